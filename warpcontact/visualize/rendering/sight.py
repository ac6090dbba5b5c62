"""Visibility of moving bodies from a camera, and choice of the camera."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.algebra.poses import transform_points
from warpcontact.drawing.drawing import Drawing, Figure
from warpcontact.drawing.triangles import ball
from warpcontact.kernels.rendering.sight import kernel
from warpcontact.validation.checks import Array
from warpcontact.visualize.rendering.camera import Camera
from warpcontact.visualize.rendering.items import Items, bounds, place_figure
from warpcontact.visualize.rendering.painter import extend_planes
from warpcontact.visualize.rendering.stage import Stage

# A body counts as visible if it is seen in at least this fraction of its records. A camera that sees at least this
# fraction of the bodies is accepted.
MIN_RECORD_FRACTION, MIN_BODY_FRACTION = 0.75, 0.95
# Largest number of bodies per panel, and of panels, that are tested.
BODIES, PANELS = 400, 16
# Occlusion within this distance of a body's center is ignored, in half heights of the view: points lie on surfaces.
_MIN_RADIUS = 0.01


@dataclass(frozen=True, eq=False)
class Targets:
    """Bodies of one panel, and its static items.

    Attributes:
        centres: Body centers, (record, body, 3), world [m]; NaN if a body is not present.
        radii: Radii of inscribed balls, (record, body) [m].
        static: Static items.
    """

    centres: Array
    radii: Array
    static: list[Items]


class Visibility:
    """Test of the visibility of bodies.

    Args:
        stage: Stage with the meshes of static items.
        panels: Bodies and static items of each panel.
        camera: Approximate camera; it defines origin and unit of length on the device.
    """

    def __init__(self, stage: Stage, panels: Sequence[Targets], camera: Camera) -> None:
        self._origin, self._unit, self._device = camera.target, camera.reach, stage.device
        self._panels = [
            (panel, stage.world(extend_planes(panel.static, camera)[0], self._origin, self._unit))
            for panel in panels
        ]

    def visible_fraction(self, camera: Camera, aspect: float) -> float:
        """Returns the fraction of bodies that are visible in most of the records in which they are in the picture.

        1 if there are none. ``aspect`` is the width of the picture divided by its height.
        """
        eye = camera.target + camera.distance * camera.backward
        right, up, forward = camera.axes
        slope = np.tan(0.5 * camera.angle)
        found = []
        for panel, world in self._panels:
            offset = panel.centres - eye
            depth = slope * (offset @ forward)
            # Comparisons with NaN, for bodies that are not present, are false.
            inside = (np.abs(offset @ right) <= aspect * depth) & (np.abs(offset @ up) <= depth)
            radii = np.maximum(panel.radii / self._unit, _MIN_RADIUS)[inside]
            points = (panel.centres[inside] - self._origin) / self._unit
            is_visible = wp.zeros(len(points), dtype=wp.uint8, device=self._device)
            if len(points):
                wp.launch(
                    kernel(),
                    dim=len(points),
                    inputs=[
                        world.struct,
                        wp.vec3(*((eye - self._origin) / self._unit).tolist()),
                        wp.array(points, dtype=wp.vec3, device=self._device),
                        wp.array(radii, dtype=wp.float32, device=self._device),
                    ],
                    outputs=[is_visible],
                    device=self._device,
                )
            visible = np.zeros(inside.shape)
            visible[inside] = is_visible.numpy()
            in_picture = inside.sum(axis=0)
            found.append((visible.sum(axis=0) >= MIN_RECORD_FRACTION * in_picture)[in_picture > 0])
        bodies = np.concatenate(found) if found else np.zeros(0, dtype=bool)
        return float(bodies.mean()) if len(bodies) else 1.0


def best_camera(visibility: Visibility, cameras: Sequence[Camera], aspect: float) -> Camera:
    """Returns the first camera that sees nearly all bodies, or else the first that sees most of them."""
    best, most = cameras[0], -1.0
    for camera in cameras:
        part = visibility.visible_fraction(camera, aspect)
        if part > most:
            best, most = camera, part
        if part >= MIN_BODY_FRACTION:
            break
    return best


def find_targets(drawing: Drawing, panels: Sequence[Sequence[int]], records: Sequence[int]) -> list[Targets]:
    """Returns bodies and static items of some panels; empty if nothing can be hidden.

    Args:
        drawing: The drawing.
        panels: Environment rows of each panel.
        records: Indices of the records that are tested.
    """
    static = [figure for figure in drawing.figures if len(figure.positions) == len(figure.orientations) == 1]
    moving = [figure for figure in drawing.figures if figure not in static]
    if not static or not moving:
        return []
    found = []
    for number in _evenly(len(panels), PANELS):
        rows = panels[number]
        parts = [_bodies(figure, row, records) for figure in moving for row in rows]
        centers, radii = (np.concatenate(column, axis=1) for column in zip(*parts, strict=True))
        chosen = _evenly(centers.shape[1], BODIES)
        static_items = [place_figure(figure, 0, row) for figure in static for row in rows]
        found.append(Targets(centers[:, chosen], radii[:, chosen], static_items))
    return found


def _bodies(figure: Figure, row: int, records: Sequence[int]) -> tuple[Array, Array]:
    """Returns centers (record, item, 3) and radii (record, item) [m] of copies of a figure, NaN if not present."""
    positions, rotations = (
        values[list(records), row] if len(values) > 1 else np.repeat(values[:, row], len(records), axis=0)
        for values in (figure.positions, figure.orientations)
    )
    scales = np.broadcast_to(figure.scales[row], positions.shape)
    middle, half = (np.zeros(3), np.ones(3)) if figure.shape is ball() else bounds(figure.shape)
    good = np.isfinite(positions).all(axis=-1) & np.isfinite(rotations).all(axis=-1) & figure.present[row]
    centers = np.full(positions.shape, np.nan)
    centers[good] = transform_points((scales[good] * middle)[:, None], positions[good], rotations[good])[:, 0]
    return centers, (scales * half).min(axis=-1)


def _evenly(count: int, most: int) -> NDArray[np.int_]:
    """Returns at most ``most`` of the numbers 0 … ``count`` − 1, evenly spaced."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))
