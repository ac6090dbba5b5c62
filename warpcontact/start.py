"""Whether the velocities that a body starts with are those that its motion allows."""

import numpy as np

from warpcontact.checks import Array
from warpcontact.elements import Body
from warpcontact.kernels.formula import unit_vectors
from warpcontact.kernels.motions import Motion
from warpcontact.kernels.types import BALL, DRIVEN, FIXED, FREE, HINGE, PLANAR, PRESCRIBED, SLIDER

# Of the velocity: more than any rounding of what a user computes.
TOLERANCE = 1.0e-6


def check_start(body: Body) -> None:
    """Raises an error if ``body`` has no motion, or starts with velocities that it does not allow.

    Raises:
        TypeError: If its motion is none.
        ValueError: If a velocity is not allowed; the message names it.
    """
    motion = body.motion
    if not isinstance(motion, Motion):
        raise TypeError(f"{body.name}.motion must be an instance of a class of wc.motions, got {motion!r}")
    if motion.kind in (FREE, PRESCRIBED):
        return
    v, w = body.linear_velocity, body.angular_velocity
    if motion.kind == DRIVEN:
        _refuse(body, "linear_velocity", v, np.zeros(3), "zero: it follows from")
        _refuse(body, "angular_velocity", w, np.zeros(3), "zero: it follows from")
        return
    values = motion.parameters()
    axis = unit_vectors("axis", np.asarray(values.get("axis", values.get("normal", (0, 0, 1))), dtype=np.float64))
    if motion.kind in (HINGE, PLANAR):
        _refuse(body, "angular_velocity", w, (axis @ w) * axis, "along the axis of")
    elif motion.kind != BALL:
        _refuse(body, "angular_velocity", w, np.zeros(3), "zero with")
    if motion.kind in (HINGE, BALL):
        follows = np.cross(w, body.position - np.asarray(values["anchor"], dtype=np.float64))
        if v.any():
            shown = ", ".join(f"{component:.9g}" for component in follows)
            _refuse(body, "linear_velocity", v, follows, f"left out or ({shown}) with this angular velocity and")
    elif motion.kind == SLIDER:
        _refuse(body, "linear_velocity", v, (axis @ v) * axis, "along the axis of")
    elif motion.kind == PLANAR:
        _refuse(body, "linear_velocity", v, v - (axis @ v) * axis, "in the plane of")
    elif motion.kind == FIXED:
        _refuse(body, "linear_velocity", v, np.zeros(3), "zero with")


def _refuse(body: Body, key: str, given: Array, allowed: Array, rule: str) -> None:
    if np.linalg.norm(given - allowed) > TOLERANCE * np.linalg.norm(given):
        kind = type(body.motion).__name__
        raise ValueError(f"{body.name}.{key} must be {rule} its motion {kind}, got {given.tolist()}")
