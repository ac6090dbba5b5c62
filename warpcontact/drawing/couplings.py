"""Couplings as curves: springs as coils, catenaries as they hang, all else as a line between its ends."""

import math
from dataclasses import dataclass

import numpy as np

from warpcontact.algebra.poses import transform_points
from warpcontact.drawing.replay import Replay
from warpcontact.drawing.spheres import WORLD_COLOR
from warpcontact.kernels.types import COUPLING_BROKEN
from warpcontact.scene.couplings import Catenary, Coupling, SpringDamper
from warpcontact.scene.scene import Points, Scene
from warpcontact.validation.checks import Array

# A coil: turns, points of each, the part of its length that is coiled, and its radius in greatest lengths.
TURNS = 8
PER_TURN = 12
COILED = 0.8
COIL_RADIUS = 0.05
# Points of a catenary, evenly along its length.
LINE_POINTS = 48


@dataclass(frozen=True, eq=False)
class Coil:
    """What coils of a spring have in common in all records, so that they do not jump from one to the next.

    Attributes:
        length: The greatest distance of its ends [m].
        along: How much it lies along each axis of the world at most, (3,) from 0 to 1.
    """

    length: float
    along: Array

    @classmethod
    def of(cls, start: Array, end: Array) -> "Coil":
        """Returns it of coils between places (…, 3) [m]."""
        length, axis = _axis(start, end)
        return cls(float(length.max()), np.abs(axis).reshape(-1, 3).max(axis=0))

    def merge(self, other: "Coil") -> "Coil":
        """Returns it of the records of both."""
        return Coil(max(self.length, other.length), np.maximum(self.along, other.along))

    @property
    def radius(self) -> float:
        """Radius [m]."""
        return COIL_RADIUS * self.length


class CouplingCurve:
    """The shape of a coupling over time.

    Args:
        replay: Some records.
        coupling: The coupling.
        coil: Of a spring, what its coils in all records have in common; ``None``: these are all.

    Attributes:
        coupling: The coupling.
        points: Its points, (time, env, n, 3), world [m].
        shown: Whether it is there, (time, env): a broken one is not.
        color: RGB in 0…1.
        coil: What its coils have in common; ``None``: it has none.
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
    """Returns coils between two places, (…, n, 3), from these (…, 3), all of the radius of the longest."""
    along = end - start
    _, axis = _axis(start, end)
    # The coordinate axis that all of them are farthest from.
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
    """Returns the distances (…, 1) [m] and directions (…, 3) from places to others."""
    along = end - start
    length = np.linalg.norm(along, axis=-1, keepdims=True)
    return length, np.where(length > 0.0, along / np.where(length > 0.0, length, 1.0), (0.0, 0.0, 1.0))


def catenary_points(replay: Replay, line: Catenary, start: Array, end: Array) -> Array:
    """Returns a catenary between two places over time, (time, env, LINE_POINTS, 3), world [m].

    Args:
        replay: The environments, with the parameters of the line as far as they were recorded.
        line: The catenary.
        start: Where its first end is, (time, env, 3), world [m].
        end: Where its second end is, likewise.
    """
    scene = Scene()
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
    # Each record of each environment is an environment of its own.
    model = scene.build(start.shape[0] * start.shape[1], "cpu", "float64")
    gravity = _over_time(replay, "scene.gravity", replay.scene.gravity)
    values = {"a.position": start, "b.position": end, "scene.gravity": gravity}
    for key in ("length", "mass_per_length", "axial_stiffness", *(() if floor is None else ("floor",))):
        values[f"line.{key}"] = _over_time(replay, f"{line.name}.{key}", getattr(line, key))
    for name, value in values.items():
        model[name] = value.reshape(-1, *value.shape[2:])
    return model.catenary_shape("line", LINE_POINTS).reshape(*start.shape[:2], LINE_POINTS, 3)


def _over_time(replay: Replay, name: str, default: Array) -> Array:
    """Returns a parameter in every record, (time, env, …)."""
    values = replay.setting(name, default)
    return np.broadcast_to(values, (len(replay.codes), *values.shape))


def _is_coil(coupling: Coupling) -> bool:
    return isinstance(coupling, SpringDamper) and not bool(coupling.tension_only)


def _places(replay: Replay, point: Points) -> Array:
    """Returns where a point is, (time, env, 3), world [m]."""
    local = replay.places(point)[:, 0]
    if point.body is None:
        return np.broadcast_to(local, (len(replay.codes), *local.shape))
    position, orientation = replay.pose(point.body)
    return transform_points(np.broadcast_to(local, position.shape)[..., None, :], position, orientation)[..., 0, :]
