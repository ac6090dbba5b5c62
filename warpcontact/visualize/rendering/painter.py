"""Paints one view by ray tracing: with all threads of a CPU, or with one launch on a GPU."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.drawing.colors import linear
from warpcontact.kernels.rendering.paint import Backdrop, Grid, Light, View, kernel
from warpcontact.system.compilation import compile_as_launched
from warpcontact.system.launches import in_order
from warpcontact.system.resources import available_threads
from warpcontact.validation.checks import Array
from warpcontact.visualize.rendering.camera import Camera, direction, extend_planes
from warpcontact.visualize.rendering.stage import Items, Stage

Picture = NDArray[np.uint8]

# Sun: azimuth to the left of the camera and elevation [rad], and radius of its disk at distance 1.
_ASIDE, _HEIGHT, _SPREAD = math.radians(45.0), math.radians(50.0), 0.035
# Approximate number of grid lines in half the height of the view.
_LINES = 3.0
# Number of picture rows per CPU work item.
_ROWS = 8


class Painter:
    """Paints views of a stage.

    Args:
        stage: Stage with the meshes.
        background: sRGB colors at top and bottom, (2, 3).
        threads: Number of CPU threads; ``None``: one per core.
    """

    def __init__(self, stage: Stage, background: Array, threads: int | None = None) -> None:
        self._stage = stage
        self._backdrop = Backdrop()
        self._backdrop.top, self._backdrop.bottom = (wp.vec3(*row) for row in linear(background).tolist())
        self._threads = available_threads() if threads is None else threads

    def paint(
        self,
        items: Sequence[Items],
        marks: Sequence[Items],
        camera: Camera,
        size: tuple[int, int],
        samples: int,
        mark_stage: Stage | None = None,
    ) -> Picture:
        """Renders a view; returns a picture, (height, width, 3) sRGB.

        Args:
            items: Items that cast shadows.
            marks: Items drawn in front of them, such as arrows.
            camera: The camera.
            size: Width and height [pixels].
            samples: Largest number of rays per pixel.
            mark_stage: Stage with the meshes of the marks; ``None``: they have none.
        """
        width, height = size
        device = self._stage.device
        # Lengths are in half heights of the view, so that tolerances do not depend on the scene.
        unit = camera.reach
        items, (self._backdrop.fade_from, self._backdrop.fade_to) = extend_planes(items, camera)
        worlds = [
            stage.world(group, camera.target, unit)
            for stage, group in ((self._stage, items), (mark_stage or self._stage, marks))
        ]
        view, light = _view(camera, unit, width, height, samples), light_of(camera)
        pixels = wp.empty((width * height, 3), dtype=wp.uint8, device=device)
        grid = _grid(camera, height)
        inputs = {"view": view, "light": light, "grid": grid, "backdrop": self._backdrop, "picture": pixels}
        inputs |= {name: world.struct for name, world in zip(("world", "marks"), worlds, strict=True)}
        paint = kernel()
        compile_as_launched(paint, device)
        rows = height if device.is_cuda else _ROWS
        launches = []
        for first in range(0, width * height, rows * width):
            count = min(rows * width, width * height - first)
            values = in_order(paint, {"first": first, **inputs})
            launches.append(wp.launch(paint, dim=count, inputs=values, device=device, record_cmd=True))
        if device.is_cuda or self._threads < 2:
            for launch in launches:
                launch.launch()
        else:
            with ThreadPoolExecutor(min(self._threads, len(launches))) as pool:
                list(pool.map(lambda launch: launch.launch(), launches))
        return pixels.numpy().reshape(height, width, 3)


def _view(camera: Camera, unit: float, width: int, height: int, samples: int) -> View:
    view = View()
    view.right, view.up, view.forward = (wp.vec3(*axis.tolist()) for axis in camera.axes)
    view.eye = wp.vec3(*(camera.distance / unit * camera.backward).tolist())
    view.tangent = math.tan(0.5 * camera.angle)
    view.width, view.height, view.samples = width, height, samples
    return view


def _grid(camera: Camera, height: int) -> Grid:
    """Returns a grid with a spacing of 1, 2 or 5 times a power of ten [m], about ``_LINES`` per half view height."""
    grid = Grid()
    target_spacing = camera.reach / _LINES
    power = 10.0 ** math.floor(math.log10(target_spacing))
    step = max(power * nice for nice in (1.0, 2.0, 5.0) if power * nice <= target_spacing * (1.0 + 1.0e-9))
    grid.step = step / camera.reach
    # Kernels use the target as origin; only its position within a grid cell matters.
    grid.origin = wp.vec2(*(-np.mod(camera.target[:2], step) / camera.reach).tolist())
    grid.shade = 0.8
    grid.pixel = 2.0 * math.tan(0.5 * camera.angle) / height
    return grid


def light_of(camera: Camera) -> Light:
    """Returns the light of a view, with the sun to the left of the camera."""
    light = Light()
    right = camera.axes[0]
    # The azimuth of the camera, also defined from straight above.
    azimuth = math.atan2(-right[0], right[1])
    sun = direction(azimuth - _ASIDE, _HEIGHT)
    across = np.cross(sun, (0.0, 0.0, 1.0))
    across /= np.linalg.norm(across)
    light.sun, light.across, light.along = (
        wp.vec3(*axis.tolist()) for axis in (sun, across, np.cross(sun, across))
    )
    light.spread = _SPREAD
    light.sun_color = wp.vec3(0.76, 0.73, 0.68)
    light.sky_color = wp.vec3(0.40, 0.42, 0.46)
    light.ground_color = wp.vec3(0.24, 0.23, 0.22)
    light.lamp, light.gloss, light.occlusion_range = 0.24, 0.12, 0.5
    return light
