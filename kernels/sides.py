"""How far a point may go and stay on the side of a surface that it is on."""

import functools

import warp as wp
from warpcontact.kernels.types import SIDES_ABOVE, SIDES_NOWHERE, structs


@functools.cache
def room_on_side(real: type) -> wp.Function:
    """Returns the device function for ``real``."""
    t = structs(real)
    vec3, Model = t.vec3, t.Model

    @wp.func
    def room_on_side(model: Model, patch: int, p_S: vec3):
        """How far a point of the outer side can go before it may be on the inner side without coming through.

        Of surfaces that are not known to keep their sides apart nothing is said: the result is negative.
        """
        sides = model.patch_sides[patch]
        room = real(wp.inf)
        if sides == SIDES_NOWHERE:
            room = real(-1.0)
        elif sides == SIDES_ABOVE:
            for wall in range(model.patch_wall_start[patch], model.patch_wall_start[patch + 1]):
                room = wp.min(room, wp.dot(model.wall_normal[wall], p_S) - model.wall_offset[wall])
        return room

    return room_on_side
