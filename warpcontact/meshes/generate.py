"""Generators of simple meshes: rectangle, terrain, box and sphere."""

from math import isfinite, sqrt
from numbers import Real

import numpy as np
import numpy.typing as npt

from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.meshes.mesh import Mesh, positive

# 20·4⁸ = 1 310 720 faces; the sphere is then exact to 1e-5.
MAX_SUBDIVISIONS = 8
MAX_CELLS = 100_000_000  # 200 million triangles; larger values are likely mistakes


@explain_keywords
def grid(size: tuple[float, float] = (1.0, 1.0), cells: tuple[int, int] = (1, 1), name: str = "grid") -> Mesh:
    """Returns a flat rectangle in the plane z = 0, centered at the origin, with outer side +z.

    Args:
        size: Lengths along x and y [m], positive.
        cells: Numbers of cells along x and y, at least 1; two triangles in each.
        name: Name of the mesh.

    Returns:
        An open mesh of (nx + 1)·(ny + 1) vertices and 2·nx·ny faces.

    Raises:
        ValueError: If a length is not positive and finite, or a number of cells not a positive integer.
    """
    return Mesh(*_plane(size, cells), name=name)


@explain_keywords
def sinusoidal_terrain(
    size: tuple[float, float] = (10.0, 10.0),
    cells: tuple[int, int] = (100, 100),
    amplitude: float = 0.2,
    wavelength: float = 2.5,
    name: str = "terrain",
) -> Mesh:
    """Returns terrain of height z = amplitude·sin(2πx/λ)·sin(2πy/λ) at the vertices, with its outer side above.

    Args:
        size: Lengths along x and y [m], positive; centered at the origin.
        cells: Numbers of cells along x and y, at least 1; at least ten per wavelength give a smooth surface.
        amplitude: Largest height [m], finite.
        wavelength: λ [m], positive.
        name: Name of the mesh.

    Returns:
        An open mesh with the layout of :func:`grid`.

    Raises:
        ValueError: If a length is not positive and finite, a number of cells not a positive integer, or
            the amplitude not finite.
    """
    if not isinstance(amplitude, Real) or not isfinite(amplitude):
        raise ValueError(f"amplitude must be finite, got {amplitude!r}")
    vertices, faces = _plane(size, cells)
    phase = 2.0 * np.pi / positive("wavelength", wavelength) * vertices[:, :2]
    vertices[:, 2] = amplitude * np.sin(phase[:, 0]) * np.sin(phase[:, 1])
    return Mesh(vertices, faces, name=name)


@explain_keywords
def box(size: tuple[float, float, float] = (1.0, 1.0, 1.0), name: str = "box") -> Mesh:
    """Returns a closed box along the axes, centered at the origin, oriented outward.

    Args:
        size: Edge lengths along x, y, z [m], positive.
        name: Name of the mesh.

    Returns:
        A mesh of 8 vertices and 12 faces.

    Raises:
        ValueError: If a length is not positive and finite.

    Example:
        >>> box = wc.meshes.box((1.0, 2.0, 3.0))
        >>> box
        Mesh('box', 8 vertices, 12 faces, closed)
        >>> round(box.report.volume, 9)
        6.0
    """
    lengths = _lengths(size, 3)
    # Vertex 4·i + 2·j + k is at (i, j, k).
    corners = np.array([(i, j, k) for i in (0, 1) for j in (0, 1) for k in (0, 1)], dtype=np.float64)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in sides for triangle in ((a, b, c), (a, c, d))]
    return Mesh((corners - 0.5) * lengths, faces, name=name)


@explain_keywords
def icosphere(radius: float = 1.0, subdivisions: int = 3, name: str = "icosphere") -> Mesh:
    """Returns a sphere about the origin, made of nearly equal triangles, oriented outward.

    The vertices lie on the sphere, so the rest of the surface is inside the sphere.

    Args:
        radius: Distance of the vertices from the origin [m], positive.
        subdivisions: Number of subdivisions of the faces of an icosahedron into four, 0 to 8.
        name: Name of the mesh.

    Returns:
        A closed mesh of 20·4ⁿ faces.

    Raises:
        ValueError: If the radius is not positive and finite, or the number of subdivisions is not an integer from 0 to 8.
    """
    radius = positive("radius", radius)
    levels = _integer("subdivisions", subdivisions, 0, MAX_SUBDIVISIONS)
    g = (1.0 + sqrt(5.0)) / 2.0  # golden ratio: three rectangles 1 : g span the icosahedron
    vertices = np.array([p for s in (-1, 1) for t in (-g, g) for p in ((0, s, t), (s, t, 0), (t, 0, s))])
    # Faces are the triples of vertices at mutual distance 2, the edge length; they are oriented outward below.
    near = np.isclose(np.linalg.norm(vertices[:, None] - vertices, axis=2), 2.0)
    triples = [
        (a, b, c) for a in range(12) for b in range(a) for c in range(b) if near[a, b] & near[b, c] & near[c, a]
    ]
    faces = np.array(triples)
    inward = np.linalg.det(vertices[faces]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    for _ in range(levels):
        vertices, faces = _divide(vertices, faces)
    vertices *= radius / np.linalg.norm(vertices, axis=1, keepdims=True)
    return Mesh(vertices, faces, name=name)


def _divide(
    vertices: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Divides each face into four, with new vertices at the midpoints of edges, moved to the sphere."""
    edges = np.sort(np.stack((faces, np.roll(faces, -1, axis=1)), axis=2), axis=2).reshape(-1, 2)
    pairs, middle = np.unique(edges, axis=0, return_inverse=True)
    points = vertices[pairs].sum(axis=1)
    # Project to the sphere at every level, so that the triangles stay nearly equal.
    points *= np.linalg.norm(vertices[0]) / np.linalg.norm(points, axis=1, keepdims=True)
    a, b, c = faces.T
    ab, bc, ca = (middle.reshape(-1, 3) + len(vertices)).T
    quarters = np.stack(((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)), axis=0)
    return np.concatenate((vertices, points)), quarters.transpose(2, 0, 1).reshape(-1, 3)


def _plane(
    size: tuple[float, float], cells: tuple[int, int]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Returns vertices and faces of :func:`grid`."""
    lengths = _lengths(size, 2)
    counts = _sequence("cells", cells, 2)
    nx, ny = (_integer(f"cells[{i}]", count, 1, MAX_CELLS) for i, count in enumerate(counts))
    if nx * ny > MAX_CELLS:
        raise ValueError(f"cells must be at most {MAX_CELLS} in all, got {nx}·{ny} = {nx * ny}")
    x, y = (length * (np.arange(n + 1) / n - 0.5) for length, n in zip(lengths, (nx, ny), strict=True))
    vertices = np.zeros((nx + 1, ny + 1, 3))
    vertices[..., 0], vertices[..., 1] = x[:, None], y
    number = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    faces = np.stack((a, b, c, a, c, d), axis=-1).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces


def _lengths(size: tuple[float, ...], count: int) -> list[float]:
    return [positive(f"size[{i}]", length) for i, length in enumerate(_sequence("size", size, count))]


def _sequence(label: str, values: object, count: int) -> list[object]:
    """Returns ``values`` as a list of ``count`` entries; raises ``ValueError`` if that is impossible."""
    rows = values.tolist() if isinstance(values, np.ndarray) else values  # a 0-d array gives a scalar
    entries = list(rows) if isinstance(rows, (tuple, list)) else []
    if len(entries) != count:
        raise ValueError(f"{label} must have {count} entries, got {values!r}")
    return entries


def _integer(label: str, value: object, lowest: int, highest: int) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or not lowest <= value <= highest:
        raise ValueError(f"{label} must be an integer from {lowest} to {highest}, got {value!r}")
    return int(value)
