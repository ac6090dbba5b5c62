"""Self-intersections, and the defects that a report distinguishes."""

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from test_meshes import OUTWARD, TETRAHEDRON, joined, moved, soup

from warpcontact.meshes import Mesh, MeshError, box, grid, icosphere, load_mesh, sinusoidal_terrain
from warpcontact.meshes.examine import examine, intersections


def det(a, b, c):
    minors = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]]
    return sum(x * minor for x, minor in zip(a, minors, strict=True))


def sign(a, b, c, d):
    """Side of abc on which d lies, in exact arithmetic."""
    rows = [[Fraction(float(x)) - Fraction(float(y)) for x, y in zip(p, a, strict=True)] for p in (b, c, d)]
    value = det(*rows)
    return (value > 0) - (value < 0)


def cut_exactly(p, q):
    """Whether an edge of one triangle passes through the interior of the other one."""
    for s, t in ((p, q), (q, p)):
        for i in range(3):
            tail, head = s[i], s[(i + 1) % 3]
            if sign(*t, tail) * sign(*t, head) < 0:
                around = {sign(tail, head, t[j], t[(j + 1) % 3]) for j in range(3)}
                if len(around) == 1 and 0 not in around:
                    return True
    return False


@pytest.mark.parametrize("seed", range(3))
def test_self_intersections_match_exact_arithmetic(seed):
    rng = np.random.default_rng(seed)
    centres = rng.uniform(0, 1, (40, 1, 3))
    corners = centres + rng.normal(0, 0.2, (40, 3, 3)) * rng.uniform(0.2, 2, (40, 1, 1))
    v, f = corners.reshape(-1, 3), np.arange(120).reshape(-1, 3)
    expected = [(i, j) for i, j in combinations(range(40), 2) if cut_exactly(corners[i], corners[j])]
    assert len(expected) > 15
    assert intersections(v, f).tolist() == [list(pair) for pair in expected]
    assert Mesh(v, f).self_intersections().tolist() == [list(pair) for pair in expected]


@pytest.mark.parametrize(
    "mesh",
    [box(), icosphere(0.5, 3), grid((1, 1), (9, 7)), sinusoidal_terrain(cells=(40, 40)), box((1e-3, 1, 100))],
)
def test_valid_surfaces_have_no_self_intersections(mesh):
    assert len(mesh.self_intersections()) == 0
    assert len(Mesh(*soup(mesh)).self_intersections()) == 0


@pytest.mark.parametrize(
    ("offset", "cuts"),
    [
        ((0.5, 0.5, 0.5), True),
        ((0.5, 0, 0), True),  # edges on faces everywhere: they overlap in planes
        ((1, 0.3, 0.2), True),
        ((1, 1, 0), False),  # they share an edge
        ((1, 1, 1), False),  # a vertex
        ((1 + 1e-9, 1, 0.5), False),
        ((2, 0, 0), False),
        ((0, 0, 0.9999), True),
    ],
)
def test_intersection_of_two_boxes_is_detected(offset, cuts):
    mesh = Mesh(*joined(box(), moved(box(), offset)))
    assert (len(mesh.self_intersections()) > 0) == cuts


def test_overlapping_faces_with_shared_vertices_are_detected():
    fold = [(0, 0, 0), (1, 0, 0), (0.5, 1, 0), (0.5, 0.5, 0)]
    assert intersections(np.array(fold), np.array([(0, 1, 2), (1, 0, 3)])).tolist() == [[0, 1]]
    flat = [(0, 0, 0), (1, 0, 0), (0.5, 1, 0), (0.5, -0.5, 0)]
    assert not len(intersections(np.array(flat), np.array([(0, 1, 2), (1, 0, 3)])))
    fin = np.array([(0, 0, 0), (2, 0, 0), (0, 2, 0), (0.5, 0.5, -1), (0.5, 0.6, 1)])
    assert intersections(fin, np.array([(0, 1, 2), (0, 3, 4)])).tolist() == [[0, 1]]
    beside = fin + np.array([(0, 0, 0)] * 3 + [(-2, -2, 0)] * 2)
    assert not len(intersections(beside, np.array([(0, 1, 2), (0, 3, 4)])))


def test_self_intersections_are_invariant_to_scale_and_position():
    v, f = joined(box(), moved(box(), (0.5, 0.25, 0.125)))
    count = len(intersections(v, f))
    for factor, offset in ((1e-6, 0.0), (1e5, 0.0), (1.0, 1e3)):
        assert len(intersections(factor * v + offset, f)) == count


def test_mesh_with_too_many_close_faces_is_not_examined(monkeypatch):
    monkeypatch.setattr("warpcontact.meshes.examine._MAX_PAIRS", 100)
    mesh = icosphere(1.0, 3)
    assert examine(mesh.vertices, mesh.faces, overlaps=True).self_intersection_count is None
    with pytest.raises(MeshError, match="too many faces close to each other"):
        mesh.self_intersections()


def test_report_of_a_file_counts_intersecting_pairs(shared_data):
    report = load_mesh(shared_data / "meshes" / "Duck.glb").report
    assert report.self_intersection_count == 4
    assert any(
        text.startswith("4 pairs of faces cut each other or overlap, first: faces") for text in report.warnings
    )
    assert box().report.self_intersection_count is None
    assert "self-intersections     not examined" in box().report.to_text()


@pytest.mark.parametrize(
    ("vertices", "faces", "kinds"),
    [
        (*joined(box()), ("closed",)),
        (*joined(box().flipped()), ("closed", "inward")),
        (*joined(grid()), ("open",)),
        (*joined(box(), moved(box(), 3.0)), ("closed", "multi-component")),
        (*joined(box((3, 3, 3)), box().flipped()), ("closed", "multi-component", "nested")),
        (*joined(box(), moved(box(), 0.5)), ("closed", "self-overlapping", "multi-component")),
        (*joined(box(), moved(box(), 1.0)), ("closed", "non-manifold vertices", "multi-component")),
        (*joined(box((200, 1, 1))), ("closed", "huge")),
        (*joined(box((1e-4, 1e-4, 1e-4))), ("closed", "tiny")),
        (TETRAHEDRON, [*OUTWARD, OUTWARD[0]], ("closed", "duplicate faces")),
        (TETRAHEDRON, [*OUTWARD, (0, 0, 1)], ("closed", "degenerate faces")),
        (TETRAHEDRON, [OUTWARD[0][::-1], *OUTWARD[1:]], ("closed", "mixed winding")),
        ([*TETRAHEDRON, (0, 0, -1)], [*OUTWARD, (0, 4, 1), (1, 4, 2), (2, 4, 0)], ("non-manifold edges",)),
        (TETRAHEDRON, np.empty((0, 3), dtype=int), ()),
    ],
)
def test_mesh_kinds_are_classified(vertices, faces, kinds):
    report = examine(vertices, faces, overlaps=True)
    assert report.kinds == kinds
    assert f"kind                   {', '.join(kinds) or 'none'}" in report.to_text()


def test_components_touching_at_a_vertex_are_reported():
    # Two tetrahedra share a vertex; two strips of a sheet do.
    v, f = joined(Mesh(TETRAHEDRON, OUTWARD), Mesh(-TETRAHEDRON, OUTWARD[:, ::-1]))
    assert examine(v, f).non_manifold_vertex_count == 1
    assert examine(v + np.repeat([0, 1.0], 4)[:, None], f).non_manifold_vertex_count == 0
    sheet = grid((1, 1), (2, 2))
    assert sheet.report.non_manifold_vertex_count == 0
    corner = examine(sheet.vertices, sheet.faces[[0, 1, 6, 7]])
    assert corner.non_manifold_vertex_count == 1


def test_components_are_identified_by_their_first_face():
    report = examine(*joined(grid(), moved(box(), 3.0), moved(box().flipped(), 6.0)))
    found = [(p.first_face, p.face_count, p.closed, p.inside) for p in report.components]
    assert found == [(0, 2, False, None), (2, 12, True, None), (14, 12, True, None)]
    assert report.components[0].volume is None
    assert [p.volume for p in report.components[1:]] == pytest.approx([1.0, -1.0])
