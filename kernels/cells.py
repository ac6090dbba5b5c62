"""A grid of cells about a mesh: which faces may be nearest to a point of a cell, and how far all its points are.

What a search in a tree finds node by node, each step waiting for the last, a cell has in one place; and what is
far away is known from one look, whatever was there before.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import foot as feet
from warpcontact.kernels.sides import room_on_side as sides_of
from warpcontact.kernels.types import natural, structs
from warpcontact.kernels.warps import first_of

# A list is a number: its first place, a multiple of ``PLACED``, over that times ``LISTED``, and how many faces it
# has, which are fewer.
LISTED = 32
PLACED = 4
# A cell is filled as if it were so much larger, for points that rounding puts into the one beside theirs; what is
# taken off for the rounding of a query serves for them as well.
OVERLAP = 1.001


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, Model, Cell = t.vec3, t.Model, t.Cell
    of_face = feet.functions(real)
    foot_on, distance_from = of_face.foot_on, of_face.distance_from
    nearer, fallen, taken = of_face.nearer, of_face.fallen, of_face.taken
    room_on_side = sides_of(real)
    nothing = wp.constant(real(0.0))

    @wp.func
    def cell_at(model: Model, patch: int, p_S: vec3):
        """What is known about a point of the mesh's frame; of a patch without cells nothing.

        A point outside of the grid is on the side of the nearest cell, with no surface between them.
        """
        cell = Cell()
        cell.faces = -1
        counts = model.patch_cells[patch]
        if counts[3] >= 0:
            size = model.patch_cells_size[patch]
            q = (real(1.0) / size) * (p_S - model.patch_cells_origin[patch])
            x = wp.clamp(q[0], nothing, real(counts[0]) - real(0.5))
            y = wp.clamp(q[1], nothing, real(counts[1]) - real(0.5))
            z = wp.clamp(q[2], nothing, real(counts[2]) - real(0.5))
            number = wp.int32(x) + counts[0] * (wp.int32(y) + counts[1] * wp.int32(z))
            cell = model.cells[natural(counts[3] + number)]
            beyond = q - vec3(x, y, z)
            inside = q[0] >= nothing and q[1] >= nothing and q[2] >= nothing
            inside = inside and beyond[0] < real(0.5) and beyond[1] < real(0.5) and beyond[2] < real(0.5)
            if not inside:
                cell.faces = -1
                if cell.free > nothing:
                    away = wp.length(wp.max(wp.abs(beyond) - vec3(real(0.5)), vec3())) * size
                    cell.free = wp.min(away + model.patch_cells_margin[patch], room_on_side(model, patch, p_S))
        return cell

    @wp.func
    def nearest_listed(model: Model, faces: int, p_S: vec3, margin: real):
        """The foot on the nearest of the faces of a list, ``margin`` being wide enough for rounding."""
        start = natural(faces) // wp.static(LISTED) * wp.static(PLACED)
        least = real(wp.inf)
        # Those that are about as near as the nearest so far, as bits.
        those = wp.int32(0)
        for number in range(natural(faces) % wp.static(LISTED)):
            distance = distance_from(model, natural(model.listed_face[start + number]), p_S)
            if distance < least - margin:
                those = wp.int32(0)
            if distance <= least + margin:
                those = those | (1 << number)
            least = wp.min(least, distance)
        best = foot_on(model, model.listed_face[start + first_of(those)], p_S)
        left = those & (those - 1)
        if left != 0:
            while left != 0:
                best = nearer(model, best, foot_on(model, model.listed_face[start + first_of(left)], p_S))
                left = left & (left - 1)
            if fallen(best):
                # Once more, now that it is known how near the nearest is.
                best.row = -1
                while those != 0:
                    best = taken(model, best, foot_on(model, model.listed_face[start + first_of(those)], p_S))
                    those = those & (those - 1)
            best.distance = wp.length(best.to_point)
        return best

    return SimpleNamespace(cell_at=cell_at, nearest_listed=nearest_listed)
