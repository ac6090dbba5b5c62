"""Reads the description of a scene on a stage as plain records: values, targets and children of each prim."""

from typing import Any, TypedDict

import numpy as np

from warpcontact.usd.importing.errors import shortened

#: Schema version of descriptions. It increases when a default value or a name changes.
SCHEMA = 2
_PREFIX = "warpcontact:"
# Allowed types of attributes, by their names in Sdf: single values, rows of numbers, arrays.
_PLAIN = ("bool", "int64", "double", "string")
_FIXED = ("double2", "double3", "double4", "matrix3d")
_ARRAYS = ("bool[]", "int[]", "int2[]", "int3[]", "double[]", "double2[]", "double3[]", "double4[]", "matrix3d[]")
# Largest nesting depth. Descriptions need element → range → impact.
_DEEPEST = 8


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
