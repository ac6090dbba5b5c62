"""Features of polyhedra: which are convex with all neighbors, and outlines of planes with several faces."""

import numpy as np
import trimesh

import warpcontact as wc
from warpcontact.geometry.polyhedron import Polyhedron
from warpcontact.geometry.polyhedron_features import PolyhedronFeatures, has_convex_features


def cube_with_vertex_in_edge():
    """Returns a cube whose front face is two, with a vertex within an edge of its top face."""
    vertices = np.array(
        [[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)] + [[0, -1, -1], [0, -1, 1]]
    )
    front = [[0, 8, 9, 1], [8, 4, 5, 9]]
    others = [[0, 1, 3, 2], [4, 6, 7, 5], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    planes = np.array([0, 2, 3, 4, 5, 6], dtype=np.int32)
    return Polyhedron.from_faces(vertices, np.array(front + others, dtype=np.int32), planes, is_closed=True)


def test_convex_polyhedron_with_a_vertex_within_an_edge_has_no_convex_features():
    """Its top face has no edge in common with the front faces, so a search from neighbor to neighbor would miss it."""
    assert has_convex_features(Polyhedron.unit_box())
    cube = cube_with_vertex_in_edge()
    assert cube.is_convex
    assert not cube.has_paired_edges
    assert not has_convex_features(cube)
    assert not PolyhedronFeatures.of(cube).is_convex


def test_outline_of_a_plane_is_a_loop_of_its_vertices():
    prism = trimesh.creation.cylinder(radius=1.0, height=2.0, sections=12)
    polyhedron = Polyhedron.from_mesh(wc.Mesh(prism.vertices, prism.faces))
    features = PolyhedronFeatures.of(polyhedron)
    normals = polyhedron.planes()[0][polyhedron.plane_faces]
    ends = np.flatnonzero(np.abs(normals[:, 2]) > 0.5)
    assert sorted(features.outlines) == sorted(ends)
    for plane, (vertices, edges) in features.outlines.items():
        assert len(set(vertices)) == 12
        places = polyhedron.vertices[vertices]
        area = 0.5 * np.cross(places, np.roll(places, -1, axis=0)).sum(axis=0)
        # Counter-clockwise, and the area of a regular polygon of 12 vertices.
        np.testing.assert_allclose(area @ normals[plane], 6 * np.sin(np.pi / 6), rtol=1e-12)
        for i, edge in enumerate(edges):
            assert set(features.edges[edge, :2]) == {vertices[i], vertices[(i + 1) % 12]}
