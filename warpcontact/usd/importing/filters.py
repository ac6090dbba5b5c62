"""Pairs of colliders without contact: collision groups and filtered pairs of a stage."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.usd.importing.findings import InvalidValue

# Largest number of excluded pairs, a limit against malicious files.
_MOST_PAIRS = 5_000_000


def excluded_pairs(
    stage: Any, paths: Sequence[str], owners: Sequence[str | None], rigid: Collection[Any]
) -> npt.NDArray[np.int64]:
    """Returns the pairs of colliders without contact, (n, 2), as indices into ``paths``.

    Args:
        stage: Stage with the colliders.
        paths: Paths of the colliders.
        owners: Paths of their bodies; ``None``: the world.
        rigid: Paths of all rigid bodies.

    Raises:
        InvalidValue: If there are more than 5 000 000 pairs.
    """
    from pxr import Sdf, Usd, UsdPhysics

    colliders = [Sdf.Path(path) for path in paths]
    found: set[tuple[int, int]] = set()
    everywhere = Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate)
    prims = list(Usd.PrimRange(stage.GetPseudoRoot(), everywhere))
    groups = [UsdPhysics.CollisionGroup(prim) for prim in prims if prim.IsA(UsdPhysics.CollisionGroup)]
    members = {group.GetPath(): _members(group, colliders) for group in groups}
    grouped = set().union(*members.values())
    ungrouped = [i for i in range(len(colliders)) if i not in grouped]
    for first, second in _excluded_groups(groups):
        _add(found, members[first.GetPath()], ungrouped if second is None else members[second.GetPath()])

    def below(root: Any) -> list[int]:
        # A body represents its own colliders, without those of nested bodies.
        if root in rigid:
            return [i for i, owner in enumerate(owners) if owner == str(root)]
        return [i for i, path in enumerate(colliders) if path.HasPrefix(root)]

    for prim in prims:
        relation = prim.GetRelationship("physics:filteredPairs")
        for target in relation.GetForwardedTargets() if relation else ():
            _add(found, below(prim.GetPath()), below(target))
    return np.array(sorted(found), dtype=np.int64).reshape(-1, 2)


def _excluded_groups(groups: Sequence[Any]) -> Iterator[tuple[Any, Any | None]]:
    """Iterates over the pairs of groups without contact, which include pairs of a group with itself.

    The second is ``None`` for the colliders in no group, which do not collide with an inverted group. Replaces
    ``UsdPhysics.CollisionGroup.ComputeCollisionGroupTable``, which mistakes a missing filtered group for another one.
    """
    merged = [str(group.GetMergeGroupNameAttr().Get() or group.GetPath()) for group in groups]
    named = {group.GetPath(): key for group, key in zip(groups, merged, strict=True)}
    never = set[tuple[str, str]]()
    for group, key in zip(groups, merged, strict=True):
        listed = {named[path] for path in group.GetFilteredGroupsRel().GetForwardedTargets() if path in named}
        inverted = bool(group.GetInvertFilteredGroupsAttr().Get())
        filtered = set(merged) - listed if inverted else listed
        never |= {(key, other) for other in filtered} | {(other, key) for other in filtered}
        if inverted:
            yield from ((one, None) for one, other in zip(groups, merged, strict=True) if other == key)
    for i, first in enumerate(groups):
        for j, second in enumerate(groups[: i + 1]):
            if (merged[i], merged[j]) in never:
                yield first, second


def _members(group: Any, colliders: Sequence[Any]) -> list[int]:
    query = group.GetCollidersCollectionAPI().ComputeMembershipQuery()
    return [i for i, path in enumerate(colliders) if query.IsPathIncluded(path)]


def _add(found: set[tuple[int, int]], own: Iterable[int], others: Sequence[int]) -> None:
    for i in own:
        found.update((min(i, j), max(i, j)) for j in others if i != j)
        if len(found) > _MOST_PAIRS:
            raise InvalidValue(f"more than {_MOST_PAIRS} pairs of colliders are filtered")
