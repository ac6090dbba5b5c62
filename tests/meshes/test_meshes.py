"""Meshes: rejected input, reports, and generators."""

import copy
import pickle
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from warpcontact import meshes
from warpcontact.meshes import Mesh, MeshError, box, grid, icosphere, sinusoidal_terrain
from warpcontact.meshes.examine import examine

TETRAHEDRON = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
OUTWARD = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])


def changed(array, index, value):
    """A copy with one entry replaced."""
    array = np.array(array)
    array[index] = value
    return array


def joined(*parts):
    """Vertices and faces of several meshes in one."""
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False)]
    return np.concatenate([part.vertices for part in parts]), np.concatenate(faces)


def moved(mesh, offset):
    return Mesh(mesh.vertices + offset, mesh.faces)


def soup(mesh):
    """The arrays of an STL file: separate vertices for every face."""
    return mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3)


def outward_solid_angle(mesh):
    """Sum of the solid angles of the faces seen from the origin; 4π for an outward surface around it."""
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    above = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", x, y) for x, y in ((a, b), (b, c), (c, a))]
    return 2.0 * np.arctan2(above, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb).sum()


# Rejected input


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (TETRAHEDRON[:, :2], OUTWARD, r"vertices must have shape \(V, 3\), got \(4, 2\)"),
        (TETRAHEDRON, OUTWARD.ravel(), r"faces must have shape \(F, 3\), got \(12,\)"),
        ([(0, 0, 0), (1, 0)], OUTWARD, r"vertices must be an array of shape \(V, 3\)"),
        (None, OUTWARD, r"vertices must have shape \(V, 3\), got \(\)"),
        (TETRAHEDRON.astype(complex), OUTWARD, "vertices must hold real numbers, got complex128"),
        (TETRAHEDRON.astype(str), OUTWARD, "vertices must hold real numbers, got <U32"),
        (TETRAHEDRON, OUTWARD.astype(float), "faces must hold integers, got float64"),
        (TETRAHEDRON, OUTWARD.astype(bool), "faces must hold integers, got bool"),
        (np.empty((0, 3)), OUTWARD, "it has no vertices"),
        (TETRAHEDRON, np.empty((0, 3), dtype=int), "it has no faces"),
        (changed(TETRAHEDRON, (3, 2), np.nan), OUTWARD, r"1 of 4 .* not finite, first: vertex 3 at \(0, 0, nan\)"),
        (changed(TETRAHEDRON, (1, 0), -np.inf), OUTWARD, r"not finite, first: vertex 1 at \(-inf, 0, 0\)"),
        (changed(TETRAHEDRON, (1, 0), 1.1e6), OUTWARD, r"1 of 4 vertices is too far away, .*within ±1e\+06 m"),
        (changed(TETRAHEDRON, (1, 0), 1e300), OUTWARD, r"too far away, first: vertex 1 at \(1e\+300, 0, 0\)"),
        (
            TETRAHEDRON,
            changed(OUTWARD, (2, 1), 4),
            r"index range, first: face 2 .* \(1, 4, 3\); .* indices 0 to 3",
        ),
        (TETRAHEDRON, changed(OUTWARD, (3, 0), -1), r"out of index range, first: face 3 .* \(-1, 3, 2\)"),
        (TETRAHEDRON, changed(OUTWARD.astype("u8"), 0, 2**64 - 1), r"index range, .* \(18446744073709551615, "),
        (TETRAHEDRON, changed(OUTWARD, (1, 1), 0), r"1 of 4 faces is degenerate, first: face 1 .* \(0, 0, 3\)"),
        ([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 1, 2)], r"degenerate, .*= 0; allowed: 1e-06 or more"),
        ([(0, 0, 0), (0, 0, 0), (0, 0, 0)], [(0, 1, 2)], "1 of 1 faces is degenerate"),
        (TETRAHEDRON, [*OUTWARD, (1, 0, 2)], r"1 of 5 .* duplicate, first: face 4 .* has the vertices of face 0"),
        (TETRAHEDRON, [*OUTWARD, (0, 1, 2)], "1 of 5 faces is duplicate"),
        (
            TETRAHEDRON,
            changed(OUTWARD, 2, (1, 3, 2)),
            r"3 of 6 edges are wound inconsistently, first: faces \d and .*; wc\.meshes\.repaired\(mesh, \"orient\"\) of",
        ),
    ],
)
def test_invalid_mesh_is_refused_with_entry_value_and_allowed_values(vertices, faces, message):
    with pytest.raises(MeshError, match=message) as caught:
        Mesh(vertices, faces, name="bad")
    assert str(caught.value).startswith("mesh 'bad'")


def test_mesh_problems_are_all_listed():
    v, f = joined(box(), moved(box(), 3.0))
    v[5] = np.nan
    v[12] = 1e7
    f[23] = f[22]
    f[21, 0] = 99
    f[2] = (0, 0, 4)
    f[0] = f[0][::-1]
    with pytest.raises(MeshError) as caught:
        Mesh(v, f)
    text = str(caught.value)
    for kind in (
        "is not finite",
        "is too far away",
        "is out of index range",
        "is degenerate",
        "is duplicate",
        "are wound inconsistently",
    ):
        assert text.count(kind) == 1
    assert text.startswith("mesh 'mesh' has 6 problems:\n  - ")


def test_slivers_are_refused_at_the_limit_of_warp():
    # Height h over an edge of length 1: |cross|/Σe² = h / (1 + 2·(1/4 + h²)) ≈ h / 1.5.
    def needle(ratio):
        return [(0, 0, 0), (1, 0, 0), (0.5, 1.5 * ratio, 0)]

    assert Mesh(needle(1.01e-6), [(0, 1, 2)]).report.degenerate_face_count == 0
    with pytest.raises(MeshError, match="degenerate"):
        Mesh(needle(0.99e-6), [(0, 1, 2)])
    # The same shape at every size.
    Mesh(1e3 * np.array(needle(1.01e-6)), [(0, 1, 2)])
    Mesh(1e-3 * np.array(needle(1.01e-6)), [(0, 1, 2)])


@pytest.mark.parametrize("name", ["", None, 3])
def test_mesh_without_a_name_is_refused(name):
    with pytest.raises(ValueError, match="name must be a non-empty string"):
        Mesh(TETRAHEDRON, OUTWARD, name=name)


# The mesh


def test_mesh_has_its_own_read_only_arrays():
    v, f = TETRAHEDRON.copy(), OUTWARD.copy()
    mesh = Mesh(v, f)
    v[:], f[:] = 7.0, 0
    np.testing.assert_array_equal(mesh.vertices, TETRAHEDRON)
    np.testing.assert_array_equal(mesh.faces, OUTWARD)
    assert mesh.vertices.dtype == np.float64
    assert mesh.faces.dtype == np.int32
    for twin in (mesh, copy.deepcopy(mesh), pickle.loads(pickle.dumps(mesh))):
        for array in (twin.vertices, twin.faces, twin.welded):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1
        assert twin.report == mesh.report
    with pytest.raises(AttributeError):
        mesh.vertices = v


def test_flipped_and_scaled_change_faces_or_size_only():
    mesh = box((1, 2, 3), name="crate")
    inside = mesh.flipped()
    assert inside.report.volume == pytest.approx(-6.0)
    assert inside.name == "crate"
    np.testing.assert_array_equal(inside.flipped().faces, mesh.faces)
    small = mesh.scaled(0.5)
    np.testing.assert_array_equal(small.bounds, [(-0.25, -0.5, -0.75), (0.25, 0.5, 0.75)])
    np.testing.assert_array_equal(small.faces, mesh.faces)
    for factor in (0.0, -1.0, np.inf, np.nan, "2", 10**400, True):
        with pytest.raises(ValueError, match="factor must be a positive finite number"):
            mesh.scaled(factor)
    with pytest.raises(MeshError, match="8 of 8 vertices are too far away"):
        mesh.scaled(1e7)


def test_welded_maps_to_the_first_coincident_vertex():
    v = [(1, 0, 0), (0, 0, 0), (0, 1, 0), (0, 0, -0.0), (1, 0, 0), (1e-12, 0, 0)]
    mesh = Mesh(v, [(1, 0, 2)])
    assert mesh.welded.tolist() == [0, 1, 2, 1, 0, 5]
    assert mesh.welded.dtype == np.int32


def test_mesh_from_trimesh_keeps_vertices_and_faces():
    original = trimesh.creation.icosphere(subdivisions=1)
    mesh = Mesh.from_trimesh(original, name="ball")
    np.testing.assert_array_equal(mesh.faces, original.faces)
    np.testing.assert_array_equal(mesh.vertices, original.vertices)
    assert repr(mesh) == "Mesh('ball', 42 vertices, 80 faces, closed)"
    with pytest.raises(TypeError, match=r"must have vertices and faces, .* got Scene"):
        Mesh.from_trimesh(trimesh.Scene(original))


def test_import_of_meshes_loads_no_slow_package():
    # With an empty parent package, to test the imports of this module only.
    code = (
        "import sys, types; parent = types.ModuleType('warpcontact'); parent.__path__ = [sys.argv[1]];"
        "sys.modules['warpcontact'] = parent; import warpcontact.meshes;"
        "print({'warp', 'trimesh', 'scipy'} & set(sys.modules))"
    )
    command = [sys.executable, "-c", code, str(Path(meshes.__file__).parents[1])]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() == "set()"
    assert set(meshes.__all__) <= set(dir(meshes))


# Reports


def test_report_of_a_box_is_correct():
    report = box((1, 2, 3)).report
    assert (report.vertex_count, report.face_count, report.edge_count, report.euler_number) == (8, 12, 18, 2)
    assert (report.lower, report.upper, report.size) == ((-0.5, -1, -1.5), (0.5, 1, 1.5), (1, 2, 3))
    assert report.area == pytest.approx(22.0)
    assert report.volume == pytest.approx(6.0)
    assert (report.shortest_edge, report.longest_edge) == pytest.approx((1.0, np.sqrt(13.0)))
    assert (report.closed, report.orientation, report.component_count) == (True, "outward", 1)
    assert report.usable
    assert report.warnings == ()


def test_report_of_an_open_grid_is_correct():
    report = grid((2, 3), (4, 5)).report
    assert (report.closed, report.orientation, report.volume) == (False, "open surface", None)
    assert (report.boundary_edge_count, report.boundary_loop_count, report.euler_number) == (18, 1, 1)
    assert report.warnings == ("the surface is open: 18 boundary edges in 1 loop",)


def test_report_of_a_flipped_box_is_correct():
    report = box().flipped().report
    assert (report.orientation, report.inward_component_count) == ("inward", 1)
    assert report.volume == pytest.approx(-1.0)
    assert report.usable
    assert len(report.warnings) == 1
    assert "faces inward" in report.warnings[0]


def test_report_of_mixed_winding_is_correct():
    v, f = box().vertices, box().faces.copy()
    f[3] = f[3][::-1]
    report = examine(v, f)
    assert (report.orientation, report.inconsistent_edge_count, report.volume) == ("mixed", 3, None)
    first, second, tail, head = map(int, re.findall(r"(\d+)(?= and| both| to|;)", report.errors[0]))
    for face in (f[first].tolist(), f[second].tolist()):
        assert (tail, head) in zip(face, face[1:] + face[:1], strict=True)


def test_report_of_a_moebius_strip_has_mixed_orientation():
    t = np.linspace(0, np.pi, 12, endpoint=False)
    circle = np.column_stack((np.cos(2 * t), np.sin(2 * t), np.zeros(12)))
    across = 0.3 * (np.cos(t)[:, None] * circle + np.sin(t)[:, None] * (0, 0, 1))
    quads = [(i, i + 12, i + 13, i + 1) for i in range(11)] + [(11, 23, 0, 12)]  # the last with a half twist
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    report = examine(np.concatenate((circle - across, circle + across)), faces)
    assert (report.orientation, report.boundary_loop_count, report.euler_number) == ("mixed", 1, 0)


def test_report_of_several_components_is_correct():
    cavity = Mesh(*joined(box((3, 3, 3)), box().flipped())).report
    assert (cavity.component_count, cavity.inward_component_count, cavity.orientation) == (2, 1, "outward")
    assert cavity.volume == pytest.approx(26.0)
    assert any(text.startswith("1 of 2 components closed and facing inward") for text in cavity.warnings)
    apart = Mesh(*joined(box(), moved(box(), 3.0), moved(grid(), -3.0))).report
    assert (apart.component_count, apart.inward_component_count, apart.closed) == (3, 0, False)


def test_report_of_a_non_manifold_fin_is_correct():
    v, f = box().vertices, box().faces
    report = Mesh([*v, (2, 2, 2)], [*f, (f[0][0], f[0][1], 8)]).report
    assert (report.non_manifold_edge_count, report.boundary_edge_count, report.closed) == (1, 2, False)
    assert "1 edge with more than two faces (non-manifold)" in report.to_text()


def test_inner_wall_is_non_manifold_without_boundary():
    report = Mesh([*TETRAHEDRON, (0, 0, -1)], [*OUTWARD, (0, 4, 1), (1, 4, 2), (2, 4, 0)]).report
    assert (report.non_manifold_edge_count, report.boundary_edge_count, report.closed) == (3, 0, False)


def test_mesh_report_excludes_duplicate_faces_but_not_reversed_ones():
    copied = examine(TETRAHEDRON, [*OUTWARD, (2, 1, 0)])
    assert (copied.duplicate_face_count, copied.non_manifold_edge_count, copied.closed) == (1, 0, True)
    reverse = examine(TETRAHEDRON, [*OUTWARD, (0, 1, 2)])
    assert (reverse.duplicate_face_count, reverse.non_manifold_edge_count, reverse.closed) == (1, 3, False)


def test_triangle_soup_is_closed_after_welding():
    report = Mesh(*soup(icosphere(subdivisions=2))).report
    assert (report.closed, report.orientation, report.component_count, report.euler_number) == (
        True,
        "outward",
        1,
        2,
    )
    assert (report.vertex_count, report.welded_vertex_count, report.coincident_vertex_count) == (960, 162, 798)


def test_topology_problems_are_found_in_a_triangle_soup():
    v, f = soup(box())
    with pytest.raises(MeshError, match=r"1 of 13 faces is duplicate, first: face 12 .* of face 4"):
        Mesh(np.concatenate((v, v[12:15])), [*f, (36, 37, 38)])
    with pytest.raises(MeshError, match="3 of 18 edges are wound inconsistently"):
        Mesh(v, changed(f, 4, f[4][::-1]))
    with pytest.raises(MeshError, match="1 of 12 faces is degenerate"):
        Mesh(changed(v, 0, v[1]), f)


def test_cracks_are_distinguished_from_the_boundary():
    v, f = soup(box())
    v[f[0]] += 1e-9
    report = Mesh(v, f).report
    assert (report.boundary_edge_count, report.crack_vertex_count) == (6, 6)
    assert Mesh(np.round(v, 6), f).report.closed
    assert grid(cells=(3, 3)).report.crack_vertex_count == 0


@pytest.mark.parametrize(
    ("mesh", "warning"),
    [
        (lambda: Mesh([*TETRAHEDRON, (5, 5, 5)], OUTWARD), "1 of 5 vertices used by no face"),
        (lambda: box((200, 1, 1)), "largest dimension is 200 m, outside 0.001 m to 100 m"),
        (lambda: box((1e-4, 1e-4, 1e-4)), "largest dimension is 0.0001 m"),
        (lambda: Mesh(*joined(moved(box((1e-2, 1e-2, 1e-2)), 9e5), box())),
         "12 faces too thin or small for float32"),
        (lambda: Mesh(*joined(*[grid()] * 1, moved(grid(), (0.5, 0, 0)))), "2 separate components"),
        (lambda: Mesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)]),
         "closed but encloses no volume"),
    ],
)  # fmt: skip
def test_usable_mesh_with_defects_has_a_warning(mesh, warning):
    assert any(warning in text for text in mesh().report.warnings)


def test_precision_warning_is_relative_to_the_center_of_a_mesh():
    assert not any("float32" in text for text in moved(box((1e-2, 1e-2, 1e-2)), 9e5).report.warnings)


def test_bounds_ignore_unused_vertices():
    assert Mesh([*TETRAHEDRON, (5, 5, 5)], OUTWARD).bounds.tolist() == [[0, 0, 0], [1, 1, 1]]


def test_mesh_report_text_has_aligned_lines():
    lines = examine(TETRAHEDRON, changed(OUTWARD, (0, 0), 9), "wedge").to_text().splitlines()
    assert lines[0] == "mesh 'wedge'"
    facts = lines[1 : lines.index("errors")]
    assert {line.index(line[25:]) for line in facts} == {25}
    assert facts[0].split() == ["usable", "no"]
    assert lines[lines.index("errors") + 1].startswith("  - 1 of 4 faces is out of index range")
    assert lines[lines.index("warnings") + 1] == "  - the surface is open: 3 boundary edges in 1 loop"


# Generators


def test_grid_is_flat_centered_and_faces_up():
    mesh = grid((2, 3), (4, 5))
    assert (len(mesh.vertices), len(mesh.faces)) == (30, 40)
    assert mesh.bounds.tolist() == [[-1, -1.5, 0], [1, 1.5, 0]]
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    np.testing.assert_allclose(np.cross(b - a, c - a), [(0, 0, 0.3)] * 40, atol=1e-15)


def test_terrain_height_matches_its_formula_and_faces_up():
    mesh = sinusoidal_terrain((4, 2), (80, 40), amplitude=0.3, wavelength=2.0)
    x, y, z = mesh.vertices.T
    np.testing.assert_allclose(z, 0.3 * np.sin(np.pi * x) * np.sin(np.pi * y), atol=1e-15)
    assert z.max() == pytest.approx(0.3)
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    np.testing.assert_array_equal(
        sinusoidal_terrain((4, 2), (5, 5), amplitude=0.0).vertices, grid((4, 2), (5, 5)).vertices
    )


def test_box_faces_are_outward():
    mesh = box((1, 2, 3))
    assert outward_solid_angle(mesh) == pytest.approx(4 * np.pi)
    assert len(mesh.faces) == 12


def test_icosphere_converges_to_the_sphere():
    errors = []
    for n in range(5):
        mesh = icosphere(0.5, n)
        assert len(mesh.faces) == 20 * 4**n
        np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 0.5, rtol=1e-14)
        assert outward_solid_angle(mesh) == pytest.approx(4 * np.pi)
        assert (mesh.report.closed, mesh.report.euler_number) == (True, 2)
        errors.append(1.0 - mesh.report.volume / (4 / 3 * np.pi * 0.125))
    # Second order: a quarter of the error at half the edge length.
    np.testing.assert_allclose(np.divide(errors[3:], errors[2:-1]), 0.25, atol=0.005)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: grid((1, 0)), r"size\[1\] must be a positive finite number, got 0"),
        (lambda: grid((1, 1, 1)), r"size must have 2 entries, got \(1, 1, 1\)"),
        (lambda: grid(cells=(0, 1)), r"cells\[0\] must be an integer from 1 to"),
        (lambda: grid(cells=(1, 1.5)), r"cells\[1\] must be an integer from 1 to .*, got 1.5"),
        (lambda: grid(cells=(10**6, 10**6)), "cells must be at most 100000000 in all"),
        (lambda: sinusoidal_terrain(wavelength=0.0), "wavelength must be a positive finite number, got 0.0"),
        (lambda: sinusoidal_terrain(amplitude=np.nan), "amplitude must be finite, got nan"),
        (lambda: box((1, 1, -1)), r"size\[2\] must be a positive finite number, got -1"),
        (lambda: box(1.0), "size must have 3 entries, got 1.0"),
        (lambda: icosphere(0.0), "radius must be a positive finite number"),
        (lambda: icosphere(subdivisions=9), "subdivisions must be an integer from 0 to 8, got 9"),
        (lambda: icosphere(subdivisions=True), "subdivisions must be an integer from 0 to 8, got True"),
    ],
)
def test_mesh_generators_raise_for_invalid_arguments(make, message):
    with pytest.raises(ValueError, match=message):
        make()
