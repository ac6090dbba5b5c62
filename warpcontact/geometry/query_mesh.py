"""Tables for closest-point queries: meshes, and pseudonormals, active flags and boundary flags of their features.

The sign of the distance is determined by the angle-weighted pseudonormal of the closest feature, which is exact
(Bærentzen & Aanæs, IEEE TVCG 11 (2005) 243). Face normals and Warp's sign are not. Kernels: ``kernels/narrowphase``.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.algebra.vectors import cross, dot, norm
from warpcontact.geometry.bvh import FaceBvh, build_bvh, declare_bvhs
from warpcontact.geometry.face_grid import FaceGrid, declare_grids
from warpcontact.geometry.side_regions import SideRegion, side_region_of
from warpcontact.kernels.lowlevel.simd import WIDTH
from warpcontact.kernels.types import FEATURE_ACTIVE, FEATURE_BOUNDARY, FEATURE_COUNT, Structs
from warpcontact.meshes import Mesh
from warpcontact.meshes.examine import SLIVER_LIMIT
from warpcontact.meshes.topology import angles, area_vectors, directions, slenderness
from warpcontact.scene.elements import Contact
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.validation.checks import Array

# Warp's queries skip triangles slimmer than the limit, evaluated in float32.
MIN_SLENDERNESS = 1.2 * SLIVER_LIMIT
# Skin of the face cache relative to the median edge length: few faces, valid for many steps.
SKIN = 0.35
# Number of cached faces of a contact on a CPU; measured. More faces are valid longer, but need more CPU cache.
MIN_CACHED_FACES, MAX_CACHED_FACES = 16, 48
# Number of faces above which a mesh and its BVH do not fit into the CPU caches; measured.
LARGE_MESH_FACES = 150_000


@dataclass(frozen=True)
class QueryMesh:
    """Faces to search, with their tables. Features: the face, edges 0-1, 1-2, 2-0, vertices 0, 1, 2."""

    corner: NDArray[np.float64]  # (F, 3, 3) vertices, axes and unit of the mesh, relative to ``Surface.centre``
    normal: NDArray[np.float64]  # (F, 7, 3) unit pseudonormals
    flags: NDArray[np.uint8]  # (F, 7) FEATURE_* bits
    neighbor: NDArray[np.int32]  # (F, 3) 3 × face + edge across each edge; −1: none, or several
    edge: float  # median edge length
    area: float  # total area of the faces
    side_region: SideRegion

    @cached_property
    def bvh(self) -> FaceBvh:
        """The BVH that is searched on a CPU."""
        return build_bvh(self.corner, self.normal[:, 0])

    @property
    def skin(self) -> float:
        """Skin of the face cache: faces up to this much farther than the nearest one are cached."""
        return SKIN * self.edge

    def faces_within(self, radius: float) -> float:
        """Returns an estimate of the number of faces within ``radius`` (unit of the mesh) of a face."""
        disk = min(radius / np.sqrt(self.area), 1.0)
        return max(1.0, min(np.pi * disk**2, 1.0) * len(self.corner))


def make_query_mesh(mesh: Mesh, active: NDArray[np.bool_], centre: Array, *, only_active: bool) -> QueryMesh:
    """Returns the query mesh of a mesh, or of its active faces as a separate open surface.

    Args:
        mesh: The mesh; coincident vertices count as one.
        active: Mask (F,) of the active faces.
        centre: Origin of the tables in the mesh frame.
        only_active: Whether to omit the other faces.
    """
    faces = mesh.faces[active] if only_active else mesh.faces
    active = np.ones(len(faces), dtype=bool) if only_active else active
    corner = mesh.vertices[faces] - centre
    welded = mesh.welded[faces]

    areas = area_vectors(corner)
    twice_area = norm(areas)[:, None]
    face_normal = areas / twice_area

    # Edges: both faces have the angle π there, so the weights are equal.
    ends = np.stack([welded, np.roll(welded, -1, axis=1)], axis=2)  # (F, 3, 2)
    count = int(welded.max()) + 1
    low, high = (end(ends[..., 0], ends[..., 1]).astype(np.int64) for end in (np.minimum, np.maximum))
    _, edge = np.unique(count * low + high, return_inverse=True)  # scalar keys are many times faster than rows
    edge = edge.reshape(-1, 3)
    face_count = np.bincount(edge.ravel())
    edge_sum = _sum_over(edge, np.repeat(face_normal[:, None], 3, axis=1), len(face_count))
    boundary = face_count == 1
    edge_active = np.bincount(edge.ravel(), weights=np.repeat(active, 3)) > 0

    # Vertices: weighted with the angle of the face.
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


#: Query meshes by mesh, active faces, origin of the tables, and ``only_active``.
QueryMeshCache = dict[tuple[Mesh, bytes, bytes, bool], QueryMesh]


@dataclass(frozen=True)
class QueryMeshes:
    """The query meshes of all surfaces; contacts that search the same faces share one.

    Attributes:
        query_meshes: The query meshes, one per mesh of a surface and value of ``only_active``.
        surfaces: Index of the surface of each query mesh.
        search_meshes: Number of the search mesh of each query mesh. Query meshes that differ only in active flags
            share a search mesh.
        corners: Vertices of the faces (F, 3, 3) of each search mesh, float32.
        first_of_contact: First query mesh of each contact.
    """

    query_meshes: list[QueryMesh]
    surfaces: list[int]
    search_meshes: list[int]
    corners: list[NDArray[np.float32]]
    first_of_contact: dict[Contact, int]

    def max_radii(self) -> NDArray[np.float64]:
        """Returns the largest sphere radius of contacts with each query mesh, in the unit of its mesh."""
        radius = np.zeros(len(self.query_meshes))
        for contact, first in self.first_of_contact.items():
            own = slice(first, first + len(contact.surface.meshes))
            radius[own] = np.maximum(radius[own], contact.radius.max() / contact.surface.scale.min())
        return radius

    def side_regions(self) -> dict[Contact, list[SideRegion]]:
        """Returns the side regions of the surface of each contact, one per mesh."""
        return {
            contact: [
                query_mesh.side_region
                for query_mesh in self.query_meshes[first : first + len(contact.surface.meshes)]
            ]
            for contact, first in self.first_of_contact.items()
        }

    @property
    def face_count(self) -> int:
        """Total number of faces of all query meshes."""
        return sum(len(query_mesh.corner) for query_mesh in self.query_meshes)

    def faces_read(self) -> int:
        """Returns an estimate of the number of faces that an environment reads from meshes too large for caches.

        Counted are faces within the extent of the points and radii of each contact, as in the scene.
        """
        face_total = 0.0
        for contact, first in self.first_of_contact.items():
            points = contact.points
            scale = 1.0 if points.surface is None else float(points.surface.scale.max())
            radius = float(contact.radius.max())
            if not points.spread:
                radius += 0.5 * scale * float(np.linalg.norm(np.ptp(points.positions, axis=0)))
            # Divide before squaring, because squares of valid radii may overflow.
            radius /= float(contact.surface.scale.min())
            query_meshes = self.query_meshes[first : first + len(contact.surface.meshes)]
            large = [query_mesh for query_mesh in query_meshes if len(query_mesh.corner) > LARGE_MESH_FACES]
            # Each environment has one mesh of a surface.
            face_total += contact.set_count * max(
                (query_mesh.faces_within(radius) for query_mesh in large), default=0.0
            )
        return round(face_total)

    def cached_face_count(self) -> int:
        """Returns the number of cached faces per contact on a CPU: the maximum over all contacts.

        For a sphere on a plane, the faces within radius + skin of its center lie in a disk. The number of faces in
        this disk is rounded up to a multiple of the SIMD width.
        """
        max_count = float(MIN_CACHED_FACES)
        for query_mesh, radius in zip(self.query_meshes, self.max_radii(), strict=True):
            disk = np.sqrt(query_mesh.skin * (2.0 * radius + query_mesh.skin)) + 0.5 * query_mesh.edge
            max_count = max(max_count, np.pi * disk**2 * len(query_mesh.corner) / query_mesh.area)
        return WIDTH * math.ceil(min(max_count, MAX_CACHED_FACES) / WIDTH)


def make_query_meshes(contacts: list[Contact], mesh_cache: QueryMeshCache | None = None) -> QueryMeshes:
    """Returns the query meshes of ``contacts``.

    Args:
        contacts: The contacts.
        mesh_cache: Existing query meshes; new ones are added.

    Raises:
        ValueError: If a face is degenerate in float32, the precision of the search.
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
                # Query meshes that differ only in active flags share a search mesh.
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
    t: Structs,
) -> list[wp.Mesh]:
    """Declares the query meshes of ``model``, with face grids if there are ``grids``.

    Returns:
        The Warp meshes, a list that is filled on allocation. The caller must keep it alive, because kernels store
        only mesh ids.
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
        # Vertices and normal of a face are contiguous, because the search is limited by memory latency.
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
        # Last, because the grids are filled from these arrays.
        declare_grids(grids, len(query_meshes), model, layout, t)
    return meshes


def _median(values: Array) -> float:
    """Returns the median of numbers (n,); ``np.median`` would import ``numpy.ma``."""
    middle = [(len(values) - 1) // 2, len(values) // 2]
    return float(np.partition(values, middle)[middle].mean())


def _face_frames(query_mesh: QueryMesh) -> Array:
    """Returns in-plane axes of the faces and in-plane coordinates of their vertices, see ``Model.face_frame``."""
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
    """Returns the vertices (F, 3, 3) of a search mesh in float32; ``face_numbers`` are those of the mesh."""
    # The mesh is valid in float64, but rounding to float32 can make faces degenerate.
    corner = query_mesh.corner.astype(np.float32)
    lost = np.flatnonzero(slenderness(corner.astype(np.float64)) < MIN_SLENDERNESS)
    if len(lost):
        far = np.abs(query_mesh.corner[lost[0]]).max()
        raise ValueError(
            f"{name}: face {face_numbers[lost[0]]} is degenerate in float32, the precision of the search "
            f"({len(lost)} such faces): it is too slim, or too small for coordinates of up to {far:g} m. Remove "
            "it, or split distant parts of the mesh into separate surfaces"
        )
    return corner


def _search_mesh(corner: NDArray[np.float32], device: wp.Device) -> wp.Mesh:
    """Returns the Warp mesh for queries."""
    return wp.Mesh(
        points=wp.array(corner.reshape(-1, 3), dtype=wp.vec3f, device=device),
        indices=wp.array(np.arange(3 * len(corner), dtype=np.int32), dtype=wp.int32, device=device),
        bvh_constructor="sah",  # gives the same BVH on every device
    )


def _mesh_bytes(faces: int, device: wp.Device) -> int:
    """Returns the bytes of such a mesh: vertices and indices, and Warp's bounding boxes and BVH."""
    corners, boxes = 3 * (12 + 4) * faces, 2 * 12 * faces
    # Per BVH node: two corners with an index, the parent and, on a GPU, a visit counter; then face indices.
    nodes = max(0, 2 * faces - 1)
    return corners + boxes + nodes * (2 * 16 + 4 + 4 * device.is_cuda) + 4 * faces


def _sum_over(index: NDArray[np.integer[Any]], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Sums vectors ``values`` (F, 3, 3) into ``count`` rows by ``index`` (F, 3)."""
    return np.stack(
        [np.bincount(index.ravel(), weights=values[..., k].ravel(), minlength=count) for k in range(3)],
        axis=1,
    )


def _neighbors(edge: NDArray[np.integer[Any]], ends: NDArray[np.integer[Any]]) -> NDArray[np.int32]:
    """Returns the neighbor across each edge, 3 × face + edge; −1 unless there is exactly one, with equal orientation.

    Args:
        edge: Number of each edge (F, 3).
        ends: Vertices of each edge in the order of the face (F, 3, 2).
    """
    flat = edge.ravel()
    order = np.argsort(flat, kind="stable")
    first = np.flatnonzero(np.diff(flat[order], prepend=-1))
    size = np.diff(first, append=len(flat))
    pairs = first[size == 2]
    a, b = order[pairs], order[pairs + 1]
    # Faces with the same orientation traverse their common edge in opposite directions.
    start = ends.reshape(-1, 2)[:, 0]
    opposite = start[a] != start[b]
    neighbor = np.full(len(flat), -1, dtype=np.int32)
    neighbor[a[opposite]], neighbor[b[opposite]] = b[opposite], a[opposite]
    return neighbor.reshape(edge.shape)


def _query_error(query_mesh: QueryMesh) -> tuple[float, float]:
    """Returns the distance error of float32 queries, and the longest edge of faces whose error exceeds rounding.

    The areas in Warp's query have the error ε (length/height)² · length along a triangle; the error in distance is at
    most the height of the triangle.
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
