"""Friction models in complete steps: cone, opposition to slip, curves, creep."""

import dataclasses

import numpy as np
import pytest
from scenes import dropped_sphere, square

import warpcontact as wc

F = wc.friction
PAIR = {"mu_static": 0.5, "mu_dynamic": 0.3}
SCALE = 0.01

# Model, largest coefficient, coefficient at slip speed s by an independent formula.
SAMPLES = [
    (F.Frictionless(), 0.0, lambda s: 0 * s),
    (F.Viscous(drag=0.1), np.inf, lambda s: 0.1 * s),
    (F.Tanh(mu=0.4, velocity_scale=SCALE), 0.4, lambda s: 0.4 * np.tanh(s / SCALE)),
    (F.RegularizedCoulomb(mu=0.4, velocity_scale=SCALE), 0.4, lambda s: 0.4 * np.clip(s / SCALE, 0, 1)),
    (F.CoulombThreshold(mu=0.4, threshold=SCALE), 0.4, lambda s: np.where(s > SCALE, 0.4, 0.0)),
    (F.Threlfall(mu=0.4, velocity_scale=SCALE), 0.4, lambda s: 0.4 * np.minimum(1 - np.exp(-3 * s / SCALE), 0.95)),
    (
        F.Ambrosio(mu=0.4, speed_first=0.001, speed_full=SCALE),
        0.4,
        lambda s: 0.4 * np.clip((s - 0.001) / (SCALE - 0.001), 0, 1),
    ),
    (
        F.StepFriction(**PAIR, speed_static=SCALE, speed_dynamic=3 * SCALE),
        0.5,
        lambda s: np.where(s < SCALE, 0.5 * (1.5 * s / SCALE - 0.5 * (s / SCALE) ** 3), 0.5 - 0.2 * smooth(s)),
    ),
    (
        F.BengisuAkay(**PAIR, velocity_scale=SCALE, decay=50.0),
        0.5,
        lambda s: np.where(
            s < SCALE, 0.5 * (1 - (s - SCALE) ** 2 / SCALE**2), 0.3 + 0.2 * np.exp(-50 * (s - SCALE))
        ),
    ),
    (
        F.Stribeck(**PAIR, stribeck_speed=0.1, velocity_scale=SCALE),
        0.5,
        lambda s: (0.3 + 0.2 * np.exp(-((s / 0.1) ** 2))) * np.tanh(s / SCALE),
    ),
    (
        F.BrownMcPhee(**PAIR, transition_speed=SCALE),
        0.5,
        lambda s: 0.3 * np.tanh(4 * s / SCALE) + 0.2 * (s / SCALE) / (0.25 * (s / SCALE) ** 2 + 0.75) ** 2,
    ),
    (
        F.Hollars(**PAIR, transition_speed=SCALE),
        0.5,
        lambda s: np.minimum(s / SCALE, 1) * (0.3 + 0.4 / (1 + (s / SCALE) ** 2)),
    ),
    (
        F.SmoothStribeck(**PAIR, breakaway_speed=SCALE),
        0.5,
        lambda s: (
            np.sqrt(2 * np.e) * 0.2 * np.exp(-(s**2) / (2 * SCALE**2)) * s / (np.sqrt(2) * SCALE)
            + 0.3 * np.tanh(10 * s / SCALE)
        ),
    ),
    (F.Elliptic(mu_1=0.4, mu_2=0.4, angle=0.3, velocity_scale=SCALE), 0.4, lambda s: 0.4 * np.tanh(s / SCALE)),
]


def smooth(s):
    y = np.clip((s - SCALE) / (2 * SCALE), 0, 1)
    return y * y * (3 - 2 * y)


def name_of(sample):
    return type(sample[0]).__name__


def sliding(friction, velocity, device, precision="float32"):
    """Friction force and normal force of a sphere pressed onto a plate, one environment per velocity (n, 2)."""
    envs = len(velocity)
    law = wc.laws.Hooke(stiffness=1e4)
    model = dropped_sphere(law, friction=friction, height=-1e-3, envs=envs, device=device, precision=precision)
    model["ball.linear_velocity"] = np.column_stack([velocity, np.zeros(envs)])
    return model.sensor("touch.friction_force"), model.sensor("touch.normal_force")


def test_samples_cover_the_catalogue():
    """Except for models with history, which are in test_history.py."""
    assert [type(friction) for friction, _, _ in SAMPLES] == [one for one in F.CATALOGUE if not one.memories]


@pytest.mark.parametrize("sample", SAMPLES, ids=name_of)
def test_friction_follows_its_formula_within_its_cone_and_opposes_slip(sample, device):
    friction, largest, coefficient = sample
    rng = np.random.default_rng(5)
    velocity = rng.normal(size=(200, 2)) * np.logspace(-6, 1, 200)[:, None]
    velocity[0] = 0.0
    force, normal = sliding(friction, velocity, device, "float64")
    size, speed = np.linalg.norm(force, axis=1), np.linalg.norm(velocity, axis=1)
    assert np.isfinite(force).all()
    assert (np.einsum("ij,ij->i", force[:, :2], velocity) <= 0).all()
    assert (size <= largest * normal * (1 + 1e-9)).all()
    # tanh(x) ≈ x below 1e-3: 3e-7 of the force.
    np.testing.assert_allclose(size / normal, coefficient(speed), rtol=1e-6, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("sample", SAMPLES, ids=name_of)
def test_friction_in_float32_matches_float64(sample, device):
    velocity = np.column_stack([np.logspace(-5, 1, 50) * 1.01, np.zeros(50)])
    one, normal = sliding(sample[0], velocity, device)
    other, _ = sliding(sample[0], velocity, device, "float64")
    # N at a penetration of 1e-3 and a height of 0.1 has an error of 7e-6; exponents of large numbers add more.
    np.testing.assert_allclose(one, other, rtol=5e-5, atol=1e-5 * normal.max())


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_elliptic_friction_lies_on_its_ellipse_and_maximizes_dissipation(turn, device):
    rng = np.random.default_rng(6)
    velocity = rng.normal(size=(100, 2))
    force, normal = sliding(
        F.Elliptic(mu_1=0.5, mu_2=0.1, angle=turn, velocity_scale=1e-6), velocity, device, "float64"
    )
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    along = force[:, :2] @ rotation.T / normal[:, None] / (0.5, 0.1)
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), 1.0, rtol=1e-9)
    # No other force on the ellipse dissipates more power.
    angle = np.linspace(0, 2 * np.pi, 721)
    others = (np.column_stack([0.5 * np.cos(angle), 0.1 * np.sin(angle)]) @ rotation) * normal[0]
    power = np.einsum("ij,ij->i", force[:, :2], velocity)
    assert (power <= (velocity @ others.T).min(axis=1) + 1e-9).all()


CREEP = [
    (F.Tanh(mu=0.3, velocity_scale=0.01), 6.742317056e-3),
    (F.RegularizedCoulomb(mu=0.3, velocity_scale=0.01), 5.877566024e-3),
    (F.StepFriction(mu_static=0.3, mu_dynamic=0.3, speed_static=0.01, speed_dynamic=0.02), 4.158002890e-3),
]


@pytest.mark.parametrize(("friction", "speed"), CREEP, ids=lambda value: type(value).__name__)
def test_regularized_friction_creeps_at_closed_form_speed(friction, speed, device):
    # A block on a slope of 10° with μ = 0.3.
    slope = np.radians(10.0)
    scene = wc.Scene(gravity=(9.81 * np.sin(slope), 0, -9.81 * np.cos(slope)))
    ground = scene.add_surface(square(5.0))
    block = scene.add_body(1.0, (0.01, 0.01, 0.02), position=(0, 0, 0.02), name="block")
    feet = scene.add_points(block, [(x, y, -0.02) for x in (-0.2, 0.2) for y in (-0.2, 0.2)])
    law = wc.laws.KelvinVoigt(stiffness=1e5, damping=200.0)
    scene.add_contact(feet, ground, wc.ContactMaterial(law=law, friction=friction))
    model = scene.build(device=device, precision="float64")
    wc.Simulation(model, dt=2e-4).step(5000)
    # The points share the load unevenly, by height/width of the block: second order in 0.1.
    np.testing.assert_allclose(model.sensor("block.linear_velocity")[0, 0], speed, rtol=2e-3)


@pytest.mark.parametrize("friction", F.CATALOGUE, ids=lambda friction: friction.__name__)
def test_every_friction_model_is_documented(friction):
    assert friction.__doc__
    assert friction.formula
    assert friction.reference
    assert friction.validity
    assert all(friction.limits(field.name)["meaning"] for field in dataclasses.fields(friction))
    assert friction.__name__ in F.__all__
