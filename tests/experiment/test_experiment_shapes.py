"""Shapes and shape contacts in experiment files: keys, errors, variations, and custom surfaces."""

import numpy as np
import pytest

import warpcontact as wc
from warpcontact.experiment.sensor_panels import make_panels

BOWL = '''
from typing import Any

import warp as wp
import warpcontact as wc


class Bowl(wc.ParametricSurface):
    """z = (x² + y²)/(2 R)."""

    depth: float = wc.parameter("m", "radius R at the bottom", above=0.0)

    u_range = (-1.0, 1.0)
    v_range = (-1.0, 1.0)

    @wp.func
    def position(p: Any, u: Any, v: Any):
        return wp.vec3d(u, v, (u * u + v * v) / (wp.float64(2.0) * p.depth))
'''
STUDY = {
    "envs": 3,
    "duration": 0.02,
    "dt": 1e-3,
    "body": [
        {"name": "ball", "mass": 1.0, "inertia": [0.01] * 3, "position": [0.0, 0.0, 0.2]},
        {"name": "egg", "mass": 1.0, "inertia": [0.01] * 3, "position": [2.0, 0.0, 0.2]},
    ],
    "shape": [
        {"name": "sphere", "body": "ball", "form": {"type": "Sphere", "radius": 0.1}},
        {"name": "oval", "body": "egg", "form": {"type": "Ellipsoid", "semi_axes": [0.2, 0.1, 0.1]}},
        {"name": "bowl", "form": {"type": "bowls.py:Bowl", "depth": 1.0}},
        {"name": "floor", "form": {"type": "Plane"}, "group": 2, "mask": 1},
    ],
    "material": [{"name": "soft", "law": {"type": "Hooke", "stiffness": 1000.0}}],
    "shape_contact": [
        {"name": "in_bowl", "shape": "sphere", "other_shape": "bowl", "material": "soft"},
        {"name": "on_floor", "shape": "oval", "other_shape": "floor", "material": "soft", "max_depth": 0.5},
    ],
    "variation": {
        "sphere.radius": {"values": [0.05, 0.1, 0.15]},
        "oval.semi_axes": {"values": [[0.2, 0.1, 0.1], [0.1, 0.2, 0.15], [0.1, 0.1, 0.19]]},
        "on_floor.law.stiffness": {"linspace": [500.0, 1000.0]},
    },
    "record": {"every": 0.01},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("study")
    (path / "bowls.py").write_text(BOWL, encoding="utf-8")
    (path / "broken.py").write_text(BOWL.replace("p.depth)", "p.dept)"), encoding="utf-8")
    return path


def test_shapes_of_an_experiment_are_varied_recorded_and_stored(folder, device):
    run = wc.Experiment.from_dict(STUDY, folder).run(folder / "out", device=device)
    data = run.recording
    np.testing.assert_allclose(data["in_bowl.gap"].values[0], [0.15, 0.1, 0.05], rtol=1e-6)
    np.testing.assert_allclose(data["on_floor.gap"].values[0], [0.1, 0.05, 0.01], rtol=1e-6)
    assert {"in_bowl.normal_force", "on_floor.normal_force", "scene.kinetic_energy"} <= set(data.data_vars)
    again = wc.Experiment.from_toml(folder / "out" / "experiment.toml").run(folder / "again", device=device)
    np.testing.assert_array_equal(again.recording["in_bowl.gap"].values, data["in_bowl.gap"].values)
    assert (folder / "out" / "bowls.py").read_text(encoding="utf-8") == BOWL


BAD_FORMS = [
    ({"type": "Sphere", "radius": -0.1}, ".form.radius must be greater than 0, got -0.1 m"),
    ({"type": "Sphere"}, ".form.radius is missing: radius r [m]"),
    ({"type": "Spher", "radius": 1.0}, ".form.type must be one of Sphere, Plane, "),
    ({"type": "Hooke", "stiffness": 1.0}, "; that is a law"),
    ("Sphere", ".form must be a table, got 'Sphere'; write form = { type = 'Sphere', … }"),
    (
        {"type": "RoundedBox", "half_extents": [0.1, 0.1, 0.1], "radius": 0.2},
        "must be less than every half extent",
    ),
    ({"type": "bowls.py:Bow", "depth": 1.0}, ".form.type: bowls.py has no shape 'Bow'; did you mean 'Bowl'?"),
    ({"type": "broken.py:Bowl", "depth": 1.0}, "broken.py, line "),
]


@pytest.mark.parametrize(("form", "message"), BAD_FORMS)
def test_invalid_shape_is_reported_with_its_key(folder, form, message):
    study = STUDY | {"shape": [*STUDY["shape"], {"name": "other", "form": form}]}
    with pytest.raises(wc.ExperimentError) as error:
        wc.Experiment.from_dict(study, folder)
    assert "shape[4]" in str(error.value)
    assert message in str(error.value)


def test_shape_and_contact_problems_are_all_reported(folder):
    study = STUDY | {
        "shape": [*STUDY["shape"], {"name": "x", "body": "bal", "form": {"type": "Plane"}, "group": -1}],
        "shape_contact": [
            *STUDY["shape_contact"],
            {"name": "y", "shape": "sphere", "other_shape": "flor", "material": "soft", "kappa": 2.0},
            {"name": "z", "shape": "bowl", "other_shape": "floor", "material": "soft"},
        ],
    }
    with pytest.raises(wc.ExperimentError) as error:
        wc.Experiment.from_dict(study, folder)
    text = str(error.value)
    assert "shape[4] ('x').group must be at least 0, got -1" in text
    assert "shape_contact[2] ('y').kappa must be at least 0 and at most 1, got 2" in text
    assert "shape_contact[3] ('z'): both shapes are fixed to the world" in text


def test_picture_shows_fixed_shapes_gaps_and_forces(tmp_path, device):
    """Planes fill the window below all else; exponents are not sizes; gaps and forces are drawn."""
    from warpcontact.experiment import ground, picture

    study = {
        **{key: STUDY[key] for key in ("duration", "dt", "material", "record")},
        "body": [STUDY["body"][0]],
        "shape": [
            {"name": "ring", "form": {"type": "Torus", "major_radius": 0.5, "minor_radius": 0.1}},
            {"name": "floor", "form": {"type": "Plane"}, "position": [5.0, 0.0, -1.0]},
            {
                "name": "box",
                "body": "ball",
                "form": {"type": "Superellipsoid", "semi_axes": [0.1, 0.1, 0.1], "exponents": [1.5, 1.5]},
            },
        ],
        "shape_contact": [{"name": "touch", "shape": "box", "other_shape": "floor", "material": "soft"}],
    }
    recording = wc.Experiment.from_dict(study).run(tmp_path, device=device).recording
    plane, lower, upper = picture._extent([recording["ball.position"].values])
    low, high = picture._window(recording.scene, [], [], lower, upper, plane)
    assert (high - low).max() == pytest.approx(10.0 * 0.1)
    floor, ring = ground.ground_surfaces(recording, 2.0)
    assert floor.corners[..., 2].max() == -1.0 < ring.corners[..., 2].min()
    assert floor.corners[..., 0].min() <= -2.0
    headings = [panel.heading for panel in make_panels(recording, np.zeros(0, dtype=int), 2)]
    assert headings == ["touch.normal_force", "touch.gap"]
