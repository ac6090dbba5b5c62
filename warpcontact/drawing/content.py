"""Visible content of the selected environments, independent of the output format."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from warpcontact.drawing.body_sets import BodySet, body_sets_of
from warpcontact.drawing.couplings import Coil, CouplingCurve
from warpcontact.drawing.forces import ForceLines, length_scale, resultant_lines
from warpcontact.drawing.replay import Replay
from warpcontact.drawing.shapes import ShapePlacement, ShapeSet
from warpcontact.drawing.spheres import Spheres, find_spheres, scene_size
from warpcontact.drawing.surfaces import Placement
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
    size: float
    force_scale: float

    @classmethod
    def of(cls, replay: Replay, coils: Mapping[str, Coil] | None = None) -> "Content":
        """Collects the content; ``coils``: coil data of springs by name, needed if ``replay`` is part of the records."""
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
            size=size,
            force_scale=length_scale([*lines, *resultants], size),
        )
