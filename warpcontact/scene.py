"""What there is: bodies, surfaces, points and contacts, as a user says them. All input is checked here."""

import copy
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact import checks
from warpcontact.checks import Array, limits
from warpcontact.kernels.contact_force import Parts
from warpcontact.kernels.formula import Formula
from warpcontact.kernels.frictions import Friction, Frictionless
from warpcontact.kernels.laws import Law
from warpcontact.meshes import Mesh
from warpcontact.meshes.groups import FaceChoice, face_mask

if TYPE_CHECKING:
    from warpcontact.model import Model

MASS = limits("kg", above=0.0)
RADIUS = limits("m", at_least=0.0)
KAPPA = limits("-", at_least=0.0, at_most=1.0)
MAX_DEPTH = limits("m", above=0.0, may_be_infinite=True)
SEARCH_RADIUS = limits("m", above=0.0, may_be_infinite=True)
TORSION_RADIUS = limits("m", at_least=0.0)
ENABLED = limits("-", at_least=0.0, at_most=1.0)


@dataclass(frozen=True, kw_only=True)
class Template:
    """The force of a contact: a normal-force law and up to three friction models; any number of contacts share it.

    A friction model says what opposes a velocity under the normal force N. Sliding, that is the tangential
    velocity at the point K where the force acts. Rolling, it is the velocity R (ω₁ − ω₂) × n at which the point
    of contact of a sphere of radius R travels, and the model's F acts as the couple R n × F: its coefficient is
    the rolling resistance μ_r, of which M = μ_r R N. In torsion it is r_t (ω₁ − ω₂)·n, with the couple r_t F; see
    ``torsion_radius`` of ``add_contact``.

    Args:
        law: Normal-force law, an instance of a class of ``wc.laws`` or of your own ``wc.Law``.
        friction: Friction model, of ``wc.frictions`` or your own ``wc.Friction``; ``None``: frictionless.
        rolling: Friction model of the resistance to rolling; ``None``: none.
        torsion: Friction model of the resistance to spinning about the normal; ``None``: none.
    """

    law: Law
    friction: Friction = field(default_factory=Frictionless)
    rolling: Friction = field(default_factory=Frictionless)
    torsion: Friction = field(default_factory=Frictionless)

    def __post_init__(self) -> None:
        for name in Parts._fields:
            kind = Law if name == "law" else Friction
            if name != "law" and getattr(self, name) is None:
                object.__setattr__(self, name, Frictionless())
            if not isinstance(getattr(self, name), kind):
                raise TypeError(
                    f"Template.{name} must be an instance of wc.{kind.__name__}, got {getattr(self, name)!r}"
                )
        if self.torsion.directional:
            raise ValueError(
                f"Template.torsion must be a friction without directions, got {type(self.torsion).__name__}: "
                "there is one axis to spin about"
            )

    @property
    def formulas(self) -> dict[str, Formula]:
        """The law and the frictions by the name of their part."""
        return {name: getattr(self, name) for name in Parts._fields}

    @property
    def parts(self) -> Parts:
        """Their classes: contacts that agree in them are computed by the same code."""
        return Parts(*(type(formula) for formula in self.formulas.values()))


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body. Its frame sits at the centre of mass."""

    name: str
    index: int
    mass: Array
    inertia: Array  # (3, 3), body axes
    position: Array
    orientation: Array
    linear_velocity: Array
    angular_velocity: Array
    color: Array | None


@dataclass(frozen=True, eq=False)
class Surface:
    """An oriented mesh fixed to a body or to the world."""

    name: str
    index: int
    mesh: Mesh
    body: Body | None
    position: Array
    orientation: Array
    active_faces: NDArray[np.bool_]  # (F,)
    color: Array | None
    visible: bool


@dataclass(frozen=True, eq=False)
class Points:
    """One point, or a set of them, fixed to a body or to the world."""

    name: str
    start: int  # index of the first
    body: Body | None
    positions: Array  # (n, 3), frame of the body
    single: bool  # made by add_point: no item axis


@dataclass(frozen=True, eq=False)
class Contact:
    """Points (with a radius: spheres) that touch a surface."""

    name: str
    points: Points
    surface: Surface
    template: Template
    radius: Array
    kappa: Array
    max_depth: Array
    search_radius: Array
    torsion_radius: Array | None
    enabled: Array
    search: str
    entry: str
    rim: str
    color: Array | None
    visible: bool

    @property
    def count(self) -> int:
        """Number of contacts, one per point."""
        return len(self.points.positions)


class Scene:
    """Bodies, surfaces, points and contacts of one environment; ``build`` makes many of it.

    Args:
        gravity: Acceleration of gravity, world axes [m/s²].
    """

    def __init__(self, gravity: ArrayLike = (0.0, 0.0, -9.81)) -> None:
        self.gravity = checks.numbers("gravity", gravity, (3,), limits("m/s²"))
        self.bodies: list[Body] = []
        self.surfaces: list[Surface] = []
        self.points: list[Points] = []
        self.contacts: list[Contact] = []
        self._elements: dict[str, Any] = {}

    def add_body(
        self,
        mass: float,
        inertia: ArrayLike,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        linear_velocity: ArrayLike = (0.0, 0.0, 0.0),
        angular_velocity: ArrayLike = (0.0, 0.0, 0.0),
        *,
        name: str | None = None,
        color: ArrayLike | None = None,
    ) -> Body:
        """Adds a rigid body.

        Args:
            mass: Mass [kg], positive.
            inertia: Inertia about the centre of mass in body axes [kg·m²]: three principal moments or a
                symmetric 3×3 tensor.
            position: Initial position of the centre of mass, world [m].
            orientation: Initial rotation body → world, quaternion (x, y, z, w).
            linear_velocity: Initial velocity of the centre of mass, world [m/s].
            angular_velocity: Initial angular velocity, world axes [rad/s].
            name: Name in parameters and readings; made up if not given.
            color: Display colour, RGB in 0…1.

        Raises:
            ValueError: If a value is out of range; the message names it.
        """
        name = checks.new_name("body", name, self._elements)
        tensor = np.array(inertia, dtype=np.float64) if np.ndim(inertia) else np.zeros(())
        if tensor.shape == (3,):
            tensor = np.diag(tensor)
        elif tensor.shape != (3, 3):
            raise ValueError(f"{name}.inertia must be 3 numbers or a 3×3 tensor [kg·m²], got {inertia!r}")
        tensor = checks.numbers(f"{name}.inertia", tensor, (3, 3), limits("kg·m²"))
        body = Body(
            name=name,
            index=len(self.bodies),
            mass=checks.numbers(f"{name}.mass", mass, (), MASS),
            inertia=checks.inertia_tensors(f"{name}.inertia", tensor),
            position=checks.numbers(f"{name}.position", position, (3,), limits("m")),
            orientation=checks.unit_quaternions(
                f"{name}.orientation", checks.numbers(f"{name}.orientation", orientation, (4,))
            ),
            linear_velocity=checks.numbers(f"{name}.linear_velocity", linear_velocity, (3,), limits("m/s")),
            angular_velocity=checks.numbers(f"{name}.angular_velocity", angular_velocity, (3,), limits("rad/s")),
            color=checks.color(f"{name}.color", color),
        )
        self.bodies.append(body)
        self._elements[name] = body
        return body

    def add_surface(
        self,
        mesh: Any,
        body: Body | None = None,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        *,
        flip: bool = False,
        active_faces: FaceChoice = None,
        name: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> Surface:
        """Adds an oriented surface: its outer side is where the faces run counter-clockwise.

        Args:
            mesh: A ``wc.Mesh``, or an object with ``vertices`` (V, 3) [m] and ``faces`` (F, 3).
            body: Body that carries it; ``None``: the world.
            position: Origin of the mesh's frame in the frame of the body [m].
            orientation: Rotation mesh → body, quaternion (x, y, z, w).
            flip: Whether to turn the outer side over.
            active_faces: The part that can touch: a mask (F,) or face numbers; the name of a group of the mesh,
                or a list of names; or a function that is given the centroids (F, 3) [m], in the frame of the
                mesh, and returns a mask; ``None``: all.
            name: Name in parameters and readings; made up if not given.
            color: Display colour, RGB in 0…1.
            visible: Whether it is drawn.

        Raises:
            MeshError: If the mesh cannot carry contact; every defect is named.
            ValueError: If a value is out of range; the message names it.
        """
        name = checks.new_name("surface", name, self._elements)
        body = self._body(f"{name}.body", body)
        if not isinstance(mesh, Mesh):
            if not (hasattr(mesh, "vertices") and hasattr(mesh, "faces")):
                raise TypeError(f"mesh of {name!r} must be a wc.Mesh or have vertices and faces, got {mesh!r}")
            mesh = Mesh(mesh.vertices, mesh.faces, name=name)
        surface = Surface(
            name=name,
            index=len(self.surfaces),
            mesh=mesh.flipped() if flip else mesh,
            body=body,
            position=checks.numbers(f"{name}.position", position, (3,), limits("m")),
            orientation=checks.unit_quaternions(
                f"{name}.orientation", checks.numbers(f"{name}.orientation", orientation, (4,))
            ),
            active_faces=face_mask(f"{name}.active_faces", active_faces, mesh),
            color=checks.color(f"{name}.color", color),
            visible=bool(visible),
        )
        self.surfaces.append(surface)
        self._elements[name] = surface
        return surface

    def add_point(self, body: Body | None, position: ArrayLike, *, name: str | None = None) -> Points:
        """Adds a point fixed to ``body`` (``None``: the world) at ``position`` in its frame [m]."""
        name = checks.new_name("point", name, self._elements)
        place = checks.numbers(f"{name}.position", position, (3,), limits("m"))
        return self._add_points(name, body, place[None], single=True)

    def add_points(self, body: Body | None, positions: ArrayLike, *, name: str | None = None) -> Points:
        """Adds a set of points fixed to ``body`` at ``positions`` (n, 3) in its frame [m].

        Readings of its contacts have one more axis, ``item``.
        """
        name = checks.new_name("points", name, self._elements)
        shape = np.shape(positions)
        if len(shape) != 2 or shape[0] < 1 or shape[1] != 3:
            raise ValueError(f"{name}.position must have shape (n, 3) with n ≥ 1, got {shape}")
        places = checks.numbers(f"{name}.position", positions, shape, limits("m"))
        return self._add_points(name, body, places, single=False)

    def _add_points(self, name: str, body: Body | None, positions: Array, single: bool) -> Points:
        points = Points(
            name=name,
            start=sum(len(p.positions) for p in self.points),
            body=self._body(f"{name}.body", body),
            positions=positions,
            single=single,
        )
        self.points.append(points)
        self._elements[name] = points
        return points

    def add_contact(
        self,
        points: Points,
        surface: Surface,
        template: Template,
        *,
        radius: float = 0.0,
        kappa: float = 0.5,
        search: str = "whole",
        entry: str = "literal",
        max_depth: float | None = None,
        rim: str = "off",
        search_radius: float = math.inf,
        torsion_radius: float | None = None,
        enabled: bool = True,
        name: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> Contact:
        """Adds the contact of points, or spheres about them, with a surface (EULER's ``contactPS2``).

        Args:
            points: From ``add_point`` or ``add_points``.
            surface: From ``add_surface``, on another body.
            template: Law and friction.
            radius: Radius of the sphere about each point [m]; 0: a point.
            kappa: Where the force acts: K = S + κ (D − S), from 0 on the surface to 1 at the deepest point D.
            search: ``"whole"``: the nearest point of the whole surface must be active; ``"active"``: the
                nearest point of the active part.
            entry: ``"literal"``: any point on the inner side is in contact; ``"latched"``: only one that came
                from the outer side.
            max_depth: Deepest penetration that still counts as contact [m]; ``None``: any.
            rim: ``"off"``: nothing touches beyond an open border; ``"outer"``: a sphere touches the rim while
                its centre is on the outer side.
            search_radius: Surfaces farther than this from a point are not seen [m]; its gap then is this
                bound less the radius.
            torsion_radius: Arm r_t at which the template's torsion acts [m]: 2/3 of the radius of a patch under
                uniform pressure. ``None``: that of the overlap of a sphere under the pressure of Hertz,
                (3π/16) √(R δ).
            enabled: Whether it acts.
            name: Name in parameters and readings; made up if not given.
            color: Colour of its arrows, RGB in 0…1.
            visible: Whether its arrows are drawn.

        Raises:
            ValueError: If a value is out of range, or both sides are fixed to the same body.
        """
        name = checks.new_name("contact", name, self._elements)
        if not isinstance(points, Points) or self._elements.get(points.name) is not points:
            raise ValueError(f"points of {name!r} must come from add_point or add_points of this scene")
        if not isinstance(surface, Surface) or self._elements.get(surface.name) is not surface:
            raise ValueError(f"surface of {name!r} must come from add_surface of this scene")
        if points.body is surface.body:
            where = f"body {points.body.name!r}" if points.body else "the world"
            raise ValueError(f"{name}: points and surface are both fixed to {where}; one must move")
        if not isinstance(template, Template):
            raise TypeError(f"template of {name!r} must be a wc.Template, got {template!r}")
        size = checks.numbers(f"{name}.radius", radius, (), RADIUS)
        _check_arms(name, template, size, torsion_radius)
        contact = Contact(
            name=name,
            points=points,
            surface=surface,
            template=template,
            radius=size,
            kappa=checks.numbers(f"{name}.kappa", kappa, (), KAPPA),
            max_depth=checks.numbers(
                f"{name}.max_depth", math.inf if max_depth is None else max_depth, (), MAX_DEPTH
            ),
            search_radius=checks.numbers(f"{name}.search_radius", search_radius, (), SEARCH_RADIUS),
            torsion_radius=None
            if torsion_radius is None
            else checks.numbers(f"{name}.torsion_radius", torsion_radius, (), TORSION_RADIUS),
            enabled=np.array(float(bool(enabled))),
            search=checks.choice(f"{name}.search", search, ("whole", "active")),
            entry=checks.choice(f"{name}.entry", entry, ("literal", "latched")),
            rim=checks.choice(f"{name}.rim", rim, ("off", "outer")),
            color=checks.color(f"{name}.color", color),
            visible=bool(visible),
        )
        if search == "active" and not surface.active_faces.any():
            raise ValueError(f"{name}: search='active' needs at least one active face on {surface.name!r}")
        self.contacts.append(contact)
        self._elements[name] = contact
        return contact

    def build(self, envs: int = 1, device: str = "auto", precision: str = "float32") -> "Model":
        """Builds ``envs`` environments of this scene on a device; see ``warpcontact.build.build``."""
        from warpcontact.build import build

        return build(self, envs=envs, device=device, precision=precision)

    def element_names(self) -> tuple[str, ...]:
        """Returns the names of all elements."""
        return tuple(self._elements)

    def snapshot(self) -> "Scene":
        """Returns a copy that what is added to this scene later does not change."""
        copied = copy.copy(self)
        for name in ("bodies", "surfaces", "points", "contacts"):
            setattr(copied, name, list(getattr(self, name)))
        copied._elements = dict(self._elements)
        return copied

    def _body(self, name: str, body: Body | None) -> Body | None:
        if body is not None and (not isinstance(body, Body) or self._elements.get(body.name) is not body):
            raise ValueError(f"{name} must be a body of this scene or None (the world), got {body!r}")
        return body


def needs_radius(template: Template, has_torsion_radius: bool) -> str | None:
    """Returns the part of ``template`` that a contact without a radius cannot have; ``None``: there is none."""
    if template.friction.needs_radius:
        return "friction"
    if not isinstance(template.rolling, Frictionless):
        return "rolling"
    torsion = template.torsion
    if not isinstance(torsion, Frictionless) and (not has_torsion_radius or torsion.needs_radius):
        return "torsion"
    return None


def _check_arms(name: str, template: Template, radius: Array, torsion_radius: float | None) -> None:
    """Raises ``ValueError`` if a friction of the template would have no arm to act at."""
    if torsion_radius is not None and isinstance(template.torsion, Frictionless):
        raise ValueError(f"{name}.torsion_radius is given, but its template has no torsion")
    part = needs_radius(template, torsion_radius is not None)
    if radius == 0.0 and part is not None:
        kind = type(getattr(template, part)).__name__
        cure = " or a torsion_radius" if part == "torsion" else ""
        raise ValueError(f"{name}: the {part} of its template, {kind}, needs a radius{cure}, got a radius of 0 m")
