"""Uniform grid around a mesh: each cell stores its clearance and the faces that may be nearest.

One read replaces a BVH traversal, in which each step depends on the last. The clearance of a distant point needs
no cached data of earlier steps. ``fill_face_grid.py`` fills the cells.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.warps import lowest_set_bit
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.narrowphase.side_regions import side_clearance as side_clearance_of
from warpcontact.kernels.types import structs

# A face list is one integer: first index / LIST_ALIGNMENT * LIST_STRIDE + number of faces (< LIST_STRIDE).
LIST_STRIDE = 32
LIST_ALIGNMENT = 4
# Factor on the cell size when cells are filled, for points that rounding assigns to a neighboring cell. The margin
# for the rounding of a query covers them as well.
OVERLAP = 1.001


class Functions(NamedTuple):
    """Device functions of face grids."""

    cell_at: wp.Function  # cell of a point in the mesh frame; without a grid, an empty cell
    closest_in_cell: wp.Function  # closest point on the faces of a list


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, Model, Cell = t.vec3, t.Model, t.Cell
    face_functions = closest_points.functions(real)
    closest_on_face, face_distance = face_functions.closest_on_face, face_functions.face_distance
    closer, lost_tie, break_tie = face_functions.closer, face_functions.lost_tie, face_functions.break_tie
    side_clearance = side_clearance_of(real)
    zero = wp.constant(real(0.0))

    @wp.func
    def cell_at(model: Model, query_mesh: int, p_S: vec3):
        """Returns the cell of a point in the mesh frame; without a grid, an empty cell.

        Outside the grid, the point is on the side of the nearest boundary cell, with no surface between them.
        """
        cell = Cell()
        cell.faces = -1
        counts = model.query_mesh_grid[query_mesh]
        if counts[3] >= 0:
            size = model.query_mesh_cell_size[query_mesh]
            q = (real(1.0) / size) * (p_S - model.query_mesh_grid_origin[query_mesh])
            x = wp.clamp(q[0], zero, real(counts[0]) - real(0.5))
            y = wp.clamp(q[1], zero, real(counts[1]) - real(0.5))
            z = wp.clamp(q[2], zero, real(counts[2]) - real(0.5))
            number = wp.int32(x) + counts[0] * (wp.int32(y) + counts[1] * wp.int32(z))
            cell = model.cells[assume_nonnegative(counts[3] + number)]
            outside = q - vec3(x, y, z)
            inside = q[0] >= zero and q[1] >= zero and q[2] >= zero
            inside = inside and outside[0] < real(0.5) and outside[1] < real(0.5) and outside[2] < real(0.5)
            if not inside:
                cell.faces = -1
                if cell.clearance > zero:
                    distance = wp.length(wp.max(wp.abs(outside) - vec3(real(0.5)), vec3())) * size
                    cell.clearance = wp.min(
                        distance + model.query_mesh_grid_margin[query_mesh], side_clearance(model, query_mesh, p_S)
                    )
        return cell

    @wp.func
    def closest_in_cell(model: Model, faces: int, p_S: vec3, margin: real):
        """Returns the closest point on the faces of a list; ``margin`` covers rounding."""
        start = assume_nonnegative(faces) // wp.static(LIST_STRIDE) * wp.static(LIST_ALIGNMENT)
        least = real(wp.inf)
        # Bits of the faces whose distance is within the margin of the smallest.
        candidates = wp.int32(0)
        for number in range(assume_nonnegative(faces) % wp.static(LIST_STRIDE)):
            distance = face_distance(model, assume_nonnegative(model.cell_face[start + number]), p_S)
            if distance < least - margin:
                candidates = wp.int32(0)
            if distance <= least + margin:
                candidates = candidates | (1 << number)
            least = wp.min(least, distance)
        best = closest_on_face(model, model.cell_face[start + lowest_set_bit(candidates)], p_S)
        remaining = candidates & (candidates - 1)
        if remaining != 0:
            while remaining != 0:
                best = closer(
                    model, best, closest_on_face(model, model.cell_face[start + lowest_set_bit(remaining)], p_S)
                )
                remaining = remaining & (remaining - 1)
            if lost_tie(best):
                # Second pass: break ties among the candidates within rounding of the smallest distance.
                best.row = -1
                while candidates != 0:
                    best = break_tie(
                        model,
                        best,
                        closest_on_face(model, model.cell_face[start + lowest_set_bit(candidates)], p_S),
                    )
                    candidates = candidates & (candidates - 1)
            best.distance = wp.length(best.to_point)
        return best

    return Functions(cell_at=cell_at, closest_in_cell=closest_in_cell)
