"""Warnings about the time step of body contact."""

import numpy as np
import pytest

import warpcontact as wc

MASS, SIDE, MODULUS = 2.0, 0.1, 1e7


def box_on_box(device, friction=None, **law):
    scene = wc.Scene()
    floor = scene.add_shape(None, wc.shapes.RoundedBox((1.0, 1.0, 0.1)), position=(0, 0, -0.1), name="floor")
    body = scene.add_body(mass=MASS, inertia=[MASS * SIDE**2 / 6] * 3, position=(0, 0, SIDE / 2), name="body")
    box = scene.add_shape(body, wc.shapes.RoundedBox((SIDE / 2,) * 3), name="box")
    material = wc.ContactMaterial(
        law=wc.laws.ElasticFoundation(stiffness=MODULUS, **law), friction=friction or wc.friction.Frictionless()
    )
    scene.add_body_contact(box, floor, material, name="press")
    return scene.build(envs=2, device=device, precision="float64")


def test_time_step_longer_than_a_twentieth_of_the_contact_is_reported(device):
    duration = np.pi * np.sqrt(MASS / (MODULUS * SIDE**2))
    model = box_on_box(device)
    assert wc.Simulation(model, dt=duration / 20.1).check() == []
    (sentence,) = wc.Simulation(model, dt=duration / 19.9).check()
    assert sentence.startswith(f"press: dt = {duration / 19.9:g} s is too long: a contact lasts {duration:.2g} s")
    # The smaller box of an environment has a longer contact.
    model["box.half_extents"] = [[SIDE / 2] * 3, [SIDE / 4] * 3]
    (sentence,) = wc.Simulation(model, dt=duration / 15).check()
    assert "in environment 0" in sentence


def test_damping_that_makes_steps_unstable_is_reported(device):
    rate = np.sqrt(MODULUS * SIDE**2 * (1 + 3000.0) / MASS)
    model = box_on_box(device, damping=3000.0)
    assert wc.Simulation(model, dt=1.99 / rate).check() == []
    (sentence,) = wc.Simulation(model, dt=2.01 / rate).check()
    assert "too long" in sentence


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_friction_that_makes_steps_unstable_is_reported(factor, device):
    stiffness = 1e7
    friction = wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=stiffness)
    # A cube that a force at its base pushes also turns: 2/5 of its mass.
    limit = 2 * np.sqrt(0.4 * MASS / stiffness)
    found = wc.Simulation(box_on_box(device, friction), dt=factor * limit).check()
    assert [one for one in found if "friction, CundallStrack" in one] == (found[-1:] if factor > 1 else [])
    assert (factor > 1) == any("unstable" in one for one in found)


@pytest.mark.parametrize(
    ("form", "side"),
    [
        (wc.shapes.Cylinder(0.1, 0.3), 0.2 * 0.6),
        (wc.shapes.Capsule(0.1, 0.2), 0.2 * 0.6),
        (wc.shapes.Cone(0.3, 0.2), 0.6 * 0.6),
        (wc.shapes.Ellipsoid((0.1, 0.2, 0.3)), 0.4 * 0.6),
        (wc.shapes.Sphere(0.1), 0.2 * 0.2),
    ],
    ids=["cylinder", "capsule", "cone", "ellipsoid", "sphere"],
)
def test_time_step_is_compared_with_the_largest_side_around_a_curved_shape(form, side, device):
    scene = wc.Scene()
    body = scene.add_body(mass=MASS, inertia=[0.1] * 3, position=(0, 0, 1.0), name="body")
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=MODULUS))
    plane = scene.add_shape(None, wc.shapes.Plane(), name="plane")
    scene.add_body_contact(scene.add_shape(body, form), plane, material, name="press")
    model = scene.build(device=device, precision="float64")
    duration = np.pi * np.sqrt(MASS / (MODULUS * side))
    assert wc.Simulation(model, dt=duration / 20.1).check() == []
    (sentence,) = wc.Simulation(model, dt=duration / 19.9).check()
    assert f"a contact lasts {duration:.2g} s" in sentence
