"""Sample points and quadrature points of a surface, with positions, areas and normals.

Blue noise: evenly spread points without a pattern, by sample elimination (C. Yuksel, Sample elimination for
generating Poisson disk sample sets, *Computer Graphics Forum* 34 (2015) 25): start with many random points and remove
the most crowded one until the wanted number is left. Points whose normals differ by more than 120°, as on the two
sides of a thin part, are independent of each other.
"""

import heapq
from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt

from warpcontact.algebra.vectors import norm
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.meshes.mesh import Mesh
from warpcontact.meshes.topology import angles, area_vectors, directions

Array = npt.NDArray[np.float64]

METHODS = ("blue_noise", "vertices", "centroids")


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Sample points of a surface, in the frame of its mesh; arrays are read-only.

    Attributes:
        positions: Positions, (n, 3) [m].
        areas: Area weight of each point, (n,) [m²]; the sum is the area of the sampled faces.
        normals: Unit normals out of the surface, (n, 3).
        faces: Face of each point, (n,); at a vertex, the first of its faces.
    """

    positions: npt.NDArray[np.float64]
    areas: npt.NDArray[np.float64]
    normals: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int64]

    def __post_init__(self) -> None:
        for array in (self.positions, self.areas, self.normals, self.faces):
            array.flags.writeable = False

    def __len__(self) -> int:
        return len(self.positions)

    def __repr__(self) -> str:
        return f"<SurfaceSamples: {len(self)} points for {self.areas.sum():.6g} m²>"


@explain_keywords
def sample_surface(
    mesh: Mesh,
    count: int | None = None,
    method: str = "blue_noise",
    *,
    seed: int = 0,
    faces: npt.ArrayLike | None = None,
) -> SurfaceSamples:
    """Returns sample points of the surface of a mesh.

    Args:
        mesh: Mesh to sample.
        count: Number of points, for ``"blue_noise"`` only.
        method: ``"blue_noise"``: evenly spread points without a pattern, each with the area nearest to it.
            ``"vertices"``: the welded vertices, each with a third of the area of its faces. ``"centroids"``: the
            centroids of the faces, each with the area of its face.
        seed: Seed of ``"blue_noise"``; the same seed gives the same points.
        faces: Faces to sample: a mask (F,) or face numbers; ``None``: all.

    Raises:
        TypeError: If ``mesh`` is not a ``Mesh``.
        ValueError: If an argument is invalid; the message names it.
    """
    if not isinstance(mesh, Mesh):
        raise TypeError(f"mesh must be a wc.Mesh, got {mesh!r}")
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(map(repr, METHODS))}, got {method!r}")
    if method != "blue_noise" and count is not None:
        raise ValueError(f"count must be None with method={method!r}, got {count!r}")
    chosen = _chosen(faces, len(mesh.faces))
    corners = mesh.vertices[mesh.faces[chosen]]
    vectors = area_vectors(corners)
    doubled = norm(vectors)
    areas, normals = 0.5 * doubled, vectors / doubled[:, None]
    if method == "centroids":
        return SurfaceSamples(corners.mean(axis=1), areas, normals, chosen)
    if method == "vertices":
        return _vertices(mesh, chosen, corners, areas, normals)
    number = _whole("count", count, 1)
    positions, areas, face = blue_noise(corners, areas, normals, number, _whole("seed", seed, 0))
    return SurfaceSamples(positions, areas, normals[face], chosen[face])


def _vertices(
    mesh: Mesh,
    chosen: npt.NDArray[np.int64],
    corners: npt.NDArray[np.float64],
    areas: npt.NDArray[np.float64],
    normals: npt.NDArray[np.float64],
) -> SurfaceSamples:
    used, first, vertex = np.unique(mesh.welded[mesh.faces[chosen]], return_index=True, return_inverse=True)
    vertex = vertex.ravel()
    third: npt.NDArray[np.float64] = np.repeat(areas / 3.0, 3)
    parts = angles(corners).reshape(-1, 1) * np.repeat(normals, 3, axis=0)
    total = np.column_stack([np.bincount(vertex, parts[:, k]) for k in range(3)]).astype(np.float64)
    face = first // 3
    normal = directions(total, normals[face])
    weight = np.bincount(vertex, third).astype(np.float64)
    return SurfaceSamples(mesh.vertices[used], weight, normal, chosen[face])


def _chosen(faces: npt.ArrayLike | None, count: int) -> npt.NDArray[np.int64]:
    """Returns the numbers of the faces to sample, in ascending order."""
    if faces is None:
        return np.arange(count)
    given = np.asarray(faces)
    if given.dtype == bool and given.shape == (count,):
        numbers = np.flatnonzero(given)
    elif given.dtype.kind in "iu" and given.ndim == 1:
        numbers = np.unique(given)
    elif given.size == 0:
        numbers = np.zeros(0, dtype=np.int64)
    else:
        raise ValueError(
            f"faces must be a mask of {count} booleans or face numbers, got {given.dtype} of shape {given.shape}"
        )
    if not len(numbers):
        raise ValueError("faces must name at least one face, got none")
    outside = numbers[(numbers < 0) | (numbers >= count)]
    if len(outside):
        raise ValueError(f"faces must be face numbers from 0 to {count - 1}, got {outside[0]}")
    return numbers.astype(np.int64)


# Like ``checks.integer``, whose module imports Warp.
def _whole(name: str, value: object, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    return int(value)


def _orbit(a: float) -> list[tuple[float, float, float]]:
    """Returns the three points of a triangle with two barycentric coordinates ``a``."""
    return [(1.0 - 2.0 * a, a, a), (a, 1.0 - 2.0 * a, a), (a, a, 1.0 - 2.0 * a)]


def _rules() -> dict[int, tuple[int, npt.NDArray[np.float64], npt.NDArray[np.float64]]]:
    """Returns order, barycentric coordinates (n, 3) and weights (n,) of the rules, by number of points.

    All rules are symmetric, inside the triangle, with positive weights: midpoint rule, Strang–Fix, Cowper–Dunavant, and
    Radon.
    """
    middle = (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)
    root = sqrt(38.0 - 44.0 * sqrt(0.4))
    far, near = ((8.0 - sqrt(10.0) + sign * root) / 18.0 for sign in (1, -1))
    share = sqrt(213125.0 - 53320.0 * sqrt(10.0))
    heavy, light = ((620.0 + sign * share) / 3720.0 for sign in (1, -1))
    fifteen = sqrt(15.0)
    rules = {
        1: (1, [middle], [1.0]),
        3: (2, _orbit(1.0 / 6.0), [1.0 / 3.0] * 3),
        6: (4, [*_orbit(far), *_orbit(near)], [heavy] * 3 + [light] * 3),
        7: (
            5,
            [middle, *_orbit((6.0 - fifteen) / 21.0), *_orbit((6.0 + fifteen) / 21.0)],
            [0.225] + [(155.0 - fifteen) / 1200.0] * 3 + [(155.0 + fifteen) / 1200.0] * 3,
        ),
    }
    return {
        number: (order, np.array(places), np.array(weights)) for number, (order, places, weights) in rules.items()
    }


_RULES = _rules()
#: Number of points per face → largest order of polynomials that are integrated exactly.
ORDERS = {number: order for number, (order, _, _) in _RULES.items()}


def face_points(mesh: Mesh, number: int, faces: npt.NDArray[np.bool_]) -> SurfaceSamples:
    """Returns ``number`` points on each selected face, with areas that add up to those of the faces.

    Args:
        mesh: Mesh with the faces.
        number: Number of points per face, a key of ``ORDERS``.
        faces: Mask (F,) of the faces.
    """
    _, places, weights = _RULES[number]
    chosen = np.flatnonzero(faces)
    corners = mesh.vertices[mesh.faces[chosen]]
    vectors = area_vectors(corners)
    doubled = norm(vectors)
    return SurfaceSamples(
        (places @ corners).reshape(-1, 3),
        (0.5 * doubled[:, None] * weights).ravel(),
        np.repeat(vectors / doubled[:, None], number, axis=0),
        np.repeat(chosen, number),
    )


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
