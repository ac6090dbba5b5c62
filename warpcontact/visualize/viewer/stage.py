"""Draws one environment on the page; sends only the objects that changed."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from warpcontact.drawing.colors import Scale, gap_colors, linear, pressure_scale
from warpcontact.drawing.contact_pressure import PressurePatches
from warpcontact.drawing.drawing import ContactForces, Curve, Drawing, Figure, Shape
from warpcontact.validation.checks import Array

# Lights: hemisphere light with gray ground, and one directional light.
SKY = 1.8
GROUND = (150, 150, 150)
SUN = 1.8
SUN_DIRECTION = (-4.0, -6.0, 10.0)

# Widths, as multiples of the size of the drawing.
ARROW = 0.03
LINE = 0.02
SPOT = 0.08
# Distance of areas of contact from their surfaces, as a multiple of the size of the drawing.
LIFT = 2.0e-3
# Colors in the texture of pressures.
_TEXELS = 256
# Opacity of bodies when the areas between them are shown.
SEE_THROUGH = 0.35
#: Range of the gap colors, as multiples of the size: penetration and distance.
DEEP_FRACTION, FAR_FRACTION = 0.02, 1.0

# Up to this number of copies, all are drawn in full. With more, distant ones are simplified.
FEW = 64
# Direction from the look-at point to the camera, and distance as a multiple of the radius shown.
CAMERA_DIRECTION = np.array([0.8, -1.5, 0.7]) / np.linalg.norm([0.8, -1.5, 0.7])
CAMERA_DISTANCE = 2.6


def by_color(shape: Shape, color: Array) -> Iterator[tuple[Array, NDArray[Any], Array]]:
    """Yields the faces of a shape of each color as (vertices, faces, color)."""
    if shape.colors is None:
        yield shape.vertices, shape.faces, color
        return
    colors, number = np.unique(shape.colors, axis=0, return_inverse=True)
    for i, face_color in enumerate(colors):
        used, faces = np.unique(shape.faces[number.reshape(-1) == i], return_inverse=True)
        yield shape.vertices[used], faces.reshape(-1, 3), face_color


def is_same(a: Shape, b: Shape) -> bool:
    """Returns whether two shapes have the same vertices, faces and colors, and both or neither have normals."""
    if a is b:
        return True
    if (a.normals is None) != (b.normals is None) or (a.colors is None) != (b.colors is None):
        return False
    pairs: list[tuple[Any, Any]] = [(a.vertices, b.vertices), (a.faces, b.faces)]
    if a.colors is not None and b.colors is not None:
        pairs.append((a.colors, b.colors))
    return all(one is other or np.array_equal(one, other) for one, other in pairs)


@dataclass
class _Drawn:
    """Figure on the page, with one node per color."""

    shape: Shape
    color: Array
    name: str
    nodes: list[Any]
    colors: list[Array]


class Stage:
    """Three-dimensional scene of a page.

    Args:
        server: Server of the page.

    Attributes:
        forces: Whether to draw force arrows.
        length: Factor on the length of arrows.
        gaps: Whether to color contacts by their gaps.
        pressure: Whether to show the areas of body contacts colored by pressure, and bodies transparent.
        largest_pressure: Largest pressure shown since the environment was selected, the end of the color scale [Pa].
        following: Whether the camera moves with the bodies.
    """

    def __init__(self, server: Any) -> None:
        self.server = server
        self.forces = True
        self.length = 1.0
        self.gaps = False
        self.pressure = False
        self.largest_pressure = 0.0
        self.following = False
        self._figures: list[_Drawn] = []
        self._curves: list[Any] = []
        self._touches: list[tuple[Any, Any]] = []
        self._patches: list[Any] = []
        self._names: list[list[str]] = []
        self._center: Array | None = None
        # The default lights of viser overexpose colors.
        server.scene.configure_environment_map(None)
        server.scene.configure_default_lights(False)
        server.scene.add_light_hemisphere("/lights/sky", ground_color=GROUND, intensity=SKY)
        server.scene.add_light_directional(
            "/lights/sun", intensity=SUN, cast_shadow=True, position=tuple(SUN_DIRECTION)
        )

    def show(self, drawing: Drawing, record: int, force_scale: float) -> None:
        """Draws one record of the first environment of a drawing.

        Args:
            drawing: Drawing of the environment.
            record: Index of the record.
            force_scale: Arrow length per force [m/N].
        """
        with self.server.atomic():
            names = [
                [one.name for one in group] for group in (drawing.figures, drawing.curves, drawing.contact_forces)
            ]
            if names != self._names:
                self.clear()
                self._names = names
                self._curves = [self._add_curve(i, curve, drawing) for i, curve in enumerate(drawing.curves)]
                self._touches = [
                    self._add_touch(i, contact, drawing) for i, contact in enumerate(drawing.contact_forces)
                ]
            colors = {} if not self.gaps else {one.name: one.gaps for one in drawing.contact_forces}
            spheres = set()
            for number, figure in enumerate(drawing.figures):
                gaps = colors.get(figure.name)
                if (
                    gaps is not None
                    and figure.kind in ("sphere", "point")
                    and gaps.shape[2:] == figure.present.shape[1:]
                ):
                    spheres.add(figure.name)
                    self._place(number, figure, record, _gap_colors(gaps[record, 0], drawing.size))
                else:
                    self._place(number, figure, record, None)
            for curve, node in zip(drawing.curves, self._curves, strict=True):
                points = at(curve.points, record)
                node.points = np.stack([points[:-1], points[1:]], axis=1)
                node.visible = bool(at(curve.shown, record))
            for contact, (arrows, spots) in zip(drawing.contact_forces, self._touches, strict=True):
                self._draw_forces(arrows, contact, record, force_scale)
                self._draw_spots(spots, contact, record, drawing.size, shown=contact.name not in spheres)
            self._draw_pressure(drawing, record)
            if self.following:
                self.follow(drawing, record)

    def clear(self) -> None:
        """Removes all figures, curves, arrows and spots from the page."""
        for drawn in self._figures:
            for node in drawn.nodes:
                node.remove()
        for node in [*self._curves, *self._patches, *(one for pair in self._touches for one in pair)]:
            node.remove()
        self._figures, self._curves, self._touches, self._names = [], [], [], []
        self._patches, self.largest_pressure = [], 0.0

    def frame_bodies(self, drawing: Drawing, record: int) -> None:
        """Moves the cameras so that all moving bodies are in view."""
        center, radius = middle(drawing, record)
        self._center = center
        position = center + CAMERA_DISTANCE * radius * CAMERA_DIRECTION
        for camera in self._cameras():
            # Set the position first: it moves the look-at point along.
            camera.position, camera.look_at = position, center
        self.server.initial_camera.near = 0.01 * radius
        self.server.initial_camera.far = max(1000.0, 1000.0 * radius)

    def follow(self, drawing: Drawing, record: int) -> None:
        """Translates the cameras with the bodies, at constant direction and distance."""
        center, _ = middle(drawing, record)
        if self._center is None:
            self.frame_bodies(drawing, record)
            return
        displacement = center - self._center
        if not displacement.any():
            return
        self._center = center
        for camera in self._cameras():
            camera.position, camera.look_at = camera.position + displacement, camera.look_at + displacement

    def _cameras(self) -> list[Any]:
        """Returns the cameras of the open pages, and the initial camera of pages opened later."""
        return [self.server.initial_camera, *(one.camera for one in self.server.get_clients().values())]

    def _place(self, number: int, figure: Figure, record: int, colors: Array | None) -> None:
        """Draws a figure at a record; ``colors``: one color per item, instead of that of the figure."""
        present = figure.present[0]
        positions, orientations = at(figure.positions, record)[present], at(figure.orientations, record)[present]
        orientations, scales = orientations[:, [3, 0, 1, 2]], figure.scales[0][present]
        previous = self._figures[number] if number < len(self._figures) else None
        if previous is None or not is_same(previous.shape, figure.shape) or (previous.color != figure.color).any():
            for node in [] if previous is None else previous.nodes:
                node.remove()
            self._figures[number:] = [
                self._add_figure(number, figure, orientations, positions, scales),
                *self._figures[number + 1 :],
            ]
            previous = self._figures[number]
        for node, color in zip(previous.nodes, previous.colors, strict=True):
            node.visible = bool(present.any())
            node.opacity = SEE_THROUGH if self.pressure and figure.kind not in ("surface", "plane") else None
            if present.any():
                node.batched_positions, node.batched_wxyzs, node.batched_scales = positions, orientations, scales
                node.batched_colors = _bytes(linear(color if colors is None else colors[present]))

    def _add_figure(
        self, number: int, figure: Figure, orientations: Array, positions: Array, scales: Array
    ) -> _Drawn:
        nodes, colors = [], []
        if not len(positions):
            orientations, positions, scales = np.array([[1.0, 0.0, 0.0, 0.0]]), np.zeros((1, 3)), np.ones((1, 3))
        for i, (vertices, faces, color) in enumerate(by_color(figure.shape, figure.color)):
            nodes.append(
                self.server.scene.add_batched_meshes_simple(
                    f"/figures/{number}_{_plain(figure.name)}/{i}",
                    vertices,
                    faces,
                    orientations,
                    positions,
                    batched_scales=scales,
                    batched_colors=_bytes(linear(color)),
                    lod="off" if len(positions) <= FEW else "auto",
                    flat_shading=figure.shape.normals is None,
                    side="double",
                    cast_shadow=figure.kind != "surface",
                )
            )
            colors.append(color)
        return _Drawn(figure.shape, figure.color, figure.name, nodes, colors)

    def _add_curve(self, number: int, curve: Curve, drawing: Drawing) -> Any:
        return self.server.scene.add_line_segments(
            f"/couplings/{number}_{_plain(curve.name)}",
            np.zeros((1, 2, 3)),
            _bytes(curve.color),
            thickness=LINE * drawing.size,
        )

    def _add_touch(self, number: int, contact: ContactForces, drawing: Drawing) -> tuple[Any, Any]:
        name, size = f"/contacts/{number}_{_plain(contact.name)}", drawing.size
        arrows = self.server.scene.add_arrows(
            f"{name}/force",
            np.zeros((1, 2, 3)),
            _bytes(linear(contact.color)),
            shaft_radius=ARROW * size,
            head_radius=2.0 * ARROW * size,
            head_length=4.0 * ARROW * size,
            visible=False,
        )
        spots = self.server.scene.add_point_cloud(
            f"{name}/gap",
            np.zeros((1, 3)),
            np.zeros((1, 3), np.uint8),
            point_size=SPOT * size,
            point_shape="circle",
            precision="float32",
            visible=False,
        )
        return arrows, spots

    def _draw_forces(self, node: Any, contact: ContactForces, record: int, force_scale: float) -> None:
        force = at(contact.forces, record)
        acting = force.any(axis=-1)
        if self.forces and acting.any():
            start = at(contact.points, record)[acting]
            node.points = np.stack([start, start + self.length * force_scale * force[acting]], axis=1)
        node.visible = bool(self.forces and acting.any())

    def _draw_pressure(self, drawing: Drawing, record: int) -> None:
        """Shows the areas of body contacts; meshes are replaced, because their triangles change."""
        for node in self._patches:
            node.remove()
        self._patches = []
        if not self.pressure or drawing.pressure is None:
            return
        patches = drawing.pressure.at(record, 0)
        largest = max((float(one.pressures.max()) for one in patches), default=0.0)
        self.largest_pressure = max(self.largest_pressure, largest)
        scale = pressure_scale(self.largest_pressure or 1.0)
        self._patches = [
            self.server.scene.add_mesh_trimesh(
                f"/pressure/{number}",
                pressure_mesh(one, scale, LIFT * drawing.size),
                cast_shadow=False,
                receive_shadow=False,
            )
            for number, one in enumerate(patches)
        ]

    def _draw_spots(self, node: Any, contact: ContactForces, record: int, size: float, *, shown: bool) -> None:
        gaps = None if contact.gaps is None else at(contact.gaps, record)
        # Without spots for large gaps, which would clutter the picture.
        near = np.zeros(0, bool) if gaps is None or not (shown and self.gaps) else gaps < FAR_FRACTION * size
        if gaps is not None and near.any():
            # Update both together: a cloud with fewer colors than points is drawn black.
            with self.server.atomic():
                node.points = at(contact.points, record)[near].astype(np.float32)
                node.colors = _bytes(_gap_colors(gaps[near], size))
        node.visible = bool(near.any())


def pressure_mesh(patches: PressurePatches, scale: Scale, lift: float) -> trimesh.Trimesh:
    """Returns the area of a contact as a mesh with the color map as a texture, independent of light.

    Args:
        patches: The area.
        scale: Color scale of the pressures.
        lift: Distance from the reference surface, which may be drawn at the same depth [m].
    """
    vertices = (patches.positions + lift * patches.normals[:, None]).reshape(-1, 3)
    at = np.clip(patches.pressures.reshape(-1) / scale.high, 0.0, 1.0)
    colors = _bytes(scale.colors(np.linspace(scale.low, scale.high, _TEXELS)))
    material = trimesh.visual.material.PBRMaterial(
        emissiveTexture=Image.fromarray(colors[None]),
        emissiveFactor=[1.0, 1.0, 1.0],
        baseColorFactor=[0, 0, 0, 255],
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=True,
    )
    # From the center of the first to that of the last texel.
    across = (0.5 + at * (_TEXELS - 1)) / _TEXELS
    visual = trimesh.visual.TextureVisuals(uv=np.stack([across, np.full_like(at, 0.5)], axis=1), material=material)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    return trimesh.Trimesh(vertices, faces, visual=visual, process=False)


def at(values: NDArray[Any], record: int) -> NDArray[Any]:
    """Returns the values of the first environment at a record from an array (1|time, env, …)."""
    return values[record if len(values) > 1 else 0, 0]


def middle(drawing: Drawing, record: int) -> tuple[Array, float]:
    """Returns center of the moving bodies, world [m], and radius to show around it [m]."""
    moving = [figure for figure in drawing.figures if figure.kind != "surface" or len(figure.positions) > 1]
    positions = [at(figure.positions, record)[figure.present[0]] for figure in moving]
    if not positions or not sum(map(len, positions)):
        positions = [contact.points[min(record, len(contact.points) - 1), 0] for contact in drawing.contact_forces]
    if not positions or not sum(map(len, positions)):
        return np.zeros(3), 5.0 * drawing.size
    box = np.concatenate(positions)
    low, high = box.min(axis=0), box.max(axis=0)
    return 0.5 * (low + high), max(0.6 * float(np.linalg.norm(high - low)), 3.0 * drawing.size)


def _gap_colors(gaps: Array, size: float) -> Array:
    return gap_colors(gaps, DEEP_FRACTION * size, FAR_FRACTION * size)


def _bytes(color: Array) -> NDArray[np.uint8]:
    return (255.0 * np.clip(color, 0.0, 1.0)).round().astype(np.uint8)


def _plain(name: str) -> str:
    """Returns a user's name with only characters that are valid in a node name, at most 40."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", name)[:40]
