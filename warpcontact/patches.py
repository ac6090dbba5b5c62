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

from warpcontact.arrays import Layout
from warpcontact.cells import Grid, declare_grids
from warpcontact.checks import Array
from warpcontact.kernels.simd import WIDTH
from warpcontact.kernels.types import FEATURE_ACTIVE, FEATURE_BOUNDARY, FEATURE_COUNT
from warpcontact.meshes import Mesh
from warpcontact.meshes.examine import SLIVER_LIMIT
from warpcontact.meshes.topology import angles, area_vectors, directions, slenderness
from warpcontact.scene import Contact
from warpcontact.sides import Sides, sides_of
from warpcontact.tree import Tree, declare_trees, make_tree
from warpcontact.vectors import cross, dot, norm

# Warp's queries skip triangles slimmer than the limit, which they compute in float32.
SLIVER = 1.2 * SLIVER_LIMIT
# Of the length of a usual edge: a list of few faces that serves for many steps.
SKIN = 0.35
# Faces that are remembered of a contact on a CPU; measured. More last longer, but take more of a cache.
FEWEST_REMEMBERED, MOST_REMEMBERED = 16, 48
# Faces of a mesh that, with its tree, is larger than what cores have of caches; measured.
MANY_FACES = 150_000


@dataclass(frozen=True)
class Patch:
    """A set of faces to search, with its tables. Features: the face, edges 0-1, 1-2, 2-0, corners 0, 1, 2."""

    corner: NDArray[np.float64]  # (F, 3, 3), in the mesh's axes and unit, from the centre of the surface
    normal: NDArray[np.float64]  # (F, 7, 3) unit pseudonormals
    flags: NDArray[np.uint8]  # (F, 7) FEATURE_* bits
    neighbor: NDArray[np.int32]  # (F, 3) 3 × face + edge across each edge; −1: none, or not one alone
    edge: float  # length of a usual edge
    area: float  # of all faces together
    sides: Sides

    @cached_property
    def tree(self) -> Tree:
        """The tree that is searched on a CPU."""
        return make_tree(self.corner, self.normal[:, 0])

    @property
    def skin(self) -> float:
        """How much farther faces are remembered than the nearest."""
        return SKIN * self.edge

    def faces_within(self, reach: float) -> float:
        """Returns about how many faces lie within ``reach``, in the unit of the mesh, of one of them."""
        disk = min(reach / np.sqrt(self.area), 1.0)
        return max(1.0, min(np.pi * disk**2, 1.0) * len(self.corner))


def make_patch(mesh: Mesh, active: NDArray[np.bool_], centre: Array, *, only_active: bool) -> Patch:
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
    return Patch(
        corner=corner,
        normal=normal,
        flags=flags,
        neighbor=neighbor,
        edge=_median(norm(np.roll(corner, -1, axis=1) - corner).ravel()),
        area=0.5 * float(twice_area.sum()),
        sides=sides_of(mesh, corner, ends, neighbor, whole=whole),
    )


#: Patches by their mesh, its active faces, the origin of the tables, and whether the other faces are left out.
Known = dict[tuple[Mesh, bytes, bytes, bool], Patch]


@dataclass(frozen=True)
class Patches:
    """The patches of all surfaces; contacts that search the same faces share one.

    Attributes:
        patches: All of them, one for each mesh of a surface that is searched in one way.
        surfaces: Index of the surface of each.
        searched: For each, the number of its mesh for queries: patches that differ in what is active share one.
        corners: Of the faces (F, 3, 3) of each of these meshes, in float32.
        of_contact: First patch of each contact.
    """

    patches: list[Patch]
    surfaces: list[int]
    searched: list[int]
    corners: list[NDArray[np.float32]]
    of_contact: dict[Contact, int]

    def reaches(self) -> NDArray[np.float64]:
        """Returns the radius of the largest sphere that touches each patch, in the unit of its mesh."""
        reach = np.zeros(len(self.patches))
        for contact, first in self.of_contact.items():
            own = slice(first, first + len(contact.surface.meshes))
            reach[own] = np.maximum(reach[own], contact.radius.max() / contact.surface.scale.min())
        return reach

    def sides(self) -> dict[Contact, list[Sides]]:
        """Returns where the surface of each contact keeps its sides apart, mesh by mesh."""
        return {
            contact: [patch.sides for patch in self.patches[first : first + len(contact.surface.meshes)]]
            for contact, first in self.of_contact.items()
        }

    @property
    def face_count(self) -> int:
        """Number of rows of the tables of faces."""
        return sum(len(patch.corner) for patch in self.patches)

    def faces_read(self) -> int:
        """Returns about how many faces an environment reads, in some steps, of meshes too large for caches.

        Those around each body as far as its points and their radii reach, as they are in the scene.
        """
        read = 0.0
        for contact, first in self.of_contact.items():
            points = contact.points
            scale = 1.0 if points.surface is None else float(points.surface.scale.max())
            reach = float(contact.radius.max())
            if not points.spread:
                reach += 0.5 * scale * float(np.linalg.norm(np.ptp(points.positions, axis=0)))
            # Divided first: squares of what is accepted may overflow.
            reach /= float(contact.surface.scale.min())
            patches = self.patches[first : first + len(contact.surface.meshes)]
            large = [patch for patch in patches if len(patch.corner) > MANY_FACES]
            # Each environment has one mesh of a surface.
            read += contact.set_count * max((patch.faces_within(reach) for patch in large), default=0.0)
        return round(read)

    def remembered(self) -> int:
        """Returns how many faces are worth remembering of each contact on a CPU: of that with the most.

        Those that are farther from the middle of a sphere, where it touches a plane, than that by no more
        than the skin lie in a disk. As many more as fill up several at once.
        """
        most = float(FEWEST_REMEMBERED)
        for patch, reach in zip(self.patches, self.reaches(), strict=True):
            disk = np.sqrt(patch.skin * (2.0 * reach + patch.skin)) + 0.5 * patch.edge
            most = max(most, np.pi * disk**2 * len(patch.corner) / patch.area)
        return WIDTH * math.ceil(min(most, MOST_REMEMBERED) / WIDTH)


def make_patches(contacts: list[Contact], known: Known | None = None) -> Patches:
    """Returns the patches of ``contacts``.

    Args:
        contacts: The contacts.
        known: Patches that are there already; those that are made here are added.

    Raises:
        ValueError: If a face has no area left in float32, in which queries search.
    """
    known = {} if known is None else known
    rows: dict[tuple[int, bool], int] = {}
    numbers: dict[tuple[Any, ...], int] = {}
    made = Patches([], [], [], [], {})
    for contact in contacts:
        surface = contact.surface
        only_active = contact.search == "active" and not all(active.all() for active in surface.active)
        key = (surface.index, only_active)
        if key not in rows:
            rows[key] = len(made.patches)
            for mesh, active in zip(surface.meshes, surface.active, strict=True):
                what = (mesh, active.tobytes(), surface.centre.tobytes(), only_active)
                patch = known.get(what)
                if patch is None:
                    patch = known[what] = make_patch(mesh, active, surface.centre, only_active=only_active)
                made.patches.append(patch)
                made.surfaces.append(surface.index)
                # Meshes that differ in what is active alone are searched as one.
                faces = (id(mesh), active.tobytes() if only_active else b"", surface.centre.tobytes())
                if faces not in numbers:
                    numbers[faces] = len(made.corners)
                    given = np.flatnonzero(active) if only_active else np.arange(len(active))
                    made.corners.append(_search_corners(surface.name, patch, given))
                made.searched.append(numbers[faces])
        made.of_contact[contact] = rows[key]
    return made


def upload_patches(
    made: Patches, grids: list[Grid] | None, model: Any, layout: Layout, t: SimpleNamespace
) -> list[wp.Mesh]:
    """Declares the patches of ``model``, with cells if there are ``grids``.

    Returns:
        The meshes, a list that is filled when they are made: a kernel holds only their ids, so somebody has to
        keep them.
    """
    patches = made.patches
    meshes: list[wp.Mesh] = []

    def make_meshes(_: int) -> None:
        meshes.extend(_search_mesh(own, layout.device) for own in made.corners)
        ids = np.array([meshes[mesh].id for mesh in made.searched], dtype=np.uint64)
        model.patch_mesh = wp.array(ids, dtype=wp.uint64, device=layout.device)

    mesh_bytes = sum(_mesh_bytes(len(own), layout.device) for own in made.corners)
    layout.other("surfaces", mesh_bytes + 8 * len(made.searched), make_meshes)
    starts = np.cumsum([0] + [len(patch.flags) for patch in patches])

    def send(name: str, values: Any, dtype: Any) -> None:
        layout.content("surfaces", model, name, values, dtype)

    send("patch_surface", made.surfaces, wp.int32)
    send("patch_face_start", starts, wp.int32)
    errors = [_query_error(patch) for patch in patches]
    send("patch_slack", [slack for slack, _ in errors], t.real)
    send("patch_thin", [thin for _, thin in errors], t.real)
    send("patch_skin", [patch.skin for patch in patches], t.real)
    send("patch_sides", [patch.sides.kind for patch in patches], wp.int32)
    walls = [patch.sides for patch in patches]
    send("patch_wall_start", np.cumsum([0] + [len(own.offset) for own in walls]), wp.int32)
    none = np.zeros((0, 3))
    send("wall_normal", np.concatenate([none, *(own.normal for own in walls)]), t.vec3)
    send("wall_offset", np.concatenate([none[:, 0], *(own.offset for own in walls)]), t.real)
    if patches:
        # With its normal a face is in one place of the memory, which is what a search waits for.
        shapes = [np.concatenate([patch.corner, patch.normal[:, :1]], axis=1) for patch in patches]
        send("face_corner", np.concatenate(shapes), t.vec3)
        flat = [_frames(patch) for patch in patches] if grids else [np.zeros((0, 4, 3))]
        send("face_frame", np.concatenate(flat), t.vec3)
        send("face_normal", np.concatenate([patch.normal for patch in patches]), t.vec3)
        send("face_flags", np.concatenate([patch.flags for patch in patches]), wp.uint8)
        shifted = [
            np.where(patch.neighbor < 0, -1, patch.neighbor + 3 * start)
            for patch, start in zip(patches, starts, strict=False)
        ]
        send("face_neighbor", np.concatenate(shifted), wp.int32)
        first = [made.searched.index(mesh) for mesh in range(len(made.corners))]
        own = [patches[number] for number in first]
        counts = [len(patch.corner) for patch in own]
        declare_trees(counts, lambda: [patch.tree for patch in own], made.searched, model, layout)
        # Last, as they are filled from all of this.
        declare_grids(grids, len(patches), model, layout, t)
    return meshes


def _median(values: Array) -> float:
    """Returns the median of numbers (n,), without the masked arrays that NumPy imports for that."""
    around = [(len(values) - 1) // 2, len(values) // 2]
    return float(np.partition(values, around)[around].mean())


def _frames(patch: Patch) -> Array:
    """Returns the axes of the faces in their planes, and where their corners are there: ``Model.face_frame``."""
    a, b, c = patch.corner.swapaxes(0, 1)
    edges = np.roll(patch.corner, -1, axis=1) - patch.corner
    squares = dot(edges, edges)
    length = np.sqrt(squares[:, 0])
    along = (b - a) / length[:, None]
    across = cross(patch.normal[:, 0], along)
    last = [dot(c - a, axis) for axis in (along, across)]
    return np.stack([along, across, np.stack([length, *last], axis=1), 1.0 / squares], axis=1)


def _search_corners(name: str, patch: Patch, given: NDArray[np.integer[Any]]) -> NDArray[np.float32]:
    """Returns the corners (F, 3, 3) that queries search; ``given`` are the numbers of the faces in their mesh."""
    # The mesh is sound in float64; only float32 can still spoil it.
    corner = patch.corner.astype(np.float32)
    lost = np.flatnonzero(slenderness(corner.astype(np.float64)) < SLIVER)
    if len(lost):
        far = np.abs(patch.corner[lost[0]]).max()
        raise ValueError(
            f"{name}: face {given[lost[0]]} has no area left in float32, in which surfaces are searched "
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


def _query_error(patch: Patch) -> tuple[float, float]:
    """Returns how far the float32 query may be off, and the longest edge of the faces where this is not rounding.

    The query's areas lose ε (length/height)² of the length along a triangle, and at most its height in distance.
    """
    corner = patch.corner
    edges = np.roll(corner, -1, axis=1) - corner
    longest = norm(edges).max(axis=1)
    height = norm(cross(edges[:, 0], edges[:, 1])) / longest
    epsilon = float(np.finfo(np.float32).eps)
    lost = epsilon * longest * (longest / height) ** 2
    rounding = 16.0 * epsilon * (np.abs(corner).max() + longest)
    slack = float((np.minimum(lost, height) + rounding).max())
    return slack, float(longest[lost > rounding].max(initial=0.0))
