"""Creates a drawing from a recording."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import xarray as xr

from warpcontact.algebra.vectors import product, transform_points
from warpcontact.drawing.body_sets import BodySet
from warpcontact.drawing.content import POINT, Content
from warpcontact.drawing.drawing import ContactForces, Curve, Drawing, Figure, Shape
from warpcontact.drawing.replay import Replay
from warpcontact.drawing.shapes import PLANE, ShapePlacement, ShapeSet
from warpcontact.drawing.spheres import Spheres, body_color, body_size
from warpcontact.drawing.surfaces import INACTIVE, Placement, surface_color
from warpcontact.drawing.triangles import analytic_shape, ball
from warpcontact.kernels import shapes
from warpcontact.kernels.shapes.base import Plane
from warpcontact.scene.elements import Body
from warpcontact.scene.scene_data import SceneData
from warpcontact.validation.checks import Array

# Shapes that are scaled from a unit sphere.
_ROUND = (shapes.Sphere, shapes.Ellipsoid)
# Largest gap that is shown, as a multiple of the size; larger gaps would clutter the picture.
NEAR = 0.25
# Radius of the ball that represents a body without geometry, as a multiple of the size.
MARK = 0.1
_UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def drawing_of(
    recording: xr.Dataset, scene: SceneData | None = None, envs: int | Iterable[int] | None = None
) -> Drawing:
    """Returns the drawing of some environments of a recording, without invisible elements.

    Args:
        recording: Result of ``Simulation.run`` or ``wc.open_run(…).recording``, with the poses of all bodies.
        scene: Scene of the recording; ``None``: the scene stored with the recording.
        envs: Numbers of the environments; ``None``: the first 16.

    Raises:
        ValueError: If an environment is missing, or poses of a body are missing or not finite.
        TypeError: If an argument has the wrong type.
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
        contact_forces=list(_contact_forces(content)),
        size=content.size,
        force_scale=content.force_scale,
    )


def _figures(content: Content) -> Iterator[Figure]:
    for placement in content.placements.values():
        if placement.surface.visible:
            yield from _surface_figures(content, placement)
    for group in content.spheres:
        if not group.contacts[0].points.spread and any(contact.visible for contact in group.contacts):
            yield _sphere_figure(content, group)
    for body_set in content.body_sets:
        if _is_visible(content, body_set):
            yield _body_set_figure(content, body_set)
    yield from _bare_body_figures(content)
    for form in content.forms:
        if form.shape.visible:
            yield from _shape_figures(content, form)
    for shape_set in content.shape_sets:
        if shape_set.placement.shape.visible:
            yield from _shape_set_figures(content, shape_set)


def _world_poses(content: Content, body: Body | None, places: Array, turns: Array) -> tuple[Array, Array]:
    """Returns world poses (time, env, item, …) of items fixed to a single body or to the world.

    Args:
        content: Content of the drawing.
        body: Body that carries the items; ``None``: the world.
        places: Positions in its frame, (env, item, 3) [m].
        turns: Rotations to its frame, (env, item, 4).
    """
    if body is None:
        return places[None], turns[None]
    positions, orientations = content.poses[body.name]
    moved = transform_points(places, positions, orientations)
    return moved, product(orientations[:, :, None], turns)


def _surface_figures(content: Content, placement: Placement) -> Iterator[Figure]:
    surface = placement.surface
    poses = _world_poses(content, surface.body, placement.position[:, None], placement.orientation[:, None])
    color = surface_color(surface)
    for index in sorted({int(mesh) for mesh in placement.mesh}):
        mesh, active = surface.meshes[index], surface.active[index]
        colors = None if active.all() else np.where(active[:, None], color, INACTIVE * color)
        shape = Shape(mesh.vertices, mesh.faces, colors)
        scales = np.repeat(placement.scale[:, None, None], 3, axis=2)
        yield Figure(surface.name, "surface", shape, color, *poses, scales, (placement.mesh == index)[:, None])


def _sphere_figure(content: Content, group: Spheres) -> Figure:
    turns = np.broadcast_to(_UPRIGHT, (*group.places.shape[:2], 4))
    poses = _world_poses(content, group.body, group.places, turns)
    own = 0.0 if group.body is None else body_size(group.body, content.placements.values(), content.spheres)
    return _sphere_figures(content, group.name, body_color(group.body), poses, group.radii, own)


def _body_set_figure(content: Content, body_set: BodySet) -> Figure:
    _, orientations = content.poses[body_set.body.name]
    return _sphere_figures(
        content, body_set.name, body_color(body_set.body), (body_set.places, orientations), body_set.radii, 0.0
    )


def _is_visible(content: Content, body_set: BodySet) -> bool:
    """Returns whether a body set is drawn: if a contact is visible, or, for centers, if the bodies have no shapes."""
    if body_set.contacts:
        return any(
            contact.visible for contact in content.replay.scene.contacts if contact.name in body_set.contacts
        )
    return all(shape_set.placement.shape.body is not body_set.body for shape_set in content.shape_sets)


def _bare_body_figures(content: Content) -> Iterator[Figure]:
    """Yields a ball for each single body without geometry, which would be invisible otherwise."""
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


def _sphere_figures(
    content: Content, name: str, color: Array, poses: tuple[Array, Array], radii: Array, own: float
) -> Figure:
    """Returns spheres of radii (env, item) [m], or points if all are zero; ``own``: size of their body [m]."""
    if radii.any():
        kind, reach = "sphere", radii
    else:
        kind, reach = "point", np.full_like(radii, 0.5 * POINT * (own or content.size))
    return Figure(name, kind, ball(), color, *poses, np.repeat(reach[..., None], 3, axis=2), reach > 0.0)


def _shape_figures(content: Content, form: ShapePlacement) -> Iterator[Figure]:
    poses = _world_poses(content, form.shape.body, form.positions, form.orientations)
    yield from _by_size(content, form, poses)


def _shape_set_figures(content: Content, shape_set: ShapeSet) -> Iterator[Figure]:
    yield from _by_size(content, shape_set.placement, (shape_set.places, shape_set.turns))


def _by_size(content: Content, form: ShapePlacement, poses: tuple[Array, Array]) -> Iterator[Figure]:
    """Yields one figure per distinct size of the shapes; spheres and ellipsoids are scaled instead."""
    kind, sizes, shape = form.shape.kind, form.sizes, form.positions.shape[:2]

    def figure(what: Shape, scales: Array, present: Any) -> Figure:
        drawn_as = "plane" if issubclass(kind, Plane) else "shape"
        return Figure(form.shape.name, drawn_as, what, form.color, *poses, scales, present)

    everywhere = np.ones(shape, dtype=bool)
    if issubclass(kind, _ROUND):
        scales = sizes["semi_axes"] if "semi_axes" in sizes else np.repeat(sizes["radius"][..., None], 3, axis=2)
        yield figure(ball(), scales, everywhere)
        return
    ones = np.ones((*shape, 3))
    if issubclass(kind, Plane):
        yield figure(analytic_shape(kind, {}, PLANE * content.size), ones, everywhere)
        return
    rows = np.concatenate([values.reshape(*shape, -1) for values in sizes.values()], axis=-1)
    _, first, numbers = np.unique(rows.reshape(-1, rows.shape[-1]), axis=0, return_index=True, return_inverse=True)
    numbers = numbers.reshape(shape)
    for number, entry in enumerate(first.tolist()):
        drawn = analytic_shape(kind, form.item_sizes(*divmod(entry, shape[1])), PLANE * content.size)
        yield figure(drawn, ones, numbers == number)


def _contact_forces(content: Content) -> Iterator[ContactForces]:
    for lines in content.lines:
        name = lines.contact.name
        if lines.contact.visible:
            gaps = content.replay.series(f"{name}.gap")
            if gaps is not None:
                gaps = gaps.reshape(lines.force.shape[:3])
                gaps = np.where(gaps < NEAR * content.size, gaps, np.nan)
            yield ContactForces(name, lines.color, lines.start, lines.force, gaps)
    for lines in content.resultants:
        if lines.contact.visible:
            yield ContactForces(lines.contact.name, lines.color, lines.start, lines.force, None)
