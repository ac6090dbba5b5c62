"""What the closest-point search reads: meshes, and the pseudonormals, activity and boundaries of their features.

The angle-weighted pseudonormal of the feature that is nearest to a point tells the side of the point without
error (Bærentzen & Aanæs, IEEE TVCG 11 (2005) 243); a face normal, or Warp's own sign, does not.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.algebra.vectors import cross, dot, norm
from warpcontact.geometry.bvh import FaceBvh, build_bvh, declare_bvhs
from warpcontact.geometry.face_grid import FaceGrid, declare_grids
from warpcontact.geometry.side_regions import SideRegion, side_region_of
from warpcontact.kernels.lowlevel.simd import WIDTH
from warpcontact.kernels.types import FEATURE_ACTIVE, FEATURE_BOUNDARY, FEATURE_COUNT
from warpcontact.meshes import Mesh
from warpcontact.meshes.examine import SLIVER_LIMIT
from warpcontact.meshes.topology import angles, area_vectors, directions, slenderness
from warpcontact.scene.scene import Contact
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.validation.checks import Array

# Warp's queries skip triangles slimmer than the limit, which they compute in float32.
MIN_SLENDERNESS = 1.2 * SLIVER_LIMIT
# Of the length of a usual edge: a list of few faces that serves for many steps.
SKIN = 0.35
# Faces that are remembered of a contact on a CPU; measured. More last longer, but take more of a cache.
MIN_CACHED_FACES, MAX_CACHED_FACES = 16, 48
# Faces of a mesh that, with its tree, is larger than what cores have of caches; measured.
LARGE_MESH_FACES = 150_000


@dataclass(frozen=True)
class QueryMesh:
    """A set of faces to search, with its tables. Features: the face, edges 0-1, 1-2, 2-0, corners 0, 1, 2."""

    corner: NDArray[np.float64]  # (F, 3, 3), in the mesh's axes and unit, from the centre of the surface
    normal: NDArray[np.float64]  # (F, 7, 3) unit pseudonormals
    flags: NDArray[np.uint8]  # (F, 7) FEATURE_* bits
    neighbor: NDArray[np.int32]  # (F, 3) 3 × face + edge across each edge; −1: none, or not one alone
    edge: float  # length of a usual edge
    area: float  # of all faces together
    side_region: SideRegion

    @cached_property
    def bvh(self) -> FaceBvh:
        """The tree that is searched on a CPU."""
        return build_bvh(self.corner, self.normal[:, 0])

    @property
    def skin(self) -> float:
        """How much farther faces are remembered than the nearest."""
        return SKIN * self.edge

    def faces_within(self, radius: float) -> float:
        """Returns about how many faces lie within ``radius``, in the unit of the mesh, of one of them."""
        disk = min(radius / np.sqrt(self.area), 1.0)
        return max(1.0, min(np.pi * disk**2, 1.0) * len(self.corner))


def make_query_mesh(mesh: Mesh, active: NDArray[np.bool_], centre: Array, *, only_active: bool) -> QueryMesh:
    """Returns the tables of a mesh, or of its active part as an open surface of its own.

    Args:
        mesh: The mesh; coincident vertices count as one.
        active: Mask (F,) of the faces that can touch.
        centre: Origin of the tables in the mesh's frame.
        only_active: Whether to leave the other faces out.
    """
    faces = mesh.faces[active] if only_active else mesh.faces
    active = np.ones(len(faces), dtype=bool) if only_active else active
    corner = mesh.vertices[faces] - centre
    welded = mesh.welded[faces]

    areas = area_vectors(corner)
    twice_area = norm(areas)[:, None]
    face_normal = areas / twice_area

    # Edges: both faces meet them with the angle π, so the weights are equal.
    ends = np.stack([welded, np.roll(welded, -1, axis=1)], axis=2)  # (F, 3, 2)
    count = int(welded.max()) + 1
    low, high = (end(ends[..., 0], ends[..., 1]).astype(np.int64) for end in (np.minimum, np.maximum))
    _, edge = np.unique(count * low + high, return_inverse=True)  # many times as fast as of rows
    edge = edge.reshape(-1, 3)
    face_count = np.bincount(edge.ravel())
    edge_sum = _sum_over(edge, np.repeat(face_normal[:, None], 3, axis=1), len(face_count))
    boundary = face_count == 1
    edge_active = np.bincount(edge.ravel(), weights=np.repeat(active, 3)) > 0

    # Corners: weighted with the angle of the face there.
    corner_sum = _sum_over(welded, angles(corner)[..., None] * face_normal[:, None], count)
    on_boundary = np.zeros(count, dtype=bool)
    on_boundary[ends[boundary[edge]].ravel()] = True
    corner_active = np.bincount(welded.ravel(), weights=np.repeat(active, 3), minlength=count) > 0

    normal = np.concatenate([face_normal[:, None], edge_sum[edge], corner_sum[welded]], axis=1)
    normal = directions(normal, face_normal[:, None])

    is_active = np.concatenate([active[:, None], edge_active[edge], corner_active[welded]], axis=1)
    is_boundary = np.concatenate(
        [np.zeros((len(faces), 1), dtype=bool), boundary[edge], on_boundary[welded]], axis=1
    )
    flags = FEATURE_ACTIVE * is_active.astype(np.uint8) + FEATURE_BOUNDARY * is_boundary.astype(np.uint8)
    assert normal.shape == (len(faces), FEATURE_COUNT, 3)
    neighbor = _neighbors(edge, ends)
    whole = len(faces) == len(mesh.faces)
    return QueryMesh(
        corner=corner,
        normal=normal,
        flags=flags,
        neighbor=neighbor,
        edge=_median(norm(np.roll(corner, -1, axis=1) - corner).ravel()),
        area=0.5 * float(twice_area.sum()),
        side_region=side_region_of(mesh, corner, ends, neighbor, whole=whole),
    )


#: Patches by their mesh, its active faces, the origin of the tables, and whether the other faces are left out.
QueryMeshCache = dict[tuple[Mesh, bytes, bytes, bool], QueryMesh]


@dataclass(frozen=True)
class QueryMeshes:
    """The patches of all surfaces; contacts that search the same faces share one.

    Attributes:
        query_meshes: All of them, one for each mesh of a surface that is searched in one way.
        surfaces: Index of the surface of each.
        search_meshes: For each, the number of its mesh for queries: patches that differ in what is active share one.
        corners: Of the faces (F, 3, 3) of each of these meshes, in float32.
        first_of_contact: First patch of each contact.
    """

    query_meshes: list[QueryMesh]
    surfaces: list[int]
    search_meshes: list[int]
    corners: list[NDArray[np.float32]]
    first_of_contact: dict[Contact, int]

    def max_radii(self) -> NDArray[np.float64]:
        """Returns the radius of the largest sphere that touches each patch, in the unit of its mesh."""
        radius = np.zeros(len(self.query_meshes))
        for contact, first in self.first_of_contact.items():
            own = slice(first, first + len(contact.surface.meshes))
            radius[own] = np.maximum(radius[own], contact.radius.max() / contact.surface.scale.min())
        return radius

    def side_regions(self) -> dict[Contact, list[SideRegion]]:
        """Returns where the surface of each contact keeps its sides apart, mesh by mesh."""
        return {
            contact: [
                query_mesh.side_region
                for query_mesh in self.query_meshes[first : first + len(contact.surface.meshes)]
            ]
            for contact, first in self.first_of_contact.items()
        }

    @property
    def face_count(self) -> int:
        """Number of rows of the tables of faces."""
        return sum(len(query_mesh.corner) for query_mesh in self.query_meshes)

    def faces_read(self) -> int:
        """Returns about how many faces an environment reads, in some steps, of meshes too large for caches.

        Those around each body as far as its points and their radii reach, as they are in the scene.
        """
        face_total = 0.0
        for contact, first in self.first_of_contact.items():
            points = contact.points
            scale = 1.0 if points.surface is None else float(points.surface.scale.max())
            radius = float(contact.radius.max())
            if not points.spread:
                radius += 0.5 * scale * float(np.linalg.norm(np.ptp(points.positions, axis=0)))
            # Divided first: squares of what is accepted may overflow.
            radius /= float(contact.surface.scale.min())
            query_meshes = self.query_meshes[first : first + len(contact.surface.meshes)]
            large = [query_mesh for query_mesh in query_meshes if len(query_mesh.corner) > LARGE_MESH_FACES]
            # Each environment has one mesh of a surface.
            face_total += contact.set_count * max(
                (query_mesh.faces_within(radius) for query_mesh in large), default=0.0
            )
        return round(face_total)

    def cached_face_count(self) -> int:
        """Returns how many faces are worth remembering of each contact on a CPU: of that with the most.

        Those that are farther from the middle of a sphere, where it touches a plane, than that by no more
        than the skin lie in a disk. As many more as fill up several at once.
        """
        max_count = float(MIN_CACHED_FACES)
        for query_mesh, radius in zip(self.query_meshes, self.max_radii(), strict=True):
            disk = np.sqrt(query_mesh.skin * (2.0 * radius + query_mesh.skin)) + 0.5 * query_mesh.edge
            max_count = max(max_count, np.pi * disk**2 * len(query_mesh.corner) / query_mesh.area)
        return WIDTH * math.ceil(min(max_count, MAX_CACHED_FACES) / WIDTH)


def make_query_meshes(contacts: list[Contact], mesh_cache: QueryMeshCache | None = None) -> QueryMeshes:
    """Returns the patches of ``contacts``.

    Args:
        contacts: The contacts.
        mesh_cache: Patches that are there already; those that are made here are added.

    Raises:
        ValueError: If a face has no area left in float32, in which queries search.
    """
    mesh_cache = {} if mesh_cache is None else mesh_cache
    rows: dict[tuple[int, bool], int] = {}
    numbers: dict[tuple[Any, ...], int] = {}
    meshes_of_contacts = QueryMeshes([], [], [], [], {})
    for contact in contacts:
        surface = contact.surface
        only_active = contact.search == "active" and not all(active.all() for active in surface.active)
        key = (surface.index, only_active)
        if key not in rows:
            rows[key] = len(meshes_of_contacts.query_meshes)
            for mesh, active in zip(surface.meshes, surface.active, strict=True):
                mesh_key = (mesh, active.tobytes(), surface.centre.tobytes(), only_active)
                query_mesh = mesh_cache.get(mesh_key)
                if query_mesh is None:
                    query_mesh = mesh_cache[mesh_key] = make_query_mesh(
                        mesh, active, surface.centre, only_active=only_active
                    )
                meshes_of_contacts.query_meshes.append(query_mesh)
                meshes_of_contacts.surfaces.append(surface.index)
                # Meshes that differ in what is active alone are searched as one.
                faces = (id(mesh), active.tobytes() if only_active else b"", surface.centre.tobytes())
                if faces not in numbers:
                    numbers[faces] = len(meshes_of_contacts.corners)
                    face_numbers = np.flatnonzero(active) if only_active else np.arange(len(active))
                    meshes_of_contacts.corners.append(_search_corners(surface.name, query_mesh, face_numbers))
                meshes_of_contacts.search_meshes.append(numbers[faces])
        meshes_of_contacts.first_of_contact[contact] = rows[key]
    return meshes_of_contacts


def upload_query_meshes(
    meshes_of_contacts: QueryMeshes,
    grids: list[FaceGrid] | None,
    model: Any,
    layout: AllocationPlan,
    t: SimpleNamespace,
) -> list[wp.Mesh]:
    """Declares the patches of ``model``, with cells if there are ``grids``.

    Returns:
        The meshes, a list that is filled when they are made: a kernel holds only their ids, so somebody has to
        keep them.
    """
    query_meshes = meshes_of_contacts.query_meshes
    meshes: list[wp.Mesh] = []

    def make_meshes(_: int) -> None:
        meshes.extend(_search_mesh(own, layout.device) for own in meshes_of_contacts.corners)
        ids = np.array([meshes[mesh].id for mesh in meshes_of_contacts.search_meshes], dtype=np.uint64)
        model.query_mesh_id = wp.array(ids, dtype=wp.uint64, device=layout.device)

    mesh_bytes = sum(_mesh_bytes(len(own), layout.device) for own in meshes_of_contacts.corners)
    layout.custom("surfaces", mesh_bytes + 8 * len(meshes_of_contacts.search_meshes), make_meshes)
    starts = np.cumsum([0] + [len(query_mesh.flags) for query_mesh in query_meshes])

    def add_constant(name: str, values: Any, dtype: Any) -> None:
        layout.constant("surfaces", model, name, values, dtype)

    add_constant("query_mesh_surface", meshes_of_contacts.surfaces, wp.int32)
    add_constant("query_mesh_face_start", starts, wp.int32)
    errors = [_query_error(query_mesh) for query_mesh in query_meshes]
    add_constant("query_mesh_error", [slack for slack, _ in errors], t.real)
    add_constant("query_mesh_thin_length", [thin for _, thin in errors], t.real)
    add_constant("query_mesh_skin", [query_mesh.skin for query_mesh in query_meshes], t.real)
    add_constant("query_mesh_side_region", [query_mesh.side_region.kind for query_mesh in query_meshes], wp.int32)
    regions = [query_mesh.side_region for query_mesh in query_meshes]
    add_constant("query_mesh_wall_start", np.cumsum([0] + [len(own.offset) for own in regions]), wp.int32)
    none = np.zeros((0, 3))
    add_constant("wall_normal", np.concatenate([none, *(own.normal for own in regions)]), t.vec3)
    add_constant("wall_offset", np.concatenate([none[:, 0], *(own.offset for own in regions)]), t.real)
    if query_meshes:
        # With its normal a face is in one place of the memory, which is what a search waits for.
        shapes = [
            np.concatenate([query_mesh.corner, query_mesh.normal[:, :1]], axis=1) for query_mesh in query_meshes
        ]
        add_constant("face_corner", np.concatenate(shapes), t.vec3)
        flat = [_face_frames(query_mesh) for query_mesh in query_meshes] if grids else [np.zeros((0, 4, 3))]
        add_constant("face_frame", np.concatenate(flat), t.vec3)
        add_constant("face_normal", np.concatenate([query_mesh.normal for query_mesh in query_meshes]), t.vec3)
        add_constant("face_flags", np.concatenate([query_mesh.flags for query_mesh in query_meshes]), wp.uint8)
        shifted = [
            np.where(query_mesh.neighbor < 0, -1, query_mesh.neighbor + 3 * start)
            for query_mesh, start in zip(query_meshes, starts, strict=False)
        ]
        add_constant("face_neighbor", np.concatenate(shifted), wp.int32)
        first = [meshes_of_contacts.search_meshes.index(mesh) for mesh in range(len(meshes_of_contacts.corners))]
        own = [query_meshes[number] for number in first]
        counts = [len(query_mesh.corner) for query_mesh in own]
        declare_bvhs(
            counts, lambda: [query_mesh.bvh for query_mesh in own], meshes_of_contacts.search_meshes, model, layout
        )
        # Last, as they are filled from all of this.
        declare_grids(grids, len(query_meshes), model, layout, t)
    return meshes


def _median(values: Array) -> float:
    """Returns the median of numbers (n,), without the masked arrays that NumPy imports for that."""
    middle = [(len(values) - 1) // 2, len(values) // 2]
    return float(np.partition(values, middle)[middle].mean())


def _face_frames(query_mesh: QueryMesh) -> Array:
    """Returns the axes of the faces in their planes, and where their corners are there: ``Model.face_frame``."""
    a, b, c = query_mesh.corner.swapaxes(0, 1)
    edges = np.roll(query_mesh.corner, -1, axis=1) - query_mesh.corner
    squares = dot(edges, edges)
    length = np.sqrt(squares[:, 0])
    along = (b - a) / length[:, None]
    across = cross(query_mesh.normal[:, 0], along)
    last = [dot(c - a, axis) for axis in (along, across)]
    return np.stack([along, across, np.stack([length, *last], axis=1), 1.0 / squares], axis=1)


def _search_corners(
    name: str, query_mesh: QueryMesh, face_numbers: NDArray[np.integer[Any]]
) -> NDArray[np.float32]:
    """Returns the corners (F, 3, 3) that queries search; ``face_numbers`` are the numbers of the faces in their mesh."""
    # The mesh is sound in float64; only float32 can still spoil it.
    corner = query_mesh.corner.astype(np.float32)
    lost = np.flatnonzero(slenderness(corner.astype(np.float64)) < MIN_SLENDERNESS)
    if len(lost):
        far = np.abs(query_mesh.corner[lost[0]]).max()
        raise ValueError(
            f"{name}: face {face_numbers[lost[0]]} has no area left in float32, in which surfaces are searched "
            f"({len(lost)} such faces): it is too slim, or too small for coordinates of up to {far:g} m. Remove "
            "it, or make parts that lie far apart surfaces of their own"
        )
    return corner


def _search_mesh(corner: NDArray[np.float32], device: wp.Device) -> wp.Mesh:
    """Returns the mesh that queries search."""
    return wp.Mesh(
        points=wp.array(corner.reshape(-1, 3), dtype=wp.vec3f, device=device),
        indices=wp.array(np.arange(3 * len(corner), dtype=np.int32), dtype=wp.int32, device=device),
        bvh_constructor="sah",  # the same tree on every device
    )


def _mesh_bytes(faces: int, device: wp.Device) -> int:
    """Returns what such a mesh takes: corners and their numbers, then what Warp adds, boxes and tree."""
    corners, boxes = 3 * (12 + 4) * faces, 2 * 12 * faces
    # Of each node two corners with a number, its parent and, on a GPU, how many were visited; numbers of faces.
    nodes = max(0, 2 * faces - 1)
    return corners + boxes + nodes * (2 * 16 + 4 + 4 * device.is_cuda) + 4 * faces


def _sum_over(index: NDArray[np.integer[Any]], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Sums vectors ``values`` (F, 3, 3) into ``count`` rows by ``index`` (F, 3)."""
    return np.stack(
        [np.bincount(index.ravel(), weights=values[..., k].ravel(), minlength=count) for k in range(3)],
        axis=1,
    )


def _neighbors(edge: NDArray[np.integer[Any]], ends: NDArray[np.integer[Any]]) -> NDArray[np.int32]:
    """Returns what lies across each edge: 3 × face + edge, −1 where no one face of the same winding does.

    Args:
        edge: Number of each edge (F, 3).
        ends: Its ends in the order of the face (F, 3, 2).
    """
    flat = edge.ravel()
    order = np.argsort(flat, kind="stable")
    first = np.flatnonzero(np.diff(flat[order], prepend=-1))
    size = np.diff(first, append=len(flat))
    pairs = first[size == 2]
    a, b = order[pairs], order[pairs + 1]
    # Neighbours of one winding run along their edge in opposite directions.
    start = ends.reshape(-1, 2)[:, 0]
    opposite = start[a] != start[b]
    neighbor = np.full(len(flat), -1, dtype=np.int32)
    neighbor[a[opposite]], neighbor[b[opposite]] = b[opposite], a[opposite]
    return neighbor.reshape(edge.shape)


def _query_error(query_mesh: QueryMesh) -> tuple[float, float]:
    """Returns how far the float32 query may be off, and the longest edge of the faces where this is not rounding.

    The query's areas lose ε (length/height)² of the length along a triangle, and at most its height in distance.
    """
    corner = query_mesh.corner
    edges = np.roll(corner, -1, axis=1) - corner
    longest = norm(edges).max(axis=1)
    height = norm(cross(edges[:, 0], edges[:, 1])) / longest
    epsilon = float(np.finfo(np.float32).eps)
    lost = epsilon * longest * (longest / height) ** 2
    rounding = 16.0 * epsilon * (np.abs(corner).max() + longest)
    slack = float((np.minimum(lost, height) + rounding).max())
    return slack, float(longest[lost > rounding].max(initial=0.0))
