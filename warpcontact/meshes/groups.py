"""Named groups of faces: validation, and selection of faces."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

#: Selection of faces: a mask (F,) or face numbers; names of groups; or a function that takes the centroids
#: (F, 3) [m], in the frame of the mesh, and returns a mask. ``None``: all.
FaceChoice = npt.ArrayLike | str | Callable[[npt.NDArray[np.float64]], npt.ArrayLike] | None


class Faces(Protocol):
    """Triangles with named groups."""

    @property
    def vertices(self) -> npt.NDArray[np.float64]:
        """Positions, (V, 3) [m]."""

    @property
    def faces(self) -> npt.NDArray[Any]:
        """Vertex indices of each triangle, (F, 3)."""

    @property
    def groups(self) -> Mapping[str, npt.NDArray[Any]]:
        """Face numbers by group name."""


def checked_groups(groups: Mapping[str, npt.ArrayLike] | None, count: int) -> Mapping[str, npt.NDArray[np.int32]]:
    """Returns groups of a mesh with ``count`` faces as ascending read-only arrays.

    Raises:
        ValueError: If a name is not a non-empty string, or a face number is out of range.
    """
    checked: dict[str, npt.NDArray[np.int32]] = {}
    for name, members in (groups or {}).items():
        if not isinstance(name, str) or not name:
            raise ValueError(f"a group must have a non-empty string for a name, got {name!r}")
        checked[name] = _numbers(f"groups[{name!r}]", members, count)
        checked[name].flags.writeable = False
    return MappingProxyType(checked)


def face_mask(label: str, choice: FaceChoice, mesh: Faces) -> npt.NDArray[np.bool]:
    """Returns the mask (F,) of the selected faces of a mesh.

    Args:
        label: Name of the argument in messages.
        choice: Selection of faces.
        mesh: A ``Mesh``, or the content of a file, which may be invalid.

    Raises:
        ValueError: If the selection is invalid, a number is out of range, or a group does not exist.
    """
    count = len(mesh.faces)
    if callable(choice):
        found = np.asarray(choice(_centroids(mesh.vertices, mesh.faces)))
        if found.dtype != bool or found.shape != (count,):
            raise ValueError(
                f"{label} as a function must return a mask of shape ({count},), got {found.dtype} values of shape "
                f"{found.shape}"
            )
        return found.copy()
    names = [choice] if isinstance(choice, str) else choice
    if isinstance(names, list | tuple | set) and any(isinstance(name, str) for name in names):
        mask = np.zeros(count, dtype=bool)
        for name in names:
            if name not in mesh.groups:
                in_range = ", ".join(sorted(mesh.groups)[:20]) + (", …" if len(mesh.groups) > 20 else "")
                raise ValueError(f"{label} must be groups of the mesh ({in_range or 'it has none'}), got {name!r}")
            mask[mesh.groups[name]] = True
        return mask
    return _mask(label, choice, count)


def _centroids(vertices: npt.NDArray[np.float64], faces: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    """Returns the centroids (F, 3) of faces; NaN if a vertex index is out of range."""
    in_range = np.all((faces >= 0) & (faces < len(vertices)), axis=1)
    centroids = np.full((len(faces), 3), np.nan)
    centroids[in_range] = vertices[faces[in_range]].mean(axis=1)
    return centroids


def _mask(label: str, faces: Any, count: int) -> npt.NDArray[np.bool]:
    """Returns a mask over ``count`` faces from a mask, face numbers, or ``None`` for all."""
    if faces is None:
        return np.ones(count, dtype=bool)
    mask = np.zeros(count, dtype=bool)
    mask[_numbers(label, faces, count)] = True
    return mask


def _numbers(label: str, faces: Any, count: int) -> npt.NDArray[np.int32]:
    """Returns ascending face numbers from a mask over ``count`` faces, or face numbers."""
    given = np.asarray(faces)
    if given.dtype == bool:
        if given.shape != (count,):
            raise ValueError(f"{label} as a mask must have shape ({count},), got {given.shape}")
        return np.flatnonzero(given).astype(np.int32)
    if given.size == 0:
        return np.empty(0, dtype=np.int32)
    if given.ndim != 1 or not np.issubdtype(given.dtype, np.integer):
        raise ValueError(f"{label} must be a mask of {count} booleans or face numbers, got {given.dtype} values")
    if given.min() < 0 or given.max() >= count:
        outside = given[(given < 0) | (given >= count)]
        raise ValueError(f"{label} must be face numbers from 0 to {count - 1}, got {outside[0]}")
    # Most numbers are sorted already; sorting each of possibly many groups would be slow.
    return (given if (given[:-1] < given[1:]).all() else np.unique(given)).astype(np.int32)
