"""Detection of time steps that are too long for body contacts that begin during a run."""

import warnings

import numpy as np
import pytest
from scipy.optimize import brentq

import warpcontact as wc
from warpcontact.validation.warning_levels import RunWarning

MASS, SIDE, STIFFNESS, DAMPING = 2.0, 0.1, 1e5, 1e3


def plate_above_posts(device, precision="float64"):
    """A plate of 1 m falls by 1 mm on nine posts, with a spin; it is far above them in the second environment."""
    scene = wc.Scene()
    body = scene.add_body(
        mass=MASS,
        inertia=np.array([1, 1, 2]) * MASS / 12,
        position=(0, 0, SIDE / 2 + 1e-3),
        angular_velocity=(1e-3, 0, 0),
        name="plate",
    )
    plate = scene.add_shape(body, wc.shapes.RoundedBox((0.5, 0.5, SIDE / 2)))
    posts = [
        scene.add_shape(None, wc.shapes.RoundedBox((SIDE / 2,) * 3), position=(x, y, -SIDE / 2))
        for x in (-0.4, 0.0, 0.4)
        for y in (-0.4, 0.0, 0.4)
    ]
    law = wc.laws.KelvinVoigt(stiffness=STIFFNESS, damping=DAMPING)
    scene.add_body_contact(plate, posts, wc.ContactMaterial(law=law), name="rest")
    model = scene.build(envs=2, device=device, precision=precision)
    model["plate.position"] = [[0, 0, SIDE / 2 + 1e-3], [0, 0, 10.0]]
    return model


def stable_limit():
    """Returns the longest stable step of the plate when it rocks on its posts [s].

    Dashpots c' turn it with the rate λ = Σ c' a²/I and springs with the frequency ω² = Σ k a²/I, a = 0.4 m, I = m/12. In a step, each
    contact has c' = c (√(1 + y²) − y), y = c dt/(4 m'), with the mass m' = m/(1 + 12 r²) at the distance r from the center. Steps are
    stable for λ dt + ω² dt²/2 < 2.
    """
    radii = np.sqrt([0.16, 0.32, 0.32] * 2)

    def excess(dt):
        y = DAMPING * dt * (1 + 12 * radii**2) / (4 * MASS)
        damping = DAMPING * (np.sqrt(1 + y**2) - y)
        return (damping * dt + STIFFNESS * dt**2 / 2).sum() * 0.16 * 12 / MASS - 2

    return brentq(excess, 1e-6, 1e-2)


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_unstable_steps_of_contacts_that_begin_later_are_counted(factor, precision, device):
    model = plate_above_posts(device, precision)
    sim = wc.Simulation(model, dt=factor * stable_limit())
    assert sim.check() == []
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        sim.run(0.5, progress=False)
    steps = model.sensor("rest.unstable_steps")
    assert (steps.max() > 0) == (factor > 1)
    assert steps[1].max() == 0
    (*texts,) = (str(one.message) for one in found if one.category is RunWarning)
    assert len(texts) == (factor > 1)
    if factor < 1:
        # It has come to rest.
        assert np.abs(model.sensor("plate.angular_velocity")[0]).max() < 1e-6
    else:
        assert texts[0].startswith("rest: dt was too long in 1 of 2 environments (first: 0)")
        assert "rest.unstable_steps counts such steps" in texts[0]
        sim.reset()
        assert model.sensor("rest.unstable_steps").max() == 0


def test_elastic_bounces_and_vibrations_are_not_counted(device):
    """A box on an undamped foundation vibrates, rocks and bounces, with 20 steps in half a period."""
    scene = wc.Scene()
    floor = scene.add_shape(None, wc.shapes.Plane())
    body = scene.add_body(
        mass=MASS,
        inertia=[MASS * SIDE**2 / 6] * 3,
        position=(0, 0, 0.06),
        angular_velocity=(3.0, 1.0, 0.0),
        name="box",
    )
    box = scene.add_shape(body, wc.shapes.RoundedBox((SIDE / 2,) * 3))
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e7))
    scene.add_body_contact(box, floor, material, name="press")
    model = scene.build(device=device, precision="float64")
    wc.Simulation(model, dt=np.pi * np.sqrt(MASS / (1e7 * SIDE**2)) / 20).step(5000)
    assert model.sensor("press.unstable_steps") == 0
