"""Renderer-independent drawing of a recording: figures, curves and contact forces over time."""

import functools
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
import xarray as xr
from numpy.typing import NDArray

from warpcontact.algebra.vectors import quat_multiply, transform_points
from warpcontact.drawing.contact_pressure import ContactPressure
from warpcontact.drawing.content import POINT, Content
from warpcontact.drawing.geometry import (
    INACTIVE,
    PLANE,
    BodySet,
    Placement,
    ShapePlacement,
    Spheres,
    body_color,
    body_size,
    surface_color,
)
from warpcontact.drawing.replay import Replay
from warpcontact.kernels import shapes
from warpcontact.kernels.shapes.base import Plane
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.meshes import icosphere
from warpcontact.scene.elements import Body
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.shapes import tessellate
from warpcontact.validation.checks import Array

# Faces that meet at a smaller angle are shaded smoothly.
SMOOTH_ANGLE = math.radians(25.0)
# Number of subdivisions of an icosahedron for a sphere.
LEVEL = 3
# Number of sides of circular edges.
SECTIONS = 64
# Vertices closer than this fraction of the mesh size are merged.
SAME_VERTEX = 1.0e-6

# Shapes that are scaled from a unit sphere.
_ROUND = (shapes.Sphere, shapes.Ellipsoid)
# Largest gap that is shown, as a multiple of the size; larger gaps would clutter the picture.
NEAR = 0.25
# Radius of the ball that represents a body without geometry, as a multiple of the size.
MARK = 0.1
_UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangle mesh in its own frame.

    Attributes:
        vertices: Positions, (V, 3) [m].
        faces: Vertex indices, (F, 3), counter-clockwise as seen from outside.
        colors: RGB of each face, (F, 3) in 0…1; ``None``: the color of the figure.
        normals: Vertex normals, (V, 3), for smooth shading; ``None``: flat shading.
    """

    vertices: Array
    faces: NDArray[np.int32]
    colors: Array | None = None
    normals: Array | None = None


@dataclass(frozen=True, eq=False)
class Figure:
    """Copies of one shape, placed in each record of each environment.

    Arrays of poses are (time, env, item, …); the size of time is 1 for static figures.

    Attributes:
        name: Name of the scene element.
        kind: ``"surface"``, ``"sphere"``, ``"shape"``, ``"plane"`` (a part of an infinite plane) or ``"point"``.
        shape: Shape that is placed.
        color: RGB in 0…1.
        positions: Origins of the frame of the shape, (time, env, item, 3), world [m].
        orientations: Rotations from shape to world, (time, env, item, 4), x, y, z, w.
        scales: Factors along the axes of the shape, (env, item, 3).
        present: Whether an item exists in an environment, (env, item).
    """

    name: str
    kind: str
    shape: Shape
    color: Array
    positions: Array
    orientations: Array
    scales: Array
    present: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Curve:
    """Moving polyline: a spring, a rope, a catenary.

    Attributes:
        name: Name of the coupling.
        color: RGB in 0…1.
        points: Points, (time, env, n, 3), world [m].
        shown: Visibility, (time, env); false for broken couplings.
    """

    name: str
    color: Array
    points: Array
    shown: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Contact points of a contact, with the forces on the body of the points.

    Attributes:
        name: Name of the contact.
        color: RGB of the arrows in 0…1.
        points: Points K where the forces act, (time, env, item, 3), world [m].
        forces: Forces on the body of the points, (time, env, item, 3), world [N]; zero without contact.
        gaps: Signed distances, (time, env, item) [m], NaN if unknown or large; ``None``: not recorded.
    """

    name: str
    color: Array
    points: Array
    forces: Array
    gaps: Array | None


@dataclass(frozen=True, eq=False)
class Drawing:
    """Drawing of the selected environments of a recording, Z up. Created by ``drawing_of``.

    Attributes:
        times: Simulated time of each record, (time,) [s].
        envs: Numbers of the environments, in the order of the arrays.
        figures: Bodies and surfaces.
        curves: Couplings.
        contact_forces: Contacts whose normal force, normal and point were recorded.
        size: Size of the drawing, the length of the largest body [m]; unit of arrow and line widths.
        force_scale: Arrow length per force [m/N], which draws the largest force at 1.5 times ``size``.
        pressure: Pressure on the areas of body contacts, evaluated on access; ``None``: none of them has forces.
    """

    times: Array
    envs: list[int]
    figures: list[Figure]
    curves: list[Curve]
    contact_forces: list[ContactForces]
    size: float
    force_scale: float
    pressure: ContactPressure | None = None


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
        pressure=content.pressure if content.pressure.contacts else None,
    )


@functools.cache
def ball() -> Shape:
    """Returns the unit sphere. The object is cached, so that renderers can recognize it."""
    mesh = icosphere(1.0, LEVEL)
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    return Shape(mesh.vertices, mesh.faces, normals=normals)


def analytic_shape(kind: type[Form], sizes: Mapping[str, Array], reach: float) -> Shape:
    """Returns the triangles of a shape; ``reach``: half the side of the square that represents a plane [m]."""
    if kind is shapes.Cylinder:
        height = 2.0 * float(sizes["half_length"])
        exact = trimesh.creation.cylinder(float(sizes["radius"]), height, sections=SECTIONS)
    elif kind is shapes.Cone:
        exact = trimesh.creation.cone(float(sizes["radius"]), float(sizes["height"]), sections=SECTIONS)
    else:
        vertices, faces = tessellate(kind, sizes, reach)
        if issubclass(kind, Plane):
            return Shape(vertices, faces.astype(np.int32))
        return smooth(vertices, faces)
    return smooth(np.asarray(exact.vertices), np.asarray(exact.faces))


def smooth(vertices: Array, faces: Any) -> Shape:
    """Returns triangles with normals shared where faces meet at a small angle; drops degenerate faces."""
    size = float(np.ptp(vertices, axis=0).max()) or 1.0
    _, first, number = np.unique(
        np.round(vertices / (SAME_VERTEX * size)), axis=0, return_index=True, return_inverse=True
    )
    faces = number.reshape(-1)[faces]
    vertices = vertices[first]
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    mesh = trimesh.Trimesh(vertices, faces[area > SAME_VERTEX**2 * size**2], process=False)
    split = trimesh.graph.smooth_shade(mesh, angle=SMOOTH_ANGLE, facet_minarea=None)
    return Shape(
        np.asarray(split.vertices),
        np.asarray(split.faces, dtype=np.int32),
        normals=np.asarray(split.vertex_normals),
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
            poses = _world_poses(content, form.shape.body, form.positions, form.orientations)
            yield from _by_size(content, form, poses)
    for shape_set in content.shape_sets:
        if shape_set.placement.shape.visible:
            yield from _by_size(content, shape_set.placement, (shape_set.places, shape_set.turns))


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
    return moved, quat_multiply(orientations[:, :, None], turns)


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
