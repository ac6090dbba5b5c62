"""Contact at all local minima in experiment files: keys, errors, recording."""

import math

import numpy as np
import pytest

import warpcontact as wc

STUDY = {
    "envs": 2,
    "duration": 0.002,
    "dt": 1e-3,
    "gravity": [0.0, 0.0, 0.0],
    "body": [{"name": "ball", "mass": 100.0, "inertia": [1.0] * 3, "position": [0.0, 0.0, 0.0699]}],
    "surface": [{"name": "walls", "mesh": {"file": "walls.obj"}}],
    "point": [{"name": "centre", "body": "ball", "position": [0.0, 0.0, 0.0]}],
    "material": [{"name": "soft", "law": {"type": "Hooke", "stiffness": 1e4}}],
    "contact": [
        {
            "name": "touch",
            "points": "centre",
            "surface": "walls",
            "material": "soft",
            "radius": 0.05,
            "minima": "all",
            "group_angle": [0.0, 0.5],
            "max_minima": 3,
        }
    ],
    "variation": {
        "touch.law.stiffness": {"values": [1e4, 2e4]},
        "touch.group_angle": {"values": [[0.0, 0.5], [0.0, 0.0]]},
    },
    "record": {"every": 0.001, "sensors": ["touch.force", "touch.minimum_normal_force", "touch.minimum_overflow"]},
}


@pytest.fixture
def folder(tmp_path):
    text = "v 0 -1 0\nv 0 1 0\nv 1 -1 1\nv 1 1 1\nv -1 -1 1\nv -1 1 1\nf 1 3 4\nf 1 4 2\nf 1 2 6\nf 1 6 5\n"
    (tmp_path / "walls.obj").write_text(text, encoding="utf-8")
    return tmp_path


def test_minima_of_an_experiment_are_varied_recorded_and_stored(folder, device):
    run = wc.Experiment.from_dict(STUDY, folder).run(folder / "out", device=device)
    recording = wc.open_run(folder / "out").recording
    depth = 0.05 - 0.0699 / math.sqrt(2)
    expected = [[0, 0, math.sqrt(2) * k * depth] for k in (1e4, 2e4)]
    for one in (run.recording, recording):
        np.testing.assert_allclose(one["touch.force"].values[0], expected, rtol=1e-3, atol=1e-4)
        load = one["touch.minimum_normal_force"].values[0]
        assert load.shape == (2, 6)
        np.testing.assert_allclose(np.sort(load)[:, -2:], depth * np.array([[1e4] * 2, [2e4] * 2]), rtol=1e-3)
        assert (one["touch.minimum_overflow"].values == 0).all()
        angles = one["touch.group_angle"]
        assert angles.dims == ("env", "limit")
        np.testing.assert_array_equal(angles.sel(limit="second"), [0.5, 0.0])
    assert wc.check_usd(wc.export_usd(recording, folder / "run.usdc")) == []
    assert "touch.group_angle" in " ".join(map(str, run.to_dataframe().columns))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"minima": "both"}, r"contact\[0\].*minima.*'both'"),
        ({"group_angle": [0.1]}, "group_angle"),
        ({"group_angle": [0.4, 0.3]}, "group_angle: the second angle must be larger"),
        ({"max_minima": 65}, "max_minima"),
    ],
)
def test_invalid_minima_of_an_experiment_are_refused(changes, message, folder):
    study = STUDY | {"contact": [STUDY["contact"][0] | changes]}
    with pytest.raises(wc.ExperimentError, match=message):
        wc.Experiment.from_dict(study, folder)
