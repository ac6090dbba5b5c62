"""Blue-noise sampling of triangles: evenly spread points without a pattern, and the area of each.

Sample elimination (C. Yuksel, Sample elimination for generating Poisson disk sample sets, *Computer Graphics
Forum* 34 (2015) 25): start with many random points and remove the most crowded one until the wanted number is left.
Points whose normals differ by more than 120°, as on the two sides of a thin part, are independent of each other.
Used by ``sample.py``.
"""

import heapq

import numpy as np
import numpy.typing as npt

# Random candidates per point of the result.
CANDIDATES = 5
# Constants of Yuksel: decay of the weight with distance, and the range of distances with equal weight.
ALPHA, BETA, GAMMA = 8.0, 0.65, 1.5
# Points are on the same side of the surface if the cosine between their normals exceeds this.
ONE_SIDE = -0.5
# Average number of probe points that measure the area of a point, and number of probes per block.
PROBES, PROBES_AT_ONCE = 128, 500_000
# Number of nearest points among which one on the same side is searched.
NEAREST = 8
# Increments of a low-discrepancy sequence in the unit square (Kronecker sequence of the plastic number).
PLASTIC = np.array([0.7548776662466927, 0.5698402909980532])

Array = npt.NDArray[np.float64]


def blue_noise(
    corners: Array, areas: Array, normals: Array, count: int, seed: int
) -> tuple[Array, Array, npt.NDArray[np.intp]]:
    """Returns positions (n, 3), areas (n,) and faces (n,) of ``count`` points.

    Args:
        corners: Vertices of each triangle, (F, 3, 3) [m].
        areas: Triangle areas, (F,) [m²], positive.
        normals: Unit normals of the triangles, (F, 3).
        count: Number of points.
        seed: Seed of the random numbers.
    """
    rng = np.random.default_rng(seed)
    number = CANDIDATES * count
    positions, face = _scatter(corners, areas, np.sort(rng.random(number)), rng.random((number, 2)))
    kept = _eliminate(positions, normals[face], float(areas.sum()), count)
    positions, face = positions[kept], face[kept]
    return positions, _measure(corners, areas, normals, positions, face, rng), face


def _scatter(corners: Array, areas: Array, marks: Array, unit: Array) -> tuple[Array, npt.NDArray[np.intp]]:
    """Returns points on triangles, and the face of each.

    Args:
        corners: Vertices of each triangle, (F, 3, 3).
        areas: Triangle areas, (F,).
        marks: Position of each point in the cumulative area, as a fraction of the total, (n,), from 0 to 1.
        unit: Point in the unit square for each point, (n, 2).
    """
    ends = np.cumsum(areas)
    face = np.minimum(np.searchsorted(ends, marks * ends[-1], side="right"), len(areas) - 1)
    # Fold the half of the square beyond the diagonal.
    u, v = np.where(unit.sum(axis=1, keepdims=True) > 1.0, 1.0 - unit, unit).T[:, :, None]
    a, b, c = corners[face].swapaxes(0, 1)
    return a + u * (b - a) + v * (c - a), face


def _eliminate(positions: Array, normals: Array, area: float, count: int) -> npt.NDArray[np.intp]:
    """Returns the indices of the ``count`` remaining points, in ascending order."""
    from scipy.spatial import cKDTree

    total = len(positions)
    # Twice the radius of ``count`` disks in their densest packing.
    reach = 2.0 * np.sqrt(area / (2.0 * np.sqrt(3.0) * count))
    pairs = cKDTree(positions).query_pairs(reach, output_type="ndarray")
    pairs = pairs[np.einsum("ij,ij->i", normals[pairs[:, 0]], normals[pairs[:, 1]]) > ONE_SIDE]
    distance = np.linalg.norm(positions[pairs[:, 0]] - positions[pairs[:, 1]], axis=1)
    least = reach * BETA * (1.0 - (count / total) ** GAMMA)
    crowding = (1.0 - np.maximum(distance, least) / reach) ** ALPHA
    # Both directions of each pair, sorted by the first point.
    first, second = np.concatenate([pairs, pairs[:, ::-1]]).T
    order = np.lexsort((second, first))
    starts = np.searchsorted(first[order], np.arange(total + 1)).tolist()
    second, both = second[order].tolist(), np.concatenate([crowding, crowding])[order].tolist()
    weight = np.bincount(first, np.concatenate([crowding, crowding]), total).tolist()

    # Outdated entries of the heap, whose weight has changed, are skipped.
    heap = [(-w, i) for i, w in enumerate(weight)]
    heapq.heapify(heap)
    stays = np.ones(total, dtype=bool)
    remaining = total
    while remaining > count:
        w, i = heapq.heappop(heap)
        if not stays[i] or w != -weight[i]:
            continue
        stays[i] = False
        remaining -= 1
        for k in range(starts[i], starts[i + 1]):
            j = second[k]
            if stays[j]:
                weight[j] -= both[k]
                heapq.heappush(heap, (-weight[j], j))
    return np.flatnonzero(stays)


def _measure(
    corners: Array,
    areas: Array,
    normals: Array,
    positions: Array,
    face: npt.NDArray[np.intp],
    rng: np.random.Generator,
) -> Array:
    """Returns the area of the part of the surface that is nearest to each point, on the same side."""
    from scipy.spatial import cKDTree

    tree, count = cKDTree(positions), len(positions)
    nearest = min(NEAREST, count)
    probes = PROBES * count
    hits = np.zeros(count)
    offset, phase = rng.random(2), rng.random()
    unit = (offset + np.arange(1, probes + 1)[:, None] * PLASTIC) % 1.0
    # Evenly distributed by area: each face larger than the area of one probe gets a probe.
    probe, on = _scatter(corners, areas, (np.arange(probes) + phase) / probes, unit)
    for start in range(0, probes, PROBES_AT_ONCE):
        part = slice(start, start + PROBES_AT_ONCE)
        normal = normals[on[part]]
        _, owner = tree.query(probe[part])
        across = np.flatnonzero(np.einsum("ij,ij->i", normals[face[owner]], normal) <= ONE_SIDE)
        if len(across) and nearest > 1:
            _, near = tree.query(probe[part][across], k=nearest)
            same = np.einsum("ijk,ik->ij", normals[face[near]], normal[across]) > ONE_SIDE
            # If none of them is on the same side, use the nearest one.
            owner[across] = near[np.arange(len(near)), same.argmax(axis=1)]
        hits += np.bincount(owner, minlength=count)
    # Each point gets a positive area, even where the surface intersects itself.
    hits = np.maximum(hits, 1.0)
    return hits * (areas.sum() / hits.sum())
