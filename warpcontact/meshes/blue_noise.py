"""Points spread evenly over triangles without a pattern, and the area that belongs to each.

Sample elimination (C. Yuksel, Sample elimination for generating Poisson disk sample sets, *Computer Graphics
Forum* 34 (2015) 25): of many more random points than wanted, the most crowded one is taken away until enough are
left. Points on two sides of a thin part, whose normals differ by more than 120°, do not crowd each other: each
side is sampled on its own.
"""

import heapq

import numpy as np
import numpy.typing as npt

# Random points for each that stays.
CANDIDATES = 5
# Yuksel's constants: how fast crowding falls off with distance, and how far all near points count alike.
ALPHA, BETA, GAMMA = 8.0, 0.65, 1.5
# Cosine between the normals of two points from which on they lie on one side of a surface.
ONE_SIDE = -0.5
# Points by which the area of each point is measured, on average, and how many of them at a time.
PROBES, PROBES_AT_ONCE = 128, 500_000
# Nearest points among which one of the same side is looked for.
NEAREST = 8
# Fractions by which points fill a square evenly, whatever their number (Kronecker sequence of the plastic number).
PLASTIC = np.array([0.7548776662466927, 0.5698402909980532])

Array = npt.NDArray[np.float64]


def blue_noise(
    corners: Array, areas: Array, normals: Array, count: int, seed: int
) -> tuple[Array, Array, npt.NDArray[np.intp]]:
    """Returns positions (n, 3), areas (n,) and faces (n,) of ``count`` points.

    Args:
        corners: Corners of each triangle, (F, 3, 3) [m].
        areas: Their areas, (F,) [m²], positive.
        normals: Their unit normals, (F, 3).
        count: Number of points.
        seed: Of the random numbers.
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
        corners: Corners of each triangle, (F, 3, 3).
        areas: Their areas, (F,).
        marks: Of each point the part of the whole area that lies before its face, or on it, (n,), from 0 to 1.
        unit: Of each point a place in the unit square, (n, 2).
    """
    ends = np.cumsum(areas)
    face = np.minimum(np.searchsorted(ends, marks * ends[-1], side="right"), len(areas) - 1)
    # The half of the square beyond the diagonal is folded over.
    u, v = np.where(unit.sum(axis=1, keepdims=True) > 1.0, 1.0 - unit, unit).T[:, :, None]
    a, b, c = corners[face].swapaxes(0, 1)
    return a + u * (b - a) + v * (c - a), face


def _eliminate(positions: Array, normals: Array, area: float, count: int) -> npt.NDArray[np.intp]:
    """Returns the indices of the ``count`` points that stay, in ascending order."""
    from scipy.spatial import cKDTree

    total = len(positions)
    # Twice the radius of the densest packing of so many discs.
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

    # Entries of the heap whose weight has changed since are passed over.
    heap = [(-w, i) for i, w in enumerate(weight)]
    heapq.heapify(heap)
    stays = np.ones(total, dtype=bool)
    left = total
    while left > count:
        w, i = heapq.heappop(heap)
        if not stays[i] or w != -weight[i]:
            continue
        stays[i] = False
        left -= 1
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
    """Returns the area of the surface that is nearest to each point, on its side."""
    from scipy.spatial import cKDTree

    tree, count = cKDTree(positions), len(positions)
    nearest = min(NEAREST, count)
    probes = PROBES * count
    hits = np.zeros(count)
    offset, phase = rng.random(2), rng.random()
    unit = (offset + np.arange(1, probes + 1)[:, None] * PLASTIC) % 1.0
    # Evenly by area: no face is missed that is larger than the part of one probe.
    probe, on = _scatter(corners, areas, (np.arange(probes) + phase) / probes, unit)
    for start in range(0, probes, PROBES_AT_ONCE):
        part = slice(start, start + PROBES_AT_ONCE)
        normal = normals[on[part]]
        _, owner = tree.query(probe[part])
        across = np.flatnonzero(np.einsum("ij,ij->i", normals[face[owner]], normal) <= ONE_SIDE)
        if len(across) and nearest > 1:
            _, near = tree.query(probe[part][across], k=nearest)
            same = np.einsum("ijk,ik->ij", normals[face[near]], normal[across]) > ONE_SIDE
            # Where none is on the same side, the nearest.
            owner[across] = near[np.arange(len(near)), same.argmax(axis=1)]
        hits += np.bincount(owner, minlength=count)
    # Every point has some area, however crowded a self-cutting surface makes it.
    hits = np.maximum(hits, 1.0)
    return hits * (areas.sum() / hits.sum())
