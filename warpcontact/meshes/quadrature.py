"""Quadrature points on faces, exact for polynomials up to some order. Used by contact couplings."""

from math import sqrt

import numpy as np
import numpy.typing as npt

from warpcontact.algebra.vectors import norm
from warpcontact.meshes.mesh import Mesh
from warpcontact.meshes.sample import SurfaceSamples
from warpcontact.meshes.topology import area_vectors


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
