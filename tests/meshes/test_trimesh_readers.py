"""Files for which trimesh returns wrong arrays without an error, and the readers of this package do not.

They are the reason for the readers of this package. If trimesh reads a file correctly, its case fails: remove the case,
and the reader if it was the last case of its format.
"""

import numpy as np
import pytest
import trimesh
from test_mesh_formats import gltf, parts
from test_meshes import TETRAHEDRON

from warpcontact import load_mesh
from warpcontact.meshes import MeshError

#: A concave polygon: a fan from its first vertex covers its notch.
DART = "0 0 0\n2 0 0\n2 2 0\n1.5 0.5 0\n"
DART_FACES = [[0, 1, 3], [1, 2, 3]]
#: A square with a triangle at its side.
FLAG = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n2 0 0\n"
FLAG_FACES = [[0, 1, 2], [0, 2, 3], [1, 4, 2]]
PLY = (
    "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {}\nproperty list uchar int vertex_indices\nend_header\n"
)
OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\n"
SOLID = (
    "solid {0}\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    "endsolid {0}\n"
)


def content(file):
    """Returns the triangles of a file as trimesh reads it, (F, 3, 3)."""
    return np.asarray(trimesh.load_scene(file, process=False, maintain_order=True).to_geometry().triangles)


def from_least_vertex(some):
    """Returns triangles (F, 3, 3) rotated to begin with their lexicographically least vertex."""
    turned = [np.roll(one, -min(range(3), key=lambda k: tuple(one[k])), axis=0) for one in some]
    return np.array(turned).reshape(-1, 3, 3)


def triangles(vertices, faces):
    return np.array(vertices, dtype=float)[np.array(faces)]


def vertices_of(text):
    return np.array([line.split() for line in text.splitlines()], dtype=float)


@pytest.mark.parametrize(
    ("suffix", "data", "expected"),
    [
        # Polygons are split into fans.
        ("obj", "".join(f"v {line}\n" for line in DART.splitlines()) + "f 1 2 3 4\n",
         triangles(vertices_of(DART), DART_FACES)),
        ("ply", PLY.format(4, 1) + DART + "4 0 1 2 3\n", triangles(vertices_of(DART), DART_FACES)),
        ("off", f"OFF\n4 1 0\n{DART}4 0 1 2 3\n", triangles(vertices_of(DART), DART_FACES)),
        # All triangles of the file come first.
        ("ply", PLY.format(5, 2) + FLAG + "4 0 1 2 3\n3 1 4 2\n", triangles(vertices_of(FLAG), FLAG_FACES)),
        ("off", f"OFF\n5 2 0\n{FLAG}4 0 1 2 3\n3 1 4 2\n", triangles(vertices_of(FLAG), FLAG_FACES)),
        # Faces are sorted by material, and relative numbers count from the end of the file.
        ("obj", OBJ + "usemtl b\nf 1 2 3\nusemtl a\nf 1 3 4\nusemtl b\nf 2 5 3\n",
         triangles(vertices_of(FLAG), FLAG_FACES)),
        ("obj", OBJ + "f -5 -4 -3\nv 5 5 5\n", triangles(vertices_of(FLAG), FLAG_FACES[:1])),
        # A fan is omitted; a strip keeps its degenerate triangles.
        ("glb", gltf([{"mesh": 0}], *parts([3, 0, 1, 2, 0], 6)),
         triangles(TETRAHEDRON, [[3, 0, 1], [3, 1, 2], [3, 2, 0]])),
        ("glb", gltf([{"mesh": 0}], *parts([0, 2, 1, 3, 3, 1, 1, 3, 0, 2], 5)),
         triangles(TETRAHEDRON, [[0, 2, 1], [1, 2, 3], [1, 3, 0], [0, 3, 2]])),
    ],
    ids=["obj-concave", "ply-concave", "off-concave", "ply-order", "off-order", "obj-order", "obj-relative",
         "glb-fan", "glb-strip"],
)  # fmt: skip
def test_valid_file_is_read_correctly_and_by_trimesh_wrongly(suffix, data, expected, tmp_path):
    file = tmp_path / f"a.{suffix}"
    file.write_bytes(data if isinstance(data, bytes) else data.encode())
    mesh = load_mesh(file)
    expected = from_least_vertex(expected)
    np.testing.assert_array_equal(from_least_vertex(mesh.vertices[mesh.faces]), expected)
    other = from_least_vertex(content(file))
    assert other.shape != expected.shape or (other != expected).any()


@pytest.mark.parametrize(
    ("suffix", "text", "message"),
    [
        ("stl", SOLID.format("a") + SOLID.format("b").removesuffix("endsolid b\n"), "the file cut short"),
        ("ply", PLY.format(4, 2) + DART + "3 0 1 2\n", "the file cut short"),
        ("off", f"OFF\n4 2 0\n{DART}3 0 1 2\n", "the file cut short"),
        ("obj", OBJ + "f 0 2 3\n", "a vertex number must be from 1"),
    ],
    ids=["stl", "ply", "off", "obj"],
)
def test_damaged_file_is_refused_and_read_by_trimesh(suffix, text, message, tmp_path):
    file = tmp_path / f"a.{suffix}"
    file.write_text(text)
    with pytest.raises(MeshError, match=message):
        load_mesh(file)
    assert len(content(file)) == 1
