"""Methods of ``Scene`` that add bodies and sets of bodies; they check all input."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.joints import Free, Motion
from warpcontact.scene.body_sets import body_set
from warpcontact.scene.elements import MASS, Body
from warpcontact.scene.initial_velocity_check import check_initial_velocity
from warpcontact.validation import checks
from warpcontact.validation.checks import limits


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
        body = body_set(
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
        check_initial_velocity(body)
        self.bodies.append(body)
        self._elements[body.name] = body
        return body
