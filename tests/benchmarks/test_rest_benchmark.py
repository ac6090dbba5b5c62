"""Descriptions of models of others are read from the stages that are written from them."""

import importlib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import warpcontact as wc

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="benchmarks are in a checkout, not in an installed package"
)


@pytest.fixture
def load(monkeypatch):
    """Imports a module of the benchmarks."""
    monkeypatch.syspath_prepend(FOLDER)
    return importlib.import_module


def description():
    turn, tilt = Rotation.from_rotvec([0.1, 0.4, -0.2]).as_quat().tolist(), [0.0, 0.0, 0.0, 1.0]
    points = [[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0, 0, 0.2]]
    faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]
    body = {
        "mass": 2.0,
        "inertia": [0.01, 0.02, 0.025],
        "linear_velocity": [0.0] * 3,
        "angular_velocity": [0.0] * 3,
    }
    solid = {"position": [0.0, 0.02, 0.0], "orientation": turn, "friction": 0.5, "excluded": []}
    return {
        "gravity": [0.0, 0.0, -9.81],
        "bodies": [
            {"name": "body_0", "position": [0.0, 0.0, 1.0], "orientation": turn, **body},
            {"name": "body_1", "position": [1.0, 0.0, 1.0], "orientation": tilt, **body},
        ],
        "colliders": [
            {**solid, "body": 0, "kind": "box", "size": [0.1, 0.2, 0.3]},
            {**solid, "body": 0, "kind": "cylinder", "size": [0.1, 0.2, 0.0]},
            {**solid, "body": -1, "kind": "plane", "size": [1.0, 1.0, 1.0]},
            {**solid, "body": 1, "kind": "mesh", "size": [], "vertices": points, "faces": faces, "excluded": [1]},
        ],
    }


def test_description_of_a_written_stage_is_that_of_the_model(tmp_path, load):
    stages = load("rest_model_stages")
    expected = description()
    path = tmp_path / "model.usda"
    path.write_text(stages.stage(expected), encoding="utf-8")
    found = stages.describe(wc.Scene.from_usd(path, trusted=True))
    assert found["gravity"] == pytest.approx(expected["gravity"])
    for one, other in zip(found["bodies"], expected["bodies"], strict=True):
        for key in ("position", "mass", "inertia", "linear_velocity"):
            assert one[key] == pytest.approx(other[key], rel=1e-6), key
    # Shapes of bodies, those of the world, and meshes, as in the model.
    assert [one["kind"] for one in found["colliders"]] == [one["kind"] for one in expected["colliders"]]
    for one, other in zip(found["colliders"], expected["colliders"], strict=True):
        sizes = np.trim_zeros(other["size"])
        assert one["size"][: len(sizes)] == pytest.approx(sizes)
        assert one["friction"] == pytest.approx(0.5)
        assert one["excluded"] == other["excluded"]
    frames = [
        np.array([[*one["position"], *one["orientation"]] for one in of["bodies"]]) for of in (found, expected)
    ]
    for one, other in zip(found["colliders"], expected["colliders"], strict=True):
        # Points of a collider in the world; axes of bodies and meshes may differ.
        places = []
        for solid, of in ((one, frames[0]), (other, frames[1])):
            # A plane defines only its normal.
            points = np.array(solid.get("vertices", np.eye(3)[2:] if solid["kind"] == "plane" else np.eye(3)))
            turn = Rotation.from_quat(solid["orientation"])
            own = turn.apply(points) + solid["position"]
            if solid["body"] >= 0:
                pose = of[solid["body"]]
                own = Rotation.from_quat(pose[3:]).apply(own) + pose[:3]
            places.append(own)
        assert places[0] == pytest.approx(places[1], abs=1e-6)


def test_difference_of_poses_is_that_of_the_corners(load):
    models = load("rest_models")
    one = description()
    poses = np.array([[*body["position"], 0, 0, 0, 1] for body in one["bodies"]])
    moved = poses.copy()
    moved[1, :3] += [0.003, 0.0, 0.002]
    low, high = models.bounds(one, 1)
    height, place = models.differences(one, moved, poses)
    assert height == pytest.approx(0.002 / (high - low).max())
    assert place == pytest.approx(np.hypot(0.003, 0.002) / (high - low).max())


def test_poses_of_a_description_can_be_set(tmp_path, load):
    rest = load("rest")
    one = description()
    path = tmp_path / "model.usda"
    path.write_text(rest.rest_model_stages.stage(one), encoding="utf-8")
    scene = wc.Scene.from_usd(path, trusted=True)
    model = scene.build(device="cpu", precision="float64")
    start = np.array([body.orientation for body in scene.bodies])
    turns = Rotation.from_rotvec([[0.3, -0.2, 1.0], [2.0, 0.1, 0.0]]).as_quat()
    poses = np.hstack([[[0.1, 0.2, 0.3], [1.0, 2.0, 3.0]], turns])
    rest.set_poses(model, one, start, poses)
    found = rest.poses_of(model, one, start)
    # Orientations of principal axes in a stage are in single precision.
    assert rest.rest_models.differences(one, found, poses) == pytest.approx((0.0, 0.0), abs=1e-6)
