"""Checks that the initial velocities of a body are compatible with its joint."""

import numpy as np

from warpcontact.kernels.catalogue.device_model import unit_vectors
from warpcontact.kernels.joints import Motion
from warpcontact.kernels.types import BALL, FIXED, FREE, HINGE, PLANAR, PRESCRIBED, SLIDER, TIME_FUNCTION
from warpcontact.scene.elements import Body
from warpcontact.validation.checks import Array

# Relative tolerance of the velocity, above the rounding error of user computations.
TOLERANCE = 1.0e-6


def check_initial_velocity(body: Body) -> None:
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
    off = np.linalg.norm(given - allowed, axis=1) > TOLERANCE * np.linalg.norm(given, axis=1)
    if off.any():
        kind, worst = type(body.motion).__name__, int(np.argmax(off))
        word = key if body.single else f"{key.removesuffix('y')}ies[{worst}]"
        raise ValueError(f"{body.name}.{word} must be {rule} its motion {kind}, got {given[worst].tolist()}")
