"""Meshes: what is refused and how, what a report says, what files give."""

import copy
import json
import pickle
import re
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from warpcontact import meshes
from warpcontact.meshes import Mesh, MeshError, box, examine_file, grid, icosphere, load_mesh, sinusoidal_terrain
from warpcontact.meshes.report import examine

CRACKED = ["angle_block.STL", "featuretype.STL", "idler_riser.STL"]
REFUSED = {
    "bunny.ply": "87 of 16301 faces are duplicate",
    "multibody.stl": "12 of 48 edges are wound inconsistently",
    "points_emptyface.ply": "it has no faces",
}
SOUND = [
    "20mm-xyz-cube.stl", "Duck.glb", "ballA.off", "busted.STL", "cycloidal.ply", "fandisk.obj", "nancolor.obj",
    "not_convex.obj", "soup.stl", *CRACKED,
]  # fmt: skip

TETRAHEDRON = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
OUTWARD = np.array([(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)])
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
OFF = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"
)


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
    """The arrays of an STL file: three vertices of its own for every face."""
    return mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3)


def outward_solid_angle(mesh):
    """Sum of the solid angles of the faces seen from the origin; 4π for an outward surface around it."""
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    above = np.einsum("ij,ij->i", a, np.cross(b, c))
    dots = [np.einsum("ij,ij->i", x, y) for x, y in ((a, b), (b, c), (c, a))]
    return 2.0 * np.arctan2(above, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb).sum()


# Refusals ---------------------------------------------------------------------------------------------------


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
        (TETRAHEDRON, [*OUTWARD, (1, 0, 2)], r"1 of 5 .* duplicate, first: face 4 .* has the corners of face 0"),
        (TETRAHEDRON, [*OUTWARD, (0, 1, 2)], "1 of 5 faces is duplicate"),
        (
            TETRAHEDRON,
            changed(OUTWARD, 2, (1, 3, 2)),
            r"3 of 6 edges are wound inconsistently, first: faces \d and",
        ),
    ],
)
def test_a_bad_mesh_is_refused_with_entry_value_and_what_is_allowed(vertices, faces, message):
    with pytest.raises(MeshError, match=message) as caught:
        Mesh(vertices, faces, name="bad")
    assert str(caught.value).startswith("mesh 'bad'")


def test_all_problems_are_listed_at_once():
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
        "not finite",
        "too far away",
        "out of index range",
        "degenerate",
        "duplicate",
        "wound inconsistently",
    ):
        assert text.count(kind) == 1
    assert text.startswith("mesh 'mesh' has 6 problems:\n  - ")


def test_slivers_are_refused_at_the_limit_of_warp_and_not_above():
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
def test_a_mesh_without_a_name_is_refused(name):
    with pytest.raises(ValueError, match="name must be a non-empty string"):
        Mesh(TETRAHEDRON, OUTWARD, name=name)


# The mesh ---------------------------------------------------------------------------------------------------


def test_a_mesh_keeps_its_own_unchangeable_arrays():
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


def test_flipped_and_scaled_change_only_what_they_say():
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


def test_welded_maps_to_the_first_vertex_at_the_same_place():
    v = [(1, 0, 0), (0, 0, 0), (0, 1, 0), (0, 0, -0.0), (1, 0, 0), (1e-12, 0, 0)]
    mesh = Mesh(v, [(1, 0, 2)])
    assert mesh.welded.tolist() == [0, 1, 2, 1, 0, 5]
    assert mesh.welded.dtype == np.int32


def test_a_trimesh_is_taken_as_it_is():
    original = trimesh.creation.icosphere(subdivisions=1)
    mesh = Mesh.from_trimesh(original, name="ball")
    np.testing.assert_array_equal(mesh.faces, original.faces)
    np.testing.assert_array_equal(mesh.vertices, original.vertices)
    assert repr(mesh) == "Mesh('ball', 42 vertices, 80 faces, closed)"
    with pytest.raises(TypeError, match=r"must have vertices and faces, .* got Scene"):
        Mesh.from_trimesh(trimesh.Scene(original))


def test_importing_meshes_imports_no_slow_package():
    # With an empty parent package: what the rest of warpcontact imports is its own matter.
    code = (
        "import sys, types; parent = types.ModuleType('warpcontact'); parent.__path__ = [sys.argv[1]];"
        "sys.modules['warpcontact'] = parent; import warpcontact.meshes;"
        "print({'warp', 'trimesh', 'scipy'} & set(sys.modules))"
    )
    command = [sys.executable, "-c", code, str(Path(meshes.__file__).parents[1])]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip() == "set()"
    assert set(meshes.__all__) <= set(dir(meshes))


# Reports ----------------------------------------------------------------------------------------------------


def test_report_of_a_box():
    report = box((1, 2, 3)).report
    assert (report.vertex_count, report.face_count, report.edge_count, report.euler_number) == (8, 12, 18, 2)
    assert (report.lower, report.upper, report.size) == ((-0.5, -1, -1.5), (0.5, 1, 1.5), (1, 2, 3))
    assert report.area == pytest.approx(22.0)
    assert report.volume == pytest.approx(6.0)
    assert (report.shortest_edge, report.longest_edge) == pytest.approx((1.0, np.sqrt(13.0)))
    assert (report.closed, report.orientation, report.component_count) == (True, "outward", 1)
    assert report.usable
    assert report.warnings == ()


def test_report_of_an_open_grid():
    report = grid((2, 3), (4, 5)).report
    assert (report.closed, report.orientation, report.volume) == (False, "open surface", None)
    assert (report.border_edge_count, report.border_loop_count, report.euler_number) == (18, 1, 1)
    assert report.warnings == ("the surface is open: 18 border edges in 1 loop",)


def test_report_of_a_flipped_box():
    report = box().flipped().report
    assert (report.orientation, report.inward_component_count) == ("inward", 1)
    assert report.volume == pytest.approx(-1.0)
    assert report.usable
    assert len(report.warnings) == 1
    assert "faces inward" in report.warnings[0]


def test_report_of_mixed_winding():
    v, f = box().vertices, box().faces.copy()
    f[3] = f[3][::-1]
    report = examine(v, f)
    assert (report.orientation, report.inconsistent_edge_count, report.volume) == ("mixed", 3, None)
    first, second, tail, head = map(int, re.findall(r"(\d+)(?= and| both| to|;)", report.errors[0]))
    for face in (f[first].tolist(), f[second].tolist()):
        assert (tail, head) in zip(face, face[1:] + face[:1], strict=True)


def test_a_moebius_strip_is_mixed():
    t = np.linspace(0, np.pi, 12, endpoint=False)
    rim = np.column_stack((np.cos(2 * t), np.sin(2 * t), np.zeros(12)))
    across = 0.3 * (np.cos(t)[:, None] * rim + np.sin(t)[:, None] * (0, 0, 1))
    quads = [(i, i + 12, i + 13, i + 1) for i in range(11)] + [(11, 23, 0, 12)]  # the last with a half twist
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    report = examine(np.concatenate((rim - across, rim + across)), faces)
    assert (report.orientation, report.border_loop_count, report.euler_number) == ("mixed", 1, 0)


def test_report_of_several_components():
    cavity = Mesh(*joined(box((3, 3, 3)), box().flipped())).report
    assert (cavity.component_count, cavity.inward_component_count, cavity.orientation) == (2, 1, "outward")
    assert cavity.volume == pytest.approx(26.0)
    assert any(text.startswith("1 of 2 components closed and facing inward") for text in cavity.warnings)
    apart = Mesh(*joined(box(), moved(box(), 3.0), moved(grid(), -3.0))).report
    assert (apart.component_count, apart.inward_component_count, apart.closed) == (3, 0, False)


def test_report_of_a_non_manifold_fin():
    v, f = box().vertices, box().faces
    report = Mesh([*v, (2, 2, 2)], [*f, (f[0][0], f[0][1], 8)]).report
    assert (report.non_manifold_edge_count, report.border_edge_count, report.closed) == (1, 2, False)
    assert "1 edge with more than two faces (non-manifold)" in report.to_text()


def test_a_wall_inside_is_no_border_and_yet_not_closed():
    report = Mesh([*TETRAHEDRON, (0, 0, -1)], [*OUTWARD, (0, 4, 1), (1, 4, 2), (2, 4, 0)]).report
    assert (report.non_manifold_edge_count, report.border_edge_count, report.closed) == (3, 0, False)


def test_figures_leave_out_a_copied_face_but_not_its_reverse():
    copied = examine(TETRAHEDRON, [*OUTWARD, (2, 1, 0)])
    assert (copied.duplicate_face_count, copied.non_manifold_edge_count, copied.closed) == (1, 0, True)
    reverse = examine(TETRAHEDRON, [*OUTWARD, (0, 1, 2)])
    assert (reverse.duplicate_face_count, reverse.non_manifold_edge_count, reverse.closed) == (1, 3, False)


def test_a_soup_is_closed_once_welded():
    report = Mesh(*soup(icosphere(subdivisions=2))).report
    assert (report.closed, report.orientation, report.component_count, report.euler_number) == (
        True,
        "outward",
        1,
        2,
    )
    assert (report.vertex_count, report.welded_vertex_count, report.coincident_vertex_count) == (960, 162, 798)


def test_topology_problems_are_found_in_a_soup():
    v, f = soup(box())
    with pytest.raises(MeshError, match=r"1 of 13 faces is duplicate, first: face 12 .* of face 4"):
        Mesh(np.concatenate((v, v[12:15])), [*f, (36, 37, 38)])
    with pytest.raises(MeshError, match="3 of 18 edges are wound inconsistently"):
        Mesh(v, changed(f, 4, f[4][::-1]))
    with pytest.raises(MeshError, match="1 of 12 faces is degenerate"):
        Mesh(changed(v, 0, v[1]), f)


def test_a_crack_is_told_from_a_border():
    v, f = soup(box())
    v[f[0]] += 1e-9
    report = Mesh(v, f).report
    assert (report.border_edge_count, report.crack_vertex_count) == (6, 6)
    assert Mesh(np.round(v, 6), f).report.closed
    assert grid(cells=(3, 3)).report.crack_vertex_count == 0


@pytest.mark.parametrize(
    ("mesh", "warning"),
    [
        (lambda: Mesh([*TETRAHEDRON, (5, 5, 5)], OUTWARD), "1 of 5 vertices used by no face"),
        (lambda: box((200, 1, 1)), "largest dimension is 200 m, outside 0.001 m to 100 m"),
        (lambda: box((1e-4, 1e-4, 1e-4)), "largest dimension is 0.0001 m"),
        (lambda: moved(box((1e-2, 1e-2, 1e-2)), 9e5), "12 faces too thin or small for float32"),
        (lambda: Mesh(*joined(*[grid()] * 1, moved(grid(), (0.5, 0, 0)))), "2 separate components"),
        (lambda: Mesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)]),
         "closed but encloses no volume"),
    ],
)  # fmt: skip
def test_a_usable_mesh_is_warned_about(mesh, warning):
    assert any(warning in text for text in mesh().report.warnings)


def test_bounds_ignore_vertices_that_no_face_uses():
    assert Mesh([*TETRAHEDRON, (5, 5, 5)], OUTWARD).bounds.tolist() == [[0, 0, 0], [1, 1, 1]]


def test_a_report_reads_as_aligned_lines():
    lines = examine(TETRAHEDRON, changed(OUTWARD, (0, 0), 9), "wedge").to_text().splitlines()
    assert lines[0] == "mesh 'wedge'"
    facts = lines[1 : lines.index("errors")]
    assert {line.index(line[25:]) for line in facts} == {25}
    assert facts[0].split() == ["usable", "no"]
    assert lines[lines.index("errors") + 1].startswith("  - 1 of 4 faces is out of index range")
    assert lines[lines.index("warnings") + 1] == "  - the surface is open: 3 border edges in 1 loop"


# Generators -------------------------------------------------------------------------------------------------


def test_a_grid_is_flat_centred_and_faces_up():
    mesh = grid((2, 3), (4, 5))
    assert (len(mesh.vertices), len(mesh.faces)) == (30, 40)
    assert mesh.bounds.tolist() == [[-1, -1.5, 0], [1, 1.5, 0]]
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    np.testing.assert_allclose(np.cross(b - a, c - a), [(0, 0, 0.3)] * 40, atol=1e-15)


def test_terrain_has_the_height_of_its_formula_and_faces_up():
    mesh = sinusoidal_terrain((4, 2), (80, 40), amplitude=0.3, wavelength=2.0)
    x, y, z = mesh.vertices.T
    np.testing.assert_allclose(z, 0.3 * np.sin(np.pi * x) * np.sin(np.pi * y), atol=1e-15)
    assert z.max() == pytest.approx(0.3)
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    np.testing.assert_array_equal(
        sinusoidal_terrain((4, 2), (5, 5), amplitude=0.0).vertices, grid((4, 2), (5, 5)).vertices
    )


def test_a_box_is_outward():
    mesh = box((1, 2, 3))
    assert outward_solid_angle(mesh) == pytest.approx(4 * np.pi)
    assert len(mesh.faces) == 12


def test_an_icosphere_converges_to_the_sphere():
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
def test_generators_name_a_bad_argument(make, message):
    with pytest.raises(ValueError, match=message):
        make()


# Files ------------------------------------------------------------------------------------------------------


@pytest.fixture
def write(tmp_path):
    """Writes a file and returns its path."""

    def write(name, content):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def binary_stl(triangles, announced=None, header=b""):
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *np.ravel(t), 0) for t in triangles)
    return header.ljust(80, b"\0") + struct.pack("<I", len(triangles) if announced is None else announced) + body


def glb(edit=None):
    """The tetrahedron as GLB, its JSON changed by ``edit``."""
    data = trimesh.Trimesh(TETRAHEDRON, OUTWARD, process=False).export(file_type="glb")
    size = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + size])
    if edit:
        edit(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<I4s", len(text), b"JSON") + text + data[20 + size :]
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk


STL = binary_stl(TETRAHEDRON[OUTWARD])
STL_TEXT = trimesh.exchange.stl.export_stl_ascii(trimesh.Trimesh(TETRAHEDRON, OUTWARD, process=False))


@pytest.mark.parametrize("suffix", ["stl", "STL", "stl_ascii", "obj", "ply", "ply_ascii", "off", "glb", "GLB"])
def test_every_format_gives_the_faces_of_the_file_in_their_order(tmp_path, suffix):
    original = trimesh.creation.icosphere(subdivisions=1)
    kind, _, text = suffix.partition("_")
    path = tmp_path / f"ball.{kind}"
    options = {"encoding": "ascii"} if suffix == "ply_ascii" else {}
    content = original.export(file_type="stl_ascii" if text and kind == "stl" else kind.lower(), **options)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    mesh = load_mesh(path, scale=2.0)
    assert mesh.name == "ball"
    assert mesh.report.closed
    # float32 in the binary formats, 8 digits in text.
    np.testing.assert_allclose(mesh.vertices[mesh.faces], 2.0 * original.triangles, rtol=0, atol=3e-7)
    assert examine_file(path, scale=2.0) == mesh.report


@pytest.mark.parametrize(("name", "content"), [("a.stl", STL), ("a.stl", STL_TEXT), ("a.obj", OBJ), ("a.off", OFF),
                                               ("a.ply", PLY), ("a.glb", glb())])  # fmt: skip
def test_the_sound_files_that_the_hostile_ones_are_made_of_load(write, name, content):
    mesh = load_mesh(write(name, content))
    np.testing.assert_allclose(mesh.vertices[mesh.faces], TETRAHEDRON[OUTWARD])
    assert load_mesh(write(name, content), name="other").name == "other"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.stl", b"", "the file is empty"),
        ("a.stl", STL[:-10], "header announces 4 triangles, so 284 bytes of binary STL, but the file has 274"),
        ("a.stl", STL + b"rest", "so 284 bytes of binary STL, but the file has 288"),
        ("a.stl", binary_stl(TETRAHEDRON[OUTWARD], 5), "announces 5 triangles"),
        ("a.stl", binary_stl(TETRAHEDRON[OUTWARD], 2**32 - 1), "announces 4294967295 triangles"),
        ("a.stl", binary_stl(TETRAHEDRON[OUTWARD], 5, b"solid part"), "announces 5 triangles"),
        ("a.stl", binary_stl([]), "it has no vertices"),
        ("a.stl", b"solid a\nendsolid a\n", "it has no faces"),
        ("a.stl", STL_TEXT[: len(STL_TEXT) // 2], "is the file cut short?"),
        ("a.stl", STL_TEXT + STL_TEXT[: len(STL_TEXT) // 2], "but only 4 triangles in complete solids"),
        ("a.stl", STL_TEXT.replace("vertex 1.0", "vertex one", 1), "not valid STL"),
        ("a.stl", binary_stl(changed(TETRAHEDRON, (1, 0), np.nan)[OUTWARD]), "3 of 12 vertices are not finite"),
        ("a.stl", bytes(range(256)) * 3, "header announces"),
        ("a.stl", bytes(range(50)), "50 bytes are too few for a binary STL"),
        ("a.obj", bytes(range(256)) * 3, "a.obj"),
        ("a.ply", bytes(range(256)) * 3, "there is no PLY header"),
        ("a.off", bytes(range(256)) * 3, "there is no OFF header"),
        ("a.glb", bytes(range(256)) * 3, "there is no GLB header"),
        ("a.obj", OBJ.replace("v 1 0 0", "v nan 0 0"), "1 of 4 vertices is not finite, first: vertex 1"),
        ("a.obj", OBJ.replace("v 1 0 0", "v 1e38 0 0"), "too far away"),
        ("a.obj", OBJ.replace("v 1 0 0", "v 1 x 0"), "line 2: 3 or more numbers are needed, got '1 x 0'"),
        ("a.obj", OBJ.replace("v 1 0 0", "v 1 0"), "line 2: 3 or more numbers are needed, got '1 0'"),
        ("a.obj", OBJ.replace("f 1 3 2", "f 0 3 2"), r"line 5: a vertex number must be from 1, .*got \[0, 3, 2\]"),
        ("a.obj", OBJ.replace("f 1 3 2", "f 1 3 5"), r"out of index range, .* \(0, 2, 4\)"),
        ("a.obj", OBJ.replace("f 1 3 2", "f 1 3 -5"), r"line 5: .* from -4 to -1, got \[1, 3, -5\]"),
        ("a.obj", OBJ.replace("f 1 3 2", "f 1 3"), "line 5: 3 or more numbers"),
        ("a.obj", OBJ.replace("f 1 3 2", f"f 1 3 {10**30}"), "not valid OBJ"),
        ("a.off", OFF[:-16], "announces 4 vertices and 4 faces, but 6 lines follow; is the file cut short?"),
        ("a.off", OFF.replace("4 4 0", "4000000000 4 0"), "is the file cut short?"),
        ("a.off", OFF.replace("3 0 2 1", "3 0 2 7"), r"face 0 with vertices \(0, 2, 7\)"),
        ("a.off", OFF.replace("3 0 2 1", "4 0 2 1"), "face 0: 4 or more numbers are needed, got '0 2 1'"),
        ("a.off", OFF.replace("3 0 2 1", "-2 0 2 1 3 3"), "face 0: 3 or more numbers"),
        ("a.ply", PLY.replace("3 0 2 1", "3 0 2 7"), r"face 0 .* \(0, 2, 7\); allowed: .* 0 to 3"),
        ("a.ply", PLY.replace("3 0 2 1", "3 0 2 -1"), r"face 0 with vertices \(0, 2, -1\)"),
        ("a.ply", PLY[:-8], "announces 8 lines, but there are 7; is the file cut short?"),
        ("a.ply", PLY[:-4], "announces 4 faces, but only 3 could be read"),
        ("a.ply", PLY.replace("end_header", "end"), "there is no PLY header"),
        ("a.ply", PLY.replace("property float x\n", ""), "not valid PLY"),
        ("a.glb", glb()[:-4], "header announces"),
        ("a.glb", glb(lambda t: t["accessors"][0].update(count=2**30)), "not valid GLB"),
        ("a.glb", glb(lambda t: t["accessors"].append({"componentType": 5126, "count": 2**30, "type": "MAT4"})),
         "accessor 2 is compressed or sparse"),
        ("a.glb", glb(lambda t: t["buffers"][0].update(uri="../../secret")), "buffer 0 is in another file"),
        ("a.glb", glb(lambda t: t["meshes"][0]["primitives"][0].update(mode=6)), "triangle fan"),
        ("a.glb", glb(lambda t: t["meshes"][0]["primitives"][0].update(mode=1)), "it has no"),
        ("a.glb", glb(lambda t: t.update(meshes=3)), "not valid GLB"),
        ("a.zip", STL, "the extension '.zip' is not one of .stl, .obj, .ply, .off, .glb"),
        ("a", STL, "the extension '' is not one of"),
    ],
)  # fmt: skip
def test_a_hostile_file_is_refused_with_its_name_and_reason(write, name, content, message):
    path = write(name, content)
    with pytest.raises(MeshError, match=message) as caught:
        load_mesh(path)
    assert str(caught.value).startswith(f"mesh file {str(path)!r}")
    report = examine_file(path)
    assert not report.usable
    assert all(error in str(caught.value) for error in report.errors)


@pytest.mark.parametrize("read", [load_mesh, examine_file])
def test_what_is_no_file_is_refused(tmp_path, read):
    with pytest.raises(MeshError, match=r"'.*missing.stl' does not exist"):
        read(tmp_path / "missing.stl")
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(MeshError, match=r"folder.stl' is not a regular file"):
        read(str(tmp_path / "folder.stl"))
    with pytest.raises(ValueError, match="scale must be a positive finite number, got 0"):
        read(tmp_path / "missing.stl", scale=0)


def test_an_obj_file_keeps_its_face_order_over_materials_and_relative_indices(write):
    text = (
        "mtllib colours.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0 # corner\nvt 0 0\nvn 0 0 1\nusemtl b\n"
        "f -3/1/1 -1/1/1 -2/1/1\nv 0 0 1\nusemtl a\no part\nf 1//1 2//1 \\\n 4//1\nusemtl b\n"
        "f 2/1 3/1 4/1\nf 1 4 3\n"
    )
    mesh = load_mesh(write("a.obj", text))
    np.testing.assert_array_equal(mesh.faces, OUTWARD)
    np.testing.assert_array_equal(mesh.vertices, TETRAHEDRON)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.obj", OBJ[: OBJ.index("f")] + "v 1 1 0\nf 1 2 5 3\nf 1 4 2\n"),
        ("a.off", "OFF 5 2 0\n# quad\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 1 0\n4 0 1 4 2\n3 0 3 1 255 0 0\n"),
        ("a.ply", PLY[: PLY.index("3 0")].replace("vertex 4", "vertex 5").replace("face 4", "face 2")
         + "1 1 0\n4 0 1 4 2\n3 0 3 1\n"),
    ],
)  # fmt: skip
def test_polygons_become_triangles_with_a_note(write, name, content):
    mesh = load_mesh(write(name, content))
    assert mesh.report.area == pytest.approx(1.5)
    assert len(mesh.faces) == 3
    assert mesh.report.warnings[0].startswith("2 faces of the file, some with more than three corners, became 3")


def test_parts_of_a_scene_are_placed_and_a_mirrored_one_stays_outward(tmp_path):
    scene = trimesh.Scene()
    crate = trimesh.Trimesh(box().vertices + 2.0, box().faces, process=False)
    scene.add_geometry(crate, geom_name="crate", transform=np.diag([1.0, 1, -2, 1]))
    scene.add_geometry(trimesh.Trimesh(TETRAHEDRON, OUTWARD, process=False), geom_name="wedge")
    scene.export(tmp_path / "scene.glb")
    mesh = load_mesh(tmp_path / "scene.glb")
    assert (len(mesh.faces), mesh.report.component_count, mesh.report.inward_component_count) == (16, 2, 0)
    assert mesh.report.volume == pytest.approx(2.0 + 1.0 / 6.0)
    np.testing.assert_allclose(mesh.bounds, [(0, 0, -5), (2.5, 2.5, 1)])


def test_points_and_lines_in_a_scene_are_left_out_with_a_note(write):
    def with_points(tree):
        parts = tree["meshes"][0]["primitives"]
        parts.append({"attributes": parts[0]["attributes"], "mode": 0})

    mesh = load_mesh(write("a.glb", glb(with_points)))
    assert len(mesh.faces) == 4
    assert mesh.report.warnings == ("1 of 2 parts are points or lines and were left out",)


def test_a_bad_index_in_one_part_does_not_reach_into_the_next(write):
    def second_part(tree):
        tree["meshes"].append(copy.deepcopy(tree["meshes"][0]))
        tree["nodes"] = [{"mesh": 0}, {"mesh": 1}]
        tree["scenes"] = [{"nodes": [0, 1]}]
        tree["scene"] = 0
        points = tree["accessors"][tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
        points["count"] = 3

    with pytest.raises(MeshError, match="has a face with an index outside its 3 vertices"):
        load_mesh(write("a.glb", glb(second_part)))


@pytest.mark.parametrize("name", REFUSED)
def test_a_broken_real_mesh_is_refused_with_the_reason(shared_data, name):
    with pytest.raises(MeshError, match=REFUSED[name]):
        load_mesh(shared_data / "meshes" / name)


@pytest.mark.parametrize("name", SOUND)
def test_a_real_mesh_loads_with_the_facts_that_trimesh_finds(shared_data, name):
    path = shared_data / "meshes" / name
    mesh = load_mesh(path)
    report = mesh.report
    loaded = trimesh.load_scene(path, process=False, maintain_order=True).to_geometry()
    np.testing.assert_allclose(mesh.vertices[mesh.faces], loaded.triangles, rtol=1e-12, atol=1e-12)
    # Welded independently, and exactly: trimesh itself merges within 1e-8.
    places, index = np.unique(mesh.vertices, axis=0, return_inverse=True)
    welded = trimesh.Trimesh(places, index.reshape(-1)[mesh.faces], process=False)
    assert report.welded_vertex_count == len(places)
    assert report.edge_count == len(welded.edges_unique)
    assert report.euler_number == welded.euler_number
    assert report.area == pytest.approx(welded.area)
    assert welded.is_winding_consistent
    assert (report.closed and not report.non_manifold_edge_count) == welded.is_watertight
    if report.closed:
        assert report.orientation == "outward"
        assert report.volume == pytest.approx(welded.volume)


@pytest.mark.parametrize("name", CRACKED)
def test_a_cracked_real_mesh_says_so_and_rounding_closes_it(shared_data, name):
    mesh = load_mesh(shared_data / "meshes" / name)
    assert mesh.report.crack_vertex_count > 0
    assert not mesh.report.closed
    assert Mesh(np.round(mesh.vertices, 6), mesh.faces).report.closed
