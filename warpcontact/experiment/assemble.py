"""Builds a scene from the valid parts of an experiment; elements that cannot be added are reported by key.

``check_build`` builds a model of one environment, to validate what only a build can check.
"""

import itertools
import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from warpcontact import meshes
from warpcontact.building.plan import plan_model
from warpcontact.building.scene import Scene
from warpcontact.experiment.catalogue import DeviceModelSettings, FileMesh, Section, ShapeMesh, user_class
from warpcontact.experiment.errors import Problems
from warpcontact.experiment.force_elements import ForceElementSettings
from warpcontact.experiment.parser import ExperimentParts
from warpcontact.experiment.quantities import read_rows
from warpcontact.experiment.schema import (
    DEVICE_MODEL_SECTIONS,
    ROW_KEYS,
    BodiesSettings,
    BodyContactSettings,
    BodySettings,
    ContactCouplingSettings,
    ContactSettings,
    CouplingOptions,
    MaterialSettings,
    PairMaterialSettings,
    ParticleContactSettings,
    PointSettings,
    PointsSettings,
    ShapeContactSettings,
    ShapeSettings,
    SurfaceContactSettings,
    SurfaceSettings,
)
from warpcontact.experiment.user_code import describe_error
from warpcontact.geometry.query_mesh import QueryMeshCache
from warpcontact.kernels import laws, shapes
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.couplings import springs
from warpcontact.kernels.joints import Motion
from warpcontact.meshes import Mesh, MeshError
from warpcontact.model.environments import Environments
from warpcontact.scene.elements import ContactMaterial
from warpcontact.scene.surface_contact import sample_points

# Kinds of references, with the sections that can contain the target.
_BODY = ("body", ("body", "bodies"))
_POINTS = ("point", ("point", "points"))
_SURFACE = ("surface", ("surface",))
_SHAPE = ("shape", ("shape",))
_SOLID = ("surface, shape or body", ("surface", "shape", "body"))
_MATERIAL = ("material", ("material",))

_ON_POINTS: dict[str, tuple[str, tuple[str, ...]]] = {"point_a": _POINTS, "point_b": _POINTS}
# Keys of each section whose value is a reference or a list of references.
_REFERENCES: dict[str, dict[str, tuple[str, tuple[str, ...]]]] = {
    "surface": {"body": _BODY},
    "point": {"body": _BODY, "surface": _SURFACE},
    "points": {"body": _BODY, "surface": _SURFACE},
    "contact": {"points": _POINTS, "surface": _SURFACE, "material": _MATERIAL},
    "surface_contact": {"surface_a": _SURFACE, "surface_b": _SURFACE, "material": _MATERIAL},
    "spring_damper": _ON_POINTS,
    "bushing": _ON_POINTS,
    "catenary": _ON_POINTS,
    "contact_coupling": {"surface_a": _SURFACE, "surface_b": _SURFACE},
    "shape": {"body": _BODY},
    "shape_contact": {"shape": _SHAPE, "other_shape": _SHAPE, "material": _MATERIAL},
    "particle_contact": {"shapes": _SHAPE, "exclude": _SHAPE, "material": _MATERIAL},
    "body_contact": {"first": _SOLID, "second": _SOLID, "material": _MATERIAL},
}


@dataclass
class FileCache:
    """Meshes of an experiment, cached so that each is read once.

    Attributes:
        meshes: Meshes by the key of their surface and their settings.
        query_meshes: Query meshes from the last validation, until a model is planned.
    """

    meshes: dict[tuple[str, FileMesh | ShapeMesh], Mesh] = field(default_factory=dict)
    query_meshes: QueryMeshCache = field(default_factory=dict)

    def take_query_meshes(self) -> QueryMeshCache:
        """Returns the query meshes and clears them."""
        query_meshes, self.query_meshes = self.query_meshes, {}
        return query_meshes


class _Unresolved(Exception):
    """A reference to an entry that does not exist or has problems, which are already reported."""


class SceneBuilder:
    """Builds scenes of an experiment.

    Args:
        parts: The valid parts of the experiment.
        folder: Folder to which the names of mesh files are relative.
        file_cache: Meshes that were read before; new ones are added.
    """

    def __init__(self, parts: ExperimentParts, folder: Path, file_cache: FileCache) -> None:
        self.parts = parts
        self.folder = folder
        self.file_cache = file_cache
        self.elements: dict[str, dict[str, Any]] = {}

    def scene(self, problems: Problems) -> Scene:
        """Returns a scene of all parts that can be added; ``problems`` receives the others."""
        settings = self.parts.settings
        scene = Scene() if settings is None else Scene(settings.gravity, **settings.quarantine.limits)
        self.elements = {section: {} for section in self.parts.entries}
        add: dict[str, Callable[..., Any]] = {
            "body": lambda path, entry: self._body(scene, entry),
            "bodies": lambda path, entry: self._bodies(scene, path, entry, problems),
            "surface": lambda path, entry: self._surface(scene, path, entry, problems),
            "point": lambda path, entry: self._points(scene, path, entry, problems),
            "points": lambda path, entry: self._points(scene, path, entry, problems),
            "material": lambda path, entry: self._material(entry),
            "contact": lambda path, entry: self._contact(scene, path, entry, problems),
            "surface_contact": lambda path, entry: self._surface_contact(scene, path, entry, problems),
            "spring_damper": lambda path, entry: self._coupling(scene.add_spring_damper, path, entry, problems),
            "bushing": lambda path, entry: self._coupling(scene.add_bushing, path, entry, problems),
            "catenary": lambda path, entry: self._coupling(scene.add_catenary, path, entry, problems),
            "contact_coupling": lambda path, entry: self._contact_coupling(scene, path, entry, problems),
            "shape": lambda path, entry: self._shape(scene, path, entry, problems),
            "shape_contact": lambda path, entry: self._shape_contact(scene, path, entry, problems),
            "particle_contact": lambda path, entry: self._particle_contact(scene, path, entry, problems),
            "body_contact": lambda path, entry: self._body_contact(scene, path, entry, problems),
            "force_element": lambda path, entry: self._force_element(scene, path, entry, problems),
        }
        for section, path, entry in self.parts:
            try:
                self.elements[section][entry.name] = add[section](path, entry)
            except _Unresolved:
                pass
            except ValueError as error:
                problems.add(path, _as_continuation(str(error), entry.name))
        for section, references in _REFERENCES.items():
            for i, raw in self.parts.damaged[section].items():
                for key, kind in references.items():
                    self._check_references(f"{section}[{i}].{key}", raw.get(key), kind, problems)
        return scene

    def _check_references(
        self, path: str, value: Any, kind: tuple[str, tuple[str, ...]], problems: Problems
    ) -> None:
        """Reports unknown references of an invalid entry; values of another type are reported elsewhere."""
        if isinstance(value, list | tuple):
            for i, one in enumerate(value):
                self._check_references(f"{path}[{i}]", one, kind, problems)
        elif isinstance(value, str):
            self._check_reference(path, value, kind, problems)

    def _body(self, scene: Scene, entry: BodySettings) -> Any:
        motion = entry.motion.make() if isinstance(entry.motion, DeviceModelSettings) else None
        return scene.add_body(**entry.model_dump(exclude={"motion"}), motion=motion)

    def _bodies(self, scene: Scene, path: str, entry: BodiesSettings, problems: Problems) -> Any:
        motion = entry.motion.make() if isinstance(entry.motion, DeviceModelSettings) else None
        rows = self._rows("bodies", path, entry, problems)
        return scene.add_bodies(**rows, motion=motion, name=entry.name, color=entry.color)

    def _rows(self, section: str, path: str, entry: Section, problems: Problems) -> dict[str, Any]:
        """Returns the values of a set by key, read from files if they are file names."""
        found, missing = {}, False
        for key in ROW_KEYS[section]:
            found[key] = getattr(entry, key)
            if isinstance(found[key], str):
                try:
                    found[key] = read_rows(self.folder / found[key])
                except ValueError as error:
                    problems.add(f"{path}.{key}", f": {error}")
                    missing = True
        if missing:
            raise _Unresolved
        return found

    def _surface(self, scene: Scene, path: str, entry: SurfaceSettings, problems: Problems) -> Any:
        # Load all meshes first, so that the problems of each are reported.
        meshes = [self._mesh(path, key, mesh, entry.name, problems) for key, mesh in entry.meshes.items()]
        body = self._find(f"{path}.body", entry.body, _BODY, problems)
        if None in meshes:
            raise _Unresolved
        options = entry.model_dump(exclude={"mesh", "body"})
        if not isinstance(entry.mesh, tuple):
            return scene.add_surface(meshes[0], body, **options)
        if entry.active_faces is not None:
            # In TOML, ``true`` stands for None: all faces of a mesh.
            options["active_faces"] = [None if chosen is True else chosen for chosen in entry.active_faces]
        return scene.add_surface(meshes, body, **options)

    def _mesh(self, path: str, key: str, mesh: FileMesh | ShapeMesh, name: str, problems: Problems) -> Mesh | None:
        if (path, mesh) in self.file_cache.meshes:
            return self.file_cache.meshes[path, mesh]
        try:
            if isinstance(mesh, FileMesh):
                options = mesh.model_dump(exclude={"file"})
                self.file_cache.meshes[path, mesh] = meshes.load_mesh(
                    self.folder / mesh.file, name=name, **options
                )
            else:
                self.file_cache.meshes[path, mesh] = mesh.make(name)
        except MeshError as error:
            problems.add(f"{path}.{key}{'.file' if isinstance(mesh, FileMesh) else ''}", f": {error}")
        except ValueError as error:
            problems.add(f"{path}.{key}", f".{error}")
        return self.file_cache.meshes.get((path, mesh))

    def _points(self, scene: Scene, path: str, entry: PointSettings | PointsSettings, problems: Problems) -> Any:
        key, kind = ("body", _BODY) if entry.surface is None else ("surface", _SURFACE)
        carrier = self._find(f"{path}.{key}", getattr(entry, key), kind, problems)
        if isinstance(entry, PointSettings):
            return scene.add_point(carrier, entry.position, name=entry.name)
        if entry.positions is not None:
            rows = self._rows("points", path, entry, problems)
            return scene.add_points(carrier, **rows, areas=entry.areas, name=entry.name)
        samples = sample_points(carrier, entry.samples, entry.seed or 0, f"{entry.name}.samples")
        return scene.add_points(carrier, samples, name=entry.name)

    def _material(self, entry: MaterialSettings) -> ContactMaterial:
        if entry.name in self.elements["material"]:
            raise ValueError(f"name {entry.name!r} is already used by another material")
        return ContactMaterial(
            **{key: table.make() for key, table in entry if isinstance(table, DeviceModelSettings)}
        )

    def _contact(self, scene: Scene, path: str, entry: ContactSettings, problems: Problems) -> Any:
        references = _REFERENCES["contact"]
        targets = self._find_all(path, entry, references, problems)
        options = entry.model_dump(exclude={*references}, exclude_none=True)
        return scene.add_contact(*targets, **(options | self._rows("contact", path, entry, problems)))

    def _surface_contact(self, scene: Scene, path: str, entry: SurfaceContactSettings, problems: Problems) -> Any:
        references = _REFERENCES["surface_contact"]
        targets = self._find_all(path, entry, references, problems)
        return scene.add_surface_contact(*targets, **entry.model_dump(exclude=set(references), exclude_none=True))

    def _coupling(self, add: Callable[..., Any], path: str, entry: CouplingOptions, problems: Problems) -> Any:
        references = _ON_POINTS
        targets = self._find_all(path, entry, references, problems)
        formulas = {key: table.make() for key, table in entry if isinstance(table, DeviceModelSettings)}
        options = entry.model_dump(exclude={*references, *formulas}, exclude_none=True)
        return add(*targets, **options, **formulas)

    def _contact_coupling(
        self, scene: Scene, path: str, entry: ContactCouplingSettings, problems: Problems
    ) -> Any:
        references = _REFERENCES["contact_coupling"]
        targets = self._find_all(path, entry, references, problems)
        friction = entry.friction.make() if isinstance(entry.friction, DeviceModelSettings) else None
        options = entry.model_dump(exclude={*references, "range", "friction"})
        return scene.add_contact_coupling(targets[0], targets[1], entry.range.make(), friction, **options)

    def _shape(self, scene: Scene, path: str, entry: ShapeSettings, problems: Problems) -> Any:
        body = self._find(f"{path}.body", entry.body, _BODY, problems)
        return scene.add_shape(body, entry.form.make(), **entry.model_dump(exclude={"body", "form"}))

    def _shape_contact(self, scene: Scene, path: str, entry: ShapeContactSettings, problems: Problems) -> Any:
        references = _REFERENCES["shape_contact"]
        targets = self._find_all(path, entry, references, problems)
        return scene.add_shape_contact(*targets, **entry.model_dump(exclude=set(references)))

    def _particle_contact(
        self, scene: Scene, path: str, entry: ParticleContactSettings, problems: Problems
    ) -> Any:
        def find(key: str, name: str, kind: tuple[str, tuple[str, ...]] = _SHAPE) -> Any:
            try:
                return self._find(f"{path}.{key}", name, kind, problems)
            except _Unresolved:
                return None

        # Resolve all references before failing, so that each is reported.
        shapes = [find(f"shapes[{i}]", name) for i, name in enumerate(entry.shapes)]
        pairs: list[Any] = [
            [find(f"exclude[{i}][{k}]", name) for k, name in enumerate(pair)]
            for i, pair in enumerate(entry.exclude)
        ]
        material = find("material", entry.material, _MATERIAL)
        if any(found is None for found in (*shapes, *(shape for pair in pairs for shape in pair), material)):
            raise _Unresolved
        options = entry.model_dump(exclude={"shapes", "material", "exclude"})
        return scene.add_particle_contact(shapes, material, exclude=pairs, **options)

    def _body_contact(self, scene: Scene, path: str, entry: BodyContactSettings, problems: Problems) -> Any:
        def find(key: str, name: str, kind: tuple[str, tuple[str, ...]]) -> Any:
            try:
                return self._find(f"{path}.{key}", name, kind, problems)
            except _Unresolved:
                return None

        def find_all(key: str, given: str | tuple[str, ...]) -> list[Any]:
            if isinstance(given, str):
                return [find(key, given, _SOLID)]
            return [find(f"{key}[{i}]", one, _SOLID) for i, one in enumerate(given)]

        # Resolve all references before failing, so that each is reported.
        keys = ("first",) if entry.second is None else ("first", "second")
        sides = [find_all(key, getattr(entry, key)) for key in keys]
        pairs: list[Any] = [
            [find_all(f"exclude[{i}][{k}]", side) for k, side in enumerate(pair)]
            for i, pair in enumerate(entry.exclude)
        ]
        material: Any = None
        if isinstance(entry.material, str):
            material = find("material", entry.material, _MATERIAL)
            materials = [material]
        else:
            materials = [
                None if row.material is None else find(f"material[{i}].material", row.material, _MATERIAL)
                for i, row in enumerate(entry.material)
            ]
            material = _table(path, entry.material, materials, problems)
            materials = [
                one for row, one in zip(entry.material, materials, strict=True) if row.material is not None
            ]
        solids = itertools.chain(*sides, *(solid for pair in pairs for solid in pair))
        if any(found is None for found in (*solids, *materials)):
            raise _Unresolved
        options = entry.model_dump(exclude={"first", "second", "material", "exclude"})
        return scene.add_body_contact(sides[0], sides[-1], material, exclude=pairs, **options)

    def _force_element(self, scene: Scene, path: str, entry: ForceElementSettings, problems: Problems) -> Any:
        targets = self._find_all(path, entry, entry.references, problems)
        values = entry.model_dump(exclude={"type", *entry.references}, exclude_none=True)
        references = dict(zip(entry.references, targets, strict=True))
        return scene.add_force_element(entry.kind, **references, **values)

    def _find_all(
        self,
        path: str,
        entry: Section,
        references: Mapping[str, tuple[str, tuple[str, ...]]],
        problems: Problems,
    ) -> list[Any]:
        targets, missing = [], False
        for key, kind in references.items():  # resolve all references before failing
            try:
                targets.append(self._find(f"{path}.{key}", getattr(entry, key), kind, problems))
            except _Unresolved:
                missing = True
        if missing:
            raise _Unresolved
        return targets

    def _find(self, path: str, name: str | None, kind: tuple[str, tuple[str, ...]], problems: Problems) -> Any:
        if name is None:
            return None
        for section in kind[1]:
            if name in self.elements[section]:
                return self.elements[section][name]
        self._check_reference(path, name, kind, problems)
        raise _Unresolved

    def _check_reference(
        self, path: str, name: str, kind: tuple[str, tuple[str, ...]], problems: Problems
    ) -> None:
        """Reports a name that no entry of the experiment has."""
        word, sections = kind
        available = [given for section in sections for given in sorted(self.parts.names[section])]
        if name not in available and not self.parts.unnamed.intersection(sections):
            problems.add_unknown_name(path, name, word, available)


def _table(
    path: str, rows: Sequence[PairMaterialSettings], materials: Sequence[Any], problems: Problems
) -> dict[tuple[str, str] | None, Any]:
    """Returns the table of contact materials of the rows of an experiment; a second row of a pair is reported."""
    table: dict[tuple[str, str] | None, Any] = {}
    for i, (row, material) in enumerate(zip(rows, materials, strict=True)):
        key = None if row.pair is None else (row.pair[0], row.pair[1])
        if key in table:
            which = "all other pairs" if key is None else f"the pair {list(key)}"
            problems.add(f"{path}.material[{i}]", f": there is an entry of {which} before")
            raise _Unresolved
        table[key] = material
    return table


def _as_continuation(message: str, name: str) -> str:
    """Returns a message of the scene about element ``name``, as a continuation of the key of the element."""
    if message.startswith(f"{name}."):
        return message[len(name) :]
    return f": {message}" if not message.startswith(f"{name}: ") else message[len(name) :]


def check_build(
    parts: ExperimentParts, folder: Path, file_cache: FileCache, problems: Problems
) -> Environments | None:
    """Returns a model of the valid parts of an experiment; ``None`` if it cannot be built.

    Args:
        parts: Valid parts of the experiment; entries whose user-defined class fails are removed.
        folder: Folder to which the names of mesh files are relative.
        file_cache: Meshes that were read before; new meshes and query meshes are added.
        problems: Receives the problems.
    """
    precision = parts.settings.precision if parts.settings else "float32"
    file_cache.query_meshes = {}  # those of an earlier validation may belong to other surfaces
    scene = SceneBuilder(parts, folder, file_cache).scene(problems)
    model, error = _try_build(scene, precision, file_cache.query_meshes)
    # Classes in the model are valid. Others, or all of them if the build failed, are tested one by one.
    working = set() if model is None else _classes(scene)
    faults = 0
    for section, i, key, formula in list(_user_formulas(parts)):
        fault = None if type(formula) in working else _find_fault(key, formula, precision)
        if fault is not None:
            problems.add(f"{section}[{i}].{key}", f": {fault}")
            parts.entries[section].pop(i, None)
            faults += 1
    if faults and model is None:
        # Build again without them to find other problems; those of the entries are already reported.
        scene = SceneBuilder(parts, folder, file_cache).scene(Problems())
        model, error = _try_build(scene, precision, file_cache.query_meshes)
    if isinstance(error, ValueError):
        message = str(error)
        paths = {entry.name: path for _, path, entry in parts}
        name = message.partition(":")[0]
        problems.add(paths.get(name, "scene"), f": {message.removeprefix(name + ': ')}")
    elif error is not None:
        raise error
    return model


def _try_build(
    scene: Scene, precision: str, known: QueryMeshCache | None = None
) -> tuple[Environments | None, Exception | None]:
    """Returns a model of one environment, or the error; query meshes are stored in ``known``."""
    if not scene.bodies:
        return None, None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the model of the run gives the warnings
            return plan_model(scene, "cpu", precision, known).build(1), None
    except Exception as error:
        return None, error


def _classes(scene: Scene) -> set[type[Formula]]:
    """Returns the classes of all laws, friction models, springs, shapes and joints in ``scene``."""
    formulas = [f for one in scene.elements() for f in getattr(one, "formulas", {}).values()]
    kinds = {kind for contact in scene.shape_contacts for kind in contact.kinds}
    return kinds | {type(formula) for formula in (*formulas, *(body.motion for body in scene.bodies))}


def _user_formulas(parts: ExperimentParts) -> Iterator[tuple[str, int, str, Formula]]:
    """Iterates over instances of user-defined classes: section, number of the entry, key, instance."""
    for section in DEVICE_MODEL_SECTIONS:
        for i, entry in parts.entries[section].items():
            for key, table in entry:
                if isinstance(table, DeviceModelSettings) and user_class(table.type)[0]:
                    yield section, i, key, table.make()


def _find_fault(key: str, formula: Formula, precision: str) -> str | None:
    """Returns why ``formula``, as ``key`` of its table, cannot be evaluated or compiled; ``None``: it can."""
    cls = type(formula)
    if isinstance(formula, Motion):
        scene = Scene()
        scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), motion=formula)
        _, failure = _try_build(scene, precision)
        return None if failure is None else _failure_text(failure, cls)
    if isinstance(formula, shapes.Shape):
        scene = Scene()
        ball = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0))
        both = scene.add_shape(ball, shapes.Sphere(1.0)), scene.add_shape(None, formula)
        scene.add_shape_contact(*both, ContactMaterial(law=laws.Hooke(stiffness=1.0)))
        _, failure = _try_build(scene, precision)
        return None if failure is None else _failure_text(failure, cls)
    values = {name: np.full((1, 1), value) for name, value in formula.parameters(area=1.0).items()}
    if along := isinstance(formula, springs.Spring | springs.Damper):
        values["rest_length"] = np.ones((1, 1))
    try:
        missing = set(cls.device_names()) - set(formula.coefficients(values))
    except Exception as error:
        return describe_error(error, cls)
    if missing:
        return f"{cls.__name__}.coefficients must return {', '.join(cls.device_names())}, got no {min(missing)}"
    scene = Scene()
    ball = scene.add_body(mass=1.0, inertia=(1.0, 1.0, 1.0), position=(0.0, 0.0, 1.0))
    if along:
        ends = (scene.add_point(None, (0.0, 0.0, 0.0)), scene.add_point(ball, (0.0, 0.0, 0.0)))
        scene.add_spring_damper(*ends, **{"spring": springs.Linear(stiffness=1.0), key: formula})
    else:
        try:
            material = ContactMaterial(**{"law": laws.Hooke(stiffness=1.0), key: formula})
        except ValueError as error:
            return str(error)
        # A set of points, because it has areas, which a law may require.
        points = scene.add_points(ball, [(0.0, 0.0, 0.0)], areas=[1.0])
        scene.add_contact(points, scene.add_surface(meshes.grid()), material, radius=0.1)
    _, failure = _try_build(scene, precision)
    if failure is None:
        return None
    text = _failure_text(failure, cls)
    if key in ("law", "spring"):
        return text
    helper = "spring Linear" if along else "law Hooke"
    return re.sub(rf"^{helper} with |^In the {helper.partition(' ')[0]}, .*\n", "", text, flags=re.MULTILINE)


def _failure_text(failure: Exception, cls: type[Formula]) -> str:
    """Returns the reason, as text, why a model with an object of class ``cls`` could not be built."""
    # The message of a compile error is complete; only the generated module name is removed.
    if isinstance(failure, TypeError):
        return str(failure).replace(f"{cls.__module__}.", "")
    return describe_error(failure, cls)
