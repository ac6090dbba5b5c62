"""The contacts that the elements of a scene can make, in one environment, as hard ones: measured on the host."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpcontact.checks import Array
from warpcontact.elements import Contact
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.types import DRIVEN, UNSOLVED, WORLD
from warpcontact.piles.elements import ParticleContact
from warpcontact.piles.pile import Pile
from warpcontact.smooth.elements import ShapeContact
from warpcontact.status import ContactStatus
from warpcontact.unilateral.materials import Hard, check_rigid
from warpcontact.unilateral.rigid.bodies import rotation_matrices
from warpcontact.unilateral.rigid.events import Event, EventKind
from warpcontact.unilateral.rigid.segments import closest_on_segments
from warpcontact.unilateral.rigid.snapshot import Place, Snapshot
from warpcontact.vectors import cross

AnyContact = Contact | ShapeContact | ParticleContact

# A point that a latch keeps out by a rounding touches; one farther in came from the wrong side [m].
LATCHED_IN = 1.0e-6


@dataclass(frozen=True)
class Measured:
    """Where contacts are in a state.

    Attributes:
        gap: Signed distances (n,) [m]; ∞ where nothing can touch.
        normal: Unit normals (n, 3) out of the second body, towards the first, world.
        point: Points K (n, 3) where forces act, world [m].
        force: Forces and moments about the centre of mass that couplings and forces from outside apply to each
            body, one after the other, (6 bodies,), without gravity and nonsmooth contacts; world axes [N, N·m].
    """

    gap: Array
    normal: Array
    point: Array
    force: Array


class Candidates:
    """All pairs that may touch in one environment, and what is the same in all its states.

    Contact couplings are forces like those of other couplings, and none of these.

    Args:
        place: The environment.

    Attributes:
        names: Name of the contact of each pair, (n,).
        items: Its item (n,), −1 of a contact without items; of a particle contact the number of the pair.
        labels: What to call each pair.
        bodies: Numbers of the first and the second body, or ``WORLD``, (n, 2).
        mu_static: Coefficients of friction of pairs that stick (n,).
        mu: Of those that slide, likewise.
        restitution: Coefficients of restitution (n,).

    Raises:
        ValueError: If a friction of a contact is none that a cone can take, or its share is not 1.
    """

    def __init__(self, place: Place) -> None:
        self.place = place
        self.model, self.env = place.model, place.env
        model = place.model
        scene = model.scene
        own = [contact for contact in scene.contacts if contact.facing is None]
        self.elements: list[Contact | ShapeContact] = [*own, *scene.shape_contacts]
        self.piles = [(pile, _pairs(pile)) for pile in model.piles]
        names: list[str] = []
        items: list[int] = []
        labels: list[str] = []
        bodies: list[NDArray[np.int_]] = []
        factors: list[Array] = []
        for contact in self.elements:
            single = contact.points.single if isinstance(contact, Contact) else contact.single
            numbers = [-1] if single else list(range(contact.count))
            names += [contact.name] * contact.count
            items += numbers
            labels += [contact.name if item < 0 else f"{contact.name}[{item}]" for item in numbers]
            bodies.append(_bodies_of(contact))
            factors.append(self._factors(contact, contact.count))
        for pile, pairs in self.piles:
            one = pile.contact
            names += [one.name] * len(pairs)
            items += range(len(pairs))
            labels += [f"{one.name}: {one.label(i)} on {one.label(j)}" for i, j in pairs]
            bodies.append(one.bodies[pairs].astype(int))
            factors.append(self._factors(one, len(pairs)))
        self.names, self.items, self.labels = np.array(names, dtype=object), np.array(items, dtype=int), labels
        self.bodies = np.concatenate([np.zeros((0, 2), dtype=int), *bodies])
        table = np.concatenate([np.zeros((0, 4)), *factors])
        self.mu_static, self.mu, self.restitution, self.enabled = table.T
        self._needs = {"contacts", "distances"}
        if scene.contacts:
            self._needs.add("points")
        if scene.shape_contacts:
            self._needs.add("shape_points")
        if any(body.motion.kind == DRIVEN for body in scene.bodies):
            self._needs |= {"wrenches", "reactions"}
        model.make_measures(self._needs)
        self._views: tuple[int, dict[str, Array]] = (-1, {})

    @property
    def count(self) -> int:
        """Number of pairs."""
        return len(self.names)

    def event(
        self,
        time: float,
        kind: EventKind,
        pair: int,
        impulse: Array | None = None,
        approach: float = 0.0,
        separation: float = 0.0,
    ) -> Event:
        """Returns what happens to a pair; the impulse (3,) is on its first body, world [N·s]."""
        return Event(
            time=float(time),
            kind=kind,
            contact=str(self.names[pair]),
            item=int(self.items[pair]),
            label=self.labels[pair],
            impulse=np.zeros(3) if impulse is None else impulse,
            approach_speed=float(approach) + 0.0,  # not −0
            separation_speed=float(separation) + 0.0,
        )

    def measure(self, snapshot: Snapshot) -> Measured:
        """Returns where they are in a state, which becomes the current one of the environment.

        Raises:
            RuntimeError: If it was not found where smooth shapes meet.
        """
        self.place.write(snapshot)
        self.model.prepare(self._needs)
        parts = [(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))]
        parts += [self._of_sensor(contact) for contact in self.elements]
        parts += [self._of_pile(pile, pairs, snapshot) for pile, pairs in self.piles]
        gap, normal, point = (np.concatenate([part[i] for part in parts]) for i in range(3))
        gap = np.where(self.enabled > 0.0, gap, np.inf)
        return Measured(gap, normal, point, self._forces())

    def _factors(self, contact: AnyContact, count: int) -> Array:
        """Returns μ at rest, μ sliding, restitution and whether it is enabled, of each item (count, 4)."""
        for part in ("rolling", "torsion"):
            if not isinstance(contact.material.formulas[part], Frictionless):
                raise ValueError(
                    f"{contact.name}.{part} must be left out: resistance to rolling and spinning is not part of "
                    f"this method, got {type(contact.material.formulas[part]).__name__}"
                )
        sources = Hard(contact, contact.material.formulas, count).sources()
        check_rigid(contact.name, contact.material.formulas, "Or use SemiImplicitEuler")
        if (self._values(f"{contact.name}.force_scale", count, 1.0) != 1.0).any():
            raise ValueError(f"{contact.name}.force_scale must be 1: a nonsmooth contact cannot be a part of one")
        columns = [
            np.zeros(count)
            if source is None
            else self._values(f"{contact.name}.{source[0]}.{source[1]}", count, 0.0)
            for source in (sources[key] for key in ("mu_static", "mu_dynamic", "restitution"))
        ]
        columns.append(self._values(f"{contact.name}.enabled", count, 1.0))
        return np.stack(columns, axis=1)

    def _values(self, name: str, count: int, otherwise: Array | float) -> Array:
        """Returns a parameter of each item (count,); ``otherwise`` if there is none of that name."""
        values = self.model[name][self.env] if name in self.model else otherwise
        return np.broadcast_to(values, (count,))

    def _sensor(self, name: str) -> Array:
        """Returns a sensor of this environment as it was computed last."""
        if not self.model.device.is_cpu:
            return self.model.measured(name)[self.env].astype(np.float64)
        revision, views = self._views
        if revision != self.model.revision:
            self._views = revision, views = self.model.revision, {}
        if name not in views:
            # A view of what is computed next, too.
            views[name] = self.model.find_sensor(name).array(self.model.arrays).numpy()
        return views[name][self.env].astype(np.float64)

    def _of_sensor(self, contact: Contact | ShapeContact) -> tuple[Array, Array, Array]:
        def read(key: str) -> Array:
            return self._sensor(f"{contact.name}.{key}").reshape(contact.count, -1)

        gap, status = read("gap")[:, 0], read("status")[:, 0].astype(int)
        if (status == UNSOLVED).any():
            raise RuntimeError(f"{contact.name}: it was not found where the shapes meet")
        meets = (status == ContactStatus.OPEN) | (status == ContactStatus.CONTACT)
        meets |= (status == ContactStatus.WRONG_SIDE) & (gap > -LATCHED_IN)
        return np.where(meets, gap, np.inf), read("normal"), read("point")

    def _of_pile(self, pile: Pile, pairs: NDArray[np.int_], snapshot: Snapshot) -> tuple[Array, Array, Array]:
        shapes, bodies = pile.shapes, pile.contact.bodies
        turns = rotation_matrices(snapshot.orientation)[bodies]
        offset, axis = (getattr(shapes, key).numpy()[self.env].astype(np.float64) for key in ("offset", "axis"))
        radius = shapes.radius.numpy()[self.env].astype(np.float64)
        middle = snapshot.position[bodies] + (turns @ offset[..., None])[..., 0]
        axis = (turns @ axis[..., None])[..., 0]
        one, other = pairs.T
        s, t = closest_on_segments(middle[one] - middle[other], axis[one], axis[other])
        near, far = middle[one] + s[:, None] * axis[one], middle[other] + t[:, None] * axis[other]
        distance = np.linalg.norm(near - far, axis=1)
        # Where centres coincide there is no direction; any keeps them apart.
        normal = np.where(distance[:, None] > 0.0, near - far, [0.0, 0.0, 1.0])
        normal = normal / np.where(distance > 0.0, distance, 1.0)[:, None]
        gap = distance - radius[one] - radius[other]
        return gap, normal, far + (radius[other] + 0.5 * gap)[:, None] * normal

    def _forces(self) -> Array:
        """Returns what couplings and forces from outside apply to each body (6 bodies,)."""
        model, env = self.model, self.env
        a, scene = model.arrays, model.scene
        result = np.zeros((model.body_count, 6))
        if model.pushed:
            result[:, :3] = a.model.body_external_force.numpy()[env]
            result[:, 3:] = a.model.body_external_torque.numpy()[env]
        if scene.couplings:
            ends = np.array([end for couplings in model.couplings for end in couplings.end_bodies()])
            force, torque = (getattr(a.ends, key).numpy()[env][: len(ends)] for key in ("force", "torque"))
            held = ends != WORLD
            np.add.at(result, ends[held], np.hstack([force, torque])[held])
        for contact in scene.contacts:
            if contact.facing is not None:
                self._add_compliant(contact, result)
        return result.reshape(-1)

    def _add_compliant(self, contact: Contact, result: Array) -> None:
        """Adds the forces of a contact of a contact coupling to those of the bodies."""

        def read(key: str) -> Array:
            return self._sensor(f"{contact.name}.{key}").reshape(contact.count, -1)

        force = read("normal_force") * read("normal") + read("friction_force")
        point, couple = read("point"), read("torque")
        position = self.place.read().position
        for sign, numbers in zip((1.0, -1.0), _bodies_of(contact).T, strict=True):
            held = (numbers != WORLD) & (force != 0.0).any(axis=1)
            moment = cross(point[held] - position[numbers[held]], force[held]) + couple[held]
            np.add.at(result, numbers[held], sign * np.hstack([force[held], moment]))


def _bodies_of(contact: Contact | ShapeContact) -> NDArray[np.int_]:
    """Returns the bodies of each item of a contact (items, 2)."""
    if isinstance(contact, Contact):
        second = WORLD if contact.surface.body is None else contact.surface.body.index
        sides = [contact.points.body_numbers, np.array([second])]
    else:
        sides = [contact.shape.body_numbers, contact.other_shape.body_numbers]
    return np.stack([np.broadcast_to(side, contact.count) for side in sides], axis=1).astype(int)


def _pairs(pile: Pile) -> NDArray[np.int_]:
    """Returns the pairs of shapes of a particle contact that may touch (pairs, 2), the lower number first."""
    one, other = np.triu_indices(pile.contact.count, 1)
    kind, allowed = pile.contact.kinds
    may = (allowed[kind[one], kind[other]] > 0) & (pile.contact.bodies[one] != pile.contact.bodies[other])
    return np.stack([one[may], other[may]], axis=1)
