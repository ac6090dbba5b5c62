"""Camera positions, overlays in pictures, and arrangement of panels."""

import math

import numpy as np
import pytest
import warp as wp
import xarray as xr
from handmade_drawings import PLATE, balls, camera, covered, drawing, figure
from warpcontact.kernels.rendering.world import CONE, CYLINDER

from warpcontact.algebra.vectors import transform_points
from warpcontact.drawing.colors import Scale, per_environment_number
from warpcontact.drawing.drawing import ContactForces, Curve
from warpcontact.visualize.rendering import frame_renderer
from warpcontact.visualize.rendering.camera import MARGIN, bounding_spheres, direction, frame_spheres
from warpcontact.visualize.rendering.frame_renderer import Coloring, FrameRenderer
from warpcontact.visualize.rendering.render_style import RenderStyle
from warpcontact.visualize.rendering.stage import curve_tube, force_arrows, place_figure

RED = np.array([0.9, 0.1, 0.1])


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.2])
def test_camera_distance_is_the_smallest_with_all_spheres_in_view(aspect):
    rng = np.random.default_rng(0)
    for azimuth, elevation in ((0.3, 0.2), (2.0, -0.7), (-1.0, 0.5 * math.pi)):
        points, radii = rng.normal(size=(20, 3)), rng.uniform(0.0, 0.3, 20)
        eye = frame_spheres(points, radii, direction(azimuth, elevation), 0.6, aspect)
        right, up, forward = eye.axes
        seen = points - eye.target - eye.distance * eye.backward
        depth = seen @ forward
        most = []
        for axis, widest in ((right, aspect), (up, 1.0)):
            slope = (1.0 - MARGIN) * widest * math.tan(0.3)
            # Distance of each sphere's surface from the planes of the margin, on both sides.
            for sign in (-1.0, 1.0):
                most.append(((sign * (seen @ axis) - slope * depth) / math.hypot(1.0, slope) + radii).max())
        assert max(most) == pytest.approx(0.0, abs=1e-9)
        # In one direction the spheres are tangent to both planes, so the eye cannot be nearer.
        assert sorted(most)[-2] == pytest.approx(0.0, abs=1e-9)


def test_requested_camera_position_is_used():
    eye = frame_spheres(
        np.zeros((1, 3)), np.ones(1), direction(0.1, 0.2), 0.5, 1.0, target=np.array([1.0, 2.0, 3.0]), distance=7.0
    )
    np.testing.assert_array_equal(eye.target, [1.0, 2.0, 3.0])
    assert eye.distance == 7.0


def test_view_includes_moving_objects_and_their_surroundings():
    ball, wall, ground = (
        place_figure(one, 0, 0)
        for one in (
            balls(RED, [[0.0, 0.0, 1.0], [0.0, 0.0, 2.0]], 0.5),
            figure(PLATE, RED, [1.0, 0.0, 1.0], 0.3),
            figure(PLATE, RED, [0.0, 0.0, 0.0], 50.0),
        )
    )
    centres, _ = bounding_spheres(drawing([]), [(ball, True), (wall, False), (ground, False)])
    assert len(centres) == 2 + 8
    assert centres[:, 0].max() == pytest.approx(1.3)
    # A body that fell off the ground long ago would make the rest tiny.
    lost = place_figure(balls(RED, [[0.0, 0.0, 1.0], [0.0, 0.0, -900.0]], 0.5), 0, 0)
    centres, _ = bounding_spheres(drawing([]), [(lost, True), (ground, False)])
    np.testing.assert_array_equal(centres, [[0.0, 0.0, 1.0]])
    # If nothing moves, the whole ground; if there is nothing, a default.
    assert len(bounding_spheres(drawing([]), [(ground, False)])[0]) == 8
    assert len(bounding_spheres(drawing([]), [])[0]) == 1


def test_arrow_lengths_are_proportional_to_forces():
    forces = np.array([[0.0, 0.0, 10.0], [3.0, 4.0, 0.0], [0.0, 0.0, 0.0], [np.nan, 0.0, 0.0], [0.0, 0.0, -1e-3]])
    starts = np.arange(15.0).reshape(5, 3)
    touch = ContactForces("touch", RED, starts[None, None], forces[None, None], None)
    shafts, heads = force_arrows(touch, 0, 0, 0.2, 0.1)
    assert (shafts.kind, heads.kind) == (CYLINDER, CONE)
    tips = transform_points(heads.scales[:, None] * (0.0, 0.0, 1.0), heads.positions, heads.rotations)[:, 0]
    acting = [0, 1, 4]
    np.testing.assert_allclose(tips, (starts + 0.2 * forces)[acting], atol=1e-12)
    np.testing.assert_allclose(shafts.positions, starts[acting])
    # The shortest arrow has the same aspect ratio.
    np.testing.assert_allclose(heads.scales[:, 2] / heads.scales[:, 0], heads.scales[0, 2] / heads.scales[0, 0])
    assert heads.scales[2, 0] < 1e-3 * heads.scales[0, 0]


def test_curves_are_drawn_as_tubes_and_broken_ones_skipped():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0], [1, 1, 0]])
    curve = Curve("rope", RED, points[None, None], np.ones((1, 1), dtype=bool))
    joints, tubes = curve_tube(curve, 0, 0, 0.2)
    assert len(joints.positions) == 4
    assert len(tubes.positions) == 2  # no curve between coincident points
    np.testing.assert_allclose(tubes.scales, [[0.1, 0.1, 1.0]] * 2)
    broken = Curve("rope", RED, points[None, None], np.zeros((1, 1), dtype=bool))
    assert curve_tube(broken, 0, 0, 0.2) == []
    failed = Curve("rope", RED, np.full((1, 1, 2, 3), np.nan), np.ones((1, 1), dtype=bool))
    assert curve_tube(failed, 0, 0, 0.2) == []


def test_arrows_are_visible_through_objects(device):
    body = balls(np.array([0.1, 0.2, 0.9]), [[0.0, 0.0, 0.0]], 1.0)
    touch = ContactForces("touch", RED, np.array([[[[0.0, 0.0, -0.5]]]]), np.array([[[[0.0, 0.0, 1.0]]]]), None)
    look = {"size": (64, 64), "samples": 4, "device": device, "labels": False}
    look |= {"look_at": (0.0, 0.0, 0.0), "distance": 6.0, "force_scale": 1.0}
    pictures = [
        FrameRenderer(drawing([body], contact_forces=[touch], size=2.0), RenderStyle(**look, forces=forces))
        .picture(0)
        .astype(int)
        for forces in (True, False)
    ]
    changed = (pictures[0] != pictures[1]).any(axis=-1)
    assert changed.sum() > 5
    redder = pictures[0][changed][:, 0] - pictures[1][changed][:, 0]
    assert (redder > 20).mean() > 0.7
    assert (pictures[0][changed][:, 2] > 40).mean() > 0.7  # the body is still visible


@pytest.mark.parametrize("count", [1, 2, 3, 5, 16])
def test_panels_have_equal_size_and_do_not_overlap(count):
    found = frame_renderer.panel_places(count, 640, 360)
    assert len(found) == count
    assert len({(right - left, bottom - top) for left, top, right, bottom in found}) == 1
    owner = np.zeros((360, 640), dtype=int)
    for left, top, right, bottom in found:
        assert min(left, top) >= 0
        owner[top:bottom, left:right] += 1
    assert owner.max() == 1
    assert owner.sum() > 0.7 * owner.size


def test_too_many_panels_are_refused():
    with pytest.raises(ValueError, match="size must be sufficient for 900 panels, got 64 × 64 pixels; together"):
        frame_renderer.panel_places(900, 64, 64)


def test_colors_range_from_the_lowest_to_the_highest_value():
    coloring = Coloring.of("mass", np.array([3.0, np.nan, 1.0, 2.0]))
    np.testing.assert_allclose(coloring.colors[[2, 3, 0]], Scale(0.0, 1.0).colors(np.array([0.0, 0.5, 1.0])))
    np.testing.assert_allclose(coloring.colors[1], 0.5)  # gray if there is none
    same = Coloring.of("mass", np.array([2.0, 2.0]))
    assert (same.colors[0] == same.colors[1]).all()


def test_parameter_of_a_set_is_one_number_if_its_items_are_equal():
    values = np.array([[1.0, 1.0], [np.nan, np.nan], [2.0, 2.0]])
    array = xr.DataArray(values, dims=("env", "item"), coords={"env": [3, 5, 9]})
    np.testing.assert_array_equal(per_environment_number(array), values[:, 0])
    array[1, 0] = 1.0
    assert per_environment_number(array) is None
    assert per_environment_number(xr.DataArray(values, dims=("env", "axis"))) is None
    over_time = per_environment_number(xr.DataArray(values, dims=("env", "time")))
    assert over_time.dims == ("time", "env")
    assert per_environment_number(xr.DataArray(["a", "b"], dims="env")) is None


def test_labels_are_drawn_at_their_positions():
    picture = np.full((120, 200, 3), 200, dtype=np.uint8)
    before = picture.copy()
    frame_renderer.write_labels(picture, [(0, 0, 200, 120)], [""], "")
    np.testing.assert_array_equal(picture, before)
    frame_renderer.write_labels(picture, [(0, 0, 200, 120)], ["environment 7"], "0.400 s")
    changed = (picture != before).any(axis=-1)
    assert changed[:40, :120].any()
    assert changed[90:, :80].any()
    assert not changed[45:85].any()


@pytest.mark.parametrize("width", [60, 100, 160, 320, 1280])
def test_labels_do_not_cover_the_scene(width):
    height = width * 9 // 16
    picture = np.full((height, width, 3), 200, dtype=np.uint8)
    frame_renderer.write_labels(picture, [(0, 0, width, height)], ["environment 7"], "0.400 s")
    frame_renderer.write_scale(picture, "touch.law.restitution", Scale(0.1, 0.9))
    changed = (picture != 200).any(axis=-1)
    texts, scale = changed[:, : width // 2], changed[:, width // 2 :]
    assert (texts.any() and scale.any()) == (width > 100)  # smaller letters are illegible
    assert not texts[:, int(0.5 * width) :].any()
    assert not scale[height // 2 :].any()


def test_long_name_of_color_scale_does_not_cover_the_scene():
    picture = np.full((180, 320, 3), 200, dtype=np.uint8)
    frame_renderer.write_scale(picture, "n" * 10_000, Scale(-1.23e-5, 4.56e10))
    changed = (picture != 200).any(axis=-1)
    assert changed.any()
    assert not changed[:, :150].any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": (8, 8)}, r"size\[0\] must be at least 16"),
        ({"size": (640.5, 360)}, "size.* must be a whole number"),
        ({"view_from": (0.0, 95.0)}, r"view_from\[1\] must be at least -90"),
        ({"view_from": (math.nan, 0.0)}, "view_from.* must be finite"),
        ({"look_at": (0.0, 0.0)}, "look_at must be 3 numbers"),
        ({"distance": 0.0}, "distance must be greater than 0"),
        ({"force_scale": -1.0}, "force_scale must be greater than 0"),
        ({"fov": 180.0}, "fov must be at least 1"),
        ({"samples": 0}, "samples must be at least 1"),
        ({"samples": 2.5}, "samples must be a whole number"),
        ({"threads": 0}, "threads must be at least 1"),
        ({"forces": "yes"}, "forces must be True or False"),
        (
            {"background": "blue"},
            "background must be one of 'light', 'white', 'dark', or a color such as #20242c, got 'blue'",
        ),
        ({"background": 7}, "background must be one of"),
    ],
)
def test_invalid_render_style_is_refused(options, message):
    with pytest.raises(ValueError, match=message):
        RenderStyle(**options)


def test_custom_background_fills_uncovered_pixels(device):
    look = RenderStyle(size=(32, 32), background="#123456", device=device, labels=False)
    picture = FrameRenderer(drawing([balls(RED, [[0.0, 0.0, 0.0]], 0.5)]), look).picture(0)
    np.testing.assert_array_equal(picture[0, 0], [0x12, 0x34, 0x56])
    assert covered(picture).all()


def nearby(seen, device, **look):
    """A picture of a figure on white, from 5 m off the origin."""
    look = RenderStyle(device=device, background="white", look_at=(0.0, 0.0, 0.0), distance=5.0, **look)
    return FrameRenderer(drawing([seen]), look).picture(0)


def test_infinite_plane_fades_into_the_background(device):
    ground = figure(PLATE, (0.2, 0.2, 0.2), [0.0, 0.0, 0.0], 1000.0, kind="plane")
    picture = nearby(ground, device, size=(32, 512), view_from=(0.0, 5.0))
    column = picture[:, 16].astype(int).mean(axis=-1)
    horizon = int(np.argmax(column < 255))
    assert 0 < horizon < 256
    assert column[horizon] > 240  # no visible edge
    assert column[-1] < 150


@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_infinite_plane_has_no_edges_in_wide_views(turn, device):
    # A square of 2 m in a wider view, from slightly above.
    ground = figure(
        PLATE, (0.2, 0.2, 0.2), [3.0, 1.0, 0.0], kind="plane", turns=(0.0, 0.0, turn, math.cos(math.asin(turn)))
    )
    look = {"size": (128, 96), "samples": 4, "device": device, "background": "white"}
    look |= {"view_from": (0.0, 10.0), "look_at": (0.0, 0.0, 0.0), "distance": 40.0}
    picture = FrameRenderer(drawing([ground]), RenderStyle(**look)).picture(0).astype(int).mean(axis=-1)
    horizon = int(np.argmax((picture < 255).all(axis=1)))
    assert 0 < horizon < 48
    assert (picture[horizon + 10 :] < 200).all()
    # Up to fading and the specular reflection: no row has a kink.
    assert np.abs(np.diff(picture, axis=1)).max() < 20


def test_infinite_plane_extends_below_all_moving_objects():
    ground = place_figure(figure(PLATE, (0.2, 0.2, 0.2), [0.0, 0.0, 0.0], 2.0, kind="plane"), 0, 0)
    track = np.zeros((200, 3))
    track[:, 0], track[:, 2] = np.linspace(0.0, 100.0, 200), 0.1
    ball = place_figure(balls(RED, track, 0.1), 0, 0)
    centres, _ = bounding_spheres(drawing([]), [(ball, True), (ground, False)])
    # The track has all positions. The drawn square is small, and none of its vertices counts.
    np.testing.assert_array_equal(centres, track)


@pytest.mark.parametrize("kind", ["surface", "plane"])
def test_ground_far_below_moving_objects_is_visible(kind, device):
    # As low as after a short drop of a ball: rays hit it at ten times half the view.
    ground = figure(PLATE, (0.2, 0.2, 0.2), [0.0, 0.0, -5.0], 1000.0, kind=kind)
    bottom = nearby(ground, device, size=(32, 32))[-1].astype(int)
    assert bottom.max() < 150


def test_mesh_does_not_fade(device):
    # A hill at the far end of large ground, at sixty times half the view.
    hill = figure(PLATE, (0.2, 0.2, 0.2), [-80.0, 0.0, 0.0], 4.0, turns=(0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)))
    assert nearby(hill, device, size=(64, 64), view_from=(0.0, 0.0))[32, 32].max() < 150


def test_camera_axes_match_its_view_direction():
    assert camera(0, 90).reach == pytest.approx(10.0 * math.tan(math.radians(10.0)))
    right, up, forward = camera(0, 90).axes
    np.testing.assert_allclose([right, up, forward], [[0, 1, 0], [-1, 0, 0], [0, 0, -1]], atol=1e-12)
    assert wp.get_device("cpu").is_cpu
