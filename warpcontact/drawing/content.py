"""Visible content of the selected environments, and its ranges over all records."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from warpcontact.drawing.contact_pressure import ContactPressure
from warpcontact.drawing.geometry import (
    BodySet,
    Placement,
    ShapePlacement,
    ShapeSet,
    Spheres,
    body_sets_of,
    body_size,
    find_spheres,
    scene_size,
)
from warpcontact.drawing.lines import LONGEST, Coil, CouplingCurve, ForceLines, length_scale, resultant_lines
from warpcontact.drawing.replay import Replay
from warpcontact.scene.elements import Body
from warpcontact.validation.checks import Array

#: Width of points without radius, as a multiple of the size of their body.
POINT = 0.03


@dataclass(frozen=True)
class Content:
    """Visible content of the selected environments of a recording, by element.

    Attributes:
        replay: Replay of the environments.
        poses: Positions (time, env, …, 3) and orientations of the bodies by name.
        placements: Surfaces by name.
        spheres: Spheres and points of contacts.
        forms: Single shapes.
        shape_sets: Shapes on sets of bodies.
        body_sets: Spheres and points on sets of bodies.
        lines: Forces of contacts.
        resultants: Forces of contact couplings and of particle contacts, for which only sums are recorded.
        curves: Couplings.
        pressure: Pressure on the areas of body contacts.
        size: Size of the drawing, the length of the largest body [m].
        force_scale: Arrow length per force [m/N], which draws the largest force at 1.5 times ``size``.
    """

    replay: Replay
    poses: dict[str, tuple[Array, Array]]
    placements: dict[str, Placement]
    spheres: list[Spheres]
    forms: list[ShapePlacement]
    shape_sets: list[ShapeSet]
    body_sets: list[BodySet]
    lines: list[ForceLines]
    resultants: list[ForceLines]
    curves: list[CouplingCurve]
    pressure: ContactPressure
    size: float
    force_scale: float

    @classmethod
    def of(cls, replay: Replay, coils: Mapping[str, Coil] | None = None, *, pressure: bool = True) -> "Content":
        """Collects the content.

        Args:
            replay: Replay of the environments.
            coils: Coil data of springs by name, needed if ``replay`` is part of the records.
            pressure: Whether to show the pressure of body contacts.
        """
        scene = replay.scene
        spheres = find_spheres(replay)
        placements = {surface.name: Placement.of(replay, surface) for surface in scene.surfaces}
        poses = {body.name: replay.pose(body) for body in scene.bodies}
        forms = [ShapePlacement.of(replay, shape) for shape in scene.shapes]
        reaches = [2.0 * form.reach for form in forms if form.shape.body is not None]
        size = max([scene_size(replay, list(placements.values()), spheres), *reaches])
        contacts: list[Any] = [*scene.contacts, *scene.shape_contacts]
        lines = [line for contact in contacts if (line := ForceLines.of(replay, contact))]
        resultants = resultant_lines(replay, poses, lines)
        return cls(
            replay=replay,
            poses=poses,
            placements=placements,
            spheres=spheres,
            forms=[form for form in forms if form.shape.single],
            shape_sets=[
                ShapeSet(form, poses[form.shape.body.name])
                for form in forms
                if form.shape.body is not None and not form.shape.single
            ],
            body_sets=body_sets_of(scene, spheres, poses),
            lines=lines,
            resultants=resultants,
            curves=[CouplingCurve(replay, one, (coils or {}).get(one.name)) for one in scene.couplings],
            pressure=ContactPressure.of(replay) if pressure else ContactPressure(replay, []),
            size=size,
            force_scale=length_scale([*lines, *resultants], size),
        )


@dataclass
class SceneRanges:
    """Ranges of space and force of the selected environments over time.

    Attributes:
        size: Size of the drawing, the length of the largest body [m].
        low: Lower corner of the space of bodies and couplings, (env, 3), world [m].
        high: Upper corner, (env, 3), world [m].
        peak: Largest force [N].
        peak_pressure: Largest pressure on the areas of body contacts [Pa].
        coils: Coil data of springs by name.
    """

    size: float
    low: Array
    high: Array
    peak: float = 0.0
    peak_pressure: float = 0.0
    coils: dict[str, Coil] = field(default_factory=dict)

    @classmethod
    def of(cls, blocks: Iterable[Content]) -> "SceneRanges":
        """Returns the ranges over all records, given block by block."""
        ranges: SceneRanges | None = None
        for content in blocks:
            if ranges is None:
                count = len(content.replay.envs)
                ranges = cls(0.0, np.full((count, 3), np.inf), np.full((count, 3), -np.inf))
                sized = _body_sizes(content)
            ranges._add(content)
        if ranges is None:
            raise ValueError("the recording has no records")
        ranges._finish(content, sized)
        return ranges

    @property
    def force_scale(self) -> float:
        """Arrow length per force [m/N], which draws the largest force at ``LONGEST`` times the size."""
        return LONGEST * self.size / self.peak if self.peak > 0.0 else 1.0

    def _add(self, content: Content) -> None:
        for body in content.replay.scene.bodies:
            self._reach(content.poses[body.name][0], body_reach(content, body))
        for curve in content.curves:
            ends = curve.points[:, :, [0, -1]]
            self._reach(curve.points if curve.coil is None else ends, 0.0)
            if curve.coil is not None:
                name = curve.coupling.name
                previous = self.coils.get(name, curve.coil)
                self.coils[name] = previous.merge(curve.coil)
        forces: list[ForceLines] = [*content.lines, *content.resultants]
        self.peak = max([self.peak, *(line.peak() for line in forces)])
        records, rows = range(len(content.replay.codes)), range(len(content.replay.envs))
        self.peak_pressure = max(self.peak_pressure, content.pressure.peak(records, rows))

    def _reach(self, places: Array, reach: float) -> None:
        """Extends the bounds to positions (time, env, …, 3), with a margin of ``reach`` [m]."""
        axes = (0, *range(2, places.ndim - 1))
        self.low = np.minimum(self.low, places.min(axis=axes) - reach)
        self.high = np.maximum(self.high, places.max(axis=axes) + reach)

    def _finish(self, content: Content, sized: tuple[float, float]) -> None:
        largest, reach = sized
        corners = [placement.corners for placement in content.placements.values()]
        if largest == 0.0:
            all_points = np.concatenate([self.low, self.high, *corners])
            largest = 0.1 * float(np.linalg.norm(np.ptp(all_points, axis=0))) or 1.0
        self.size = max(largest, reach)
        coil_radius = max((coil.radius for coil in self.coils.values()), default=0.0)
        self.low -= coil_radius
        self.high += coil_radius


def body_reach(content: Content, body: Body) -> float:
    """Returns the largest distance of a body's geometry from its center of mass in any environment [m]."""
    forms = [*content.forms, *(shape_set.placement for shape_set in content.shape_sets)]
    own = [form.reach for form in forms if form.shape.body is body]
    return max([0.5 * body_size(body, content.placements.values(), content.spheres), *own])


def _body_sizes(content: Content) -> tuple[float, float]:
    """Returns the largest body diameters, by surfaces and spheres, and by shapes [m]."""
    bodies, placements = content.replay.scene.bodies, content.placements.values()
    forms = [*content.forms, *(shape_set.placement for shape_set in content.shape_sets)]
    by_shapes = [2.0 * form.reach for form in forms if form.shape.body is not None]
    by_surfaces = [body_size(body, placements, content.spheres) for body in bodies]
    return max(by_surfaces, default=0.0), max(by_shapes, default=0.0)
