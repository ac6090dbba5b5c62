"""Recordings of all sensors of nonsmooth body contacts: axes of pairs and of points, stored and read back."""

import numpy as np
import pytest
import xarray as xr
from nonsmooth_scenes import G, rigid

import warpcontact as wc

HARD = wc.integrators.MoreauJean()

STUDY = {
    "envs": 3,
    "duration": 0.004,
    "dt": 1e-3,
    "integrator": {"type": "MoreauJean"},
    "body": [
        {"name": name, "mass": mass, "inertia": [0.01] * 3, "position": [x, 0.0, 0.05]}
        for name, mass, x in (("a", 1.0, 0.0), ("b", 2.0, 0.2), ("c", 3.0, 0.4))
    ],
    "shape": [
        {"name": "floor", "form": {"type": "Plane"}},
        *(
            {"name": f"{name}_box", "body": name, "form": {"type": "RoundedBox", "half_extents": [0.05] * 3}}
            for name in "abc"
        ),
    ],
    "material": [{"name": "hard", "law": {"type": "Rigid"}, "friction": {"type": "Coulomb", "mu": 0.5}}],
    "body_contact": [{"name": "feet", "first": ["a", "b", "c"], "second": "floor", "material": "hard"}],
    "variation": {"feet.friction.mu": {"values": [0.3, 0.4, 0.5]}},
}


def boxes_on_floor(device, *, points=0):
    """Three boxes of 1, 2 and 3 kg at rest on a half-space, two of them in further contacts, and a set of ``points``."""
    scene = wc.Scene(gravity=(0, 0, -G))
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    boxes = []
    for i in range(3):
        body = scene.add_body(i + 1.0, (0.01,) * 3, position=(0.2 * i, 0, 0.05), name=f"box_{i}")
        scene.add_shape(body, wc.shapes.RoundedBox((0.05,) * 3))
        boxes.append(body)
    scene.add_body_contact(boxes, floor, rigid(mu=0.5), name="feet")
    scene.add_body_contact(boxes[0], boxes[1], rigid(mu=0.5), name="side")
    if points:
        # They stay far above.
        surface = scene.add_surface(wc.meshes.grid((1.0, 1.0), (1, 1)), position=(0, 0, -5), name="ground")
        corners = scene.add_points(boxes[2], np.linspace((0, 0, 0), (0, 0, 0.01), points), name="corners")
        scene.add_contact(corners, surface, rigid(), name="far")
    return scene.build(envs=2, device=device, precision="float64")


@pytest.mark.parametrize("points", [0, 3, 12])
def test_all_sensors_of_nonsmooth_body_contacts_are_recorded_together(points, tmp_path, device):
    """Also in a scene with a set of as many points as there are pairs, or points of contact."""
    model = boxes_on_floor(device, points=points)
    recording = wc.Simulation(model, dt=1e-3, integrator=HARD).run(3e-3, model.sensor_names, every=1e-3)
    assert set(model.sensor_names) <= set(map(str, recording.data_vars))
    for name in model.sensor_names:
        np.testing.assert_array_equal(recording[name].values[-1], model.sensor(name), err_msg=name)
    items = "feet.item" if points == 12 else "item"
    assert recording["feet.normal_force"].dims == ("time", "env", items)
    assert recording["feet.load_ratio"].dims == recording["feet.overflow"].dims == ("time", "env", items)
    assert recording["feet.point_gap"].dims == ("time", "env", "feet.point.item")
    assert recording["feet.point"].dims == ("time", "env", "feet.point.item", "axis")
    assert recording.sizes["feet.point.item"] == 12
    # A single pair has an axis of points only.
    assert recording["side.normal_force"].dims == ("time", "env")
    assert recording["side.point_force"].dims == ("time", "env", "side.point.item", "axis")
    total = recording["feet.point_force"].sel(axis="z").sum("feet.point.item")
    np.testing.assert_allclose(total[-1], 6.0 * G, rtol=1e-9)
    recording.to_zarr(tmp_path / "stored.zarr", zarr_format=3, consolidated=False)
    with xr.open_zarr(tmp_path / "stored.zarr", consolidated=False) as stored:
        for name in model.sensor_names:
            assert stored[name].dims == recording[name].dims
            np.testing.assert_array_equal(stored[name], recording[name], err_msg=name)


def test_all_sensors_of_a_nonsmooth_body_contact_are_stored_by_an_experiment(tmp_path, device):
    """In two shards, with an outcome for each point; the report and the picture of the run are made."""
    sim = wc.Simulation(wc.Experiment.from_dict(STUDY).scene().build(device=device), dt=1e-3, integrator=HARD)
    sensors = [name for name in sim.model.sensor_names if name.startswith("feet.")]
    study = STUDY | {
        "record": {"every": 0.001, "sensors": sensors},
        "outcome": {
            "load": {"type": "Max", "of": "feet.point_force", "component": "z", "items": "each"},
            "force": {"type": "Max", "of": "feet.normal_force", "items": "each"},
        },
    }
    wc.Experiment.from_dict(study).run(tmp_path / "out", device=device, shard=2)
    run = wc.open_run(tmp_path / "out")
    assert "feet.point_gap" in sensors
    assert set(sensors) <= set(map(str, run.recording.data_vars))
    points, forces = run.recording["feet.point_force"], run.recording["feet.normal_force"]
    assert points.sizes["feet.point.item"] == 12
    assert forces.sizes["item"] == 3
    np.testing.assert_allclose(forces[-1], np.tile([G, 2 * G, 3 * G], (3, 1)), rtol=1e-4)
    assert run.outcome["load"].dims == ("env", "feet.point.item")
    assert run.outcome["force"].dims == ("env", "item")
    assert (run.outcome["load"].values[:, 8:] > 0.0).any()
