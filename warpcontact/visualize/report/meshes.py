"""Simplification of triangle meshes for the replay of the report."""

import functools

import numpy as np

from warpcontact.drawing.drawing import Shape
from warpcontact.drawing.triangles import ball
from warpcontact.meshes import icosphere
from warpcontact.visualize.report.packing import Pack

# Largest number of triangles of one shape; larger meshes are simplified by vertex clustering.
TRIANGLES = 120_000
# Numbers of copies of a sphere above which it has fewer icosahedron subdivisions: (copies, subdivisions).
FEWER = ((4096, 1), (256, 2))


def drawable_shape(shape: Shape, copies: int) -> Shape:
    """Returns a shape simplified for ``copies`` copies in the replay."""
    if shape is ball():
        level = next((level for count, level in FEWER if copies > count), None)
        if level is not None:
            return _sphere(level)
        return shape
    return shape if len(shape.faces) <= TRIANGLES else _coarsen(shape)


@functools.cache
def _sphere(level: int) -> Shape:
    mesh = icosphere(1.0, level)
    return Shape(mesh.vertices, mesh.faces, normals=mesh.vertices)


def add_shape(pack: Pack, shape: Shape, finest: float) -> dict[str, bool]:
    """Adds a shape to a pack, and returns whether it has normals and colors.

    Args:
        pack: Pack to add to.
        shape: Shape to add.
        finest: Largest position error that is invisible [m].
    """
    pack.series(shape.vertices, finest)
    pack.indices(shape.faces)
    if shape.normals is not None:
        pack.series(shape.normals)
    if shape.colors is not None:
        pack.series(shape.colors)
    return {"normals": shape.normals is not None, "colors": shape.colors is not None}


def _coarsen(shape: Shape) -> Shape:
    """Returns a shape with vertices merged per cell of a grid, until the number of triangles is small enough."""
    low = shape.vertices.min(axis=0)
    size = float(np.ptp(shape.vertices, axis=0).max()) or 1.0
    cells = 1024
    while True:
        places = np.floor((shape.vertices - low) / size * cells).astype(np.int64)
        _, number, counts = np.unique(places, axis=0, return_inverse=True, return_counts=True)
        number = number.reshape(-1)
        faces = number[shape.faces]
        proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        if proper.sum() <= TRIANGLES:
            break
        cells = int(cells / 1.4)
    vertices = np.stack([np.bincount(number, shape.vertices[:, axis]) / counts for axis in range(3)], axis=1)
    colors = None if shape.colors is None else shape.colors[proper]
    return Shape(vertices, faces[proper].astype(np.int32), colors)
