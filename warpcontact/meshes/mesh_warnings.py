"""Warnings and notes about a mesh, as sentences made from the facts of its report."""

from dataclasses import replace

from warpcontact.meshes.report import USUAL_SIZE, MeshReport, counted
from warpcontact.meshes.topology import Orientation

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
        'contact is lost; repair="merge" closes them': report.crack_vertex_count > 0,
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
