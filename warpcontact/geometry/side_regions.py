"""Side regions: regions in which a point stays on the same side of a surface unless it passes through it.

The side of a point is that of the nearest face. In general it can change without contact, where two faces with
different sides are equally near. In a side region it cannot, so cached sides stay valid. Closed surfaces have such a
region everywhere, height fields within walls over their boundary.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from warpcontact.algebra.vectors import bounds, norm
from warpcontact.kernels.types import SIDE_KNOWN_EVERYWHERE, SIDE_KNOWN_INSIDE_WALLS, SIDE_KNOWN_NOWHERE
from warpcontact.meshes import Mesh
from warpcontact.meshes.examine import MOST_FACES
from warpcontact.meshes.topology import area_vectors, components
from warpcontact.validation.checks import Array

# Relative tolerance of areas: far above rounding, far below the area of a face.
_TOLERANCE = 1.0e-9
# Tolerance of collinearity relative to the size of the boundary: far above rounding, far below a real bend.
_STRAIGHT = 1.0e-13


@dataclass(frozen=True)
class SideRegion:
    """Region in which the side of a surface changes only by passing through the surface.

    Attributes:
        kind: One of ``SIDE_KNOWN_*``.
        normal: Unit normals of the walls of the region, pointing inwards, (n, 3), axes of the mesh.
        offset: Offsets of the walls along their normals, (n,), unit and origin of ``QueryMesh.corner``.
        outer_normal: Unit normals of planes with the whole surface behind them, (m, 3). Within the walls, points in
            front of any of these planes are on the outer side.
        outer_offset: Offsets of these planes along their normals, (m,).
    """

    kind: int = SIDE_KNOWN_NOWHERE
    normal: Array = field(default_factory=lambda: np.zeros((0, 3)))
    offset: Array = field(default_factory=lambda: np.zeros(0))
    outer_normal: Array = field(default_factory=lambda: np.zeros((0, 3)))
    outer_offset: Array = field(default_factory=lambda: np.zeros(0))

    def clearance(self, places: Array) -> Array:
        """Returns lower bounds of the radius around positions that is on the outer side; negative if unknown.

        Args:
            places: Positions (…, 3), axes, unit and origin of ``QueryMesh.corner``.
        """
        before = (places @ self.outer_normal.T - self.outer_offset).max(axis=-1, initial=-np.inf)
        within = (places @ self.normal.T - self.offset).min(axis=-1, initial=np.inf)
        return np.minimum(before, within)


def bounds_region(mesh: Mesh) -> bool:
    """Returns whether a mesh divides space into an outer and an inner region, consistent with its orientation.

    This holds for closed surfaces without self-intersections whose nested components have alternating orientation.
    Returns false for large meshes that were not checked for self-intersections.
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
    """Returns the side region of an open surface: the prism over its boundary, if it is a height field.

    The projection along the mean normal must cover a convex region once, as for terrains, plates and bowls. From a
    point within the walls over the boundary and above the surface, the line to the closest point neither leaves the
    walls nor crosses the surface, so it arrives on the outer side.

    Args:
        corner: Vertices of each face, (F, 3, 3).
        ends: Vertex numbers of each edge, in the order of the face, (F, 3, 2).
        neighbor: Neighbor across each edge, see ``QueryMesh``, (F, 3).
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

    # The vertices of the boundary in order; it must be a single loop.
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
    # Distance of the boundary vertices from the walls over their convex hull.
    beside = (inward @ flat.T - offset[:, None]).min(axis=0)
    covered = 0.5 * float((areas @ up).sum())
    equal = np.allclose([within, covered], _area(hull), rtol=_TOLERANCE, atol=0.0)
    if not equal or (beside > _TOLERANCE * size).any():
        return SideRegion()
    return SideRegion(
        SIDE_KNOWN_INSIDE_WALLS, inward @ across, offset, up[None], (corner @ up).max(keepdims=True)[0]
    )


def _area(loop: Array) -> float:
    """Returns the signed area of a polygon (n, 2), positive if counterclockwise."""
    x, y = (loop - loop[0]).T
    return 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def _hull(points: Array, straight: float) -> Array:
    """Returns the vertices (m, 2) of the convex hull of points (n, 2), counterclockwise (Andrew's monotone chain).

    Args:
        points: The points.
        straight: Vertices within this distance of the line through their neighbors are omitted.
    """
    ordered = points[np.lexsort(points.T[::-1])].tolist()
    around = [place for half in (ordered, ordered[::-1]) for place in _left_turns(half, 0.0)[:-1]]
    # Remove nearly collinear vertices in a second pass, because rounding makes their sorted order unreliable. It
    # starts at the vertex farthest from the mean, which is certainly a vertex of the hull.
    first = int(np.argmax(np.linalg.norm(np.array(around) - points.mean(axis=0), axis=1)))
    return np.array(_left_turns([*around[first:], *around[: first + 1]], straight)[:-1])


def _left_turns(places: list[list[float]], straight: float) -> list[list[float]]:
    """Returns the ends of a path and its points with a left turn of more than ``straight``."""
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
    """Returns the side region of a mesh or, with ``whole`` false, of a part of it with these faces."""
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
