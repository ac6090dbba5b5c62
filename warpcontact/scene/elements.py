"""The elements of a scene: bodies, surfaces, points, contacts, materials, and the ranges of their values."""

from dataclasses import dataclass, field
from typing import Any, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact.algebra import poses
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.contact.contact_evaluation import ContactModel
from warpcontact.kernels.friction import Friction, Frictionless
from warpcontact.kernels.joints import Motion
from warpcontact.kernels.laws import Law
from warpcontact.kernels.types import WORLD
from warpcontact.meshes import Mesh
from warpcontact.meshes.topology import seen_from
from warpcontact.validation.checks import Array, limits

MASS = limits("kg", above=0.0)
AREA = limits("m²", above=0.0)
RADIUS = limits("m", at_least=0.0)
RANGE = limits("m", above=0.0)
KAPPA = limits("-", at_least=0.0, at_most=1.0)
MAX_DEPTH = limits("m", above=0.0, may_be_infinite=True)
SEARCH_RADIUS = limits("m", above=0.0, may_be_infinite=True)
TORSION_RADIUS = limits("m", at_least=0.0)
FORCE_SCALE = limits("-", at_least=0.0)
SCALE = limits("-", above=0.0)
ENABLED = limits("-", at_least=0.0, at_most=1.0)


@explain_keywords_of
@dataclass(frozen=True, kw_only=True)
class ContactMaterial:
    """The force of a contact: a normal-force law and up to three friction models; any number of contacts share it.

    A friction model says what opposes a velocity under the normal force N. Sliding, that is the tangential
    velocity at the point K where the force acts. Rolling, it is the velocity R (ω₁ − ω₂) × n at which the point
    of contact of a sphere of radius R travels, and the model's F acts as the couple R n × F: its coefficient is
    the rolling resistance μ_r, of which M = μ_r R N. In torsion it is r_t (ω₁ − ω₂)·n, with the couple r_t F; see
    ``torsion_radius`` of ``add_contact``.

    Args:
        law: Normal-force law, an instance of a class of ``wc.laws`` or of your own ``wc.Law``.
        friction: Friction model, of ``wc.friction`` or your own ``wc.Friction``; ``None``: frictionless.
        rolling: Friction model of the resistance to rolling; ``None``: none.
        torsion: Friction model of the resistance to spinning about the normal; ``None``: none.
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
                f"ContactMaterial.torsion must be a friction without directions, got {type(self.torsion).__name__}: "
                "there is one axis to spin about"
            )

    @property
    def formulas(self) -> dict[str, Formula]:
        """The law and the friction models by the name of their part."""
        return {name: getattr(self, name) for name in ContactModel._fields}

    @property
    def parts(self) -> ContactModel:
        """Their classes: contacts that agree in them are computed by the same code."""
        return ContactModel(*(type(formula) for formula in self.formulas.values()))


def needs_radius(material: ContactMaterial, has_torsion_radius: bool) -> str | None:
    """Returns the part of ``material`` that a contact without a radius cannot have; ``None``: there is none."""
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
    """A rigid body, or a set of them that is one element. The frame of each sits at its centre of mass.

    Of a set the values of the state, mass and inertia have a first axis, one entry for each of its bodies.
    """

    name: str
    index: int  # of the first on the device
    mass: Array
    inertia: Array  # (3, 3), body axes
    position: Array
    orientation: Array
    linear_velocity: Array
    angular_velocity: Array
    external_force: Array
    external_torque: Array
    motion: Motion  # of a set: that of each of its bodies
    color: Array | None
    count: int = 1  # number of bodies
    single: bool = True  # made by add_body: no item axis

    @property
    def items(self) -> slice:
        """Where its bodies are among those of an environment."""
        return slice(self.index, self.index + self.count)

    def rows(self, key: str) -> Array:
        """Returns a value of each of its bodies, such as ``"mass"``, (n, …)."""
        values: Array = getattr(self, key)
        return values[None] if self.single else values


@dataclass(frozen=True, eq=False)
class Surface:
    """An oriented mesh, or one of several, fixed to a body or to the world."""

    name: str
    index: int
    meshes: tuple[Mesh, ...]
    body: Body | None
    position: Array
    orientation: Array
    scale: Array
    active: tuple[NDArray[np.bool_], ...]  # (F,) of each mesh
    color: Array | None
    visible: bool

    @property
    def mesh(self) -> Mesh:
        """Its mesh, the first if there are several."""
        return self.meshes[0]

    @property
    def active_faces(self) -> NDArray[np.bool_]:
        """Mask (F,) of the faces of that mesh that can touch."""
        return self.active[0]

    @property
    def centre(self) -> Array:
        """Where kernels see its meshes from, in their frame.

        The middle of meshes that lie far from the origin of their frame, where coordinates are coarse. Of others
        the origin: what was modelled at zero stays there, to the last digit.
        """
        bounds = np.array([mesh.bounds for mesh in self.meshes])
        return seen_from(bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0))


@dataclass(frozen=True, eq=False)
class Points:
    """One point, or a set of them, fixed to a body or to the world, or to a surface and moved with that.

    On a set of bodies they are one point on each, in the order of the bodies.
    """

    name: str
    start: int  # index of the first
    body: Body | None
    surface: Surface | None
    positions: Array  # (n, 3), frame of the surface's mesh if they are fixed to one, else of the body [m]
    areas: Array | None  # (n,) the area that each stands for, in the mesh's frame like their positions [m²]
    normals: Array | None  # (n, 3) unit, out of the surface that they are of, in the same frame
    single: bool  # made by add_point: no item axis

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.positions)

    @property
    def spread(self) -> bool:
        """Whether each is on a body of its own."""
        return self.body is not None and not self.body.single

    @property
    def body_numbers(self) -> NDArray[np.int32]:
        """Body of each on the device (n,), or ``WORLD``."""
        first = WORLD if self.body is None else self.body.index
        return np.int32(first) + np.arange(self.count, dtype=np.int32) * np.int32(self.spread)

    @property
    def places(self) -> Array:
        """Where they are in the frame of the body, or of the world, (n, 3) [m]."""
        if self.surface is None:
            return self.positions
        scaled = self.surface.scale * self.positions
        return poses.transform_points(scaled, self.surface.position, self.surface.orientation)


class ContactOptions(TypedDict, total=False):
    """Keywords of ``Scene.add_contact`` that ``Scene.add_surface_contact`` takes, too."""

    radius: ArrayLike
    kappa: float
    search: str
    entry: str
    swept: bool
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
    """Points (with a radius: spheres) that touch a surface.

    On the device they are a set, which moves as one; of points on a set of bodies each is a set of its own.
    """

    name: str
    points: Points
    surface: Surface
    material: ContactMaterial
    radius: Array  # of all, or one per point (n,) [m]
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
    # Of a contact coupling: "all" or "projected", and the force acts at the points; None of an ordinary contact.
    facing: str | None = None

    @property
    def bodies(self) -> tuple[Body | None, Body | None]:
        """What points and surface are fixed to; ``None``: the world."""
        return self.points.body, self.surface.body

    @property
    def code(self) -> tuple[ContactModel, bool]:
        """What its force kernel is chosen by: law and friction models, and whether it weighs by normals."""
        return self.material.parts, self.facing == "projected"

    @property
    def count(self) -> int:
        """Number of contacts, one per point."""
        return self.points.count

    @property
    def set_count(self) -> int:
        """Number of sets on the device that move as one each."""
        return self.count if self.points.spread else 1

    def parameters(self, part: str) -> dict[str, Any]:
        """Returns the values of the parameters of one part of the material, one number each or one per point."""
        return self.material.formulas[part].parameters(area=self.points.areas)

    def area_carrier(self, part: str) -> Surface | None:
        """Returns the surface whose scale enlarges the area of one part of the material, if any."""
        return self.points.surface if self.material.formulas[part].takes_area else None
