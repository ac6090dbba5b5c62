"""Shapes as triangles with normals, to be drawn: round where they are smooth, with edges where they have them."""

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import trimesh

from warpcontact.drawing.drawing import Shape
from warpcontact.forces.shape_contact.tessellate import tessellate
from warpcontact.kernels.shapes import shapes
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.shapes.plane import Plane
from warpcontact.meshes import icosphere
from warpcontact.validation.checks import Array

# Faces that meet at less than this look round.
SHAPE_CONTACT_MEASURES = math.radians(25.0)
# Halvings of an icosahedron that make a sphere.
LEVEL = 3
# Sides of what has a circular edge.
SECTIONS = 64
# Points of a mesh that are closer than this, in sizes of it, are one.
NEAR = 1.0e-6


@functools.cache
def ball() -> Shape:
    """Returns the sphere of radius 1."""
    mesh = icosphere(1.0, LEVEL)
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    return Shape(mesh.vertices, mesh.faces, normals=normals)


def analytic_shape(kind: type[Form], sizes: Mapping[str, Array], reach: float) -> Shape:
    """Returns a shape of analytic form; ``reach``: half the side of what is drawn of a half-space [m]."""
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
    """Returns triangles with normals that are common where faces meet at a small angle; without empty faces."""
    size = float(np.ptp(vertices, axis=0).max()) or 1.0
    _, first, number = np.unique(
        np.round(vertices / (NEAR * size)), axis=0, return_index=True, return_inverse=True
    )
    faces = number.reshape(-1)[faces]
    vertices = vertices[first]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    mesh = trimesh.Trimesh(vertices, faces[area > NEAR**2 * size**2], process=False)
    split = trimesh.graph.smooth_shade(mesh, angle=SHAPE_CONTACT_MEASURES, facet_minarea=None)
    return Shape(
        np.asarray(split.vertices),
        np.asarray(split.faces, dtype=np.int32),
        normals=np.asarray(split.vertex_normals),
    )
