"""Environments are independent of each other and of their number, and can be reset."""

import dataclasses

import numpy as np
import pytest
from scenes import dropped_sphere

import warpcontact as wc

RECORD = ["ball.position", "ball.angular_velocity", "touch.gap", "touch.normal_force", "touch.friction_force"]


def terrain_model(envs, device, spread=None):
    """Spheres with different parameters in each environment, on a small terrain."""
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.sinusoidal_terrain((4, 4), (30, 30)), name="ground")
    ball = scene.add_body(0.5, (5e-4, 5e-4, 5e-4), position=(0.1, 0.2, 0.3), name="ball")
    material = wc.ContactMaterial(
        law=wc.laws.HuntCrossley(stiffness=2e4, restitution=0.7), friction=wc.friction.Tanh(mu=0.4)
    )
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, material, radius=0.05, name="touch")
    model = scene.build(envs=envs, device=device)
    spread = np.linspace(0, 1, envs) if spread is None else np.atleast_1d(spread)
    model["ball.mass"] = 0.2 + spread
    model["touch.radius"] = 0.03 + 0.05 * spread
    model["touch.law.restitution"] = 0.2 + 0.7 * spread
    model["touch.friction.mu"] = 0.8 * spread
    model["ball.position"] = np.stack([spread - 0.5, 0.3 - spread, 0.35 + 0 * spread], axis=1)
    model["ball.angular_velocity"] = np.stack([10 * spread, 0 * spread, -5 * spread], axis=1)
    return model


def trace(model, duration=0.5):
    return wc.Simulation(model, dt=5e-4).run(duration, RECORD, every=0.01)


def assert_same_bits(one, other):
    for name in RECORD:
        np.testing.assert_array_equal(one[name].values, other[name].values, err_msg=name)


def test_environment_alone_is_bitwise_identical_to_same_environment_among_4096(device):
    envs, chosen = 4096, 1234
    many = trace(terrain_model(envs, device), 0.35)
    alone = trace(terrain_model(1, device, spread=np.linspace(0, 1, envs)[chosen]), 0.35)
    assert (many["touch.normal_force"].isel(env=chosen) > 0).any()
    assert_same_bits(many.isel(env=[chosen]), alone)


def test_run_is_repeated_bitwise(device):
    assert_same_bits(trace(terrain_model(32, device)), trace(terrain_model(32, device)))


def test_nan_does_not_spread_to_other_environments(device):
    clean = trace(terrain_model(64, device))
    model = terrain_model(64, device)
    sim = wc.Simulation(model, dt=5e-4)
    position = sim.state.body_position.numpy()
    position[17, 0, 1] = np.nan
    sim.state.body_position.assign(position)
    with pytest.warns(RuntimeWarning, match=r"1 of 64 environments turned non-finite .*: 17"):
        spoiled = sim.run(0.5, RECORD, every=0.01)
    others = np.arange(64) != 17
    assert_same_bits(clean.isel(env=others), spoiled.isel(env=others))
    assert model.health().frozen.tolist() == [17]
    assert spoiled.attrs["frozen_environments"] == [17]


def test_diverged_environment_keeps_its_last_finite_state(device):
    law = wc.laws.Hooke(stiffness=1e4)
    model = dropped_sphere(law, gravity=(0, 0, -9.81), height=-0.01, velocity=(0, 0, 0), envs=8, device=device)
    stiffness = np.full(8, 1e4)
    stiffness[3] = 1e38
    model["touch.law.stiffness"] = stiffness
    sim = wc.Simulation(model, dt=1e-3)
    with pytest.warns(RuntimeWarning, match="1 of 8 environments"):
        recording = sim.run(0.1, ["ball.position"], every=1e-3)
    held = recording["ball.position"].values[:, 3]
    assert np.isfinite(held).all()
    np.testing.assert_array_equal(held[-1], held[-2])
    np.testing.assert_array_equal(sim.state.body_position.numpy()[3, 0], held[-1].astype(np.float32))
    # A reset unfreezes the environment.
    model["touch.law.stiffness"] = 1e4
    sim.reset()
    assert model.health().good
    sim.step(100)
    assert model.health().good
    assert not np.array_equal(model.sensor("ball.position")[3], held[-1])


def test_all_bodies_of_failed_environment_keep_their_state(device):
    scene = wc.Scene()
    for name in ("first", "second", "third"):
        scene.add_body(1.0, (1, 1, 1), name=name)
    model = scene.build(envs=4, device=device)
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(5)
    velocity = sim.state.body_linear_velocity.numpy()
    before = sim.state.body_position.numpy().copy()
    velocity[2, 1] = np.inf
    sim.state.body_linear_velocity.assign(velocity)
    for count in (1, 2, 3):
        sim.step(count)
        np.testing.assert_array_equal(sim.state.body_position.numpy()[2], before[2])
    assert (sim.state.body_position.numpy()[[0, 1, 3], :, 2] < before[[0, 1, 3], :, 2]).all()


def test_reset_changes_masked_environments_only(device):
    model = terrain_model(16, device)
    sim = wc.Simulation(model, dt=5e-4)
    start = sim.state.body_position.numpy().copy()
    sim.step(601)
    later = sim.state.body_position.numpy().copy()
    mask = np.arange(16) % 2 == 0
    entry = model.arrays.history.entry_speed.numpy().copy()
    sim.reset(mask)
    np.testing.assert_array_equal(sim.state.body_position.numpy()[mask], start[mask])
    np.testing.assert_array_equal(sim.state.body_position.numpy()[~mask], later[~mask])
    assert (model.arrays.history.entry_speed.numpy()[mask] == -1).all()
    np.testing.assert_array_equal(model.arrays.history.entry_speed.numpy()[~mask], entry[~mask])


def test_run_is_repeated_after_reset(device):
    model = terrain_model(8, device)
    sim = wc.Simulation(model, dt=5e-4)
    first = sim.run(0.5, RECORD, every=0.01)
    sim.reset()
    assert_same_bits(first, sim.run(0.5, RECORD, every=0.01))


def test_number_of_steps_per_call_does_not_change_results(device):
    one, other = (wc.Simulation(terrain_model(8, device), dt=5e-4) for _ in range(2))
    one.step(500)
    for count in (1, 2, 3, 94, 200, 200):
        other.step(count)
    np.testing.assert_array_equal(one.state.body_position.numpy(), other.state.body_position.numpy())


def test_sensor_array_is_unchanged_by_later_steps(device):
    sim = wc.Simulation(terrain_model(2, device), dt=5e-4)
    height, energy = (sim.model.sensor(name) for name in ("ball.position", "scene.kinetic_energy"))
    kept = height.copy(), energy.copy()
    sim.step(100)
    sim.model.sensor("scene.kinetic_energy")
    np.testing.assert_array_equal(height, kept[0])
    np.testing.assert_array_equal(energy, kept[1])


def test_sensor_evaluation_does_not_change_the_motion(device):
    one, other = (wc.Simulation(terrain_model(8, device), dt=5e-4) for _ in range(2))
    one.step(600)
    for _ in range(600):
        other.step()
        other.model.sensor("touch.normal_force")
    np.testing.assert_array_equal(one.state.body_position.numpy(), other.state.body_position.numpy())


def test_broadcast_and_repeated_parameters_give_bitwise_identical_results(device):
    """Stride 0 and a full array give the same result."""
    friction = wc.friction.Tanh(mu=0.4)
    one, other = (
        dropped_sphere(
            wc.laws.HuntCrossley(stiffness=2e4, restitution=0.7), friction=friction, gravity=(0, 0, -9.81),
            height=0.1, velocity=(1, 0, 0), envs=8, device=device,
        )
        for _ in range(2)
    )  # fmt: skip
    for name in other:
        other[name] = other[name]
    assert one.arrays.model.body_mass.strides[0] == 0
    assert other.arrays.model.body_mass.strides[0] > 0
    assert_same_bits(trace(one), trace(other))


def test_parameters_can_change_between_steps(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), envs=3, device=device)
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(3)
    model["scene.gravity"] = [(1, 0, 0), (0, 2, 0), (0, 0, 3)]
    before = sim.state.body_linear_velocity.numpy().copy()
    model["touch.enabled"] = 0
    sim.step(10)
    gained = sim.state.body_linear_velocity.numpy()[:, 0] - before[:, 0]
    np.testing.assert_allclose(gained, np.diag([1, 2, 3]) * 0.01, atol=1e-6)


def test_new_parameter_values_compile_no_kernel(device):
    from warpcontact.kernels.contact import contact_force

    model = terrain_model(4, device)
    wc.Simulation(model, dt=5e-4).step(2)
    compiled = contact_force.kernel.cache_info().misses
    model["touch.law.restitution"] = np.linspace(0.3, 0.5, 4)
    model["touch.law.stiffness"] = 3e4
    wc.Simulation(model, dt=1e-4).step(2)
    other = terrain_model(9, device)
    wc.Simulation(other, dt=1e-4).step(2)
    assert contact_force.kernel.cache_info().misses == compiled


def test_state_is_shared_with_numpy_and_torch_without_copy():
    model = terrain_model(8, "cpu")
    sim = wc.Simulation(model, dt=5e-4)
    view = sim.state.body_position.numpy()
    assert view.shape == (8, 1, 3)
    for count in (1, 3, 4):
        sim.step(count)
        # The sensor includes the rounding remainder of the position.
        np.testing.assert_array_equal(view, model.sensor("ball.position")[:, None].astype(np.float32))
    assert view.ctypes.data == sim.state.body_position.ptr
    through_dlpack = np.from_dlpack(sim.state.body_position)
    assert through_dlpack.ctypes.data == sim.state.body_position.ptr
    # JAX requires contiguous arrays.
    assert all(getattr(sim.state, one.name).is_contiguous for one in dataclasses.fields(sim.state))
