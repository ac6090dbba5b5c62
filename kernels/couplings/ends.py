"""Positions and velocities of the ends of couplings, and the wrench of a force at an end."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.types import structs


class Functions(NamedTuple):
    """Device functions of the ends of couplings."""

    arm: wp.Function  # arm of a point, W [m]
    separation: wp.Function  # vector from the first point to the second, W [m]
    velocity: wp.Function  # velocity of a point, W [m/s]
    write_end_force: wp.Function  # writes a force at an end and its torque


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions for ``real``.

    The arm of a point is its position relative to the center of mass of its body or to its anchor in the world, W
    [m].
    """
    t = structs(real)
    vec3, Model, State, EndWrenches = t.vec3, t.Model, t.State, t.EndWrenches
    frame = frames.functions(real)
    rotate_to_world, velocity_at = frame.rotate_to_world, frame.velocity_at

    @wp.func
    def arm(model: Model, state: State, env: int, point: int):
        """Returns the arm of ``point``, W [m]."""
        return rotate_to_world(state, env, model.point_body[point], model.point_position[env, point])

    @wp.func
    def separation(model: Model, state: State, env: int, point_1: int, point_2: int, arm_1: vec3, arm_2: vec3):
        """Returns the vector from the first point to the second, W [m]. Rounding is relative to the difference."""
        body_1 = model.point_body[point_1]
        body_2 = model.point_body[point_2]
        remainder = arm_2 - arm_1
        difference = model.point_anchor[env, point_2]
        if body_2 >= 0:
            difference = state.body_position[env, body_2]
            remainder += state.body_position_remainder[env, body_2]
        if body_1 >= 0:
            difference -= state.body_position[env, body_1]
            remainder -= state.body_position_remainder[env, body_1]
        else:
            difference -= model.point_anchor[env, point_1]
        return difference + remainder

    @wp.func
    def velocity(model: Model, state: State, env: int, point: int, arm_W: vec3):
        """Returns the velocity of ``point``, W [m/s]."""
        return velocity_at(state, env, model.point_body[point], arm_W)

    @wp.func
    def write_end_force(ends: EndWrenches, env: int, end: int, arm_W: vec3, force_W: vec3):
        """Writes a force at an end and its torque."""
        ends.force[env, end] = force_W
        ends.torque[env, end] = wp.cross(arm_W, force_W)

    return Functions(arm=arm, separation=separation, velocity=velocity, write_end_force=write_end_force)
