"""Contacts that begin deeper than their points can have come: those came to lie behind a surface another way."""

import math
import warnings

import numpy as np
import pytest

import warpcontact as wc

RADIUS, TILT, DT = 0.1, math.radians(20.0), 1e-3
SPRING = wc.Template(law=wc.laws.KelvinVoigt(stiffness=1e4, damping=20.0), friction=wc.frictions.Tanh(mu=0.5))
RIGID = wc.Template(law=wc.laws.Rigid(restitution=0.5), friction=wc.frictions.Coulomb(mu=0.5))
# Past the upper border of the slope, from where a ball falls to behind it; above its middle; in it; fast.
PLACES = [[-1.2, 0.0, 0.8], [0.0, 0.0, 0.4], [0.0, 0.0, -0.1], [0.1, 0.0, 0.5]]
SPEEDS = [[0.0, 0.0, -1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, -30.0]]


def slope(device, precision="float32", template=SPRING, **options):
    """A ball over a square that is inclined, in four environments."""
    h, drop = 1.0, math.tan(TILT)
    corners = [[-h, -h, drop], [h, -h, -drop], [h, h, -drop], [-h, h, drop]]
    scene = wc.Scene()
    ground = scene.add_surface(wc.Mesh(corners, [[0, 1, 2], [0, 2, 3]]), name="ground")
    ball = scene.add_body(mass=1.0, inertia=[4e-3] * 3, name="ball")
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, template, radius=RADIUS, name="touch", **options)
    model = scene.build(envs=len(PLACES), device=device, precision=precision)
    model["ball.position"], model["ball.linear_velocity"] = PLACES, SPEEDS
    return model


def run(model, frames=10, **options):
    """Runs until the ball that fell past the border was pushed out; returns what was said of points behind."""
    options = {"dt": DT, **options}
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        names = [f"{contact.name}.penetration" for contact in model.scene.contacts]
        wc.Simulation(model, **options).run(0.4, names, every=frames * DT)
    return [str(one.message) for one in said if "behind a surface" in str(one.message)]


@pytest.mark.parametrize("options", [{}, {"threads": 1, "graphs": False}], ids=str)
@pytest.mark.parametrize("frames", [1, 10])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_what_comes_from_behind_is_counted_and_told(precision, frames, options, device):
    model = slope(device, precision)
    said = run(model, frames, **options)
    assert model.reading("scene.deep_entries").tolist() == [1, 0, 0, 0]
    # It fell, and was pushed up without touching what is above.
    assert model.reading("ball.linear_velocity")[0, 2] > 2.0
    assert len(said) == 1
    assert said[0].startswith("touch: in 1 of 4 environments, the first of them 0, points came to lie behind")


@pytest.mark.parametrize("options", [{"entry": "latched"}, {"max_depth": 0.15}], ids=str)
def test_what_is_let_go_is_not_counted(options, device):
    model = slope(device, **options)
    assert run(model) == []
    assert not model.reading("scene.deep_entries").any()
    assert model.reading("ball.linear_velocity")[0, 2] == pytest.approx(-1.0 - 9.81 * 0.4, abs=1e-4)


def test_hard_contacts_are_counted_too(device):
    model = slope(device, "float64", RIGID)
    assert len(run(model, integrator=wc.integrators.MoreauJean())) == 1
    assert model.reading("scene.deep_entries").tolist() == [1, 0, 0, 0]


def test_the_contact_that_is_told_of_is_the_one(device):
    """Contacts lie by the code of their laws on the device, not as they were added."""
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    ground = scene.add_surface(wc.Mesh([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]]))
    others = wc.Template(law=wc.laws.Hooke(stiffness=1e3))
    for number, template in enumerate((SPRING, others, SPRING, others)):
        x = -1.05 if number == 2 else 0.4 * number - 0.6
        ball = scene.add_body(mass=1.0, inertia=[4e-3] * 3, position=(x, 0, -0.3), name=f"ball_{number}")
        contact = {"radius": RADIUS, "name": f"touch_{number}", "max_depth": None if number == 2 else 0.01}
        scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, template, **contact)
    model = scene.build(envs=3, device=device)
    # From beside the border to behind it.
    velocity = np.zeros((3, 3))
    velocity[1, 0] = 1.0
    model["ball_2.linear_velocity"] = velocity
    said = run(model)
    assert len(said) == 1
    assert said[0].startswith("touch_2: in 1 of 3 environments, the first of them 1, ")


def test_a_reset_forgets(device):
    model = slope(device)
    simulation = wc.Simulation(model, dt=DT)
    simulation.step(400)
    assert model.reading("scene.deep_entries").tolist() == [1, 0, 0, 0]
    simulation.reset(np.array([True, False, False, False]))
    assert not model.reading("scene.deep_entries").any()
    simulation.step(400)
    assert model.reading("scene.deep_entries").tolist() == [1, 0, 0, 0]
