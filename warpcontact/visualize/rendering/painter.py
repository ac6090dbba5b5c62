"""Paints one view: the rays of a picture, by all threads of a CPU or one launch on a GPU."""

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.drawing.colors import linear
from warpcontact.kernels.rendering.paint import View, kernel
from warpcontact.kernels.rendering.shade import Backdrop, Grid, Light
from warpcontact.system.compilation import compile_as_launched
from warpcontact.system.resources import available_threads
from warpcontact.validation.checks import Array
from warpcontact.visualize.rendering.camera import Camera, direction
from warpcontact.visualize.rendering.items import Items, turned_axes
from warpcontact.visualize.rendering.stage import Stage

Picture = NDArray[np.uint8]

# The sun, from the left of the eye and above [rad], and the radius of its disc at distance 1.
_ASIDE, _HEIGHT, _SPREAD = math.radians(45.0), math.radians(50.0), 0.035
# Distances from the target at which planes without end begin to fade into the background, and have, in halves of
# the view or, if that is more, in distances of the target from them: what is below it is seen farther away.
_FADE = (3.0, 12.0)
# Lines of the grid in half of the view from top to bottom, about.
_LINES = 3.0
# Rows of a picture that a thread takes at once on a CPU.
_ROWS = 8


class Painter:
    """Paints views of a stage.

    Args:
        stage: What there is to see.
        background: Colours as displayed at the top and the bottom, (2, 3).
        threads: How many threads paint on a CPU; ``None``: one per core.
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
    ) -> Picture:
        """Returns a picture, (height, width, 3) sRGB.

        Args:
            items: What throws shadows.
            marks: What is shown over it, such as arrows.
            camera: Where from.
            size: Width and height [pixels].
            samples: Rays of a pixel at most.
        """
        width, height = size
        device = self._stage.device
        # Lengths are in halves of the view, so that no tolerance depends on the scene.
        unit = camera.reach
        items, (self._backdrop.fade_from, self._backdrop.fade_to) = extend_planes(items, camera)
        worlds = [self._stage.world(group, camera.target, unit) for group in (items, marks)]
        view, light = _view(camera, unit, width, height, samples), light_of(camera)
        pixels = wp.empty((width * height, 3), dtype=wp.uint8, device=device)
        grid = _grid(camera, height)
        inputs = [view, *(world.struct for world in worlds), light, grid, self._backdrop]
        paint = kernel()
        compile_as_launched(paint, device)
        rows = height if device.is_cuda else _ROWS
        launches = []
        for first in range(0, width * height, rows * width):
            count = min(rows * width, width * height - first)
            launches.append(
                wp.launch(paint, dim=count, inputs=[first, *inputs, pixels], device=device, record_cmd=True)
            )
        if device.is_cuda or self._threads < 2:
            for launch in launches:
                launch.launch()
        else:
            with ThreadPoolExecutor(min(self._threads, len(launches))) as pool:
                list(pool.map(lambda launch: launch.launch(), launches))
        return pixels.numpy().reshape(height, width, 3)


def extend_planes(items: Sequence[Items], camera: Camera) -> tuple[list[Items], tuple[float, float]]:
    """Returns items with planes without end as far as they are seen, and where these fade into the background.

    They begin to at the first distance from the target, and have at the second, in halves of the view.
    """
    unit = camera.reach
    scale = max([1.0, *(_farthest(group, camera.target) / unit for group in items if group.infinite)])
    begin, end = (scale * distance for distance in _FADE)
    return [group.extend(camera.target, end * unit) for group in items], (begin, end)


def _view(camera: Camera, unit: float, width: int, height: int, samples: int) -> View:
    view = View()
    view.right, view.up, view.forward = (wp.vec3(*axis.tolist()) for axis in camera.axes)
    view.eye = wp.vec3(*(camera.distance / unit * camera.backward).tolist())
    view.tangent = math.tan(0.5 * camera.angle)
    view.width, view.height, view.samples = width, height, samples
    return view


def _farthest(planes: Items, point: Array) -> float:
    """Returns the greatest distance of a point from planes z = 0 in their own frames [m]."""
    normals = turned_axes(planes.rotations)[:, 2]
    return float(np.abs(((point - planes.positions) * normals).sum(axis=1)).max(initial=0.0))


def _grid(camera: Camera, height: int) -> Grid:
    """Returns lines at 1, 2 or 5 times a power of ten metres, a few of them in the view."""
    grid = Grid()
    wanted = camera.reach / _LINES
    power = 10.0 ** math.floor(math.log10(wanted))
    step = max(power * nice for nice in (1.0, 2.0, 5.0) if power * nice <= wanted * (1.0 + 1.0e-9))
    grid.step = step / camera.reach
    # The target is the origin of kernels; of its coordinates only the part within a step matters.
    grid.origin = wp.vec2(*(-np.mod(camera.target[:2], step) / camera.reach).tolist())
    grid.shade = 0.8
    grid.pixel = 2.0 * math.tan(0.5 * camera.angle) / height
    return grid


def light_of(camera: Camera) -> Light:
    """Returns the light of a view: the sun stands to the left of the eye, wherever that is."""
    light = Light()
    right = camera.axes[0]
    # The azimuth of the eye, also from straight above.
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
