"""Device data of a drawing: its meshes, uploaded once, and the placed items of each view."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from warpcontact.algebra.poses import transform_points
from warpcontact.drawing.colors import linear
from warpcontact.drawing.drawing import Drawing, Shape
from warpcontact.drawing.triangles import ball
from warpcontact.kernels.rendering.world import World
from warpcontact.validation.checks import Array
from warpcontact.visualize.rendering.items import Items, bounds

# Relative margin of bounding boxes, so that rays hit flat items despite rounding.
_BOX_MARGIN = 1.0e-4
# Items smaller than this, in units of the view, are dropped because they are invisible.
_SMALLEST = 1.0e-7


class Stage:
    """Meshes of a drawing on a device.

    Args:
        drawing: Drawing with the shapes.
        device: Warp device.

    Raises:
        ValueError: If the mesh of a figure is invalid.
    """

    def __init__(self, drawing: Drawing, device: wp.Device) -> None:
        self.device = device
        self._numbers: dict[int, int] = {}
        self._shapes: list[Shape] = []
        self._meshes: list[wp.Mesh] = []
        # Center and half the longest side of each mesh [m]; on the device, meshes are normalized with these.
        self._frames: list[tuple[Array, float]] = []
        normals: list[Array] = []
        colors: list[Array] = []
        first_normal: list[int] = []
        first_color: list[int] = []
        for figure in drawing.figures:
            shape = figure.shape
            if shape is ball() or id(shape) in self._numbers:
                continue
            _check(figure.name, shape)
            self._numbers[id(shape)] = len(self._shapes)
            self._shapes.append(shape)
            self._add_mesh(shape)
            first_normal.append(-1 if shape.normals is None else sum(map(len, normals)))
            first_color.append(-1 if shape.colors is None else sum(map(len, colors)))
            if shape.normals is not None:
                normals.append(shape.normals[shape.faces].reshape(-1, 3))
            if shape.colors is not None:
                colors.append(linear(shape.colors))
        self._parts = {
            "mesh": self._upload([mesh.id for mesh in self._meshes], wp.uint64),
            "first_normal": self._upload(first_normal, wp.int32),
            "first_color": self._upload(first_color, wp.int32),
            "normals": self._upload(np.concatenate([np.zeros((0, 3)), *normals]), wp.vec3),
            "colors": self._upload(np.concatenate([np.zeros((0, 3)), *colors]), wp.vec3),
        }

    def world(self, items: Sequence[Items], origin: Array, unit: float) -> "PlacedWorld":
        """Returns items placed relative to ``origin`` [m], with lengths divided by ``unit`` [m]."""
        parts = [self._place(group, origin, unit) for group in items if len(group.positions)]
        columns = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]} if parts else {}
        keep = columns["scale"].min(axis=1) > _SMALLEST if parts else np.zeros(0, dtype=bool)
        return PlacedWorld({key: values[keep] for key, values in columns.items()}, self._parts, self.device)

    def _place(self, items: Items, origin: Array, unit: float) -> dict[str, Array]:
        positions, scales, count = items.positions, items.scales, len(items.positions)
        number = -1
        if items.shape is not None:
            number = self._numbers[id(items.shape)]
            middle, half = self._frames[number]
            positions = transform_points((scales * middle)[:, None], positions, items.rotations)[:, 0]
            scales = scales * half
        centers, halves = items.boxes()
        margin = _BOX_MARGIN * halves.max(axis=1, keepdims=True) + 1.0e-5 * unit
        return {
            "kind": np.full(count, items.kind),
            "shape": np.full(count, number),
            "position": (positions - origin) / unit,
            "rotation": items.rotations,
            "scale": scales / unit,
            "color": linear(items.colors),
            "has_grid": np.full(count, items.has_grid),
            "infinite": np.full(count, items.infinite),
            "lower": (centers - halves - margin - origin) / unit,
            "upper": (centers + halves + margin - origin) / unit,
        }

    def _add_mesh(self, shape: Shape) -> None:
        middle, halves = bounds(shape)
        half = float(halves.max())
        points = self._upload((shape.vertices - middle) / half, wp.vec3)
        indices = self._upload(shape.faces.reshape(-1), wp.int32)
        self._meshes.append(wp.Mesh(points, indices, bvh_constructor="sah"))
        self._frames.append((middle, half))

    def _upload(self, values: Any, dtype: Any) -> wp.array:
        return wp.array(values, dtype=dtype, device=self.device)


class PlacedWorld:
    """Placed items on a device; keeps their arrays alive.

    Attributes:
        struct: Argument of the rendering kernels.
    """

    def __init__(self, columns: dict[str, Array], parts: dict[str, wp.array], device: wp.Device) -> None:
        self.struct = World()
        for name, values in parts.items():
            setattr(self.struct, name, values)
        self.struct.count = len(columns.get("kind", ()))
        if not self.struct.count:  # Warp crashes on an empty BVH
            return
        types = {
            "kind": wp.int32,
            "shape": wp.int32,
            "position": wp.vec3,
            "rotation": wp.quat,
            "scale": wp.vec3,
            "color": wp.vec3,
            "has_grid": wp.uint8,
            "infinite": wp.uint8,
        }
        for name, dtype in types.items():
            setattr(self.struct, name, wp.array(columns[name], dtype=dtype, device=device))
        lower, upper = (wp.array(columns[name], dtype=wp.vec3, device=device) for name in ("lower", "upper"))
        self._tree = wp.Bvh(lower, upper)
        self.struct.bvh = self._tree.id


def _check(name: str, shape: Shape) -> None:
    """Raises ``ValueError`` if a mesh is invalid; Warp would crash or silently skip faces."""
    vertices, faces = shape.vertices, shape.faces
    if not len(faces):
        raise ValueError(f"{name}: the mesh must have faces")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(
            f"{name}: vertex indices must be from 0 to {len(vertices) - 1}, got {faces.min()} to {faces.max()}"
        )
    if not np.isfinite(vertices).all() or not np.ptp(vertices, axis=0).max() > 0.0:
        raise ValueError(f"{name}: vertices must be finite, and not all coincide")
    for key, values, count in (("normals", shape.normals, len(vertices)), ("colors", shape.colors, len(faces))):
        if values is not None and values.shape != (count, 3):
            raise ValueError(f"{name}: {key} must have shape {(count, 3)}, got {values.shape}")
