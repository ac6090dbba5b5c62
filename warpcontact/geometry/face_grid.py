"""Grids about the meshes that points touch: where they lie, how fine they are, and what they take."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.algebra.vectors import bounds
from warpcontact.kernels.narrowphase.face_grid import LIST_ALIGNMENT, LIST_STRIDE
from warpcontact.kernels.types import SIDE_KNOWN_NOWHERE
from warpcontact.storage.allocation_plan import AllocationPlan

if TYPE_CHECKING:
    from warpcontact.geometry.query_mesh import QueryMesh, QueryMeshes

# Size of a cell, as part of a usual edge: the finest first, the coarsest last. Measured.
FINEST, COARSEST = 0.25, 1.25
# Cells beside those near the patch, where there is room for them.
MARGIN_CELLS = 8.0
# Spheres that come to touch may be so much larger later, by their parameters; or so, where there is less room.
RADIUS_GROWTHS = (2.0, 1.25)
# Room for the faces of a list on average, and so many more times the area of a cell in squares of a usual edge:
# measured. Where it runs out, cells have none.
LIST_BASE, LIST_PER_AREA = 4.5, 11.0
# Faces about a point from which on there are too many to tell them apart.
MAX_CANDIDATES = 120
# What the cells of a patch may take, its lists, and all that of all patches [bytes].
CELL_BYTES, LIST_BYTES, MAX_BYTES = 384 * 2**20, 640 * 2**20, 1024 * 2**20


@dataclass(frozen=True)
class FaceGrid:
    """A grid about a patch, in the mesh's frame and unit.

    Attributes:
        origin: Its lowest corner (3,).
        counts: Cells along the axes.
        size: Size of a cell.
        margin: From its boundary to the patch.
        places: Room for the faces that its cells list.
        radius: How far points on the outer side are that may come to touch.
        bytes: What it takes.
    """

    origin: NDArray[np.float64]
    counts: tuple[int, int, int]
    size: float
    margin: float
    places: int
    radius: float
    bytes: int

    @property
    def cells(self) -> int:
        """How many there are."""
        return int(np.prod(self.counts))


def make_grids(made: "QueryMeshes", device: wp.Device, t: SimpleNamespace) -> list[FaceGrid] | None:
    """Returns the grids about all patches; ``None`` where not all have one, or nothing is gained.

    On a CPU a search waits for little. Points beside a surface of several sheets, and those that are swept, are
    better remembered.
    """
    if not device.is_cuda or any(contact.swept for contact in made.first_of_contact):
        return None
    grids: list[FaceGrid] = []
    for query_mesh, radius in zip(made.query_meshes, made.max_radii(), strict=True):
        grid = make_grid(query_mesh, float(radius), t)
        if grid is None:
            return None
        grids.append(grid)
        # A list is told by a number.
        places = sum(one.places for one in grids)
        if sum(one.bytes for one in grids) > MAX_BYTES or places // LIST_ALIGNMENT * LIST_STRIDE >= 2**31:
            return None
    return grids or None


def make_grid(query_mesh: "QueryMesh", radius: float, t: SimpleNamespace) -> FaceGrid | None:
    """Returns the grid about a patch; ``None`` where it would take too much, or help too little.

    Args:
        query_mesh: The patch.
        radius: Radius of the largest sphere that touches it, in the unit of the mesh.
        t: The structs of kernels.
    """
    if query_mesh.side_region.kind == SIDE_KNOWN_NOWHERE:
        return None
    corner = query_mesh.corner
    low, high = bounds(corner)
    of_cell = wp.types.type_size_in_bytes(t.Cell)
    size = FINEST * query_mesh.edge
    while size <= COARSEST * query_mesh.edge:
        # Faces that may be nearest before any other is held against them lie in a disk about the point.
        crowd = np.pi * size * (2.0 * radius + size) * len(corner) / query_mesh.area
        if crowd > MAX_CANDIDATES:
            return None
        list_size = LIST_BASE + LIST_PER_AREA * (size / query_mesh.edge) ** 2
        # Cells beyond those that have a list tell how far it is.
        for radius_growth, margin_size in product(
            RADIUS_GROWTHS, (MARGIN_CELLS, MARGIN_CELLS / 2.0, MARGIN_CELLS / 4.0, 1.0)
        ):
            far = radius_growth * radius
            margin = far + query_mesh.skin + margin_size * size
            counts = np.ceil((high - low + 2.0 * margin) / size)
            cells = float(np.prod(counts))
            # Cells that have one lie within this of the area, a third more about a bend or beside a rim.
            height = far + 2.0 * query_mesh.skin + 3.0 * size
            lists = min(1.35 * query_mesh.area * height / size**3 + 1000.0, cells)
            places = LIST_ALIGNMENT * int(list_size * lists / LIST_ALIGNMENT)
            if cells * of_cell <= CELL_BYTES and 4 * places <= LIST_BYTES:
                x, y, z = counts.astype(int).tolist()
                return FaceGrid(
                    low - margin, (x, y, z), size, margin, places, far, int(cells) * of_cell + 4 * places
                )
        size *= 1.1
    return None


def declare_grids(
    grids: Sequence[FaceGrid] | None, query_meshes: int, model: Any, layout: AllocationPlan, t: SimpleNamespace
) -> None:
    """Declares the grids of the patches of ``model``, to be filled when they are made."""
    rows = grids or [FaceGrid(np.zeros(3), (0, 0, 0), 1.0, 0.0, 0, 0.0, 0)] * query_meshes
    first_cell = np.cumsum([0] + [grid.cells for grid in rows]).tolist()
    first_place = np.cumsum([0] + [grid.places for grid in rows]).tolist()
    counts = [(*grid.counts, start if grid.cells else -1) for grid, start in zip(rows, first_cell, strict=False)]
    layout.constant("surfaces", model, "query_mesh_grid", np.array(counts).reshape(-1, 4), wp.vec4i)
    origins = np.array([grid.origin for grid in rows]).reshape(-1, 3)
    layout.constant("surfaces", model, "query_mesh_grid_origin", origins, t.vec3)
    layout.constant("surfaces", model, "query_mesh_cell_size", [grid.size for grid in rows], t.real)
    # Rounding of the boundary, which is of single precision, takes none of it.
    margins = [grid.margin * (1.0 - 1e-4) - 1e-6 * float(np.abs(grid.origin).max()) for grid in rows]
    layout.constant("surfaces", model, "query_mesh_grid_margin", margins, t.real)

    def make(_: int) -> None:
        device = layout.device
        model.cells = wp.empty(first_cell[-1], dtype=t.Cell, device=device)
        model.cell_face = wp.empty(first_place[-1], dtype=wp.int32, device=device)
        if grids is None:
            return
        # Warp parses functions as they are made: only where there are any.
        from warpcontact.kernels.narrowphase import fill_face_grid

        used = wp.zeros(len(grids), dtype=wp.int32, device=device)
        for query_mesh, grid in enumerate(grids):
            own = used[query_mesh : query_mesh + 1]
            inputs = [model, query_mesh, grid.radius, first_place[query_mesh], grid.places, own]
            wp.launch(fill_face_grid.kernel(t.real), grid.cells, inputs, device=device)

    layout.custom("surfaces", sum(grid.bytes for grid in rows), make)
