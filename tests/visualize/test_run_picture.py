"""Picture of a run: the ground, the values that color tracks and curves, and sensors over time."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

import warpcontact as wc
from warpcontact.algebra.vectors import transform_points
from warpcontact.experiment import picture
from warpcontact.experiment.ground import GroundSurface, contour_step, draw_from_above
from warpcontact.experiment.sensor_panels import CURVES, draw_panel, make_panels
from warpcontact.model.health import Health
from warpcontact.stepping.recording import Recording

WINDOW = np.array([-2.0, -2.0]), np.array([2.0, 2.0])


def terrain(tilt, amplitude=0.1):
    """amplitude · sin · sin, with a wavelength of 1 m, rotated about the y axis by an angle [degrees]."""
    mesh = wc.meshes.grid((4.0, 4.0), (64, 64))
    x, y, _ = mesh.vertices.T
    vertices = np.stack([x, y, amplitude * np.sin(2 * np.pi * x) * np.sin(2 * np.pi * y)], axis=1)
    half = math.radians(0.5 * tilt)
    corners = transform_points(vertices, np.zeros(3), np.array([0.0, math.sin(half), 0.0, math.cos(half)]))[
        mesh.faces
    ]
    return GroundSurface(corners, np.ones(len(corners), dtype=bool), True), vertices[mesh.faces].mean(axis=1)


def drawn(ground, step=0.0):
    axes = Figure().add_subplot()
    draw_from_above(axes, ground, *WINDOW, step)
    return axes


def greys_of(ground, middles):
    """Gray values of faces, in their original order."""
    faces = drawn(ground).collections[0]
    lower_first = np.argsort(ground.corners[..., 2].mean(axis=1))
    greys = np.empty(len(middles))
    greys[lower_first] = faces.get_facecolor()[:, 0]
    return greys


@pytest.mark.parametrize("tilt", [0.0, 10.0, -25.0])
def test_hill_shading_is_independent_of_ground_inclination(tilt):
    ground, middles = terrain(tilt)
    greys = greys_of(ground, middles)
    # Within a wave, points higher above the mean plane are lighter.
    assert np.corrcoef(greys, middles[:, 2])[0, 1] > 0.9
    # Both ridge families of sin · sin are equally visible: ½ cos of x − y, and of x + y.
    x, y = 2.0 * np.pi * middles[:, :2].T
    ridges = [abs(np.mean(greys * np.exp(1j * (x + sign * y)))) for sign in (-1, 1)]
    assert ridges[0] == pytest.approx(ridges[1], rel=0.05)
    # The mean inclination has no effect.
    assert abs(np.corrcoef(greys, middles[:, 0])[0, 1]) < 0.05


@pytest.mark.parametrize("tilt", [0.0, 10.0])
def test_plane_ground_has_one_gray(tilt):
    ground, middles = terrain(tilt, amplitude=0.0)
    assert np.ptp(greys_of(ground, middles)) < 1e-6


def test_contours_are_at_labeled_heights():
    ground, _ = terrain(10.0, amplitude=0.0)
    step = contour_step([ground], *WINDOW)
    assert step == pytest.approx(0.1)  # 0.69 m in at most eight steps
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
    # The walls of a box do not count either, because they are lines seen from above.
    box = wc.meshes.box((1.0, 1.0, 0.5))
    corners = box.vertices[box.faces]
    walls = GroundSurface(corners, np.ones(len(corners), dtype=bool), True)
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
def test_color_scale_has_ticks_at_its_ends(norm, whole, names):
    ticks, labels = picture._ticks(norm, whole)
    assert labels == names
    assert (ticks[0], ticks[-1]) == (norm.vmin, norm.vmax)
    np.testing.assert_allclose([float(label) for label in labels], ticks, rtol=1e-3)


def test_height_labels_are_drawn_above_tracks():
    ground, _ = terrain(10.0, amplitude=0.0)
    heights = drawn(ground, 0.1).texts
    # End markers are at 3, tracks at the default of Matplotlib lines.
    assert heights
    assert all(height.get_zorder() > 3 for height in heights)


def test_picture_view_fits_the_shown_tracks():
    level = np.array([[[0.0, 0.0, 0.5], [1.0, 0.01, 0.2]], [[2.0, 0.0, 0.1], [np.nan, 5.0, 0.0]]])
    plane, low, high = picture._extent([level])
    assert plane == [0, 2]
    np.testing.assert_array_equal([low, high], [[0.0, 0.1], [2.0, 0.5]])
    plane, low, high = picture._extent([level, np.array([[[-1.0, 3.0, 0.0]]])])
    assert plane == [0, 1]
    np.testing.assert_array_equal([low, high], [[-1.0, 0.0], [2.0, 3.0]])


# Sensors over time

NONE = np.zeros(0, dtype=int)


def recorded(*names, envs=3, records=50, **parameters):
    """A recording of sensors that increase with time and environment; contacts a and b, spring s, body ball."""
    seconds = np.linspace(0.0, 1.0, records)
    values = seconds[:, None] + np.arange(envs)
    variables = {}
    for name in (*names, "ball.position"):
        vector = name.endswith(("position", "velocity", "friction_force"))
        dims = ("time", "env", "axis") if vector else ("time", "env")
        variables[name] = (dims, np.repeat(values[..., None], 3, axis=2) if vector else values.copy())
    variables |= parameters
    recording = Recording(variables, {"time": seconds, "env": np.arange(envs), "axis": ["x", "y", "z"]})
    for name in recording:
        recording[name].attrs["units"] = "N" if name.endswith("force") else "m"
    named = [SimpleNamespace(name=name) for name in ("a", "b", "s", "ball")]
    recording.scene = SimpleNamespace(
        contacts=named[:2], shape_contacts=[], particle_contacts=[], body_contacts=[], contact_couplings=[], couplings=named[2:3],
        bodies=named[3:],
    )  # fmt: skip
    return recording


def headings(recording, most=3):
    return [panel.heading for panel in make_panels(recording, NONE, most)]


def test_contact_sensors_are_drawn_first():
    energy, speed = "scene.kinetic_energy", "ball.linear_velocity"
    touch = ("a.gap", "a.normal_force", "b.gap", "b.normal_force")
    assert headings(recorded(speed, energy, *touch)) == ["a.normal_force", "a.gap", f"magnitude of {speed}"]
    assert headings(recorded(speed, energy, *touch), 2) == ["a.normal_force", "a.gap"]
    assert headings(recorded(energy, "a.friction_force", "s.length", "s.force", "b.penetration")) == [
        "b.penetration",
        "magnitude of a.friction_force",
        "s.force",
    ]
    assert headings(recorded("a.normal_force", "b.normal_force")) == ["a.normal_force", "b.normal_force"]


def test_contact_with_force_is_drawn_before_one_without():
    recording = recorded("a.gap", "a.normal_force", "b.gap", "b.normal_force")
    recording["a.normal_force"][:] = 0.0
    assert headings(recording) == ["b.normal_force", "a.normal_force", "b.gap"]
    assert headings(recording, 2) == ["b.normal_force", "b.gap"]


def test_positions_are_drawn_if_nothing_else_was_recorded():
    assert headings(recorded()) == ["height of ball", "distance of ball from its start"]
    assert headings(recorded("scene.kinetic_energy")) == ["scene.kinetic_energy", "height of ball"]


def test_peak_of_one_record_is_drawn_and_labeled():
    recording = recorded("a.normal_force", envs=3, records=100_000)
    recording["a.normal_force"][77_777, 1] = 1234.5
    panel = make_panels(recording, NONE, 2)[0]
    axes = Figure().add_subplot()
    draw_panel(axes, panel, np.eye(4)[[0, 1, 2]])
    lines = axes.get_lines()
    assert [line.get_color().tolist() for line in lines] == np.eye(4)[[0, 1, 2]].tolist()
    assert max(lines[1].get_ydata()) == 1234.5
    assert max(len(line.get_xdata()) for line in lines) <= 4000
    heading = axes.get_title(loc="left").replace("\u202f", " ")
    assert heading == "a.normal_force\nmin 0 N at 0 s (env 0), max 1234.5 N at 0.77778 s (env 1)"
    assert axes.get_ylabel() == "normal_force [N]"


def test_frozen_environment_is_dotted_and_excluded_from_the_scale():
    recording = recorded("a.normal_force", envs=3)
    recording["a.normal_force"][:, 1] = 1e9
    axes = Figure().add_subplot()
    draw_panel(axes, make_panels(recording, np.array([1]), 2)[0], np.eye(4)[[0, 1, 2]])
    assert [line.get_linestyle() for line in axes.get_lines()] == ["-", ":", "-"]
    assert axes.get_ylim()[1] == pytest.approx(6.0)
    assert axes.get_ylabel() == "normal_force [N]"


def test_many_environments_are_drawn_as_quantiles_without_frozen_ones():
    recording = recorded("a.normal_force", envs=20)
    recording["a.normal_force"][:, 4] = 1e9
    panel = make_panels(recording, np.array([4]), 2)[0]
    axes = Figure().add_subplot()
    draw_panel(axes, panel, None)
    assert [text.get_label() for text in axes.get_lines()] == ["median of 19 environments"]
    assert len(axes.collections) == 2
    assert axes.get_lines()[0].get_ydata()[0] == 10.0
    assert "max 20\u202fN at 1\u202fs (env 19)" in axes.get_title(loc="left")


@pytest.mark.parametrize(
    ("name", "dims", "values", "expected"),
    [
        ("a.law.stiffness", ("env",), [1.0, 2.0, 4.0], "a.law.stiffness [m]"),
        ("a.radius", ("env", "a.item"), [[1.0, 1.0], [2.0, 2.0], [4.0, 4.0]], "a.radius [m]"),
        ("ball.way.initial", ("env", "axis"), [[0, 1, 0], [0, 2, 0], [0, 4, 0]], "ball.way.initial.y [m]"),
        ("a.radius", ("env", "a.item"), [[1.0, 3.0], [2.0, 3.0], [4.0, 3.0]], "environment"),
        ("a.radius", ("env",), [1.0, 1.0, 1.0], "environment"),
    ],
)  # fmt: skip
def test_curves_are_colored_by_the_first_scalar_varied_parameter(name, dims, values, expected):
    recording = recorded(**{name: (dims, np.array(values, dtype=float))})
    numbers, label = picture._color_values(recording, [name.removesuffix(".initial")])
    assert label == expected
    assert numbers.tolist() == ([0, 1, 2] if expected == "environment" else [1.0, 2.0, 4.0])
    recording["other"] = "env", [5.0, 5.0, 6.0]
    _, label = picture._color_values(recording, [name.removesuffix(".initial"), "other"])
    differs = len(np.unique(values, axis=0)) > 1
    first = "other" if expected == "environment" else expected
    assert label == (f"{first}\none of 2 varied parameters" if differs else first)


@pytest.fixture(scope="module")
def drops(tmp_path_factory):
    """Balls that start at different heights, without contact."""
    study = {
        "envs": 20,
        "duration": 0.2,
        "dt": 1e-3,
        "output": {"usd_envs": 0},
        "body": [{"name": "a_ball_with_a_very_long_name_" + 60 * "x", "mass": 1, "inertia": [1, 1, 1]}],
        "record": {"every": 1e-2, "sensors": ["scene.kinetic_energy"]},
    }
    body = study["body"][0]["name"]
    study["variation"] = {
        f"{body}.linear_velocity": {"linspace": [[0, 0, -1], [1, 1, 1]]},
        f"{body}.mass": {"linspace": [1.0, 2.0]},
    }
    return wc.Experiment.from_dict(study).run(tmp_path_factory.mktemp("drops") / "run", device="cpu").recording


@pytest.mark.parametrize("envs", [1, CURVES, CURVES + 1])
def test_picture_texts_are_not_clipped_and_do_not_overlap(envs, drops, tmp_path, monkeypatch):
    figures = []
    monkeypatch.setattr(picture, "save", lambda figure, path: figures.append(figure))
    some = drops.isel(env=slice(0, envs))
    some.scene = drops.scene
    varied = [str(name).removesuffix(".initial") for name in drops if "time" not in drops[name].dims]
    health = Health.of(np.zeros(envs), np.zeros(envs), np.zeros(envs))
    picture.write_picture(tmp_path / "x.png", some, "n" * 300, varied[:2], health)
    (figure,) = figures
    figure.canvas.draw()
    _, *panels = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    assert len(panels) == 2
    assert all(len(axes.get_lines()) == (envs if envs <= CURVES else 1) for axes in panels)
    assert len(figure.legends) == (envs > CURVES)
    texts = [figure._suptitle, *(text for legend in figure.legends for text in legend.get_texts())]
    for axes in figure.axes:
        texts += [axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label]
        texts += [axes.xaxis.get_offset_text(), axes.yaxis.get_offset_text()]
    boxes = [text.get_window_extent() for text in texts if text.get_visible() and text.get_text()]
    assert len(boxes) > 8
    whole = figure.bbox
    for box in boxes:
        assert whole.x0 <= box.x0 <= box.x1 <= whole.x1
        assert whole.y0 <= box.y0 <= box.y1 <= whole.y1
    for one, other in itertools.combinations(boxes, 2):
        assert not one.overlaps(other)
