"""Uniform grid around a mesh: each cell stores its clearance and the faces that may be nearest.

One read replaces a BVH traversal, in which each step depends on the last. The clearance of a distant point needs
no cached data of earlier steps. ``fill_cells`` fills the cells, once per mesh.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.lowlevel.warps import lowest_set_bit
from warpcontact.kernels.narrowphase import face_closest_point as closest_points
from warpcontact.kernels.narrowphase import search
from warpcontact.kernels.types import SIDE_KNOWN_INSIDE_WALLS, SIDE_KNOWN_NOWHERE, structs

# A face list is one integer: first index / LIST_ALIGNMENT * LIST_STRIDE + number of faces (< LIST_STRIDE).
LIST_STRIDE = 32
LIST_ALIGNMENT = 4
# Factor on the cell size when cells are filled, for points that rounding assigns to a neighboring cell. The margin
# for the rounding of a query covers them as well.
OVERLAP = 1.001
# Capacity for candidate faces of a cell before dominated faces are removed.
MAX_CANDIDATES = 192
# Number of faces nearest to the cell center that others are compared with.
COMPARED_FACES = 4
# Smallest distance, in units of the size of the differences, at which rounding errors of a direction are
# negligible.
MIN_RELATIVE_DISTANCE = 0.05


@functools.cache
def side_clearance_function(real: type) -> wp.Function:
    """Returns the device function of the distance that a point can move while its side of a surface is known."""
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
    side_clearance = side_clearance_function(real)
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
        smallest_distance = real(wp.inf)
        # Bits of the faces whose distance is within the margin of the smallest.
        candidates = wp.int32(0)
        for number in range(assume_nonnegative(faces) % wp.static(LIST_STRIDE)):
            distance = face_distance(model, assume_nonnegative(model.cell_face[start + number]), p_S)
            if distance < smallest_distance - margin:
                candidates = wp.int32(0)
            if distance <= smallest_distance + margin:
                candidates = candidates | (1 << number)
            smallest_distance = wp.min(smallest_distance, distance)
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


@functools.cache
def fill_cells(real: type) -> wp.Kernel:
    """Returns the kernel that fills the cells of a query mesh, one per thread.

    A face can be nearest to a point of the cell only if its smallest distance to the cell is not above the largest
    distance of the face nearest to the center. The latter occurs at a corner of the cell, because the distance to
    a triangle is convex. A remaining face is removed if another is nearer everywhere in the cell. Its distance has
    the linear lower bound

        d(p) ≥ d(q) + u·(p − q)

    with its gradient u at any point q, and the distance of the other face is convex. So the smallest difference of
    the two occurs at a corner of the cell.
    """
    t = structs(real)
    vec3, Model = t.vec3, t.Model
    search_functions = search.functions(real)
    refine_closest, faces_within = search_functions.refine_closest, search_functions.faces_within
    max_coordinate, query_error = search_functions.max_coordinate, search_functions.query_error
    closest_on_face, is_inside = (
        closest_points.functions(real).closest_on_face,
        closest_points.functions(real).is_inside,
    )
    side_clearance = side_clearance_function(real)
    Rows = wp.types.vector(length=MAX_CANDIDATES, dtype=wp.int32)
    ComparedFaces = wp.types.vector(length=COMPARED_FACES, dtype=wp.int32)
    Distances = wp.types.vector(length=COMPARED_FACES, dtype=real)
    Corners = wp.types.vector(length=8 * COMPARED_FACES, dtype=real)
    min_relative_distance = wp.constant(real(MIN_RELATIVE_DISTANCE))

    @wp.func
    def corner(c: vec3, half: real, number: int):
        """Returns a corner of a cell, or its center for ``number`` 8."""
        if number == 8:
            return c
        side = vec3(real(number & 1), real((number >> 1) & 1), real((number >> 2) & 1))
        return c + real(2.0) * half * (side - vec3(real(0.5)))

    @wp.func
    def is_never_nearest(
        model: Model,
        row: int,
        c: vec3,
        half: real,
        compared_faces: ComparedFaces,
        corner_distances: Corners,
        margin: real,
    ):
        """Returns whether one of the compared faces is nearer by more than ``margin`` everywhere in the cell."""
        for at in range(9):
            # Start with the center.
            q = corner(c, half, 8 - at)
            closest = closest_on_face(model, row, q)
            if closest.distance > min_relative_distance * closest.span:
                u = closest.to_point / closest.distance
                for compared in range(wp.static(COMPARED_FACES)):
                    if compared_faces[compared] >= 0 and compared_faces[compared] != row:
                        lead = real(wp.inf)
                        for k in range(8):
                            corner_bound = closest.distance + wp.dot(u, corner(c, half, k) - q)
                            lead = wp.min(lead, corner_bound - corner_distances[8 * compared + k])
                        if lead > margin:
                            return True
        return False

    # Loops are not unrolled: unrolling takes seven times as long to compile and is not faster (measured).
    @unique_kernel(unrolled=1)
    def fill_grid_cells(
        model: Model,
        query_mesh: wp.int32,
        reach: real,  # distance up to which points on the outer side are searched [mesh unit]
        first: wp.int32,  # index of the first list entry of this mesh
        face_capacity: wp.int32,  # number of list entries; like ``first`` a multiple of ``LIST_ALIGNMENT``
        used_units: wp.array(dtype=wp.int32),
    ):
        number = wp.tid()
        counts = model.query_mesh_grid[query_mesh]
        size = model.query_mesh_cell_size[query_mesh]
        half = real(wp.static(0.5 * OVERLAP)) * size
        radius = real(wp.static(3.0**0.5)) * half
        x = number % counts[0]
        y = (number // counts[0]) % counts[1]
        z = number // (counts[0] * counts[1])
        middle = vec3(real(x) + real(0.5), real(y) + real(0.5), real(z) + real(0.5))
        c = model.query_mesh_grid_origin[query_mesh] + size * middle
        cell = counts[3] + number
        model.cells[cell].clearance = real(0.0)
        model.cells[cell].faces = -1
        c_32 = wp.vec3f(wp.float32(c[0]), wp.float32(c[1]), wp.float32(c[2]))
        query = wp.mesh_query_point_no_sign(model.query_mesh_id[query_mesh], c_32, wp.float32(wp.inf))
        if not query.result:
            return
        start = model.query_mesh_face_start[query_mesh]
        nearest = closest_on_face(model, start + query.face, c)
        error = query_error(model, query_mesh, max_coordinate(c), nearest.distance)
        # Among faces within the error of the query another may be nearest, with the point on its inner side.
        nearest = refine_closest(model, query_mesh, c, nearest, error)
        inside = is_inside(model, nearest)
        if not inside:
            side_distance = side_clearance(model, query_mesh, c)
            model.cells[cell].clearance = wp.min(nearest.distance, side_distance) - error - radius
        skin = model.query_mesh_skin[query_mesh]
        far = wp.where(inside, skin, reach + skin + size) + radius
        if nearest.distance > far:
            return

        largest = real(0.0)
        for k in range(8):
            largest = wp.max(largest, closest_on_face(model, nearest.row, corner(c, half, k)).distance)
        # Keep the faces nearest to the center for comparison.
        rows = Rows()
        compared_faces = ComparedFaces(-1)
        distances = Distances(real(wp.inf))
        count = wp.int32(0)
        found = faces_within(model, query_mesh, c, largest + radius + error)
        face = wp.int32(0)
        while wp.mesh_query_next(found, face):
            closest = closest_on_face(model, start + face, c)
            lower_bound = closest.distance - radius
            if closest.distance > min_relative_distance * closest.span:
                u = closest.to_point / closest.distance
                lower_bound = closest.distance - half * (wp.abs(u[0]) + wp.abs(u[1]) + wp.abs(u[2]))
            if lower_bound - error <= largest:
                if count < wp.static(MAX_CANDIDATES):
                    rows[count] = closest.row
                count += 1
                distance = closest.distance
                row = closest.row
                for i in range(wp.static(COMPARED_FACES)):
                    if distance < distances[i]:
                        farther = distances[i]
                        farther_row = compared_faces[i]
                        distances[i] = distance
                        compared_faces[i] = row
                        distance = farther
                        row = farther_row
        if count > wp.static(MAX_CANDIDATES):
            return
        corner_distances = Corners()
        for compared in range(wp.static(COMPARED_FACES)):
            if compared_faces[compared] >= 0:
                for k in range(8):
                    corner_distances[8 * compared + k] = closest_on_face(
                        model, compared_faces[compared], corner(c, half, k)
                    ).distance
        kept_count = wp.int32(0)
        for i in range(count):
            if not is_never_nearest(model, rows[i], c, half, compared_faces, corner_distances, real(2.0) * error):
                rows[kept_count] = rows[i]
                kept_count += 1
        if kept_count == 0 or kept_count >= wp.static(LIST_STRIDE):
            return
        units = (kept_count + wp.static(LIST_ALIGNMENT - 1)) // wp.static(LIST_ALIGNMENT)
        unit = wp.atomic_add(used_units, 0, units)
        if unit + units > face_capacity // wp.static(LIST_ALIGNMENT):
            return
        unit += first // wp.static(LIST_ALIGNMENT)
        for i in range(kept_count):
            model.cell_face[wp.static(LIST_ALIGNMENT) * unit + i] = rows[i]
        model.cells[cell].faces = wp.static(LIST_STRIDE) * unit + kept_count

    return fill_grid_cells
