"""Examination of triangle arrays: all errors, warnings and facts of a mesh, and faces that intersect or overlap.

``wp.Mesh`` accepts any arrays: an index out of range or an empty mesh crashes the process, and a NaN vertex or a sliver
is silently a hole in the surface. Therefore all arrays are examined on the host first.

Topology is that of the *welded* surface, in which vertices at exactly the same position are one (an STL file has no
other connectivity), restricted to valid faces: those with usable vertices and three different ones, without copies of
an earlier face in the same direction.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.algebra.vectors import bounds, norm
from warpcontact.meshes.report import MeshReport, listed, notes_of, warnings_of
from warpcontact.meshes.topology import (
    CRACK_LIMIT,
    area_vectors,
    examine_surface,
    representatives,
    seen_from,
    slenderness,
)

# Warp's closest-point queries skip a face whose |cross|/Σe² is below this (sliver detection in its mesh.h).
SLIVER_LIMIT = 1.0e-6
# float32, in which Warp stores vertices, resolves 6 cm at this distance [m]: no contact is meaningful there.
COORDINATE_LIMIT = 1.0e6


def examine(
    vertices: npt.ArrayLike,
    faces: npt.ArrayLike,
    name: str = "mesh",
    *,
    overlaps: bool = False,
    remedy: str = 'repair="{step}"',
) -> MeshReport:
    """Examines any vertices and faces. All problems are listed in ``errors``; no exception is raised.

    Args:
        vertices: Positions, (V, 3) real numbers [m].
        faces: Three vertex indices of each triangle, (F, 3) integers.
        name: Name for the report.
        overlaps: Whether to search for intersecting faces, which about doubles the run time. Skipped for more than
            100 000 faces.
        remedy: Recommendation of a repair step in errors, with ``{step}`` for its name.

    Returns:
        Report with all facts and problems.
    """
    v, vertex_error = _array(vertices, "vertices", "(V, 3)", "iuf", "real numbers")
    f, face_error = _array(faces, "faces", "(F, 3)", "iu", "integers")
    if vertex_error or face_error:
        return MeshReport(name, len(v), len(f), errors=vertex_error + face_error)
    with np.errstate(over="ignore"):  # a longdouble beyond float64 becomes inf, which is an error below
        v = v.astype(np.float64)
    finite: npt.NDArray[np.bool] = np.all(np.isfinite(v), axis=1)
    near: npt.NDArray[np.bool] = np.all(np.abs(v) <= COORDINATE_LIMIT, axis=1)  # false for NaN
    # Before the cast, which wraps large unsigned numbers.
    in_range: npt.NDArray[np.bool] = np.all((f >= 0) & (f < len(v)), axis=1)
    index = np.where(in_range[:, None], f, 0).astype(np.int64)
    placed = in_range & near[index].all(axis=1)
    used = np.zeros(len(v), dtype=bool)
    used[index[in_range]] = True
    box = v[near & used] if (near & used).any() else np.zeros((1, 3))
    lower, upper = box.min(axis=0), box.max(axis=0)
    ratio, ratio32 = np.full(len(f), np.inf), np.full(len(f), np.inf)
    ratio[placed] = slenderness(v[index[placed]])
    with np.errstate(all="ignore"):  # float32 underflow is detected below
        ratio32[placed] = slenderness((v[index[placed]] - seen_from(lower, upper)).astype(np.float32))

    welded = representatives(v)
    corners = welded[index]
    valid_faces = np.flatnonzero(placed & (corners != corners[:, [1, 2, 0]]).all(axis=1))
    original = np.arange(len(f))
    original[valid_faces] = valid_faces[representatives(np.sort(corners[valid_faces], axis=1))]
    # Copies in the opposite direction are kept: in a folded sheet, some neighbors belong to each.
    rotated = corners[valid_faces].argmin(axis=1)[:, None] + np.arange(3)
    oriented = representatives(np.take_along_axis(corners[valid_faces], rotated % 3, axis=1))
    valid_faces = valid_faces[oriented == np.arange(len(valid_faces))]
    facts, clash, halves = examine_surface(v, corners[valid_faces])
    if "components" in facts:  # face numbers of the input
        facts["components"] = tuple(
            replace(part, first_face=int(valid_faces[part.first_face])) for part in facts["components"]
        )
    slivers, copies = ratio < SLIVER_LIMIT, original != np.arange(len(f))
    flat = valid_faces[~slivers[valid_faces] & ~copies[valid_faces]]
    cuts = intersections(v, corners[flat]) if overlaps and len(flat) <= MOST_FACES else None

    def vertex(i: int) -> str:
        return f"vertex {i} at {listed(v[i])}"

    def face(i: int) -> str:
        return f"face {i} with vertices {listed(f[i])}"

    def sliver(i: int) -> str:
        return f"{face(i)} and |cross|/Σe² = {ratio[i]:.3g}"

    def duplicate(i: int) -> str:
        return f"{face(i)} has the vertices of face {original[i]}"

    def edge(i: int) -> str:
        (here, there), corner = halves[i] // 3, halves[i][0] % 3
        tail, head = np.roll(corners[valid_faces[here]], -corner)[:2]
        return f"faces {valid_faces[here]} and {valid_faces[there]} both run from vertex {tail} to vertex {head}"

    def repair(step: str) -> str:
        return remedy.format(step=step)

    found = (
        _problem(~finite, "vertices", "not finite", vertex, "finite numbers"),
        _problem(finite & ~near, "vertices", "too far away", vertex, f"within ±{COORDINATE_LIMIT:g} m"),
        _problem(~in_range, "faces", "out of index range", face, f"vertex indices 0 to {len(v) - 1}"),
        _problem(slivers, "faces", "degenerate", sliver, f"{SLIVER_LIMIT:g} or more; {repair('degenerate')}"),
        _problem(copies, "faces", "duplicate", duplicate, f"one face for three points; {repair('duplicate')}"),
        _problem(clash, "edges", "wound inconsistently", edge, f"one face in each direction; {repair('orient')}"),
    )
    report = MeshReport(
        name,
        vertex_count=len(v),
        face_count=len(f),
        welded_vertex_count=int((welded == np.arange(len(v))).sum()),
        lower=tuple(lower.tolist()),
        upper=tuple(upper.tolist()),
        inconsistent_edge_count=int(clash.sum()),
        duplicate_face_count=int(copies.sum()),
        degenerate_face_count=int(slivers.sum()),
        float32_sliver_count=int((~slivers & ~(ratio32 >= np.float32(SLIVER_LIMIT))).sum()),
        self_intersection_count=None if cuts is None else len(cuts),
        first_intersection=None
        if cuts is None or not len(cuts)
        else (int(flat[cuts[0, 0]]), int(flat[cuts[0, 1]])),
        unreferenced_vertex_count=int((~used).sum()),
        coincident_vertex_count=int((welded != np.arange(len(v))).sum()),
        errors=tuple(problem for problem in found if problem),
        **facts,
    )
    return replace(report, warnings=warnings_of(report), notes=notes_of(report))


def _problem(
    invalid: npt.NDArray[np.bool], noun: str, what: str, describe: Callable[[int], str], allowed: str
) -> str:
    """Returns a sentence about the ``invalid`` entries; empty if there are none."""
    count = int(invalid.sum())
    if not count:
        return ""
    verb, first = "is" if count == 1 else "are", describe(int(invalid.argmax()))
    return f"{count} of {len(invalid)} {noun} {verb} {what}, first: {first}; allowed: {allowed}"


def _array(
    values: npt.ArrayLike, label: str, shape: str, kinds: str, numbers: str
) -> tuple[npt.NDArray[Any], tuple[str, ...]]:
    """Returns ``values`` as an (n, 3) array, empty if that is impossible, and the error if it is unusable."""
    none = np.empty((0, 3))
    try:
        array = np.asarray(values)
    except (ValueError, TypeError, OverflowError) as error:  # ragged rows
        return none, (f"{label} must be an array of shape {shape}: {error}",)
    if array.size == 0:
        return none, (f"it has no {label}",)
    if array.ndim != 2 or array.shape[1] != 3:
        return none, (f"{label} must have shape {shape}, got {array.shape}",)
    if array.dtype.kind not in kinds:
        return array, (f"{label} must hold {numbers}, got {array.dtype}",)
    return array, ()


#: Largest number of faces that are examined by default.
MOST_FACES = 100_000
# Largest number of box pairs on one level of the tree; beyond it, no result is given.
_MAX_PAIRS = 8_000_000
_CHUNK = 500_000

_Pairs = npt.NDArray[np.int64]
_Floats = npt.NDArray[np.float64]


def intersections(v: _Floats, faces: npt.NDArray[np.int64]) -> _Pairs | None:
    """Finds pairs of faces that have more than a vertex or an edge in common.

    Two faces count if an edge of one passes through the other by more than 1e-6 of the surface size on both sides, or
    if they are coplanar to that accuracy and overlap. Faces of parts that touch along an edge or at a vertex do not
    count.

    Args:
        v: Positions, (V, 3) [m].
        faces: Welded vertex indices of each triangle, (F, 3), none degenerate.

    Returns:
        Face numbers of each pair, the lower one first, (n, 2), sorted; ``None`` if there are too many candidates.
    """
    if len(faces) < 2:
        return np.empty((0, 2), dtype=np.int64)
    corners = v[faces]
    lower, upper = bounds(corners)
    corners = corners - 0.5 * (lower + upper)  # for precision
    pairs = _candidates(corners)
    if pairs is None:
        return None
    tolerance = CRACK_LIMIT * float((upper - lower).max())
    normals = area_vectors(corners)
    normals /= norm(normals)[:, None]
    found = [np.empty((0, 2), dtype=np.int64)]
    for start in range(0, len(pairs), _CHUNK):
        block = pairs[start : start + _CHUNK]
        found.append(block[_intersect(corners, normals, faces, block, tolerance)])
    result = np.concatenate(found)
    return result[np.lexsort(result.T[::-1])]


def _candidates(corners: _Floats) -> _Pairs | None:
    """Returns pairs of faces with overlapping boxes, by a tree of boxes over faces sorted along a Z curve."""
    count = len(corners)
    levels = int(np.ceil(np.log2(count)))
    order = np.argsort(_z_curve(corners.mean(axis=1)), kind="stable")
    lower, upper = np.full((2**levels, 3), np.inf), np.full((2**levels, 3), -np.inf)
    lower[:count], upper[:count] = corners.min(axis=1)[order], corners.max(axis=1)[order]
    tree = [(lower, upper)]
    for _ in range(levels):
        low, high = tree[-1]
        tree.append((low.reshape(-1, 2, 3).min(axis=1), high.reshape(-1, 2, 3).max(axis=1)))
    pairs = np.zeros((1, 2), dtype=np.int64)
    for low, high in tree[-2::-1]:
        # Children of two different nodes form four pairs, children of the same node three.
        is_same = pairs[:, 0] == pairs[:, 1]
        a, b = 2 * pairs[:, 0], 2 * pairs[:, 1]
        twice = [(a, b), (a, b + 1), (a + 1, b + 1)]
        halves = [np.column_stack(pair) for pair in twice] + [np.column_stack((a + 1, b))[~is_same]]
        if sum(map(len, halves)) > _MAX_PAIRS:
            return None
        pairs = np.concatenate([half[_boxes_overlap(low, high, half)] for half in halves])
    pairs = pairs[pairs[:, 0] != pairs[:, 1]]
    return np.sort(order[pairs], axis=1)


def _boxes_overlap(low: _Floats, high: _Floats, pairs: _Pairs) -> npt.NDArray[np.bool]:
    a, b = pairs.T
    overlapping = (low[a, 0] <= high[b, 0]) & (low[b, 0] <= high[a, 0])
    for axis in (1, 2):
        overlapping &= (low[a, axis] <= high[b, axis]) & (low[b, axis] <= high[a, axis])
    return overlapping


def _z_curve(points: _Floats) -> npt.NDArray[np.uint64]:
    """Returns the positions of points along a Z-order curve."""
    span = np.ptp(points, axis=0).max()
    cells = ((points - points.min(axis=0)) / (span if span > 0.0 else 1.0) * (2**20 - 1)).astype(np.uint64)
    for shift, mask in (
        (32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF), (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3), (2, 0x1249249249249249),
    ):  # fmt: skip
        cells = (cells | cells << np.uint64(shift)) & np.uint64(mask)
    return cells[:, 0] | cells[:, 1] << np.uint64(1) | cells[:, 2] << np.uint64(2)


def _intersect(
    corners: _Floats, normals: _Floats, faces: npt.NDArray[np.int64], pairs: _Pairs, tolerance: float
) -> npt.NDArray[np.bool]:
    """Returns which pairs of faces intersect or overlap in a plane."""
    overlapping = np.zeros(len(pairs), dtype=bool)
    candidates = np.arange(len(pairs))
    heights: list[_Floats] = []
    for a, b in ((0, 1), (1, 0)):  # discard pairs with one face entirely on one side of the other
        p, q = pairs[candidates, a], pairs[candidates, b]
        height = np.einsum("ijk,ik->ij", corners[p] - corners[q][:, :1], normals[q])
        across = (height.min(axis=1) <= tolerance) & (height.max(axis=1) >= -tolerance)
        heights = [previous[across] for previous in (*heights, height)]
        candidates = candidates[across]
    block = pairs[candidates]
    same = faces[block[:, 0]][:, :, None] == faces[block[:, 1]][:, None, :]
    found = np.zeros(len(block), dtype=bool)
    for (a, b), height, shared in zip(
        ((0, 1), (1, 0)), heights, (same.any(axis=2), same.any(axis=1)), strict=True
    ):
        p, q = block[:, a], block[:, b]
        for i in range(3):
            j = (i + 1) % 3
            low, high = np.minimum(height[:, i], height[:, j]), np.maximum(height[:, i], height[:, j])
            # An edge that ends at a shared vertex only touches the other face.
            todo = np.flatnonzero((low < -tolerance) & (high > tolerance) & ~shared[:, i] & ~shared[:, j] & ~found)
            found[todo] = _line_crosses_face(corners[p[todo], i], corners[p[todo], j], corners[q[todo]])
        flat = np.flatnonzero((np.abs(height) <= tolerance).all(axis=1) & ~found)
        found[flat] = _overlap(corners[p[flat]], corners[q[flat]], normals[q[flat]], tolerance)
    overlapping[candidates] = found
    return overlapping


def _line_crosses_face(tail: _Floats, head: _Floats, q: _Floats) -> npt.NDArray[np.bool]:
    """Returns whether the line through two points (n, 3) passes through a triangle (n, 3, 3)."""
    a, b, c = (q[:, i] - tail for i in range(3))
    along = head - tail
    sides = np.stack([np.einsum("ij,ij->i", along, np.cross(x, y)) for x, y in ((a, b), (b, c), (c, a))], axis=1)
    total = np.abs(sides).sum(axis=1, keepdims=True)
    return (sides >= -1e-9 * total).all(axis=1) | (sides <= 1e-9 * total).all(axis=1)


def _overlap(p: _Floats, q: _Floats, normal: _Floats, tolerance: float) -> npt.NDArray[np.bool]:
    """Returns whether coplanar triangles (n, 3, 3) overlap: no edge of either is a separating axis."""
    candidates = np.arange(len(p))
    for use_p in (True, False):
        for i in range(3):
            shape = (p if use_p else q)[candidates]
            side = np.cross(shape[:, (i + 1) % 3] - shape[:, i], normal[candidates])
            reach = tolerance * np.sqrt(np.einsum("ij,ij->i", side, side))
            s, t = (np.matmul(x[candidates], side[:, :, None])[:, :, 0] for x in (p, q))
            apart = (s.min(axis=1) > t.max(axis=1) - reach) | (t.min(axis=1) > s.max(axis=1) - reach)
            candidates = candidates[~apart]
    overlap = np.zeros(len(p), dtype=bool)
    overlap[candidates] = True
    return overlap
