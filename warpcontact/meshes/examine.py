"""Examination of triangle arrays: all errors, warnings and facts of a mesh.

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

from warpcontact.meshes.mesh_warnings import notes_of, warnings_of
from warpcontact.meshes.overlap import MOST_FACES, intersections
from warpcontact.meshes.report import MeshReport, listed
from warpcontact.meshes.topology import examine_surface, representatives, seen_from, slenderness

# Warp's closest-point queries skip a face whose |cross|/Σe² is below this (sliver detection in its mesh.h).
SLIVER_LIMIT = 1.0e-6
# float32, in which Warp stores vertices, resolves 6 cm at this distance [m]: no contact is meaningful there.
COORDINATE_LIMIT = 1.0e6


def examine(
    vertices: npt.ArrayLike, faces: npt.ArrayLike, name: str = "mesh", *, overlaps: bool = False
) -> MeshReport:
    """Examines any vertices and faces. All problems are listed in ``errors``; no exception is raised.

    Args:
        vertices: Positions, (V, 3) real numbers [m].
        faces: Three vertex indices of each triangle, (F, 3) integers.
        name: Name for the report.
        overlaps: Whether to search for intersecting faces, which about doubles the run time. Skipped for more than
            100 000 faces.

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

    found = (
        _problem(~finite, "vertices", "not finite", vertex, "finite numbers"),
        _problem(finite & ~near, "vertices", "too far away", vertex, f"within ±{COORDINATE_LIMIT:g} m"),
        _problem(~in_range, "faces", "out of index range", face, f"vertex indices 0 to {len(v) - 1}"),
        _problem(slivers, "faces", "degenerate", sliver, f'{SLIVER_LIMIT:g} or more; repair="degenerate"'),
        _problem(copies, "faces", "duplicate", duplicate, 'one face for three points; repair="duplicate"'),
        _problem(clash, "edges", "wound inconsistently", edge, 'one face in each direction; repair="orient"'),
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


def _problem(bad: npt.NDArray[np.bool], noun: str, what: str, describe: Callable[[int], str], allowed: str) -> str:
    """Returns a sentence about the ``bad`` entries; empty if there are none."""
    count = int(bad.sum())
    if not count:
        return ""
    verb, first = "is" if count == 1 else "are", describe(int(bad.argmax()))
    return f"{count} of {len(bad)} {noun} {verb} {what}, first: {first}; allowed: {allowed}"


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
