"""The description of a scene on a stage as plain records: values, targets and children of each of its prims."""

from typing import Any, TypedDict

import numpy as np

from warpcontact.usd.importing.errors import shortened

#: Schema of descriptions. It increases when a default of an argument changes, or a name.
SCHEMA = 2
_PREFIX = "warpcontact:"
# Types of attributes, as Sdf calls them: single values, rows of numbers, arrays.
_PLAIN = ("bool", "int64", "double", "string")
_FIXED = ("double2", "double3", "double4", "matrix3d")
_ARRAYS = ("bool[]", "int[]", "int2[]", "int3[]", "double[]", "double2[]", "double3[]", "double4[]", "matrix3d[]")
# A description has elements with a range with an impact.
_DEEPEST = 8


class Record(TypedDict):
    """A prim of a description.

    Attributes:
        path: Its path.
        values: Its attributes ``warpcontact:*`` without the prefix: bool, int, float, str, lists or arrays.
        targets: Its relationships likewise, as paths.
        children: The prims below by name.
    """

    path: str
    values: dict[str, Any]
    targets: dict[str, list[str]]
    children: dict[str, "Record"]


def read_records(stage: Any) -> Record | None:
    """Returns the description of a stage; ``None`` if it has none, or one of an earlier schema.

    Raises:
        ValueError: If there are several, or one has what descriptions do not have; the message names the prim.
    """
    roots = [prim for prim in _roots(stage) if not _is_earlier(prim)]
    if not roots:
        return None
    if len(roots) > 1:
        listed = ", ".join(shortened(prim.GetPath()) for prim in roots[:5])
        raise ValueError(f"a stage describes one scene, got descriptions at {listed}")
    return _record(roots[0], 0)


def earlier_description(stage: Any) -> str | None:
    """Returns a warning if a stage has a description of an earlier schema, which is not read; else ``None``."""
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
        raise ValueError(f"{shortened(path)} lies deeper than anything in a description")
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
