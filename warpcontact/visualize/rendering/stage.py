"""Content of a view: placed shapes, lines and arrows, and their data on the device."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.algebra.vectors import shortest_rotations, transform_points
from warpcontact.drawing.colors import Scale, linear
from warpcontact.drawing.contact_pressure import PressurePatches
from warpcontact.drawing.drawing import ContactForces, Curve, Drawing, Figure, Shape, ball
from warpcontact.kernels.rendering.world import CONE, CYLINDER, MESH, SPHERE, World
from warpcontact.validation.checks import Array

# Head of an arrow: largest fraction of the arrow length, and width in shaft widths.
HEAD_LENGTH = 0.45
HEAD_WIDTHS = 2.4
# Length of the head divided by its width.
HEAD_SLENDER = 1.5
# Bounding boxes of the unit primitives in their own frames: center and half lengths.
_BOXES = {
    SPHERE: ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)),
    CYLINDER: ((0.0, 0.0, 0.5), (1.0, 1.0, 0.5)),
    CONE: ((0.0, 0.0, 0.5), (1.0, 1.0, 0.5)),
}

# Largest difference of pressures on a face, relative to the largest one of the color scale: faces have one color.
FACE_STEP = 1.0 / 48.0

# Relative margin of bounding boxes, so that rays hit flat items despite rounding.
_BOX_MARGIN = 1.0e-4
# Items smaller than this, in units of the view, are dropped because they are invisible.
_SMALLEST = 1.0e-7


@dataclass(frozen=True, eq=False)
class Items:
    """Placed shapes of one kind, with world position = position + rotation · (scale ∘ p) [m].

    Attributes:
        kind: MESH, SPHERE, CYLINDER or CONE.
        shape: Mesh, if ``kind`` is MESH.
        positions: Origins, (n, 3) [m].
        rotations: Quaternions, (n, 4), x, y, z, w.
        scales: Factors along the axes, (n, 3), positive.
        colors: sRGB colors, (n, 3) in 0…1.
        has_grid: Whether to draw a grid on level faces.
        infinite: Whether they represent infinite planes, z = 0, which fade into the background far away.
        unlit: Whether their color does not depend on light; for marks.
    """

    kind: int
    shape: Shape | None
    positions: Array
    rotations: Array
    scales: Array
    colors: Array
    has_grid: bool = False
    infinite: bool = False
    unlit: bool = False

    def boxes(self) -> tuple[Array, Array]:
        """Returns centers and half lengths of axis-aligned bounding boxes, world, (n, 3) [m]."""
        if self.shape is None:
            middle, half = (np.array(values) for values in _BOXES[self.kind])
        else:
            middle, half = bounds(self.shape)
        centers = transform_points((self.scales * middle)[:, None], self.positions, self.rotations)[:, 0]
        axes = self.scales[:, :, None] * turned_axes(self.rotations)
        if self.kind == SPHERE:
            return centers, np.linalg.norm(axes, axis=1)
        return centers, np.abs(half[:, None] * axes).sum(axis=1)

    def extend(self, point: Array, reach: float) -> "Items":
        """Returns infinite planes as squares centered at the projection of a point [m].

        Half their side is at least ``reach`` [m]. Other items are returned unchanged.
        """
        if not self.infinite or self.shape is None:
            return self
        normals = turned_axes(self.rotations)[:, 2]
        above = ((point - self.positions) * normals).sum(axis=1, keepdims=True)
        half = float(bounds(self.shape)[1].max())
        return replace(self, positions=point - above * normals, scales=np.maximum(self.scales, reach / half))


@functools.lru_cache(maxsize=1024)
def bounds(shape: Shape) -> tuple[Array, Array]:
    """Returns center and half lengths of the bounding box of a mesh, in its own frame [m]."""
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    return 0.5 * (low + high), 0.5 * (high - low)


def turned_axes(rotations: Array) -> Array:
    """Returns the images of the three axes under rotations, (n, axis, 3)."""
    count = len(rotations)
    axes = np.broadcast_to(np.eye(3), (count, 3, 3))
    return transform_points(axes, np.zeros((count, 3)), rotations)


def place_figure(
    figure: Figure,
    record: int,
    row: int,
    *,
    color: Array | None = None,
    has_grid: bool = False,
    least: float = 0.0,
) -> Items:
    """Returns the copies of a figure in an environment that are present and finite.

    Args:
        figure: Figure to place.
        record: Index of the record in the drawing.
        row: Index of the environment in the drawing.
        color: RGB that replaces the color of the figure.
        has_grid: Whether to draw a grid on it.
        least: Smallest radius of points [m].
    """
    time = record if len(figure.positions) > 1 else 0
    positions, scales = figure.positions[time, row], figure.scales[row]
    rotations = figure.orientations[record if len(figure.orientations) > 1 else 0, row]
    if figure.kind == "point":
        scales = np.maximum(scales, least)
    kind, shape = (SPHERE, None) if figure.shape is ball() else (MESH, figure.shape)
    finite = np.isfinite(np.concatenate([positions, rotations, scales], axis=1)).all(axis=1)
    good = np.broadcast_to(figure.present[row], finite.shape) & finite & (scales > 0.0).all(axis=1)
    count = int(good.sum())
    colors = np.broadcast_to(figure.color if color is None else color, (count, 3))
    return Items(
        kind, shape, positions[good], rotations[good], scales[good], colors, has_grid, figure.kind == "plane"
    )


def patch_figure(patches: PressurePatches, scale: Scale) -> Figure | None:
    """Returns the area of a contact as a figure with the colors of its pressures; ``None`` if it has no extent."""
    refined = patches.refined(scale.high, FACE_STEP)
    vertices = refined.positions.reshape(-1, 3)
    if not len(vertices) or not np.ptp(vertices, axis=0).any():
        return None
    faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    shape = Shape(vertices, faces, scale.colors(refined.pressures.mean(axis=1)))
    origin, upright = np.zeros((1, 1, 1, 3)), np.array([0.0, 0.0, 0.0, 1.0]).reshape(1, 1, 1, 4)
    ones = np.ones((1, 1, 3))
    return Figure(patches.name, "patch", shape, np.zeros(3), origin, upright, ones, ones[..., 0] > 0.0)


def curve_tube(curve: Curve, record: int, row: int, width: float) -> list[Items]:
    """Returns a curve as a tube of diameter ``width`` [m]: cylinders and spheres; empty if it is not shown."""
    points = curve.points[record if len(curve.points) > 1 else 0, row]
    shown = curve.shown[record if len(curve.shown) > 1 else 0, row]
    if not shown or not np.isfinite(points).all():
        return []
    joints = np.full((len(points), 3), 0.5 * width)
    upright = np.broadcast_to((0.0, 0.0, 0.0, 1.0), (len(points), 4))
    spheres = Items(SPHERE, None, points, upright, joints, np.broadcast_to(curve.color, points.shape))
    lengths = np.diff(points, axis=0)
    return [spheres, _between(CYLINDER, points[:-1], lengths, 0.5 * width, curve.color)]


def force_arrows(contact: ContactForces, record: int, row: int, scale: float, width: float) -> list[Items]:
    """Returns the forces of a contact as arrows from the points where they act, ``scale`` [m/N] long.

    ``width`` is the shaft diameter [m]. Short arrows are scaled down as a whole.
    """
    starts, arrows = contact.points[record, row], scale * contact.forces[record, row]
    lengths = np.linalg.norm(arrows, axis=-1)
    good = np.isfinite(starts).all(axis=-1) & np.isfinite(lengths) & (lengths > 0.0)
    starts, arrows, lengths = starts[good], arrows[good], lengths[good, None]
    head_width = HEAD_WIDTHS * width
    heads = np.minimum(HEAD_SLENDER * head_width, np.maximum(HEAD_LENGTH * lengths, 1.0e-300))
    shafts = arrows * (1.0 - heads / np.maximum(lengths, 1.0e-300))
    # Heads of short arrows shrink in all directions.
    thin = heads[:, 0] / (HEAD_SLENDER * head_width)
    return [
        _between(CYLINDER, starts, shafts, 0.5 * width * thin, contact.color),
        _between(CONE, starts + shafts, arrows - shafts, 0.5 * head_width * thin, contact.color),
    ]


def _between(kind: int, starts: Array, lengths: Array, radius: Array | float, color: Array) -> Items:
    """Returns cylinders or cones along vectors ``lengths`` (n, 3) from ``starts`` (n, 3) [m]."""
    size = np.linalg.norm(lengths, axis=-1)
    radii = np.broadcast_to(radius, size.shape)
    good = (size > 0.0) & (radii > 0.0)
    starts, lengths, size, radii = starts[good], lengths[good], size[good], radii[good]
    rotations = shortest_rotations((0.0, 0.0, 1.0), lengths / size[:, None])
    scales = np.stack([radii, radii, size], axis=-1)
    return Items(kind, None, starts, rotations, scales, np.broadcast_to(color, starts.shape))


def is_static(figure: Figure) -> bool:
    """Returns whether a figure never moves and is the same in all environments."""
    arrays: Sequence[NDArray[np.float64]] = (figure.positions, figure.orientations)
    static = all(len(values) == 1 and bool((values == values[:, :1]).all()) for values in arrays)
    return static and bool((figure.scales == figure.scales[:1]).all()) and bool(figure.present.all())


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
            "unlit": np.full(count, items.unlit),
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
            "unlit": wp.uint8,
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
