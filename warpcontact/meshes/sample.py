"""Sample points and quadrature points of a surface, with positions, areas and normals."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
import numpy.typing as npt

from warpcontact.algebra.vectors import norm
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.meshes.blue_noise import blue_noise
from warpcontact.meshes.mesh import Mesh
from warpcontact.meshes.topology import angles, area_vectors, directions

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
