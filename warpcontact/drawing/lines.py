"""Contact forces as lines, with points, vectors and drawing scale, and couplings as curves."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpcontact.algebra.vectors import transform_points
from warpcontact.drawing.geometry import WORLD_COLOR, ShapePlacement
from warpcontact.drawing.replay import Replay
from warpcontact.kernels.types import COUPLING_BROKEN
from warpcontact.model.build import plan_on_devices
from warpcontact.model.model import DeviceModel
from warpcontact.scene.body_contact import BodyContact
from warpcontact.scene.couplings import Catenary, Coupling, SpringDamper
from warpcontact.scene.elements import Contact, Points
from warpcontact.scene.particles import ParticleContact
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.shapes import ShapeContact
from warpcontact.storage.memory_estimate import require
from warpcontact.validation.checks import Array

FORCE_COLOR = (0.9, 0.25, 0.1)
# Length of the longest force line, as a multiple of the size.
LONGEST = 1.5

# Coil: number of turns, points per turn, coiled fraction of the length, and radius as a fraction of the largest length.
TURNS = 8
PER_TURN = 12
COILED = 0.8
COIL_RADIUS = 0.05
# Number of points of a catenary, evenly spaced along its length.
LINE_POINTS = 48


class ForceLines:
    """Forces of a contact on the body of its points, with the points where they act.

    Attributes:
        contact: The contact; for a contact coupling, the first of its contacts.
        name: Name of the element.
        meaning: Description, a sentence.
        start: Point K where the force acts, (time, env, item, 3), world [m].
        force: Force, (time, env, item, 3), world [N]; zero without contact.
        color: RGB in 0…1.
    """

    def __init__(
        self,
        contact: Contact | ShapeContact | ParticleContact | BodyContact,
        start: Array,
        force: Array,
        name: str | None = None,
        meaning: str = "Force on the body of the points, from the point where it acts.",
    ) -> None:
        self.contact = contact
        self.name = contact.name if name is None else name
        self.meaning = meaning
        self.color = np.array(FORCE_COLOR) if contact.color is None else contact.color
        # Frozen environments may hold NaN, which must not enter the geometry.
        good = np.all(np.isfinite(force) & np.isfinite(start), axis=-1, keepdims=True)
        self.force = np.where(good, force, 0.0)
        self.start = np.where(np.isfinite(start), start, 0.0)

    @classmethod
    def of(cls, replay: Replay, contact: Contact | ShapeContact) -> "ForceLines | None":
        """Returns the lines, or ``None`` unless normal force, normal and point were recorded.

        A contact at several minima has several normals, and needs force and center instead.
        """
        shape = (len(replay.codes), len(replay.envs), contact.count)
        if isinstance(contact, Contact) and contact.minima == "all":
            total, center = (replay.series(f"{contact.name}.{key}") for key in ("force", "center"))
            if total is None or center is None:
                return None
            start, each = (values.astype(np.float64).reshape(*shape, 3) for values in (center, total))
            return cls(contact, start, each)
        parts = {}
        for key in ("normal_force", "normal", "point", "friction_force"):
            values = replay.series(f"{contact.name}.{key}")
            if values is not None:
                length = () if key == "normal_force" else (3,)
                parts[key] = values.astype(np.float64).reshape(*shape, *length)
            elif key != "friction_force":
                return None
        with np.errstate(invalid="ignore"):  # ∞ × 0
            force = parts["normal_force"][..., None] * parts["normal"] + parts.get("friction_force", 0.0)
        return cls(contact, parts["point"], force)

    def peak(self) -> float:
        """Returns the largest force [N]."""
        return float(np.linalg.norm(self.force, axis=-1).max())


def resultant_lines(
    replay: Replay, poses: Mapping[str, tuple[Array, Array]], lines: list[ForceLines]
) -> list[ForceLines]:
    """Returns resultant forces: of contact couplings at the center of mass, of particle contacts on each shape.

    A coupling is omitted if ``lines`` contain the forces of all its contacts.
    """
    found, drawn = [], {line.name for line in lines}
    shape = (len(replay.codes), len(replay.envs))
    for coupling in replay.scene.contact_couplings:
        body, force = coupling.surface_a.body, replay.series(f"{coupling.name}.force")
        if body is None or force is None or drawn.issuperset(one.name for one in coupling.contacts):
            continue
        start = poses[body.name][0][:, :, None]
        meaning = "Force on the body of the first surface, from its center of mass."
        each = force.astype(np.float64).reshape(*shape, 1, 3)
        found.append(ForceLines(coupling.contacts[0], start, each, coupling.name, meaning))
    for particle_contact in replay.scene.particle_contacts:
        force = replay.series(f"{particle_contact.name}.force")
        if force is not None:
            start = np.concatenate([_centers(replay, poses, one) for one in particle_contact.shapes], axis=2)
            each = force.astype(np.float64).reshape(*shape, particle_contact.count, 3)
            meaning = "Force of the other particles on each shape, from its center."
            found.append(ForceLines(particle_contact, start, each, meaning=meaning))
    for body_contact in replay.scene.body_contacts:
        points, forces = (replay.series(f"{body_contact.name}.{key}") for key in ("point", "point_force"))
        if points is not None and forces is not None:
            start, each = (values.astype(np.float64).reshape(*shape, -1, 3) for values in (points, forces))
            found.append(ForceLines(body_contact, start, each, meaning="Forces of the points on the first body."))
            continue
        force, center = (replay.series(f"{body_contact.name}.{key}") for key in ("force", "center"))
        if force is not None and center is not None:
            start, each = (
                values.astype(np.float64).reshape(*shape, body_contact.count, 3) for values in (center, force)
            )
            meaning = "Force on the first body, from the center of pressure."
            found.append(ForceLines(body_contact, start, each, meaning=meaning))
    return found


def _centers(replay: Replay, poses: Mapping[str, tuple[Array, Array]], shape: Any) -> Array:
    """Returns the origins of shapes, (time, env, item, 3), world [m]."""
    local = ShapePlacement.of(replay, shape).positions
    if shape.body is None:
        return np.broadcast_to(local, (len(replay.codes), *local.shape))
    positions, orientations = poses[shape.body.name]
    if shape.single:
        return transform_points(np.broadcast_to(local, (len(positions), *local.shape)), positions, orientations)
    return transform_points(local[..., None, :], positions, orientations)[..., 0, :]


def length_scale(lines: list[ForceLines], size: float) -> float:
    """Returns the arrow length per force [m/N] that draws the largest force at ``LONGEST`` times ``size`` [m]."""
    peak = max((line.peak() for line in lines), default=0.0)
    return LONGEST * size / peak if peak > 0.0 else 1.0


@dataclass(frozen=True, eq=False)
class Coil:
    """Data of a coil over all records, so that its shape is continuous in time.

    Attributes:
        length: Largest distance between its ends [m].
        along: Largest absolute component of its direction along each world axis, (3,) from 0 to 1.
    """

    length: float
    along: Array

    @classmethod
    def of(cls, start: Array, end: Array) -> "Coil":
        """Returns the data of coils between positions (…, 3) [m]."""
        length, axis = _axis(start, end)
        return cls(float(length.max()), np.abs(axis).reshape(-1, 3).max(axis=0))

    def merge(self, other: "Coil") -> "Coil":
        """Returns the data for the records of both."""
        return Coil(max(self.length, other.length), np.maximum(self.along, other.along))

    @property
    def radius(self) -> float:
        """Radius of the coil [m]."""
        return COIL_RADIUS * self.length


class CouplingCurve:
    """Shape of a coupling over time.

    Args:
        replay: Some records.
        coupling: The coupling.
        coil: Data of a spring over all records; ``None``: ``replay`` has all records.

    Attributes:
        coupling: The coupling.
        points: Points of the curve, (time, env, n, 3), world [m].
        shown: Visibility, (time, env); false for broken couplings.
        color: RGB in 0…1.
        coil: Coil data; ``None`` if the coupling is not a coil.
    """

    def __init__(self, replay: Replay, coupling: Coupling, coil: Coil | None = None) -> None:
        self.coupling = coupling
        self.color = np.array(WORLD_COLOR) if coupling.color is None else coupling.color
        ends = [_places(replay, point) for point in (coupling.point_a, coupling.point_b)]
        self.coil: Coil | None = None
        if isinstance(coupling, Catenary):
            self.points = catenary_points(replay, coupling, *ends)
        elif _is_coil(coupling):
            self.coil = coil or Coil.of(*ends)
            self.points = coil_points(ends[0], ends[1], self.coil)
        else:
            self.points = np.stack(ends, axis=2)
        status = replay.series(f"{coupling.name}.status")
        everywhere = np.ones(self.points.shape[:2], dtype=bool)
        may_break = isinstance(coupling, SpringDamper) and status is not None
        self.shown = status != COUPLING_BROKEN if may_break else everywhere


def coil_points(start: Array, end: Array, coil: Coil) -> Array:
    """Returns coils between positions ``start`` and ``end`` (…, 3), (…, n, 3) [m], with a constant radius."""
    along = end - start
    _, axis = _axis(start, end)
    # Use the world axis that is farthest from all directions of the coil.
    across = np.cross(axis, np.eye(3)[int(np.argmin(coil.along))])
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1.0e-9)
    normal = np.cross(axis, across)
    part = np.linspace(0.0, 1.0, TURNS * PER_TURN + 1)
    angle = 2.0 * math.pi * TURNS * part
    lead = 0.5 * (1.0 - COILED)
    rows = [start]
    for s, a in zip(lead + COILED * part, angle, strict=True):
        rows.append(start + s * along + coil.radius * (math.cos(a) * across + math.sin(a) * normal))
    return np.stack([*rows, end], axis=-2)


def _axis(start: Array, end: Array) -> tuple[Array, Array]:
    """Returns distances (…, 1) [m] and unit directions (…, 3) between positions; z if the distance is 0."""
    along = end - start
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    return length, np.where(length > 0.0, along / np.where(length > 0.0, length, 1.0), (0.0, 0.0, 1.0))


def catenary_points(replay: Replay, line: Catenary, start: Array, end: Array) -> Array:
    """Returns a catenary between two positions over time, (time, env, LINE_POINTS, 3), world [m].

    Args:
        replay: Replay with the recorded parameters of the catenary.
        line: The catenary.
        start: Position of its first end, (time, env, 3), world [m].
        end: Position of its second end, (time, env, 3), world [m].
    """
    scene = SceneData()
    marks = [scene.add_body(1.0, (1.0, 1.0, 1.0), name=name) for name in ("a", "b")]
    ends = [scene.add_point(mark, (0.0, 0.0, 0.0)) for mark in marks]
    floor = None if line.floor is None else float(line.floor)
    scene.add_catenary(
        *ends,
        length=float(line.length),
        mass_per_length=float(line.mass_per_length),
        axial_stiffness=float(line.axial_stiffness),
        floor=floor,
        name="line",
    )
    # One environment per record and environment of the replay.
    (plan,) = plan_on_devices(scene, "cpu", "float64")
    envs = start.shape[0] * start.shape[1]
    require(plan.memory_estimate, envs, "to draw a catenary, ")
    model = DeviceModel(plan, envs)
    gravity = _over_time(replay, "scene.gravity", replay.scene.gravity)
    values = {"a.position": start, "b.position": end, "scene.gravity": gravity}
    for key in ("length", "mass_per_length", "axial_stiffness", *(() if floor is None else ("floor",))):
        values[f"line.{key}"] = _over_time(replay, f"{line.name}.{key}", getattr(line, key))
    for name, value in values.items():
        model[name] = value.reshape(-1, *value.shape[2:])
    return model.catenary_shape("line", LINE_POINTS).reshape(*start.shape[:2], LINE_POINTS, 3)


def _over_time(replay: Replay, name: str, default: Array) -> Array:
    """Returns a parameter in each record, (time, env, …)."""
    values = replay.setting(name, default)
    return np.broadcast_to(values, (len(replay.codes), *values.shape))


def _is_coil(coupling: Coupling) -> bool:
    return isinstance(coupling, SpringDamper) and not bool(coupling.tension_only)


def _places(replay: Replay, point: Points) -> Array:
    """Returns positions of a point, (time, env, 3), world [m]."""
    local = replay.places(point)[:, 0]
    if point.body is None:
        return np.broadcast_to(local, (len(replay.codes), *local.shape))
    position, orientation = replay.pose(point.body)
    return transform_points(np.broadcast_to(local, position.shape)[..., None, :], position, orientation)[..., 0, :]
