"""Substeps in steps that cross a surface: accuracy, and no effect on other environments and bodies."""

import difficult_meshes
import numpy as np
import pytest
from test_swept import PRECISIONS, SPRING, fan_of_shots, shoot_balls

import warpcontact as wc

STATE = ("ball.position", "ball.orientation", "ball.linear_velocity", "ball.angular_velocity")


@PRECISIONS
def test_crossing_step_is_resolved_in_substeps(precision, device):
    """The penetration and speed at the end of the step match the closed form to first order in the substep."""
    start = np.column_stack([np.zeros((64, 2)), np.linspace(0.02, 0.095, 64)])
    velocity = np.tile([0.0, 0.0, -10.0], (64, 1))
    omega, dt, parts = 100.0, 1e-2, np.array([1, 2, 4, 8, 16])
    errors = []
    for count in parts.tolist():
        sim = shoot_balls(
            difficult_meshes.plate(), start, velocity, dt=dt, precision=precision, device=device, crossing_substeps=count,
            law=wc.laws.Hooke(stiffness=omega**2),
        )  # fmt: skip
        depth, speed = np.full(64, np.nan), np.full(64, np.nan)
        for _ in range(10):
            sim.step()
            new = np.isnan(depth) & (sim.model.sensor("touch.crossings") > 0)
            depth[new] = 1e-3 - sim.model.sensor("ball.position")[new, 2]
            speed[new] = -sim.model.sensor("ball.linear_velocity")[new, 2]
        due = (start[:, 2] - 1e-3) / 10.0
        np.testing.assert_allclose(sim.model.sensor("touch.crossing_time"), due, rtol=0, atol=3e-7)
        since = np.ceil(due / dt) * dt - due
        late = np.abs(depth - 10.0 / omega * np.sin(omega * since)).max()
        # Velocities belong to half a step before the end, with and without substeps.
        behind = 0.5 * dt * 10.0 * omega * np.sin(omega * since)
        fast = np.abs(speed - 10.0 * np.cos(omega * since) - behind).max()
        errors.append((late, fast))
    errors = np.array(errors)
    # The first substep after the crossing has no force yet.
    bound = 10.0 * (omega * dt / parts) * np.array([[1.0 / omega], [1.0]])
    assert (bound > errors.T).all()
    order = np.log2(errors[1:-1] / errors[2:]).mean(axis=0)
    assert (order > 0.8).all()


@PRECISIONS
@pytest.mark.parametrize("omega_dt", [0.1, 0.3])
def test_bounce_with_substeps_gains_negligible_energy(omega_dt, precision, device):
    """Energy error for ω dt = ``omega_dt``: of its square at separation, of the square of the substep at the impact."""
    start = np.column_stack([np.zeros((64, 2)), np.linspace(0.02, 0.12, 64)])
    velocity = np.tile([0.0, 0.0, -10.0], (64, 1))
    for parts in (1, 4, 16):
        sim = shoot_balls(
            difficult_meshes.plate(), start, velocity, dt=1e-2, precision=precision, device=device, crossing_substeps=parts,
            law=wc.laws.Hooke(stiffness=(omega_dt / 1e-2) ** 2),
        )  # fmt: skip
        sim.step(14 + round(4 / omega_dt))
        gain = (sim.model.sensor("ball.linear_velocity")[:, 2] / 10.0) ** 2 - 1
        # The force starts and ends up to a step h late. The error is at most k (v h)²/8 of the energy m v²/2.
        assert gain.min() > -0.25 * (omega_dt / parts) ** 2 - 1e-6
        assert gain.max() < 0.25 * omega_dt**2 + 1e-4


@PRECISIONS
def test_rotating_bounce_at_vertex_with_substeps_gains_negligible_energy(precision, device):
    """The correction by half a step applies to torques as well, about all axes."""
    mass, inertia, corner = 2.0, np.diag([0.02, 0.05, 0.04]), np.array([0.2, 0.1, -0.1])
    scene = wc.Scene(gravity=(0, 0, 0))
    plate = scene.add_surface(difficult_meshes.plate(), name="plate")
    body = scene.add_body(mass, inertia, name="body")
    arm = np.cross(corner, [0.0, 0.0, 1.0])
    opposed = 1.0 / (1.0 / mass + arm @ np.linalg.solve(inertia, arm))
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=opposed * 30.0**2))
    scene.add_contact(scene.add_point(body, corner), plate, material, name="touch", swept=True)
    model = scene.build(envs=32, device=device, precision=precision)
    # The vertex arrives at 2 m/s, half of it from rotation, at times spread over the first step.
    model["body.position"] = np.linspace([0.0, 0.0, 0.103], [0.0, 0.0, 0.119], 32)
    model["body.linear_velocity"], model["body.angular_velocity"] = (0.0, 0.0, -1.0), (-2.0, 4.0, 0.0)
    sim = wc.Simulation(model, dt=1e-2, crossing_substeps=16)
    before = model.sensor("body.kinetic_energy")
    sim.step()
    assert (model.sensor("touch.crossings") == 1).all()
    while (model.sensor("touch.status") != wc.ContactStatus.OPEN).any():
        sim.step()
    gain = model.sensor("body.kinetic_energy") / before - 1
    # The bounds of a bounce without rotation, plus the square of ω dt with 4.5 rad/s for the lever arm that
    # rotates in contact. Without the torque correction, 0.016 of the energy would be lost.
    assert gain.min() > -0.25 * (0.3 / 16) ** 2 - (4.5 * 1e-2) ** 2 * 2
    assert gain.max() < 0.25 * 0.3**2


@PRECISIONS
@pytest.mark.parametrize("parts", [2, 3, 16])
def test_substeps_do_not_affect_environments_without_crossing(parts, precision, device):
    start, velocity, _ = fan_of_shots(60, 1.0)
    slow = np.arange(60) % 3 == 0
    velocity[slow] *= 1e-3  # these do not reach the surface
    spin = np.random.default_rng(2).normal(size=(60, 3))

    def run(rows, count=12):
        sim = shoot_balls(
            difficult_meshes.plate(), start[rows], velocity[rows], dt=1e-2, precision=precision, device=device,
            crossing_substeps=parts,
        )  # fmt: skip
        sim.model["ball.angular_velocity"] = spin[rows]
        sim.step(count)
        return sim

    together, alone = run(np.arange(60)), run(np.flatnonzero(slow))
    assert (together.model.sensor("touch.crossings")[~slow] > 0).all()
    for name in STATE:
        np.testing.assert_array_equal(together.model.sensor(name)[slow], alone.model.sensor(name))
    # An environment that crosses is independent of others that cross at the same time or later.
    single = run(np.array([1]))
    for name in (*STATE, "touch.crossing_time"):
        np.testing.assert_array_equal(together.model.sensor(name)[[1]], single.model.sensor(name))


@PRECISIONS
@pytest.mark.parametrize("parts", [3, 16])
def test_substeps_without_crossing_are_bitwise_identical(parts, precision, device):
    start = np.array([[0.1, 0.2, 0.05], [0.3, -0.2, 0.02]])
    velocity = np.array([[0.0, 0.1, -0.25], [0.3, 0.0, -0.1]])
    results = []
    for options in ({"swept": False}, {"swept": True}, {"swept": True, "crossing_substeps": parts}):
        sim = shoot_balls(
            difficult_meshes.plate(),
            start,
            velocity,
            dt=1e-3,
            precision=precision,
            device=device,
            radius=0.01,
            **options,
        )
        sim.step(200)
        results.append([sim.model.sensor(name) for name in (*STATE, "touch.gap", "touch.normal_force")])
    assert results[0][-1].max() > 0
    for other in results[1:]:
        for expected, value in zip(results[0], other, strict=True):
            np.testing.assert_array_equal(value, expected)


@PRECISIONS
def test_frozen_environments_are_unchanged_by_substeps(precision, device):
    start, velocity, _ = fan_of_shots(12, 1.0)
    sim = shoot_balls(
        difficult_meshes.plate(), start, velocity, dt=1e-2, precision=precision, device=device, crossing_substeps=4
    )
    # A body that becomes non-finite while others cross.
    sim.step(1)
    state = sim.state.body_linear_velocity.numpy().copy()
    state[3] = np.nan
    sim.state.body_linear_velocity.assign(state)
    sim.step(1)
    assert sim.model.health().frozen.tolist() == [3]
    held = [sim.model.sensor(name)[3] for name in STATE]
    sim.step(20)
    for name, before in zip(STATE, held, strict=True):
        np.testing.assert_array_equal(sim.model.sensor(name)[3], before)
    others = np.arange(12) != 3
    assert (sim.model.sensor("touch.crossings")[others] > 0).all()
    assert (sim.model.sensor("ball.linear_velocity")[others, 2] > 0).all()


@PRECISIONS
def test_two_simulations_of_one_model_can_alternate_with_substeps(precision, device):
    start, velocity, _ = fan_of_shots(12, 1.0)
    one = shoot_balls(
        difficult_meshes.plate(), start, velocity, dt=1e-2, precision=precision, device=device, crossing_substeps=3
    )
    values = [one.model.sensor(name) for _ in [one.step(16)] for name in STATE]
    other = wc.Simulation(one.model, dt=1e-2, crossing_substeps=3)
    one.reset()
    for turn in range(16):
        (one if turn % 3 else other).step()
    for expected, name in zip(values, STATE, strict=True):
        np.testing.assert_array_equal(one.model.sensor(name), expected)


@pytest.mark.parametrize("wrong", [0, -1, 1.5, True, "4"])
def test_invalid_number_of_substeps_is_refused(wrong, device):
    model = shoot_balls(
        difficult_meshes.plate(),
        [[0, 0, 1.0]],
        [[0, 0, 0]],
        dt=1e-3,
        precision="float32",
        device=device,
        law=SPRING,
    ).model
    with pytest.raises(ValueError, match=r"crossing_substeps must be a whole number of at least 1"):
        wc.Simulation(model, dt=1e-3, crossing_substeps=wrong)
