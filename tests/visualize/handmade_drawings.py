"""Handmade drawings that can be rendered without a simulation."""

import math

import numpy as np
import warp as wp

from warpcontact.drawing.drawing import Drawing, Figure, Shape, ball
from warpcontact.visualize.rendering.camera import Camera, direction
from warpcontact.visualize.rendering.painter import Painter
from warpcontact.visualize.rendering.stage import Stage, place_figure

WHITE = np.ones((2, 3))
PLATE = Shape(
    np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
)


def figure(shape, color, positions, scales=1.0, turns=(0.0, 0.0, 0.0, 1.0), name="thing", kind="surface"):
    """Copies of a shape in one record of one environment."""
    positions = np.asarray(positions, dtype=float).reshape(1, 1, -1, 3)
    count = positions.shape[2]
    turns = np.broadcast_to(np.asarray(turns, dtype=float), (1, 1, count, 4))
    scales = np.asarray(scales, dtype=float)
    scales = scales[:, None] if scales.ndim == 1 and len(scales) == count != 3 else scales
    return Figure(
        name,
        kind,
        shape,
        np.array(color, dtype=float),
        positions,
        turns,
        np.array(np.broadcast_to(scales, (1, count, 3))),
        np.ones((1, count), dtype=bool),
    )


def balls(color, positions, radii):
    """Spheres."""
    return figure(ball(), color, positions, radii, name="balls")


def drawing(figures, curves=(), contact_forces=(), size=1.0):
    """A drawing of one record of environment 0."""
    return Drawing(np.zeros(1), [0], list(figures), list(curves), list(contact_forces), size, 1.0)


def camera(azimuth=0.0, elevation=0.0, *, distance=10.0, angle=20.0, target=(0.0, 0.0, 0.0)):
    """A camera given by angles [degrees]."""
    backward = direction(math.radians(azimuth), math.radians(elevation))
    return Camera(np.array(target, dtype=float), backward, distance, math.radians(angle))


def paint(figures, eye, size=(128, 128), samples=1, background=WHITE, device="cpu", threads=1, has_grid=()):
    """Picture of figures; those in ``has_grid`` are drawn with grid lines."""
    stage = Stage(drawing(figures), wp.get_device(device))
    items = [place_figure(one, 0, 0, has_grid=one in has_grid) for one in figures]
    return Painter(stage, background, threads).paint(items, [], eye, size, samples)


def covered(picture):
    """Pixels that differ from a white background."""
    return (picture < 255).any(axis=-1)
