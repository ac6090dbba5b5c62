"""The camera position is selected such that static objects do not hide moving ones."""

import math
from dataclasses import replace

import numpy as np
import pytest
from handmade_drawings import PLATE, balls, drawing, figure

from warpcontact.drawing.drawing import Shape
from warpcontact.meshes import grid
from warpcontact.visualize.rendering.camera import direction
from warpcontact.visualize.rendering.frame_renderer import FrameRenderer
from warpcontact.visualize.rendering.render_style import RenderStyle

BLUE, GREY = (0.1, 0.2, 0.9), (0.6, 0.6, 0.6)
ON_EDGE = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))  # a plate across the y axis
FRONT = direction(math.radians(-60.0), math.radians(22.0))


def bowl(depth=1.0, **where):
    """z = depth · (x² + y²) over a square of 2 m."""
    mesh = grid((2.0, 2.0), (30, 30))
    x, y, _ = mesh.vertices.T
    shape = Shape(np.stack([x, y, depth * (x * x + y * y)], axis=1), mesh.faces)
    return figure(shape, GREY, [0.0, 0.0, 0.0], **where)


def moving(*places, radius=0.1):
    """A ball with one position per record."""
    ball = balls(BLUE, places[0], radius)
    return replace(ball, positions=np.array(places, dtype=float)[:, None, None])


def show(figures, device, records=2, envs=1, size=1.0, **look):
    shown = replace(
        drawing(figures), times=np.arange(float(records)), envs=list(range(envs)), size=size, force_scale=size
    )
    return FrameRenderer(shown, RenderStyle(size=(96, 64), samples=4, device=device, **look))


def blue(picture):
    red, _, blue = np.moveaxis(picture.astype(int), -1, 0)
    return int((blue > 1.5 * red).sum())


def test_camera_sees_a_ball_in_a_bowl_from_above(device):
    figures = [bowl(), moving((0.0, 0.0, 0.15), (0.1, 0.0, 0.15))]
    chosen = show(figures, device)
    assert blue(chosen.picture(1)) > 20
    assert chosen.camera.backward[2] > math.sin(math.radians(40.0))
    # From the default direction and from the requested one, the bowl hides the ball.
    requested = show(figures, device, view_from=(-60.0, 22.0))
    np.testing.assert_allclose(requested.camera.backward, FRONT)
    assert blue(requested.picture(1)) == 0


def test_camera_sees_a_ball_in_a_well_from_straight_above(device):
    walls = [
        figure(PLATE, GREY, place, (1.0, 8.0, 1.0), turns=turn, name=f"wall {i}")
        for i, (place, turn) in enumerate(
            [
                ([0.0, 1.0, 0.0], ON_EDGE),
                ([0.0, -1.0, 0.0], ON_EDGE),
                ([1.0, 0.0, 0.0], (0.5, 0.5, 0.5, 0.5)),
                ([-1.0, 0.0, 0.0], (0.5, 0.5, 0.5, 0.5)),
            ]
        )
    ]
    chosen = show([*walls, moving((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))], device, distance=60.0, fov=3.0)
    np.testing.assert_allclose(chosen.camera.backward, [0.0, 0.0, 1.0], atol=1e-9)
    assert blue(chosen.picture(1)) > 0


def test_camera_sees_a_ball_behind_a_high_wall_from_another_side(device):
    wall = figure(PLATE, GREY, [0.0, -0.5, 0.0], 8.0, turns=ON_EDGE)
    chosen = show([wall, moving((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))], device)
    np.testing.assert_allclose(chosen.camera.backward, direction(math.radians(30.0), math.radians(22.0)))
    assert blue(chosen.picture(1)) > 20


def test_camera_has_default_direction_if_nothing_is_hidden_or_nothing_helps(device):
    ball = moving((0.0, 0.0, 0.2), (0.1, 0.0, 0.2))
    floor = figure(PLATE, GREY, [0.0, 0.0, 0.1], 8.0)
    lid = figure(PLATE, GREY, [0.0, 0.0, 0.4], 8.0)
    lost = moving((0.0, 0.0, 0.2), (0.1, 0.0, -900.0))  # outside of the picture; there it is behind the floor
    for figures in ([ball], [floor, ball], [floor, lid, ball], [floor], [floor, ball, lost], []):
        np.testing.assert_allclose(show(figures, device).camera.backward, FRONT)


def test_camera_ignores_a_ball_hidden_in_few_records(device):
    post = figure(PLATE, GREY, [0.0, -0.5, 0.0], (0.05, 8.0, 1.0), turns=ON_EDGE)
    ball = moving(*np.linspace((-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), 21), radius=0.02)
    np.testing.assert_allclose(show([post, ball], device, records=21).camera.backward, FRONT)


def test_camera_of_each_panel_uses_the_ground_of_its_environment(device):
    """The bowl of the second environment is so deep that it hides the ball there, but not in the first."""
    ground, ball = bowl(), moving((0.0, 0.0, 0.15), (0.1, 0.0, 0.15))
    two = [np.repeat(values, 2, axis=1) for values in (ball.positions, ball.orientations)]
    ball = replace(
        ball,
        positions=two[0],
        orientations=two[1],
        scales=np.repeat(ball.scales, 2, axis=0),
        present=np.repeat(ball.present, 2, axis=0),
    )
    deep = {
        "positions": np.repeat(ground.positions, 2, axis=1),
        "orientations": np.repeat(ground.orientations, 2, axis=1),
        "scales": np.array([[[1.0, 1.0, 0.01]], [[1.0, 1.0, 1.0]]]),
        "present": np.repeat(ground.present, 2, axis=0),
    }
    assert show([replace(ground, **deep), ball], device, envs=2).camera.backward[2] > math.sin(math.radians(40.0))
    flat = {**deep, "scales": np.full((2, 1, 3), (1.0, 1.0, 0.01))}
    np.testing.assert_allclose(show([replace(ground, **flat), ball], device, envs=2).camera.backward, FRONT)


@pytest.mark.parametrize("unit", [1e-3, 1e4])
def test_camera_visibility_is_invariant_to_scale(unit, device):
    ground = bowl(scales=unit)
    ball = moving((0.0, 0.0, 0.15 * unit), (0.1 * unit, 0.0, 0.15 * unit), radius=0.1 * unit)
    assert show([ground, ball], device, size=unit).camera.backward[2] > math.sin(math.radians(40.0))
