"""Camera of a picture: axes, view of given spheres, visibility of bodies, and choice of the camera."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.algebra.vectors import transform_points
from warpcontact.drawing.drawing import Drawing, Figure, ball
from warpcontact.kernels.rendering.world import SPHERE, visibility
from warpcontact.system.launches import launch_kernel
from warpcontact.validation.checks import Array
from warpcontact.visualize.rendering.stage import Items, Stage, bounds, is_static, place_figure, turned_axes

# Fraction of the picture left free around the moving bodies.
MARGIN = 0.12
# Smallest height of the view, as a multiple of the size of the drawing.
LEAST = 1.4
# Static items are framed if they are at most this many times as long as the moving bodies.
STATIC_SURROUNDINGS = 1.0
# Bodies lower, or farther away in other directions, are not framed; as multiples of the extent of static items.
BELOW, AWAY = 0.25, 2.0
# An infinite plane is framed below at least this fraction of the moving bodies.
NEARLY = 0.95
# Distances from the target at which infinite planes begin to fade into the background and have faded completely, in
# half heights of the view, or, if larger, in distances of the target from the plane.
_FADE = (3.0, 12.0)

# A body counts as visible if it is seen in at least this fraction of its records. A camera that sees at least this
# fraction of the bodies is accepted.
MIN_RECORD_FRACTION, MIN_BODY_FRACTION = 0.75, 0.95
# Largest number of bodies per panel, and of panels, that are tested.
BODIES, PANELS = 400, 16
# Occlusion within this distance of a body's center is ignored, in half heights of the view: points lie on surfaces.
_MIN_RADIUS = 0.01


@dataclass(frozen=True, eq=False)
class Camera:
    """Perspective camera with a horizontal right axis.

    Attributes:
        target: Look-at point, at the center of the picture, world [m].
        backward: Unit vector from the target to the camera.
        distance: Distance from target to camera [m].
        angle: Vertical angle of view [rad].
    """

    target: Array
    backward: Array
    distance: float
    angle: float

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """Unit vectors to the right, up in the picture, and forward."""
        return *_across(self.backward), -self.backward

    @property
    def reach(self) -> float:
        """Half the height of the view at the target [m]."""
        return self.distance * math.tan(0.5 * self.angle)


def direction(azimuth: float, elevation: float) -> Array:
    """Returns the unit vector to a camera from azimuth about z, from x, and elevation above the horizontal [rad]."""
    flat = math.cos(elevation)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])


def _across(backward: Array) -> tuple[Array, Array]:
    """Returns unit vectors to the right and up in the picture."""
    flat = math.hypot(backward[0], backward[1])
    # Seen from straight above, the rounding error that remains of the azimuth defines the axes.
    right = np.array([-backward[1], backward[0], 0.0]) / flat if flat > 0.0 else np.array([1.0, 0.0, 0.0])
    return right, np.cross(backward, right)


def frame_spheres(
    points: Array,
    radii: Array,
    backward: Array,
    angle: float,
    aspect: float,
    *,
    target: Array | None = None,
    distance: float | None = None,
    least: float = 0.0,
) -> Camera:
    """Returns the nearest camera that sees all of the given spheres, with a margin.

    Args:
        points: Centers, (n, 3) [m].
        radii: Radii, (n,) [m].
        backward: Unit vector to the camera.
        angle: Vertical angle of view [rad].
        aspect: Width of the picture divided by its height.
        target: Look-at point [m]; ``None``: the point that minimizes the distance.
        distance: Distance of the camera [m]; ``None``: the smallest possible.
        least: Smallest height of the view at the target [m].
    """
    right, up = _across(backward)
    tangent = math.tan(0.5 * angle)
    needed, shift = [], []
    middle = points.mean(axis=0) if target is None else target
    x, y, z = ((points - middle) @ axis for axis in (right, up, backward))
    for places, widest in ((x, aspect * tangent), (y, tangent)):
        slope = (1.0 - MARGIN) * widest
        # The planes that bound the view touch the outermost spheres: d ≥ high − c / slope and d ≥ low + c / slope,
        # with the shift c of the target.
        aside = radii * math.sqrt(1.0 + 1.0 / slope**2)
        high = float((z + places / slope + aside).max())
        low = float((z - places / slope + aside).max())
        shift.append(0.5 * (high - low) * slope if target is None else 0.0)
        needed.append(0.5 * (high + low) if target is None else max(high, low))
    if distance is None:
        distance = max(*needed, 0.5 * least / tangent, float((z + radii).max()) * 1.05)
    return Camera(middle + shift[0] * right + shift[1] * up, backward, distance, angle)


def bounding_spheres(drawing: Drawing, items: Sequence[tuple[Items, bool]]) -> tuple[Array, Array]:
    """Returns spheres around the content to frame: centers (n, 3) and radii (n,) [m].

    Included are moving bodies, except those far away, and static items, except those much larger, such as the ground.

    Args:
        drawing: Drawing of the items.
        items: Placed items, and whether each of them moves.
    """
    centers, radii, _ = _all_balls([group for group, moves in items if moves])
    static_items = [group for group, moves in items if not moves]
    if len(centers):
        # Quantile and median, because a few bodies may have been ejected far away.
        middle = np.median(centers, axis=0)
        reach = float(np.quantile(np.linalg.norm((centers - middle)[:, :2], axis=1), NEARLY))
        static_items = [group.extend(middle, reach) for group in static_items]
    static, sizes, spans = _all_balls(static_items)
    if not len(centers):
        centers, radii, static, sizes, spans = static, sizes, static[:0], sizes[:0], spans[:0]
    if not len(centers):
        return np.zeros((1, 3)), np.array([drawing.size])
    if len(static):
        low, high = (static - sizes[:, None]).min(axis=0), (static + sizes[:, None]).max(axis=0)
        size = np.linalg.norm(high - low)
        low = low - np.array([AWAY, AWAY, BELOW]) * size
        near = ((centers > low) & (centers < high + AWAY * size)).all(axis=1)
        if near.any():
            centers, radii = centers[near], radii[near]
    span = np.ptp(np.concatenate([centers - radii[:, None], centers + radii[:, None]]), axis=0)
    nearby = spans <= STATIC_SURROUNDINGS * float(np.linalg.norm(span))
    return np.concatenate([centers, static[nearby]]), np.concatenate([radii, sizes[nearby]])


def _all_balls(items: Sequence[Items]) -> tuple[Array, Array, Array]:
    """Returns the bounding spheres of several groups of items, concatenated; see ``_balls``."""
    empty = (np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    centers, radii, spans = zip(empty, *map(_balls, items), strict=True)
    return np.concatenate(centers), np.concatenate(radii), np.concatenate(spans)


def _balls(items: Items) -> tuple[Array, Array, Array]:
    """Returns centers and radii of spheres, or vertices of boxes with radius 0, and the length of each item."""
    centers, halves = items.boxes()
    if items.kind == SPHERE:
        radii = halves.max(axis=1)
        return centers, radii, 2.0 * radii
    corners = np.array([[i, j, k] for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
    points = (centers[:, None] + corners * halves[:, None]).reshape(-1, 3)
    # An infinite plane has infinite length.
    spans = np.full(len(halves), np.inf) if items.infinite else 2.0 * np.linalg.norm(halves, axis=1)
    return points, np.zeros(len(points)), np.repeat(spans, 8)


def extend_planes(items: Sequence[Items], camera: Camera) -> tuple[list[Items], tuple[float, float]]:
    """Returns items with infinite planes extended as far as they are visible, and the fade distances.

    Planes begin to fade at the first distance from the target and have faded at the second, in half view heights.
    """
    unit = camera.reach
    scale = max([1.0, *(_farthest(group, camera.target) / unit for group in items if group.infinite)])
    begin, end = (scale * distance for distance in _FADE)
    return [group.extend(camera.target, end * unit) for group in items], (begin, end)


def _farthest(planes: Items, point: Array) -> float:
    """Returns the largest distance of a point from planes z = 0 in their own frames [m]."""
    normals = turned_axes(planes.rotations)[:, 2]
    return float(np.abs(((point - planes.positions) * normals).sum(axis=1)).max(initial=0.0))


def moving(drawing: Drawing) -> list[bool]:
    """Returns whether each figure moves, or differs between environments."""
    return [not is_static(figure) for figure in drawing.figures]


@dataclass(frozen=True, eq=False)
class Targets:
    """Bodies of one panel, and its static items.

    Attributes:
        centres: Body centers, (record, body, 3), world [m]; NaN if a body is not present.
        radii: Radii of inscribed balls, (record, body) [m].
        static: Static items.
    """

    centres: Array
    radii: Array
    static: list[Items]


class Visibility:
    """Test of the visibility of bodies.

    Args:
        stage: Stage with the meshes of static items.
        panels: Bodies and static items of each panel.
        camera: Approximate camera; it defines origin and unit of length on the device.
    """

    def __init__(self, stage: Stage, panels: Sequence[Targets], camera: Camera) -> None:
        self._origin, self._unit, self._device = camera.target, camera.reach, stage.device
        self._panels = [
            (panel, stage.world(extend_planes(panel.static, camera)[0], self._origin, self._unit))
            for panel in panels
        ]

    def visible_fraction(self, camera: Camera, aspect: float) -> float:
        """Returns the fraction of bodies that are visible in most of the records in which they are in the picture.

        1 if there are none. ``aspect`` is the width of the picture divided by its height.
        """
        eye = camera.target + camera.distance * camera.backward
        right, up, forward = camera.axes
        slope = np.tan(0.5 * camera.angle)
        found = []
        for panel, world in self._panels:
            offset = panel.centres - eye
            depth = slope * (offset @ forward)
            # Comparisons with NaN, for bodies that are not present, are false.
            inside = (np.abs(offset @ right) <= aspect * depth) & (np.abs(offset @ up) <= depth)
            radii = np.maximum(panel.radii / self._unit, _MIN_RADIUS)[inside]
            points = (panel.centres[inside] - self._origin) / self._unit
            is_visible = wp.zeros(len(points), dtype=wp.uint8, device=self._device)
            if len(points):
                launch_kernel(
                    visibility(),
                    len(points),
                    device=self._device,
                    world=world.struct,
                    eye=wp.vec3(*((eye - self._origin) / self._unit).tolist()),
                    points=wp.array(points, dtype=wp.vec3, device=self._device),
                    radii=wp.array(radii, dtype=wp.float32, device=self._device),
                    visible=is_visible,
                )
            visible = np.zeros(inside.shape)
            visible[inside] = is_visible.numpy()
            in_picture = inside.sum(axis=0)
            found.append((visible.sum(axis=0) >= MIN_RECORD_FRACTION * in_picture)[in_picture > 0])
        bodies = np.concatenate(found) if found else np.zeros(0, dtype=bool)
        return float(bodies.mean()) if len(bodies) else 1.0


def best_camera(visibility: Visibility, cameras: Sequence[Camera], aspect: float) -> Camera:
    """Returns the first camera that sees nearly all bodies, or else the first that sees most of them."""
    best, most = cameras[0], -1.0
    for camera in cameras:
        part = visibility.visible_fraction(camera, aspect)
        if part > most:
            best, most = camera, part
        if part >= MIN_BODY_FRACTION:
            break
    return best


def find_targets(drawing: Drawing, panels: Sequence[Sequence[int]], records: Sequence[int]) -> list[Targets]:
    """Returns bodies and static items of some panels; empty if nothing can be hidden.

    Args:
        drawing: The drawing.
        panels: Environment rows of each panel.
        records: Indices of the records that are tested.
    """
    static = [figure for figure in drawing.figures if len(figure.positions) == len(figure.orientations) == 1]
    moving = [figure for figure in drawing.figures if figure not in static]
    if not static or not moving:
        return []
    found = []
    for number in _evenly(len(panels), PANELS):
        rows = panels[number]
        parts = [_bodies(figure, row, records) for figure in moving for row in rows]
        centers, radii = (np.concatenate(column, axis=1) for column in zip(*parts, strict=True))
        chosen = _evenly(centers.shape[1], BODIES)
        static_items = [place_figure(figure, 0, row) for figure in static for row in rows]
        found.append(Targets(centers[:, chosen], radii[:, chosen], static_items))
    return found


def _bodies(figure: Figure, row: int, records: Sequence[int]) -> tuple[Array, Array]:
    """Returns centers (record, item, 3) and radii (record, item) [m] of copies of a figure, NaN if not present."""
    positions, rotations = (
        values[list(records), row] if len(values) > 1 else np.repeat(values[:, row], len(records), axis=0)
        for values in (figure.positions, figure.orientations)
    )
    scales = np.broadcast_to(figure.scales[row], positions.shape)
    middle, half = (np.zeros(3), np.ones(3)) if figure.shape is ball() else bounds(figure.shape)
    good = np.isfinite(positions).all(axis=-1) & np.isfinite(rotations).all(axis=-1) & figure.present[row]
    centers = np.full(positions.shape, np.nan)
    centers[good] = transform_points((scales[good] * middle)[:, None], positions[good], rotations[good])[:, 0]
    return centers, (scales * half).min(axis=-1)


def _evenly(count: int, most: int) -> NDArray[np.int_]:
    """Returns at most ``most`` of the numbers 0 … ``count`` − 1, evenly spaced."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))
