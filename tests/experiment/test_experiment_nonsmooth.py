"""Experiment files with nonsmooth shape and particle contact use the names of the Python API."""

import numpy as np
import pytest

import warpcontact as wc

pytestmark = pytest.mark.usefixtures("no_pictures")

STUDY = {
    "envs": 2,
    "duration": 0.3,
    "dt": 1e-3,
    "precision": "float64",
    "gravity": [0.0, 0.0, 0.0],
    "integrator": {"type": "MoreauJean", "theta": 0.5},
    "body": [
        {"name": "left", "mass": 1.0, "inertia": [0.01] * 3, "linear_velocity": [1.0, 0.0, 0.0]},
        {"name": "right", "mass": 1.0, "inertia": [0.01] * 3, "position": [0.25, 0.0, 0.0]},
    ],
    "shape": [
        {"name": "first", "body": "left", "form": {"type": "Sphere", "radius": 0.1}},
        {"name": "second", "body": "right", "form": {"type": "Sphere", "radius": 0.1}},
        {
            "name": "wall",
            "form": {"type": "Plane"},
            "position": [0.45, 0.0, 0.0],
            "orientation": [0.0, -(0.5**0.5), 0.0, 0.5**0.5],
        },
    ],
    "material": [{"name": "hard", "law": {"type": "Rigid", "restitution": 1.0}}],
    "particle_contact": [{"name": "pile", "shapes": ["first", "second"], "material": "hard"}],
    "shape_contact": [{"name": "touch", "shape": "second", "other_shape": "wall", "material": "hard"}],
    "variation": {"pile.law.restitution": {"values": [0.5, 1.0]}},
    "record": {
        "every": 1e-3,
        "sensors": ["touch.impulse", "touch.mode", "pile.normal_force", "scene.impact_dissipation"],
    },
}


def test_nonsmooth_particles_and_wall_match_closed_form_in_experiment(tmp_path, device):
    run = wc.Experiment.from_dict(STUDY, tmp_path).run(tmp_path / "out", device=device)
    data = run.recording
    # The first gives the second (1 + e)/2 of its speed, and the wall reverses it.
    passed = np.array([0.75, 1.0])
    assert data["pile.normal_force"].values.max(axis=0) == pytest.approx(passed / 1e-3, rel=1e-9)
    assert data["touch.impulse"].values[:, :, 0].min(axis=0) == pytest.approx(-2.0 * passed, rel=1e-9)
    assert set(np.unique(data["touch.mode"])) == {wc.ContactMode.OPEN, wc.ContactMode.SLIP}
    # (1 − e²) m/4 times the square of their speed, in each impact of the two.
    loss = data["scene.impact_dissipation"].values[-1]
    assert loss[1] == pytest.approx(0.0, abs=1e-12)
    assert loss[0] >= 0.25 * 0.75 - 1e-12


def test_compliant_contact_with_rigid_law_is_refused(tmp_path):
    study = {**STUDY, "integrator": {"type": "MoreauJean", "compliant": ["touch"]}}
    with pytest.raises(ValueError, match=r"touch\.law is Rigid, which has no force"):
        wc.Experiment.from_dict(study, tmp_path).run(tmp_path / "out")


@pytest.mark.parametrize(
    ("integrator", "problems"),
    [
        ({"type": "MoreauJean", "theta": 0.3}, ["integrator.theta must be at least 0.5"]),
        ({"type": "MoreauJaen"}, ["integrator.type must be one of"]),
        ({"type": "MoreauJean", "tol": 1e-5}, ["integrator.tol"]),
        (
            {"type": "MoreauJean", "recovery_time": 0.0},
            ["integrator.recovery_time must be greater than 0, got 0 s"],
        ),
        ({}, ["which has no force; use the integrator MoreauJean"]),
        (
            {"type": "MoreauJean", "compliant": ["tuoch", "plie"]},
            [
                "integrator.compliant[0] must be the name of a contact, got 'tuoch'; did you mean 'touch'?",
                "integrator.compliant[1] must be the name of a contact, got 'plie'; did you mean 'pile'?",
            ],
        ),
        ({"theta": 0.5}, ["theta requires type = 'MoreauJean'"]),
    ],
)
def test_invalid_integrator_is_one_problem(tmp_path, integrator, problems):
    with pytest.raises(wc.ExperimentError) as caught:
        wc.Experiment.from_dict({**STUDY, "integrator": integrator}, tmp_path)
    found_problems = caught.value.problems
    assert len(found_problems) == len(problems)
    for message, line in zip(problems, found_problems, strict=True):
        assert message in line
