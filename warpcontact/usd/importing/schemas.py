"""Applied schemas and authored attribute values, without the plug-ins that define the schemas."""

from typing import Any

#: Schemas included by those of Newton. USD adds them only if the plug-in of ``newton-usd-schemas`` is loaded.
INCLUDED = {
    "NewtonArticulationRootAPI": ("PhysicsArticulationRootAPI",),
    "NewtonMassAPI": ("PhysicsMassAPI",),
    "NewtonCollisionAPI": ("PhysicsCollisionAPI",),
    "NewtonMeshCollisionAPI": ("NewtonCollisionAPI", "PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"),
    "NewtonSDFCollisionAPI": ("NewtonCollisionAPI", "PhysicsCollisionAPI"),
    "NewtonMaterialAPI": ("PhysicsMaterialAPI",),
}


def applied(prim: Any) -> list[str]:
    """Returns the names of the applied schemas of a prim in order, without instance names and repetitions."""
    names: dict[str, None] = {}
    for full in prim.GetPrimTypeInfo().GetAppliedAPISchemas():
        name = str(full).partition(":")[0]
        names |= dict.fromkeys((name, *INCLUDED.get(name, ())))
    return list(names)


def has(prim: Any, schema: str) -> bool:
    """Returns whether a schema is applied to a prim, directly or included by another one."""
    return schema in applied(prim)


def value_of(attribute: Any, time: Any, fallback: Any = None) -> Any:
    """Returns the value of an attribute; ``fallback`` if it does not exist, has no value, or is blocked."""
    value = attribute.Get(time) if attribute else None
    return fallback if value is None else value


def is_on(attribute: Any, time: Any) -> bool:
    """Returns a boolean attribute of UsdPhysics that is true by default."""
    return bool(value_of(attribute, time, True))


def is_authored(attribute: Any) -> bool:
    """Returns whether an attribute has an authored value, other than the fallback of its schema."""
    return bool(attribute) and attribute.HasAuthoredValue()
