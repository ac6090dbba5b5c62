"""Where a picture is taken from: the eye, and the least distance from which all that moves is in it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from warpcontact.drawing.drawing import Drawing
from warpcontact.kernels.rendering.world import SPHERE
from warpcontact.validation.checks import Array
from warpcontact.visualize.rendering.items import Items, is_static

# Part of the picture that is left free around what moves.
MARGIN = 0.12
# A picture shows at least so many sizes of the largest body.
LEAST = 1.4
# What never moves is in the picture as a whole if it is no longer than this many times what moves.
STATIC_SURROUNDINGS = 1.0
# What is lower, or farther off in other directions, in sizes of all that stands still, is not looked for.
BELOW, AWAY = 0.25, 2.0
# Part of what moves that a plane without end is at least below.
NEARLY = 0.95


@dataclass(frozen=True, eq=False)
class Camera:
    """An eye, above which is up.

    Attributes:
        target: What it looks at, in the middle of the picture, world [m].
        backward: Unit vector from there to the eye.
        distance: How far that is [m].
        angle: Angle of view from top to bottom [rad].
    """

    target: Array
    backward: Array
    distance: float
    angle: float

    @property
    def axes(self) -> tuple[Array, Array, Array]:
        """Unit vectors to the right, upwards in the picture, and forward."""
        return *_across(self.backward), -self.backward

    @property
    def reach(self) -> float:
        """Half of what is seen from top to bottom, at the target [m]."""
        return self.distance * math.tan(0.5 * self.angle)


def direction(azimuth: float, elevation: float) -> Array:
    """Returns the unit vector to an eye by angles [rad], from the x axis about z, and up from the horizontal."""
    flat = math.cos(elevation)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), math.sin(elevation)])


def _across(backward: Array) -> tuple[Array, Array]:
    """Returns unit vectors to the right and upwards in the picture."""
    flat = math.hypot(backward[0], backward[1])
    # From straight above what rounding leaves of the azimuth is enough.
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
    """Returns the nearest camera that sees all of some spheres, with a margin.

    Args:
        points: Their centres, (n, 3) [m].
        radii: Their radii, (n,) [m].
        backward: Unit vector to the eye.
        angle: Angle of view from top to bottom [rad].
        aspect: Width of the picture by its height.
        target: What it looks at [m]; ``None``: where least distance is needed.
        distance: How far away it is [m]; ``None``: as far as needed.
        least: What it sees from top to bottom at least, at the target [m].
    """
    right, up = _across(backward)
    tangent = math.tan(0.5 * angle)
    needed, shift = [], []
    middle = points.mean(axis=0) if target is None else target
    x, y, z = ((points - middle) @ axis for axis in (right, up, backward))
    for places, widest in ((x, aspect * tangent), (y, tangent)):
        slope = (1.0 - MARGIN) * widest
        # The planes that bound the view on both sides touch the outermost spheres: d ≥ high − c / slope and
        # d ≥ low + c / slope, with the shift c of the target.
        aside = radii * math.sqrt(1.0 + 1.0 / slope**2)
        high = float((z + places / slope + aside).max())
        low = float((z - places / slope + aside).max())
        shift.append(0.5 * (high - low) * slope if target is None else 0.0)
        needed.append(0.5 * (high + low) if target is None else max(high, low))
    if distance is None:
        distance = max(*needed, 0.5 * least / tangent, float((z + radii).max()) * 1.05)
    return Camera(middle + shift[0] * right + shift[1] * up, backward, distance, angle)


def bounding_spheres(drawing: Drawing, items: Sequence[tuple[Items, bool]]) -> tuple[Array, Array]:
    """Returns spheres around what a picture is about: centres (n, 3) and radii (n,) [m].

    That is what moves, unless it is long gone, and what stands beside it, unless it is larger, as the ground is.

    Args:
        drawing: What it is of.
        items: Shapes that were placed, and whether each moves.
    """
    centres, radii, _ = _all_balls([group for group, moves in items if moves])
    standing = [group for group, moves in items if not moves]
    if len(centres):
        # A plane without end is below nearly all that moves; a few bodies may have been thrown out of the world.
        middle = np.median(centres, axis=0)
        reach = float(np.quantile(np.linalg.norm((centres - middle)[:, :2], axis=1), NEARLY))
        standing = [group.extend(middle, reach) for group in standing]
    static, sizes, spans = _all_balls(standing)
    if not len(centres):
        centres, radii, static, sizes, spans = static, sizes, static[:0], sizes[:0], spans[:0]
    if not len(centres):
        return np.zeros((1, 3)), np.array([drawing.size])
    if len(static):
        low, high = (static - sizes[:, None]).min(axis=0), (static + sizes[:, None]).max(axis=0)
        size = np.linalg.norm(high - low)
        low = low - np.array([AWAY, AWAY, BELOW]) * size
        near = ((centres > low) & (centres < high + AWAY * size)).all(axis=1)
        if near.any():
            centres, radii = centres[near], radii[near]
    span = np.ptp(np.concatenate([centres - radii[:, None], centres + radii[:, None]]), axis=0)
    nearby = spans <= STATIC_SURROUNDINGS * float(np.linalg.norm(span))
    return np.concatenate([centres, static[nearby]]), np.concatenate([radii, sizes[nearby]])


def _all_balls(items: Sequence[Items]) -> tuple[Array, Array, Array]:
    """Returns what encloses items, one after the other, see ``_balls``."""
    empty = (np.zeros((0, 3)), np.zeros(0), np.zeros(0))
    centres, radii, spans = zip(empty, *map(_balls, items), strict=True)
    return np.concatenate(centres), np.concatenate(radii), np.concatenate(spans)


def _balls(items: Items) -> tuple[Array, Array, Array]:
    """Returns what encloses items: centres and radii of balls, or corners of boxes; and the length of all."""
    centres, halves = items.boxes()
    if items.kind == SPHERE:
        radii = halves.max(axis=1)
        return centres, radii, 2.0 * radii
    corners = np.array([[i, j, k] for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
    points = (centres[:, None] + corners * halves[:, None]).reshape(-1, 3)
    # A plane without end is longer than anything.
    spans = np.full(len(halves), np.inf) if items.infinite else 2.0 * np.linalg.norm(halves, axis=1)
    return points, np.zeros(len(points)), np.repeat(spans, 8)


def moving(drawing: Drawing) -> list[bool]:
    """Returns whether each figure moves, or differs between environments."""
    return [not is_static(figure) for figure in drawing.figures]
