"""Camera of a picture: axes, and the smallest distance at which given spheres are in view."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpcontact.drawing.drawing import Drawing
from warpcontact.kernels.rendering.world import SPHERE
from warpcontact.validation.checks import Array
from warpcontact.visualize.rendering.items import Items, is_static

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


def moving(drawing: Drawing) -> list[bool]:
    """Returns whether each figure moves, or differs between environments."""
    return [not is_static(figure) for figure in drawing.figures]
