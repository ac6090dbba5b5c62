"""What there is: bodies, surfaces, points and contacts, as a user says them. All input is checked here."""

import copy
import math
import os
import textwrap
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.catalogue.renamed import explain_renamed
from warpcontact.meshes import SurfaceSamples
from warpcontact.meshes.groups import face_mask
from warpcontact.scene.add_bodies import Bodies
from warpcontact.scene.add_couplings import Couplings
from warpcontact.scene.add_particles import ParticleContacts
from warpcontact.scene.add_shapes import ShapeContacts
from warpcontact.scene.couplings import Coupling
from warpcontact.scene.elements import (
    AREA,
    RADIUS,
    SCALE,
    SEARCH_RADIUS,
    Body,
    Contact,
    ContactMaterial,
    ContactOptions,
    Points,
    Surface,
)
from warpcontact.scene.mesh_arguments import active_of_each, check_areas, check_arms, mesh_of, options_of
from warpcontact.scene.particles import ParticleContact
from warpcontact.scene.shapes import Shape, ShapeContact
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

if TYPE_CHECKING:
    from warpcontact.kernels.catalogue.device_model import Formula
    from warpcontact.meshes.isolation import Limits
    from warpcontact.model.model import Model
    from warpcontact.model.split_model import SplitModel
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
)


#: What an environment may do before it is put into quarantine.
MAX_SPEED = limits("m/s", above=0.0, may_be_infinite=True)
MAX_DISTANCE = limits("m", above=0.0, may_be_infinite=True)


@explain_renamed
@explain_keywords_of
class Scene(Bodies, Couplings, ShapeContacts, ParticleContacts):
    """Bodies, surfaces, shapes, points, contacts and couplings of one environment; ``build`` makes many of it.

    Args:
        gravity: Acceleration of gravity, world axes [m/s²].
        max_speed: A centre of mass that gets faster fails the step, and the environment is put into quarantine
            [m/s].
        max_distance: Likewise one that gets farther from the origin [m].

    Attributes:
        import_warnings: What to know of how a USD stage was read, see ``from_usd``.
        suggested_dt: Time step that the NewtonSceneAPI of that stage requests [s]; ``None``: none.
        suggested_iterations: Likewise the largest number of iterations of a solver in a step.
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
            "contacts": [*self.contacts, *self.shape_contacts, *self.particle_contacts, *self.contact_couplings],
            "couplings": self.couplings,
        }
        told = [f"{kind}: {', '.join(one.name for one in some)}" for kind, some in kinds.items() if some]
        return f"<Scene of {textwrap.shorten('; '.join(told) or 'nothing yet', 200, placeholder=' …')}>"

    @classmethod
    def from_usd(
        cls,
        path: str | os.PathLike[str],
        *,
        custom_types: "Iterable[type[Formula]]" = (),
        material: ContactMaterial | None = None,
        contact_time: float = 0.01,
        samples: int | str = "vertices",
        skip_unsupported: bool = False,
        trusted: bool = False,
        limits: "Limits | None" = None,
    ) -> "Scene":
        """Returns the scene of a USD stage: one that ``export_usd`` wrote, or one of UsdPhysics.

        Of a stage of ours it is the scene that was simulated, to the bit. Of others rigid bodies, masses,
        colliders, physics materials, gravity and collision groups are read, in SI units with z up;
        ``docs/usd.md`` says how, and which contacts are made. The file is read in a process of its own, as by
        ``wc.load_mesh``.

        Args:
            path: A .usd, .usda, .usdc or .usdz file.
            custom_types: Laws, friction models, springs, motions and shapes of one's own that a stage of ours was made with.
            material: Of a stage of others, law and friction of all contacts; ``None``: what its materials say.
            contact_time: Time that an impact takes there, which the stiffness of contacts follows from [s].
            samples: How points of meshes that touch meshes are made there, as for ``add_surface_contact``.
            skip_unsupported: Whether to leave out what there is no counterpart for, such as joints, and list it in
                ``import_warnings``; otherwise it is an error.
            trusted: Whether to read the file in this process, and files out of its folder that it refers to.
            limits: Memory, time and size of its meshes.

        Raises:
            UsdError: If it cannot be read, something in it makes no sense, or there is no counterpart for it.
                Everything that is in the way is listed, with the path of its prim.
            ValueError: If another argument is out of range; the message names it.
        """
        from warpcontact.usd.importing.scene_from_stage import scene_from_usd

        return scene_from_usd(
            path,
            custom_types=custom_types,
            material=material,
            contact_time=contact_time,
            samples=samples,
            skip_unsupported=skip_unsupported,
            trusted=trusted,
            limits=limits,
        )

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
        color: ArrayLike | None = None,
        visible: bool = True,
    ) -> Surface:
        """Adds an oriented surface: its outer side is where the faces run counter-clockwise.

        Args:
            mesh: A ``wc.Mesh``, or an object with ``vertices`` (V, 3) [m] and ``faces`` (F, 3). A list of them:
                ``model["<surface>.mesh"]`` then says by number which one an environment has.
            body: Body that carries it, from ``add_body``; ``None``: the world.
            position: Origin of the mesh's frame in the frame of the body [m].
            orientation: Rotation mesh → body, quaternion (x, y, z, w).
            scale: Factor by which the mesh is enlarged about the origin of its frame.
            flip: Whether to turn the outer side over.
            active_faces: The part that can touch: a mask (F,) or face numbers; the name of a group of the mesh,
                or a list of names; or a function that is given the centroids (F, 3) [m], in the frame of the
                mesh, and returns a mask; ``None``: all. For a list of meshes, a list
                with one of these for each.
            name: Name in parameters and sensors; made up if not given.
            color: Display colour, RGB in 0…1.
            visible: Whether it is drawn.

        Raises:
            MeshError: If the mesh cannot carry contact; every defect is named.
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
            color=checks.color(f"{name}.color", color),
            visible=checks.switch(f"{name}.visible", visible),
        )
        self.surfaces.append(surface)
        self._elements[name] = surface
        return surface

    def add_point(self, body: Body | Surface | None, position: ArrayLike, *, name: str | None = None) -> Points:
        """Adds a point fixed to ``body`` (``None``: the world) at ``position`` in its frame [m].

        On a surface it is in the frame of the mesh, and moves with that. On a set of bodies it is one point on
        each of them, at the same place of all, and sensors of its contacts have one more axis, ``item``.
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
        """Adds a set of points. Sensors of its contacts have one more axis, ``item``.

        Args:
            body: What carries them: a body, ``None`` for the world, or a surface, with which they move; a set of
                bodies, which are given one each.
            positions: Where they are in its frame, (n, 3) [m], of a surface in that of its mesh; or points with
                their areas, from ``wc.sample_surface``.
            areas: The area that each stands for, (n,) [m²], for laws that leave it to the points; on a surface
                that in its mesh, to which the square of its scale comes.
            name: Name in parameters and sensors; made up if not given.

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
            surface = self._surface(f"{name}.body", body)
            body = surface.body
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
        """Adds the contact of points, or spheres about them, with a surface (EULER's ``contactPS2``).

        Args:
            points: From ``add_point`` or ``add_points``.
            surface: From ``add_surface``, on another body.
            material: Law and friction.
            radius: Radius of the sphere about each point [m]; 0: a point. Of a set of points one for all, or (n,).
            kappa: Where the force acts: K = S + κ (D − S), from 0 on the surface to 1 at the deepest point D.
            search: ``"whole"``: the nearest point of the whole surface must be active; ``"active"``: the
                nearest point of the active part.
            entry: ``"literal"``: any point on the inner side is in contact; ``"latched"``: only one that came
                from the outer side, held by the part of the surface that it touched.
            swept: Whether to look for points that cross the surface within a step, which are then held by the
                face that they crossed, through however thin a plate.
            max_depth: Deepest penetration that still counts as contact [m]; ``None``: any.
            boundary: ``"off"``: nothing touches beyond an open boundary; ``"outer"``: a sphere touches the boundary while
                its centre is on the outer side.
            search_radius: Surfaces farther than this from a point are not seen [m]; its gap then is this
                bound less the radius.
            torsion_radius: Arm r_t at which the material's torsion acts [m]: 2/3 of the radius of a patch under
                uniform pressure. ``None``: that of the overlap of a sphere under the pressure of Hertz,
                (3π/16) √(R δ).
            force_scale: Factor on the forces and couples of this contact: ½ each for two that describe the same touch.
            enabled: Whether it acts.
            name: Name in parameters and sensors; made up if not given.
            color: Colour of its arrows, RGB in 0…1.
            visible: Whether its arrows are drawn.

        Raises:
            ValueError: If a value is out of range, or both sides are fixed to the same body.
        """
        name = checks.new_name("contact", name, self._elements)
        if not isinstance(points, Points) or self._elements.get(points.name) is not points:
            raise ValueError(
                f"points of {name!r} must come from add_point or add_points of this scene, got "
                f"{checks.element(points)}"
            )
        surface = self._surface(f"surface of {name!r}", surface)
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
            **options_of(name, kappa, max_depth, torsion_radius, force_scale, enabled, color, visible),
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
        """Adds the contact of two surfaces: points of one, with the area that each stands for, touch the other.

        The points are those of the active faces, fixed to their surface. Whatever the bookkeeping of sides, both
        bodies get the same force at the same point.

        Args:
            surface_a: From ``add_surface``.
            surface_b: From ``add_surface``, on another body.
            material: Law and friction. Laws with an area, such as ``ElasticFoundation`` and ``ContactRange``, take
                that of each point; the force then does not depend on how many there are.
            samples: Number of points, spread evenly, or ``"vertices"`` or ``"centroids"``: see
                ``wc.sample_surface``. With two sides a pair gives each its own.
            seed: Of the random numbers that spread them.
            sides: ``"first"``: points of ``surface_a`` touch ``surface_b``. ``"average"``: points of each touch
                the other, in two contacts with the share ½.
            name: Name of the contact; of two, ``<name>_first`` and ``<name>_second``. The points are called like
                their contact, with ``_points`` behind. Made up if not given.
            **options: Others of ``add_contact``: ``radius``, ``kappa``, ``search``, ``max_depth``, …

        Returns:
            The contacts, one or two: that of the points of ``surface_a`` is the first.

        Raises:
            ValueError: If a value is out of range; the message names it, and the scene is as before.
        """
        from warpcontact.scene.surface_contact import add_surface_contact

        return add_surface_contact(
            self, surface_a, surface_b, material, samples, seed=seed, sides=sides, name=name, options=options
        )

    def build(
        self, envs: int = 1, device: str | Sequence[str] = "auto", precision: str = "float32"
    ) -> "Model | SplitModel":
        """Builds ``envs`` environments of this scene on a device or several; see ``warpcontact.model.build.build``."""
        from warpcontact.model.build import build

        return build(self, envs=envs, device=device, precision=precision)

    def element_names(self) -> tuple[str, ...]:
        """Returns the names of all elements."""
        return tuple(self._elements)

    def elements(self) -> tuple[Any, ...]:
        """Returns all elements in the order in which they were added."""
        return tuple(self._elements.values())

    def new_name(self, kind: str, name: str | None) -> str:
        """Returns ``name`` if an element can have it, or one made from ``kind`` if it is ``None``."""
        return checks.new_name(kind, name, self._elements)

    def include(self, coupling: "ContactCoupling") -> None:
        """Adds a contact coupling, whose contacts are there."""
        self.contact_couplings.append(coupling)
        self._elements[coupling.name] = coupling

    def exchange(self, contact: Contact, other: Contact) -> None:
        """Puts ``other``, of the same name, in the place of ``contact``."""
        self.contacts[self.contacts.index(contact)] = other
        self._elements[other.name] = other

    def restore(self, earlier: "Scene") -> None:
        """Takes back what was added since the snapshot ``earlier``."""
        for name in (*_LISTS, "_elements"):
            setattr(self, name, getattr(earlier, name))

    def snapshot(self) -> "Scene":
        """Returns a copy that what is added to this scene later does not change."""
        copied = copy.copy(self)
        for name in _LISTS:
            setattr(copied, name, list(getattr(self, name)))
        copied._elements = dict(self._elements)
        return copied

    def _surface(self, label: str, surface: Surface) -> Surface:
        if not isinstance(surface, Surface) or self._elements.get(surface.name) is not surface:
            raise ValueError(f"{label} must come from add_surface of this scene, got {checks.element(surface)}")
        return surface

    def owned_body(self, name: str, body: Body | None) -> Body | None:
        """Returns ``body`` if it is one of this scene, or ``None``; ``name`` is what an error calls it."""
        if body is not None and (not isinstance(body, Body) or self._elements.get(body.name) is not body):
            raise ValueError(f"{name} must be a body of this scene or None (the world), got {body!r}")
        return body
