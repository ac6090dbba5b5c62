"""Restores a scene from its description by adding each element again, with all checks of its arguments."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np

from warpcontact.forces.registry import element_kinds
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.contact.contact_evaluation import ContactModel
from warpcontact.kernels.couplings.springs import Damper, Spring
from warpcontact.kernels.friction import Friction
from warpcontact.kernels.joints import Motion
from warpcontact.kernels.laws import Law
from warpcontact.kernels.shapes.base import Shape as ShapeParameters
from warpcontact.meshes import Mesh, SurfaceSamples
from warpcontact.scene.contact_coupling import ContactRange, ExpectedImpact
from warpcontact.scene.elements import ContactMaterial
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.scene_element import SceneElement
from warpcontact.usd.author import identifiers
from warpcontact.usd.importing.findings import UsdError, shortened
from warpcontact.usd.importing.stage import SCHEMA, Record
from warpcontact.usd.serialize import ADDERS, FORCE_ELEMENT, Catalogue, argument_names, required_names

_FORMULAS: dict[str, type[Formula]] = {
    "motion": Motion,
    "spring": Spring,
    "damper": Damper,
    "friction": Friction,
    "form": ShapeParameters,
}
# Arguments that refer to an element of the scene; ``body`` has no target if it is the world.
_ELEMENTS = ("body", "points", "surface", "surface_a", "surface_b", "point_a", "point_b", "shape", "other_shape")
# Arguments that refer to a list of elements.
_LISTS = ("shapes", "first", "second")
_ALWAYS_GIVEN = {"point": ("body",), "points": ("body",), "shape": ("body",)}


def restore_scene(
    records: Record,
    custom_types: Iterable[type[Formula] | type[SceneElement]] = (),
    subject: str = "the description of the scene",
) -> SceneData:
    """Returns the scene of a description.

    Args:
        records: Record of the description.
        custom_types: Custom classes that the description may name.
        subject: Name of the description in messages.

    Raises:
        UsdError: If the scene cannot be restored; the message names the prims.
    """
    return _Restoration(records, Catalogue(custom_types), subject).scene()


class _Restoration:
    def __init__(self, root: Record, catalogue: Catalogue, subject: str) -> None:
        self.root = root
        self.subject = subject
        self.catalogue = catalogue
        self.problems: list[str] = []
        self.objects: dict[str, Any] = {}  # elements, materials and meshes by path

    def scene(self) -> SceneData:
        values = self.root["values"]
        if not isinstance(values["schema"], int) or values["schema"] != SCHEMA:
            version = shortened(values.get("version", "an unknown version"))
            raise self._error([f"{self.root['path']} was written by warpcontact {version}, which is newer"])
        given = {name: values[name] for name in ("gravity", "max_speed", "max_distance") if name in values}
        scene = self._collect_errors(self.root, lambda: SceneData(**given))
        for folder, make in (("Materials", self._contact_material), ("Meshes", self._mesh)):
            for record in self._folder(folder).values():
                self.objects[record["path"]] = self._collect_errors(record, partial(make, record))
        elements = {record["path"]: record for record in self._folder("Elements").values()}
        order = self.root["targets"].get("elements", [])
        if sorted(order) != sorted(elements):
            odd = sorted(set(order) ^ set(elements)) or order
            self.problems.append(
                f"{self.root['path']}.elements must be all its elements once: {shortened(odd[0])}"
            )
        if self.problems:
            raise self._error(self.problems)
        for path in order:
            record = elements[path]
            # Stop at the first error, because later elements may need the missing one.
            self.objects[path] = self._collect_errors(record, partial(self._element, scene, record))
            if self.problems:
                raise self._error(self.problems)
        return scene

    def _error(self, problems: list[str]) -> UsdError:
        return UsdError(self.subject, problems)

    def _collect_errors(self, record: Record, make: Callable[[], Any]) -> Any:
        try:
            return make()
        except (ValueError, TypeError, LookupError, OverflowError) as error:
            self.problems.append(f"{shortened(record['path'])}: {_error_text(error)}")
            return None

    def _folder(self, name: str) -> dict[str, Record]:
        folder = self.root["children"].get(name)
        return {} if folder is None else folder["children"]

    def _element(self, scene: SceneData, record: Record) -> Any:
        kind, name = record["values"].get("kind"), record["values"].get("name")
        if kind == FORCE_ELEMENT:
            return self._force_element(scene, record)
        if kind not in ADDERS:
            raise ValueError(f"kind must be one of {', '.join(ADDERS)}, got {kind!r}")
        allowed = argument_names(kind)
        given: dict[str, Any] = {"name": name}
        for key in _ALWAYS_GIVEN.get(kind, ()):
            given[key] = None
        readers: tuple[tuple[Mapping[str, Any], Callable[[str, Any], Any]], ...] = (
            ({key: value for key, value in record["values"].items() if key not in ("kind", "name")}, self._plain),
            (record["targets"], self._named),
            (record["children"], self._made_of),
        )
        for values, read in readers:
            for key, value in values.items():
                if key not in allowed:
                    available = ", ".join(allowed)
                    raise ValueError(f"{key[:80]!r} is not an argument of {ADDERS[kind]}; there are: {available}")
                given[key] = read(key, value)
        if missing := [key for key in required_names(kind) if key not in given]:
            raise ValueError(f"{missing[0]} is missing")
        if kind == "surface":
            _split_mask(given)
        if kind == "points" and "normals" in given:
            given["positions"] = _samples(given)
        if "exclude" in given:
            elements = given["shapes"] if kind == "particle_contact" else [*given["first"], *given["second"]]
            given["exclude"] = _pairs(given["exclude"], list(dict.fromkeys(elements)))
        if kind == "body_contact":
            _join_table(given)
        return getattr(scene, ADDERS[kind])(**given)

    def _force_element(self, scene: SceneData, record: Record) -> Any:
        """Adds an element of a registered family of force elements."""
        values = {key: value for key, value in record["values"].items() if key != "kind"}
        given, kinds = values.pop("type", None), {**element_kinds(), **self.catalogue.force_elements}
        if given not in kinds:
            raise ValueError(
                f"type must be a registered force element ({', '.join(kinds) or 'there is none'}), got "
                f"{shortened(given)}; import the module that registers it, or pass the class: custom_types=[…]"
            )
        targets = {key: self._named(key, paths) for key, paths in record["targets"].items()}
        return scene.add_force_element(kinds[given], **values, **targets)

    def _plain(self, key: str, value: Any) -> Any:
        if key in (*_ELEMENTS, *_LISTS, *_FORMULAS, "material", "mesh", "range"):
            raise ValueError(f"{key} must be a prim, got an attribute")
        return value

    def _named(self, key: str, paths: list[str]) -> Any:
        for path in paths:
            if self.objects.get(path) is None:
                raise ValueError(f"{key} must be earlier prims of the description, got {shortened(path)}")
        found = [self.objects[path] for path in paths]
        if key in _LISTS or (key in ("mesh", "material") and len(found) > 1):
            return found
        if len(found) != 1:
            raise ValueError(f"{key} must have one target, got {len(found)}")
        return found[0]

    def _made_of(self, key: str, record: Record) -> Any:
        if key in _FORMULAS:
            return self._formula(_FORMULAS[key], record, each=key == "form")
        if key == "range":
            return self._range(record)
        raise ValueError(f"{key} must not be a prim")

    def _contact_material(self, record: Record) -> ContactMaterial:
        missing = [part for part in ContactModel._fields if part not in record["children"]]
        if missing:
            raise ValueError(f"the material must have a {missing[0]}, which is missing")
        parts = {
            part: self._formula(Law if part == "law" else Friction, record["children"][part])
            for part in ContactModel._fields
        }
        return ContactMaterial(**parts)

    def _mesh(self, record: Record) -> Mesh:
        values = record["values"]
        names, sizes = values.get("group_names", []), values.get("group_sizes", [])
        members = values.get("group_faces", np.empty(0, dtype=np.int64))
        if len(names) != len(sizes) or np.min(sizes, initial=0) < 0 or np.sum(sizes) != len(members):
            raise ValueError("group_names, group_sizes and group_faces must have consistent lengths")
        ends = np.cumsum([0, *sizes]).astype(np.int64)
        groups = {name: members[ends[i] : ends[i + 1]] for i, name in enumerate(names)}
        vertices, faces = (values.get(key, np.empty((0, 3))) for key in ("vertices", "faces"))
        return Mesh(vertices, faces, name=values.get("name", "mesh"), groups=groups)

    def _formula(self, base: type[Formula], record: Record, each: bool = False) -> Any:
        """Returns an instance of a class; with ``each``, one per row of the parameters, or one if all are equal."""
        values = dict(record["values"])
        name, custom_types = values.pop("type", None), values.pop("own", False)
        if not isinstance(name, str):
            raise ValueError(f"{record['path']}: type must be the name of a class, got {name!r}")
        kind = self.catalogue.find(base, name, bool(custom_types))
        fields = {prim: field for field, prim in identifiers(f.name for f in dataclasses.fields(kind)).items()}
        for key in values:
            if key not in fields:
                raise ValueError(f"{name} has no parameter {key[:80]!r}; there are: {', '.join(fields) or 'none'}")
        named = {fields[key]: value for key, value in values.items()}
        if not each:
            return kind(**{key: _tuple(value) for key, value in named.items()})
        counts = {np.shape(value)[:1] for value in named.values()}
        if not counts:
            return kind()
        if len(counts) > 1 or counts == {()}:
            raise ValueError(f"parameters of {name} must have one entry for each shape, got {sorted(counts)}")
        rows = [{key: _tuple(value[i]) for key, value in named.items()} for i in range(counts.pop()[0])]
        if not rows:
            raise ValueError(f"parameters of {name} must have one entry for each shape, got none")
        forms = [kind(**rows[0])] if all(row == rows[0] for row in rows) else [kind(**row) for row in rows]
        return forms[0] if len(forms) == 1 else forms

    def _range(self, record: Record) -> ContactRange:
        impact = record["children"].get("impact")
        expected = None
        if impact is not None:
            expected = ExpectedImpact(**{"other_mass": None, **impact["values"]})
        return ContactRange(**record["values"], impact=expected)


def _error_text(error: Exception) -> str:
    return str(error.args[0]) if isinstance(error, LookupError) and error.args else str(error)


def _tuple(value: Any) -> Any:
    """Returns arrays as nested tuples, which are hashable and comparable."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    return tuple(_tuple(one) for one in value) if isinstance(value, list) else value


def _split_mask(given: dict[str, Any]) -> None:
    """Splits a mask over the faces of several meshes into one mask per mesh."""
    meshes, mask = given.get("mesh"), given.get("active_faces")
    if isinstance(meshes, list) and mask is not None:
        counts = [len(mesh.faces) for mesh in meshes]
        if np.shape(mask) != (sum(counts),):
            raise ValueError(f"active_faces must be a mask of {sum(counts)} faces, got {np.shape(mask)}")
        given["active_faces"] = np.split(mask, np.cumsum(counts)[:-1])


def _join_table(given: dict[str, Any]) -> None:
    """Joins the values of a table of contact materials of a body contact to its argument ``material``."""
    names, numbers = given.pop("pair_names", None), given.pop("pair_materials", None)
    materials = given.get("material")
    if names is None and numbers is None:
        if isinstance(materials, list):
            raise ValueError(
                f"material must have one target, got {len(materials)}, because there are no pair_names"
            )
        return
    count = 0 if names is None else len(names) // 2
    index = np.asarray([] if numbers is None else numbers)
    every = materials if isinstance(materials, list) else [materials]
    if not count or len(names) != 2 * count or index.shape != (count,) or index.dtype.kind != "i":
        raise ValueError("pair_names must have two names for each entry of pair_materials")
    if index.min() < -1 or index.max() >= len(every):
        raise ValueError(f"pair_materials must be indices from -1 to {len(every) - 1}, got {shortened(index)}")
    keys = [None if pair == ("", "") else pair for pair in zip(names[::2], names[1::2], strict=True)]
    if len(set(keys)) < len(keys):
        raise ValueError("pair_names must be different pairs")
    given["material"] = {key: None if i < 0 else every[i] for key, i in zip(keys, index.tolist(), strict=True)}


def _pairs(numbers: Any, shapes: list[Any]) -> list[tuple[Any, Any]]:
    """Returns the excluded pairs of shapes from their index pairs."""
    pairs = np.asarray(numbers)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or pairs.dtype.kind != "i":
        raise ValueError(f"exclude must be pairs of shape indices, got {shortened(numbers)}")
    if pairs.size and not 0 <= pairs.min() <= pairs.max() < len(shapes):
        raise ValueError(f"exclude must be shape indices from 0 to {len(shapes) - 1}, got {pairs.max()}")
    return [(shapes[i], shapes[j]) for i, j in pairs.tolist()]


def _samples(given: dict[str, Any]) -> SurfaceSamples:
    """Returns points with normals as surface samples."""
    positions, areas, normals = (np.asarray(given.pop(key, None)) for key in ("positions", "areas", "normals"))
    shape = positions.shape
    if normals.shape != shape or areas.shape != shape[:1] or normals.dtype.kind != "f":
        raise ValueError(
            f"normals and areas must be those of {shape} positions, got {normals.shape}, {areas.shape}"
        )
    if not (np.abs(np.linalg.norm(normals, axis=-1) - 1.0) <= 1.0e-6).all():  # rejects NaN as well
        raise ValueError("normals must have unit length")
    return SurfaceSamples(positions, areas, normals, np.zeros(len(positions), dtype=np.int64))
