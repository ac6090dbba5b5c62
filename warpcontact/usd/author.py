"""How values and names are written: NumPy arrays to USD types, element names to prim names."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

# What NumPy holds → what the types of Sdf and Vt are called, for numbers, and the suffix of their vectors.
_NUMBERS = {
    "float32": ("Float", "f"),
    "float64": ("Double", "d"),
    "int32": ("Int", None),
    "int64": ("Int64", None),
    "bool": ("Bool", None),
}


def identifiers(names: Iterable[str], reserved: Iterable[str] = ()) -> dict[str, str]:
    """Returns a prim name for each of ``names``, no two alike and none of them in ``reserved``.

    A name that is valid in USD stays as it is; ``-`` becomes ``_``, and a number tells apart what would
    otherwise fall together.
    """
    from pxr import Tf

    taken = set(reserved)
    table: dict[str, str] = {}
    # The last number that was given to what falls together.
    last: dict[str, int] = {}
    # Valid names first, so that they keep theirs whatever the order.
    for name in sorted(names, key=lambda name: not Tf.IsValidIdentifier(name)):
        identifier = base = Tf.MakeValidIdentifier(name)
        number = last.get(base, 0)
        while identifier in taken:
            number += 1
            identifier = f"{base}_{number}"
        last[base] = number
        taken.add(identifier)
        table[name] = identifier
    return table


def store_element_name(prim: Any, name: str) -> None:
    """Keeps the name that an element has in the scene on its prim."""
    prim.SetCustomDataByKey("warpcontact:name", name)
    if prim.GetName() != name:
        prim.SetDisplayName(name)


def attribute_name(quantity: str) -> str:
    """Returns the name of the attribute for a sensor: ``normal_force`` → ``warpcontact:normalForce``."""
    from pxr import Tf

    parts = []
    for part in quantity.split("."):
        identifier = Tf.MakeValidIdentifier(part)
        first, *others = identifier.split("_")
        word = first + "".join(other.capitalize() for other in others)
        # Without its underscores nothing, or a number, may be left.
        parts.append(word if Tf.IsValidIdentifier(word) else identifier)
    return ":".join(["warpcontact", *parts])


def attribute_type(dtype: np.dtype[Any], kind: str, is_array: bool, role: str = "Vector3") -> Any:
    """Returns the Sdf type of a quantity.

    Args:
        dtype: Type of its numbers; floating-point numbers keep their precision.
        kind: ``"number"``, ``"vector"`` or ``"quaternion"``.
        is_array: Whether there is one value per item of a set.
        role: ``"Vector3"``, ``"Point3"`` or ``"Normal3"``, what a vector stands for.
    """
    from pxr import Sdf

    number, suffix = _NUMBERS[dtype.name]
    name = {"number": number, "vector": f"{role}{suffix}", "quaternion": f"Quat{suffix}"}[kind]
    return getattr(Sdf.ValueTypeNames, f"{name}Array" if is_array else name)


def series(values: NDArray[Any], kind: str, is_array: bool) -> list[Any]:
    """Returns one USD value per entry of the first axis of ``values``; see ``attribute_type``."""
    from pxr import Vt

    number, suffix = _NUMBERS[values.dtype.name]
    if kind == "number" and not is_array:
        return list(values.tolist())
    name = {"number": number, "vector": f"Vec3{suffix}", "quaternion": f"Quat{suffix}"}[kind]
    array = getattr(Vt, f"{name}Array")
    if is_array:
        return [array.FromNumpy(np.ascontiguousarray(entry)) for entry in values]
    return list(array.FromNumpy(np.ascontiguousarray(values)))


def plain(values: NDArray[Any]) -> NDArray[Any]:
    """Returns ``values`` in a type that ``series`` takes, without loss."""
    if values.dtype.name in _NUMBERS:
        return values
    if values.dtype.kind == "f":
        return values.astype(np.float64)
    return values.astype(np.int32 if values.dtype.itemsize < 4 else np.int64)


class Samples:
    """Where values over time go, and what of them.

    Args:
        codes: Time codes of the records.
        layer: Receives a time sample for each record.
        defaults: Whether the first value is to be the default of an attribute as well: a program that does not
            look at time, as most importers of physics do not, then sees the start.
        declared: Receives what is written, without values.
    """

    def __init__(
        self, codes: Sequence[float], layer: Any = None, *, defaults: bool = True, declared: Any = None
    ) -> None:
        self.codes = codes
        self.layer = layer
        self.defaults = defaults
        self.declared = declared

    def write(self, attribute: Any, values: Sequence[Any]) -> None:
        """Writes one value per record of an attribute of the stage."""
        from pxr import Sdf

        path = attribute.GetPath()
        if self.defaults:
            attribute.Set(values[0])
        for layer in (self.declared, self.layer):
            if layer is not None and not layer.GetAttributeAtPath(path):
                Sdf.JustCreatePrimAttributeInLayer(
                    layer, path, attribute.GetTypeName(), isCustom=attribute.IsCustom()
                )
        if self.layer is not None:
            # The layer takes samples three times as fast as the stage, and faster where nobody is told of each.
            with Sdf.ChangeBlock():
                for code, value in zip(self.codes, values, strict=True):
                    self.layer.SetTimeSample(path, code, value)


def vectors(rows: NDArray[Any]) -> Any:
    """Returns ``rows`` (n, 3) as an array of single-precision vectors, what USD has points in."""
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(rows, dtype=np.float32))


def add_pose(xformable: Any, position: NDArray[Any], orientation: NDArray[Any]) -> None:
    """Adds operations ``translate`` (double3) and ``orient`` (quatd) with a pose to a prim.

    Args:
        xformable: The prim's ``UsdGeom.Xformable``.
        position: Origin in the frame of the parent [m].
        orientation: Rotation to the frame of the parent, quaternion (x, y, z, w).
    """
    turn, move = add_pose_operations(xformable)
    move.Set(series(position[None], "vector", False)[0])
    turn.Set(series(orientation[None], "quaternion", False)[0])


def add_pose_operations(xformable: Any) -> tuple[Any, Any]:
    """Adds the operations of a pose to a prim and returns their attributes ``orient`` and ``translate``.

    USD makes a matrix of a quaternion by the arc cosine of w: single precision would lose turns below 0.02
    degrees altogether, so ``orient`` is a quatd.
    """
    from pxr import UsdGeom

    move = xformable.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).GetAttr()
    return xformable.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).GetAttr(), move


def integers(values: NDArray[Any]) -> Any:
    """Returns whole numbers (n,) as an array of 32 bits."""
    from pxr import Vt

    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, dtype=np.int32))


def long_integers(values: NDArray[Any]) -> Any:
    """Returns whole numbers (n,) as an array of 64 bits, what USD has ids in."""
    from pxr import Vt

    return Vt.Int64Array.FromNumpy(np.ascontiguousarray(values, dtype=np.int64))


def quaternions(rows: NDArray[Any]) -> Any:
    """Returns quaternions (n, 4), x, y, z, w, in single precision: half of it is off by up to 0.04 degrees."""
    from pxr import Vt

    return Vt.QuatfArray.FromNumpy(np.ascontiguousarray(rows, dtype=np.float32))


def write_box(prim: Any, low: NDArray[Any], high: NDArray[Any]) -> None:
    """Says what space a model takes in its own frame at all times, for viewers that would rather not look [m]."""
    from pxr import UsdGeom

    UsdGeom.ModelAPI.Apply(prim).SetExtentsHint(vectors(np.array([low, high])))
