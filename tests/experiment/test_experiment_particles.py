"""Particle contacts in experiment files: keys, variations and errors."""

import copy

import numpy as np
import pytest

import warpcontact as wc

STUDY = {
    "envs": 2,
    "duration": 0.02,
    "dt": 1e-3,
    "gravity": [0.0, 0.0, 0.0],
    "body": [
        {"name": name, "mass": 1.0, "inertia": [0.01] * 3, "position": [0.15 * i, 0.0, 0.0]}
        for i, name in enumerate(("left", "middle", "right"))
    ],
    "shape": [
        {"name": "first", "body": "left", "form": {"type": "Sphere", "radius": 0.1}},
        {"name": "second", "body": "middle", "form": {"type": "Capsule", "radius": 0.1, "half_length": 0.2}},
        {"name": "third", "body": "right", "form": {"type": "Sphere", "radius": 0.1}},
    ],
    "material": [{"name": "soft", "law": {"type": "Hooke", "stiffness": 1000.0}}],
    "particle_contact": [
        {
            "name": "pile",
            "shapes": ["first", "second", "third"],
            "material": "soft",
            "exclude": [["second", "third"]],
            "skin": 0.01,
            "max_neighbors": 5,
        }
    ],
    "variation": {
        "first.radius": {"values": [0.1, 0.04]},
        "pile.law.stiffness": {"linspace": [500.0, 1000.0]},
    },
    "record": {"every": 0.01},
}


def test_particle_contact_of_an_experiment_is_varied_recorded_and_stored(tmp_path, device):
    run = wc.Experiment.from_dict(STUDY, tmp_path).run(tmp_path / "out", device=device)
    data = run.recording
    assert data["pile.contacts"].values[0].tolist() == [1, 0]
    np.testing.assert_allclose(data["pile.max_penetration"].values[0], [0.05, 0.0], rtol=1e-6)
    again = wc.Experiment.from_toml(tmp_path / "out" / "experiment.toml").run(tmp_path / "again", device=device)
    np.testing.assert_array_equal(again.recording["pile.contacts"].values, data["pile.contacts"].values)


def test_particle_contact_problems_are_all_reported(tmp_path):
    study = copy.deepcopy(STUDY)
    study["particle_contact"][0] |= {
        "shapes": ["first", "secnd"],
        "material": "sfot",
        "exclude": [["third", "gone"]],
    }
    with pytest.raises(ValueError, match="secnd") as error:
        wc.Experiment.from_dict(study, tmp_path)
    text = str(error.value).replace(" ('pile')", "")
    for words in (
        "particle_contact[0].shapes[1]",
        "particle_contact[0].material",
        "particle_contact[0].exclude[0][1]",
    ):
        assert words in text
    study = copy.deepcopy(STUDY)
    study["particle_contact"][0] |= {"skin": -1.0, "max_neighbors": 0, "kapa": 0.5}
    with pytest.raises(ValueError, match="skin") as error:
        wc.Experiment.from_dict(study, tmp_path)
    text = str(error.value).replace(" ('pile')", "")
    for words in ("particle_contact[0].skin", "particle_contact[0].max_neighbors", "kapa"):
        assert words in text
    study = copy.deepcopy(STUDY)
    study["shape"][2]["form"] = {"type": "Plane"}
    with pytest.raises(ValueError, match=r"particle_contact\[0\].*'third' is a Plane; particle contacts are of"):
        wc.Experiment.from_dict(study, tmp_path)
