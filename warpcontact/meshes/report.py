"""What a triangle mesh is like and why it cannot be used: the one place that knows.

``wp.Mesh`` accepts anything: an index out of range or an empty mesh ends the process, a NaN vertex or a
sliver is a hole in the surface without a word. Everything is therefore examined on the host first.

Topology is that of the *welded* surface, in which vertices at exactly the same place are one (an STL file
has no other connectivity), and of its sound faces: those that refer to usable vertices, have three
different corners and are no copy of an earlier face in the same direction. The figures of a broken mesh
are those of its sound part. Self-intersection is not examined.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

Orientation = Literal["outward", "inward", "open surface", "mixed", "undefined"]

# Warp's closest-point queries skip a face whose |cross|/Σe² is below this (sliver detection in its mesh.h).
SLIVER_LIMIT = 1.0e-6
# float32, in which Warp stores vertices, resolves 6 cm at this distance [m]: no contact is meaningful there.
COORDINATE_LIMIT = 1.0e6
# Border vertices closer than this fraction of the largest dimension are meant to be one. CAD programs write
# the two sides of a seam with different rounding, and float32 resolves 1e-7.
CRACK_LIMIT = 1.0e-6
# A largest dimension outside of this range [m] usually means a file in millimetres or inches.
USUAL_SIZE = (1.0e-3, 1.0e2)


@dataclass(frozen=True)
class MeshReport:
    """Facts about a triangle mesh; lengths in m, areas in m², volumes in m³.

    Attributes:
        name: Name of the mesh.
        vertex_count: Vertices as given.
        face_count: Faces as given.
        welded_vertex_count: Different places among the vertices.
        edge_count: Edges of the welded surface.
        lower: Smallest x, y, z of the vertices that faces use (of all, if there is no face) [m].
        upper: Largest x, y, z of them [m].
        area: Surface area [m²].
        volume: Signed volume [m³], positive if the faces point outward; ``None`` unless the surface is
            closed and consistently wound.
        closed: True if every edge belongs to an even number of faces, so that the surface bounds a volume.
        border_edge_count: Edges with one face only.
        border_loop_count: Connected curves that these edges form.
        crack_vertex_count: Border vertices within 1e-6 of the size of another one, but not at its place.
        component_count: Parts of the surface, connected across edges.
        inward_component_count: Closed parts with a negative volume: cavities, or parts turned inside out.
        orientation: Where the faces point. "mixed": neighbouring faces disagree. "undefined": no sound
            face, or a closed surface without volume. For several closed parts the sign of the sum decides.
        inconsistent_edge_count: Edges that their two faces traverse in the same direction.
        non_manifold_edge_count: Edges with more than two faces.
        duplicate_face_count: Faces with the same three corners as an earlier one, in any order.
        degenerate_face_count: Faces with coincident corners or |cross|/Σe² below 1e-6.
        unreferenced_vertex_count: Vertices that no face uses.
        coincident_vertex_count: Vertices at exactly the place of an earlier one.
        euler_number: Vertices − edges + faces of the welded surface; 2 for a sphere, 1 for a disk.
        shortest_edge: Length [m].
        longest_edge: Length [m].
        errors: Why the mesh cannot be used, one sentence each; empty for a usable mesh.
        warnings: What to know before using it, one sentence each.
    """

    name: str
    vertex_count: int = 0
    face_count: int = 0
    welded_vertex_count: int = 0
    edge_count: int = 0
    lower: tuple[float, float, float] = (0.0, 0.0, 0.0)
    upper: tuple[float, float, float] = (0.0, 0.0, 0.0)
    area: float = 0.0
    volume: float | None = None
    closed: bool = False
    border_edge_count: int = 0
    border_loop_count: int = 0
    crack_vertex_count: int = 0
    component_count: int = 0
    inward_component_count: int = 0
    orientation: Orientation = "undefined"
    inconsistent_edge_count: int = 0
    non_manifold_edge_count: int = 0
    duplicate_face_count: int = 0
    degenerate_face_count: int = 0
    unreferenced_vertex_count: int = 0
    coincident_vertex_count: int = 0
    euler_number: int = 0
    shortest_edge: float = 0.0
    longest_edge: float = 0.0
    errors: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        """True if a :class:`~warpcontact.meshes.Mesh` can be made of it."""
        return not self.errors

    @property
    def size(self) -> tuple[float, float, float]:
        """Extent of the bounding box along x, y, z [m]."""
        x, y, z = (high - low for low, high in zip(self.lower, self.upper, strict=True))
        return x, y, z

    def to_text(self) -> str:
        """The report as aligned lines to read, without a final newline."""
        rows = {
            "usable": "yes" if self.usable else "no",
            "vertices": f"{self.vertex_count} ({self.welded_vertex_count} after welding)",
            "faces": f"{self.face_count}",
            "edges": f"{self.edge_count}, {self.shortest_edge:.6g} to {self.longest_edge:.6g} m",
            "size": " × ".join(f"{length:.6g}" for length in self.size) + " m",
            "bounds": f"{_tuple(self.lower)} to {_tuple(self.upper)} m",
            "area": f"{self.area:.6g} m²",
            "volume": "none" if self.volume is None else f"{self.volume:.6g} m³",
            "surface": f"{'closed' if self.closed else 'not closed'}, orientation: {self.orientation}",
            "border": f"{_count(self.border_edge_count, 'edge')} in {_count(self.border_loop_count, 'loop')}, "
            f"{_count(self.crack_vertex_count, 'crack vertex', 'crack vertices')}",
            "components": f"{self.component_count} ({self.inward_component_count} closed and inward)",
            "Euler number": f"{self.euler_number}",
        }
        for kind in ("inconsistent_edge", "non_manifold_edge", "duplicate_face", "degenerate_face"):
            rows[kind.replace("non_", "non-").replace("_", " ") + "s"] = str(getattr(self, kind + "_count"))
        rows["unreferenced vertices"] = str(self.unreferenced_vertex_count)
        rows["coincident vertices"] = str(self.coincident_vertex_count)
        lines = [f"mesh {self.name!r}"] + [f"  {label:<22} {value}" for label, value in rows.items()]
        for title, entries in (("errors", self.errors), ("warnings", self.warnings)):
            lines += [title, *(f"  - {entry}" for entry in entries)] if entries else []
        return "\n".join(lines)


def weld(vertices: npt.NDArray[np.float64]) -> npt.NDArray[np.int32]:
    """First vertex at the same place, for every vertex; the comparison is exact.

    Args:
        vertices: Positions, (V, 3) [m]. One with a NaN coincides with none.

    Returns:
        Index of the representative vertex, (V,).
    """
    return _representatives(vertices).astype(np.int32)


def examine(vertices: npt.ArrayLike, faces: npt.ArrayLike, name: str = "mesh") -> MeshReport:
    """Examine any vertices and faces; what is wrong ends up in ``errors``, never in an exception.

    Args:
        vertices: Positions, (V, 3) real numbers [m].
        faces: Three vertex indices for each triangle, (F, 3) integers.
        name: Name for the report.

    Returns:
        All facts, with every problem found.
    """
    v, vertex_error = _array(vertices, "vertices", "(V, 3)", "iuf", "real numbers")
    f, face_error = _array(faces, "faces", "(F, 3)", "iu", "integers")
    if vertex_error or face_error:
        return MeshReport(name, len(v), len(f), errors=vertex_error + face_error)
    with np.errstate(over="ignore"):  # a longdouble beyond float64 becomes inf, which is refused below
        v = v.astype(np.float64)
    finite: npt.NDArray[np.bool] = np.all(np.isfinite(v), axis=1)
    near: npt.NDArray[np.bool] = np.all(np.abs(v) <= COORDINATE_LIMIT, axis=1)  # false for NaN
    # Before the cast, which wraps large unsigned numbers.
    known: npt.NDArray[np.bool] = np.all((f >= 0) & (f < len(v)), axis=1)
    index = np.where(known[:, None], f, 0).astype(np.int64)
    placed = known & near[index].all(axis=1)
    ratio, ratio32 = np.full(len(f), np.inf), np.full(len(f), np.inf)
    ratio[placed] = _slenderness(v[index[placed]])
    with np.errstate(all="ignore"):  # underflow of float32 is one of the things looked for
        ratio32[placed] = _slenderness(v[index[placed]].astype(np.float32))

    welded = _representatives(v)
    corners = welded[index]
    sound = np.flatnonzero(placed & (corners != corners[:, [1, 2, 0]]).all(axis=1))
    original = np.arange(len(f))
    original[sound] = sound[_representatives(np.sort(corners[sound], axis=1))]
    # A copy in the other direction stays: in a folded sheet some of the neighbours belong to it.
    turn = corners[sound].argmin(axis=1)[:, None] + np.arange(3)
    oriented = _representatives(np.take_along_axis(corners[sound], turn % 3, axis=1))
    sound = sound[oriented == np.arange(len(sound))]
    facts, clash, halves = _surface(v, corners[sound])
    used = np.zeros(len(v), dtype=bool)
    used[index[known]] = True

    def vertex(i: int) -> str:
        return f"vertex {i} at {_tuple(v[i])}"

    def face(i: int) -> str:
        return f"face {i} with vertices {_tuple(f[i])}"

    def sliver(i: int) -> str:
        return f"{face(i)} and |cross|/Σe² = {ratio[i]:.3g}"

    def duplicate(i: int) -> str:
        return f"{face(i)} has the corners of face {original[i]}"

    def edge(i: int) -> str:
        (here, there), corner = halves[i] // 3, halves[i][0] % 3
        tail, head = np.roll(corners[sound[here]], -corner)[:2]
        return f"faces {sound[here]} and {sound[there]} both run from vertex {tail} to vertex {head}"

    slivers, copies = ratio < SLIVER_LIMIT, original != np.arange(len(f))
    found = (
        _problem(~finite, "vertices", "not finite", vertex, "finite numbers"),
        _problem(finite & ~near, "vertices", "too far away", vertex, f"within ±{COORDINATE_LIMIT:g} m"),
        _problem(~known, "faces", "out of index range", face, f"vertex indices 0 to {len(v) - 1}"),
        _problem(slivers, "faces", "degenerate", sliver, f"{SLIVER_LIMIT:g} or more"),
        _problem(copies, "faces", "duplicate", duplicate, "one face for three points"),
        _problem(clash, "edges", "wound inconsistently", edge, "one face in each direction"),
    )
    box = v[near & used] if (near & used).any() else np.zeros((1, 3))
    report = MeshReport(
        name,
        vertex_count=len(v),
        face_count=len(f),
        welded_vertex_count=len(np.unique(welded)),
        lower=tuple(box.min(axis=0).tolist()),
        upper=tuple(box.max(axis=0).tolist()),
        inconsistent_edge_count=int(clash.sum()),
        duplicate_face_count=int(copies.sum()),
        degenerate_face_count=int(slivers.sum()),
        unreferenced_vertex_count=int((~used).sum()),
        coincident_vertex_count=int((welded != np.arange(len(v))).sum()),
        errors=tuple(problem for problem in found if problem),
        **facts,
    )
    lost = int((~slivers & ~(ratio32 >= np.float32(SLIVER_LIMIT))).sum())
    return replace(report, warnings=_warnings(report, lost))


def _surface(
    v: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]
) -> tuple[dict[str, Any], npt.NDArray[np.bool], npt.NDArray[np.intp]]:
    """Facts of a sound welded surface; its edges wound inconsistently; two half-edges of every edge.

    Half-edge 3·i + j runs from corner j of face i to the next corner.
    """
    if not len(faces):
        return {}, np.zeros(0, dtype=bool), np.empty((0, 2), dtype=np.intp)
    ends = np.stack((faces, faces[:, [1, 2, 0]]), axis=2).reshape(-1, 2)
    order, starts = _groups(np.sort(ends, axis=1))
    counts = np.diff(starts, append=len(order))
    balance = np.add.reduceat(np.where(ends[:, 0] < ends[:, 1], 1, -1)[order], starts)
    first = order[starts]
    halves = np.column_stack((first, np.roll(order, -1)[starts]))

    edge = np.repeat(np.arange(len(starts)), counts)
    neighbours = np.column_stack((order[:-1], order[1:]))[edge[:-1] == edge[1:]] // 3
    parts, part = _components(neighbours, len(faces))
    loops, cracks = _border(v, ends[first[counts == 1]], CRACK_LIMIT * float(np.ptp(v[faces], axis=(0, 1)).max()))

    p = v[faces] - 0.5 * (v[faces].min(axis=(0, 1)) + v[faces].max(axis=(0, 1)))  # centred for precision
    normals = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    area = 0.5 * float(np.linalg.norm(normals, axis=1).sum())
    volumes = np.bincount(part, np.einsum("ij,ij->i", normals, p[:, 0]) / 6.0, parts)
    nothing = 1e-12 * area * float(np.abs(p).max())  # rounding of a volume that is zero
    odd, mixed = counts % 2 == 1, (counts % 2 == 0) & (balance != 0)
    bounding = np.ones(parts, dtype=bool)
    bounding[part[first[odd | mixed] // 3]] = False
    total = float(volumes.sum())
    orientation: Orientation = "undefined"
    if mixed.any():
        orientation = "mixed"
    elif odd.any():
        orientation = "open surface"
    elif abs(total) > nothing:
        orientation = "outward" if total > 0.0 else "inward"
    lengths = np.linalg.norm(v[ends[first, 0]] - v[ends[first, 1]], axis=1)
    facts = {
        "edge_count": len(starts),
        "area": area,
        "volume": None if (odd | mixed).any() else total,
        "closed": not odd.any(),
        "border_edge_count": int((counts == 1).sum()),
        "border_loop_count": loops,
        "crack_vertex_count": cracks,
        "component_count": parts,
        "inward_component_count": int((bounding & (volumes < -nothing)).sum()),
        "orientation": orientation,
        "non_manifold_edge_count": int((counts > 2).sum()),
        "euler_number": len(np.unique(faces)) - len(starts) + len(faces),
        "shortest_edge": float(lengths.min()),
        "longest_edge": float(lengths.max()),
    }
    return facts, (counts == 2) & (balance != 0), halves


def _border(v: npt.NDArray[np.float64], edges: npt.NDArray[np.intp], near: float) -> tuple[int, int]:
    """Number of loops of border edges (n, 2), and of their vertices with another one within ``near``."""
    from scipy.spatial import KDTree

    if not len(edges):
        return 0, 0
    vertices, links = np.unique(edges, return_inverse=True)
    distances, _ = KDTree(v[vertices]).query(v[vertices], k=2, distance_upper_bound=near)
    return _components(links.reshape(-1, 2), len(vertices))[0], int(np.isfinite(distances[:, 1]).sum())


def _components(links: npt.NDArray[np.intp], count: int) -> tuple[int, npt.NDArray[np.int32]]:
    """Number of connected parts of ``count`` items with links (n, 2), and the part of each item."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(links), dtype=bool), links.T), shape=(count, count))
    return connected_components(graph, directed=False)


def _warnings(report: MeshReport, lost: int) -> tuple[str, ...]:
    """What to know of a mesh before using it; ``lost`` faces are slivers in float32 only."""
    parts, inward, size = report.component_count, report.inward_component_count, max(report.size)
    border, loops = _count(report.border_edge_count, "border edge"), _count(report.border_loop_count, "loop")
    void = report.closed and report.orientation == "undefined" and parts > 0
    few, many = USUAL_SIZE
    notes = {
        f"the surface is open: {border} in {loops}": report.border_edge_count > 0,
        f"{report.crack_vertex_count} border vertices nearly coincide with another one: cracks, at which "
        "contact is lost; np.round(vertices, digits) closes them": report.crack_vertex_count > 0,
        "the surface is closed and faces inward, like a container seen from inside; "
        "flipped() turns it": report.orientation == "inward",
        f"{inward} of {parts} components closed and facing inward: cavities, or parts inside out": (
            inward > 0 and parts > 1
        ),
        "the surface is closed but encloses no volume": void,
        f"{_count(report.non_manifold_edge_count, 'edge')} with more than two faces (non-manifold): "
        "no side of the surface is the outer one there": report.non_manifold_edge_count > 0,
        f"{parts} separate components": parts > 1,
        f"{report.unreferenced_vertex_count} of {report.vertex_count} vertices used by no face": (
            report.unreferenced_vertex_count > 0
        ),
        f"{report.coincident_vertex_count} of {report.vertex_count} vertices coincide with another one and "
        "are taken as one with it": report.coincident_vertex_count > 0,
        f"the largest dimension is {size:.3g} m, outside {few:g} m to {many:g} m; is the unit right? "
        "(scale=0.001 for a file in mm)": parts > 0 and not few <= size <= many,
        f"{_count(lost, 'face')} too thin or small for float32, which Warp will pass over; "
        "move the mesh to its origin or enlarge them": lost > 0,
    }
    return tuple(note for note, holds in notes.items() if holds)


def _problem(bad: npt.NDArray[np.bool], noun: str, what: str, describe: Callable[[int], str], allowed: str) -> str:
    """One sentence on the ``bad`` entries; empty if there is none."""
    count = int(bad.sum())
    if not count:
        return ""
    verb, first = "is" if count == 1 else "are", describe(int(bad.argmax()))
    return f"{count} of {len(bad)} {noun} {verb} {what}, first: {first}; allowed: {allowed}"


def _array(
    values: npt.ArrayLike, label: str, shape: str, kinds: str, numbers: str
) -> tuple[npt.NDArray[Any], tuple[str, ...]]:
    """``values`` as an (n, 3) array, empty if it is none, and why it is not usable."""
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


def _groups(rows: npt.NDArray[Any]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Order (stable) that brings equal rows together, and where in it each group starts."""
    order = np.lexsort(rows.T)
    ordered = rows[order]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return order, np.flatnonzero(new)


def _representatives(rows: npt.NDArray[Any]) -> npt.NDArray[np.intp]:
    """Index of the first row equal to each row."""
    order, starts = _groups(rows)
    first = np.empty(len(rows), dtype=np.intp)
    first[order] = np.repeat(order[starts], np.diff(starts, append=len(order)))
    return first


def _slenderness(corners: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """|cross|/Σe² of triangles (n, 3, 3), in their precision; 0 for a point, 0.29 at most."""
    a, b, c = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], corners[:, 2] - corners[:, 1]
    squares = sum(np.einsum("ij,ij->i", e, e) for e in (a, b, c))
    return np.linalg.norm(np.cross(a, b), axis=1) / np.where(squares > 0.0, squares, 1.0)


def _count(number: int, noun: str, plural: str = "") -> str:
    return f"{number} {noun if number == 1 else plural or noun + 's'}"


def _tuple(values: Any) -> str:
    return "(" + ", ".join(f"{value:.9g}" if isinstance(value, float) else str(value) for value in values) + ")"
