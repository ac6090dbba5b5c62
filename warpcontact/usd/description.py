"""Writes the whole scene as attributes ``warpcontact:*`` of a stage.

A simulation of the scene that ``importing.restore`` reads back is bitwise identical. Attributes are listed in ``docs/usd.md``. The description
duplicates what UsdGeom and UsdPhysics hold, because positions of UsdGeom are single precision and the schemas have no
force laws or springs.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from warpcontact._version import __version__
from warpcontact.kernels.catalogue.device_model import ROWS, Formula
from warpcontact.kernels.contact.contact_evaluation import ContactModel
from warpcontact.meshes import Mesh
from warpcontact.scene.contact_coupling import ContactRange
from warpcontact.scene.elements import ContactMaterial
from warpcontact.scene.scene_data import SceneData
from warpcontact.usd.author import identifiers
from warpcontact.usd.importing.stage import SCHEMA
from warpcontact.usd.serialize import ElementCall, ShapeParameters, element_calls, is_custom
from warpcontact.validation.checks import Array

#: Path of the description in exports.
ROOT = "/World/Description"


def write_description(stage: Any, scene: SceneData, names: Mapping[str, str], root: str = ROOT) -> None:
    """Writes the description of a scene.

    Args:
        stage: Stage; the description is written to its edit target.
        scene: Scene to describe.
        names: Prim name of each element of the scene.
        root: Path of the new prim of the description.

    Raises:
        ValueError: If two prim names, or two parameter names of a class, coincide in USD.
    """
    from pxr import Sdf

    with Sdf.ChangeBlock():
        _Description(stage.GetEditTarget().GetLayer(), scene, names, root).write()


class _Description:
    """Writes one description. Specs are created in the layer directly, without composing a stage."""

    def __init__(self, layer: Any, scene: SceneData, names: Mapping[str, str], root: str) -> None:
        self.layer = layer
        self.scene = scene
        self.root = root
        self.paths = {name: f"{root}/Elements/{names[name]}" for name in scene.element_names()}
        # Shared materials and meshes with their paths. Keeping the object prevents reuse of its id.
        self.shared_paths: dict[tuple[int, int], tuple[Any, str]] = {}
        self.counts = {"Materials": 0, "Meshes": 0}

    def write(self) -> None:
        """Writes the scene, its elements, and the materials and meshes that they share."""
        calls = element_calls(self.scene)
        self._prim(self.root)
        self._value(self.root, "schema", SCHEMA)
        self._value(self.root, "version", __version__)
        for name in ("gravity", "max_speed", "max_distance"):
            self._value(self.root, name, getattr(self.scene, name))
        for folder in ("Elements", "Materials", "Meshes"):
            self._prim(f"{self.root}/{folder}")
        self._targets(self.root, "elements", [self.paths[one.name] for one in calls])
        for one in calls:
            self._element(one)

    def _element(self, call: ElementCall) -> None:
        path = self.paths[call.name]
        self._prim(path)
        self._value(path, "kind", call.kind)
        self._value(path, "name", call.name)
        for name, value in call.arguments.items():
            self._argument(path, name, value, name in call.rows)

    def _argument(self, path: str, name: str, value: Any, rows: bool) -> None:
        """Writes one argument of an element, by its type."""
        match value:
            case ContactMaterial() | Mesh():
                self._targets(path, name, [self._shared_path(value)])
            case tuple() if isinstance(value[0], Mesh):
                # A relationship lists each target once, so a repeated mesh is written again as a copy.
                copy_index = [sum(mesh is other for other in value[:i]) for i, mesh in enumerate(value)]
                self._targets(
                    path, name, [self._shared_path(*each) for each in zip(value, copy_index, strict=True)]
                )
            case tuple() if isinstance(value[0], ContactMaterial):
                self._targets(path, name, [self._shared_path(one) for one in value])
            case tuple():
                self._targets(path, name, [self.paths[one.name] for one in value])
            case list() if isinstance(value[0], str):
                self._value(path, name, value)
            case list():  # one mask per mesh
                self._value(path, name, np.concatenate(value), rows=True)
            case ShapeParameters():
                self._formula(f"{path}/{name}", value.kind, value.sizes, each=True)
            case Formula():
                self._formula(f"{path}/{name}", type(value), _formula_values(value))
            case ContactRange():
                self._range(f"{path}/{name}", value)
            case _ if hasattr(value, "name"):
                self._targets(path, name, [self.paths[value.name]])
            case _:
                self._value(path, name, value, rows)

    def _shared_path(self, shared: Any, copy_index: int = 0) -> str:
        """Returns the path of a material or mesh, which is written at first use; ``copy_index`` selects a copy."""
        if (id(shared), copy_index) not in self.shared_paths:
            folder, word = ("Materials", "material") if isinstance(shared, ContactMaterial) else ("Meshes", "mesh")
            path = f"{self.root}/{folder}/{word}_{self.counts[folder]}"
            self.counts[folder] += 1
            self.shared_paths[id(shared), copy_index] = (shared, path)
            self._prim(path)
            if isinstance(shared, ContactMaterial):
                for part in ContactModel._fields:
                    formula = getattr(shared, part)
                    self._formula(f"{path}/{part}", type(formula), _formula_values(formula))
            else:
                self._mesh(path, shared)
        return self.shared_paths[id(shared), copy_index][1]

    def _mesh(self, path: str, mesh: Mesh) -> None:
        self._value(path, "name", mesh.name)
        self._value(path, "vertices", mesh.vertices, rows=True)
        self._value(path, "faces", mesh.faces, rows=True)
        if mesh.groups:
            members = list(mesh.groups.values())
            self._value(path, "group_names", list(mesh.groups))
            self._value(
                path,
                "group_sizes",
                np.array([len(faces) for faces in members], dtype=np.int32),
                rows=True,
            )
            self._value(path, "group_faces", np.concatenate(members), rows=True)

    def _formula(self, path: str, kind: type[Formula], values: Mapping[str, Any], each: bool = False) -> None:
        """Writes a law, friction model, spring, damper, motion or shape; ``each``: one entry per shape."""
        self._prim(path)
        self._value(path, "type", kind.__name__)
        if is_custom(kind):
            self._value(path, "own", True)
        names = identifiers(field.name for field in dataclasses.fields(kind))
        for name, value in values.items():
            limits = kind.limits(name)
            rows = each or ROWS in limits["shape"]
            note = f"{limits['meaning']} [{limits['unit']}]"
            self._value(path, names[name], np.asarray(value, dtype=np.float64), rows, note)

    def _range(self, path: str, given: ContactRange) -> None:
        self._prim(path)
        for name in ("k1", "k2", "effective_range"):
            self._value(path, name, getattr(given, name))
        if given.impact is not None:
            self._prim(f"{path}/impact")
            for name, value in dataclasses.asdict(given.impact).items():
                if value is not None:
                    self._value(f"{path}/impact", name, value)

    def _prim(self, path: str) -> None:
        from pxr import Sdf

        if self.layer.GetPrimAtPath(path):
            raise ValueError(f"the prim {path} exists already; element names must differ as USD names")
        spec = Sdf.CreatePrimInLayer(self.layer, path)
        spec.specifier, spec.typeName = Sdf.SpecifierDef, "Scope"

    def _targets(self, path: str, name: str, targets: list[str]) -> None:
        from pxr import Sdf

        spec = Sdf.RelationshipSpec(self.layer.GetPrimAtPath(path), f"warpcontact:{name}", True)
        spec.targetPathList.explicitItems = targets

    def _value(self, path: str, name: str, value: Any, rows: bool = False, note: str = "") -> None:
        from pxr import Sdf

        kind, written = _usd_value(value, rows)
        owner = self.layer.GetPrimAtPath(path)
        spec = Sdf.AttributeSpec(owner, f"warpcontact:{name}", kind, Sdf.VariabilityUniform, True)
        spec.default = written
        if note:
            spec.documentation = note


def _formula_values(formula: Formula) -> dict[str, Any]:
    values = {field.name: getattr(formula, field.name) for field in dataclasses.fields(formula)}
    return {name: value for name, value in values.items() if value is not None}


# USD type of one row of an array of doubles, by its shape.
_ROWS = {(): "Double", (2,): "Double2", (3,): "Double3", (4,): "Double4", (3, 3): "Matrix3d"}


def _usd_value(value: Any, rows: bool) -> tuple[Any, Any]:
    """Returns the USD type and the USD value; ``rows``: the first axis counts rows."""
    from pxr import Sdf, Vt

    types = Sdf.ValueTypeNames
    match value:
        case bool():
            return types.Bool, value
        case int():
            return types.Int64, value
        case float():
            return types.Double, value
        case str():
            return types.String, value
        case list():
            return types.StringArray, Vt.StringArray(value)
    array = np.asarray(value, order="C")
    if array.dtype == bool:
        return types.BoolArray, Vt.BoolArray.FromNumpy(array)
    if array.dtype.kind == "i":
        width = "" if array.ndim == 1 else str(array.shape[1])
        name, suffix = f"Int{width}", f"Vec{width}i" if width else "Int"
        return getattr(types, f"{name}Array"), getattr(Vt, f"{suffix}Array").FromNumpy(array.astype(np.int32))
    return _numbers(array.astype(np.float64), rows)


def _numbers(array: Array, rows: bool) -> tuple[Any, Any]:
    from pxr import Gf, Sdf, Vt

    shape = array.shape[1:] if rows else array.shape
    name = _ROWS[shape]
    vector_type = {"Double2": "Vec2d", "Double3": "Vec3d", "Double4": "Vec4d"}.get(name, name)
    if rows:
        return getattr(Sdf.ValueTypeNames, f"{name}Array"), getattr(Vt, f"{vector_type}Array").FromNumpy(array)
    plain = array.reshape(-1).tolist()
    return getattr(Sdf.ValueTypeNames, name), plain[0] if shape == () else getattr(Gf, vector_type)(*plain)
