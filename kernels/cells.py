"""A grid of cells about a mesh: which faces may be nearest to a point of a cell, and how far all points of it are.

What a search in a tree finds node by node, each step waiting for the last, a cell has in one place: for a GPU.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.types import structs

# Faces in the list of a cell, at most. The rest of them are farther than its reach.
IN_CELL = 32
# A cell is filled as if it were so much larger, for points that rounding puts into the one beside theirs; what is
# taken off for the rounding of a query serves for them as well.
OVERLAP = 1.001


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, Model = t.vec3, t.Model

    @wp.func
    def cell_of(model: Model, patch: int, p_S: vec3):
        """The cell that a point of the mesh's frame is in; −1: none."""
        counts = model.patch_cells[patch]
        cell = wp.int32(-1)
        if counts[3] >= 0:
            q = (p_S - model.patch_cells_origin[patch]) / model.patch_cells_size[patch]
            inside = q[0] >= real(0.0) and q[1] >= real(0.0) and q[2] >= real(0.0)
            inside = inside and q[0] < real(counts[0]) and q[1] < real(counts[1]) and q[2] < real(counts[2])
            if inside:
                cell = wp.int32(q[0]) + counts[0] * (wp.int32(q[1]) + counts[1] * wp.int32(q[2]))
                cell += counts[3]
        return cell

    @wp.func
    def list_at(model: Model, patch: int, p_S: vec3):
        """The row of the list of faces about a point; −1: none."""
        cell = cell_of(model, patch, p_S)
        row = wp.int32(-1)
        if cell >= 0:
            row = model.cell_list[cell]
        return row

    return SimpleNamespace(cell_of=cell_of, list_at=list_at)
