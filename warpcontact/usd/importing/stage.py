"""Reads a USD file in the reader process: an exported scene, or the UsdPhysics content of other stages.

An exported scene is its description, records of values, targets and children of each prim. The scene is built from the
description alone, so bodies, colliders and joints that were added to the stage are reported.
"""

import re
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from warpcontact.meshes.readers.unreadable import Unreadable
from warpcontact.meshes.readers.usd_layers import check_layers, reason
from warpcontact.usd.importing.findings import has, is_on, path_of, shortened
from warpcontact.usd.importing.physics import read_gravity, read_physics, stepping_of
from warpcontact.usd.importing.prims import below, reasons

#: Schema version of descriptions. It increases when a default value or a name changes.
SCHEMA = 2
_PREFIX = "warpcontact:"
# Allowed types of attributes, by their names in Sdf: single values, rows of numbers, arrays.
_PLAIN = ("bool", "int64", "double", "string")
_FIXED = ("double2", "double3", "double4", "matrix3d")
_ARRAYS = ("bool[]", "int[]", "int2[]", "int3[]", "double[]", "double2[]", "double3[]", "double4[]", "matrix3d[]")
# Largest nesting depth. Descriptions need element → range → impact.
_DEEPEST = 8

_ENVIRONMENT = re.compile(r"env_\d+")
_ITEM = re.compile(r"item_\d+")
# Directions and magnitudes of gravity are single precision on a stage.
_SINGLE = 1.0e-6

#: Key of an array in the header; not a valid name in USD.
ARRAY = "*"


class Record(TypedDict):
    """Prim of a description.

    Attributes:
        path: Path of the prim.
        values: Attributes ``warpcontact:*`` by name without the prefix: bool, int, float, str, lists or arrays.
        targets: Relationships ``warpcontact:*`` by name without the prefix, as lists of paths.
        children: Child prims by name.
    """

    path: str
    values: dict[str, Any]
    targets: dict[str, list[str]]
    children: dict[str, "Record"]


def read_records(stage: Any) -> Record | None:
    """Returns the description of a stage; ``None`` if it has none, or one with an earlier schema.

    Raises:
        ValueError: If there are several, or one has invalid content; the message names the prim.
    """
    roots = [prim for prim in _roots(stage) if not _is_earlier(prim)]
    if not roots:
        return None
    if len(roots) > 1:
        listed = ", ".join(shortened(prim.GetPath()) for prim in roots[:5])
        raise ValueError(f"a stage must have one description, got descriptions at {listed}")
    return _record(roots[0], 0)


def earlier_description(stage: Any) -> str | None:
    """Returns a warning if a stage has a description with an earlier schema, which is ignored; else ``None``."""
    for prim in filter(_is_earlier, _roots(stage)):
        version = prim.GetAttribute(f"{_PREFIX}version").Get()
        return (
            f"{shortened(prim.GetPath())}: written by warpcontact {shortened(version)} in schema "
            f"{prim.GetAttribute(f'{_PREFIX}schema').Get()}; the stage is imported as one of UsdPhysics"
        )
    return None


def _roots(stage: Any) -> list[Any]:
    return [prim for prim in stage.Traverse() if prim.HasAttribute(f"{_PREFIX}schema")]


def _is_earlier(prim: Any) -> bool:
    schema = prim.GetAttribute(f"{_PREFIX}schema").Get()
    return isinstance(schema, int) and 0 < schema < SCHEMA


def _record(prim: Any, depth: int) -> Record:
    path = str(prim.GetPath())
    if depth > _DEEPEST:
        raise ValueError(f"{shortened(path)} exceeds the nesting depth of a description")
    values = {}
    for attribute in prim.GetAttributes():
        name = str(attribute.GetName())
        if name.startswith(_PREFIX):
            values[name.removeprefix(_PREFIX)] = _value(attribute)
    targets = {
        str(relation.GetName()).removeprefix(_PREFIX): [str(target) for target in relation.GetTargets()]
        for relation in prim.GetRelationships()
        if str(relation.GetName()).startswith(_PREFIX)
    }
    children = {str(child.GetName()): _record(child, depth + 1) for child in prim.GetChildren()}
    return {"path": path, "values": values, "targets": targets, "children": children}


def _value(attribute: Any) -> Any:
    kind, value = str(attribute.GetTypeName()), attribute.Get()
    if value is None:
        raise ValueError(f"{shortened(attribute.GetPath())} has no value")
    if kind in _PLAIN:
        return value
    if kind == "string[]":
        return list(value)
    if kind in _FIXED:
        return np.array(value, dtype=np.float64)
    if kind in _ARRAYS:
        return np.array(value)
    allowed = ", ".join((*_PLAIN, *_FIXED, *_ARRAYS))
    raise ValueError(f"{shortened(attribute.GetPath())} must be one of {allowed}, got {kind}")


def additions(stage: Any, description: Record) -> list[str]:
    """Returns what a stage contains in addition to its description, each with the path of its prim.

    Lists rigid bodies, colliders, joints and other physics without a counterpart, unless they have the path and the
    name that an export gives an element; and a changed gravity.

    Args:
        stage: Stage with the description.
        description: Record of the description.
    """
    from pxr import Usd, UsdPhysics

    expected, time = _Expected(description), Usd.TimeCode.EarliestTime()
    found = []
    for prim in below(stage.GetPseudoRoot()):
        role, added = expected.role(prim), []
        if has(prim, "PhysicsRigidBodyAPI") and role != "body":
            enabled = is_on(UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr(), time)
            added += ["a rigid body"] if enabled else []
        if has(prim, "PhysicsCollisionAPI") and role != "collider":
            enabled = is_on(UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr(), time)
            added += ["a collider"] if enabled else []
        if role != "joint":
            added += reasons(prim)
        if prim.IsA(UsdPhysics.Scene):
            added += _gravity(stage, prim, description)
        found += [f"{path_of(prim)}: {what}, missing in the description" for what in added]
    return found


def _gravity(stage: Any, prim: Any, description: Record) -> list[str]:
    """Returns the gravity of a physics scene as text if it is neither the exported nor the described one."""
    written = prim.GetCustomDataByKey("warpcontact:gravity")
    expected = np.array(description["values"].get("gravity") if written is None else written, dtype=np.float64)
    gravity = read_gravity(stage, prim)
    if expected.shape == (3,) and np.linalg.norm(gravity - expected) <= _SINGLE * np.linalg.norm(expected):
        return []
    return [f"a gravity of {np.round(gravity, 6).tolist()} m/s²"]


class _Expected:
    """Paths at which an export places the elements of a description; the description is their sibling."""

    def __init__(self, description: Record) -> None:
        self.world = description["path"].rpartition("/")[0]
        folder = description["children"].get("Elements")
        elements = {} if folder is None else folder["children"]
        kinds = {prim: str(one["values"].get("kind")) for prim, one in elements.items()}
        self.bodies = {prim for prim, kind in kinds.items() if kind == "body"}
        # Carrier of each surface and shape; "Surfaces" for the world. With target "[]" it is derived elsewhere.
        self.carriers = {
            prim: one["targets"].get("body", ["Surfaces"])[0].rpartition("/")[2]
            for prim, one in elements.items()
            if kinds[prim] in ("surface", "shape") and one["targets"].get("body") != []
        }
        self.names = {prim: str(one["values"].get("name")) for prim, one in elements.items()}

    def role(self, prim: Any) -> str | None:
        """Returns whether a prim is a body, collider or joint of the description; ``None`` if neither."""
        path = str(prim.GetPath())
        if not path.startswith(f"{self.world}/"):
            return None
        parts = path.removeprefix(f"{self.world}/").split("/")
        if _ENVIRONMENT.fullmatch(parts[0]):
            parts = parts[1:]
        elif parts[0] != "Surfaces":
            return None
        if len(parts) == 3 and _ITEM.fullmatch(parts[2]):  # one sphere of a set
            prim, parts = prim.GetParent(), parts[:2]
        if not parts or not self._named(parts[-1], prim.GetCustomDataByKey("warpcontact:name")):
            return None
        match parts:
            case [name] if name in self.bodies:
                return "body"
            case ["joints", name] if name in self.bodies:
                return "joint"
            case [carrier, name] if carrier in self.bodies | {"Surfaces", "FixedPoints"}:
                return "collider" if self.carriers.get(name, carrier) == carrier else None
        return None

    def _named(self, prim: str, element_name: Any) -> bool:
        """Returns whether a prim name is that of the element whose name is stored on the prim."""
        from pxr import Tf

        if prim in self.names:
            return self.names[prim] == element_name
        # The contact points of contact couplings are not listed in the description.
        return (
            isinstance(element_name, str)
            and element_name not in self.names.values()
            and Tf.MakeValidIdentifier(element_name) == prim
        )


def answer(task: dict[str, Any]) -> tuple[dict[str, Any], list[Any]]:
    """Returns the answer of the reader process; ``task`` holds the arguments of ``read_stage``."""
    try:
        return pack(read_stage(**task, confined=True))
    except Unreadable as error:
        return {"error": str(error)}, []


def read_stage(file: str, most_faces: int, *, confined: bool) -> dict[str, Any]:
    """Returns ``description``, the records of an exported scene, or ``physics``, the result of ``read_physics``.

    A description is accompanied by ``additions``, what the stage contains in addition to it, and ``stepping``.

    Args:
        file: Path of the file.
        most_faces: Largest number of triangles per mesh.
        confined: Whether all layers of the stage must lie in or below the folder of the file.

    Raises:
        Unreadable: If the file is damaged, or refers to files that are not allowed.
    """
    from pxr import Tf, Usd

    path = Path(file).resolve()
    check_layers(path, confined=confined)
    try:
        stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
        records = read_records(stage)
        if records is not None:
            return {
                "description": records,
                "additions": additions(stage, records),
                "stepping": stepping_of(stage),
            }
        physics = read_physics(stage, most_faces)
        if (warning := earlier_description(stage)) is not None:
            physics["findings"]["remarks"].append(warning)
        return {"physics": physics}
    except Tf.ErrorException as error:
        raise Unreadable(f"not valid USD: {reason(error)}") from error
    except Unreadable:
        raise
    except ValueError as error:
        raise Unreadable(str(error)) from error


def pack(value: Any) -> tuple[dict[str, Any], list[Any]]:
    """Returns the header and the flat arrays of a value of dictionaries, lists, arrays and plain values."""
    arrays: list[Any] = []
    described: list[Any] = []

    def packed(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: packed(one) for key, one in value.items()}
        if isinstance(value, list):
            return [packed(one) for one in value]
        if isinstance(value, np.ndarray):
            kind = {"f": "<f8", "i": "<i8", "b": "|b1"}[value.dtype.kind]
            if value.size:
                arrays.append(np.ascontiguousarray(value, dtype=kind).reshape(-1).view(np.uint8))
            described.append([kind, *value.shape])
            return {ARRAY: len(described) - 1}
        return value

    tree = packed(value)
    return {"tree": tree, "arrays": described}, arrays
