"""Data of a scene: bodies, surfaces, points, shapes and force elements; checks all user input.

``SceneData`` combines the mixins of ``add_bodies.py``, ``couplings.py``, ``shapes.py``, ``particles.py`` and
``scene_element.py``. Users get its subclass ``Scene`` (``building/scene.py``), which builds models and imports USD.
"""

import copy
import math
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.catalogue.names import explain_renamed
from warpcontact.meshes import SurfaceSamples
from warpcontact.meshes.mesh import face_mask
from warpcontact.scene.add_bodies import Bodies
from warpcontact.scene.body_contact import BodyContact, BodyContacts
from warpcontact.scene.couplings import Coupling, Couplings
from warpcontact.scene.elements import (
    ALL_GROUPS,
    AREA,
    DEFAULT_GROUP_ANGLE,
    GROUP_ANGLE,
    MINIMA,
    MOST_MINIMA,
    RADIUS,
    SCALE,
    SEARCH_RADIUS,
    Body,
    Contact,
    ContactMaterial,
    ContactOptions,
    Points,
    Surface,
    active_of_each,
    check_areas,
    check_arms,
    check_group_angle,
    check_owned,
    group_bits,
    mesh_of,
    options_of,
    physics_material_name,
)
from warpcontact.scene.particles import ParticleContact, ParticleContacts
from warpcontact.scene.scene_element import ForceElements, SceneElement
from warpcontact.scene.shapes import Shape, ShapeContact, ShapeContacts
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

if TYPE_CHECKING:
    from warpcontact.scene.contact_coupling import ContactCoupling

_LISTS = (
    "bodies",
    "surfaces",
    "points",
    "contacts",
    "contact_couplings",
    "couplings",
    "shapes",
    "shape_contacts",
    "particle_contacts",
    "body_contacts",
    "force_elements",
)


#: Limits beyond which an environment is quarantined.
MAX_SPEED = limits("m/s", above=0.0, may_be_infinite=True)
MAX_DISTANCE = limits("m", above=0.0, may_be_infinite=True)


def _check_max_minima(name: str, value: int) -> int:
    """Returns ``max_minima``; raises ``ValueError`` if it is out of range."""
    number = checks.integer(f"{name}.max_minima", value)
    if number > MOST_MINIMA:
        raise ValueError(f"{name}.max_minima must be at most {MOST_MINIMA}, got {number}")
    return number


@explain_renamed
@explain_keywords_of
class SceneData(Bodies, Couplings, ShapeContacts, ParticleContacts, BodyContacts, ForceElements):
    """Bodies, surfaces, shapes, points, contacts and couplings of one environment; base class of ``Scene``.

    Args:
        gravity: Acceleration of gravity, world axes [m/s²].
        max_speed: Maximum speed of centers of mass [m/s]. If exceeded, the environment is quarantined.
        max_distance: Maximum distance of centers of mass from the origin [m]. If exceeded, the environment is
            quarantined.
    """

    def __init__(
        self,
        gravity: ArrayLike = (0.0, 0.0, -9.81),
        *,
        max_speed: float = math.inf,
        max_distance: float = math.inf,
    ) -> None:
        self.gravity = checks.numbers("gravity", gravity, (3,), limits("m/s²"))
        self.max_speed = float(checks.numbers("max_speed", max_speed, (), MAX_SPEED))
        self.max_distance = float(checks.numbers("max_distance", max_distance, (), MAX_DISTANCE))
        self.bodies: list[Body] = []
        self.surfaces: list[Surface] = []
        self.points: list[Points] = []
        self.contacts: list[Contact] = []
        self.contact_couplings: list[ContactCoupling] = []
        self.couplings: list[Coupling] = []
        self.shapes: list[Shape] = []
        self.shape_contacts: list[ShapeContact] = []
        self.particle_contacts: list[ParticleContact] = []
        self.body_contacts: list[BodyContact] = []
        self.force_elements: list[SceneElement] = []
        self._elements: dict[str, Any] = {}
        self.import_warnings: tuple[str, ...] = ()
        self.suggested_dt: float | None = None
        self.suggested_iterations: int | None = None

    def __repr__(self) -> str:
        kinds: dict[str, Sequence[Any]] = {
            "bodies": self.bodies,
            "surfaces": self.surfaces,
            "points": self.points,
            "shapes": self.shapes,
            "contacts": [
                *self.contacts,
                *self.shape_contacts,
                *self.particle_contacts,
                *self.body_contacts,
                *self.contact_couplings,
            ],
            "couplings": self.couplings,
            "force elements": self.force_elements,
        }
        texts = [f"{kind}: {', '.join(one.name for one in some)}" for kind, some in kinds.items() if some]
        return f"<Scene of {textwrap.shorten('; '.join(texts) or 'nothing yet', 200, placeholder=' …')}>"

    def add_surface(
        self,
        mesh: Any,
        body: Body | None = None,
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        *,
        scale: float = 1.0,
        flip: bool = False,
        active_faces: Any = None,
        name: str | None = None,
        group: int = 1,
        mask: int = ALL_GROUPS,
        physics_material: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> Surface:
        """Adds an oriented surface. From its outer side, the vertices of faces run counter-clockwise.

        Args:
            mesh: A ``wc.Mesh``, or an object with ``vertices`` (V, 3) [m] and ``faces`` (F, 3). With a list of
                meshes, ``model["<surface>.mesh"]`` is the index of the mesh of each environment.
            body: Body to which it is fixed, from ``add_body``; ``None``: the world.
            position: Origin of the mesh frame in the frame of the body [m].
            orientation: Rotation mesh → body, quaternion (x, y, z, w).
            scale: Scale factor of the mesh about the origin of its frame.
            flip: Whether to reverse the orientation of the faces.
            active_faces: Faces that can be in contact: a mask (F,) or face numbers; the name of a group of the mesh,
                or a list of names; or a function that gets the centroids (F, 3) [m], in the mesh frame, and returns
                a mask. Default: all. With a list of meshes, a list with one entry per mesh.
            name: Name in parameters and sensors. Default: generated.
            group: Bits of the groups of the surface, for body contacts.
            mask: Bits of the groups with which it can be in body contact, see ``add_shape``.
            physics_material: Name of its material, for tables of contact materials of ``add_body_contact``.
            color: Display color, RGB in 0…1.
            visible: Whether it is drawn.

        Raises:
            MeshError: If the mesh is not valid for contact; the message names all defects.
            ValueError: If a value is out of range; the message names it.
        """
        name = checks.new_name("surface", name, self._elements)
        body = self.owned_body(f"{name}.body", body)
        if body is not None and not body.single:
            raise ValueError(f"{name}.body must be one body, from add_body, got the set {body.name!r}")
        several = isinstance(mesh, list | tuple)
        meshes = [mesh_of(name, one) for one in (mesh if several else [mesh])]
        if not meshes:
            raise ValueError(f"mesh of {name!r} must not be an empty list")
        active = (
            active_of_each(f"{name}.active_faces", active_faces, meshes)
            if several
            else [face_mask(f"{name}.active_faces", active_faces, meshes[0])]
        )
        surface = Surface(
            name=name,
            index=len(self.surfaces),
            meshes=tuple(one.flipped() if flip else one for one in meshes),
            body=body,
            position=checks.numbers(f"{name}.position", position, (3,), limits("m")),
            orientation=checks.unit_quaternions(
                f"{name}.orientation", checks.numbers(f"{name}.orientation", orientation, (4,))
            ),
            scale=checks.numbers(f"{name}.scale", scale, (), SCALE),
            active=tuple(active),
            group=group_bits(f"{name}.group", group),
            mask=group_bits(f"{name}.mask", mask),
            physics_material=physics_material_name(f"{name}.physics_material", physics_material),
            color=checks.color(f"{name}.color", color),
            visible=checks.switch(f"{name}.visible", visible),
        )
        self.surfaces.append(surface)
        self._elements[name] = surface
        return surface

    def add_point(self, body: Body | Surface | None, position: ArrayLike, *, name: str | None = None) -> Points:
        """Adds a point fixed to ``body`` (``None``: the world) at ``position`` in its frame [m].

        On a surface, the position is in the mesh frame and the point moves with the surface. On a set of bodies, one
        point at this position is added to each body, and sensors of its contacts have an additional axis, ``item``.
        """
        name = checks.new_name("point", name, self._elements)
        place = checks.numbers(f"{name}.position", position, (3,), limits("m"))
        if isinstance(body, Body) and not body.single:
            return self._add_points(name, body, np.tile(place, (body.count, 1)), None, None, single=False)
        return self._add_points(name, body, place[None], None, None, single=True)

    def add_points(
        self,
        body: Body | Surface | None,
        positions: ArrayLike | SurfaceSamples,
        *,
        areas: ArrayLike | None = None,
        name: str | None = None,
    ) -> Points:
        """Adds a set of points. Sensors of its contacts have an additional axis, ``item``.

        Args:
            body: Body or surface to which the points are fixed; ``None``: the world. A set of bodies gets one point
                per body.
            positions: Positions (n, 3) [m] in the frame of the body, or in the mesh frame of the surface; or samples
                from ``wc.sample_surface``, which include areas and normals.
            areas: Area weights (n,) [m²], for laws with an area. On a surface they are areas in the mesh frame and
                are multiplied by the square of its scale.
            name: Name in parameters and sensors. Default: generated.

        Raises:
            ValueError: If a value is out of range; the message names it.
        """
        name = checks.new_name("points", name, self._elements)
        normals = None
        if isinstance(positions, SurfaceSamples):
            if areas is not None:
                raise ValueError(f"{name}.areas must be left out: the points of wc.sample_surface have theirs")
            areas, normals, positions = positions.areas, positions.normals, positions.positions
        shape = checks.shape_of(f"{name}.position", positions)
        if isinstance(body, Body) and not body.single and shape != (body.count, 3):
            raise ValueError(
                f"{name}.position must have shape {(body.count, 3)}, one for each body of {body.name!r}, "
                f"got {shape}"
            )
        if len(shape) != 2 or shape[0] < 1 or shape[1] != 3:
            raise ValueError(f"{name}.position must have shape (n, 3) with n ≥ 1, got {shape}")
        places = checks.numbers(f"{name}.position", positions, shape, limits("m"))
        sizes = None if areas is None else checks.numbers(f"{name}.areas", areas, shape[:1], AREA)
        return self._add_points(name, body, places, sizes, normals, single=False)

    def _add_points(
        self,
        name: str,
        body: Body | Surface | None,
        positions: Array,
        areas: Array | None,
        normals: Array | None,
        single: bool,
    ) -> Points:
        surface = None
        if isinstance(body, Surface):
            self.check_surface(f"{name}.body", body)
            surface, body = body, body.body
        points = Points(
            name=name,
            start=sum(p.count for p in self.points),
            body=self.owned_body(f"{name}.body", body),
            surface=surface,
            positions=positions,
            areas=areas,
            normals=normals,
            single=single,
        )
        self.points.append(points)
        self._elements[name] = points
        return points

    def add_contact(
        self,
        points: Points,
        surface: Surface,
        material: ContactMaterial,
        *,
        radius: ArrayLike = 0.0,
        kappa: float = 0.5,
        search: str = "whole",
        entry: str = "literal",
        swept: bool = False,
        minima: str = "nearest",
        group_angle: ArrayLike = DEFAULT_GROUP_ANGLE,
        max_minima: int = 4,
        max_depth: float | None = None,
        boundary: str = "off",
        search_radius: float = math.inf,
        torsion_radius: float | None = None,
        force_scale: float = 1.0,
        enabled: bool = True,
        name: str | None = None,
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> Contact:
        """Adds contact of points, or spheres around them, with a surface (EULER's ``contactPS2``).

        Args:
            points: From ``add_point`` or ``add_points``.
            surface: From ``add_surface``, on another body.
            material: Contact material.
            radius: Radius of the sphere around each point [m]; 0: a point. For a set of points one value, or (n,).
            kappa: κ of the contact point K = S + κ (D − S): 0 is the closest point S of the surface, 1 the deepest
                point D of the sphere.
            search: ``"whole"``: the closest point of the whole surface is used, and must be on an active face.
                ``"active"``: the closest point on the active faces is used.
            entry: ``"literal"``: any point on the inner side is in contact. ``"latched"``: only points that came from
                the outer side; their contact tracks the part of the surface where they entered.
            swept: Whether to detect points that cross the surface within a step. They stay in contact with the face
                that they crossed, so that thin plates of any thickness hold them.
            minima: ``"nearest"``: the force acts at the closest point of the surface. ``"all"``: at all local minima of
                the distance within the sphere, so that all walls of a groove or corner carry the sphere.
            group_angle: Two angles between the normals of minima [rad]. Up to the first one they act as one contact, from
                the second one on in full. (0, 0): always in full.
            max_minima: Largest number of minima of a sphere, at most 64. If there are more, the deepest act.
            max_depth: Maximum penetration of a contact [m]. Default: unlimited.
            boundary: ``"off"``: no contact beyond the boundary of an open surface. ``"outer"``: a sphere contacts the
                boundary while its center is on the outer side.
            search_radius: Distance beyond which surfaces are ignored [m]; the gap is then this distance minus the
                radius.
            torsion_radius: Lever arm r_t of torsional friction [m]: 2/3 of the radius of a contact patch with uniform
                pressure. Default: (3π/16) √(R δ), for a sphere with Hertzian pressure.
            force_scale: Factor on forces and torques of this contact; for example ½ each for two contacts that
                describe the same pair of surfaces.
            enabled: Whether the contact is enabled.
            name: Name in parameters and sensors. Default: generated.
            color: Color of the force arrows, RGB in 0…1.
            visible: Whether the force arrows are drawn.

        Raises:
            ValueError: If a value is out of range, or both sides are fixed to the same body.
        """
        name = checks.new_name("contact", name, self._elements)
        check_owned(f"points of {name!r}", points, Points, self._elements, "add_point or add_points")
        self.check_surface(f"surface of {name!r}", surface)
        if points.body is surface.body:
            where = f"body {points.body.name!r}" if points.body else "the world"
            raise ValueError(f"{name}: points and surface are both fixed to {where}; one must move")
        if not isinstance(material, ContactMaterial):
            raise TypeError(f"material of {name!r} must be a wc.ContactMaterial, got {material!r}")
        each = () if points.single or not checks.shape_of(f"{name}.radius", radius) else (points.count,)
        size = checks.numbers(f"{name}.radius", radius, each, RADIUS)
        check_arms(name, material, size, torsion_radius)
        check_areas(name, material, points)
        contact = Contact(
            name=name,
            points=points,
            surface=surface,
            material=material,
            radius=size,
            search_radius=checks.numbers(f"{name}.search_radius", search_radius, (), SEARCH_RADIUS),
            search=checks.choice(f"{name}.search", search, ("whole", "active")),
            entry=checks.choice(f"{name}.entry", entry, ("literal", "latched")),
            swept=checks.switch(f"{name}.swept", swept),
            boundary=checks.choice(f"{name}.boundary", boundary, ("off", "outer")),
            minima=checks.choice(f"{name}.minima", minima, MINIMA),
            group_angle=check_group_angle(
                f"{name}.group_angle", checks.numbers(f"{name}.group_angle", group_angle, (2,), GROUP_ANGLE)
            ),
            max_minima=_check_max_minima(name, max_minima),
            **options_of(name, kappa, max_depth, torsion_radius, force_scale, enabled, color, visible),
        )
        if minima == "all" and search == "whole" and not all(active.all() for active in surface.active):
            raise ValueError(
                f"{name}: minima='all' needs search='active', because {surface.name!r} has faces that are not active: with "
                "search='whole' the closest of them would exclude the minima on active faces"
            )
        if search == "active" and not all(active.any() for active in surface.active):
            raise ValueError(f"{name}: search='active' needs at least one active face on {surface.name!r}")
        self.contacts.append(contact)
        self._elements[name] = contact
        return contact

    def add_surface_contact(
        self,
        surface_a: Surface,
        surface_b: Surface,
        material: ContactMaterial,
        *,
        samples: int | str | Sequence[int | str] = 500,
        seed: int = 0,
        sides: str = "first",
        name: str | None = None,
        **options: Unpack[ContactOptions],
    ) -> tuple[Contact, ...]:
        """Adds contact of two surfaces by sample points with area weights.

        The points are on the active faces and fixed to their surface. Both bodies get equal and opposite forces at the
        same point, for any value of ``sides``. Faces of one surface without points of the other have no force; for solids on
        solids, use ``add_body_contact``. ``build`` warns of vertices of a closed mesh in contact with a closed mesh.

        Args:
            surface_a: From ``add_surface``.
            surface_b: From ``add_surface``, on another body.
            material: Contact material. Laws with an area, such as ``ElasticFoundation`` and ``ContactRange``, use the
                area weight of each point; the total force then does not depend on the number of points.
            samples: Number of points, distributed evenly, or ``"vertices"`` or ``"centroids"``; see
                ``wc.sample_surface``. With ``sides="average"``, a pair sets each surface separately.
            seed: Seed of the random distribution of points.
            sides: ``"first"``: points of ``surface_a`` contact ``surface_b``. ``"average"``: points of each surface
                contact the other one, as two contacts with half the ``force_scale``.
            name: Name of the contact, or prefix of ``<name>_first`` and ``<name>_second``. The name of the points is
                that of the contact with the suffix ``_points``. Default: generated.
            **options: Further options of ``add_contact``: ``radius``, ``kappa``, ``search``, ``max_depth``, …

        Returns:
            One or two contacts; the first is that of the points of ``surface_a``.

        Raises:
            ValueError: If a value is out of range; the message names it. The scene is unchanged then.
        """
        from warpcontact.scene.surface_contact import add_surface_contact

        return add_surface_contact(
            self, surface_a, surface_b, material, samples, seed=seed, sides=sides, name=name, options=options
        )

    def element_names(self) -> tuple[str, ...]:
        """Returns the names of all elements."""
        return tuple(self._elements)

    def elements(self) -> tuple[Any, ...]:
        """Returns all elements in the order of their creation."""
        return tuple(self._elements.values())

    def new_name(self, kind: str, name: str | None) -> str:
        """Returns ``name`` if it is valid and not in use, or a name generated from ``kind`` if it is ``None``."""
        return checks.new_name(kind, name, self._elements)

    def include(self, coupling: "ContactCoupling") -> None:
        """Adds a contact coupling, whose contacts were already added."""
        self.contact_couplings.append(coupling)
        self._elements[coupling.name] = coupling

    def exchange(self, contact: Contact, other: Contact) -> None:
        """Replaces ``contact`` by ``other``, which has the same name."""
        self.contacts[self.contacts.index(contact)] = other
        self._elements[other.name] = other

    @contextmanager
    def unchanged_on_error(self) -> Iterator[None]:
        """Removes the elements that were added in a block that raises an error; a context manager."""
        earlier = self.snapshot()
        try:
            yield
        except Exception:
            for name in (*_LISTS, "_elements"):
                setattr(self, name, getattr(earlier, name))
            raise

    def snapshot(self) -> "SceneData":
        """Returns a shallow copy; elements that are added to this scene later are not in it."""
        copied = copy.copy(self)
        for name in _LISTS:
            setattr(copied, name, list(getattr(self, name)))
        copied._elements = dict(self._elements)
        return copied

    def check_surface(self, label: str, surface: Any) -> None:
        """Raises ``ValueError`` unless ``surface`` belongs to this scene; ``label`` is its name in the message."""
        check_owned(label, surface, Surface, self._elements, "add_surface")

    def owned_body(self, name: str, body: Body | None) -> Body | None:
        """Returns ``body`` if it belongs to this scene or is ``None``; ``name`` is used in the error message."""
        if body is not None and (not isinstance(body, Body) or self._elements.get(body.name) is not body):
            raise ValueError(f"{name} must be a body of this scene or None (the world), got {body!r}")
        return body
