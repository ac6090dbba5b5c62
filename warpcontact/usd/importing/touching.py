"""Which colliders touch, and by which contacts; ``docs/usd.md`` says the rules."""

from dataclasses import astuple, dataclass
from itertools import islice
from typing import Any

import numpy as np

from warpcontact.elements import Body, ContactMaterial, Points, Surface
from warpcontact.kernels.smooth import shapes
from warpcontact.meshes import sample_surface
from warpcontact.scene import Scene
from warpcontact.smooth.elements import Shape
from warpcontact.usd.importing.contact_materials import ContactMaterials, PhysicsMaterial, Side
from warpcontact.usd.importing.findings import Wrong
from warpcontact.usd.importing.forms import Part
from warpcontact.usd.importing.pairs import Numbers, loose, piles_of, within
from warpcontact.usd.importing.together import share_of
from warpcontact.usd.rolling import rolling_radius

#: So many spheres and capsules of one material are a pile, in which partners are looked for.
PILE = 32
#: Most contacts of one scene, but for piles.
MOST_CONTACTS = 10_000
#: Most points of what is at rest that look for what moves.
MOST_POINTS = 2000


@dataclass(eq=False)
class Collider:
    """A collider of a scene, and what was made of it.

    Attributes:
        path: Path of its prim.
        name: Its name.
        body: Body that carries it; ``None``: the world.
        moves: Whether forces move that.
        own: What it is.
        material: Its physics material.
        visible: Whether it is drawn.
    """

    path: str
    name: str
    body: Body | None
    moves: bool
    own: Part
    material: PhysicsMaterial
    visible: bool
    shape: Shape | None = None
    outside: Surface | None = None
    centre: Points | None = None
    points: Points | None = None

    @property
    def side(self) -> Side:
        """Its material and the body that forces move."""
        return Side(self.material, self.body if self.moves else None)

    def is_a(self, *kinds: type) -> bool:
        """Whether its form is one of these."""
        return isinstance(self.own.form, kinds)

    def add(self, scene: Scene) -> None:
        """Adds its shape, or its surface if it is a mesh."""
        if self.own.form is None:
            self.surface(scene)
            return
        place, turn = self.own.position, self.own.orientation
        self.shape = scene.add_shape(self.body, self.own.form, place, turn, name=self.name, visible=self.visible)

    def surface(self, scene: Scene) -> Surface:
        """Returns its surface, which is added when it is first asked for."""
        if self.outside is None:
            mesh, is_mesh = self.own.surface(self.name), self.own.form is None
            name = self.name if is_mesh else scene.new_name(f"{self.name}_surface", None)
            place, turn, seen = self.own.position, self.own.orientation, is_mesh and self.visible
            self.outside = scene.add_surface(mesh, self.body, place, turn, name=name, visible=seen)
        return self.outside

    def middle(self, scene: Scene) -> Points:
        """Returns the centre of a sphere as a point."""
        if self.centre is None:
            name = scene.new_name(f"{self.name}_centre", None)
            self.centre = scene.add_point(self.body, self.own.position, name=name)
        return self.centre

    def sampled(self, scene: Scene, samples: int | str) -> Points:
        """Returns points of its surface."""
        if self.points is None:
            outside = self.surface(scene)
            method = {"method": samples} if isinstance(samples, str) else {"count": samples}
            name = scene.new_name(f"{self.name}_points", None)
            self.points = scene.add_points(outside, sample_surface(outside.mesh, **method), name=name)
        return self.points


class Touching:
    """Adds the contacts of colliders to a scene.

    Args:
        scene: The scene.
        material: Law and friction of all contacts; ``None``: as materials say.
        contact_time: Time that an impact takes, which stiffness follows from [s].
        samples: Of ``add_surface_contact``.
    """

    def __init__(
        self, scene: Scene, material: ContactMaterial | None, contact_time: float, samples: int | str
    ) -> None:
        self.scene = scene
        self.samples = samples
        self.materials = ContactMaterials(material, contact_time)
        self.remarks: list[str] = []

    def add(self, colliders: list[Collider], apart: Numbers) -> None:
        """Adds all contacts of colliders.

        Args:
            colliders: The colliders.
            apart: Pairs (n, 2) of their numbers that do not touch, the lower number first, ordered.
        """
        piles = piles_of([_pile_key(one) for one in colliders], PILE)
        for number, exclude in enumerate(within(piles, apart)):
            self._add_pile([colliders[i] for i in np.flatnonzero(piles == number)], exclude, colliders)
        carriers: dict[Body | None, int] = {}
        bodies = np.array([carriers.setdefault(one.body, len(carriers)) for one in colliders], dtype=np.int64)
        moves = np.array([one.moves for one in colliders], dtype=bool)
        pairs = list(islice(loose(bodies, moves, piles, apart), MOST_CONTACTS + 1))
        if len(pairs) > MOST_CONTACTS:
            raise Wrong(
                f"more than {MOST_CONTACTS} pairs of colliders may touch; no more are allowed. Keep "
                "apart what does not touch, with collision groups or filtered pairs"
            )
        for i, j in pairs:
            one, other = colliders[i], colliders[j]
            # What moves, and no half-space, is the first: normals point towards it.
            swap = (one.is_a(shapes.Plane), not one.moves) > (other.is_a(shapes.Plane), not other.moves)
            self._add_pair(*((other, one) if swap else (one, other)))
        self.remarks += self.materials.remarks()

    def _add_pile(self, members: list[Collider], apart: Numbers, colliders: list[Collider]) -> None:
        heaviest = max(members, key=lambda one: one.side.mass)
        radii = {one.own.form.radius for one in members}  # type: ignore[union-attr]
        radius = radii.pop() / 2.0 if len(radii) == 1 else None
        label = f"the particle contact of {members[0].name!r}"
        material, options = self.materials.between(label, heaviest.side, heaviest.side, radius)
        exclude = [(_shape(colliders[i]), _shape(colliders[j])) for i, j in apart.tolist()]
        self.scene.add_particle_contact([_shape(one) for one in members], material, exclude=exclude, **options)

    def _add_pair(self, one: Collider, other: Collider) -> None:
        scene = self.scene
        name = scene.new_name(f"{one.name}_{other.name}", None)
        form, other_form = one.own.form, other.own.form
        ball, around = (one, other) if one.is_a(shapes.Sphere) else (other, one)
        smooth = form is not None and other_form is not None
        if form is not None and other_form is not None:
            radius = rolling_radius(form, other_form)
        else:
            radius = ball.own.form.radius if ball.is_a(shapes.Sphere) else None  # type: ignore[union-attr]
        material, common = self.materials.between(repr(name), one.side, other.side, radius)
        options: dict[str, Any] = {**common, "name": name}
        if smooth:
            scene.add_shape_contact(_shape(one), _shape(other), material, **options)
        elif radius is not None:
            scene.add_contact(ball.middle(scene), around.surface(scene), material, radius=radius, **options)
        elif other.is_a(shapes.Plane):
            self._add_points(one, other, material, options, 1.0)
        else:
            self._add_surfaces(one, other, material, options)

    def _add_surfaces(
        self, one: Collider, other: Collider, material: ContactMaterial, options: dict[str, Any]
    ) -> None:
        """Lets points of two surfaces touch the other one; of one at rest only if they are not too many."""
        both = other.moves or len(other.surface(self.scene).mesh.vertices) <= MOST_POINTS
        self._add_points(one, other, material, options, 0.5 if both else 1.0)
        if both:
            name = self.scene.new_name(f"{other.name}_{one.name}", None)
            self._add_points(other, one, material, options | {"name": name}, 0.5)
        else:
            self.remarks.append(
                f"{other.path}: it has more than {MOST_POINTS} vertices and does not move: points of "
                f"{one.path} touch it, and not the reverse"
            )

    def _add_points(
        self, one: Collider, other: Collider, material: ContactMaterial, options: dict[str, Any], part: float
    ) -> None:
        """Lets points of one surface touch the other; ``part``: of the force of the pair."""
        points, outside = one.sampled(self.scene, self.samples), other.surface(self.scene)
        reach = 0.5 * float(np.linalg.norm(np.ptp(outside.mesh.bounds, axis=0)))
        force_scale = part * share_of(points.positions, reach, convex=one.moves)
        self.scene.add_contact(points, outside, material, force_scale=force_scale, **options)


def _shape(one: Collider) -> Shape:
    assert one.shape is not None
    return one.shape


def _pile_key(one: Collider) -> tuple[float | None, ...] | None:
    """Returns what spheres and capsules of a pile have in common; ``None``: it is in none."""
    if one.moves and one.is_a(shapes.Sphere, shapes.Capsule):
        return astuple(one.material)
    return None
