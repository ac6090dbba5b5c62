"""Prims of a stage that describe physics, and pairs of colliders without contact."""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.usd.importing.findings import Findings, InvalidValue, applied, has, is_on

# Parts of schema names of other libraries that define dynamics; other schemas hold only solver settings.
_ESSENTIAL = {
    "Deformable": "a deformable body",
    "SoftBody": "a deformable body",
    "Cloth": "cloth",
    "Particle": "particles",
    "Tendon": "a tendon",
    "Vehicle": "a vehicle",
    "ForceAPI": "a force",
    "SurfaceVelocity": "a surface that conveys",
    "CharacterController": "a character",
    "Mimic": "a joint that follows another",
    "Actuator": "an actuator",
    "Trigger": "a trigger",
    "Buoyancy": "buoyancy",
}
# Prefixes of type names of other libraries. Typed prims define dynamics, so none may be omitted silently.
_FOREIGN = ("Physx", "Newton", "Mjc", "OmniPhysics", "Isaac")
# Applied schemas of UsdPhysics that are read.
_READ = (
    "PhysicsRigidBodyAPI",
    "PhysicsMassAPI",
    "PhysicsCollisionAPI",
    "PhysicsMeshCollisionAPI",
    "PhysicsMaterialAPI",
    "PhysicsFilteredPairsAPI",
)
# Schemas of Newton that are read; attributes without a counterpart get their own remarks.
_READ_OF_NEWTON = (
    "NewtonSceneAPI",
    "NewtonMassAPI",
    "NewtonCollisionAPI",
    "NewtonMaterialAPI",
)

# Largest number of excluded pairs, a limit against malicious files.
_MOST_PAIRS = 5_000_000


@dataclass
class Prims:
    """Prims with physics, in the order of the stage."""

    scenes: list[Any] = field(default_factory=list)
    bodies: list[Any] = field(default_factory=list)
    colliders: list[Any] = field(default_factory=list)


def find_prims(stage: Any, findings: Findings) -> Prims:
    """Returns the prims of a stage with physics, including instances; records those without a counterpart."""
    from pxr import Usd, UsdGeom, UsdPhysics

    prims, tuning, attributes = Prims(), Counter[str](), 0
    time = Usd.TimeCode.EarliestTime()
    instanced = _prototypes(stage)
    walk = iter(below(stage.GetPseudoRoot()))
    for prim in walk:
        if prim.GetPath() in instanced or prim.IsA(UsdGeom.PointInstancer):
            physical = next((one for one in below(prim) if _is_physical(one)), None)
            if physical is not None:
                findings.add_unsupported(physical, "physics in a PointInstancer")
            walk.PruneChildren()
            continue
        for reason in reasons(prim):
            findings.add_unsupported(prim, reason)
        tuning.update(name for name in applied(prim) if _is_tuning(name))
        if prim.IsA(UsdPhysics.Scene):
            prims.scenes.append(prim)
        if has(prim, "PhysicsRigidBodyAPI"):
            if is_on(UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr(), time):
                prims.bodies.append(prim)
            else:
                findings.remark(prim, "physics:rigidBodyEnabled is off: it is part of its parent")
        if has(prim, "PhysicsCollisionAPI"):
            if not is_on(UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr(), time):
                findings.remark(prim, "physics:collisionEnabled is off: it has neither contacts nor mass")
            elif prim.IsA(UsdGeom.Gprim):
                prims.colliders.append(prim)
            elif any(has(one, "PhysicsCollisionAPI") for one in list(below(prim))[1:]):
                findings.remark(prim, "it has no shape; colliders below it are read")
            else:
                kind = prim.GetTypeName() or "no type"
                findings.add_unsupported(prim, f"a collider of type {kind}, which has no shape")
        elif prim.IsA(UsdGeom.Gprim):
            attributes += 1
    if attributes and (prims.bodies or prims.colliders):
        findings.remarks.append(f"{attributes} shapes without CollisionAPI are visual only and were omitted")
    if tuning:
        listed = ", ".join(f"{count} {name}" for name, count in sorted(tuning.items()))
        findings.remarks.append(f"solver settings of other programs were ignored: {listed}")
    return prims


def _prototypes(stage: Any) -> set[Any]:
    """Returns the paths of the prototypes of all PointInstancers, which are not drawn where they are defined."""
    from pxr import UsdGeom

    instancers = [UsdGeom.PointInstancer(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.PointInstancer)]
    return {path for one in instancers for path in one.GetPrototypesRel().GetForwardedTargets()}


def below(prim: Any) -> Any:
    """Returns a range of a prim and its descendants, including instances."""
    from pxr import Usd

    return Usd.PrimRange(prim, Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate))


def _is_physical(prim: Any) -> bool:
    return has(prim, "PhysicsRigidBodyAPI") or has(prim, "PhysicsCollisionAPI")


def reasons(prim: Any) -> list[str]:
    """Returns the reasons why a prim has no counterpart; empty if it has one."""
    from pxr import UsdPhysics

    kind = str(prim.GetTypeName())
    if prim.IsA(UsdPhysics.Joint):
        return [f"a joint, {kind}"]
    found = [f"{kind}, a type of another program"] if kind.startswith(_FOREIGN) else []
    for name in applied(prim):
        if name == "PhysicsArticulationRootAPI":
            found.append("an articulation")
        elif name.startswith("Physics") and name not in _READ:
            found.append(f"{name}")
        elif (essence := _essence(name)) is not None:
            found.append(f"{essence}, {name}")
    return found


def _is_tuning(schema: str) -> bool:
    return schema.startswith(_FOREIGN) and schema not in _READ_OF_NEWTON and _essence(schema) is None


def _essence(schema: str) -> str | None:
    return next((words for part, words in _ESSENTIAL.items() if part in schema), None)


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
