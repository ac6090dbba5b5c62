"""Grids about the meshes that a GPU searches: where they lie, how fine they are, and what they take."""

from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.arrays import Layout
from warpcontact.kernels.cells import IN_CELL

if TYPE_CHECKING:
    from warpcontact.patches import Patch, Patches

# Size of a cell, as part of a usual edge: the finest first, the coarsest last. Measured.
FINEST, COARSEST = 0.5, 1.0
# Cells beside those near the patch, where there is room for them.
AROUND = 8.0
# What the cells of a patch may take, its lists, and those of all patches [bytes].
CELL_BYTES, LIST_BYTES, MOST_BYTES = 16 * 2**20, 64 * 2**20, 256 * 2**20


@dataclass(frozen=True)
class Grid:
    """A grid about a patch, in the mesh's frame and unit.

    Attributes:
        origin: Its lowest corner (3,).
        counts: Cells along the axes.
        size: Size of a cell.
        lists: Room for lists of faces, which cells near the patch have.
        reach: How far points on the outer side are that come to touch.
        bytes: What it takes.
    """

    origin: NDArray[np.float64]
    counts: tuple[int, int, int]
    size: float
    lists: int
    reach: float
    bytes: int

    @property
    def cells(self) -> int:
        """How many there are."""
        return int(np.prod(self.counts))


def grids_about(made: "Patches", device: wp.Device, real: type) -> list[Grid | None]:
    """Returns the grids about patches; ``None`` where there is none, as on a CPU, which waits for no search.

    The first have theirs where there is no room for all.
    """
    grids: list[Grid | None] = [None] * len(made.patches)
    if not device.is_cuda:
        return grids
    reach = np.zeros(len(made.patches))
    for contact, first in made.of_contact.items():
        own = slice(first, first + len(contact.surface.meshes))
        reach[own] = np.maximum(reach[own], contact.radius.max() / contact.surface.scale.min())
    left = MOST_BYTES
    for number, patch in enumerate(made.patches):
        grid = grid_about(patch, float(reach[number]), real)
        if grid is not None and (left := left - grid.bytes) >= 0:
            grids[number] = grid
    return grids


def grid_about(patch: "Patch", reach: float, real: type) -> Grid | None:
    """Returns the grid about a patch; ``None`` where it would take too much, or help too little.

    Args:
        patch: The patch.
        reach: Radius of the largest sphere that touches it, in the unit of the mesh.
        real: Type of a real number.
    """
    of_cell, of_list = _sizes(real)
    corner = patch.corner
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    low, high = corner.min(axis=(0, 1)), corner.max(axis=(0, 1))
    size = FINEST * patch.edge
    while size <= COARSEST * patch.edge:
        # Faces that come nearer to a point than the nearest and this lie in a disk about that.
        about = size + patch.skin
        crowd = np.pi * about * (2.0 * reach + about) / float(area.mean())
        if crowd > IN_CELL:
            return None
        # Cells that have a list lie within this of the area, a third more about a bend or beside a rim.
        height = reach + 2.0 * patch.skin + 3.0 * size
        lists = int(1.35 * float(area.sum()) * height / size**3) + 1000
        # Cells beyond those tell how far it is.
        for beyond in (AROUND, AROUND / 2.0, AROUND / 4.0, 1.0):
            margin = reach + patch.skin + beyond * size
            counts = np.ceil((high - low + 2.0 * margin) / size)
            cells = float(np.prod(counts))
            if cells * of_cell <= CELL_BYTES and lists * of_list <= LIST_BYTES:
                x, y, z = counts.astype(int).tolist()
                lists = min(lists, int(cells))
                return Grid(low - margin, (x, y, z), size, lists, reach, int(cells) * of_cell + lists * of_list)
        size *= 1.1
    return None


def _sizes(real: type) -> tuple[int, int]:
    """Returns what a cell takes, and a list of faces [bytes]."""
    own = wp.types.type_size_in_bytes(real)
    return 4 + own, 4 * IN_CELL + own


def declare_grids(grids: Sequence[Grid | None], model: Any, layout: Layout, t: SimpleNamespace) -> None:
    """Declares the grids of the patches of ``model``, to be filled when they are made."""
    there = [grid for grid in grids if grid is not None]
    first_cell = np.cumsum([0] + [0 if grid is None else grid.cells for grid in grids]).tolist()
    first_list = np.cumsum([0] + [0 if grid is None else grid.lists for grid in grids]).tolist()
    none = Grid(np.zeros(3), (0, 0, 0), 1.0, 0, 0.0, 0)
    rows = [grid or none for grid in grids]
    counts = [(*grid.counts, start if grid.cells else -1) for grid, start in zip(rows, first_cell, strict=False)]
    layout.content("surfaces", model, "patch_cells", np.array(counts).reshape(-1, 4), wp.vec4i)
    origins = np.array([grid.origin for grid in rows]).reshape(-1, 3)
    layout.content("surfaces", model, "patch_cells_origin", origins, t.vec3)
    layout.content("surfaces", model, "patch_cells_size", [grid.size for grid in rows], t.real)
    cells, lists = first_cell[-1], first_list[-1]

    def make(_: int) -> None:
        device = layout.device
        model.cell_list = wp.empty(cells, dtype=wp.int32, device=device)
        model.cell_free = wp.empty(cells, dtype=t.real, device=device)
        model.list_reach = wp.empty(lists, dtype=t.real, device=device)
        model.list_face = wp.empty((lists, IN_CELL), dtype=wp.int32, device=device)
        if not there:
            return
        # Warp parses functions as they are made: not for a CPU.
        from warpcontact.kernels import fill_cells

        used = wp.zeros(len(grids), dtype=wp.int32, device=device)
        for patch, grid in enumerate(grids):
            if grid is not None:
                own = used[patch : patch + 1]
                inputs = [model, patch, grid.reach, first_list[patch], grid.lists, own]
                wp.launch(fill_cells.kernel(t.real), grid.cells, inputs, device=device)

    layout.other("surfaces", sum(grid.bytes for grid in there), make)
