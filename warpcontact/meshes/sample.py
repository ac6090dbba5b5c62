"""Points that stand for a surface: where they are, how much area each stands for, and which way it looks."""

from dataclasses import dataclass

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
    """Points of a surface, in the frame of its mesh; arrays are read-only.

    Attributes:
        positions: Where they are, (n, 3) [m].
        areas: The area that each stands for, (n,) [m²]; their sum is the area of the faces that were sampled.
        normals: Unit normals out of the surface, (n, 3).
        faces: The face on which each lies, (n,); of several, at a vertex, the first.
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
    """Returns points that stand for the surface of a mesh.

    Args:
        mesh: The mesh.
        count: Number of points; of ``"blue_noise"`` only, the other methods know theirs.
        method: ``"blue_noise"``: as evenly as points can lie that follow no pattern, each with the area that is
            nearer to it than to any other. ``"vertices"``: the vertices, those at the same place as one, each
            with a third of its faces. ``"centroids"``: the centres of the faces, each with its face.
        seed: Of the random numbers of ``"blue_noise"``: the same seed gives the same points.
        faces: The part to sample: a mask (F,) or face numbers; ``None``: all.

    Raises:
        ValueError: If an argument is not allowed; the message names it.
    """
    if not isinstance(mesh, Mesh):
        raise TypeError(f"mesh must be a wc.Mesh, got {mesh!r}")
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(map(repr, METHODS))}, got {method!r}")
    if method != "blue_noise" and count is not None:
        raise ValueError(f"count must be left out with method={method!r}, which has its own, got {count!r}")
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


# As ``checks.whole``, which imports Warp.
def _whole(name: str, value: object, least: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    return int(value)
