"""Orients the faces of a surface: neighbors agree and closed parts face outward."""

import numpy as np
import numpy.typing as npt

from warpcontact.algebra.vectors import norm
from warpcontact.meshes.nesting import find_containing_parts
from warpcontact.meshes.topology import Edges, area_vectors, components, representatives, volumes_of

_Integers = npt.NDArray[np.integer]


def faces_to_flip(v: npt.NDArray[np.float64], faces: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.bool], int]:
    """Selects the faces to flip.

    Faces connected by edges of exactly two faces form patches. Within a patch, faces are made consistent by flipping
    the smaller area. Then closed patches are oriented outward. A patch inside another one, such as a cavity, keeps its
    orientation relative to the enclosing one if its own faces were consistent, and is oriented as a cavity otherwise.

    Args:
        v: Positions, (V, 3) [m].
        faces: Welded vertex indices of each triangle, (F, 3), three different ones.

    Returns:
        Whether to flip each face, (F,); and the number of one-sided patches, such as a Möbius strip, which are
        unchanged.
    """
    count = len(faces)
    edges = Edges(faces)
    shared = edges.counts == 2
    pairs, opposed = edges.halves[shared] // 3, edges.balance[shared] != 0
    parts, part = components(pairs, count)
    # Each face has two nodes, unchanged (2 i) and flipped (2 i + 1), linked with the consistent nodes of neighbors.
    f, g = pairs.T
    links = [np.column_stack((2 * f + side, 2 * g + (side ^ opposed))) for side in (0, 1)]
    _, state = components(np.concatenate(links), 2 * count)
    one_sided = np.zeros(parts, dtype=bool)
    one_sided[part[state[0::2] == state[1::2]]] = True
    first = np.unique(part, return_index=True)[1]
    flip = (state[0::2] != state[2 * first[part]]) & ~one_sided[part]

    areas = norm(area_vectors(v[faces]))
    flip ^= (np.bincount(part, areas * flip, parts) > 0.5 * np.bincount(part, areas, parts))[part]
    agreed = np.bincount(part, flip, parts) == 0  # as given
    agreed |= np.bincount(part, flip, parts) == np.bincount(part, minlength=parts)

    alike = np.where(flip[:, None], faces[:, ::-1], faces)
    closed = _closed(alike, part, parts) & ~one_sided
    _, volumes, zero_volume = volumes_of(v, alike, part, parts)
    closed &= np.abs(volumes) > zero_volume
    containing = find_containing_parts(v, alike, part, closed)
    over = np.zeros(parts, dtype=bool)  # patches to flip as a whole, in addition
    for i in sorted(np.flatnonzero(closed).tolist(), key=lambda i: _depth(i, containing)):
        outer = containing.get(i)
        if outer is None:
            over[i] = volumes[i] < 0.0
        elif agreed[i]:
            over[i] = over[outer] and agreed[outer]
        else:
            over[i] = (volumes[i] > 0.0) == ((volumes[outer] > 0.0) != over[outer])
    return flip ^ over[part], int(one_sided.sum())


def _depth(i: int, containing: dict[int, int]) -> int:
    depth = 0
    while i in containing and depth <= len(containing):
        i, depth = containing[i], depth + 1
    return depth


def _closed(faces: npt.NDArray[np.int64], part: _Integers, parts: int) -> npt.NDArray[np.bool]:
    """Returns which patches are closed: each edge is traversed equally often in both directions."""
    ends = np.stack((faces, faces[:, [1, 2, 0]]), axis=2).reshape(-1, 2)
    owner = np.repeat(part, 3)
    edge = representatives(np.column_stack((np.sort(ends, axis=1), owner)))
    balance = np.bincount(edge, np.where(ends[:, 0] < ends[:, 1], 1, -1), len(ends))
    closed = np.ones(parts, dtype=bool)
    closed[owner[balance != 0]] = False
    return closed
