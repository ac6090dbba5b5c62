"""Distance that a point can move while its side of a surface is known."""

import functools

import warp as wp
from warpcontact.kernels.types import SIDE_KNOWN_INSIDE_WALLS, SIDE_KNOWN_NOWHERE, structs


@functools.cache
def side_clearance(real: type) -> wp.Function:
    """Returns the device function for ``real``."""
    t = structs(real)
    vec3, Model = t.vec3, t.Model

    @wp.func
    def side_clearance(model: Model, query_mesh: int, p_S: vec3):
        """Returns how far a point on the outer side can move without reaching the inner side around the boundary.

        Negative if the sides of the surface are not known anywhere [mesh unit].
        """
        sides = model.query_mesh_side_region[query_mesh]
        clearance = real(wp.inf)
        if sides == SIDE_KNOWN_NOWHERE:
            clearance = real(-1.0)
        elif sides == SIDE_KNOWN_INSIDE_WALLS:
            for wall in range(
                model.query_mesh_wall_start[query_mesh], model.query_mesh_wall_start[query_mesh + 1]
            ):
                clearance = wp.min(clearance, wp.dot(model.wall_normal[wall], p_S) - model.wall_offset[wall])
        return clearance

    return side_clearance
