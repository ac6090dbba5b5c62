"""Packing of arrays as text in a page: quantized, compressed; decoded by ``web/src/unpack.js``.

A pack is a byte stream, deflated and base64-encoded, and a list of array headers: type, ``shape`` and, if quantized,
``low`` and ``step`` of each component (last axis). Integers are stored as differences along the first axis, low bytes
first and high bytes after, which compresses smooth motion well.
"""

import base64
import functools
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.drawing.drawing import Shape, ball
from warpcontact.meshes import icosphere
from warpcontact.validation.checks import Array

# Quantized values are 0 … MOST; the largest 16-bit number denotes NaN.
MOST = 65534
NAN = 65535

# Largest number of triangles of one shape; larger meshes are simplified by vertex clustering.
TRIANGLES = 120_000
# Numbers of copies of a sphere above which it has fewer icosahedron subdivisions: (copies, subdivisions).
FEWER = ((4096, 1), (256, 2))


class Pack:
    """Arrays packed together, in the order in which they are added."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._numbers: dict[tuple[Any, ...], int] = {}
        self._array_headers: list[dict[str, Any]] = []

    @property
    def raw(self) -> int:
        """Uncompressed size [bytes]."""
        return sum(map(len, self._parts))

    def exact(self, values: NDArray[Any]) -> None:
        """Adds numbers as 32-bit floats."""
        data = np.ascontiguousarray(values, dtype="<f4")
        self._add("float", data.shape, data.tobytes())

    def series(self, values: Array, finest: float = 0.0) -> None:
        """Adds an array (time, …, component), quantized to 16 bits between the extremes of each component.

        Args:
            values: The array; NaN for unknown values.
            finest: If the quantization step would exceed this, the array is added as floats; 0: never.
        """
        values = np.asarray(values, dtype=np.float64)
        finite = np.isfinite(values)
        axes = tuple(range(values.ndim - 1))
        low = values.min(axis=axes, where=finite, initial=np.inf)
        high = values.max(axis=axes, where=finite, initial=-np.inf)
        low, high = (np.where(low <= high, end, 0.0) for end in (low, high))
        step = (high - low) / MOST
        if finest > 0.0 and step.max(initial=0.0) > finest:
            self.exact(values)
            return
        scale = np.where(step > 0.0, step, 1.0)
        integers = np.where(finite, np.round((np.where(finite, values, low) - low) / scale), NAN).astype(np.uint16)
        self._add_integers(integers, low, step)

    def indices(self, values: NDArray[Any]) -> None:
        """Adds nonnegative integers in 32 bits, with small differences between neighbors."""
        flat = np.ascontiguousarray(values, dtype=np.uint32).reshape(-1)
        differences = np.diff(flat, prepend=np.zeros(1, np.uint32)).astype("<u4")
        planar = np.ascontiguousarray(differences.view(np.uint8).reshape(-1, 4).T)
        self._add("index", values.shape, planar.tobytes())

    def rotations(self, values: Array) -> None:
        """Adds unit quaternions (time, …, 4), with signs chosen for continuity, because q and −q are equivalent."""
        values = np.asarray(values, dtype=np.float64)
        turned = np.sum(values[1:] * values[:-1], axis=-1) < 0.0
        signs = np.where(np.cumsum(turned, axis=0) % 2, -1.0, 1.0)[..., None]
        values = np.concatenate([values[:1], values[1:] * signs])
        step = 2.0 / MOST
        integers = np.round((np.clip(values, -1.0, 1.0) + 1.0) / step).astype(np.uint16)
        self._add_integers(integers, np.full(4, -1.0), np.full(4, step))

    def text(self) -> str:
        """Returns the compressed bytes as base64."""
        return base64.b64encode(zlib.compress(b"".join(self._parts), 9)).decode("ascii")

    def content(self) -> dict[str, Any]:
        """Returns the pack as content of a data block."""
        return {"arrays": self._array_headers, "data": self.text()}

    def _add_integers(self, values: NDArray[np.uint16], low: Array, step: Array) -> None:
        rows = values.reshape(len(values), -1)
        differences = np.diff(rows, axis=0, prepend=np.zeros((1, rows.shape[1]), np.uint16)).astype(np.uint16)
        planar = np.ascontiguousarray(differences.T)
        data = (planar & 0xFF).astype(np.uint8).tobytes() + (planar >> 8).astype(np.uint8).tobytes()
        self._add("short", values.shape, data, low=low.tolist(), step=step.tolist())

    def _add(self, kind: str, shape: tuple[int, ...], data: bytes, **more: Any) -> None:
        same = self._numbers.setdefault((kind, shape, data, str(more)), len(self._array_headers))
        if same < len(self._array_headers):
            # For example, figures of one body share their poses.
            self._array_headers.append({"type": "same", "of": same})
            return
        self._array_headers.append({"type": kind, "shape": list(shape), **more})
        self._parts.append(data)


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
