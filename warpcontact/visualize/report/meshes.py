"""Triangles as a page holds them: few enough to be sent and drawn anywhere."""

import functools

import numpy as np

from warpcontact.drawing.drawing import Shape
from warpcontact.drawing.triangles import ball
from warpcontact.meshes import icosphere
from warpcontact.visualize.report.packing import Pack

# Triangles of one shape; of more, points that are near each other become one.
TRIANGLES = 120_000
# Copies of a sphere, from which on it is drawn with fewer triangles: halvings of an icosahedron.
FEWER = ((4096, 1), (256, 2))


def drawable_shape(shape: Shape, copies: int) -> Shape:
    """Returns what is drawn for a shape of which there are so many copies."""
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
    """Adds a shape to a pack, and returns what it has beside points and faces.

    Args:
        pack: The pack.
        shape: The shape.
        finest: Steps of this length [m] are not seen.
    """
    pack.series(shape.vertices, finest)
    pack.indices(shape.faces)
    if shape.normals is not None:
        pack.series(shape.normals)
    if shape.colors is not None:
        pack.series(shape.colors)
    return {"normals": shape.normals is not None, "colors": shape.colors is not None}


def _coarsen(shape: Shape) -> Shape:
    """Returns a shape with the points of each cell of a grid in one place."""
    low = shape.vertices.min(axis=0)
    size = float(np.ptp(shape.vertices, axis=0).max()) or 1.0
    cells = 1024
    while True:
        places = np.floor((shape.vertices - low) / size * cells).astype(np.int64)
        _, number, counts = np.unique(places, axis=0, return_inverse=True, return_counts=True)
        number = number.reshape(-1)
        faces = number[shape.faces]
        whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
        if whole.sum() <= TRIANGLES:
            break
        cells = int(cells / 1.4)
    vertices = np.stack([np.bincount(number, shape.vertices[:, axis]) / counts for axis in range(3)], axis=1)
    colors = None if shape.colors is None else shape.colors[whole]
    return Shape(vertices, faces[whole].astype(np.int32), colors)
