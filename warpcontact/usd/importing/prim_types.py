"""Which prims of a stage are of physics, and of which kind."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from warpcontact.usd.importing.findings import Findings
from warpcontact.usd.importing.schemas import applied, has, is_on

# Parts of names of applied schemas of other libraries that say what moves how, not how well it is computed.
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
# Of typed prims, which a stage has for what it describes: nothing of another library can be left out unsaid.
_FOREIGN = ("Physx", "Newton", "Mjc", "OmniPhysics", "Isaac")
# Applied schemas of UsdPhysics that are read, or are about joints, which are not.
_READ = (
    "PhysicsRigidBodyAPI",
    "PhysicsMassAPI",
    "PhysicsCollisionAPI",
    "PhysicsMeshCollisionAPI",
    "PhysicsMaterialAPI",
    "PhysicsFilteredPairsAPI",
)
# Schemas of Newton that are read; each attribute of them without a counterpart has a remark of its own.
_READ_OF_NEWTON = (
    "NewtonSceneAPI",
    "NewtonMassAPI",
    "NewtonCollisionAPI",
    "NewtonMaterialAPI",
)


@dataclass
class Prims:
    """Prims of physics, in the order of the stage."""

    scenes: list[Any] = field(default_factory=list)
    bodies: list[Any] = field(default_factory=list)
    colliders: list[Any] = field(default_factory=list)


def find_prims(stage: Any, findings: Findings) -> Prims:
    """Returns the prims of physics of a stage, instances as well; notes those that there is no counterpart for."""
    from pxr import Usd, UsdGeom, UsdPhysics

    prims, tuning, attributes = Prims(), Counter[str](), 0
    time = Usd.TimeCode.EarliestTime()
    instanced = _prototypes(stage)
    walk = iter(below(stage.GetPseudoRoot()))
    for prim in walk:
        if prim.GetPath() in instanced or prim.IsA(UsdGeom.PointInstancer):
            physical = next((one for one in below(prim) if _is_physical(one)), None)
            if physical is not None:
                findings.add_unsupported(physical, "physics of a PointInstancer")
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
                findings.remark(prim, "its rigid body is not enabled: it is part of what carries it")
        if has(prim, "PhysicsCollisionAPI"):
            if not is_on(UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr(), time):
                findings.remark(prim, "its collision is not enabled: it touches nothing and has no mass")
            elif prim.IsA(UsdGeom.Gprim):
                prims.colliders.append(prim)
            elif any(has(one, "PhysicsCollisionAPI") for one in list(below(prim))[1:]):
                findings.remark(prim, "it has no shape to collide with; those below it that collide are read")
            else:
                kind = prim.GetTypeName() or "no type"
                findings.add_unsupported(prim, f"a collider of type {kind}, which has no shape of its own")
        elif prim.IsA(UsdGeom.Gprim):
            attributes += 1
    if attributes and (prims.bodies or prims.colliders):
        findings.remarks.append(f"{attributes} shapes without CollisionAPI are for looks and were left out")
    if tuning:
        listed = ", ".join(f"{count} {name}" for name, count in sorted(tuning.items()))
        findings.remarks.append(f"settings of other programs were not looked at: {listed}")
    return prims


def _prototypes(stage: Any) -> set[Any]:
    """Returns the paths of the prototypes of all PointInstancers, which are not where they are."""
    from pxr import UsdGeom

    instancers = [UsdGeom.PointInstancer(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.PointInstancer)]
    return {path for one in instancers for path in one.GetPrototypesRel().GetForwardedTargets()}


def below(prim: Any) -> Any:
    """Returns a range of a prim and all below, those of instances as well."""
    from pxr import Usd

    return Usd.PrimRange(prim, Usd.TraverseInstanceProxies(Usd.PrimDefaultPredicate))


def _is_physical(prim: Any) -> bool:
    return has(prim, "PhysicsRigidBodyAPI") or has(prim, "PhysicsCollisionAPI")


def reasons(prim: Any) -> list[str]:
    """Returns why there is no counterpart for a prim, in words, if there is none."""
    from pxr import UsdPhysics

    kind = str(prim.GetTypeName())
    if prim.IsA(UsdPhysics.Joint):
        return [f"a joint, {kind}"]
    found = [f"{kind}, of another program"] if kind.startswith(_FOREIGN) else []
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
