"""Nonsmooth contact in published benchmarks of rigid bodies, with the error measures of their sources.

Rolling and bouncing are those of SimBenchmark (Kang and Hwangbo, leggedrobotics.github.io/SimBenchmark). The rod
is that of Painlevé (1895), with the impact without collision of Génot and Brogliato (1999).
"""

import itertools

import numpy as np
import pytest
from nonsmooth_scenes import ENERGY, G, add_box, energy, rigid
from scenes import square
from scipy.optimize import brentq

import warpcontact as wc


@pytest.mark.parametrize("direction", [(0.0, 1.0, 0.0), (np.sqrt(0.5), np.sqrt(0.5), 0.0)], ids=["y", "xy"])
def test_nonsmooth_rolling_matches_simbenchmark(device, direction):
    """A box of 10 kg, 20 × 20 × 1 m, on the ground, 25 balls of 1 kg and 0.5 m on it, and 150 N on the box.

    μ is 0.4 below the box, which slides, and 0.8 at the balls, which roll. With f₁ = μ (M + n m) g below the box
    and f₂ = (F − f₁)/M / (3.5/m + n/M) at a ball, accelerations are (F − f₁ − n f₂)/M and f₂/m, in any direction.
    All bodies begin at a penetration of 5 μm, and the step is 1 ms. The measure is the error of the speeds of box
    and balls. (SimBenchmark uses the mean over time of the sum of their squared errors; with friction pyramids the
    box stays at rest along xy.)
    """
    n, m, M, F, dt, deep = 25, 1.0, 10.0, 150.0, 1e-3, 5e-6
    direction_of_motion = np.array(direction)
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(100.0), name="ground")
    size = (20.0, 20.0, 1.0)
    feet = [(x, y, -0.5) for x in (-10.0, 10.0) for y in (-10.0, 10.0)]
    options = {
        "mass": M,
        "feet": feet,
        "position": (0.0, 0.0, 0.5 - deep),
        "external_force": F * direction_of_motion,
    }
    box = add_box(scene, size, ground, rigid(mu=0.4), **options)
    top = scene.add_surface(wc.meshes.box(size), box, name="top")
    grid = 2.0 * np.arange(5.0) - 4.0
    places = [(x, y, 1.5 - 3.0 * deep) for x in grid for y in grid]
    balls = scene.add_bodies(places, mass=m, inertia=[0.4 * m * 0.25] * 3, name="balls")
    centres = scene.add_point(balls, (0.0, 0.0, 0.0))
    scene.add_contact(centres, top, rigid(mu=0.8), radius=0.5, kappa=1.0, name="roll")
    model = scene.build(device=device, precision="float64")
    integrator = wc.integrators.MoreauJean(solver="accelerated", iterations=2000, tolerance=1e-8)
    sensors = ["box.linear_velocity", "balls.linear_velocity", "roll.penetration", "box_feet.penetration"]
    data = wc.Simulation(model, dt, integrator).run(1.0, sensors)
    f1 = 0.4 * (M + n * m) * G
    f2 = (F - f1) / M / (3.5 / m + n / M)
    time = data["time"].values[:, None]
    box_error = data["box.linear_velocity"].values[:, 0] - (F - f1 - n * f2) / M * time * direction_of_motion
    ball_error = data["balls.linear_velocity"].values[:, 0] - (f2 / m * time * direction_of_motion)[:, None]
    mean_square = (np.square(box_error) + np.square(ball_error[:, 0])).sum(axis=1).mean()
    # 1000 steps, each solved to 1e-8 of impulses of 0.3 N·s on 10 kg. Published errors begin at 1e-12.
    assert mean_square < 1e-14
    assert np.abs(box_error).max() < 1e-6
    assert np.abs(ball_error).max() < 1e-6
    for name, start in (("roll", 2.0 * deep), ("box_feet", deep)):
        assert data[f"{name}.penetration"].values.max() < start + 1e-6


def test_nonsmooth_bouncing_conserves_energy_in_simbenchmark(device):
    """49 balls of 10 kg and 0.1 m fall from 5 m with e = 1, in steps of 10 ms for 20 s, and conserve their energy."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(50.0), name="ground")
    grid = 2.0 * np.arange(7.0)
    balls = scene.add_bodies(
        [(x, y, 5.0) for x in grid for y in grid], mass=10.0, inertia=[0.4 * 10.0 * 0.01] * 3, name="balls"
    )
    scene.add_contact(scene.add_point(balls, (0, 0, 0)), ground, rigid(1.0), radius=0.1, kappa=1.0, name="touch")
    model = scene.build(device=device, precision="float64")
    data = wc.Simulation(model, 1e-2, wc.integrators.MoreauJean()).run(20.0, [*ENERGY, "touch.penetration"])
    total = energy(data)[:, 0]
    assert np.abs(total / (49 * 10.0 * G * 5.0) - 1.0).max() < 1e-11
    # Gaps are predicted half a step ahead: a contact is closed if the last half step ends below the ground.
    assert 0.0 < data["touch.penetration"].values.max() < np.sqrt(2.0 * G * 5.0) * 1e-2


def turned(time, first, drive, friction):
    """Velocity (along the new and the old force) of a sliding block, ``time`` after its force turned by 90°.

    With the angle ψ of the velocity from the force, u = tan ψ/2, k = friction/drive: s sin ψ = C uᵏ, and t = C/(2
    a) (u₀ᵏ⁻¹/(k − 1) + u₀ᵏ⁺¹/(k + 1) − …u…), from s dψ/dt = −a sin ψ, ds/dt = a cos ψ − friction.
    """
    k = friction / drive

    def spent(u):
        return first / (2.0 * drive) * (u ** (k - 1.0) / (k - 1.0) + u ** (k + 1.0) / (k + 1.0))

    u = brentq(lambda u: spent(1.0) - spent(u) - time, 1e-9, 1.0, xtol=1e-15)
    angle = 2.0 * np.arctan(u)
    speed = first * u**k / np.sin(angle)
    return speed * np.array([np.cos(angle), np.sin(angle)])


def test_nonsmooth_sliding_block_matches_closed_form_after_change_of_direction(device):
    """A force of constant size drives a block without rotation over rough ground, and turns by 90° halfway."""
    mu, force, half = 0.3, 6.0, 0.4
    drive, friction = force, mu * G
    before = (drive - friction) * half
    expected = turned(half, before, drive, friction)
    errors = []
    for dt in (8e-3, 4e-3, 2e-3):
        model = sledge(mu, device)
        simulation = wc.Simulation(model, dt, wc.integrators.MoreauJean())
        model["sledge.external_force"] = (0.0, force, 0.0)
        simulation.step(round(half / dt))
        assert model.sensor("sledge.linear_velocity")[0] == pytest.approx([0.0, before, 0.0], abs=1e-8)
        model["sledge.external_force"] = (force, 0.0, 0.0)
        simulation.step(round(half / dt))
        errors.append(np.abs(model.sensor("sledge.linear_velocity")[0, :2] - expected).max())
        assert model.sensor("touch.penetration")[0] == pytest.approx(1e-9, rel=1e-6)
    assert errors[-1] < 2e-3 * np.abs(expected).max()
    for coarse, fine in itertools.pairwise(errors):
        assert coarse / fine == pytest.approx(2.0, rel=0.1)


def sledge(mu, device):
    """A body of 1 kg without rotation, 1 nm deep in rough ground."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(50.0), name="ground")
    start = {"position": (0.0, 0.0, -1e-9), "motion": wc.motions.Translation()}
    body = scene.add_body(1.0, [1.0] * 3, **start, name="sledge")
    scene.add_contact(scene.add_point(body, (0.0, 0.0, 0.0)), ground, rigid(mu=mu), name="touch")
    return scene.build(device=device, precision="float64")


def test_nonsmooth_rolling_ball_matches_closed_form_after_change_of_direction(device):
    """A force on a ball turns by 90° halfway: the ball rolls, with 5/7 F/m along the force of each half."""
    model = rolling_ball(device)
    simulation = wc.Simulation(model, 2e-3, wc.integrators.MoreauJean())
    for number, force in enumerate([(3.0, 0.0, 0.0), (0.0, 3.0, 0.0)]):
        model["ball.external_force"] = force
        simulation.step(250)
        gained = 5.0 / 7.0 * 3.0 * 0.5
        assert model.sensor("ball.linear_velocity")[0] == pytest.approx([gained, number * gained, 0.0], abs=1e-8)
    assert model.sensor("touch.mode")[0] == wc.ContactMode.STICK


def rolling_ball(device):
    """A ball of 1 kg on ground with μ = 0.2, which rolls for forces up to 3.5 μ m g."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(50.0), name="ground")
    body = scene.add_body(1.0, [0.004] * 3, position=(0.0, 0.0, 0.1 - 1e-9), name="ball")
    point = scene.add_point(body, (0.0, 0.0, 0.0))
    scene.add_contact(point, ground, rigid(mu=0.2), radius=0.1, kappa=1.0, name="touch")
    return scene.build(device=device, precision="float64")


# A rod of 2 m and 1 kg with its lower end on the ground and its center towards +x, at tan θ = 2, where μ = 4/3 is
# critical. The end slides towards −x. Delassus operator of the end, along n and t.
SIN, COS = 2.0 / np.sqrt(5.0), 1.0 / np.sqrt(5.0)
DELASSUS = np.array([[1.0 + 3.0 * COS**2, -3.0 * SIN * COS], [-3.0 * SIN * COS, 1.0 + 3.0 * SIN**2]])


def painleve(mu, dt, solver, device):
    """Returns a simulation of the rod with its end at a penetration of 1 nm, sliding at 3 m/s."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(50.0), name="ground")
    rod = scene.add_body(
        1.0,
        (1.0 / 3.0, 1.0 / 3.0, 1e-3),
        position=(COS, 0.0, SIN - 1e-9),
        linear_velocity=(-3.0, 0.0, 0.0),
        orientation=leaning(),
        name="rod",
    )
    scene.add_contact(scene.add_point(rod, (0.0, 0.0, -1.0)), ground, rigid(mu=mu), name="touch")
    model = scene.build(device=device, precision="float64")
    return wc.Simulation(model, dt, wc.integrators.MoreauJean(solver=solver))


def leaning():
    """Axis z of the rod along (cos θ, 0, sin θ): rotated about y by 90° − θ."""
    half = 0.5 * np.arctan2(COS, SIN)
    return (0.0, np.sin(half), 0.0, np.cos(half))


@pytest.mark.parametrize("solver", ["gauss_seidel", "accelerated"])
def test_painleve_rod_slides_below_critical_friction(device, solver):
    simulation = painleve(1.0, 1e-5, solver, device)
    simulation.step(2)
    model = simulation.model
    # N = m g / (W_nn + μ W_nt), 2.5 times the weight at μ = 1.
    expected = G / (DELASSUS[0, 0] + DELASSUS[0, 1])
    assert model.sensor("touch.normal_force")[0] == pytest.approx(expected, rel=1e-3)
    assert model.sensor("touch.mode")[0] == wc.ContactMode.SLIP


@pytest.mark.parametrize("solver", ["gauss_seidel", "accelerated"])
@pytest.mark.parametrize("dt", [1e-3, 1e-5])
def test_painleve_rod_stops_by_impulse_above_critical_friction(device, dt, solver):
    """At μ = 2 no finite force is consistent with sliding: an impulse stops the end in one step, for any dt.

    The impulse is W⁻¹ times the velocity of the end and lies in the cone: 1.2 N·s along the ground, 0.9 N·s
    normal.
    """
    simulation = painleve(2.0, dt, solver, device)
    model = simulation.model
    simulation.step(1)
    assert model.sensor("scene.solve_converged")[0] == 1
    expected = np.linalg.solve(DELASSUS, [G * dt, 3.0])
    impulse = model.sensor("touch.impulse")[0]
    assert impulse[[2, 0]] == pytest.approx(expected, rel=1e-6)
    assert expected == pytest.approx([0.9, 1.2], rel=0.02)
    assert model.sensor("touch.mode")[0] == wc.ContactMode.STICK
    assert model.sensor("scene.kinetic_energy")[0] == pytest.approx(4.5 - 1.8, rel=0.02)
    before = energy_of(model)
    for _ in range(400):
        simulation.step(1)
        now = energy_of(model)
        # The energy of a rotating body is constant to second order in the step.
        assert now - before < 20.0 * dt**2 + 1e-9
        before = now
    # Gauss–Seidel solves a single contact exactly, by cases. The accelerated solver is iterative, and strong
    # coupling of normal and tangent may prevent convergence; it reports that.
    unsolved = model.sensor("scene.solve_failures")[0]
    assert unsolved == 0 if solver == "gauss_seidel" else unsolved < 0.25 * 400


def energy_of(model):
    return sum(model.sensor(name)[0] for name in ENERGY)
