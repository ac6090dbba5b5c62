"""What the picture of a run tells of the ground, and of the numbers that colour the tracks."""

import math

import numpy as np
import pytest
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

import warpcontact as wc
from warpcontact.experiment import picture
from warpcontact.experiment.ground import Ground, contour_step, draw_from_above
from warpcontact.frames import placed

WINDOW = np.array([-2.0, -2.0]), np.array([2.0, 2.0])


def terrain(tilt, amplitude=0.1):
    """amplitude · sin · sin, with waves of a metre, turned about the y axis by an angle [degrees]."""
    mesh = wc.meshes.grid((4.0, 4.0), (64, 64))
    x, y, _ = mesh.vertices.T
    vertices = np.stack([x, y, amplitude * np.sin(2 * np.pi * x) * np.sin(2 * np.pi * y)], axis=1)
    half = math.radians(0.5 * tilt)
    corners = placed(vertices, np.zeros(3), np.array([0.0, math.sin(half), 0.0, math.cos(half)]))[mesh.faces]
    return Ground(corners, np.ones(len(corners), dtype=bool), True), vertices[mesh.faces].mean(axis=1)


def drawn(ground, step=0.0):
    axes = Figure().add_subplot()
    draw_from_above(axes, ground, *WINDOW, step)
    return axes


def greys_of(ground, middles):
    """The greys that faces are drawn in, in their own order."""
    faces = drawn(ground).collections[0]
    lower_first = np.argsort(ground.corners[..., 2].mean(axis=1))
    greys = np.empty(len(middles))
    greys[lower_first] = faces.get_facecolor()[:, 0]
    return greys


@pytest.mark.parametrize("tilt", [0.0, 10.0, -25.0])
def test_hills_look_like_hills_however_the_ground_is_inclined(tilt):
    ground, middles = terrain(tilt)
    greys = greys_of(ground, middles)
    # Over a wave, what is higher above the ground's own plane is lighter.
    assert np.corrcoef(greys, middles[:, 2])[0, 1] > 0.9
    # Both families of ridges of sin · sin are seen alike: ½ cos of x − y, and of x + y.
    x, y = 2.0 * np.pi * middles[:, :2].T
    ridges = [abs(np.mean(greys * np.exp(1j * (x + sign * y)))) for sign in (-1, 1)]
    assert ridges[0] == pytest.approx(ridges[1], rel=0.05)
    # Of the inclination as a whole nothing is left.
    assert abs(np.corrcoef(greys, middles[:, 0])[0, 1]) < 0.05


@pytest.mark.parametrize("tilt", [0.0, 10.0])
def test_what_is_plane_is_of_one_grey(tilt):
    ground, middles = terrain(tilt, amplitude=0.0)
    assert np.ptp(greys_of(ground, middles)) < 1e-6


def test_contours_are_where_they_say():
    ground, _ = terrain(10.0, amplitude=0.0)
    step = contour_step([ground], *WINDOW)
    assert step == pytest.approx(0.1)  # 0.69 m in at most eight
    axes = drawn(ground, step)
    x = np.concatenate([[s[:, 0].mean() for s in lines.get_segments()] for lines in axes.collections[1:]])
    heights = -x * math.tan(math.radians(10.0))
    np.testing.assert_allclose(heights, np.round(heights / step) * step, atol=1e-5)
    assert len(np.unique(np.round(heights / step))) == 7
    for text in axes.texts:
        assert -text.get_position()[0] * math.tan(math.radians(10.0)) == pytest.approx(
            float(text.get_text()), abs=1e-5
        )
    assert len(axes.texts) >= 6


def test_level_ground_has_no_contours():
    ground, _ = terrain(0.0, amplitude=0.0)
    assert contour_step([ground], *WINDOW) == 0.0
    assert contour_step([], *WINDOW) == 0.0
    assert len(drawn(ground).collections) == 1
    # Nor have the walls of a box, which are but lines from above.
    box = wc.meshes.box((1.0, 1.0, 0.5))
    corners = box.vertices[box.faces]
    walls = Ground(corners, np.ones(len(corners), dtype=bool), True)
    assert contour_step([ground, walls], *WINDOW) == 0.0
    assert not drawn(walls, 0.1).texts


@pytest.mark.parametrize(
    ("norm", "whole", "names"),
    [
        (Normalize(0.31234, 0.88), False, ["0.3123", "0.4", "0.6", "0.88"]),
        (Normalize(0, 63), True, ["0", "20", "40", "63"]),
        (Normalize(0, 1), True, ["0", "1"]),
        (Normalize(12345.0, 67890.0), False, ["12345", "40000", "67890"]),
        (Normalize(-0.2, 0.1), False, ["-0.2", "-0.1", "0", "0.1"]),
        (Normalize(2.5, 2.5), False, ["2.5"]),
        (Normalize(1e6, 1e6 + 2), True, ["1000000", "1000001", "1000002"]),
        (LogNorm(1e3, 1e9), False, ["1000", "100000", "1e+07", "1e+09"]),
        (LogNorm(0.05, 200.0), False, ["0.05", "1", "10", "200"]),
    ],
)
def test_a_scale_of_colours_has_ticks_at_its_ends(norm, whole, names):
    ticks, labels = picture._ticks(norm, whole)
    assert labels == names
    assert (ticks[0], ticks[-1]) == (norm.vmin, norm.vmax)
    np.testing.assert_allclose([float(label) for label in labels], ticks, rtol=1e-3)


def test_heights_are_above_tracks_and_dots():
    ground, _ = terrain(10.0, amplitude=0.0)
    heights = drawn(ground, 0.1).texts
    # Dots of ends are at 3, tracks where Matplotlib has lines.
    assert heights
    assert all(height.get_zorder() > 3 for height in heights)


def test_the_view_is_of_the_tracks_that_are_shown():
    level = np.array([[[0.0, 0.0, 0.5], [1.0, 0.01, 0.2]], [[2.0, 0.0, 0.1], [np.nan, 5.0, 0.0]]])
    plane, low, high = picture._extent([level])
    assert plane == [0, 2]
    np.testing.assert_array_equal([low, high], [[0.0, 0.1], [2.0, 0.5]])
    plane, low, high = picture._extent([level, np.array([[[-1.0, 3.0, 0.0]]])])
    assert plane == [0, 1]
    np.testing.assert_array_equal([low, high], [[-1.0, 0.0], [2.0, 3.0]])
