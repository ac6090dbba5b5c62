"""From what was recorded to what is drawn of it."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import xarray as xr

from warpcontact.checks import Array
from warpcontact.frames import placed, product
from warpcontact.kernels.smooth import shapes
from warpcontact.kernels.smooth.plane import Plane
from warpcontact.replay.content import POINT, Content
from warpcontact.replay.drawing import Curve, Drawing, Figure, Shape, Touch
from warpcontact.replay.forms import PLANE, FormPlacement, FormSwarm
from warpcontact.replay.replay import Replay
from warpcontact.replay.spheres import Spheres, body_color, body_size
from warpcontact.replay.surfaces import INACTIVE, Placement, surface_color
from warpcontact.replay.swarms import Swarm
from warpcontact.replay.triangles import ball, of_form
from warpcontact.scene import Body, Scene

# What is round is scaled from one sphere.
_ROUND = (shapes.Sphere, shapes.Ellipsoid)
# Gaps are shown up to so many sizes of the largest body: what is farther apart has nothing in between to point at.
NEAR = 0.25
# Radius of what shows a body that carries nothing, in sizes of the largest body.
MARK = 0.1
_UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def drawing_of(
    recording: xr.Dataset, scene: Scene | None = None, envs: int | Iterable[int] | None = None
) -> Drawing:
    """Returns what is seen of some environments of a recording; what is not visible is left out.

    Args:
        recording: What ``Simulation.run`` returned or ``wc.open_run(…).recording``, with the poses of all bodies.
        scene: What was simulated; ``None``: what the recording remembers.
        envs: Numbers of the environments; ``None``: the first 16.

    Raises:
        ValueError: If an environment is not there, or the poses of a body are not, or are not finite.
        TypeError: If an argument is of another type.
    """
    replay = Replay.of(recording, scene, envs)
    content = Content.of(replay)
    return Drawing(
        times=replay.times,
        envs=replay.envs,
        figures=list(_figures(content)),
        curves=[
            Curve(curve.coupling.name, curve.color, curve.points, curve.shown)
            for curve in content.curves
            if curve.coupling.visible
        ],
        touches=list(_touches(content)),
        size=content.size,
        force_scale=content.force_scale,
    )


def _figures(content: Content) -> Iterator[Figure]:
    for placement in content.placements.values():
        if placement.surface.visible:
            yield from _of_surface(content, placement)
    for group in content.spheres:
        if not group.contacts[0].points.spread and any(contact.visible for contact in group.contacts):
            yield _of_spheres(content, group)
    for swarm in content.swarms:
        if _is_seen(content, swarm):
            yield _of_swarm(content, swarm)
    yield from _marks(content)
    for form in content.forms:
        if form.shape.visible:
            yield from _of_form(content, form)
    for moving in content.form_swarms:
        if moving.placement.shape.visible:
            yield from _of_form_swarm(content, moving)


def _carried(content: Content, body: Body | None, places: Array, turns: Array) -> tuple[Array, Array]:
    """Returns poses (time, env, item, …) in the world of what is fixed to a single body or to the world.

    Args:
        content: What is seen.
        body: The body.
        places: Positions in its frame, (env, item, 3) [m].
        turns: Rotations to it, (env, item, 4).
    """
    if body is None:
        return places[None], turns[None]
    positions, orientations = content.poses[body.name]
    moved = placed(places, positions, orientations)
    return moved, product(orientations[:, :, None], turns)


def _of_surface(content: Content, placement: Placement) -> Iterator[Figure]:
    surface = placement.surface
    poses = _carried(content, surface.body, placement.position[:, None], placement.orientation[:, None])
    color = surface_color(surface)
    for index in sorted({int(mesh) for mesh in placement.mesh}):
        mesh, active = surface.meshes[index], surface.active[index]
        colors = None if active.all() else np.where(active[:, None], color, INACTIVE * color)
        shape = Shape(mesh.vertices, mesh.faces, colors)
        scales = np.repeat(placement.scale[:, None, None], 3, axis=2)
        yield Figure(surface.name, "surface", shape, color, *poses, scales, (placement.mesh == index)[:, None])


def _of_spheres(content: Content, group: Spheres) -> Figure:
    turns = np.broadcast_to(_UPRIGHT, (*group.places.shape[:2], 4))
    poses = _carried(content, group.body, group.places, turns)
    own = 0.0 if group.body is None else body_size(group.body, content.placements.values(), content.spheres)
    return _round(content, group.name, body_color(group.body), poses, group.radii, own)


def _of_swarm(content: Content, swarm: Swarm) -> Figure:
    _, orientations = content.poses[swarm.body.name]
    return _round(content, swarm.name, body_color(swarm.body), (swarm.places, orientations), swarm.radii, 0.0)


def _is_seen(content: Content, swarm: Swarm) -> bool:
    """Whether a swarm shows something: not hidden contacts, nor the centres of what has shapes of its own."""
    if swarm.contacts:
        return any(contact.visible for contact in content.replay.scene.contacts if contact.name in swarm.contacts)
    return all(moving.placement.shape.body is not swarm.body for moving in content.form_swarms)


def _marks(content: Content) -> Iterator[Figure]:
    """Yields a ball for each single body that carries nothing, or it would move unseen."""
    carriers = {placement.surface.body for placement in content.placements.values()}
    carriers |= {group.body for group in content.spheres} | {form.shape.body for form in content.forms}
    for body in content.replay.scene.bodies:
        if body.single and body not in carriers:
            positions, orientations = (values[:, :, None] for values in content.poses[body.name])
            radii = np.full((len(content.replay.envs), 1), MARK * content.size)
            scales = np.repeat(radii[..., None], 3, axis=2)
            yield Figure(
                body.name, "point", ball(), body_color(body), positions, orientations, scales, radii > 0.0
            )


def _round(
    content: Content, name: str, color: Array, poses: tuple[Array, Array], radii: Array, own: float
) -> Figure:
    """Returns spheres of radii (env, item) [m], or points where all are zero; ``own``: size of their body."""
    if radii.any():
        kind, reach = "sphere", radii
    else:
        kind, reach = "point", np.full_like(radii, 0.5 * POINT * (own or content.size))
    return Figure(name, kind, ball(), color, *poses, np.repeat(reach[..., None], 3, axis=2), reach > 0.0)


def _of_form(content: Content, form: FormPlacement) -> Iterator[Figure]:
    poses = _carried(content, form.shape.body, form.positions, form.orientations)
    yield from _by_size(content, form, poses)


def _of_form_swarm(content: Content, moving: FormSwarm) -> Iterator[Figure]:
    yield from _by_size(content, moving.placement, (moving.places, moving.turns))


def _by_size(content: Content, form: FormPlacement, poses: tuple[Array, Array]) -> Iterator[Figure]:
    """Yields one figure for all shapes of one size; what is round is scaled."""
    kind, sizes, shape = form.shape.kind, form.sizes, form.positions.shape[:2]

    def figure(what: Shape, scales: Array, there: Any) -> Figure:
        drawn_as = "plane" if issubclass(kind, Plane) else "shape"
        return Figure(form.shape.name, drawn_as, what, form.color, *poses, scales, there)

    everywhere = np.ones(shape, dtype=bool)
    if issubclass(kind, _ROUND):
        scales = sizes["semi_axes"] if "semi_axes" in sizes else np.repeat(sizes["radius"][..., None], 3, axis=2)
        yield figure(ball(), scales, everywhere)
        return
    ones = np.ones((*shape, 3))
    if issubclass(kind, Plane):
        yield figure(of_form(kind, {}, PLANE * content.size), ones, everywhere)
        return
    rows = np.concatenate([values.reshape(*shape, -1) for values in sizes.values()], axis=-1)
    _, first, numbers = np.unique(rows.reshape(-1, rows.shape[-1]), axis=0, return_index=True, return_inverse=True)
    numbers = numbers.reshape(shape)
    for number, entry in enumerate(first.tolist()):
        drawn = of_form(kind, form.of_item(*divmod(entry, shape[1])), PLANE * content.size)
        yield figure(drawn, ones, numbers == number)


def _touches(content: Content) -> Iterator[Touch]:
    for lines in content.lines:
        name = lines.contact.name
        if lines.contact.visible:
            gaps = content.replay.series(f"{name}.gap")
            if gaps is not None:
                gaps = gaps.reshape(lines.force.shape[:3])
                gaps = np.where(gaps < NEAR * content.size, gaps, np.nan)
            yield Touch(name, lines.color, lines.start, lines.force, gaps)
    for lines in content.resultants:
        if lines.contact.visible:
            yield Touch(lines.contact.name, lines.color, lines.start, lines.force, None)
