"""Selects contact pairs of imported colliders and adds their contacts; rules in ``docs/usd.md``."""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import astuple, dataclass
from itertools import islice, pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, KDTree, QhullError

from warpcontact.kernels import shapes
from warpcontact.meshes import sample_surface
from warpcontact.scene.body_contact import Solid, unsupported_reason
from warpcontact.scene.elements import Body, ContactMaterial, Points, Surface
from warpcontact.scene.material_table import MaterialTable
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.shapes import Shape
from warpcontact.usd.importing.contact_materials import ContactMaterials, PhysicsMaterial, Side
from warpcontact.usd.importing.findings import InvalidValue
from warpcontact.usd.importing.shapes import ColliderShape
from warpcontact.usd.materials import rolling_radius
from warpcontact.validation.checks import Array

#: Number of points that may carry their full force; with more, each carries a fraction. With this number, a dashpot at
#: the smallest restitution is stable at time steps of 1/50 of the contact time.
FULL_FORCE_POINTS = 4
# Thickness of a flat part, as a fraction of the size of the point set.
_FLAT = 0.01
# Largest number of points and hull facets that are tested.
_MAX_TRIED = 256

#: Sampling of meshes in pairs that body contact does not support.
DEFAULT_SAMPLES = "vertices"

Numbers = npt.NDArray[np.int64]

#: More than this number of moving spheres and capsules of one material form a particle contact.
MIN_PARTICLES = 32
#: More than this number of pairs of one material form one body contact.
MIN_BODY_PAIRS = 32
#: Largest number of contacts of a scene, not counting particle contacts.
MOST_CONTACTS = 10_000
#: Largest number of vertices of a static surface whose points are tested against moving bodies.
MOST_POINTS = 2000


def averaged_force_scale(points: Array, reach: float, *, convex: bool) -> float:
    """Returns the fraction of its force that each point is given.

    Args:
        points: Positions of the points (n, 3) [m].
        reach: Half the size of the opposite body [m], within which points can be in contact simultaneously.
        convex: Whether only points in one flat part of the convex hull can be in contact simultaneously, as for a
            body that lies on another.
    """
    tried = points[:: max(1, len(points) // _MAX_TRIED)]
    count = int(KDTree(points).query_ball_point(tried, reach, return_length=True).max())
    if convex:
        count = min(count, _max_coplanar(points))
    return min(1.0, FULL_FORCE_POINTS / count)


def _max_coplanar(points: Array) -> int:
    """Returns the largest number of points in one flat part of their convex hull."""
    try:
        planes = ConvexHull(points).equations
    except (QhullError, ValueError):  # the points are coplanar
        return len(points)
    planes = planes[:: max(1, len(planes) // _MAX_TRIED)]
    distance = points @ planes[:, :3].T + planes[:, 3]
    return int((distance > -_FLAT * np.ptp(points, axis=0).max()).sum(axis=0).max())


def group_particles(keys: Sequence[Hashable | None], min_count: int) -> Numbers:
    """Returns the index of the particle contact of each item (n,); −1: none.

    Args:
        keys: Items with equal keys belong together; those with ``None`` to no particle contact.
        min_count: A group needs more than this number of items. Groups are numbered by their first item.
    """
    alike: dict[Hashable, list[int]] = {}
    for i, key in enumerate(keys):
        if key is not None:
            alike.setdefault(key, []).append(i)
    groups = np.full(len(keys), -1, dtype=np.int64)
    for number, members in enumerate(members for members in alike.values() if len(members) > min_count):
        groups[members] = number
    return groups


def pairs_within_groups(groups: Numbers, pairs: Numbers) -> list[Numbers]:
    """Returns, for each particle contact, those of the pairs (n, 2) whose items both belong to it."""
    first, second = groups[pairs[:, 0]], groups[pairs[:, 1]]
    same_group = np.flatnonzero((first == second) & (first >= 0))
    same_group = same_group[np.argsort(first[same_group], kind="stable")]
    ends = np.searchsorted(first[same_group], np.arange(groups.max(initial=-1) + 2))
    return [pairs[same_group[start:end]] for start, end in pairwise(ends)]


def other_pairs(
    bodies: Numbers, moves: npt.NDArray[np.bool_], groups: Numbers, excluded: Numbers
) -> Iterator[tuple[int, int]]:
    """Iterates over the pairs of colliders that can be in contact, except those within a particle contact, in order.

    Args:
        bodies: Index of the carrier of each collider (n,); colliders of the same carrier are not paired.
        moves: Whether forces move the carrier (n,); at least one of a pair must move.
        groups: Index of the particle contact (n,); −1: none.
        excluded: Index pairs without contact (m, 2), each with the lower index first, sorted.
    """
    starts = np.searchsorted(excluded[:, 0], np.arange(len(bodies) + 1))
    for i in range(len(bodies)):
        after = slice(i + 1, None)
        may_touch = bodies[after] != bodies[i]
        if not moves[i]:
            may_touch &= moves[after]
        if groups[i] >= 0:
            may_touch &= groups[after] != groups[i]
        may_touch[excluded[starts[i] : starts[i + 1], 1] - (i + 1)] = False
        for j in np.flatnonzero(may_touch).tolist():
            yield i, i + 1 + j


@dataclass(eq=False)
class Collider:
    """Collider of a scene, and the elements created for it.

    Attributes:
        path: Path of its prim.
        name: Name of its elements.
        body: Body that carries it; ``None``: the world.
        moves: Whether forces move the body.
        geometry: Shape or mesh in the frame of the body.
        material: Physics material.
        visible: Whether it is drawn.
        material_name: Name of the prim of the physics material; ``None``: there is none.
        shape: Shape element, once added.
        surface_element: Surface element, once added.
        centre: Point element at the center, once added.
        points: Sample points of the surface, once added.
    """

    path: str
    name: str
    body: Body | None
    moves: bool
    geometry: ColliderShape
    material: PhysicsMaterial
    visible: bool
    material_name: str | None = None
    shape: Shape | None = None
    surface_element: Surface | None = None
    centre: Points | None = None
    points: Points | None = None

    @property
    def side(self) -> Side:
        """Material and movable body, for the combination of materials."""
        return Side(self.material, self.body if self.moves else None, self.material_name)

    @property
    def solid(self) -> Solid:
        """The shape, or the surface if the collider is a mesh, once added."""
        solid = self.surface_element if self.shape is None else self.shape
        assert solid is not None
        return solid

    @property
    def is_open(self) -> bool:
        """Whether the collider is an open mesh."""
        return self.geometry.mesh is not None and not self.geometry.mesh.report.closed

    def is_a(self, *kinds: type) -> bool:
        """Returns whether the analytic shape is an instance of one of these classes."""
        return isinstance(self.geometry.form, kinds)

    def add(self, scene: SceneData) -> None:
        """Adds the shape, or the surface if the collider is a mesh."""
        if self.geometry.form is None:
            self.surface(scene)
            return
        position, rotation = self.geometry.position, self.geometry.orientation
        self.shape = scene.add_shape(
            self.body,
            self.geometry.form,
            position,
            rotation,
            name=self.name,
            physics_material=self.material_name,
            visible=self.visible,
        )

    def surface(self, scene: SceneData) -> Surface:
        """Returns the surface, which is added at the first call."""
        if self.surface_element is None:
            mesh, is_mesh = self.geometry.surface(self.name), self.geometry.form is None
            name = self.name if is_mesh else scene.new_name(f"{self.name}_surface", None)
            position, rotation, visible = (
                self.geometry.position,
                self.geometry.orientation,
                is_mesh and self.visible,
            )
            self.surface_element = scene.add_surface(
                mesh,
                self.body,
                position,
                rotation,
                name=name,
                physics_material=self.material_name,
                visible=visible,
            )
        return self.surface_element

    def center_point(self, scene: SceneData) -> Points:
        """Returns the center of a sphere as a point, which is added at the first call."""
        if self.centre is None:
            name = scene.new_name(f"{self.name}_centre", None)
            self.centre = scene.add_point(self.body, self.geometry.position, name=name)
        return self.centre

    def sample_points(self, scene: SceneData, samples: int | str) -> Points:
        """Returns sample points of the surface, which are added at the first call."""
        if self.points is None:
            surface_element = self.surface(scene)
            method = {"method": samples} if isinstance(samples, str) else {"count": samples}
            name = scene.new_name(f"{self.name}_points", None)
            self.points = scene.add_points(
                surface_element, sample_surface(surface_element.mesh, **method), name=name
            )
        return self.points


@dataclass(frozen=True, eq=False)
class BodyPair:
    """Two colliders with body contact; the second is a half-space or open mesh if one of them is."""

    first: Collider
    second: Collider
    material: ContactMaterial


class ContactBuilder:
    """Adds the contacts of colliders to a scene.

    Args:
        scene: Scene to add to.
        material: Contact material of all contacts, or a table of them; ``None``: from the physics materials.
        contact_time: Duration of an impact [s], which gives the stiffness if no material does.
        samples: Sampling of meshes, as for ``add_surface_contact``; ``None``: body contact.
    """

    def __init__(
        self,
        scene: SceneData,
        material: ContactMaterial | MaterialTable | None,
        contact_time: float,
        samples: int | str | None,
    ) -> None:
        self.scene = scene
        self.samples = samples
        self.combiner = ContactMaterials(material, contact_time, float(np.linalg.norm(scene.gravity)))
        self.has_table = isinstance(material, MaterialTable)
        self.remarks: list[str] = []
        self._body_pairs: list[BodyPair] = []
        self._unsupported: dict[str, list[str]] = {}  # reasons why pairs have no body contact, by kind of contact

    def add(self, colliders: list[Collider], excluded: Numbers) -> None:
        """Adds all contacts between colliders.

        Args:
            colliders: Colliders of the scene.
            excluded: Index pairs (n, 2) without contact, each with the lower index first, sorted.
        """
        keys = [_particle_key(collider, self.has_table) for collider in colliders]
        groups = group_particles(keys, MIN_PARTICLES)
        for number, exclude in enumerate(pairs_within_groups(groups, excluded)):
            self._add_particles([colliders[i] for i in np.flatnonzero(groups == number)], exclude, colliders)
        carriers: dict[Body | None, int] = {}
        bodies = np.array(
            [carriers.setdefault(collider.body, len(carriers)) for collider in colliders], dtype=np.int64
        )
        moves = np.array([collider.moves for collider in colliders], dtype=bool)
        pairs = list(islice(other_pairs(bodies, moves, groups, excluded), MOST_CONTACTS + 1))
        if len(pairs) > MOST_CONTACTS:
            raise InvalidValue(
                f"more than {MOST_CONTACTS} pairs of colliders can be in contact. Exclude pairs "
                "with collision groups or filtered pairs"
            )
        for i, j in pairs:
            first, second = colliders[i], colliders[j]
            # Normals point towards the first: a moving collider before a static one, and a plane last.
            swap = (first.is_a(shapes.Plane), not first.moves) > (second.is_a(shapes.Plane), not second.moves)
            self._add_pair(*((second, first) if swap else (first, second)))
        self._add_body_contacts()
        self.remarks += self.combiner.remarks()
        for kind, reasons in self._unsupported.items():
            self.remarks.append(
                f"{len(reasons)} pairs have contact {kind}, because they have no body contact. The first: {reasons[0]}"
            )

    def _add_particles(self, members: list[Collider], excluded: Numbers, colliders: list[Collider]) -> None:
        heaviest = max(members, key=lambda first: first.side.mass)
        if self.combiner.are_apart(heaviest.side, heaviest.side):
            return
        radii = {first.geometry.form.radius for first in members}  # type: ignore[union-attr]
        radius = radii.pop() / 2.0 if len(radii) == 1 else None
        label = f"the particle contact of {members[0].name!r}"
        material, options = self.combiner.combine(label, heaviest.side, heaviest.side, radius)
        exclude = [(_shape(colliders[i]), _shape(colliders[j])) for i, j in excluded.tolist()]
        self.scene.add_particle_contact([_shape(first) for first in members], material, exclude=exclude, **options)

    def _add_pair(self, first: Collider, second: Collider) -> None:
        scene = self.scene
        if self.combiner.are_apart(first.side, second.side):
            return
        name = scene.new_name(f"{first.name}_{second.name}", None)
        form, second_form = first.geometry.form, second.geometry.form
        sphere, surface_side = (first, second) if first.is_a(shapes.Sphere) else (second, first)
        is_shape_contact = form is not None and second_form is not None
        if form is not None and second_form is not None:
            radius = rolling_radius(form, second_form)
        else:
            radius = sphere.geometry.form.radius if sphere.is_a(shapes.Sphere) else None  # type: ignore[union-attr]
        if self._has_body_contact(first, second, radius):
            material, _ = self.combiner.combine(repr(name), first.side, second.side, None, over_area=True)
            # An open mesh is the second solid.
            self._body_pairs.append(BodyPair(*((second, first) if first.is_open else (first, second)), material))
            return
        material, common = self.combiner.combine(repr(name), first.side, second.side, radius)
        options: dict[str, Any] = {**common, "name": name}
        if is_shape_contact:
            scene.add_shape_contact(_shape(first), _shape(second), material, **options)
        elif radius is not None:
            options |= {"radius": radius, "minima": "all"}
            scene.add_contact(sphere.center_point(scene), surface_side.surface(scene), material, **options)
        elif second.is_a(shapes.Plane):
            self._add_points(first, second, material, options, 1.0)
        else:
            self._add_surfaces(first, second, material, options)

    def _has_body_contact(self, first: Collider, second: Collider, radius: float | None) -> bool:
        """Returns whether a pair has body contact. ``radius``: rolling radius [m]; ``None``: there is none."""
        has_mesh = first.geometry.form is None or second.geometry.form is None
        if self.samples is not None and has_mesh:
            return False
        given = self.combiner.given_for(first.side, second.side)
        # Contact at one point has no area for a law per area.
        per_area = given is not None and given.law.takes_area
        if (first.is_a(shapes.Sphere) or second.is_a(shapes.Sphere)) and not per_area:
            return False
        if not has_mesh and (first.is_a(shapes.Ellipsoid) or second.is_a(shapes.Ellipsoid)) and not per_area:
            return False
        # A rolling cylinder or capsule keeps the rolling friction of its material, which body contact does not have.
        if radius is not None and given is None and first.material.with_other(second.material).rolling:
            return False
        reason = unsupported_reason(first.solid, second.solid, given)
        if reason is not None:
            kind = "of sample points" if has_mesh else "at one point"
            self._unsupported.setdefault(kind, []).append(reason)
        return reason is None

    def _add_body_contacts(self) -> None:
        """Adds a body contact for each pair, or one for many pairs of the same material."""
        groups: dict[tuple[int, bool], list[BodyPair]] = {}
        for pair in self._body_pairs:
            groups.setdefault((id(pair.material), pair.second.moves), []).append(pair)
        for pairs in groups.values():
            if len(pairs) > MIN_BODY_PAIRS and self._add_body_contact_of_lists(pairs):
                continue
            for pair in pairs:
                name = self.scene.new_name(f"{pair.first.name}_{pair.second.name}", None)
                self.scene.add_body_contact(pair.first.solid, pair.second.solid, pair.material, name=name)

    def _add_body_contact_of_lists(self, pairs: "list[BodyPair]") -> bool:
        """Adds one body contact of all pairs, unless it would exclude more pairs than it has; returns whether it was added."""
        first = list(dict.fromkeys(pair.first for pair in pairs))
        second = list(dict.fromkeys(pair.second for pair in pairs))
        if pairs[0].second.moves:
            first = second = list(dict.fromkeys((*first, *second)))
        wanted = {frozenset((pair.first, pair.second)) for pair in pairs}
        every = {
            frozenset((one, other)): (one.solid, other.solid)
            for one in first
            for other in second
            if one.body is not other.body
        }
        exclude = [pair for key, pair in every.items() if key not in wanted]
        if len(exclude) > len(pairs):
            return False
        solids = [one.solid for one in first], [one.solid for one in second]
        self.scene.add_body_contact(solids[0], solids[1], pairs[0].material, exclude=exclude)
        return True

    def _add_surfaces(
        self, first: Collider, second: Collider, material: ContactMaterial, options: dict[str, Any]
    ) -> None:
        """Adds contacts of the points of each surface with the other; a large static surface gets no points."""
        both = second.moves or len(second.surface(self.scene).mesh.vertices) <= MOST_POINTS
        self._add_points(first, second, material, options, 0.5 if both else 1.0)
        if both:
            name = self.scene.new_name(f"{second.name}_{first.name}", None)
            self._add_points(second, first, material, options | {"name": name}, 0.5)
        else:
            self.remarks.append(
                f"{second.path}: does not move and has more than {MOST_POINTS} vertices: only the points of "
                f"{first.path} are tested against it, not its points against that mesh"
            )

    def _add_points(
        self, first: Collider, second: Collider, material: ContactMaterial, options: dict[str, Any], part: float
    ) -> None:
        """Adds contact of points of one surface with the other; ``part``: fraction of the force of the pair."""
        samples = DEFAULT_SAMPLES if self.samples is None else self.samples
        points, surface_element = first.sample_points(self.scene, samples), second.surface(self.scene)
        reach = 0.5 * float(np.linalg.norm(np.ptp(surface_element.mesh.bounds, axis=0)))
        force_scale = part * averaged_force_scale(points.positions, reach, convex=first.moves)
        self.scene.add_contact(points, surface_element, material, force_scale=force_scale, **options)


def _shape(first: Collider) -> Shape:
    assert first.shape is not None
    return first.shape


def _particle_key(first: Collider, has_table: bool) -> tuple[float | str | None, ...] | None:
    """Returns the key that particles of one particle contact share; ``None``: not a particle."""
    if first.moves and first.is_a(shapes.Sphere, shapes.Capsule):
        return astuple(first.material) + ((first.material_name,) if has_table else ())
    return None
