"""Independent evaluation of body contact: rays from points of a fine subdivision of both surfaces, in NumPy."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Reference:
    """Overlap and force for a pressure of 1 Pa/m times the depth of columns.

    Attributes:
        force: On the first body [N].
        torque: On the first body, about the origin [N·m].
        depth: D [m].
        share: Weight of the columns on the second body.
        scale: Sum of the magnitudes of forces over both surfaces [N].
    """

    force: np.ndarray
    torque: np.ndarray
    depth: float
    share: float
    scale: float


def subdivide(triangles, size):
    """Returns centers (N, 3), areas (N,) and triangle numbers (N,) of equal parts of edge length up to ``size``."""
    centers, areas, numbers = [], [], []
    edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
    counts = np.maximum(1, np.ceil(edges / size)).astype(int)
    area = 0.5 * np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )
    for count in np.unique(counts):
        own = np.flatnonzero(counts == count)
        i, j = np.mgrid[0:count, 0:count]
        upright = (i + j < count).ravel()
        inverted = (i + j < count - 1).ravel()
        u = np.concatenate([(i.ravel()[upright] + 1 / 3), (i.ravel()[inverted] + 2 / 3)]) / count
        v = np.concatenate([(j.ravel()[upright] + 1 / 3), (j.ravel()[inverted] + 2 / 3)]) / count
        t = triangles[own]
        points = (
            t[:, None, 0]
            + u[:, None] * (t[:, None, 1] - t[:, None, 0])
            + v[:, None] * (t[:, None, 2] - t[:, None, 0])
        )
        centers.append(points.reshape(-1, 3))
        areas.append(np.repeat(area[own] / count**2, len(u)))
        numbers.append(np.repeat(own, len(u)))
    return np.concatenate(centers), np.concatenate(areas), np.concatenate(numbers)


def first_hits(origins, directions, numbers, triangles):
    """Returns distances (N,) of the first crossings of rays with triangles, infinite without, and whether they leave, (N,).

    Args:
        origins: Starts of the rays, (N, 3) [m].
        directions: Unit vectors, (N, 3). Those with the same number are equal.
        numbers: Numbers of their directions, (N,).
        triangles: Vertices (T, 3, 3) [m].
    """
    distance, leaves = np.full(len(origins), np.inf), np.zeros(len(origins), dtype=bool)
    order = np.argsort(numbers, kind="stable")
    for own in np.split(order, np.flatnonzero(np.diff(numbers[order])) + 1):
        direction = directions[own[0]]
        # Coordinates across the rays, in which they are points.
        across = np.linalg.svd(direction[None])[2][1:]
        points, corners = origins[own] @ across.T, triangles @ across.T
        low, high = corners.min(axis=1), corners.max(axis=1)
        for part, near in cells(points, low, high):
            rays = own[part]
            distance[rays], leaves[rays] = crossings(origins[rays], direction, triangles[near])
    return distance, leaves


def cells(points, low, high, most=64):
    """Yields numbers of points in small cells, and those of the boxes that overlap each cell.

    Args:
        points: Points (N, k).
        low: Lower corners of the boxes, (T, k).
        high: Upper corners, (T, k).
        most: Largest number of points in a cell with more than four boxes.
    """
    waiting = [(np.arange(len(points)), np.arange(len(low)))]
    while waiting:
        part, near = waiting.pop()
        first, last = points[part].min(axis=0), points[part].max(axis=0)
        near = near[((low[near] <= last) & (high[near] >= first)).all(axis=1)]
        if not len(near):
            continue
        if len(part) <= most or len(part) * len(near) <= 4 * most:
            yield part, near
            continue
        axis = int(np.argmax(last - first))
        order = part[np.argsort(points[part, axis], kind="stable")]
        middle = len(order) // 2
        waiting += [(order[:middle], near), (order[middle:], near)]


def crossings(origins, direction, triangles):
    """Returns distances (N,) of the first crossings of parallel rays with triangles, and whether they leave, (N,)."""
    first, edge_1, edge_2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    normals = np.cross(edge_1, edge_2)
    cosine = normals @ direction
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.einsum("ijk,jk->ij", first - origins[:, None], normals) / cosine
        offset = origins[:, None] + t[..., None] * direction - first
        # Barycentric coordinates of the crossing.
        area = np.einsum("jk,jk->j", normals, normals)
        u = np.einsum("ijk,jk->ij", np.cross(offset, edge_2), normals) / area
        v = np.einsum("ijk,jk->ij", np.cross(edge_1, offset), normals) / area
        hit = (t > 0) & (u >= 0) & (v >= 0) & (u + v <= 1)
    t = np.where(hit, t, np.inf)
    nearest = t.argmin(axis=1)
    distance = t[np.arange(len(t)), nearest]
    return distance, (cosine[nearest] > 0) & np.isfinite(distance)


def largest_distance(points, bounds, triangles):
    """Returns the largest distance of points from the nearest triangle of each of them.

    Args:
        points: Points (N, 3) [m].
        bounds: Upper bounds of the distances, (N,) [m].
        triangles: Vertices (T, 3, 3) [m].
    """
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    largest = 0.0
    order = np.argsort(-bounds, kind="stable")
    for start in range(0, len(order), 4096):
        part = order[start : start + 4096]
        if bounds[part[0]] <= largest:
            break
        reach = bounds[part[0]]
        for own, near in cells(points[part], low - reach, high + reach):
            rows = part[own]
            # Only triangles whose bounding boxes are within the bounds of these points.
            reach = bounds[rows].max()
            first, last = points[rows].min(axis=0), points[rows].max(axis=0)
            close = near[((low[near] - reach <= last) & (high[near] + reach >= first)).all(axis=1)]
            largest = max(largest, distances(points[rows], triangles[close]).max())
    return float(largest)


def distances(points, triangles):
    """Returns the distances (N,) of points from the nearest triangle."""
    p = points[:, None]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    height = np.einsum("ijk,jk->ij", p - triangles[:, 0], normals)
    inside = np.ones(height.shape, dtype=bool)
    least = np.full(height.shape, np.inf)
    for i in range(3):
        a, edge = triangles[:, i], triangles[:, (i + 1) % 3] - triangles[:, i]
        inside &= np.einsum("ijk,jk->ij", p - a, np.cross(normals, edge)) >= 0
        along = np.clip(np.einsum("ijk,jk->ij", p - a, edge) / np.einsum("jk,jk->j", edge, edge), 0, 1)
        least = np.minimum(least, np.linalg.norm(p - a - along[..., None] * edge, axis=2))
    return np.where(inside, np.abs(height), least).min(axis=1)


def body_contact(first, second, size, depth_of_weights=None):
    """Returns the ``Reference`` of two closed surfaces, triangles (T, 3, 3) in one frame.

    Args:
        first: Triangles of the first body.
        second: Triangles of the second body.
        size: Largest edge of the parts into which triangles are divided [m].
        depth_of_weights: D in the weights of columns [m]; by default that of the reference.
    """
    families, depth, deviation = [], 0.0, []
    for own, other, sign in ((second, first, 1.0), (first, second, -1.0)):
        low, high = other.min(axis=(0, 1)), other.max(axis=(0, 1))
        near = ((own.max(axis=1) >= low) & (own.min(axis=1) <= high)).all(axis=1)
        normals = np.cross(own[:, 1] - own[:, 0], own[:, 2] - own[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        points, areas, numbers = subdivide(own[near], size)
        normals = normals[near][numbers]
        close = ((points >= low) & (points <= high)).all(axis=1)
        points, areas, normals, numbers = points[close], areas[close], normals[close], numbers[close]
        column, inside = first_hits(points, -normals, numbers, other)
        points, areas, normals, column = points[inside], areas[inside], normals[inside], column[inside]
        if len(points):
            depth = max(depth, largest_distance(points, column, other))
        deviation.append(areas.sum() - np.linalg.norm((areas[:, None] * normals).sum(axis=0)))
        families.append((points, areas, sign * normals, column))
    share = 0.5 if sum(deviation) <= 0 else deviation[1] / sum(deviation)
    force, torque, scale = np.zeros(3), np.zeros(3), 0.0
    scale_depth = depth if depth_of_weights is None else depth_of_weights
    for weight, (points, areas, normals, column) in zip((share, 1.0 - share), families, strict=True):
        x = np.clip((column - 2 * scale_depth) / (2 * scale_depth), 0, 1) if scale_depth else np.zeros_like(column)
        forces = (weight * areas * column * (1 - x * x * (3 - 2 * x)))[:, None] * normals
        force += forces.sum(axis=0)
        torque += np.cross(points, forces).sum(axis=0)
        scale += np.linalg.norm(forces, axis=1).sum()
    return Reference(force, torque, float(depth), float(share), float(scale))


def triangles_of(mesh):
    """Returns the triangles (T, 3, 3) of a mesh."""
    return np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
