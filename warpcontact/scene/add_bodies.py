"""Methods of ``Scene`` that add bodies and sets of bodies; they check all input."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.kernels.catalogue.device_model import unit_vectors
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.joints import Free, Motion
from warpcontact.kernels.types import (
    BALL,
    FIXED,
    FREE,
    HINGE,
    PLANAR,
    PRESCRIBED,
    SLIDER,
    TIME_FUNCTION,
    TRANSLATION,
)
from warpcontact.scene.elements import MASS, Body
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

#: Motions of bodies of a set: the same for all bodies, without anchors or functions of time.
SET_MOTIONS = (FREE, FIXED, TRANSLATION, PLANAR, SLIDER, PRESCRIBED)
# Relative tolerance of an initial velocity, above the rounding error of user computations.
VELOCITY_TOLERANCE = 1.0e-6


@explain_keywords_of
class Bodies:
    """The bodies of a ``Scene``."""

    bodies: list[Body]
    _elements: dict[str, Any]

    def add_body(
        self,
        mass: float,
        inertia: ArrayLike,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        linear_velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        *,
        external_force: ArrayLike = (0.0, 0.0, 0.0),
        external_torque: ArrayLike = (0.0, 0.0, 0.0),
        motion: Motion | None = None,
        name: str | None = None,
        color: ArrayLike | None = None,
    ) -> Body:
        """Adds a rigid body.

        Args:
            mass: Mass [kg], positive.
            inertia: Inertia about the center of mass in body axes [kg·m²]: three principal moments or a
                symmetric 3×3 tensor.
            position: Initial position of the center of mass, world [m].
            orientation: Initial rotation body → world, quaternion (x, y, z, w).
            linear_velocity: Initial velocity of the center of mass, world [m/s].
            angular_velocity: Initial angular velocity, world axes [rad/s].
            external_force: External force at the center of mass, world axes [N].
            external_torque: External torque, world axes [N·m].
            motion: Joint or prescribed motion, of ``wc.motions`` or a custom ``wc.Motion``. Default: free. Axes and
                anchors are given in the world, at the initial pose. With a hinge or ball joint, the linear velocity
                follows from the angular velocity and may be omitted.
            name: Name in parameters and sensors. Default: generated.
            color: Display color, RGB in 0…1.

        Raises:
            ValueError: If a value is out of range; the message names it.

        Example:
            A quarter turn about z takes the x axis of the body to the y axis of the world:

            >>> from scipy.spatial.transform import Rotation
            >>> quarter = np.sqrt(0.5)
            >>> arm = wc.Scene().add_body(1.0, (1.0, 1.0, 1.0), orientation=(0.0, 0.0, quarter, quarter))
            >>> Rotation.from_quat(arm.orientation).apply((1.0, 0.0, 0.0)).round(9).tolist()
            [0.0, 1.0, 0.0]
        """
        name = checks.new_name("body", name, self._elements)
        shape = checks.shape_of(f"{name}.inertia", inertia)
        if shape not in ((3,), (3, 3)):
            raise ValueError(f"{name}.inertia must be 3 numbers or a 3×3 tensor [kg·m²], got {inertia!r}")
        tensor = checks.numbers(f"{name}.inertia", inertia, shape, limits("kg·m²"))
        tensor = np.diag(tensor) if shape == (3,) else tensor
        body = Body(
            name=name,
            index=self._body_count(),
            mass=checks.numbers(f"{name}.mass", mass, (), MASS),
            inertia=checks.inertia_tensors(f"{name}.inertia", tensor),
            position=checks.numbers(f"{name}.position", position, (3,), limits("m")),
            orientation=checks.unit_quaternions(
                f"{name}.orientation", checks.numbers(f"{name}.orientation", orientation, (4,))
            ),
            linear_velocity=checks.numbers(f"{name}.linear_velocity", linear_velocity, (3,), limits("m/s")),
            angular_velocity=checks.numbers(f"{name}.angular_velocity", angular_velocity, (3,), limits("rad/s")),
            external_force=checks.numbers(f"{name}.external_force", external_force, (3,), limits("N")),
            external_torque=checks.numbers(f"{name}.external_torque", external_torque, (3,), limits("N·m")),
            motion=Free() if motion is None else motion,
            color=checks.color(f"{name}.color", color),
        )
        return self._include_body(body)

    def add_bodies(
        self,
        positions: ArrayLike,
        mass: ArrayLike,
        inertia: ArrayLike,
        orientations: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        linear_velocities: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocities: ArrayLike = (0.0, 0.0, 0.0),
        *,
        external_forces: ArrayLike = (0.0, 0.0, 0.0),
        external_torques: ArrayLike = (0.0, 0.0, 0.0),
        motion: Motion | None = None,
        name: str | None = None,
        color: ArrayLike | None = None,
    ) -> Body:
        """Adds a set of rigid bodies as one element. Its parameters and sensors have an additional axis, ``item``.

        All arguments except ``positions`` are one value for all bodies, or one per body, (n, …).

        Args:
            positions: Initial positions of the centers of mass, (n, 3), world [m].
            mass: Mass [kg], positive; one or (n,).
            inertia: Inertia about the center of mass in body axes [kg·m²]: three principal moments or a symmetric
                3×3 tensor; one per body: (n, 3) or (n, 3, 3).
            orientations: Initial rotations body → world, quaternions (x, y, z, w).
            linear_velocities: Initial velocities of the centers of mass, world [m/s].
            angular_velocities: Initial angular velocities, world axes [rad/s].
            external_forces: External forces at the centers of mass, world axes [N].
            external_torques: External torques, world axes [N·m].
            motion: Motion of each body: ``Free``, ``Fixed``, ``Translation``, ``Planar``, ``Slider`` or
                ``Prescribed`` of ``wc.motions``. Default: free.
            name: Name in parameters and sensors. Default: generated.
            color: Display color, RGB in 0…1.

        Raises:
            ValueError: If a value is out of range; the message names it.
        """
        name = checks.new_name("bodies", name, self._elements)
        body = _body_set(
            name,
            self._body_count(),
            positions,
            mass=mass,
            inertia=inertia,
            orientation=orientations,
            linear_velocity=linear_velocities,
            angular_velocity=angular_velocities,
            external_force=external_forces,
            external_torque=external_torques,
            motion=Free() if motion is None else motion,
            color=color,
        )
        return self._include_body(body)

    def _body_count(self) -> int:
        return self.bodies[-1].items.stop if self.bodies else 0

    def _include_body(self, body: Body) -> Body:
        _check_initial_velocity(body)
        self.bodies.append(body)
        self._elements[body.name] = body
        return body


def _body_set(
    name: str,
    index: int,
    positions: ArrayLike,
    *,
    mass: ArrayLike,
    inertia: ArrayLike,
    orientation: ArrayLike,
    motion: Motion,
    color: ArrayLike | None,
    **vectors: ArrayLike,
) -> Body:
    """Returns a set of bodies.

    Args:
        name: Name of the set.
        index: Index of its first body on the device.
        positions: Initial positions (n, 3), world [m].
        mass: One for all or (n,) [kg].
        inertia: Moments (3,) or a tensor (3, 3) for all, or (n, 3) or (n, 3, 3) [kg·m²].
        orientation: One quaternion for all or (n, 4).
        motion: Motion of each body.
        color: Color of all bodies.
        **vectors: Velocities, forces and torques, one for all or (n, 3).

    Raises:
        ValueError: If a value is out of range; the message names it.
    """
    shape = checks.shape_of(f"{name}.positions", positions)
    if len(shape) != 2 or shape[0] < 1 or shape[1] != 3:
        raise ValueError(f"{name}.positions must have shape (n, 3) with n ≥ 1, got {shape}")
    count = shape[0]
    if isinstance(motion, Motion) and motion.kind not in SET_MOTIONS:
        raise ValueError(
            f"{name}.motion must be Free, Fixed, Translation, Planar, Slider or Prescribed for a set of bodies, "
            f"got {type(motion).__name__}, which needs an anchor or a function of time per body; use add_body"
        )
    # Argument name and unit of each vector.
    words = {
        "linear_velocity": ("linear_velocities", "m/s"),
        "angular_velocity": ("angular_velocities", "rad/s"),
        "external_force": ("external_forces", "N"),
        "external_torque": ("external_torques", "N·m"),
    }
    return Body(
        name=name,
        index=index,
        mass=_each(f"{name}.mass", mass, count, (), MASS),
        inertia=_tensors(f"{name}.inertia", inertia, count),
        position=checks.numbers(f"{name}.positions", positions, shape, limits("m")),
        orientation=checks.unit_quaternions(
            f"{name}.orientations", _each(f"{name}.orientations", orientation, count, (4,))
        ),
        motion=motion,
        color=checks.color(f"{name}.color", color),
        count=count,
        single=False,
        **{
            key: _each(f"{name}.{word}", vectors[key], count, (3,), limits(unit))
            for key, (word, unit) in words.items()
        },
    )


def _each(
    name: str, value: ArrayLike, count: int, tail: tuple[int, ...], allowed: Mapping[str, Any] = checks.FINITE
) -> Array:
    """Returns ``value``, one for all or one per body, with shape (count, *tail)."""
    shape = checks.shape_of(name, value, checks.describe_shape(tail))
    if shape not in (tail, (count, *tail)):
        raise ValueError(f"{name} must have shape {tail} or {(count, *tail)}, one per body, got {shape}")
    return np.array(np.broadcast_to(checks.numbers(name, value, shape, allowed), (count, *tail)))


def _tensors(name: str, value: ArrayLike, count: int) -> Array:
    """Returns principal moments or tensors, one for all or one per body, as checked tensors (count, 3, 3)."""
    shape = checks.shape_of(name, value)
    if count == 3 and shape == (3, 3):
        raise ValueError(
            f"{name} of shape (3, 3) is ambiguous: one tensor, or the moments of each of 3 bodies; use shape "
            "(3, 3, 3)"
        )
    if shape not in ((3,), (3, 3), (count, 3), (count, 3, 3)):
        raise ValueError(
            f"{name} must be 3 numbers or a 3×3 tensor, or of shape {(count, 3)} or {(count, 3, 3)} [kg·m²], "
            f"got shape {shape}"
        )
    values = checks.numbers(name, value, shape, limits("kg·m²"))
    if shape in ((3,), (count, 3)):
        values = values[..., None] * np.eye(3)
    checked = checks.inertia_tensors(name, values)
    return np.array(np.broadcast_to(checked, (count, 3, 3)))


def _check_initial_velocity(body: Body) -> None:
    """Checks the motion of ``body`` and its initial velocities.

    Raises:
        TypeError: If ``body.motion`` is not a motion.
        ValueError: If the motion does not allow an initial velocity; the message names it.
    """
    motion = body.motion
    if not isinstance(motion, Motion):
        raise TypeError(f"{body.name}.motion must be an instance of a class of wc.motions, got {motion!r}")
    if motion.kind in (FREE, PRESCRIBED):
        return
    v, w = body.rows("linear_velocity"), body.rows("angular_velocity")
    nothing = np.zeros_like(v)
    if motion.kind == TIME_FUNCTION:
        _refuse(body, "linear_velocity", v, nothing, "zero: it follows from")
        _refuse(body, "angular_velocity", w, nothing, "zero: it follows from")
        return
    values = motion.parameters()
    axis = unit_vectors("axis", np.asarray(values.get("axis", values.get("normal", (0, 0, 1))), dtype=np.float64))
    if motion.kind in (HINGE, PLANAR):
        _refuse(body, "angular_velocity", w, _along(axis, w), "along the axis of")
    elif motion.kind != BALL:
        _refuse(body, "angular_velocity", w, nothing, "zero with")
    if motion.kind in (HINGE, BALL):
        follows = np.cross(w, body.rows("position") - np.asarray(values["anchor"], dtype=np.float64))
        if v.any():
            shown = ", ".join(f"{component:.9g}" for component in follows[0])
            _refuse(body, "linear_velocity", v, follows, f"left out or ({shown}) with this angular velocity and")
    elif motion.kind == SLIDER:
        _refuse(body, "linear_velocity", v, _along(axis, v), "along the axis of")
    elif motion.kind == PLANAR:
        _refuse(body, "linear_velocity", v, v - _along(axis, v), "in the plane of")
    elif motion.kind == FIXED:
        _refuse(body, "linear_velocity", v, nothing, "zero with")


def _along(axis: Array, vectors: Array) -> Array:
    """Returns the components of ``vectors`` (n, 3) along ``axis``."""
    return (vectors @ axis)[:, None] * axis


def _refuse(body: Body, key: str, given: Array, allowed: Array, rule: str) -> None:
    violates_joint = np.linalg.norm(given - allowed, axis=1) > VELOCITY_TOLERANCE * np.linalg.norm(given, axis=1)
    if violates_joint.any():
        kind, worst = type(body.motion).__name__, int(np.argmax(violates_joint))
        word = key if body.single else f"{key.removesuffix('y')}ies[{worst}]"
        raise ValueError(f"{body.name}.{word} must be {rule} its motion {kind}, got {given[worst].tolist()}")
