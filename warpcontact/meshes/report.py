"""Report on a triangle mesh, as data and as text; warnings and notes as sentences made from its facts."""

from dataclasses import dataclass, replace
from typing import Any

from warpcontact.kernels.catalogue.names import explain_renamed
from warpcontact.meshes.topology import Component, Orientation
from warpcontact.validation.safe_text import escape_controls

# Largest dimensions outside this range [m] usually indicate a file in millimeters or inches.
USUAL_SIZE = (1.0e-3, 1.0e2)


@dataclass(frozen=True)
class RepairStep:
    """Changes made by one step of a repair.

    Attributes:
        step: Name of the step, one of ``warpcontact.meshes.REPAIRS``.
        count: Number of vertices or faces merged, removed or flipped; 0 if nothing changed.
        distance: Largest displacement of a vertex [m].
        text: Description as a sentence.
    """

    step: str
    count: int
    distance: float
    text: str


@explain_renamed
@dataclass(frozen=True)
class MeshReport:
    """Facts about a triangle mesh; lengths in m, areas in m², volumes in m³.

    Attributes:
        name: Name of the mesh.
        vertex_count: Number of vertices of the input.
        face_count: Number of faces of the input.
        welded_vertex_count: Number of distinct vertex positions.
        edge_count: Number of edges of the welded surface.
        lower: Smallest x, y, z of the vertices used by faces (of all, if there are no faces) [m].
        upper: Largest x, y, z of the same vertices [m].
        area: Surface area [m²].
        volume: Signed volume [m³], positive if the faces are oriented outward; ``None`` unless the surface is closed
            and consistently wound.
        closed: Whether each edge belongs to an even number of faces, so that the surface bounds a volume.
        boundary_edge_count: Number of edges with one face only.
        boundary_loop_count: Number of connected curves of boundary edges.
        crack_vertex_count: Number of boundary vertices within 1e-6 of the mesh size of another one, not coincident.
        component_count: Number of parts of the surface, connected across edges.
        components: The first 100 parts, in the order of their first faces.
        inward_component_count: Number of closed parts with negative volume: cavities, or inverted parts.
        outward_component_count: Number of closed parts with positive volume.
        orientation: Orientation of the faces. "mixed": neighboring faces disagree. "undefined": no valid face, or a
            closed surface without volume. For several closed parts the sign of the total volume decides.
        inconsistent_edge_count: Number of edges that their two faces traverse in the same direction.
        non_manifold_edge_count: Number of edges with more than two faces.
        non_manifold_vertex_count: Number of vertices at which parts of the surface meet in a single point.
        self_intersection_count: Number of pairs of faces that intersect or overlap in a plane; ``None``: not
            examined, as for meshes that are not from files, and for large ones.
        first_intersection: Faces of the first of these pairs, if there is one.
        duplicate_face_count: Number of faces with the same three vertices as an earlier one, in any order.
        degenerate_face_count: Number of faces with coincident vertices or |cross|/Σe² below 1e-6.
        float32_sliver_count: Number of further faces that are degenerate in float32, the precision of Warp's search.
        unreferenced_vertex_count: Number of vertices not used by any face.
        coincident_vertex_count: Number of vertices at exactly the position of an earlier one.
        euler_number: Vertices − edges + faces of the welded surface; 2 for a sphere, 1 for a disk.
        shortest_edge: Smallest edge length [m].
        longest_edge: Largest edge length [m].
        groups: Name and number of faces of each group.
        active_face_count: Number of active faces; ``None``: no selection was given.
        active_area: Area of the active faces [m²]; ``None``: no selection was given.
        repairs: Repair steps executed on request; all other fields describe the result.
        errors: Reasons why the mesh cannot be used, one sentence each; empty for a usable mesh.
        warnings: Possible problems, one sentence each.
        notes: Normal properties of possible interest, one sentence each.
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
    boundary_edge_count: int = 0
    boundary_loop_count: int = 0
    crack_vertex_count: int = 0
    component_count: int = 0
    components: tuple[Component, ...] = ()
    inward_component_count: int = 0
    outward_component_count: int = 0
    orientation: Orientation = "undefined"
    inconsistent_edge_count: int = 0
    non_manifold_edge_count: int = 0
    non_manifold_vertex_count: int = 0
    self_intersection_count: int | None = None
    first_intersection: tuple[int, int] | None = None
    duplicate_face_count: int = 0
    degenerate_face_count: int = 0
    float32_sliver_count: int = 0
    unreferenced_vertex_count: int = 0
    coincident_vertex_count: int = 0
    euler_number: int = 0
    shortest_edge: float = 0.0
    longest_edge: float = 0.0
    groups: tuple[tuple[str, int], ...] = ()
    active_face_count: int | None = None
    active_area: float | None = None
    repairs: tuple[RepairStep, ...] = ()
    errors: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether a :class:`~warpcontact.meshes.Mesh` can be created."""
        return not self.errors

    @property
    def size(self) -> tuple[float, float, float]:
        """Extent of the bounding box along x, y, z [m]."""
        x, y, z = (high - low for low, high in zip(self.lower, self.upper, strict=True))
        return x, y, z

    @property
    def nested_components(self) -> tuple[int, ...]:
        """Indices of the ``components`` that lie inside another one."""
        return tuple(i for i, part in enumerate(self.components) if part.inside is not None)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Properties of the mesh as keywords, those that apply in a fixed order.

        The order is closed, open, inward, mixed winding, non-manifold edges, non-manifold vertices, self-overlapping,
        duplicate faces, degenerate faces, cracked, multi-component, nested, tiny, huge. A closed surface with an
        interior wall (an edge with three faces) is neither closed nor open.
        """
        few, many = USUAL_SIZE
        words = {
            "closed": self.closed,
            "open": self.boundary_edge_count > 0,
            "inward": self.orientation == "inward",
            "mixed winding": self.orientation == "mixed" or self.inconsistent_edge_count > 0,
            "non-manifold edges": self.non_manifold_edge_count > 0,
            "non-manifold vertices": self.non_manifold_vertex_count > 0,
            "self-overlapping": bool(self.self_intersection_count),
            "duplicate faces": self.duplicate_face_count > 0,
            "degenerate faces": self.degenerate_face_count > 0,
            "cracked": self.crack_vertex_count > 0,
            "multi-component": self.component_count > 1,
            "nested": bool(self.nested_components),
            "tiny": self.component_count > 0 and max(self.size) < few,
            "huge": max(self.size) > many,
        }
        return tuple(word for word, holds in words.items() if holds)

    def to_text(self) -> str:
        """Returns the report as aligned lines, without a final newline."""
        cuts = self.self_intersection_count
        rows = {
            "usable": "yes" if self.usable else "no",
            "kind": ", ".join(self.kinds) or "none",
            "vertices": f"{self.vertex_count} ({self.welded_vertex_count} after welding)",
            "faces": f"{self.face_count}",
            "edges": f"{self.edge_count}, {self.shortest_edge:.6g} to {self.longest_edge:.6g} m",
            "size": " × ".join(f"{length:.6g}" for length in self.size) + " m",
            "bounds": f"{listed(self.lower)} to {listed(self.upper)} m",
            "area": f"{self.area:.6g} m²",
            "volume": "none" if self.volume is None else f"{self.volume:.6g} m³",
            "surface": f"{'closed' if self.closed else 'not closed'}, orientation: {self.orientation}",
            "boundary": f"{counted(self.boundary_edge_count, 'edge')} in {counted(self.boundary_loop_count, 'loop')}",
            "crack vertices": f"{self.crack_vertex_count}",
            "components": f"{self.component_count} ({self.inward_component_count} closed and inward, "
            f"{len(self.nested_components)} inside another)",
            "Euler number": f"{self.euler_number}",
            "inconsistent edges": f"{self.inconsistent_edge_count}",
            "non-manifold edges": f"{self.non_manifold_edge_count}",
            "non-manifold vertices": f"{self.non_manifold_vertex_count}",
            "self-intersections": "not examined" if cuts is None else f"{counted(cuts, 'pair')} of faces",
            "duplicate faces": f"{self.duplicate_face_count}",
            "degenerate faces": f"{self.degenerate_face_count}",
            "unreferenced vertices": f"{self.unreferenced_vertex_count}",
            "coincident vertices": f"{self.coincident_vertex_count}",
            "groups": self._groups(),
        }
        if self.active_face_count is not None:
            faces = f"{self.active_face_count} of {self.face_count}"
            rows["active faces"] = f"{faces}, {self.active_area:.6g} of {self.area:.6g} m²"
        lines = [f"mesh {self.name!r}"] + [f"  {label:<22} {value}" for label, value in rows.items()]
        blocks = {
            "errors": self.errors,
            "repairs": tuple(step.text for step in self.repairs),
            "warnings": self.warnings,
            "notes": self.notes,
        }
        for title, entries in blocks.items():
            lines += [title, *(f"  - {entry}" for entry in entries)] if entries else []
        return escape_controls("\n".join(lines))

    def _groups(self) -> str:
        shown = [f"{name!r} ({counted(count, 'face')})" for name, count in self.groups[:20]]
        more = [f"and {len(self.groups) - 20} more"] if len(self.groups) > 20 else []
        return ", ".join(shown + more) or "none"


def restored(plain: dict[str, Any]) -> MeshReport:
    """Returns the report from its ``dataclasses.asdict`` form after JSON, which turns tuples into lists."""
    fields = {name: _tuples(value) for name, value in plain.items()}
    fields["components"] = tuple(Component(**part) for part in plain["components"])
    fields["repairs"] = tuple(RepairStep(**step) for step in plain["repairs"])
    return MeshReport(**fields)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def counted(number: int, noun: str) -> str:
    """Returns number and noun, such as ``3 faces``."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def listed(values: Any) -> str:
    """Returns numbers in parentheses, separated by commas."""
    return "(" + ", ".join(f"{value:.9g}" if isinstance(value, float) else str(value) for value in values) + ")"


# Largest number of nested components that are listed.
_NAMED = 5


def warnings_of(report: MeshReport) -> tuple[str, ...]:
    """Returns the warnings for a mesh."""
    parts, inward, size = report.component_count, report.inward_component_count, max(report.size)
    boundary, loops = (
        counted(report.boundary_edge_count, "boundary edge"),
        counted(report.boundary_loop_count, "loop"),
    )
    void = report.closed and report.orientation == "undefined" and parts > 0
    few, many = USUAL_SIZE
    cut = report.first_intersection
    remarks = {
        f"the surface is open: {boundary} in {loops}": report.boundary_edge_count > 0,
        f"{report.crack_vertex_count} boundary vertices nearly coincide with another one: cracks, at which "
        'contact is lost; repair="merge", or wc.meshes.repaired(mesh, "merge"), closes them': report.crack_vertex_count
        > 0,
        "the surface is closed and faces inward, like a container seen from inside; "
        "flipped() reverses it": report.orientation == "inward",
        f"{inward} of {parts} components closed and facing inward: cavities, or parts inside out": (
            inward > 0 and parts > 1
        ),
        "the surface is closed but encloses no volume": void,
        f"{counted(report.non_manifold_edge_count, 'edge')} with more than two faces (non-manifold): "
        "the outer side is ambiguous there": report.non_manifold_edge_count > 0,
        f"{counted(report.non_manifold_vertex_count, 'vertex')} at which parts of the surface touch in a point "
        "(non-manifold): the outer side is ambiguous there".replace("vertexs", "vertices"): (
            report.non_manifold_vertex_count > 0
        ),
        f"{counted(report.self_intersection_count or 0, 'pair')} of faces cut each other or overlap, first: faces "
        f"{cut and cut[0]} and {cut and cut[1]}; inside and outside are ambiguous near them": cut is not None,
        f"{parts} separate components": parts > 1,
        _nested(report): bool(report.nested_components),
        f"{report.unreferenced_vertex_count} of {report.vertex_count} vertices used by no face": (
            report.unreferenced_vertex_count > 0
        ),
        f"the largest dimension is {size:.3g} m, outside {few:g} m to {many:g} m; is the unit right? "
        '(unit="mm" for a file in mm)': parts > 0 and not few <= size <= many,
        f"{counted(report.float32_sliver_count, 'face')} too thin or small for float32, in which surfaces are "
        "searched; remove or enlarge them": report.float32_sliver_count > 0,
    }
    return tuple(remark for remark, holds in remarks.items() if holds)


def notes_of(report: MeshReport) -> tuple[str, ...]:
    """Returns notes on normal properties: an STL file repeats each vertex for each of its faces."""
    remark = f"{report.coincident_vertex_count} of {report.vertex_count} vertices coincide with another one and "
    return (f"{remark}are treated as one",) if report.coincident_vertex_count else ()


def with_inherited_warnings(old: MeshReport, new: MeshReport) -> MeshReport:
    """Returns report ``new`` of a surface derived from that of ``old``, with the inherited messages of ``old``.

    Inherited are repairs, warnings about the file, and intersections, if ``new`` did not examine them.
    """
    if new.self_intersection_count is None:
        cuts, first = old.self_intersection_count, old.first_intersection
        new = replace(new, self_intersection_count=cuts, first_intersection=first)
    old_warnings, old_notes = warnings_of(old), notes_of(old)
    return replace(
        new,
        repairs=old.repairs,
        warnings=(*(text for text in old.warnings if text not in old_warnings), *warnings_of(new)),
        notes=(*(text for text in old.notes if text not in old_notes), *notes_of(new)),
    )


def flipped(report: MeshReport) -> MeshReport:
    """Returns the report of the same surface with its sides exchanged."""
    sides: dict[Orientation, Orientation] = {"outward": "inward", "inward": "outward"}
    turned = replace(
        report,
        volume=_minus(report.volume),
        orientation=sides.get(report.orientation, report.orientation),
        inward_component_count=report.outward_component_count,
        outward_component_count=report.inward_component_count,
        components=tuple(replace(part, volume=_minus(part.volume)) for part in report.components),
    )
    return with_inherited_warnings(report, turned)


def _minus(volume: float | None) -> float | None:
    return None if volume is None else 0.0 - volume


def _nested(report: MeshReport) -> str:
    described = []
    for i in report.nested_components[:_NAMED]:
        part = report.components[i]
        side = "inward, a cavity" if (part.volume or 0.0) < 0.0 else "outward, one solid within another"
        described.append(
            f"component {i} ({counted(part.face_count, 'face')} from face {part.first_face}, {side}) in "
            f"component {part.inside}"
        )
    more = len(report.nested_components) - _NAMED
    return "components lie inside others: " + "; ".join(described) + (f"; and {more} more" if more > 0 else "")
