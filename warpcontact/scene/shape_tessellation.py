"""Triangulation of shapes, for drawing and for estimates."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes import tessellation
from warpcontact.kernels.shapes.base import Plane
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface
from warpcontact.kernels.shapes.revolution import Torus
from warpcontact.meshes import icosphere
from warpcontact.storage.parameters import pack
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.devices import find_device
from warpcontact.validation.checks import Array

# Subdivisions of an icosahedron for convex shapes; steps per parameter for parametric surfaces and tori.
LEVEL = 4
STEPS = 48

Faces = NDArray[np.signedinteger[Any]]


def tessellate(kind: type[Form], sizes: Mapping[str, Array], reach: float = 1.0) -> tuple[Array, Faces]:
    """Returns the surface of a shape as points (n, 3) [m], in its frame, and triangles (m, 3), oriented outwards.

    Args:
        kind: Class of the shape.
        sizes: Parameters of the shape.
        reach: Half the side of the square that represents a half-space [m].
    """
    if issubclass(kind, Plane):
        corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        return reach * corners, np.array([[0, 1, 2], [0, 2, 3]])
    if issubclass(kind, Torus):
        around, faces = _grid((0.0, 2 * np.pi), (0.0, 2 * np.pi), (True, True))
        distance = sizes["major_radius"] + sizes["minor_radius"] * np.cos(around[:, 1])
        height = sizes["minor_radius"] * np.sin(around[:, 1])
        return np.stack([distance * np.cos(around[:, 0]), distance * np.sin(around[:, 0]), height], axis=1), faces
    if issubclass(kind, ParametricSurface):
        parameters, faces = _grid(kind.u_range, kind.v_range, (kind.u_periodic, kind.v_periodic))
        return _computed(kind, sizes, tessellation.patch_points(kind), parameters, wp.vec2d), faces
    ball = icosphere(1.0, LEVEL)
    return _computed(kind, sizes, tessellation.support_points(kind), ball.vertices, wp.vec3d), ball.faces


@shared_capture_lock()
def _computed(
    kind: type[Form], sizes: Mapping[str, Array], kernel: wp.Kernel, given: Array, dtype: Any
) -> NDArray[np.float64]:
    struct = coefficient_struct(kind, wp.float64)
    columns = {key: np.asarray(value)[None, None] for key, value in sizes.items()}
    names = kind.device_names()
    computed = kind.coefficients(columns) if names else {"unused": np.zeros((1, 1))}
    packed = pack(struct, {name: computed[name] for name in names or ("unused",)})
    device = find_device("cpu")
    points = wp.zeros(len(given), dtype=wp.vec3d, device=device)
    inputs = [wp.array(packed, dtype=struct, device=device), wp.array(given, dtype=dtype, device=device)]
    wp.launch(kernel, dim=len(given), inputs=inputs, outputs=[points], device=device)
    return points.numpy()


def _grid(u: tuple[float, float], v: tuple[float, float], closed: tuple[bool, bool]) -> tuple[Array, Faces]:
    """Returns a grid of parameters (n, 2) over two ranges, and its triangles (m, 3)."""
    lines = [
        np.linspace(*ends, STEPS + 1)[: STEPS + (not periodic)]
        for ends, periodic in zip((u, v), closed, strict=True)
    ]
    parameters = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 2)
    i, j = np.meshgrid(np.arange(STEPS), np.arange(STEPS), indexing="ij")
    rows, columns = (len(line) for line in lines)

    def number(i: Faces, j: Faces) -> Faces:
        return (i % rows) * columns + j % columns

    corners = [number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)]
    faces = np.stack([np.stack(corners[:3], axis=-1), np.stack([corners[0], corners[2], corners[3]], axis=-1)])
    return parameters, faces.reshape(-1, 3)
