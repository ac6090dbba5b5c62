"""Face grids: size and resolution of the uniform grids around query meshes, used on GPUs.

Each cell stores its clearance and the faces that may be nearest to a point in it. The grids are filled by
``kernels/narrowphase/face_grid.py``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.algebra.vectors import bounds
from warpcontact.kernels.narrowphase.face_grid import LIST_ALIGNMENT, LIST_STRIDE
from warpcontact.kernels.types import SIDE_KNOWN_NOWHERE, Structs
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.system.launches import launch_kernel

if TYPE_CHECKING:
    from warpcontact.geometry.query_mesh import QueryMesh, QueryMeshes

# Cell size relative to the median edge length: smallest and largest. Measured.
FINEST, COARSEST = 0.25, 1.25
# Width of the margin around the mesh, in cells, if memory permits.
MARGIN_CELLS = 8.0
# Growth of sphere radii (parameters can change) that the grid allows for; the second if memory is short.
RADIUS_GROWTHS = (2.0, 1.25)
# Average length of a face list: LIST_BASE + LIST_PER_AREA · (cell size/median edge length)². Measured. If the memory
# for lists is full, cells have no list.
LIST_BASE, LIST_PER_AREA = 4.5, 11.0
# Maximum number of candidate faces around a point for which a grid is useful.
MAX_CANDIDATES = 120
# Maximum size of the cells of a query mesh, of its lists, and of all grids together [bytes].
CELL_BYTES, LIST_BYTES, MAX_BYTES = 384 * 2**20, 640 * 2**20, 1024 * 2**20


@dataclass(frozen=True)
class FaceGrid:
    """A grid around a query mesh, in the frame and unit of the mesh.

    Attributes:
        origin: Corner with the lowest coordinates (3,).
        counts: Number of cells along each axis.
        size: Edge length of a cell.
        margin: Distance from the boundary of the grid to the mesh.
        places: Capacity of the face lists of all cells, in faces.
        radius: Distance from the mesh within which points on the outer side can be in contact.
        bytes: Memory [bytes].
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
        """Number of cells."""
        return int(np.prod(self.counts))


def make_grids(made: "QueryMeshes", device: wp.Device, t: Structs) -> list[FaceGrid] | None:
    """Returns the grids of all query meshes; ``None`` if one cannot have a grid, or grids are not faster.

    Grids are not used on a CPU, for swept contacts, and for meshes without a side region; the face cache is then used.
    """
    if not device.is_cuda or any(contact.swept for contact in made.first_of_contact):
        return None
    grids: list[FaceGrid] = []
    for query_mesh, radius in zip(made.query_meshes, made.max_radii(), strict=True):
        grid = make_grid(query_mesh, float(radius), t)
        if grid is None:
            return None
        grids.append(grid)
        # Lists are addressed by an int32.
        places = sum(one.places for one in grids)
        if sum(one.bytes for one in grids) > MAX_BYTES or places // LIST_ALIGNMENT * LIST_STRIDE >= 2**31:
            return None
    return grids or None


def make_grid(query_mesh: "QueryMesh", radius: float, t: Structs) -> FaceGrid | None:
    """Returns the grid of a query mesh; ``None`` if it would need too much memory or have too many candidates.

    Args:
        query_mesh: The query mesh.
        radius: Radius of the largest sphere in contact with it, in the unit of the mesh.
        t: Warp structs of the precision.
    """
    if query_mesh.side_region.kind == SIDE_KNOWN_NOWHERE:
        return None
    corner = query_mesh.corner
    low, high = bounds(corner)
    of_cell = wp.types.type_size_in_bytes(t.Cell)
    size = FINEST * query_mesh.edge
    while size <= COARSEST * query_mesh.edge:
        # Candidates for the nearest face lie in a disk around the point, with r² ≈ size (2 radius + size).
        crowd = np.pi * size * (2.0 * radius + size) * len(corner) / query_mesh.area
        if crowd > MAX_CANDIDATES:
            return None
        list_size = LIST_BASE + LIST_PER_AREA * (size / query_mesh.edge) ** 2
        # Cells in the outer margin have no list and store only their clearance.
        for radius_growth, margin_size in product(
            RADIUS_GROWTHS, (MARGIN_CELLS, MARGIN_CELLS / 2.0, MARGIN_CELLS / 4.0, 1.0)
        ):
            far = radius_growth * radius
            margin = far + query_mesh.skin + margin_size * size
            counts = np.ceil((high - low + 2.0 * margin) / size)
            cells = float(np.prod(counts))
            # Cells with a list lie within this height of the surface; 1/3 more at bends and along the boundary.
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
    grids: Sequence[FaceGrid] | None, query_meshes: int, model: Any, layout: AllocationPlan, t: Structs
) -> None:
    """Declares the grids of the query meshes of ``model``; they are filled when they are allocated."""
    rows = grids or [FaceGrid(np.zeros(3), (0, 0, 0), 1.0, 0.0, 0, 0.0, 0)] * query_meshes
    first_cell = np.cumsum([0] + [grid.cells for grid in rows]).tolist()
    first_place = np.cumsum([0] + [grid.places for grid in rows]).tolist()
    counts = [(*grid.counts, start if grid.cells else -1) for grid, start in zip(rows, first_cell, strict=False)]
    layout.constant("surfaces", model, "query_mesh_grid", np.array(counts).reshape(-1, 4), wp.vec4i)
    origins = np.array([grid.origin for grid in rows]).reshape(-1, 3)
    layout.constant("surfaces", model, "query_mesh_grid_origin", origins, t.vec3)
    layout.constant("surfaces", model, "query_mesh_cell_size", [grid.size for grid in rows], t.real)
    # Reduced by the rounding error of the float32 boundary of the grid.
    margins = [grid.margin * (1.0 - 1e-4) - 1e-6 * float(np.abs(grid.origin).max()) for grid in rows]
    layout.constant("surfaces", model, "query_mesh_grid_margin", margins, t.real)

    def make(_: int) -> None:
        device = layout.device
        model.cells = wp.empty(first_cell[-1], dtype=t.Cell, device=device)
        model.cell_face = wp.empty(first_place[-1], dtype=wp.int32, device=device)
        if grids is None:
            return
        # Imported on demand, because Warp parses kernel functions on import.
        from warpcontact.kernels.narrowphase.face_grid import fill_cells

        used = wp.zeros(len(grids), dtype=wp.int32, device=device)
        for query_mesh, grid in enumerate(grids):
            launch_kernel(
                fill_cells(t.real),
                grid.cells,
                device=device,
                model=model,
                query_mesh=query_mesh,
                reach=grid.radius,
                first=first_place[query_mesh],
                face_capacity=grid.places,
                used_units=used[query_mesh : query_mesh + 1],
            )

    layout.custom("surfaces", sum(grid.bytes for grid in rows), make)
