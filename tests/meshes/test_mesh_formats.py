"""Variants of mesh formats in real files: polygons, byte orders, strides, strips, nodes."""

import json
import struct

import numpy as np
import pytest
import trimesh
from test_mesh_files import OBJ, OFF, PLY, STL_TEXT, glb
from test_meshes import OUTWARD, TETRAHEDRON

from warpcontact.meshes import UNITS, MeshError, load_mesh
from warpcontact.meshes.readers import Unreadable
from warpcontact.meshes.readers.polygons import MOST_CORNERS, triangulate


def area_vectors(v, faces):
    return 0.5 * np.cross(v[faces[:, 1]] - v[faces[:, 0]], v[faces[:, 2]] - v[faces[:, 0]])


def star(points, turn):
    """A nonconvex star in a rotated plane."""
    angle = np.linspace(0, 2 * np.pi, 2 * points, endpoint=False)
    radius = np.where(np.arange(2 * points) % 2, 0.4, 1.0)
    return np.column_stack((radius * np.cos(angle), radius * np.sin(angle), 0 * angle)) @ turn


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("points", [3, 5, 40])
def test_nonconvex_polygons_are_filled_once(seed, points):
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    shape = np.roll(star(points, turn), seed, axis=0)
    v = np.concatenate((shape, shape + np.array((0, 0, 3))))
    n = len(shape)
    counts, corners = np.array([n, 3, n]), np.array([*range(n), 0, 1, 2, *range(n, 2 * n)])
    faces, owner = triangulate(v, counts, corners)
    assert np.bincount(owner).tolist() == [n - 2, 1, n - 2]
    expected = 0.5 * np.cross(shape, np.roll(shape, -1, axis=0)).sum(axis=0)
    for polygon in (0, 2):
        vectors = area_vectors(v, faces[owner == polygon])
        np.testing.assert_allclose(vectors.sum(axis=0), expected, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(vectors, axis=1).sum(), np.linalg.norm(expected))


def test_convex_polygons_are_fans_and_degenerate_ones_are_kept():
    faces, owner = triangulate(star(4, np.eye(3)), np.array([4, 3]), np.array([0, 2, 4, 6, 1, 2, 3]))
    assert faces.tolist() == [[0, 2, 4], [0, 4, 6], [1, 2, 3]]
    assert owner.tolist() == [0, 0, 1]
    for v in (
        np.full((5, 3), np.nan),
        np.zeros((5, 3)),
        np.zeros((2, 3)),
        np.random.default_rng(0).normal(size=(5, 3)),
    ):
        faces, _ = triangulate(v, np.array([5]), np.arange(5))
        assert len(faces) == 3


def test_polygons_with_many_vertices_must_be_convex():
    angle = np.linspace(0, 2 * np.pi, 20_000, endpoint=False)
    disk = np.column_stack((np.cos(angle), np.sin(angle), 0 * angle))
    faces, _ = triangulate(disk, np.array([len(disk)]), np.arange(len(disk)))
    np.testing.assert_allclose(np.linalg.norm(area_vectors(disk, faces), axis=1).sum(), np.pi, rtol=1e-6)
    many = star(MOST_CORNERS // 2 + 1, np.eye(3))
    with pytest.raises(
        Unreadable, match=f"face 1 has {len(many)} vertices and is not convex; allowed: 2000 vertices"
    ):
        triangulate(many, np.array([3, len(many)]), np.array([0, 1, 2, *range(len(many))]))


def ply(order, faces, kind="int", extra=False):
    """A binary PLY of the tetrahedron with an additional element and unused properties."""
    name = {"<": "little", ">": "big"}[order]
    color = "property uchar red\n" if extra else ""
    texture = "property list uchar float texcoord\n" if extra else ""
    head = (
        f"ply\nformat binary_{name}_endian 1.0\ncomment made here\nelement vertex 4\nproperty double x\n{color}"
        "property double y\nproperty double z\nelement material 2\nproperty float shine\n"
        f"element face {len(faces)}\n{texture}property list uchar {kind} vertex_indices\nend_header\n"
    ).encode()
    code = {"int": "i", "ushort": "H"}[kind]
    shade = ("B", (7,)) if extra else ("", ())
    body = b"".join(struct.pack(f"{order}d{shade[0]}dd", x, *shade[1], y, z) for x, y, z in TETRAHEDRON)
    body += struct.pack(f"{order}2f", 1, 2)
    for i, face in enumerate(faces):
        uv = [0.5] * (i % 3)
        body += struct.pack(f"{order}B{len(uv)}f", len(uv), *uv) if extra else b""
        body += struct.pack(f"{order}B{len(face)}{code}", len(face), *face)
    return head + body


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", ["int", "ushort"])
@pytest.mark.parametrize("extra", [False, True])
def test_binary_ply_of_any_layout_is_read(tmp_path, order, kind, extra):
    (tmp_path / "a.ply").write_bytes(ply(order, OUTWARD.tolist(), kind, extra))
    mesh = load_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(mesh.faces, OUTWARD)
    np.testing.assert_array_equal(mesh.vertices, TETRAHEDRON)
    (tmp_path / "b.ply").write_bytes(ply(order, [*OUTWARD[:3].tolist(), (0, 3, 2)], kind, extra)[:-3])
    with pytest.raises(MeshError, match="announces 4 face rows, but the file ends earlier; is the file cut short"):
        load_mesh(tmp_path / "b.ply")


def test_ply_with_triangles_and_quads_is_read(tmp_path):
    (tmp_path / "a.ply").write_bytes(ply("<", [(0, 1, 2, 3), (0, 1, 3), (3, 1, 2), (0, 3, 2, 1)][1:]))
    assert len(load_mesh(tmp_path / "a.ply", repair=True).faces) > 0
    (tmp_path / "b.ply").write_bytes(ply("<", [(0, 1, 2), (0, 1)]))
    with pytest.raises(MeshError, match="face 1 must have at least 3 vertices, got 2"):
        load_mesh(tmp_path / "b.ply")


def gltf(nodes, primitives, accessors, blob, **more):
    """A GLB of given parts; every accessor has a separate view."""
    views = [{"buffer": 0, **accessor.pop("view")} for accessor in accessors]
    for i, accessor in enumerate(accessors):
        accessor["bufferView"] = i
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes, **more,
        "meshes": [{"primitives": primitives}], "accessors": accessors, "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }  # fmt: skip
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    blob += bytes(-len(blob) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(blob), b"BIN\0") + blob
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


POINTS = TETRAHEDRON.astype("<f4")


def parts(indices, mode, dtype="<u1"):
    code = {"<u1": 5121, "<u2": 5123, "<u4": 5125}[dtype]
    # Vertices are interleaved with other data.
    rows = np.column_stack((POINTS, np.full((4, 1), 9, "<f4"))).tobytes()
    data = np.array(indices, dtype).tobytes()
    accessors = [
        {"componentType": 5126, "count": 4, "type": "VEC3",
         "view": {"byteOffset": 0, "byteLength": len(rows), "byteStride": 16}},
        {"componentType": code, "count": len(indices), "type": "SCALAR",
         "view": {"byteOffset": len(rows), "byteLength": len(data)}},
    ]  # fmt: skip
    return [{"attributes": {"POSITION": 0}, "indices": 1, "mode": mode}], accessors, rows + data


@pytest.mark.parametrize(
    ("indices", "mode"),
    [
        (OUTWARD.ravel(), 4),
        ([0, 2, 1, 3, 0, 2], 5),  # a closed strip
        ([0, 2, 1, 3, 3, 1, 1, 3, 0, 2], 5),  # two in one, joined by repeated vertices
    ],
)
@pytest.mark.parametrize("dtype", ["<u1", "<u2", "<u4"])
def test_triangles_and_strips_of_a_glb_are_read(tmp_path, indices, mode, dtype):
    (tmp_path / "a.glb").write_bytes(gltf([{"mesh": 0}], *parts(indices, mode, dtype)))
    report = load_mesh(tmp_path / "a.glb", repair="orient").report
    assert (report.face_count, report.closed, report.orientation) == (4, True, "outward")


def test_triangle_fan_of_a_glb_is_read(tmp_path):
    (tmp_path / "a.glb").write_bytes(gltf([{"mesh": 0}], *parts([3, 0, 1, 2, 0], 6)))
    assert load_mesh(tmp_path / "a.glb").faces.tolist() == [[3, 0, 1], [3, 1, 2], [3, 2, 0]]


def test_glb_nodes_transform_their_children(tmp_path):
    half = np.sqrt(0.5)
    nodes = [
        {"children": [1, 2], "translation": [10, 0, 0]},
        {"mesh": 0, "rotation": [0, 0, half, half], "scale": [2, 1, 1]},
        {"mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 5, 0, 1]},
    ]
    (tmp_path / "a.glb").write_bytes(gltf(nodes, *parts(OUTWARD.ravel(), 4)))
    mesh = load_mesh(tmp_path / "a.glb")
    expected = trimesh.load_scene(tmp_path / "a.glb", process=False).to_geometry()
    key = lambda t: np.sort(t.mean(axis=1).round(6), axis=0)  # noqa: E731
    np.testing.assert_allclose(key(mesh.vertices[mesh.faces]), key(expected.triangles), atol=1e-6)
    np.testing.assert_allclose(mesh.vertices[1], (10, 2, 0), atol=1e-6)
    assert [part.volume for part in mesh.report.components] == pytest.approx([1 / 3, 1 / 6], rel=1e-5)


def _indices(tree):
    return tree["accessors"][tree["meshes"][0]["primitives"][0]["indices"]]


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda t: t["nodes"][0].update(mesh=7), "an index into meshes must be from 0 to 0, got 7"),
        (lambda t: t["nodes"][0].update(mesh=-1), "an index into meshes must be from 0 to 0, got -1"),
        (lambda t: t.update(scene=True), "an index into scenes must be from 0 to 0, got True"),
        (lambda t: t["accessors"][0].update(type="VEC2"), "accessor . must be of type .*, got 'VEC2'"),
        (lambda t: t["accessors"][0].update(count=-1), "accessor . announces -1 values"),
        (lambda t: t["meshes"][0]["primitives"][0].update(extensions={"KHR_draco_mesh_compression": {}}),
         "compression .KHR_draco_mesh_compression. is not"),
        (lambda t: t["meshes"][0]["primitives"][0]["attributes"].pop("POSITION"), "a part has no POSITION"),
        (lambda t: t.update(meshes=[3]), r"meshes\[0\] must be an object"),
        (lambda t: t["meshes"][0]["primitives"][0].update(extensions={"VENDOR_a": {}, "EXT_b_compression": {}}),
         "compression .EXT_b_compression. is not"),
        (lambda t: (t["buffers"].append(dict(t["buffers"][0])), [v.update(buffer=1) for v in t["bufferViews"]]),
         "buffer 1 has no data; only buffer 0 can be the binary part of the file"),
        (lambda t: t.update(extensionsRequired=["EXT_meshopt_compression"]),
         "the file needs the extension 'EXT_meshopt_compression', which is not supported"),
        (lambda t: t.update(extensionsRequired=["KHR_texture_transform", "KHR_draco_mesh_compression"]),
         "the file needs the extension 'KHR_draco_mesh_compression', which"),
        (lambda t: t["asset"].update(version="3.1"), r"glTF version must be '2\.0', got '3\.1'"),
        (lambda t: t["asset"].update(version="1.0"), r"glTF version must be '2\.0', got '1\.0'"),
        (lambda t: t["asset"].pop("version"), "KeyError: 'version'"),
        (lambda t: _indices(t).update(componentType=5126), "must be unsigned integers, .* got float32"),
        (lambda t: _indices(t).update(componentType=5124), "of type SCALAR, got 'SCALAR' of 5124"),
        (lambda t: _indices(t).update(normalized=True), "must be unsigned integers, not normalized; got float64"),
    ],
)  # fmt: skip
def test_invalid_references_of_a_glb_are_reported(tmp_path, edit, message):
    (tmp_path / "a.glb").write_bytes(glb(edit))
    with pytest.raises(MeshError, match=message):
        load_mesh(tmp_path / "a.glb")


def test_glb_of_another_version_is_refused(tmp_path):
    data = bytearray(glb())
    data[4] = 1
    (tmp_path / "a.glb").write_bytes(data)
    with pytest.raises(MeshError, match="GLB version must be 2, got 1"):
        load_mesh(tmp_path / "a.glb")


def _skin(tree):
    tree["skins"] = [{"joints": [0]}]
    tree["nodes"][0]["skin"] = 0


def _morph(weights):
    def edit(tree):
        tree["meshes"][0]["weights"] = weights
        tree["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": 0}]

    return edit


BENT = "1 of 1 parts have a skin or morph targets, which were ignored"


@pytest.mark.parametrize(
    ("edit", "warnings"),
    [
        (_skin, (BENT,)),
        (_morph([0.5]), (BENT,)),
        (_morph([0.0]), ()),
        (lambda t: t["nodes"][0].update(extensions={"EXT_mesh_gpu_instancing": {}}),
         ("instances of EXT_mesh_gpu_instancing were ignored; such parts are included once",)),
        (lambda t: t.update(extensionsRequired=["KHR_materials_unlit", "KHR_mesh_quantization"]), ()),
    ],
)  # fmt: skip
def test_unsupported_content_of_a_glb_is_reported(tmp_path, edit, warnings):
    (tmp_path / "a.glb").write_bytes(glb(edit))
    assert load_mesh(tmp_path / "a.glb").report.warnings == warnings


@pytest.mark.parametrize("kind", ["float", "double"])
def test_ply_vertex_indices_must_be_integers(tmp_path, kind):
    binary = ply("<", OUTWARD.tolist()).replace(b"list uchar int", f"list uchar {kind}".encode())
    for content in (PLY.replace("uchar int", f"uchar {kind}").encode(), binary):
        (tmp_path / "a.ply").write_bytes(content)
        with pytest.raises(MeshError, match="vertex_indices must be a list of an integer type, got f"):
            load_mesh(tmp_path / "a.ply")


def test_ply_vertex_lists_are_refused(tmp_path):
    rows = "".join(f"{x} {y} {z} 1 7\n" for x, y, z in TETRAHEDRON)
    head, faces = PLY.replace("property float z\n", "property float z\nproperty list uchar int w\n").split(
        "0 0 0\n"
    )
    (tmp_path / "a.ply").write_text(head + rows + faces.partition("0 0 1\n")[2])
    with pytest.raises(MeshError, match="list properties of vertices are not supported"):
        load_mesh(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("name", "content", "old", "new", "message"),
    [
        ("a.obj", OBJ, "v 1 0 0", "v 1_0 0 0", "line 2: 3 or more numbers are needed, got '1_0 0 0'"),
        ("a.obj", OBJ, "f 1 3 2", "f 1 0_3 2", "line 5: 3 or more numbers are needed, got '1 0_3 2'"),
        ("a.off", OFF, "1 0 0", "1_0 0 0", "vertex 1: 3 or more numbers are needed, got '1_0 0 0'"),
        ("a.off", OFF, "3 0 2 1", "3 0 0_2 1", "face 0: 3 or more numbers are needed, got '0 0_2 1'"),
        ("a.ply", PLY, "1 0 0\n", "1_0 0 0\n", "'1_0' is not a number"),
        ("a.ply", PLY, "3 0 2 1", "3 0 0_2 1", "'0_2' is not a number"),
        ("a.stl", STL_TEXT, "vertex 1.0", "vertex 1_0.0", "line 6: 3 or more numbers are needed, got '1_0.0"),
    ],
)
def test_python_number_syntax_is_refused_in_mesh_files(tmp_path, name, content, old, new, message):
    assert old in content
    (tmp_path / name).write_text(content.replace(old, new, 1))
    with pytest.raises(MeshError, match=message):
        load_mesh(tmp_path / name, trusted=True)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize(
    ("rows", "line"),
    [
        ("v 0 \\\n 0 0\nv 1 0 0\nv 0 1 0\nf 1 \\\n 2 \\\n 3\n# note\nf 1 x 3\n", 9),
        ("v 0 0 0\nf 1 \\\n x \\\n 3\n", 2),
        ("v 0 0 0\nv 0 0 0\nf 1 x \\\n", 3),
        ("v 0 0 0\nv 0 0 0\nf 1 \\\n x 3 \\", 3),
    ],
)
def test_obj_line_numbers_match_text_editors(tmp_path, rows, line, end):
    (tmp_path / "a.obj").write_bytes(rows.replace("\n", end).encode())
    with pytest.raises(MeshError, match=f"line {line}: 3 or more numbers are needed"):
        load_mesh(tmp_path / "a.obj", trusted=True)


@pytest.mark.parametrize("unit", UNITS)
def test_units_are_meters_per_unit(tmp_path, unit):
    (tmp_path / "a.obj").write_text(OBJ)
    mesh = load_mesh(tmp_path / "a.obj", unit=unit, trusted=True)
    units = {
        "m": 1,
        "dm": 0.1,
        "cm": 0.01,
        "mm": 0.001,
        "um": 1e-6,
        "µm": 1e-6,
        "km": 1000,
        "in": 0.0254,
        "ft": 0.3048,
    }
    np.testing.assert_array_equal(mesh.vertices, TETRAHEDRON * units[unit])
    half = load_mesh(tmp_path / "a.obj", unit=unit, scale=0.5, trusted=True)
    np.testing.assert_array_equal(half.vertices, 0.5 * TETRAHEDRON * units[unit])
    with pytest.raises(ValueError, match="unit must be one of m, dm, cm, mm, um, µm, km, in, ft, got 'inch'"):
        load_mesh(tmp_path / "a.obj", unit="inch")
