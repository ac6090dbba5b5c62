"""Creates sets of rigid bodies as one element from values for all bodies or for each, and checks them."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.kernels.joints import Motion
from warpcontact.kernels.types import FIXED, FREE, PLANAR, PRESCRIBED, SLIDER, TRANSLATION
from warpcontact.scene.elements import MASS, Body
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

#: Motions of bodies of a set: the same for all bodies, without anchors or functions of time.
KINDS = (FREE, FIXED, TRANSLATION, PLANAR, SLIDER, PRESCRIBED)


def body_set(
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
    if isinstance(motion, Motion) and motion.kind not in KINDS:
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
