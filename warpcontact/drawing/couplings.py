"""Couplings as curves: springs as coils, catenaries in their shape, others as straight lines."""

import math
from dataclasses import dataclass

import numpy as np

from warpcontact.algebra.vectors import transform_points
from warpcontact.drawing.replay import Replay
from warpcontact.drawing.spheres import WORLD_COLOR
from warpcontact.kernels.types import COUPLING_BROKEN
from warpcontact.model.build import plan_on_devices
from warpcontact.model.model import DeviceModel
from warpcontact.scene.couplings import Catenary, Coupling, SpringDamper
from warpcontact.scene.elements import Points
from warpcontact.scene.scene_data import SceneData
from warpcontact.storage.memory_estimate import require
from warpcontact.validation.checks import Array

# Coil: number of turns, points per turn, coiled fraction of the length, and radius as a fraction of the largest length.
TURNS = 8
PER_TURN = 12
COILED = 0.8
COIL_RADIUS = 0.05
# Number of points of a catenary, evenly spaced along its length.
LINE_POINTS = 48


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
