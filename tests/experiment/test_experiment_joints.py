"""Joints in experiment files: tables, variation, recording, custom classes, and errors."""

import copy

import numpy as np
import pytest

import warpcontact as wc

HEAVE = '''
from typing import Any
import warp as wp
import warpcontact as wc


class Heave(wc.Motion):
    """z = a sin(ω t)."""

    amplitude: float = wc.parameter("m", "amplitude a")
    rate: float = wc.parameter("rad/s", "angular frequency ω")

    @wp.func
    def displacement(p: Any, t: Any):
        return wp.vec3d(wp.float64(0.0), wp.float64(0.0), p.amplitude * wp.sin(p.rate * t))


class Idle(wc.Motion):
    pass


class Cubic(wc.Law):
    stiffness: float = wc.parameter("N/m³", "stiffness k")

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta
'''
BODY = {"mass": 1, "inertia": [1, 1, 1]}
HINGE = {"type": "Hinge", "axis": [0, 2, 0], "anchor": [0, 0, 0]}
TABLE = {"type": "Table", "times": [0, 1], "displacements": [[0, 0, 0], [1, 0, 0]]}
STUDY = {
    "envs": 3,
    "duration": 0.01,
    "dt": 1e-3,
    "precision": "float64",
    "body": [
        BODY | {"name": "arm", "position": [1, 0, 0], "motion": HINGE},
        BODY | {"name": "table", "motion": TABLE},
        BODY | {"name": "own", "motion": {"type": "my_motions.py:Heave", "amplitude": 2, "rate": 2}},
    ],
    "variation": {
        "arm.motion.anchor": {"values": [[0, 0, 0], [0.5, 0, 0], [0.9, 0, 0]]},
        "own.motion.rate": {"linspace": [1, 2]},
    },
    "record": {"sensors": ["arm.angle", "arm.reaction_force", "own.linear_velocity", "table.reaction_torque"]},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("study")
    (path / "my_motions.py").write_text(HEAVE, encoding="utf-8")
    (path / "broken.py").write_text(HEAVE.replace("p.rate * t", "p.rat * t"), encoding="utf-8")
    return path


def test_joints_of_an_experiment_are_varied_recorded_and_stored(folder, device):
    run = wc.Experiment.from_dict(STUDY, folder).run(folder / "out", device=device)
    data = run.recording
    # At rest, horizontal: a reaction of m g (1 − m l²/I) with I = 1 + l².
    arm = 1.0 - np.array([0.0, 0.5, 0.9])
    np.testing.assert_allclose(data["arm.reaction_force"].values[0, :, 2], 9.81 * (1 - arm**2 / (1 + arm**2)))
    np.testing.assert_allclose(data["own.linear_velocity"].values[0, :, 2], [2.0, 3.0, 4.0], rtol=1e-9)
    np.testing.assert_allclose(data["table.position"].values[-1, :, 0], 0.01, rtol=1e-12)
    np.testing.assert_array_equal(
        data["arm.motion.anchor"].values, STUDY["variation"]["arm.motion.anchor"]["values"]
    )
    again = wc.Experiment.from_toml(folder / "out" / "experiment.toml").run(folder / "again", device=device)
    np.testing.assert_array_equal(again.recording["arm.angle"].values, data["arm.angle"].values)
    assert (folder / "out" / "my_motions.py").read_text(encoding="utf-8") == HEAVE


BAD = [
    (HINGE | {"axis": [0, 0, 0]}, ".axis must be a direction, got [0.0, 0.0, 0.0]"),
    (HINGE | {"axis": [0, 1]}, ".axis must be 3 numbers, got [0, 1]"),
    (HINGE | {"anchor": ["a", 0, 0]}, ".anchor must be 3 numbers [m], got 'a'"),
    (HINGE | {"ancor": [0, 0, 0]}, ".ancor is not known; did you mean 'anchor'?"),
    ({"type": "Hinge", "axis": [0, 1, 0]}, ".anchor is missing: point of the axis, world [m]"),
    ({"type": "Hing"}, ".type must be one of Free, Fixed, "),
    ({"type": "Hooke"}, "; that is a law"),
    ("Fixed", " must be a table, got 'Fixed'; write motion = { type = 'Fixed', … }"),
    ({"type": "Harmonic", "direction": [0, 0, 1], "frequency": 1}, "exactly one of amplitude and angle, got none"),
    ({"type": "Table", "times": [0, 0], "displacements": [[0, 0, 0]] * 2}, "at least two increasing times [s]"),
    (
        {"type": "Table", "times": [0, 1], "displacements": [[0, 0], [1, 0, 0]]},
        "must be a list of 3 numbers each [m]",
    ),
    ({"type": "Table", "times": [0, "1"]}, ".times must be a list of numbers [s], got '1'"),
    ({"type": "my_motions.py:Heav"}, ".type: my_motions.py has no motion 'Heav'; did you mean 'Heave'?"),
    ({"type": "my_motions.py:Cubic"}, ".type: 'Cubic' in my_motions.py is a law and no motion"),
    (
        {"type": "my_motions.py:Idle"},
        "Idle.displacement in my_motions.py must be a wp.func of (coefficients, time)",
    ),
    (
        {"type": "broken.py:Heave", "amplitude": 1, "rate": 1},
        "broken.py, line 15: `rat` is not an attribute of 'p'",
    ),
]


@pytest.mark.parametrize(("motion", "message"), BAD, ids=[message[:40] for _, message in BAD])
def test_invalid_joint_is_reported_with_its_key(motion, message, folder):
    study = copy.deepcopy(STUDY)
    study["body"] = [study["body"][0] | {"motion": motion}]
    study["variation"], study["record"] = {}, {}
    with pytest.raises(wc.ExperimentError) as caught:
        wc.Experiment.from_dict(study, folder)
    (problem,) = caught.value.problems
    assert problem.startswith("body[0].motion")
    assert message in problem


def test_velocity_not_allowed_by_joint_is_reported_with_its_key(folder):
    study = copy.deepcopy(STUDY)
    study["body"][0]["linear_velocity"] = [1, 0, 0]
    with pytest.raises(wc.ExperimentError, match="linear_velocity must be left out or") as caught:
        wc.Experiment.from_dict(study, folder)
    assert caught.value.problems[0].startswith("body[0].linear_velocity")
