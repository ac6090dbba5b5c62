"""Triangulation of shapes for drawing, with vertex normals: smooth, except at sharp edges."""

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import trimesh

from warpcontact.drawing.drawing import Shape
from warpcontact.kernels import shapes
from warpcontact.kernels.shapes.base import Plane
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.meshes import icosphere
from warpcontact.scene.shapes import tessellate
from warpcontact.validation.checks import Array

# Faces that meet at a smaller angle are shaded smoothly.
SMOOTH_ANGLE = math.radians(25.0)
# Number of subdivisions of an icosahedron for a sphere.
LEVEL = 3
# Number of sides of circular edges.
SECTIONS = 64
# Vertices closer than this fraction of the mesh size are merged.
NEAR = 1.0e-6


@functools.cache
def ball() -> Shape:
    """Returns the unit sphere. The object is cached, so that renderers can recognize it."""
    mesh = icosphere(1.0, LEVEL)
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    return Shape(mesh.vertices, mesh.faces, normals=normals)


def analytic_shape(kind: type[Form], sizes: Mapping[str, Array], reach: float) -> Shape:
    """Returns the triangles of a shape; ``reach``: half the side of the square that represents a plane [m]."""
    if kind is shapes.Cylinder:
        height = 2.0 * float(sizes["half_length"])
        exact = trimesh.creation.cylinder(float(sizes["radius"]), height, sections=SECTIONS)
    elif kind is shapes.Cone:
        exact = trimesh.creation.cone(float(sizes["radius"]), float(sizes["height"]), sections=SECTIONS)
    else:
        vertices, faces = tessellate(kind, sizes, reach)
        if issubclass(kind, Plane):
            return Shape(vertices, faces.astype(np.int32))
        return smooth(vertices, faces)
    return smooth(np.asarray(exact.vertices), np.asarray(exact.faces))


def smooth(vertices: Array, faces: Any) -> Shape:
    """Returns triangles with normals shared where faces meet at a small angle; drops degenerate faces."""
    size = float(np.ptp(vertices, axis=0).max()) or 1.0
    _, first, number = np.unique(
        np.round(vertices / (NEAR * size)), axis=0, return_index=True, return_inverse=True
    )
    faces = number.reshape(-1)[faces]
    vertices = vertices[first]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    mesh = trimesh.Trimesh(vertices, faces[area > NEAR**2 * size**2], process=False)
    split = trimesh.graph.smooth_shade(mesh, angle=SMOOTH_ANGLE, facet_minarea=None)
    return Shape(
        np.asarray(split.vertices),
        np.asarray(split.faces, dtype=np.int32),
        normals=np.asarray(split.vertex_normals),
    )
