"""Stages of other programs: bodies come to rest on their faces, at heights in closed form."""

import numpy as np
import pytest
from physics_stages import contact_pairs, stage
from rest_stages import STAGES

import warpcontact as wc

# 1/50 of the contact time of imported materials [s].
DT = 2e-4


def settled(path, seconds, parameters=None, *, dt=DT, integrator=None):
    """The scene of a stage, and its model after a time."""
    scene = wc.Scene.from_usd(path, trusted=True)
    model = scene.build(device="cpu", precision="float64")
    for name, value in (parameters or {}).items():
        model[name] = value
    wc.Simulation(model, dt=dt, integrator=integrator).step(round(seconds / dt))
    return scene, model


def check_rest(scene, model):
    for one in scene.bodies:
        for speed in ("linear_velocity", "angular_velocity"):
            assert np.abs(model.sensor(f"{one.name}.{speed}")).max() < 1e-6, (one.name, speed)


def heights(scene, model):
    return {one.name: float(model.sensor(f"{one.name}.position")[0, 2]) for one in scene.bodies}


@pytest.mark.parametrize("name", STAGES)
def test_bodies_of_a_stage_come_to_rest_on_their_faces(tmp_path, name):
    own = STAGES[name]
    scene, model = settled(stage(tmp_path, own.content, **own.metadata), 1.5)
    check_rest(scene, model)
    expected = {body: height - depth for body, (height, depth) in own.heights.items()}
    assert heights(scene, model) == pytest.approx(expected, abs=own.tolerance)
    assert not set(own.filtered) & {tuple(sorted(pair)) for pair in contact_pairs(scene)}


@pytest.mark.parametrize("name", STAGES)
def test_bodies_of_a_stage_come_to_rest_without_penetration_with_nonsmooth_contact(tmp_path, name):
    own = STAGES[name]
    path = stage(tmp_path, own.content, **own.metadata)
    scene, model = settled(path, 2.0, dt=2e-3, integrator=wc.integrators.MoreauJean())
    check_rest(scene, model)
    # Rounding of mesh points to single precision.
    assert heights(scene, model) == pytest.approx(
        {body: height for body, (height, _) in own.heights.items()}, abs=2e-8
    )


@pytest.mark.parametrize("rigid", [False, True], ids=["compliant", "nonsmooth"])
@pytest.mark.parametrize(
    ("case", "seconds", "push", "places"),
    [
        # Dropped with a tilt of 10 degrees; it may slide.
        ("p01_tilted_cube", 4.0, 0.0, {"b": (0.0, None, 0.1)}),
        # Pushed with half of the force at which it slides.
        ("p02_cube_at_rest", 2.0, 20.0, {"b": (0.0, 0.0, 0.1)}),
        ("p03_equal_mesh_cubes", 1.0, 0.0, {"a": (0.0, 0.0, 0.1), "b": (0.0, 0.0, 0.3)}),
    ],
)
def test_stages_of_cubes_come_to_rest_within_a_millimeter(shared, case, seconds, push, places, rigid):
    """Finite stiffness: 0.1 mm for each contact and weight. Nonsmooth contact has no penetration."""
    parameters = {"b.external_force": (push, 0.0, 0.0)} if push else {}
    method = {"dt": 2e-3, "integrator": wc.integrators.MoreauJean()} if rigid else {}
    scene, model = settled(shared / "cases" / "patches" / f"{case}.usda", seconds, parameters, **method)
    check_rest(scene, model)
    for name, place in places.items():
        for found, expected in zip(model.sensor(f"{name}.position")[0], place, strict=True):
            assert expected is None or found == pytest.approx(expected, abs=2e-8 if rigid else 1e-3), name
