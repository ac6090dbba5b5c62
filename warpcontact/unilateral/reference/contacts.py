"""Contacts of one environment: candidates measured on the host, and closed contacts assembled as matrices."""

from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.algebra.vectors import cross
from warpcontact.forces.couplings.coupling_set import CouplingSet
from warpcontact.forces.nonsmooth.materials import NonsmoothSource, check_rigid
from warpcontact.forces.particle_contact.contact_set import ParticleContactSet
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.types import TIME_FUNCTION, UNSOLVED, WORLD
from warpcontact.scene.elements import Contact
from warpcontact.scene.particles import ParticleContact
from warpcontact.scene.shapes import ShapeContact
from warpcontact.scene.status import ContactStatus
from warpcontact.unilateral.reference.environment import (
    Bodies,
    EnvironmentAccess,
    Snapshot,
    find_environment,
    rotation_matrices,
)
from warpcontact.unilateral.reference.events import Event, EventKind
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

AnyContact = Contact | ShapeContact | ParticleContact

# Penetration up to which a latched point counts as in contact [m]; deeper points came from the inner side.
LATCHED_IN = 1.0e-6
# Families of force elements that are treated as contacts.
_CONTACTS = ("mesh contact", "shape contact", "particle contact")
# Squared sine of the angle below which two segments are parallel.
PARALLEL = 1.0e-10


@dataclass(frozen=True)
class MeasuredPairs:
    """Contact geometry of all candidate pairs in a state.

    Attributes:
        gap: Signed distances (n,) [m]; ∞ if contact is impossible.
        normal: Unit normals (n, 3) out of the second body, towards the first, world.
        point: Points K (n, 3) where forces act, world [m].
        force: Forces and torques about the centers of mass by couplings and external wrenches, (6 bodies,),
            without gravity and nonsmooth contacts; world axes [N, N·m].
    """

    gap: Array
    normal: Array
    point: Array
    force: Array


class Candidates:
    """All candidate pairs of one environment, and their constant properties.

    Contact couplings are not included; they are forces like other couplings.

    Args:
        environment: The environment.

    Attributes:
        names: Name of the contact of each pair, (n,).
        items: Item of the contact (n,), −1 for a contact without items; for a particle contact the index of the
            pair.
        labels: Label of each pair in messages.
        bodies: Indices of the first and the second body, or ``WORLD``, (n, 2).
        mu_static: Coefficients of static friction (n,).
        mu: Coefficients of dynamic friction (n,).
        restitution: Coefficients of restitution (n,).

    Raises:
        ValueError: If a contact has a friction model without Coulomb coefficients, rolling or torsional friction,
            or a force scale other than 1; or if there are force elements other than contacts and couplings.
    """

    def __init__(self, environment: EnvironmentAccess) -> None:
        self.environment = environment
        self.model, self.env = environment.model, environment.env
        model = environment.model
        scene = model.scene
        own = [contact for contact in scene.contacts if contact.facing is None]
        self.elements: list[Contact | ShapeContact] = [*own, *scene.shape_contacts]
        self.coupling_sets = [one for one in model.force_elements if isinstance(one, CouplingSet)]
        for one in model.force_elements:
            if one.target is not None and one.family not in _CONTACTS and one not in self.coupling_sets:
                raise ValueError(
                    f"forces of {one.family} are not included in event-driven simulation and equilibrium"
                )
        self.particle_contact_sets = [(pile, _pairs(pile)) for pile in model.of_family("particle contact")]
        names: list[str] = []
        items: list[int] = []
        labels: list[str] = []
        bodies: list[NDArray[np.int_]] = []
        coefficients: list[Array] = []
        for contact in self.elements:
            single = contact.points.single if isinstance(contact, Contact) else contact.single
            numbers = [-1] if single else list(range(contact.count))
            names += [contact.name] * contact.count
            items += numbers
            labels += [contact.name if item < 0 else f"{contact.name}[{item}]" for item in numbers]
            bodies.append(_bodies_of(contact))
            coefficients.append(self._coefficients(contact, contact.count))
        for pile, pairs in self.particle_contact_sets:
            index_1 = pile.contact
            names += [index_1.name] * len(pairs)
            items += range(len(pairs))
            labels += [f"{index_1.name}: {index_1.label(i)} on {index_1.label(j)}" for i, j in pairs]
            bodies.append(index_1.bodies[pairs].astype(int))
            coefficients.append(self._coefficients(index_1, len(pairs)))
        self.names, self.items, self.labels = np.array(names, dtype=object), np.array(items, dtype=int), labels
        self.bodies = np.concatenate([np.zeros((0, 2), dtype=int), *bodies])
        table = np.concatenate([np.zeros((0, 4)), *coefficients])
        self.mu_static, self.mu, self.restitution, self.enabled = table.T
        self._needs = {"contacts", "all_distances"}
        if scene.contacts:
            self._needs.add("points")
        if scene.shape_contacts:
            self._needs.add("shape_points")
        if any(body.motion.kind == TIME_FUNCTION for body in scene.bodies):
            self._needs |= {"wrenches", "reactions"}
        model.ensure_sensor_arrays(self._needs)
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
        """Returns an event of a pair; the impulse (3,) is on its first body, world [N·s]."""
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

    def measure(self, snapshot: Snapshot) -> MeasuredPairs:
        """Returns the contact geometry in a state, which becomes the current state of the environment.

        Raises:
            RuntimeError: If a shape contact did not converge.
        """
        self.environment.write(snapshot)
        self.model.evaluate_needs(self._needs)
        parts = [(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3)))]
        parts += [self._of_sensor(contact) for contact in self.elements]
        parts += [self._particle_pairs(pile, pairs, snapshot) for pile, pairs in self.particle_contact_sets]
        gap, normal, point = (np.concatenate([part[i] for part in parts]) for i in range(3))
        gap = np.where(self.enabled > 0.0, gap, np.inf)
        return MeasuredPairs(gap, normal, point, self._forces())

    def _coefficients(self, contact: AnyContact, count: int) -> Array:
        """Returns static μ, dynamic μ, restitution and ``enabled`` of each item (count, 4)."""
        for part in ("rolling", "torsion"):
            if not isinstance(contact.material.formulas[part], Frictionless):
                raise ValueError(
                    f"{contact.name}.{part} must not be set: this method does not support rolling and torsional "
                    f"friction, got {type(contact.material.formulas[part]).__name__}"
                )
        sources = NonsmoothSource(contact, contact.material.formulas, count).parameter_paths()
        check_rigid(contact.name, contact.material.formulas, "Or use SemiImplicitEuler")
        if isinstance(contact, Contact) and contact.minima == "all":
            raise ValueError(
                f"{contact.name}.minima must be 'nearest': this method has one contact point per sphere, got 'all'. Use "
                "MoreauJean, or a surface and a contact for each wall"
            )
        if (self._values(f"{contact.name}.force_scale", count, 1.0) != 1.0).any():
            raise ValueError(f"{contact.name}.force_scale must be 1 for nonsmooth contact")
        if sources["compliance"] is not None:
            compliance = self._values(f"{contact.name}.law.compliance", count, 0.0)
            if compliance.any():
                raise ValueError(
                    f"{contact.name}.law.compliance must be 0 m/N for this method, got {compliance.max():g} m/N; "
                    "MoreauJean supports it"
                )
        columns = [
            np.zeros(count)
            if source is None
            else self._values(f"{contact.name}.{source[0]}.{source[1]}", count, 0.0)
            for source in (sources[key] for key in ("mu_static", "mu_dynamic", "restitution"))
        ]
        columns.append(self._values(f"{contact.name}.enabled", count, 1.0))
        return np.stack(columns, axis=1)

    def _values(self, name: str, count: int, otherwise: Array | float) -> Array:
        """Returns a parameter of each item (count,); ``otherwise`` if there is no parameter of that name."""
        values = self.model[name][self.env] if name in self.model else otherwise
        return np.broadcast_to(values, (count,))

    def _sensor(self, name: str) -> Array:
        """Returns the last value of a sensor of this environment."""
        if not self.model.device.is_cpu:
            return self.model.last_value(name)[self.env].astype(np.float64)
        revision, views = self._views
        if revision != self.model.revision:
            self._views = revision, views = self.model.revision, {}
        if name not in views:
            # The view remains valid for later evaluations.
            views[name] = self.model.find_sensor(name).array(self.model.arrays).numpy()
        return views[name][self.env].astype(np.float64)

    def _contact_sensor(self, contact: Contact | ShapeContact, key: str) -> Array:
        """Returns the last value of a sensor of a contact, (items, components)."""
        return self._sensor(f"{contact.name}.{key}").reshape(contact.count, -1)

    def _of_sensor(self, contact: Contact | ShapeContact) -> tuple[Array, Array, Array]:
        read = partial(self._contact_sensor, contact)
        gap, status = read("gap")[:, 0], read("status")[:, 0].astype(int)
        if (status == UNSOLVED).any():
            raise RuntimeError(f"{contact.name}: shape contact did not converge")
        may_touch = (status == ContactStatus.OPEN) | (status == ContactStatus.CONTACT)
        may_touch |= (status == ContactStatus.WRONG_SIDE) & (gap > -LATCHED_IN)
        return np.where(may_touch, gap, np.inf), read("normal"), read("point")

    def _particle_pairs(
        self, pile: ParticleContactSet, pairs: NDArray[np.int_], snapshot: Snapshot
    ) -> tuple[Array, Array, Array]:
        shapes, bodies = pile.particles, pile.contact.bodies
        rotations = rotation_matrices(snapshot.orientation)[bodies]
        offset, axis = (getattr(shapes, key).numpy()[self.env].astype(np.float64) for key in ("offset", "axis"))
        radius = shapes.radius.numpy()[self.env].astype(np.float64)
        center = snapshot.position[bodies] + (rotations @ offset[..., None])[..., 0]
        axis = (rotations @ axis[..., None])[..., 0]
        index_1, index_2 = pairs.T
        s, t = closest_on_segments(center[index_1] - center[index_2], axis[index_1], axis[index_2])
        point_1, point_2 = (
            center[index_1] + s[:, None] * axis[index_1],
            center[index_2] + t[:, None] * axis[index_2],
        )
        distance = np.linalg.norm(point_1 - point_2, axis=1)
        # If centers coincide, any direction separates the particles.
        normal = np.where(distance[:, None] > 0.0, point_1 - point_2, [0.0, 0.0, 1.0])
        normal = normal / np.where(distance > 0.0, distance, 1.0)[:, None]
        gap = distance - radius[index_1] - radius[index_2]
        return gap, normal, point_2 + (radius[index_2] + 0.5 * gap)[:, None] * normal

    def _forces(self) -> Array:
        """Returns the wrenches of couplings and external wrenches on each body (6 bodies,)."""
        model, env = self.model, self.env
        a, scene = model.arrays, model.scene
        result = np.zeros((model.body_count, 6))
        if model.has_external_forces:
            result[:, :3] = a.model.body_external_force.numpy()[env]
            result[:, 3:] = a.model.body_external_torque.numpy()[env]
        if self.coupling_sets:
            force, torque = (getattr(a.end_wrenches, key).numpy()[env] for key in ("force", "torque"))
            for couplings in self.coupling_sets:
                ends = np.array(couplings.end_bodies)
                own = slice(2 * couplings.first, 2 * couplings.first + len(ends))
                moves_body = ends != WORLD
                np.add.at(result, ends[moves_body], np.hstack([force[own], torque[own]])[moves_body])
        for contact in scene.contacts:
            if contact.facing is not None:
                self._add_compliant(contact, result)
        return result.reshape(-1)

    def _add_compliant(self, contact: Contact, result: Array) -> None:
        """Adds the forces of a contact of a contact coupling to those of the bodies."""
        read = partial(self._contact_sensor, contact)
        force = read("normal_force") * read("normal") + read("friction_force")
        point, couple = read("point"), read("torque")
        position = self.environment.read().position
        for sign, numbers in zip((1.0, -1.0), _bodies_of(contact).T, strict=True):
            moves_body = (numbers != WORLD) & (force != 0.0).any(axis=1)
            moment = (
                cross(point[moves_body] - position[numbers[moves_body]], force[moves_body]) + couple[moves_body]
            )
            np.add.at(result, numbers[moves_body], sign * np.hstack([force[moves_body], moment]))


def _bodies_of(contact: Contact | ShapeContact) -> NDArray[np.int_]:
    """Returns the bodies of each item of a contact (items, 2)."""
    if isinstance(contact, Contact):
        second = WORLD if contact.surface.body is None else contact.surface.body.index
        sides = [contact.points.body_numbers, np.array([second])]
    else:
        sides = [contact.shape.body_numbers, contact.other_shape.body_numbers]
    return np.stack([np.broadcast_to(side, contact.count) for side in sides], axis=1).astype(int)


def _pairs(pile: ParticleContactSet) -> NDArray[np.int_]:
    """Returns the candidate pairs of a particle contact (pairs, 2), the lower particle index first."""
    index_1, index_2 = np.triu_indices(pile.contact.count, 1)
    kind, allowed = pile.contact.kinds
    allowed_pairs = (allowed[kind[index_1], kind[index_2]] > 0) & (
        pile.contact.bodies[index_1] != pile.contact.bodies[index_2]
    )
    return np.stack([index_1[allowed_pairs], index_2[allowed_pairs]], axis=1)


def closest_on_segments(d: Array, g: Array, h: Array) -> tuple[Array, Array]:
    """Returns the parameters (s, t) in [−1, 1] (n,) of the closest points of pairs of segments.

    For parallel segments that overlap in projection, the middle of the overlap is used.

    Args:
        d: Vector from the middle of the second to that of the first (n, 3) [m].
        g: Vector from the middle of the first to its end (n, 3) [m]; zeros: a point.
        h: Likewise for the second.
    """
    a, b, c = (g * g).sum(axis=1), (g * h).sum(axis=1), (h * h).sum(axis=1)
    e, f = (g * d).sum(axis=1), (h * d).sum(axis=1)
    long_1, long_2 = a > 0.0, c > 0.0
    a_or_1, c_or_1 = np.where(long_1, a, 1.0), np.where(long_2, c, 1.0)
    det = a * c - b * b
    crossing = det > PARALLEL * a * c
    ends = np.stack([-e - b, -e + b]) / a_or_1
    low, high = ends.min(axis=0), ends.max(axis=0)
    beside = 0.5 * (np.maximum(low, -1.0) + np.minimum(high, 1.0))
    # Without overlap: the end that is nearest to the other segment.
    beside = np.where(high < -1.0, -1.0, np.where(low > 1.0, 1.0, beside))
    s = np.where(crossing, (b * f - c * e) / np.where(crossing, det, 1.0), beside)
    s = np.where(long_2, np.clip(s, -1.0, 1.0), np.clip(-e / a_or_1, -1.0, 1.0))
    s = np.where(long_1, s, 0.0)
    t = np.where(long_2, (f + s * b) / c_or_1, 0.0)
    beyond = np.abs(t) > 1.0
    t = np.clip(t, -1.0, 1.0)
    return np.where(beyond & long_1, np.clip((t * b - e) / a_or_1, -1.0, 1.0), s), t


@dataclass(frozen=True)
class Assembly:
    """Closed contacts and bodies: U = H v, M v̇ = force + Hᵀ λ.

    v contains linear and angular velocity of each body, in world axes, at the centers of mass. U and λ have
    components (n, t1, t2) for each contact: the velocity of the first body relative to the second at K, and the
    force on the first.

    Attributes:
        body_names: Names of the bodies; for a body set with the item in brackets.
        names: Names of the contacts (contacts,).
        items: Items of the contacts (contacts,), −1 for a contact without items.
        labels: Labels of the contacts in messages.
        bodies: Indices of the first and the second body, −1 for the world, (contacts, 2).
        gap: Signed distances (contacts,) [m].
        axes: Unit vectors n, t1, t2 (contacts, 3, 3), world; n points out of the second body.
        point: Points K (contacts, 3), world [m].
        mu_static: Coefficients of static friction (contacts,).
        mu: Coefficients of dynamic friction (contacts,).
        restitution: Coefficients of restitution (contacts,).
        H: (contacts, 3, 6 bodies) [-, m].
        inverse_mass: Inverse mass matrix (6 bodies, 6 bodies), zero along directions constrained by joints.
        velocity: v (6 bodies,) [m/s, rad/s].
        force: Applied forces and torques (6 bodies,), including gravity and couplings, [N, N·m].
        free_acceleration: Acceleration without contact (6 bodies,) [m/s², rad/s²].
    """

    body_names: list[str]
    names: NDArray[Any]
    items: NDArray[np.int_]
    labels: list[str]
    bodies: NDArray[np.int_]
    gap: Array
    axes: Array
    point: Array
    mu_static: Array
    mu: Array
    restitution: Array
    H: Array = field(repr=False)
    inverse_mass: Array = field(repr=False)
    velocity: Array = field(repr=False)
    force: Array = field(repr=False)
    free_acceleration: Array = field(repr=False)

    @property
    def count(self) -> int:
        """Number of contacts."""
        return len(self.names)

    @property
    def rows(self) -> Array:
        """H with one row per component (3 contacts, 6 bodies)."""
        return self.H.reshape(3 * self.count, self.H.shape[-1])

    @cached_property
    def delassus(self) -> Array:
        """W = H M⁻¹ Hᵀ, (3 contacts, 3 contacts)."""
        return self.rows @ self.inverse_mass @ self.rows.T

    @property
    def contact_velocity(self) -> Array:
        """U = H v, (contacts, 3) [m/s]."""
        return (self.rows @ self.velocity).reshape(-1, 3)

    def accelerations(self, forces: Array) -> Array:
        """Returns accelerations (6 bodies,) under contact forces λ (contacts, 3) [N]."""
        return self.free_acceleration + self.inverse_mass @ (self.rows.T @ forces.reshape(-1))


class Assembler:
    """Creates assemblies of one environment in many states.

    Args:
        model: From ``Scene.build``.
        env: Index of the environment.

    Raises:
        TypeError: If ``model`` is not a model.
        ValueError: If there is no such environment, or a contact has a friction model without Coulomb
            coefficients.
    """

    def __init__(self, model: Any, env: int = 0) -> None:
        self.model, self.env = find_environment(model, env)
        self.environment = EnvironmentAccess(self.model, self.env)
        self.bodies = Bodies(self.model, self.env)
        self.candidates = Candidates(self.environment)

    def assembly(self, snapshot: Snapshot, measured: MeasuredPairs, chosen: NDArray[np.int_]) -> Assembly:
        """Returns the assembly of the ``chosen`` candidate pairs in the state that was measured last."""
        own, bodies = self.candidates, self.bodies
        response = bodies.response(snapshot)
        weight = np.zeros((bodies.count, 6))
        weight[:, :3] = bodies.mass[:, None] * bodies.gravity
        force = measured.force + weight.reshape(-1)
        free = response.inverse_mass @ force + response.bias + bodies.prescribed_accelerations()
        axes = contact_axes(measured.normal[chosen])
        return Assembly(
            body_names=bodies.names,
            names=own.names[chosen],
            items=own.items[chosen],
            labels=[own.labels[number] for number in chosen],
            bodies=own.bodies[chosen],
            gap=measured.gap[chosen],
            axes=axes,
            point=measured.point[chosen],
            mu_static=own.mu_static[chosen],
            mu=own.mu[chosen],
            restitution=own.restitution[chosen],
            H=contact_rows(axes, measured.point[chosen], own.bodies[chosen], snapshot.position),
            inverse_mass=response.inverse_mass,
            velocity=snapshot.velocity,
            force=force,
            free_acceleration=free,
        )


def contact_axes(normal: Array) -> Array:
    """Returns n, t1, t2 of unit normals (n, 3), right-handed, (n, 3, 3)."""
    x, y, z = normal.T
    # Duff et al., J. Comput. Graph. Tech. 6 (2017): without a branch that rounding could switch.
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y * y * a, -y], axis=1)
    return np.stack([normal, first, second], axis=1)


def contact_rows(axes: Array, point: Array, bodies: NDArray[np.int_], position: Array) -> Array:
    """Returns H (n, 3, 6 bodies): velocity of the first body relative to the second at K, along ``axes``."""
    count = len(position)
    rows = np.zeros((len(axes), 3, count, 6))
    for side, sign in ((0, 1.0), (1, -1.0)):
        moved_rows = np.flatnonzero(bodies[:, side] != WORLD)
        own = bodies[moved_rows, side]
        arm = (point[moved_rows] - position[own])[:, None, :]
        rows[moved_rows, :, own, :3] += sign * axes[moved_rows]
        rows[moved_rows, :, own, 3:] += sign * cross(arm, axes[moved_rows])
    return rows.reshape(len(axes), 3, 6 * count)


@explain_keywords
def assemble(model: Any, env: int = 0, closed: float = 1.0e-6) -> Assembly:
    """Returns the closed contacts of one environment in its current state, and its bodies, as matrices.

    All contacts of the scene count: point and sphere contacts with meshes, shape contacts, and pairs of particle
    contacts. Contact couplings are forces like other couplings. μ is that of the friction model of a contact
    (``mu``, or ``mu_static`` and ``mu_dynamic``), the restitution that of its law, or 0.

    Args:
        model: From ``Scene.build``; its state is not changed. ``precision="float64"`` is recommended.
        env: Index of the environment.
        closed: Largest gap of a closed contact [m].

    Raises:
        TypeError: If ``model`` is not a model.
        ValueError: If an argument is out of range, or a contact has a friction model without Coulomb coefficients.
        RuntimeError: If a shape contact did not converge.
    """
    max_gap = float(checks.numbers("closed", closed, (), checks.limits("m", at_least=0.0)))
    assembler = Assembler(model, env)
    snapshot = assembler.environment.read()
    with assembler.environment.preserved_state():
        measured = assembler.candidates.measure(snapshot)
        return assembler.assembly(snapshot, measured, np.flatnonzero(measured.gap <= max_gap))
