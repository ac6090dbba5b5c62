"""Mesh files: results of all formats, rejection of damaged and malicious files, and real files."""

import copy
import json
import struct

import numpy as np
import pytest
import trimesh
from test_meshes import OUTWARD, TETRAHEDRON, changed

from warpcontact.meshes import Mesh, MeshError, box, examine_file, load_mesh

pytestmark = pytest.mark.installed

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

OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
OFF = "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"
)


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
def test_every_mesh_format_keeps_faces_and_their_order(tmp_path, suffix):
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


@pytest.mark.smoke
@pytest.mark.parametrize(("name", "content"), [("a.stl", STL), ("a.stl", STL_TEXT), ("a.obj", OBJ), ("a.off", OFF),
                                               ("a.ply", PLY), ("a.glb", glb())])  # fmt: skip
def test_valid_originals_of_malformed_files_load(write, name, content):
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
        ("a.stl", STL_TEXT[: len(STL_TEXT) // 2], "after 2 triangles; is the file cut short?"),
        ("a.stl", STL_TEXT + STL_TEXT[: len(STL_TEXT) // 2], "after 6 triangles; is the file cut short?"),
        ("a.stl", STL_TEXT.replace("vertex 1.0", "vertex one", 1),
         "line 6: 3 or more numbers are needed, got 'one 0.0 0.0'"),
        ("a.stl", STL_TEXT.replace("outer", "inner", 1), "line 3: not valid STL, unknown keyword 'inner'"),
        ("a.stl", binary_stl(changed(TETRAHEDRON, (1, 0), np.nan)[OUTWARD]), "3 of 12 vertices are not finite"),
        ("a.stl", bytes(range(256)) * 3, "header announces"),
        ("a.stl", bytes(range(50)), "50 bytes are too few for a binary STL"),
        ("a.obj", bytes(range(256)) * 3, "a.obj"),
        ("a.ply", bytes(range(256)) * 3, "no PLY header"),
        ("a.off", bytes(range(256)) * 3, "no OFF header"),
        ("a.glb", bytes(range(256)) * 3, "no GLB header"),
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
        ("a.ply", PLY[:-4], "face 3 lacks values, got '3 0'"),
        ("a.ply", PLY.replace("end_header", "end"), "no PLY header"),
        ("a.ply", PLY.replace("property float x\n", ""), "not valid PLY"),
        ("a.glb", glb()[:-4], "header announces"),
        ("a.glb", glb(lambda t: t["accessors"][0].update(count=2**30)), "not valid GLB"),
        ("a.glb", glb(lambda t: t["accessors"][0].pop("bufferView")), "accessor 0 is compressed or sparse"),
        ("a.glb", glb(lambda t: t["buffers"][0].update(uri="../../secret")), "buffer 0 is in another file"),
        ("a.glb", glb(lambda t: t["meshes"][0]["primitives"][0].update(mode=1)), "it has no"),
        ("a.glb", glb(lambda t: t.update(meshes=3)), "not valid GLB"),
        ("a.zip", STL, "the extension '.zip' is not one of .stl, .obj, .ply, .off, .glb"),
        ("a", STL, "the extension '' is not one of"),
    ],
)  # fmt: skip
def test_malformed_mesh_file_is_refused_with_name_and_reason(write, name, content, message):
    path = write(name, content)
    with pytest.raises(MeshError, match=message) as caught:
        load_mesh(path)
    assert str(caught.value).startswith(f"mesh file {str(path)!r}")
    # Read in this process, because a second reader process takes longer than the examination.
    report = examine_file(path, trusted=True)
    assert not report.usable
    assert all(error in str(caught.value) for error in report.errors), report.errors


@pytest.mark.parametrize("read", [load_mesh, examine_file])
def test_missing_file_or_folder_is_refused(tmp_path, read):
    with pytest.raises(MeshError, match=r"'.*missing.stl' does not exist"):
        read(tmp_path / "missing.stl")
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(MeshError, match=r"folder.stl' is not a regular file"):
        read(str(tmp_path / "folder.stl"))
    with pytest.raises(ValueError, match="scale must be a positive finite number, got 0"):
        read(tmp_path / "missing.stl", scale=0)


def test_obj_file_keeps_face_order_with_materials_and_relative_indices(write):
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
def test_polygons_are_triangulated_with_a_note(write, name, content):
    mesh = load_mesh(write(name, content))
    assert mesh.report.area == pytest.approx(1.5)
    assert len(mesh.faces) == 3
    assert mesh.report.warnings[0].startswith("2 faces of the file, some with more than three vertices, became 3")


def test_scene_parts_are_placed_and_mirrored_parts_stay_outward(tmp_path):
    scene = trimesh.Scene()
    crate = trimesh.Trimesh(box().vertices + 2.0, box().faces, process=False)
    scene.add_geometry(crate, geom_name="crate", transform=np.diag([1.0, 1, -2, 1]))
    scene.add_geometry(trimesh.Trimesh(TETRAHEDRON, OUTWARD, process=False), geom_name="wedge")
    scene.export(tmp_path / "scene.glb")
    mesh = load_mesh(tmp_path / "scene.glb")
    assert (len(mesh.faces), mesh.report.component_count, mesh.report.inward_component_count) == (16, 2, 0)
    assert mesh.report.volume == pytest.approx(2.0 + 1.0 / 6.0)
    np.testing.assert_allclose(mesh.bounds, [(0, 0, -5), (2.5, 2.5, 1)])


def test_points_and_lines_of_a_scene_are_skipped_with_a_note(write):
    def with_points(tree):
        parts = tree["meshes"][0]["primitives"]
        parts.append({"attributes": parts[0]["attributes"], "mode": 0})

    mesh = load_mesh(write("a.glb", glb(with_points)))
    assert len(mesh.faces) == 4
    assert mesh.report.warnings == ("1 of 2 parts are points or lines and were omitted",)


def test_invalid_index_of_one_part_does_not_reach_the_next(write):
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
def test_defective_real_mesh_is_refused_with_the_reason(shared_data, name):
    with pytest.raises(MeshError, match=REFUSED[name]):
        load_mesh(shared_data / "meshes" / name)


@pytest.mark.parametrize("name", SOUND)
def test_real_mesh_report_matches_trimesh(shared_data, name):
    path = shared_data / "meshes" / name
    mesh = load_mesh(path)
    report = mesh.report
    loaded = trimesh.load_scene(path, process=False, maintain_order=True).to_geometry()
    np.testing.assert_allclose(mesh.vertices[mesh.faces], loaded.triangles, rtol=1e-12, atol=1e-12)
    # Welded independently and exactly; trimesh itself merges within 1e-8.
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
def test_cracked_real_mesh_is_reported_and_closed_by_rounding(shared_data, name):
    mesh = load_mesh(shared_data / "meshes" / name)
    assert mesh.report.crack_vertex_count > 0
    assert not mesh.report.closed
    assert Mesh(np.round(mesh.vertices, 6), mesh.faces).report.closed
