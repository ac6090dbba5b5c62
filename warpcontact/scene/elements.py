"""The elements of a scene: bodies, surfaces, points, contacts, materials, and the ranges of their values.

The functions check arguments that several methods of ``Scene`` have in common.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact.algebra import vectors
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.contact.contact_evaluation import ContactModel
from warpcontact.kernels.friction import Friction, Frictionless
from warpcontact.kernels.joints import Motion
from warpcontact.kernels.laws import Law
from warpcontact.kernels.types import WORLD
from warpcontact.meshes import Mesh
from warpcontact.meshes.mesh import face_mask
from warpcontact.meshes.topology import seen_from
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

MASS = limits("kg", above=0.0)
AREA = limits("m²", above=0.0)
RADIUS = limits("m", at_least=0.0)
RANGE = limits("m", above=0.0)
KAPPA = limits("-", at_least=0.0, at_most=1.0)
MARGIN = limits("m", at_least=0.0)
MAX_DEPTH = limits("m", above=0.0, may_be_infinite=True)
SEARCH_RADIUS = limits("m", above=0.0, may_be_infinite=True)
TORSION_RADIUS = limits("m", at_least=0.0)
FORCE_SCALE = limits("-", at_least=0.0)
SCALE = limits("-", above=0.0)
ENABLED = limits("-", at_least=0.0, at_most=1.0)
GROUP_ANGLE = limits("rad", at_least=0.0, at_most=math.pi)
#: Default of ``group_angle``: 10° and 40° [rad].
DEFAULT_GROUP_ANGLE = (math.radians(10.0), math.radians(40.0))
#: Smallest difference of the two angles of ``group_angle`` [rad].
MIN_ANGLE_DIFFERENCE = 1.0e-3
#: Largest ``max_minima``.
MOST_MINIMA = 64
#: Values of ``minima``.
MINIMA = ("nearest", "all")
#: Bits of all groups of surfaces and shapes.
ALL_GROUPS = 0xFFFFFFFF


@explain_keywords_of
@dataclass(frozen=True, kw_only=True)
class ContactMaterial:
    """Material of a contact (not of a body): a normal force law and up to three friction models.

    Several contacts can share a material. A friction model gives the force F that opposes a velocity under the normal
    force N. For sliding it is the tangential velocity at the contact point K. For rolling it is the velocity
    R (ω₁ − ω₂) × n of the contact point of a sphere of radius R, and F gives the torque R n × F: its coefficient is
    the rolling resistance μ_r in M = μ_r R N. For torsion it is r_t (ω₁ − ω₂)·n, with the torque r_t F; see
    ``torsion_radius`` of ``add_contact``.

    Args:
        law: Normal force law, an instance of a class of ``wc.laws`` or of a custom ``wc.Law``.
        friction: Friction model of ``wc.friction`` or a custom ``wc.Friction``. Default: frictionless.
        rolling: Friction model of rolling resistance. Default: none.
        torsion: Friction model of torsional (spinning) friction. Default: none.
    """

    law: Law
    friction: Friction = field(default_factory=Frictionless)
    rolling: Friction = field(default_factory=Frictionless)
    torsion: Friction = field(default_factory=Frictionless)

    def __post_init__(self) -> None:
        for name in ContactModel._fields:
            kind = Law if name == "law" else Friction
            if name != "law" and getattr(self, name) is None:
                object.__setattr__(self, name, Frictionless())
            if not isinstance(getattr(self, name), kind):
                raise TypeError(
                    f"ContactMaterial.{name} must be an instance of wc.{kind.__name__}, got {getattr(self, name)!r}"
                )
        if self.torsion.directional:
            raise ValueError(
                f"ContactMaterial.torsion must be an isotropic friction model, got {type(self.torsion).__name__}; "
                "torsion has only one axis"
            )

    @property
    def formulas(self) -> dict[str, Formula]:
        """The law and the friction models, by name of the part."""
        return {name: getattr(self, name) for name in ContactModel._fields}

    @property
    def parts(self) -> ContactModel:
        """The contact model: classes of law and friction models, for which a kernel is compiled."""
        return ContactModel(*(type(formula) for formula in self.formulas.values()))


def needs_radius(material: ContactMaterial, has_torsion_radius: bool) -> str | None:
    """Returns the name of a part of ``material`` that requires a radius; ``None``: no part does."""
    if material.law.needs_curvature:
        return "law"
    if material.friction.needs_radius:
        return "friction"
    if not isinstance(material.rolling, Frictionless):
        return "rolling"
    torsion = material.torsion
    if not isinstance(torsion, Frictionless) and (not has_torsion_radius or torsion.needs_radius):
        return "torsion"
    return None


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body, or a set of bodies as one element. The origin of the body frame is the center of mass.

    For a set, state, mass and inertia have a first axis with one entry per body.
    """

    name: str
    index: int  # of the first body on the device
    mass: Array
    inertia: Array  # (3, 3), body axes
    position: Array
    orientation: Array
    linear_velocity: Array
    angular_velocity: Array
    external_force: Array
    external_torque: Array
    motion: Motion  # for a set: the motion of each body
    color: Array | None
    count: int = 1  # number of bodies
    single: bool = True  # made by add_body: no item axis

    @property
    def items(self) -> slice:
        """Index range of its bodies in an environment."""
        return slice(self.index, self.index + self.count)

    def rows(self, key: str) -> Array:
        """Returns an attribute, such as ``"mass"``, with one row per body (n, …)."""
        values: Array = getattr(self, key)
        return values[None] if self.single else values


@dataclass(frozen=True, eq=False)
class Surface:
    """An oriented mesh, or several alternative meshes, fixed to a body or to the world."""

    name: str
    index: int
    meshes: tuple[Mesh, ...]
    body: Body | None
    position: Array
    orientation: Array
    scale: Array
    active: tuple[NDArray[np.bool_], ...]  # (F,) of each mesh
    group: int  # bits
    mask: int  # bits
    physics_material: str | None
    color: Array | None
    visible: bool

    @property
    def mesh(self) -> Mesh:
        """The mesh, or the first one of several."""
        return self.meshes[0]

    @property
    def active_faces(self) -> NDArray[np.bool_]:
        """Mask (F,) of the active faces of ``mesh``."""
        return self.active[0]

    @property
    def centre(self) -> Array:
        """Origin of the mesh coordinates in kernels, in the mesh frame (3,) [m].

        For meshes far from the origin of their frame it is their center, because float32 coordinates are coarse
        there. For others it is the origin, so that coordinates are not rounded.
        """
        bounds = np.array([mesh.bounds for mesh in self.meshes])
        return seen_from(bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0))


@dataclass(frozen=True, eq=False)
class Points:
    """One point, or a set of points, fixed to a body, to a surface or to the world.

    On a set of bodies there is one point per body, in the order of the bodies.
    """

    name: str
    start: int  # index of the first
    body: Body | None
    surface: Surface | None
    positions: Array  # (n, 3), in the mesh frame if fixed to a surface, else in the body frame [m]
    areas: Array | None  # (n,) area weights, in the same frame as the positions [m²]
    normals: Array | None  # (n, 3) outward unit normals of the sampled surface, in the same frame
    single: bool  # made by add_point: no item axis

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.positions)

    @property
    def spread(self) -> bool:
        """Whether each point is on a separate body of a set."""
        return self.body is not None and not self.body.single

    @property
    def body_numbers(self) -> NDArray[np.int32]:
        """Body index of each point on the device (n,), or ``WORLD``."""
        first = WORLD if self.body is None else self.body.index
        return np.int32(first) + np.arange(self.count, dtype=np.int32) * np.int32(self.spread)

    @property
    def places(self) -> Array:
        """Positions in the frame of the body, or of the world, (n, 3) [m]."""
        if self.surface is None:
            return self.positions
        scaled = self.surface.scale * self.positions
        return vectors.transform_points(scaled, self.surface.position, self.surface.orientation)


class ContactOptions(TypedDict, total=False):
    """Keywords of ``Scene.add_contact`` that ``Scene.add_surface_contact`` also accepts."""

    radius: ArrayLike
    kappa: float
    search: str
    entry: str
    swept: bool
    minima: str
    group_angle: ArrayLike
    max_minima: int
    max_depth: float | None
    boundary: str
    search_radius: float
    torsion_radius: float | None
    force_scale: float
    enabled: bool
    color: ArrayLike | None
    visible: bool


@dataclass(frozen=True, eq=False)
class Contact:
    """Contact of points (with a radius: spheres) with a surface.

    On the device the points are one point set, which moves rigidly. Points on a set of bodies are one set each.
    """

    name: str
    points: Points
    surface: Surface
    material: ContactMaterial
    radius: Array  # one value, or one per point (n,) [m]
    kappa: Array
    max_depth: Array
    search_radius: Array
    torsion_radius: Array | None
    force_scale: Array
    enabled: Array
    search: str
    entry: str
    swept: bool
    boundary: str
    color: Array | None
    visible: bool
    minima: str
    group_angle: Array  # (2,) [rad]
    max_minima: int
    # "all" or "projected" for a contact coupling, whose force acts at the points; None for an ordinary contact.
    facing: str | None = None

    @property
    def bodies(self) -> tuple[Body | None, Body | None]:
        """Bodies of the points and of the surface; ``None``: the world."""
        return self.points.body, self.surface.body

    @property
    def formulas(self) -> dict[str, Formula]:
        """The law and the friction models, by name of the part."""
        return self.material.formulas

    @property
    def code(self) -> tuple[ContactModel, bool, int]:
        """Key of the force kernel: contact model, projection of area weights, number of minima.

        The second one is whether area weights are projected onto the contact normal. The third one is the largest number of
        minima of a point; 0: only the closest point of the surface.
        """
        room = self.max_minima if self.minima == "all" else 0
        return self.material.parts, self.facing == "projected", room

    @property
    def count(self) -> int:
        """Number of contacts, one per point."""
        return self.points.count

    @property
    def set_count(self) -> int:
        """Number of point sets on the device."""
        return self.count if self.points.spread else 1

    def parameters(self, part: str) -> dict[str, Any]:
        """Returns the parameters of one part of the material, one value or one per point."""
        return self.material.formulas[part].parameters(area=self.points.areas)

    def area_carrier(self, part: str) -> Surface | None:
        """Returns the surface whose scale affects the area of one part of the material, if any."""
        return self.points.surface if self.material.formulas[part].takes_area else None


def check_owned(label: str, given: Any, kind: type, elements: Mapping[str, Any], method: str) -> None:
    """Raises ``ValueError`` unless ``given`` is one of the ``elements`` of a scene, which ``method`` adds."""
    if not isinstance(given, kind) or elements.get(given.name) is not given:  # type: ignore[attr-defined]
        raise ValueError(f"{label} must come from {method} of this scene, got {checks.element(given)}")


def group_bits(name: str, value: Any) -> int:
    """Returns the bits of groups; raises ``ValueError`` if they are not a whole number of 32 bits."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 0 <= value <= ALL_GROUPS:
        raise ValueError(
            f"{name} must be a whole number from 0 to {ALL_GROUPS:#x}, one bit for each group, got {value!r}"
        )
    return int(value)


def physics_material_name(name: str, value: Any) -> str | None:
    """Returns the checked name of a physics material."""
    if value is not None and (not isinstance(value, str) or not value):
        raise TypeError(f"{name} must be a name, such as 'steel', or None, got {value!r}")
    return value


def options_of(
    name: str,
    kappa: float,
    max_depth: float | None,
    torsion_radius: float | None,
    force_scale: float,
    enabled: bool,
    color: ArrayLike | None,
    visible: bool,
) -> dict[str, Any]:
    """Returns the checked options that all kinds of contacts have; arguments are those of ``add_contact``.

    Raises:
        ValueError: If a value is out of range; the message names it.
    """
    depth = math.inf if max_depth is None else max_depth
    return {
        "kappa": checks.numbers(f"{name}.kappa", kappa, (), KAPPA),
        "max_depth": checks.numbers(f"{name}.max_depth", depth, (), MAX_DEPTH),
        "torsion_radius": None
        if torsion_radius is None
        else checks.numbers(f"{name}.torsion_radius", torsion_radius, (), TORSION_RADIUS),
        "force_scale": checks.numbers(f"{name}.force_scale", force_scale, (), FORCE_SCALE),
        "enabled": np.array(float(checks.switch(f"{name}.enabled", enabled))),
        "color": checks.color(f"{name}.color", color),
        "visible": checks.switch(f"{name}.visible", visible),
    }


def check_arms(name: str, material: ContactMaterial, radius: Array, torsion_radius: float | None) -> None:
    """Raises ``ValueError`` if a part of the material has no radius or lever arm."""
    if torsion_radius is not None and isinstance(material.torsion, Frictionless):
        raise ValueError(f"{name}.torsion_radius is given, but its material has no torsion")
    part = needs_radius(material, torsion_radius is not None)
    if (radius == 0.0).any() and part is not None:
        kind = type(getattr(material, part)).__name__
        cure = " or a torsion_radius" if part == "torsion" else ""
        raise ValueError(f"{name}: the {part} of its material, {kind}, needs a radius{cure}, got a radius of 0 m")


def check_group_angle(name: str, angles: Array) -> Array:
    """Returns pairs of angles (…, 2) [rad] of ``group_angle``; raises ``ValueError`` if one is not possible."""
    first, second = angles[..., 0], angles[..., 1]
    wrong = (second > 0.0) & (second - first < MIN_ANGLE_DIFFERENCE) | (second == 0.0) & (first > 0.0)
    if wrong.any():
        pair = angles[np.unravel_index(int(np.argmax(wrong)), wrong.shape)]
        raise ValueError(
            f"{name}: the second angle must be larger than the first by at least {MIN_ANGLE_DIFFERENCE:g} rad, or both must "
            f"be 0, got ({pair[0]:g}, {pair[1]:g}) rad"
        )
    return angles


def check_areas(name: str, material: ContactMaterial, points: Points) -> None:
    """Raises ``ValueError`` if a part of the material needs areas and the points have none."""
    for part, formula in material.formulas.items():
        if points.areas is None and formula.takes_area:
            raise ValueError(
                f"{name}: the {part} of its material, {type(formula).__name__}, was given no area [m²], and the "
                f"points {points.name!r} have none; create them with wc.sample_surface, pass areas to add_points, or "
                f"give the {part} an area"
            )


def active_of_each(label: str, choices: Any, meshes: Sequence[Mesh]) -> list[NDArray[np.bool_]]:
    """Returns the mask of each of several meshes; ``choices`` has one entry per mesh, or is ``None``."""
    if choices is None:
        choices = [None] * len(meshes)
    listed = isinstance(choices, list | tuple) or getattr(choices, "ndim", 0) > 0
    if not listed or len(choices) != len(meshes):
        got = len(choices) if listed else repr(choices)
        raise ValueError(f"{label} must have one entry for each of {len(meshes)} meshes, got {got}")
    return [
        face_mask(f"{label}[{i}]", choice, mesh)
        for i, (choice, mesh) in enumerate(zip(choices, meshes, strict=True))
    ]


def mesh_of(name: str, mesh: Any) -> Mesh:
    """Returns the checked mesh of surface ``name``."""
    if isinstance(mesh, Mesh):
        return mesh
    if not (hasattr(mesh, "vertices") and hasattr(mesh, "faces")):
        raise TypeError(f"mesh of {name!r} must be a wc.Mesh or have vertices and faces, got {mesh!r}")
    return Mesh(mesh.vertices, mesh.faces, name=name)
