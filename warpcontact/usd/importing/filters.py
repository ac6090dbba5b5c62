"""Which colliders of a stage do not touch each other: collision groups and filtered pairs."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.usd.importing.findings import Wrong

# Pairs beyond this number are no scene that anyone wrote.
_MOST_PAIRS = 5_000_000


def apart(stage: Any, paths: Sequence[str]) -> npt.NDArray[np.int64]:
    """Returns the pairs of colliders that do not touch, (n, 2), by their numbers among ``paths``.

    Raises:
        Wrong: If they are too many.
    """
    from pxr import Sdf, Usd, UsdPhysics

    colliders = [Sdf.Path(path) for path in paths]
    found: set[tuple[int, int]] = set()
    everywhere = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
    prims = list(Usd.PrimRange(stage.GetPseudoRoot(), everywhere))
    groups = [UsdPhysics.CollisionGroup(prim) for prim in prims if prim.IsA(UsdPhysics.CollisionGroup)]
    for first, second in _apart(groups):
        _add(found, _members(first, colliders), _members(second, colliders))
    for prim in prims:
        if prim.HasAPI(UsdPhysics.FilteredPairsAPI):
            own = _below(prim.GetPath(), colliders)
            for target in UsdPhysics.FilteredPairsAPI(prim).GetFilteredPairsRel().GetForwardedTargets():
                _add(found, own, _below(target, colliders))
    return np.array(sorted(found), dtype=np.int64).reshape(-1, 2)


def _apart(groups: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
    """Iterates over the pairs of groups that do not touch; a group may be one of a pair with itself.

    ``UsdPhysics.CollisionGroup.ComputeCollisionGroupTable`` takes a filtered group that there is not for another.
    """
    merged = [str(group.GetMergeGroupNameAttr().Get() or group.GetPath()) for group in groups]
    named = {group.GetPath(): key for group, key in zip(groups, merged, strict=True)}
    never = set[tuple[str, str]]()
    for group, key in zip(groups, merged, strict=True):
        listed = {named[path] for path in group.GetFilteredGroupsRel().GetForwardedTargets() if path in named}
        filtered = set(merged) - listed if group.GetInvertFilteredGroupsAttr().Get() else listed
        never |= {(key, other) for other in filtered} | {(other, key) for other in filtered}
    for i, first in enumerate(groups):
        for j, second in enumerate(groups[: i + 1]):
            if (merged[i], merged[j]) in never:
                yield first, second


def _members(group: Any, colliders: Sequence[Any]) -> list[int]:
    query = group.GetCollidersCollectionAPI().ComputeMembershipQuery()
    return [i for i, path in enumerate(colliders) if query.IsPathIncluded(path)]


def _below(root: Any, colliders: Sequence[Any]) -> list[int]:
    return [i for i, path in enumerate(colliders) if path.HasPrefix(root)]


def _add(found: set[tuple[int, int]], own: Iterable[int], others: Sequence[int]) -> None:
    for i in own:
        found.update((min(i, j), max(i, j)) for j in others if i != j)
        if len(found) > _MOST_PAIRS:
            raise Wrong(f"more than {_MOST_PAIRS} pairs of colliders are filtered")
