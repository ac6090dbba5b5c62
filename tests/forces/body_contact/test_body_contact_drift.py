"""Drift of bodies at rest: after 2 s they do not move, and stay where they are for 10 s."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import warpcontact as wc

MASS = 1.0
LYING = Rotation.from_rotvec([np.pi / 2, 0, 0])
UPRIGHT = Rotation.identity()
# Shape, orientation, and height of the center at rest [m].
SOLIDS = {
    "cube": (wc.shapes.RoundedBox((0.05, 0.05, 0.05)), UPRIGHT, 0.05),
    "mesh": (wc.meshes.box((0.1, 0.1, 0.1)), UPRIGHT, 0.05),
    "standing": (wc.shapes.Cylinder(0.04, 0.05), UPRIGHT, 0.05),
    "lying": (wc.shapes.Cylinder(0.04, 0.05), LYING, 0.04),
    "capsule": (wc.shapes.Capsule(0.04, 0.05), LYING, 0.04),
}

STIFFNESS, GRAVITY = 2e7, 9.81


def volume(name, depth):
    """Returns the volume below a plane of a solid at rest [m³]."""
    radius, half = 0.04, 0.05
    segment = radius**2 * np.arccos(1 - depth / radius) - (radius - depth) * np.sqrt(2 * radius * depth - depth**2)
    cap = np.pi * depth**2 * (radius - depth / 3)
    return {
        "cube": 0.01 * depth,
        "mesh": 0.01 * depth,
        "standing": np.pi * radius**2 * depth,
        "lying": 2 * half * segment,
        "capsule": 2 * half * segment + cap,
    }[name]


@pytest.mark.parametrize("nonsmooth", [True, False], ids=["impulses", "forces"])
def test_solids_at_rest_do_not_drift(nonsmooth, device):
    """They land tilted by 0.7°, 0.3 mm above a floor and turned about the vertical."""
    if nonsmooth:
        material = wc.ContactMaterial(law=wc.laws.Rigid(), friction=wc.friction.Coulomb(mu=0.5))
    else:
        friction = wc.friction.CundallStrack.from_overshoot(
            mu_static=0.5, mu_dynamic=0.5, stiffness=1e5, mass=MASS, overshoot=0.01
        )
        law = wc.laws.ElasticFoundation(stiffness=STIFFNESS, damping=200.0)
        material = wc.ContactMaterial(law=law, friction=friction)
    scene = wc.Scene(gravity=(0, 0, -GRAVITY))
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    for i, (name, (solid, turn, height)) in enumerate(SOLIDS.items()):
        tilted = Rotation.from_rotvec([0.01, 0.006, 0.0]) * Rotation.from_rotvec([0, 0, 0.3]) * turn
        body = scene.add_body(
            mass=MASS,
            inertia=(1.7e-3, 1.7e-3, 1e-3),
            position=(0.5 * i, 0, height + 1e-3),
            orientation=tilted.as_quat(),
            name=name,
        )
        if isinstance(solid, wc.Mesh):
            upper = scene.add_surface(solid, body)
        else:
            upper = scene.add_shape(body, solid)
        scene.add_body_contact(upper, floor, material, name=f"{name}_touch")
    model = scene.build(device=device, precision="float64")
    dt, integrator = (2e-3, wc.integrators.MoreauJean()) if nonsmooth else (2e-4, None)
    sim = wc.Simulation(model, dt=dt, integrator=integrator)
    sim.step(round(2.0 / dt))
    poses = {}
    for name in SOLIDS:
        assert np.abs(model.sensor(f"{name}.linear_velocity")).max() < 1e-6, name
        assert np.abs(model.sensor(f"{name}.angular_velocity")).max() < 1e-6, name
        poses[name] = [model.sensor(f"{name}.{key}")[0].copy() for key in ("position", "orientation")]
        depth = SOLIDS[name][2] - poses[name][0][2]
        if nonsmooth:
            assert abs(depth) < 1e-8, name
        else:
            # Quadrature of curved solids.
            load = STIFFNESS * volume(name, depth)
            assert load == pytest.approx(MASS * GRAVITY, rel=1e-9 if name in ("cube", "mesh") else 1e-4), name
    sim.step(round(10.0 / dt))
    for name, (position, orientation) in poses.items():
        assert np.abs(model.sensor(f"{name}.position")[0] - position).max() < 1e-8, name
        assert np.abs(model.sensor(f"{name}.orientation")[0] - orientation).max() < 1e-7, name
        np.testing.assert_allclose(model.sensor(f"{name}_touch.force")[0], [0, 0, GRAVITY * MASS], atol=1e-6)
