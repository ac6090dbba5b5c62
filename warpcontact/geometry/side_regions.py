"""Where a point keeps the side of a surface that it is on, as long as it does not come through the surface.

The side of a point is that of the nearest face. Of surfaces in general it can change without a touch, where two
faces are equally near and show different sides; of those told here it cannot.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from warpcontact.algebra.vectors import bounds, norm
from warpcontact.kernels.types import SIDE_KNOWN_EVERYWHERE, SIDE_KNOWN_INSIDE_WALLS, SIDE_KNOWN_NOWHERE
from warpcontact.meshes import Mesh
from warpcontact.meshes.overlap import MOST_FACES
from warpcontact.meshes.topology import area_vectors, components
from warpcontact.validation.checks import Array

# Of areas: far above their rounding, far below a face.
_TOLERANCE = 1.0e-9
# Of the size of a rim: far above the rounding of its places, far below what a wall in more parts would tell.
_STRAIGHT = 1.0e-13


@dataclass(frozen=True)
class SideRegion:
    """Where a surface keeps its sides apart.

    Attributes:
        kind: One of SIDES_*.
        normal: Unit normals of the walls of the region, into it, (n, 3), axes of the mesh.
        offset: Where they are along their normals, (n,), unit of the mesh, from the origin of the corners.
        outer_normal: Unit normals of planes with the whole surface behind them, (m, 3): within the walls all that is
            before one of them is on the outer side.
        outer_offset: Where these are along their normals, (m,).
    """

    kind: int = SIDE_KNOWN_NOWHERE
    normal: Array = field(default_factory=lambda: np.zeros((0, 3)))
    offset: Array = field(default_factory=lambda: np.zeros(0))
    outer_normal: Array = field(default_factory=lambda: np.zeros((0, 3)))
    outer_offset: Array = field(default_factory=lambda: np.zeros(0))

    def clearance(self, places: Array) -> Array:
        """Returns how far about places all is on the outer side, at least; negative if that is not known.

        Args:
            places: In axes and unit of the mesh, from the origin of the corners, (…, 3).
        """
        before = (places @ self.outer_normal.T - self.outer_offset).max(axis=-1, initial=-np.inf)
        within = (places @ self.normal.T - self.offset).min(axis=-1, initial=np.inf)
        return np.minimum(before, within)


def bounds_region(mesh: Mesh) -> bool:
    """Returns whether a mesh parts space into two regions, of which one sees its outer sides only, the other none.

    That is so of closed surfaces that do not cut themselves, each part of which faces the other way than the part
    that it lies in. Large ones that were not examined for cuts may be, and are not told.
    """
    report = mesh.report
    parts = report.components
    if not report.closed or report.component_count > len(parts) or not all(part.closed for part in parts):
        return False
    if report.non_manifold_edge_count or any(part.volume == 0.0 for part in parts):
        return False
    outward = [(part.volume or 0.0) > 0.0 for part in parts]
    outermost = {side for part, side in zip(parts, outward, strict=True) if part.inside is None}
    if len(outermost) > 1:
        return False
    if any(
        part.inside is not None and outward[part.inside] == side for part, side in zip(parts, outward, strict=True)
    ):
        return False
    cuts = report.self_intersection_count
    if cuts is None:
        cuts = len(mesh.self_intersections()) if report.face_count <= MOST_FACES else 1
    return cuts == 0


def height_field_region(corner: Array, ends: NDArray[np.integer], neighbor: NDArray[np.int32]) -> SideRegion:
    """Returns where an open surface keeps its sides apart: above it, if it has one height over each place.

    Seen along some direction it has to cover a convex region once, as terrains, plates and bowls do. From a point
    within the walls over the rim, and above it, the way to the nearest face does not leave these walls, nor cross
    the surface, and so arrives on the outer side.

    Args:
        corner: Corners of each face, (F, 3, 3).
        ends: Numbers of the vertices at the ends of each edge, in the order of the face, (F, 3, 2).
        neighbor: What lies across each edge, as in ``Patch``, (F, 3).
    """
    areas = area_vectors(corner)
    up = areas.sum(axis=0)
    if not np.linalg.norm(up) > 0.0:
        return SideRegion()
    up /= np.linalg.norm(up)
    steep = areas @ up <= _TOLERANCE * norm(areas)
    inner = np.argwhere(neighbor >= 0)
    links = np.column_stack([inner[:, 0], neighbor[neighbor >= 0] // 3])
    if steep.any() or components(links, len(corner))[0] != 1:
        return SideRegion()

    # Its rim, corner by corner: one loop.
    rim = np.argwhere(neighbor < 0)
    start, end = ends[rim[:, 0], rim[:, 1]].T
    if not len(start) or np.bincount(start).max() > 1:
        return SideRegion()
    following = dict(zip(start.tolist(), end.tolist(), strict=True))
    place = dict(zip(start.tolist(), corner[rim[:, 0], rim[:, 1]], strict=True))
    loop = [int(start[0])]
    while (after := following.get(loop[-1])) is not None and after != loop[0] and len(loop) < len(start):
        loop.append(after)
    if len(loop) < len(start):
        return SideRegion()

    across = np.linalg.svd(up[None])[2][1:]
    if np.linalg.det(np.vstack([across, up])) < 0.0:
        across = across[::-1]
    flat = np.array([place[vertex] for vertex in loop]) @ across.T
    within = _area(flat)
    size = float(np.ptp(flat, axis=0).max())
    hull = _hull(flat, _STRAIGHT * size)
    if len(hull) < 3:
        return SideRegion()
    after = np.roll(hull, -1, axis=0) - hull
    inward = np.column_stack([-after[:, 1], after[:, 0]]) / np.linalg.norm(after, axis=1, keepdims=True)
    offset = (inward * hull).sum(axis=1)
    # Whichever way round: the distance of the rim from the walls over the hull of it.
    beside = (inward @ flat.T - offset[:, None]).min(axis=0)
    covered = 0.5 * float((areas @ up).sum())
    equal = np.allclose([within, covered], _area(hull), rtol=_TOLERANCE, atol=0.0)
    if not equal or (beside > _TOLERANCE * size).any():
        return SideRegion()
    return SideRegion(
        SIDE_KNOWN_INSIDE_WALLS, inward @ across, offset, up[None], (corner @ up).max(keepdims=True)[0]
    )


def _area(loop: Array) -> float:
    """Returns the area that a loop of corners (n, 2) goes round counterclockwise."""
    x, y = (loop - loop[0]).T
    return 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def _hull(points: Array, straight: float) -> Array:
    """Returns the corners (m, 2) of the convex hull of points (n, 2), counterclockwise.

    Args:
        points: The points.
        straight: A corner that is no farther than that from the line between those beside it is none.
    """
    ordered = points[np.lexsort(points.T[::-1])].tolist()
    around = [place for half in (ordered, ordered[::-1]) for place in _left_turns(half, 0.0)[:-1]]
    # What is straight goes only now: of points in a line but for rounding, their order says nothing. The way
    # begins at a corner for sure.
    first = int(np.argmax(np.linalg.norm(np.array(around) - points.mean(axis=0), axis=1)))
    return np.array(_left_turns([*around[first:], *around[: first + 1]], straight)[:-1])


def _left_turns(places: list[list[float]], straight: float) -> list[list[float]]:
    """Returns those of ``places`` where the way along them turns left, by more than ``straight``, and its ends."""
    way: list[list[float]] = []
    for x, y in places:
        while len(way) > 1:
            (ax, ay), (bx, by) = way[-2:]
            turn = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
            if turn > straight * math.hypot(x - ax, y - ay):
                break
            way.pop()
        way.append([x, y])
    return way


def side_region_of(
    mesh: Mesh, corner: Array, ends: NDArray[np.integer], neighbor: NDArray[np.int32], *, whole: bool
) -> SideRegion:
    """Returns where a mesh, or with ``whole`` false a part of it that has these faces, keeps its sides apart."""
    if whole and bounds_region(mesh):
        if mesh.report.orientation != "outward":
            return SideRegion(SIDE_KNOWN_EVERYWHERE)
        low, high = bounds(corner)
        return SideRegion(
            SIDE_KNOWN_EVERYWHERE,
            outer_normal=np.vstack([np.eye(3), -np.eye(3)]),
            outer_offset=np.append(high, -low),
        )
    return height_field_region(corner, ends, neighbor)
