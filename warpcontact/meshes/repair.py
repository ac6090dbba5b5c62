"""Repair of meshes on request: unambiguous changes only, each of them recorded.

Other defects are unchanged and stay in the report: holes are not filled, intersecting parts are not united, and
one-sided surfaces and non-manifold edges are kept.
"""

from collections import defaultdict, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.algebra.vectors import norm
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.meshes.examine import COORDINATE_LIMIT, SLIVER_LIMIT, examine
from warpcontact.meshes.mesh import Mesh, MeshError, positive
from warpcontact.meshes.report import RepairStep, counted
from warpcontact.meshes.topology import (
    CRACK_LIMIT,
    Edges,
    area_vectors,
    components,
    find_containing_parts,
    representatives,
    slenderness,
    volumes_of,
)

Groups = dict[str, npt.NDArray[np.int64]]
#: Argument ``repair``: ``True`` (all), ``False``, ``None``, the name of a step, or several names.
RepairRequest = bool | str | Iterable[str] | None
# More near pairs per vertex than this indicate a tolerance larger than the faces.
_MOST_PAIRS = 30


@dataclass
class MeshUnderRepair:
    """Surface during repair.

    Attributes:
        vertices: Positions, (V, 3) [m].
        faces: Vertex indices of each triangle, (F, 3), in range.
        groups: Face numbers by group name.
        tolerance: Distance below which vertices are merged [m].
    """

    vertices: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int64]
    groups: Groups
    tolerance: float

    @property
    def corners(self) -> npt.NDArray[np.int64]:
        """Welded vertex indices of each triangle, (F, 3): equal for vertices at the same position."""
        return representatives(self.vertices)[self.faces]

    def replace_faces(self, faces: npt.NDArray[np.int64], source: npt.NDArray[np.int64]) -> None:
        """Replaces the faces; new face i belongs to the groups of old face ``source[i]``."""
        for name, members in self.groups.items():
            is_member = np.zeros(len(self.faces), dtype=bool)
            is_member[members] = True
            self.groups[name] = np.flatnonzero(is_member[source])
        self.faces = faces

    def keep_faces(self, kept: npt.NDArray[np.bool]) -> None:
        """Removes all faces except ``kept``."""
        self.replace_faces(self.faces[kept], np.flatnonzero(kept))


def steps_of(repair: RepairRequest) -> tuple[str, ...]:
    """Returns the names of the requested steps, in the order of execution.

    Raises:
        ValueError: If a step does not exist.
    """
    if repair is None or isinstance(repair, bool):
        return REPAIRS if repair else ()
    names = (repair,) if isinstance(repair, str) else repair
    if not isinstance(names, list | tuple | set | frozenset):
        raise ValueError(f"repair must be True, False, or names out of {', '.join(REPAIRS)}; got {repair!r}")
    for name in names:
        if name not in ("all", *REPAIRS):
            raise ValueError(f"repair must be True, False, or names out of {', '.join(REPAIRS)}; got {name!r}")
    return REPAIRS if "all" in names else tuple(step for step in REPAIRS if step in names)


def check_tolerance(tolerance: object) -> float:
    """Returns a tolerance relative to the size of a mesh, after validation.

    Raises:
        ValueError: If it is not positive, or above 0.01.
    """
    value = positive("tolerance", tolerance)
    if value > 0.01:
        raise ValueError(f"tolerance must be at most 0.01 of the size of the mesh, got {tolerance!r}")
    return value


def repair_arrays(
    vertices: npt.NDArray[Any],
    faces: npt.NDArray[Any],
    groups: Groups,
    steps: Iterable[str],
    tolerance: float = CRACK_LIMIT,
) -> tuple[npt.NDArray[Any], npt.NDArray[Any], Groups, tuple[RepairStep, ...]]:
    """Repairs a surface.

    Args:
        vertices: Positions, (V, 3) [m].
        faces: Vertex indices of each triangle, (F, 3).
        groups: Face numbers by group name.
        steps: Names of steps, in the order of ``REPAIRS``.
        tolerance: Distance below which vertices are merged, relative to the largest dimension.

    Returns:
        Vertices, faces, groups and executed steps. The input without steps, if a vertex is not finite or too far away
        or an index is out of range, which cannot be repaired.

    Raises:
        MeshError: If the tolerance is larger than the faces.
    """
    if not is_repairable(vertices, faces):
        return vertices, faces, groups, ()
    v, f = np.array(vertices, dtype=np.float64), np.array(faces, dtype=np.int64)
    size = float(np.ptp(v[f], axis=(0, 1)).max())
    surface = MeshUnderRepair(v, f, dict(groups), tolerance * size)
    done = tuple(_STEPS[step](surface) for step in steps)
    return surface.vertices, surface.faces, surface.groups, done


def is_repairable(vertices: npt.NDArray[Any], faces: npt.NDArray[Any]) -> bool:
    """Returns whether the arrays have valid shapes and types, finite and near vertices, and valid indices."""
    arrays = (vertices, "iuf"), (faces, "iu")
    if not all(a.ndim == 2 and a.shape[1] == 3 and len(a) and a.dtype.kind in kinds for a, kinds in arrays):
        return False
    return bool(((faces >= 0) & (faces < len(vertices))).all() and (np.abs(vertices) <= COORDINATE_LIMIT).all())


@explain_keywords
def repaired(mesh: Any, repair: RepairRequest = True, *, tolerance: float = CRACK_LIMIT, name: str = "") -> Mesh:
    """Returns a repaired mesh of any object with vertices and faces.

    Args:
        mesh: A ``Mesh``, a ``trimesh.Trimesh``, or another object with ``vertices`` (V, 3) [m] and ``faces``
            (F, 3), valid or not.
        repair: Repair steps: ``True`` for all, or names out of ``REPAIRS``.
        tolerance: Distance below which ``merge`` joins vertices, relative to the largest dimension.
        name: Name of the mesh. Default: that of ``mesh``, or "mesh".

    Returns:
        The mesh; its ``report.repairs`` lists the changes.

    Raises:
        TypeError: If there are no vertices and faces.
        MeshError: If the result is not usable, or the tolerance is larger than the faces.
        ValueError: If an option is invalid.
    """
    if not (hasattr(mesh, "vertices") and hasattr(mesh, "faces")):
        raise TypeError(f"mesh must have vertices and faces, like trimesh.Trimesh, got {type(mesh).__name__}")
    steps, relative_tolerance = steps_of(repair), check_tolerance(tolerance)
    title = name or (mesh.name if isinstance(mesh, Mesh) else "mesh")
    groups = (
        {key: members.astype(np.int64) for key, members in mesh.groups.items()} if isinstance(mesh, Mesh) else {}
    )
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    vertices, faces, groups, done = repair_arrays(vertices, faces, groups, steps, relative_tolerance)
    report = replace(examine(vertices, faces, title, overlaps=True), repairs=done)
    return Mesh._examined(vertices, faces, groups, report, f"mesh {title!r}")


def _merge(surface: MeshUnderRepair) -> RepairStep:
    before, v = len(surface.vertices), surface.vertices
    leader = representatives(v)
    unique_vertices = np.unique(leader)
    near_pairs = _near_pairs(v[unique_vertices], surface.tolerance)
    distance = 0.0
    for i, j in unique_vertices[near_pairs].tolist():  # sorted by j, then i, so vertices before j are final
        if leader[j] == j and leader[i] == i:
            leader[j] = i
            distance = max(distance, float(np.linalg.norm(v[i] - v[j])))
    leader = leader[leader]
    kept = np.flatnonzero(leader == np.arange(before))
    number = np.empty(before, dtype=np.int64)
    number[kept] = np.arange(len(kept))
    surface.vertices, surface.faces = v[kept], number[leader][surface.faces]
    count = before - len(kept)
    text = (
        f"merge: {count} of {counted(before, 'vertex').replace('vertexs', 'vertices')} joined with another one, "
        f"{distance:.3g} m away at most (tolerance {surface.tolerance:.3g} m)"
    )
    return RepairStep("merge", count, distance, text if count else "merge: no vertices to join")


def _near_pairs(v: npt.NDArray[np.float64], distance: float) -> npt.NDArray[np.intp]:
    """Returns pairs of points within ``distance``, the lower index first, sorted by the higher one."""
    from scipy.spatial import KDTree

    tree = KDTree(v)
    count = (int(tree.count_neighbors(tree, distance)) - len(v)) // 2
    if count > _MOST_PAIRS * len(v):
        raise MeshError(
            f"tolerance must be smaller than the faces, got {distance:.3g} m, within which {len(v)} vertices form {count} "
            "pairs"
        )
    pairs = np.sort(tree.query_pairs(distance, output_type="ndarray"), axis=1)
    return pairs[np.lexsort((pairs[:, 0], pairs[:, 1]))]


def _drop_degenerate(surface: MeshUnderRepair) -> RepairStep:
    before = len(surface.faces)
    faces, source, split, height = without_slivers(surface.vertices, surface.corners)
    dropped = before - len(faces)
    if dropped or split:
        surface.replace_faces(faces, source)
    parts = [f"{counted(dropped, 'face')} without area dropped"] if dropped else []
    if split:
        parts.append(f"{split} merged with the neighbor at the longest edge, at most {height:.3g} m away")
    text = "degenerate: " + ("; ".join(parts) or "no face without area")
    return RepairStep("degenerate", dropped + split, height, text)


def _drop_duplicates(surface: MeshUnderRepair) -> RepairStep:
    original = representatives(np.sort(surface.corners, axis=1))
    kept = original == np.arange(len(original))
    count = int((~kept).sum())
    surface.keep_faces(kept)
    text = (
        f"{counted(count, 'face')} with the vertices of an earlier one dropped" if count else "no duplicate face"
    )
    return RepairStep("duplicate", count, 0.0, f"duplicate: {text}")


def _orient(surface: MeshUnderRepair) -> RepairStep:
    corners = surface.corners
    valid_faces = (corners != corners[:, [1, 2, 0]]).all(axis=1)
    flip, one_sided = np.zeros(len(corners), dtype=bool), 0
    if valid_faces.any():
        flip[valid_faces], one_sided = _faces_to_flip(surface.vertices, corners[valid_faces])
    surface.faces = np.where(flip[:, None], surface.faces[:, [0, 2, 1]], surface.faces)
    count = int(flip.sum())
    text = f"orient: {count} of {counted(len(flip), 'face')} flipped" if count else "orient: no face flipped"
    if one_sided:
        text += f"; {counted(one_sided, 'part')} one-sided, such as a Möbius strip, unchanged"
    return RepairStep("orient", count, 0.0, text)


def _faces_to_flip(v: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.bool], int]:
    """Selects the faces to flip.

    Faces connected by edges of exactly two faces form patches. Within a patch, faces are made consistent by flipping
    the smaller area. Then closed patches are oriented outward. A patch inside another one, such as a cavity, keeps its
    orientation relative to the enclosing one if its own faces were consistent, and is oriented as a cavity otherwise.

    Args:
        v: Positions, (V, 3) [m].
        faces: Welded vertex indices of each triangle, (F, 3), three different ones.

    Returns:
        Whether to flip each face, (F,); and the number of one-sided patches, such as a Möbius strip, which are
        unchanged.
    """
    count = len(faces)
    edges = Edges(faces)
    shared = edges.counts == 2
    pairs, opposed = edges.halves[shared] // 3, edges.balance[shared] != 0
    parts, part = components(pairs, count)
    # Each face has two nodes, unchanged (2 i) and flipped (2 i + 1), linked with the consistent nodes of neighbors.
    f, g = pairs.T
    links = [np.column_stack((2 * f + side, 2 * g + (side ^ opposed))) for side in (0, 1)]
    _, state = components(np.concatenate(links), 2 * count)
    one_sided = np.zeros(parts, dtype=bool)
    one_sided[part[state[0::2] == state[1::2]]] = True
    first = np.unique(part, return_index=True)[1]
    flip = (state[0::2] != state[2 * first[part]]) & ~one_sided[part]

    areas = norm(area_vectors(v[faces]))
    flip ^= (np.bincount(part, areas * flip, parts) > 0.5 * np.bincount(part, areas, parts))[part]
    agreed = np.bincount(part, flip, parts) == 0  # as given
    agreed |= np.bincount(part, flip, parts) == np.bincount(part, minlength=parts)

    alike = np.where(flip[:, None], faces[:, ::-1], faces)
    closed = _closed(alike, part, parts) & ~one_sided
    _, volumes, zero_volume = volumes_of(v, alike, part, parts)
    closed &= np.abs(volumes) > zero_volume
    containing = find_containing_parts(v, alike, part, closed)
    over = np.zeros(parts, dtype=bool)  # patches to flip as a whole, in addition
    for i in sorted(np.flatnonzero(closed).tolist(), key=lambda i: _depth(i, containing)):
        outer = containing.get(i)
        if outer is None:
            over[i] = volumes[i] < 0.0
        elif agreed[i]:
            over[i] = over[outer] and agreed[outer]
        else:
            over[i] = (volumes[i] > 0.0) == ((volumes[outer] > 0.0) != over[outer])
    return flip ^ over[part], int(one_sided.sum())


def _depth(i: int, containing: dict[int, int]) -> int:
    depth = 0
    while i in containing and depth <= len(containing):
        i, depth = containing[i], depth + 1
    return depth


def _closed(faces: npt.NDArray[np.int64], part: npt.NDArray[np.integer], parts: int) -> npt.NDArray[np.bool]:
    """Returns which patches are closed: each edge is traversed equally often in both directions."""
    ends = np.stack((faces, faces[:, [1, 2, 0]]), axis=2).reshape(-1, 2)
    owner = np.repeat(part, 3)
    edge = representatives(np.column_stack((np.sort(ends, axis=1), owner)))
    balance = np.bincount(edge, np.where(ends[:, 0] < ends[:, 1], 1, -1), len(ends))
    closed = np.ones(parts, dtype=bool)
    closed[owner[balance != 0]] = False
    return closed


def _drop_unused(surface: MeshUnderRepair) -> RepairStep:
    used = np.zeros(len(surface.vertices), dtype=bool)
    used[surface.faces] = True
    count = int((~used).sum())
    surface.vertices, surface.faces = surface.vertices[used], (np.cumsum(used) - 1)[surface.faces]
    text = f"{count} of {len(used)} unused vertices dropped" if count else "no unused vertex"
    return RepairStep("unused", count, 0.0, f"unused: {text}")


_STEPS: dict[str, Callable[[MeshUnderRepair], RepairStep]] = {
    "merge": _merge,
    "degenerate": _drop_degenerate,
    "duplicate": _drop_duplicates,
    "orient": _orient,
    "unused": _drop_unused,
}
#: Names of the repair steps, in the order of execution.
REPAIRS = tuple(_STEPS)


# Largest number of splits per sliver, because splitting a neighbor can create new slivers.
_ROUNDS = 20


def without_slivers(
    v: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], int, float]:
    """Removes degenerate faces.

    A face with coincident vertices is a line that its neighbors already share, and is dropped. If a vertex c of a face
    lies on its longest edge ab, the face is merged with the neighbor abd at that edge, and both become acd and cbd, so
    that c is a vertex of both. If there is no single such neighbor, the face is dropped.

    Args:
        v: Positions, (V, 3) [m].
        faces: Welded vertex indices of each triangle, (F, 3).

    Returns:
        Faces; for each, the number of the input face it is a part of, for its groups; number of faces merged with a
        neighbor; and the largest height of those [m].
    """
    slivers = np.flatnonzero(slenderness(v[faces]) < SLIVER_LIMIT).tolist()
    surface = _Surface(v, faces)
    queue, remaining_rounds, split, height = deque(slivers), _ROUNDS * len(slivers), 0, 0.0
    while queue:
        i = queue.popleft()
        if not surface.is_sliver(i):
            continue
        found = surface.face_behind(i) if remaining_rounds > 0 else None
        if found is None:
            surface.remove(i)
            continue
        remaining_rounds -= 1
        a, b, c, j = found
        height = max(height, _height(v[a], v[b], v[c]))
        surface.split(i, j, a, b, c)
        queue.extend((i, j))
        split += 1
    kept = [i for i, corners in enumerate(surface.corners) if corners]
    result = np.array([surface.corners[i] for i in kept], dtype=np.int64).reshape(-1, 3)
    return result, np.array([surface.source[i] for i in kept], dtype=np.int64), split, height


class _Surface:
    """Changing faces with a map from edges to faces.

    Args:
        v: Positions, (V, 3) [m].
        faces: Vertex indices of each triangle, (F, 3).

    Attributes:
        corners: Vertex indices of each face; empty for a removed one.
        source: Number of the input face that each face is a part of.
    """

    def __init__(self, v: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> None:
        self.v = v
        self.corners: list[list[int]] = faces.tolist()
        self.source = list(range(len(faces)))
        self._faces_at_edge: defaultdict[tuple[int, int], set[int]] = defaultdict(set)
        for i, corners in enumerate(self.corners):
            for edge in _edges(corners):
                self._faces_at_edge[edge].add(i)

    def is_sliver(self, i: int) -> bool:
        corners = self.corners[i]
        return bool(corners) and bool(slenderness(self.v[[corners]])[0] < SLIVER_LIMIT)

    def remove(self, i: int) -> None:
        self._set(i, [])

    def face_behind(self, i: int) -> tuple[int, int, int, int] | None:
        """Returns ends of the longest edge of face i, the vertex on it, and the single neighbor there, or ``None``."""
        corners = self.corners[i]
        if len(set(corners)) < 3:
            return None
        lengths = [float(np.linalg.norm(self.v[corners[k]] - self.v[corners[k - 2]])) for k in range(3)]
        k = int(np.argmax(lengths))
        a, b, c = corners[k], corners[k - 2], corners[k - 1]
        others = self._faces_at_edge[_edge(a, b)] - {i}
        if len(others) != 1:
            return None
        j = next(iter(others))
        opposite = set(self.corners[j]) - {a, b}
        # The edge from c to the opposite vertex must be new, because it gets two faces.
        if len(opposite) != 1 or c in opposite or self._faces_at_edge[_edge(c, *opposite)]:
            return None
        return a, b, c, j

    def split(self, i: int, j: int, a: int, b: int, c: int) -> None:
        """Replaces faces i and j by the two parts of face j, whose edge ab is divided at c."""
        face = self.corners[j]
        for k, replaced in ((i, a), (j, b)):
            self._set(k, [c if corner == replaced else corner for corner in face])
        self.source[i] = self.source[j]

    def _set(self, i: int, corners: list[int]) -> None:
        for edge in _edges(self.corners[i]):
            self._faces_at_edge[edge].discard(i)
        self.corners[i] = corners
        for edge in _edges(corners):
            self._faces_at_edge[edge].add(i)


def _edge(p: int, q: int) -> tuple[int, int]:
    return (p, q) if p < q else (q, p)


def _edges(corners: list[int]) -> list[tuple[int, int]]:
    return [_edge(corners[k - 1], corners[k]) for k in range(len(corners))]


def _height(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64], c: npt.NDArray[np.float64]) -> float:
    base = float(np.linalg.norm(b - a))
    return float(np.linalg.norm(np.cross(b - a, c - a))) / base if base > 0.0 else 0.0
