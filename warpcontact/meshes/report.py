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
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.meshes.topology import Orientation, examine_surface, representatives, slenderness

# Warp's closest-point queries skip a face whose |cross|/Σe² is below this (sliver detection in its mesh.h).
SLIVER_LIMIT = 1.0e-6
# float32, in which Warp stores vertices, resolves 6 cm at this distance [m]: no contact is meaningful there.
COORDINATE_LIMIT = 1.0e6
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
            "border": f"{_count(self.border_edge_count, 'edge')} in {_count(self.border_loop_count, 'loop')}",
            "crack vertices": f"{self.crack_vertex_count}",
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
    ratio[placed] = slenderness(v[index[placed]])
    with np.errstate(all="ignore"):  # underflow of float32 is one of the things looked for
        ratio32[placed] = slenderness(v[index[placed]].astype(np.float32))

    welded = representatives(v)
    corners = welded[index]
    sound = np.flatnonzero(placed & (corners != corners[:, [1, 2, 0]]).all(axis=1))
    original = np.arange(len(f))
    original[sound] = sound[representatives(np.sort(corners[sound], axis=1))]
    # A copy in the other direction stays: in a folded sheet some of the neighbours belong to it.
    turn = corners[sound].argmin(axis=1)[:, None] + np.arange(3)
    oriented = representatives(np.take_along_axis(corners[sound], turn % 3, axis=1))
    sound = sound[oriented == np.arange(len(sound))]
    facts, clash, halves = examine_surface(v, corners[sound])
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


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _tuple(values: Any) -> str:
    return "(" + ", ".join(f"{value:.9g}" if isinstance(value, float) else str(value) for value in values) + ")"
