"""Names, paths and values of prims: NumPy arrays as USD types, element names as prim names, layout of a stage."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.drawing.geometry import CENTRES, BodySet, Placement, ShapePlacement
from warpcontact.scene.elements import Body
from warpcontact.validation.checks import Array

# NumPy type → name of the scalar type in Sdf and Vt, and suffix of the vector types.
_NUMBERS = {
    "float32": ("Float", "f"),
    "float64": ("Double", "d"),
    "int32": ("Int", None),
    "int64": ("Int64", None),
    "bool": ("Bool", None),
}

WORLD = "/World"
#: Class prim that environments refer to.
PROTOTYPE = f"{WORLD}/Prototype"
#: Class prim with the surface meshes that differ between environments.
SHAPES = f"{WORLD}/Shapes"
ENSEMBLE = f"{WORLD}/Ensemble"
#: Names of children of an environment or body that elements must not take.
RESERVED = (
    "contacts",
    "couplings",
    "joints",
    "FixedPoints",
    "PhysicsMaterials",
    "PhysicsScene",
    "Surfaces",
    CENTRES,
)


def identifiers(names: Iterable[str], reserved: Iterable[str] = ()) -> dict[str, str]:
    """Returns a distinct prim name for each of ``names``; none of them is in ``reserved``.

    A name that is valid in USD is unchanged. In others, invalid characters such as ``-`` become ``_``. A number is
    appended to names that would coincide.
    """
    from pxr import Tf

    taken = set(reserved)
    table: dict[str, str] = {}
    # Last number appended to each base name.
    last: dict[str, int] = {}
    # Valid names first, so that they are unchanged in any order.
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
    """Stores the element's name of the scene on its prim."""
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
        # Without underscores, the word may be empty or begin with a digit.
        parts.append(word if Tf.IsValidIdentifier(word) else identifier)
    return ":".join(["warpcontact", *parts])


def attribute_type(dtype: np.dtype[Any], kind: str, is_array: bool, role: str = "Vector3") -> Any:
    """Returns the Sdf type of a quantity.

    Args:
        dtype: Type of its numbers. The precision of floating-point numbers is preserved.
        kind: ``"number"``, ``"vector"`` or ``"quaternion"``.
        is_array: Whether there is one value per item of a set.
        role: Role of a vector: ``"Vector3"``, ``"Point3"`` or ``"Normal3"``.
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
    """Returns ``values`` in a type accepted by ``series``, without loss."""
    if values.dtype.name in _NUMBERS:
        return values
    if values.dtype.kind == "f":
        return values.astype(np.float64)
    return values.astype(np.int32 if values.dtype.itemsize < 4 else np.int64)


class Samples:
    """Destination of values over time.

    Args:
        codes: Time codes of the records.
        layer: Layer for the time samples; ``None``: writes none.
        defaults: Whether to set the first value as the default of an attribute. Most physics importers ignore time
            samples and read the default.
        declared: Layer in which the attributes are declared without values, such as a clip manifest.
    """

    def __init__(
        self, codes: Sequence[float], layer: Any = None, *, defaults: bool = True, declared: Any = None
    ) -> None:
        self.codes = codes
        self.layer = layer
        self.defaults = defaults
        self.declared = declared

    def write(self, attribute: Any, values: Sequence[Any]) -> None:
        """Writes one value per record to an attribute of the stage."""
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
            # Writing to the layer is three times as fast as to the stage. The block suppresses notifications.
            with Sdf.ChangeBlock():
                for code, value in zip(self.codes, values, strict=True):
                    self.layer.SetTimeSample(path, code, value)


def vectors(rows: NDArray[Any]) -> Any:
    """Returns ``rows`` (n, 3) as an array of single-precision vectors, the type of points in USD."""
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(rows, dtype=np.float32))


def add_pose(xformable: Any, position: NDArray[Any], orientation: NDArray[Any]) -> None:
    """Adds operations ``translate`` (double3) and ``orient`` (quatd) with a pose to a prim.

    Args:
        xformable: The prim's ``UsdGeom.Xformable``.
        position: Origin in the frame of the parent [m].
        orientation: Rotation to the frame of the parent, quaternion (x, y, z, w).
    """
    orient, translate = add_pose_operations(xformable)
    translate.Set(series(position[None], "vector", False)[0])
    orient.Set(series(orientation[None], "quaternion", False)[0])


def add_pose_operations(xformable: Any) -> tuple[Any, Any]:
    """Adds the operations of a pose to a prim and returns their attributes ``orient`` and ``translate``.

    ``orient`` is a quatd: USD computes the rotation angle with the arc cosine of w, which in single precision loses
    rotations below 0.02 degrees.
    """
    from pxr import UsdGeom

    translate = xformable.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble).GetAttr()
    return xformable.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).GetAttr(), translate


def integers(values: NDArray[Any]) -> Any:
    """Returns integers (n,) as an array of 32 bits."""
    from pxr import Vt

    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, dtype=np.int32))


def long_integers(values: NDArray[Any]) -> Any:
    """Returns integers (n,) as an array of 64 bits, the type of ids in USD."""
    from pxr import Vt

    return Vt.Int64Array.FromNumpy(np.ascontiguousarray(values, dtype=np.int64))


def quaternions(rows: NDArray[Any]) -> Any:
    """Returns quaternions (n, 4), x, y, z, w, in single precision; half precision is off by up to 0.04 degrees."""
    from pxr import Vt

    return Vt.QuatfArray.FromNumpy(np.ascontiguousarray(rows, dtype=np.float32))


def write_box(prim: Any, low: NDArray[Any], high: NDArray[Any]) -> None:
    """Writes the bounding box of a model at all times, in its own frame [m], which saves viewers computing it."""
    from pxr import UsdGeom

    UsdGeom.ModelAPI.Apply(prim).SetExtentsHint(vectors(np.array([low, high])))


@dataclass(frozen=True)
class Layout:
    """Layout of a stage.

    Attributes:
        names: Prim names by element name.
        envs: Numbers of the environments.
        spacing: Grid spacing of environments along x and y [m]; 0: all in place.
        size: Size of the drawing, the length of the largest body [m].
        force_scale: Arrow length per force [m/N].
        peak_pressure: Largest pressure on the areas of body contacts [Pa].
        own_surfaces: Names of surfaces and shapes that have one prim per environment, because they differ.
    """

    names: dict[str, str]
    envs: list[int]
    spacing: Array
    size: float
    force_scale: float
    peak_pressure: float
    own_surfaces: frozenset[str]

    @property
    def apart(self) -> bool:
        """Whether environments are spread on a grid."""
        return bool(self.spacing.any())

    @property
    def surfaces(self) -> str:
        """Path of the surfaces fixed to the world and common to all environments."""
        return f"{PROTOTYPE if self.apart else WORLD}/Surfaces"

    def place(self, row: int) -> tuple[float, float, float]:
        """Returns the position of an environment on the grid [m]; the first is at the origin."""
        x, y = self.spacing.tolist()
        count = len(self.envs)
        columns = count if y == 0.0 else 1 if x == 0.0 else math.ceil(math.sqrt(count))
        return row % columns * x, row // columns * y, 0.0

    def env(self, row: int) -> str:
        """Returns the path of environment ``row`` of the export."""
        return f"{WORLD}/env_{self.envs[row]}"

    def body(self, env: str, body: Body | None) -> str:
        """Returns the path of a body, or, for ``None``, of the scope of points fixed to the world."""
        return f"{env}/{'FixedPoints' if body is None else self.names[body.name]}"

    def body_set(self, env: str, body_set: BodySet) -> str:
        """Returns the path of spheres or points on a set of bodies."""
        return f"{self.body(env, body_set.body)}/{self.names[body_set.name] if body_set.contacts else CENTRES}"

    def surface(self, env: str, placement: Placement) -> str:
        """Returns the path of a surface in an environment."""
        surface = placement.surface
        return f"{self._carrier(env, surface.body)}/{self.names[surface.name]}"

    def form(self, env: str, form: ShapePlacement) -> str:
        """Returns the path of a shape in an environment."""
        return f"{self._carrier(env, form.shape.body)}/{self.names[form.shape.name]}"

    def _carrier(self, env: str, body: Body | None) -> str:
        return f"{env}/Surfaces" if body is None else self.body(env, body)

    def contact(self, env: str, name: str) -> str:
        """Returns the path of a contact, a contact coupling or a particle contact."""
        return f"{env}/contacts/{self.names[name]}"

    def coupling(self, env: str, name: str) -> str:
        """Returns the path of a coupling."""
        return f"{env}/couplings/{self.names[name]}"

    def joint(self, env: str, body: Body) -> str:
        """Returns the path of the joint of a body."""
        return f"{env}/joints/{self.names[body.name]}"
