"""Finds the prims of a stage that describe physics, and classifies them."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from warpcontact.usd.importing.findings import Findings
from warpcontact.usd.importing.schemas import applied, has, is_on

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
