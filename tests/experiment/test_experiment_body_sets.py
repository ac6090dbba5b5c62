"""Body sets in experiment files: lists and files, recordings, and errors."""

import copy

import numpy as np
import pytest

import warpcontact as wc
from warpcontact.experiment.observation import default_sensors

POSITIONS = [[0, 0, 0.2], [1, 0, 0.3], [2, 0, 0.4], [3, 0, 0.5]]
RADII = [0.1, 0.12, 0.14, 0.16]
GRAINS = {"name": "grains", "positions": POSITIONS, "mass": [1, 2, 3, 4], "inertia": [0.01, 0.01, 0.01]}
STUDY = {
    "envs": 3,
    "duration": 0.02,
    "dt": 1e-3,
    "body": [{"name": "ball", "mass": 1, "inertia": [1, 1, 1], "position": [0, 0, 5]}],
    "bodies": [GRAINS],
    "surface": [{"name": "ground", "mesh": {"shape": "grid", "size": [20, 20], "cells": [2, 2]}}],
    "point": [{"name": "middles", "body": "grains", "position": [0, 0, 0]}],
    "points": [{"name": "tips", "body": "grains", "positions": [[0, 0, 0.01 * i] for i in range(4)]}],
    "material": [{"name": "soft", "law": {"type": "KelvinVoigt", "stiffness": 1000, "damping": 1}}],
    "contact": [
        {"name": "touch", "points": "middles", "surface": "ground", "material": "soft", "radius": RADII},
        {"name": "scratch", "points": "tips", "surface": "ground", "material": "soft"},
    ],
    "variation": {"grains.mass": {"values": [[1, 2, 3, 4], [2, 2, 2, 2], [4, 3, 2, 1]]}},
    "record": {"sensors": ["touch.gap", "scratch.gap", "grains.kinetic_energy", "scene.kinetic_energy"]},
    "output": {"usd_envs": 2},
}


@pytest.fixture
def folder(tmp_path):
    np.save(tmp_path / "positions.npy", np.array(POSITIONS))
    np.savetxt(tmp_path / "masses.csv", GRAINS["mass"], header="mass [kg]")
    np.savetxt(tmp_path / "radii.csv", RADII)
    tensors = np.tile(0.01 * np.eye(3).ravel(), (4, 1))
    np.savetxt(tmp_path / "inertia.csv", tensors, delimiter=",")
    return tmp_path


def test_body_set_from_lists_equals_body_set_from_files(folder, device):
    run = wc.Experiment.from_dict(STUDY, folder).run(folder / "lists", device=device)
    data = run.recording
    np.testing.assert_allclose(data["touch.gap"].values[0, 1], np.array(POSITIONS)[:, 2] - RADII, atol=1e-7)
    np.testing.assert_allclose(data["scratch.gap"].values[0, 2], [0.2, 0.31, 0.42, 0.53], atol=1e-7)
    np.testing.assert_array_equal(data["grains.mass"].values, STUDY["variation"]["grains.mass"]["values"])
    assert (run.folder / "picture.png").stat().st_size > 10_000
    # Only the other body is not in the set.
    others = data["scene.kinetic_energy"].values - data["grains.kinetic_energy"].values.sum(axis=2)
    time = data["time"].values[:, None]
    np.testing.assert_allclose(others, np.broadcast_to(0.5 * (9.81 * time) ** 2, others.shape), rtol=1e-4)

    named = copy.deepcopy(STUDY)
    named["bodies"][0] |= {"positions": "positions.npy", "mass": "masses.csv", "inertia": "inertia.csv"}
    named["contact"][0]["radius"] = "radii.csv"
    files = wc.Experiment.from_dict(named, folder).run(folder / "files", device=device)
    # The experiment saved with the results refers to the files from there.
    again = wc.Experiment.from_toml(folder / "files" / "experiment.toml").run(folder / "again", device=device)
    for name in ("touch.gap", "grains.position", "grains.kinetic_energy"):
        for other in (files, again):
            np.testing.assert_array_equal(other.recording[name].values, data[name].values)


@pytest.mark.usefixtures("no_pictures")
def test_body_set_results_do_not_depend_on_shards(folder, device):
    experiment = wc.Experiment.from_dict(STUDY, folder)
    whole = experiment.run(folder / "whole", device=device).recording
    shards = experiment.run(folder / "shards", device=device, shard=2).recording
    for name in ("touch.gap", "grains.position", "grains.mass"):
        np.testing.assert_array_equal(shards[name].values, whole[name].values)


def test_body_set_inertia_follows_from_mass_and_radius_of_each_body(folder, device):
    study = copy.deepcopy(STUDY)
    study["variation"] |= {
        "touch.radius": {"linspace": [0.1, 0.2]},
        "grains.inertia": {"solid_sphere": {"mass": "grains.mass", "radius": "touch.radius"}},
    }
    model = wc.Experiment.from_dict(study, folder).model(device=device)
    expected = 0.4 * np.array(study["variation"]["grains.mass"]["values"]) * np.linspace(0.1, 0.2, 3)[:, None] ** 2
    np.testing.assert_allclose(model["grains.inertia"], expected[..., None, None] * np.eye(3), rtol=1e-12)


def test_body_set_sensors_are_not_recorded_by_default():
    scene = wc.Scene()
    slider = wc.motions.Slider(axis=(0, 0, 1))
    scene.add_bodies(POSITIONS, mass=1, inertia=(1, 1, 1), motion=slider, name="grains")
    scene.add_body(mass=1, inertia=(1, 1, 1), motion=slider, name="piston")
    assert default_sensors(scene.build(1, "cpu")) == ["piston.displacement", "scene.kinetic_energy"]


def test_experiment_can_have_only_a_body_set(device):
    study = {"duration": 1e-3, "dt": 1e-3, "bodies": [GRAINS]}
    assert wc.Experiment.from_dict(study).model(device=device).body_count == 4


BAD = [
    ({"positions": [[0, 0]]}, "bodies[0].positions[0] must be 3 numbers [m], got (0.0, 0.0)"),
    ({"positions": []}, "bodies[0].positions must be a list of 3 numbers each [m], got []"),
    ({"positions": "grains.txt"}, "bodies[0].positions must be a list, or a file that ends in .npy or .csv"),
    ({"positions": "none.npy"}, "bodies[0].positions: there is no file"),
    ({"positions": "words.csv"}, "words.csv' holds no table of numbers"),
    ({"mass": "none.csv"}, "bodies[0].mass: there is no file"),
    ({"mass": [1, 2]}, "bodies[0].mass must have shape () or (4,), one per body, got (2,)"),
    ({"mass": [1, 2, 3, -4]}, "bodies[0].mass[3] must be greater than 0, got -4 kg"),
    ({"inertia": [[1, 1, 1], [1, 1, 5], [1, 1, 1], [1, 1, 1]]}, "bodies[0].inertia[1] must be physical"),
    ({"inertia": [1, 1]}, "bodies[0].inertia must be 3 numbers or a 3×3 tensor [kg·m²], a list of that for each"),
    ({"orientations": [[0, 0, 0, 1]] * 3}, "bodies[0].orientations must have shape (4,) or (4, 4), one per body"),
    ({"orientations": [0, 0, 0, 2]}, "bodies[0].orientations must be a unit quaternion"),
    ({"position": [0, 0, 0]}, "bodies[0].position is not known; did you mean 'positions'?"),
    (
        {"motion": {"type": "Hinge", "axis": [0, 0, 1], "anchor": [0, 0, 0]}},
        "bodies[0].motion must be Free, Fixed, Translation, Planar, Slider or Prescribed for a set of bodies",
    ),
]


@pytest.mark.parametrize(("change", "message"), BAD, ids=[str(change)[:40] for change, _ in BAD])
def test_invalid_body_set_is_reported_with_its_key(change, message, folder):
    (folder / "words.csv").write_text("one,two\n", encoding="utf-8")
    study = copy.deepcopy(STUDY)
    study["bodies"][0] |= change
    with pytest.raises(wc.ExperimentError) as caught:
        wc.Experiment.from_dict(study, folder)
    # Consequential errors in entries that refer to the set are not reported.
    (problem,) = caught.value.problems
    assert message in problem


def test_positions_list_of_a_single_body_is_reported_with_the_right_section():
    study = {
        "duration": 1,
        "dt": 1e-3,
        "body": [{"name": "a", "mass": 1, "inertia": [1, 1, 1], "positions": [[0]]}],
    }
    with pytest.raises(wc.ExperimentError, match=r"a list of positions belongs into \[\[bodies\]\], as positions"):
        wc.Experiment.from_dict(study)


def test_list_of_radii_must_match_number_of_points(folder):
    study = copy.deepcopy(STUDY)
    study["contact"][0]["radius"] = [0.1, 0.1]
    with pytest.raises(wc.ExperimentError, match=r"contact\[0\] \('touch'\)\.radius must be 4 numbers"):
        wc.Experiment.from_dict(study, folder)
