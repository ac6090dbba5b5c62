"""Schema of the experiment file: sections, keys, types and defaults, named as in the Python API.

Laws, friction models and meshes are in ``catalogue.py``.
"""

from collections.abc import Sequence
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, model_validator

from warpcontact.experiment import observation
from warpcontact.experiment import quantities as q
from warpcontact.experiment.catalogue import (
    DeviceModelTable,
    FileMesh,
    Section,
    ShapeMesh,
    SurfaceMesh,
    device_model_settings,
    mesh_model,
    settings_model,
)
from warpcontact.experiment.force_elements import ForceElementSettings, ForceElementTable, force_element_model
from warpcontact.experiment.observation import IntegratorSettings
from warpcontact.experiment.user_code import UserFiles
from warpcontact.experiment.variation_settings import (
    MOST_ENVS,
    CorrelationSettings,
    SamplingSettings,
    SolidSphere,
    VariationSettings,
)
from warpcontact.kernels import laws
from warpcontact.kernels.friction import Frictionless
from warpcontact.model.build import PRECISIONS
from warpcontact.scene import couplings as coupling_limits
from warpcontact.scene import elements as limits_of
from warpcontact.scene.contact_coupling import CLOSEST, DAMPING_RATIO, FACINGS, SPEED, ContactRange
from warpcontact.scene.surface_contact import SIDES

Row = TypeVar("Row")
# TOML has only lists; they are stored as tuples, which are immutable.
Rows = Annotated[tuple[Row, ...], Field(strict=False)]
Name = Annotated[str, q.element_name]
Position = Annotated[tuple[float, ...], q.position]
Quaternion = Annotated[tuple[float, ...], q.quaternion]
Color = Annotated[tuple[float, ...], q.color]
ORIGIN = (0.0, 0.0, 0.0)
NO_ROTATION = (0.0, 0.0, 0.0, 1.0)


class SurfaceSettings(Section):
    """``[[surface]]``: an oriented mesh on a body, or on the world."""

    name: Name
    mesh: SurfaceMesh
    body: str | None = None
    position: Position = ORIGIN
    orientation: Quaternion = NO_ROTATION
    scale: Annotated[float, q.numbers((), allowed=limits_of.SCALE)] = 1.0
    flip: bool = False
    active_faces: Annotated[Any, q.faces] = None
    group: int = Field(default=1, ge=0, le=limits_of.ALL_GROUPS)
    mask: int = Field(default=limits_of.ALL_GROUPS, ge=0, le=limits_of.ALL_GROUPS)
    physics_material: str | None = Field(default=None, min_length=1)
    color: Color | None = None
    visible: bool = True

    @property
    def meshes(self) -> dict[str, FileMesh | ShapeMesh]:
        """Meshes by key: ``"mesh"``, or ``"mesh[0]"``, … of a list."""
        if isinstance(self.mesh, tuple):
            return {f"mesh[{i}]": mesh for i, mesh in enumerate(self.mesh)}
        return {"mesh": self.mesh}


class BodySettings(Section):
    """``[[body]]``: a rigid body and its initial state."""

    name: Name
    mass: Annotated[float, q.numbers((), allowed=limits_of.MASS)] = Field(description="mass [kg]")
    inertia: Annotated[Any, q.inertia] = Field(description="3 principal moments or a 3×3 tensor [kg·m²]")
    position: Position = ORIGIN
    orientation: Quaternion = NO_ROTATION
    linear_velocity: Annotated[tuple[float, ...], q.velocity] = ORIGIN
    angular_velocity: Annotated[tuple[float, ...], q.angular_velocity] = ORIGIN
    external_force: Annotated[tuple[float, ...], q.force] = ORIGIN
    external_torque: Annotated[tuple[float, ...], q.torque] = ORIGIN
    motion: DeviceModelTable | None = None
    color: Color | None = None


class BodiesSettings(Section):
    """``[[bodies]]``: a set of rigid bodies.

    All values but the positions are one value for all bodies, a list with one per body, or the name of a file.
    """

    name: Name
    positions: Annotated[Any, q.positions] = Field(description="a list of 3 numbers each [m], or a file")
    mass: Annotated[Any, q.masses] = Field(description="mass [kg]")
    inertia: Annotated[Any, q.inertias] = Field(description="3 principal moments or a 3×3 tensor [kg·m²]")
    orientations: Annotated[Any, q.quaternions] = NO_ROTATION
    linear_velocities: Annotated[Any, q.velocities] = ORIGIN
    angular_velocities: Annotated[Any, q.angular_velocities] = ORIGIN
    external_forces: Annotated[Any, q.forces] = ORIGIN
    external_torques: Annotated[Any, q.torques] = ORIGIN
    motion: DeviceModelTable | None = None
    color: Color | None = None


class PointSettings(Section):
    """``[[point]]``: a point of a body, a surface or the world; with a set of bodies, one point on each."""

    name: Name
    body: str | None = None
    surface: str | None = None
    position: Position = Field(description="3 numbers [m]")

    @model_validator(mode="after")
    def _one_carrier(self) -> "PointSettings":
        _check_carrier(self)
        return self


class PointsSettings(Section):
    """``[[points]]``: a set of points of a body, a surface or the world."""

    name: Name
    body: str | None = None
    surface: str | None = None
    positions: Annotated[Any, q.positions] = None
    areas: Annotated[tuple[float, ...] | None, q.areas] = None
    samples: Annotated[int | str | None, q.amount] = None
    seed: int | None = Field(default=None, ge=0)

    @model_validator(mode="after")
    def _one_source(self) -> "PointsSettings":
        _check_carrier(self)
        if (self.positions is None) == (self.samples is None):
            got = "none" if self.positions is None else "both"
            raise ValueError(f"must have exactly one of positions and samples; got {got}")
        if self.samples is None and self.seed is not None:
            raise ValueError(".seed requires samples, got positions")
        if self.samples is not None and self.areas is not None:
            raise ValueError(".areas must be left out: samples have their own areas")
        if self.samples is not None and self.surface is None:
            raise ValueError(".surface is missing: samples are taken on a surface")
        return self


def _check_carrier(entry: PointSettings | PointsSettings) -> None:
    if entry.body is not None and entry.surface is not None:
        raise ValueError(f" must be on a body or on a surface, got {entry.body!r} and {entry.surface!r}")


class MaterialSettings(Section):
    """``[[material]]``: a normal law with friction, rolling and torsion models, shared by contacts."""

    name: Name
    law: DeviceModelTable = Field(description="{ type = …, and its parameters }")
    friction: DeviceModelTable = settings_model(Frictionless)(type="Frictionless")
    rolling: DeviceModelTable | None = None
    torsion: DeviceModelTable | None = None


class ContactOptions(Section):
    """Options of point contacts and surface contacts."""

    name: Name
    material: str = Field(description="the name of a material")
    radius: Annotated[Any, q.numbers((), allowed=limits_of.RADIUS)] = 0.0
    kappa: Annotated[float, q.numbers((), allowed=limits_of.KAPPA)] = 0.5
    search: Annotated[str, q.one_of(("whole", "active"))] = "whole"
    entry: Annotated[str, q.one_of(("literal", "latched"))] = "literal"
    swept: bool = False
    minima: Annotated[str, q.one_of(limits_of.MINIMA)] = "nearest"
    group_angle: Annotated[Any, q.numbers((2,), allowed=limits_of.GROUP_ANGLE)] = limits_of.DEFAULT_GROUP_ANGLE
    max_minima: int = Field(default=4, ge=1, le=limits_of.MOST_MINIMA)
    max_depth: Annotated[float | None, q.numbers((), allowed=limits_of.MAX_DEPTH)] = None
    boundary: Annotated[str, q.one_of(("off", "outer"))] = "off"
    search_radius: Annotated[float | None, q.numbers((), allowed=limits_of.SEARCH_RADIUS)] = None
    torsion_radius: Annotated[float | None, q.numbers((), allowed=limits_of.TORSION_RADIUS)] = None
    force_scale: Annotated[float, q.numbers((), allowed=limits_of.FORCE_SCALE)] = 1.0
    enabled: bool = True
    color: Color | None = None
    visible: bool = True


class ContactSettings(ContactOptions):
    """``[[contact]]``: contact of points or spheres with a surface."""

    radius: Annotated[Any, q.radii] = 0.0
    points: str = Field(description="the name of a point or of points")
    surface: str = Field(description="the name of a surface")


class SurfaceContactSettings(ContactOptions):
    """``[[surface_contact]]``: contact of two surfaces, by sample points of one or both."""

    surface_a: str = Field(description="the name of a surface")
    surface_b: str = Field(description="the name of a surface")
    samples: Annotated[Any, q.amounts] = 500
    seed: int = Field(default=0, ge=0)
    sides: Annotated[str, q.one_of(SIDES)] = "first"


class ShapeSettings(Section):
    """``[[shape]]``: an analytic shape on a body or the world; with a set of bodies, one shape on each."""

    name: Name
    form: DeviceModelTable = Field(description="{ type = …, and its parameters }")
    body: str | None = None
    position: Position = ORIGIN
    orientation: Quaternion = NO_ROTATION
    group: int = Field(default=1, ge=0, le=limits_of.ALL_GROUPS)
    mask: int = Field(default=limits_of.ALL_GROUPS, ge=0, le=limits_of.ALL_GROUPS)
    physics_material: str | None = Field(default=None, min_length=1)
    color: Color | None = None
    visible: bool = True


class ShapeContactSettings(Section):
    """``[[shape_contact]]``: contact of two shapes."""

    name: Name
    shape: str = Field(description="the name of a shape")
    other_shape: str = Field(description="the name of a shape")
    material: str = Field(description="the name of a material")
    kappa: Annotated[float, q.numbers((), allowed=limits_of.KAPPA)] = 0.5
    max_depth: Annotated[float | None, q.numbers((), allowed=limits_of.MAX_DEPTH)] = None
    torsion_radius: Annotated[float | None, q.numbers((), allowed=limits_of.TORSION_RADIUS)] = None
    force_scale: Annotated[float, q.numbers((), allowed=limits_of.FORCE_SCALE)] = 1.0
    enabled: bool = True
    color: Color | None = None
    visible: bool = True


class ParticleContactSettings(Section):
    """``[[particle_contact]]``: contact among many spheres and capsules."""

    name: Name
    shapes: Rows[str] = Field(description="the names of shapes", min_length=1)
    material: str = Field(description="the name of a material")
    exclude: Rows[Rows[str]] = ()
    skin: Annotated[float | None, q.numbers((), allowed=limits_of.RANGE)] = None
    max_neighbors: int | None = Field(default=None, ge=1)
    kappa: Annotated[float, q.numbers((), allowed=limits_of.KAPPA)] = 0.5
    max_depth: Annotated[float | None, q.numbers((), allowed=limits_of.MAX_DEPTH)] = None
    torsion_radius: Annotated[float | None, q.numbers((), allowed=limits_of.TORSION_RADIUS)] = None
    force_scale: Annotated[float, q.numbers((), allowed=limits_of.FORCE_SCALE)] = 1.0
    enabled: bool = True
    color: Color | None = None
    visible: bool = True


class PairMaterialSettings(Section):
    """Entry of a table of contact materials."""

    pair: Rows[str] | None = Field(
        default=None, description="two names of physics materials; if left out, all other pairs"
    )
    material: str | None = Field(default=None, description="the name of a material; if left out, no contact")

    @model_validator(mode="after")
    def _has_two_names(self) -> "PairMaterialSettings":
        if self.pair is not None and (len(self.pair) != 2 or not all(self.pair)):
            raise ValueError(f".pair must be two names of physics materials, got {list(self.pair)}")
        return self


class BodyContactSettings(Section):
    """``[[body_contact]]``: contact of solids over an area."""

    name: Name
    first: str | Rows[str] = Field(description="the name of a surface, a shape or a body, or a list of names")
    second: str | Rows[str] | None = Field(
        default=None, description="likewise; if left out, each solid of first is in contact with each other one"
    )
    material: str | Rows[PairMaterialSettings] = Field(
        description="the name of a material, or a list of tables { pair = [two physics materials], material = name }"
    )
    exclude: Rows[Rows[str | Rows[str]]] = Field(
        default=(),
        description="pairs of names of surfaces, shapes or bodies, or of lists of them, that are not in contact",
    )
    reference: Literal["auto", "first", "second", "average"] = "auto"
    kappa: Annotated[float, q.numbers((), allowed=limits_of.KAPPA)] = 0.5
    max_depth: Annotated[float | None, q.numbers((), allowed=limits_of.MAX_DEPTH)] = None
    margin: Annotated[float, q.numbers((), allowed=limits_of.MARGIN)] = 0.0
    force_scale: Annotated[float, q.numbers((), allowed=limits_of.FORCE_SCALE)] = 1.0
    enabled: bool = True
    color: Color | None = None
    visible: bool = True


class ImpactSettings(Section):
    """An expected impact, from which the coefficients of a contact coupling are computed."""

    mass: Annotated[float, q.numbers((), allowed=limits_of.MASS)] = Field(description="of the body [kg]")
    other_mass: Annotated[float | None, q.numbers((), allowed=limits_of.MASS)] = None
    area: Annotated[float, q.numbers((), allowed=limits_of.AREA)] = Field(description="of the contact [m²]")
    speed: Annotated[float, q.numbers((), allowed=SPEED)] = Field(description="normal speed [m/s]")
    effective_range: Annotated[float, q.numbers((), allowed=limits_of.RANGE)] = Field(
        description="distance at which the force starts [m]"
    )
    closest: Annotated[float, q.numbers((), allowed=CLOSEST)] = Field(description="smallest distance [m]")
    damping_ratio: Annotated[float, q.numbers((), allowed=DAMPING_RATIO)] = 0.0

    @model_validator(mode="after")
    def _stops_within(self) -> "ImpactSettings":
        if self.closest >= self.effective_range:
            raise ValueError(
                f".closest must be less than effective_range = {self.effective_range:g} m, got {self.closest:g} m"
            )
        return self


class RangeSettings(Section):
    """Coefficients of a contact coupling, or the impact from which they are computed."""

    k1: Annotated[float | None, q.numbers((), allowed=laws.ContactRange.limits("k1"))] = None
    k2: Annotated[float | None, q.numbers((), allowed=laws.ContactRange.limits("k2"))] = None
    effective_range: Annotated[float | None, q.numbers((), allowed=limits_of.RANGE)] = None
    from_impact: ImpactSettings | None = None

    @model_validator(mode="after")
    def _one_source(self) -> "RangeSettings":
        given = [key for key in ("k1", "k2", "effective_range") if getattr(self, key) is not None]
        if self.from_impact is not None:
            if given:
                raise ValueError(f".{given[0]} must be left out: from_impact determines it")
        elif missing := [key for key in ("k1", "effective_range") if key not in given]:
            raise ValueError(f".{missing[0]} is missing, or from_impact = {{ … }} instead of all")
        return self

    def make(self) -> ContactRange:
        """Returns the ``ContactRange``."""
        if self.from_impact is not None:
            return ContactRange.from_impact(**self.from_impact.model_dump())
        return ContactRange(**self.model_dump(exclude={"from_impact"}, exclude_none=True))


class ContactCouplingSettings(Section):
    """``[[contact_coupling]]``: repulsive pressure between two surfaces within a range."""

    name: Name
    surface_a: str = Field(description="the name of a surface, on a body")
    surface_b: str = Field(description="the name of a surface")
    range: RangeSettings = Field(description="{ k1, k2, effective_range } or { from_impact = { … } }")
    friction: DeviceModelTable | None = None
    facing: Annotated[str, q.one_of(FACINGS)] = "projected"
    sides: Annotated[str, q.one_of(SIDES)] = "first"
    quadrature: Annotated[int, q.quadrature] = 1
    damping_ramp: Annotated[float, q.numbers((), allowed=laws.ContactRange.limits("ramp"))] = 0.0
    search: Annotated[str, q.one_of(("whole", "active"))] = "whole"
    boundary: Annotated[str, q.one_of(("off", "outer"))] = "off"
    enabled: bool = True
    color: Color | None = None
    visible: bool = True


class CouplingOptions(Section):
    """Options of all couplings between two points."""

    name: Name
    point_a: str = Field(description="the name of a point")
    point_b: str = Field(description="the name of a point")
    enabled: bool = True
    color: Color | None = None
    visible: bool = True


class SpringDamperSettings(CouplingOptions):
    """``[[spring_damper]]``: a spring and a damper in parallel, along the line between two points."""

    stiffness: Annotated[float | None, q.numbers((), allowed=coupling_limits.STIFFNESS)] = None
    damping: Annotated[float | None, q.numbers((), allowed=coupling_limits.DAMPING)] = None
    spring: DeviceModelTable | None = None
    damper: DeviceModelTable | None = None
    rest_length: Annotated[float | None, q.numbers((), allowed=coupling_limits.LENGTH)] = None
    tension_only: bool = False
    break_force: Annotated[float | None, q.numbers((), allowed=coupling_limits.BREAK_FORCE)] = None


class BushingSettings(CouplingOptions):
    """``[[bushing]]``: springs and dampers along and about three axes, between two points."""

    stiffness: Annotated[tuple[float, ...], q.numbers((3,), allowed=coupling_limits.STIFFNESS)] = ORIGIN
    damping: Annotated[tuple[float, ...], q.numbers((3,), allowed=coupling_limits.DAMPING)] = ORIGIN
    turn_stiffness: Annotated[tuple[float, ...], q.numbers((3,), allowed=coupling_limits.TURN_STIFFNESS)] = ORIGIN
    turn_damping: Annotated[tuple[float, ...], q.numbers((3,), allowed=coupling_limits.TURN_DAMPING)] = ORIGIN
    orientation: Quaternion = NO_ROTATION


class CatenarySettings(CouplingOptions):
    """``[[catenary]]``: an elastic cable between two points under its own weight."""

    length: Annotated[float, q.numbers((), allowed=coupling_limits.LINE_LENGTH)] = Field(
        description="unstretched length [m]"
    )
    mass_per_length: Annotated[float, q.numbers((), allowed=coupling_limits.MASS_PER_LENGTH)] = Field(
        description="mass per unstretched length [kg/m]"
    )
    axial_stiffness: Annotated[float, q.numbers((), allowed=coupling_limits.AXIAL_STIFFNESS)] = Field(
        description="tension over strain [N]"
    )
    floor: Annotated[float | None, q.numbers((), allowed=coupling_limits.FLOOR)] = None


class Settings(Section):
    """The content of an experiment file."""

    name: Annotated[str, q.title] = "experiment"
    envs: int = Field(default=1, ge=1, le=MOST_ENVS)
    duration: Annotated[float, q.time] = Field(description="simulated time [s]")
    dt: Annotated[float, q.time] = Field(description="time step [s]")
    crossing_substeps: int = Field(default=1, ge=1)
    precision: Annotated[str, q.one_of(tuple(PRECISIONS))] = "float32"
    seed: int = Field(default=0, ge=0)
    gravity: Annotated[tuple[float, ...], q.acceleration] = (0.0, 0.0, -9.81)
    surface: Rows[SurfaceSettings] = ()
    body: Rows[BodySettings] = ()
    bodies: Rows[BodiesSettings] = ()
    point: Rows[PointSettings] = ()
    points: Rows[PointsSettings] = ()
    material: Rows[MaterialSettings] = ()
    contact: Rows[ContactSettings] = ()
    surface_contact: Rows[SurfaceContactSettings] = ()
    contact_coupling: Rows[ContactCouplingSettings] = ()
    shape: Rows[ShapeSettings] = ()
    shape_contact: Rows[ShapeContactSettings] = ()
    particle_contact: Rows[ParticleContactSettings] = ()
    body_contact: Rows[BodyContactSettings] = ()
    spring_damper: Rows[SpringDamperSettings] = ()
    bushing: Rows[BushingSettings] = ()
    catenary: Rows[CatenarySettings] = ()
    force_element: Rows[ForceElementTable] = ()
    variation: dict[str, VariationSettings] = Field(default_factory=dict)
    sampling: SamplingSettings = Field(default_factory=SamplingSettings)
    correlation: Rows[CorrelationSettings] = ()
    integrator: IntegratorSettings = Field(default_factory=IntegratorSettings)
    outcome: dict[str, observation.OutcomeTable] = Field(default_factory=dict)
    stop: dict[str, observation.StopSettings] = Field(default_factory=dict)
    events: observation.EventsSettings | None = None
    quarantine: observation.QuarantineSettings = Field(default_factory=observation.QuarantineSettings)
    record: observation.RecordSettings = Field(default_factory=observation.RecordSettings)
    output: observation.OutputSettings = Field(default_factory=observation.OutputSettings)


#: Sections of the scene, all lists, in the order in which elements are added.
SECTIONS: dict[str, type[Section]] = {
    "body": BodySettings,
    "bodies": BodiesSettings,
    "surface": SurfaceSettings,
    "point": PointSettings,
    "points": PointsSettings,
    "material": MaterialSettings,
    "contact": ContactSettings,
    "surface_contact": SurfaceContactSettings,
    "contact_coupling": ContactCouplingSettings,
    "shape": ShapeSettings,
    "shape_contact": ShapeContactSettings,
    "particle_contact": ParticleContactSettings,
    "body_contact": BodyContactSettings,
    "spring_damper": SpringDamperSettings,
    "bushing": BushingSettings,
    "catenary": CatenarySettings,
    "force_element": ForceElementSettings,
}


#: Sections with laws, friction models, springs, shapes or joints.
DEVICE_MODEL_SECTIONS = ("body", "bodies", "material", "contact_coupling", "shape", "spring_damper")
#: Keys of sections that may name a file with rows.
ROW_KEYS: dict[str, tuple[str, ...]] = {
    "bodies": (
        "positions",
        "mass",
        "inertia",
        "orientations",
        "linear_velocities",
        "angular_velocities",
        "external_forces",
        "external_torques",
    ),
    "points": ("positions",),
    "contact": ("radius",),
}
#: Sections that are a single table.
_SINGLE: dict[str, type[Section]] = {
    "sampling": SamplingSettings,
    "integrator": IntegratorSettings,
    "events": observation.EventsSettings,
    "quarantine": observation.QuarantineSettings,
    "record": observation.RecordSettings,
    "output": observation.OutputSettings,
}
#: Sections that are lists and not part of the scene.
LISTS: dict[str, type[Section]] = {"correlation": CorrelationSettings}
#: Tables of a contact coupling.
_TABLES: dict[str, type[Section]] = {"range": RangeSettings, "from_impact": ImpactSettings}


def entry_model(section: str, entry: Any, user_files: UserFiles) -> type[Section]:
    """Returns the type of an entry of a section of the scene; raises ``ValueError`` if the entry has none."""
    return force_element_model(entry, user_files) if section == "force_element" else SECTIONS[section]


def table_at(location: Sequence[str | int], raw: Any, user_files: UserFiles) -> type[Section]:
    """Returns the type of the table at ``location`` in ``raw``, a location of pydantic."""
    parts = [part for part in location if isinstance(part, str)]
    if not parts:
        return Settings
    if parts[0] == "variation":
        return SolidSphere if len(parts) > 2 else VariationSettings
    if parts[0] == "stop":
        return observation.StopSettings
    if parts[0] == "outcome":
        return observation.outcome_model(raw["outcome"][parts[1]], user_files)
    if parts[0] == "force_element" and len(location) > 1:
        return force_element_model(list(raw["force_element"])[int(location[1])], user_files)
    if len(parts) == 1:
        return (SECTIONS | _SINGLE | LISTS)[parts[0]]
    if parts[1] in _TABLES and parts[0] == "contact_coupling":
        return _TABLES[parts[-1]]
    value = raw
    for part in location:
        value = value[part] if isinstance(part, str) else list(value)[part]
    return mesh_model(value) if parts[-1] == "mesh" else device_model_settings(parts[-1], value, user_files)
