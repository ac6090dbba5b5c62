"""Fills the cells of ``cells.py``, once for each mesh."""

import functools

import warp as wp
from warpcontact.kernels import foot as feet
from warpcontact.kernels import search
from warpcontact.kernels.cells import LISTED, OVERLAP, PLACED
from warpcontact.kernels.sides import room_on_side as sides_of
from warpcontact.kernels.types import structs
from warpcontact.kernels.unique import unique_kernel

# Faces that may be nearest before it is looked at which of them another is always nearer than.
CANDIDATES = 192
# Those, the nearest to the middle, that others are held against.
RIVALS = 4
# Distance, in units of the size of the differences, from which on rounding leaves a direction as it is.
STEADY = 0.05


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that fills one cell of a patch for each thread.

    A face may be nearest to a point of a cell only if its least distance there is not more than the largest of
    the face that is nearest to the middle: that of a corner, as the distance from a triangle is convex. Of those
    that are left one is never nearest if another is nearer everywhere in the cell. What its distance is at least,

        d(p) ≥ d(q) + u·(p − q)

    with its slope u at any point q, is linear, and the distance from the other convex: so the difference of both
    is least in a corner.
    """
    t = structs(real)
    vec3, Model = t.vec3, t.Model
    of_search = search.functions(real)
    nearest_of_all, faces_about = of_search.nearest_of_all, of_search.faces_about
    extent_of, unsure_of = of_search.extent_of, of_search.unsure_of
    foot_on, inner = feet.functions(real).foot_on, feet.functions(real).inner
    room_on_side = sides_of(real)
    Rows = wp.types.vector(length=CANDIDATES, dtype=wp.int32)
    Rivals = wp.types.vector(length=RIVALS, dtype=wp.int32)
    Distances = wp.types.vector(length=RIVALS, dtype=real)
    Corners = wp.types.vector(length=8 * RIVALS, dtype=real)
    steady = wp.constant(real(STEADY))

    @wp.func
    def corner(c: vec3, half: real, number: int):
        """A corner of a cell, or with the number 8 its middle."""
        if number == 8:
            return c
        side = vec3(real(number & 1), real((number >> 1) & 1), real((number >> 2) & 1))
        return c + real(2.0) * half * (side - vec3(real(0.5)))

    @wp.func
    def never_nearest(model: Model, row: int, c: vec3, half: real, rivals: Rivals, away: Corners, margin: real):
        """Whether one of the rivals is nearer than a face by more than a margin, wherever in the cell."""
        for at in range(9):
            # From the middle first.
            q = corner(c, half, 8 - at)
            foot = foot_on(model, row, q)
            if foot.distance > steady * foot.span:
                u = foot.to_point / foot.distance
                for rival in range(wp.static(RIVALS)):
                    if rivals[rival] >= 0 and rivals[rival] != row:
                        ahead = real(wp.inf)
                        for k in range(8):
                            least = foot.distance + wp.dot(u, corner(c, half, k) - q)
                            ahead = wp.min(ahead, least - away[8 * rival + k])
                        if ahead > margin:
                            return True
        return False

    # Loops in loops: written out they take the compiler seven times as long, and run no faster; measured.
    @unique_kernel(unrolled=1)
    def fill_cells(
        model: Model,
        patch: wp.int32,
        reach: real,  # from the outer side, of points that are searched for [unit of the mesh]
        first: wp.int32,  # place of the first face that is listed
        places: wp.int32,  # that there is room for; both are multiples of ``PLACED``
        used: wp.array(dtype=wp.int32),
    ):
        number = wp.tid()
        counts = model.patch_cells[patch]
        size = model.patch_cells_size[patch]
        half = real(wp.static(0.5 * OVERLAP)) * size
        radius = real(wp.static(3.0**0.5)) * half
        x = number % counts[0]
        y = (number // counts[0]) % counts[1]
        z = number // (counts[0] * counts[1])
        middle = vec3(real(x) + real(0.5), real(y) + real(0.5), real(z) + real(0.5))
        c = model.patch_cells_origin[patch] + size * middle
        cell = counts[3] + number
        model.cells[cell].free = real(0.0)
        model.cells[cell].faces = -1
        c_32 = wp.vec3f(wp.float32(c[0]), wp.float32(c[1]), wp.float32(c[2]))
        query = wp.mesh_query_point_no_sign(model.patch_mesh[patch], c_32, wp.float32(wp.inf))
        if not query.result:
            return
        start = model.patch_face_start[patch]
        nearest = foot_on(model, start + query.face, c)
        unsure = unsure_of(model, patch, extent_of(c), nearest.distance)
        # One that the query takes for as near may show the other side.
        nearest = nearest_of_all(model, patch, c, nearest, unsure)
        within = inner(model, nearest)
        if not within:
            room = room_on_side(model, patch, c)
            model.cells[cell].free = wp.min(nearest.distance, room) - unsure - radius
        skin = model.patch_skin[patch]
        far = wp.where(within, skin, reach + skin + size) + radius
        if nearest.distance > far:
            return

        largest = real(0.0)
        for k in range(8):
            largest = wp.max(largest, foot_on(model, nearest.row, corner(c, half, k)).distance)
        # The nearest to the middle are the rivals.
        rows = Rows()
        rivals = Rivals(-1)
        distances = Distances(real(wp.inf))
        count = wp.int32(0)
        found = faces_about(model, patch, c, largest + radius + unsure)
        face = wp.int32(0)
        while wp.mesh_query_next(found, face):
            foot = foot_on(model, start + face, c)
            near = foot.distance - radius
            if foot.distance > steady * foot.span:
                u = foot.to_point / foot.distance
                near = foot.distance - half * (wp.abs(u[0]) + wp.abs(u[1]) + wp.abs(u[2]))
            if near - unsure <= largest:
                if count < wp.static(CANDIDATES):
                    rows[count] = foot.row
                count += 1
                distance = foot.distance
                row = foot.row
                for i in range(wp.static(RIVALS)):
                    if distance < distances[i]:
                        farther = distances[i]
                        farther_row = rivals[i]
                        distances[i] = distance
                        rivals[i] = row
                        distance = farther
                        row = farther_row
        if count > wp.static(CANDIDATES):
            return
        away = Corners()
        for rival in range(wp.static(RIVALS)):
            if rivals[rival] >= 0:
                for k in range(8):
                    away[8 * rival + k] = foot_on(model, rivals[rival], corner(c, half, k)).distance
        left = wp.int32(0)
        for i in range(count):
            if not never_nearest(model, rows[i], c, half, rivals, away, real(2.0) * unsure):
                rows[left] = rows[i]
                left += 1
        if left == 0 or left >= wp.static(LISTED):
            return
        taken = (left + wp.static(PLACED - 1)) // wp.static(PLACED)
        place = wp.atomic_add(used, 0, taken)
        if place + taken > places // wp.static(PLACED):
            return
        place += first // wp.static(PLACED)
        for i in range(left):
            model.listed_face[wp.static(PLACED) * place + i] = rows[i]
        model.cells[cell].faces = wp.static(LISTED) * place + left

    return fill_cells
