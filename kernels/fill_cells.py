"""Fills the cells of ``cells.py``, once for each mesh."""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels import closest_point as closest
from warpcontact.kernels import foot as feet
from warpcontact.kernels import search
from warpcontact.kernels.cells import IN_CELL, OVERLAP
from warpcontact.kernels.closest_point import ROUNDING, WHOLE
from warpcontact.kernels.search import STEADY
from warpcontact.kernels.types import REMEMBERED_IN_QUEUES, structs


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that fills one cell of a patch for each thread.

    A face may be nearest to a point of a cell only if its least distance there is not more than the largest of
    the face that is nearest to the middle: that of a corner, as the distance from a triangle is convex. The least
    is no less than what the slope in the middle says.
    """
    t = structs(real)
    vec3, Model = t.vec3, t.Model
    of_face, nearest_of_all = feet.functions(real), search.functions(real, REMEMBERED_IN_QUEUES).nearest_of_all
    foot_on, inner = of_face.foot_on, of_face.inner
    room_on_side = closest.functions(real, False, WHOLE).room_on_side
    query_epsilon = wp.constant(real(float(np.finfo(np.float32).eps) * ROUNDING))
    Least = wp.types.vector(length=IN_CELL, dtype=real)
    steady = wp.constant(real(STEADY))

    @wp.kernel(module="unique", enable_backward=False)
    def fill_cells(
        model: Model,
        patch: wp.int32,
        reach: real,  # from the outer side, of points that are searched for [unit of the mesh]
        first_list: wp.int32,
        lists: wp.int32,  # that there is room for
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
        model.cell_list[cell] = -1
        model.cell_free[cell] = real(0.0)
        c_32 = wp.vec3f(wp.float32(c[0]), wp.float32(c[1]), wp.float32(c[2]))
        query = wp.mesh_query_point_no_sign(model.patch_mesh[patch], c_32, wp.float32(wp.inf))
        if not query.result:
            return
        start = model.patch_face_start[patch]
        first = foot_on(model, start + query.face, c)
        extent = wp.max(wp.max(wp.abs(c[0]), wp.abs(c[1])), wp.abs(c[2]))
        unsure = model.patch_slack[patch] + query_epsilon * (extent + first.distance)
        # One that the query takes for as near may show the other side.
        first = nearest_of_all(model, patch, c, first, unsure)
        within = inner(model, first)
        if not within:
            model.cell_free[cell] = wp.min(first.distance, room_on_side(model, patch, c)) - unsure - radius
        skin = model.patch_skin[patch]
        far = wp.where(within, skin, reach + skin + size) + radius
        if first.distance > far:
            return
        row = wp.atomic_add(used, 0, 1)
        if row >= lists:
            return
        row += first_list

        largest = real(0.0)
        for corner in range(8):
            side = vec3(real(corner & 1), real((corner >> 1) & 1), real((corner >> 2) & 1))
            p = c + real(2.0) * half * (side - vec3(real(0.5)))
            largest = wp.max(largest, foot_on(model, first.row, p).distance)
        # Faces with a larger least distance are left out.
        beyond = largest + skin
        found = wp.mesh_query_sphere(
            model.patch_mesh[patch],
            c_32,
            wp.float32(beyond + radius + unsure + model.patch_thin[patch]),
        )
        least = Least()
        # The nearest to the middle comes first, and stays.
        model.list_face[row, 0] = first.row
        count = wp.int32(1)
        face = wp.int32(0)
        while wp.mesh_query_next(found, face):
            foot = foot_on(model, start + face, c)
            near = foot.distance - radius
            if foot.distance > steady * foot.span:
                u = foot.to_point / foot.distance
                near = foot.distance - half * (wp.abs(u[0]) + wp.abs(u[1]) + wp.abs(u[2]))
            near -= unsure
            if near <= beyond and foot.row != first.row:
                place = count
                if count == wp.static(IN_CELL):
                    # The farthest makes room, and ends the reach of the list.
                    place = wp.int32(1)
                    for i in range(2, wp.static(IN_CELL)):
                        if least[i] > least[place]:
                            place = i
                    if near < least[place]:
                        beyond = least[place]
                    else:
                        beyond = near
                        place = wp.int32(-1)
                else:
                    count += 1
                if place >= 0:
                    least[place] = near
                    model.list_face[row, place] = foot.row
        for i in range(count, wp.static(IN_CELL)):
            model.list_face[row, i] = -1
        model.list_reach[row] = beyond
        model.cell_list[cell] = row

    return fill_cells
