"""Parameters, resets and failures of a model split over devices equal those on one device."""

import signal
import threading
import warnings

import numpy as np
import pytest
from scenes import dropped_sphere, square
from split_models import ENVS, assert_same_recordings, assert_same_state, both, scene

import warpcontact as wc
from warpcontact.forces.mesh_contact import friction_warnings, step_warnings
from warpcontact.storage.parameters import DeviceField

# Parameters


def test_parameters_on_several_devices_equal_one_device(devices, device):
    one, other = (scene().build(ENVS, where) for where in (device, devices))
    assert list(one) == list(other)
    rng = np.random.default_rng(4)
    for number, name in enumerate(one):
        assert name in other
        assert one.find_parameter(name).limits == other.find_parameter(name).limits
        values = one[name]
        if name.endswith((".mass", ".stiffness", ".radius", "position", "velocity")):
            # Alternately one value for all environments and one for each.
            values = values + rng.uniform(0.001, 0.002, values.shape)
            values = values[0] if number % 2 and values.ndim == 1 else values
        one[name] = values
        other[name] = values
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
        assert one.varies(name) == other.varies(name)
    for model in (one, other):
        wc.Simulation(model, dt=1e-3, deterministic=True).step(100)
    assert_same_state(one, other)


def test_ambiguous_shape_is_resolved_by_total_number_of_environments(device):
    """One row per environment, or one per point of a set that has as many points as a part has environments."""
    points = 8
    one, other = (scene().build(2 * points, where) for where in (device, [device, device]))
    assert [part.envs for part in other.parts] == [points, points]
    rows = np.arange(3.0 * 2 * points).reshape(2 * points, 3) * 1e-3
    for model in (one, other):
        model["corners.position"] = rows
        model["hull.radius"] = np.linspace(0.01, 0.02, points)[None]
        with pytest.raises(ValueError, match=r"corners\.position must have shape"):
            model["corners.position"] = rows[:points]
    assert (other["corners.position"] == rows[:, None]).all()
    assert (other["hull.radius"] == np.linspace(0.01, 0.02, points)).all()
    for model in (one, other):
        wc.Simulation(model, dt=1e-3, deterministic=True).step(50)
    assert_same_state(one, other)
    with pytest.raises(ValueError, match="is ambiguous: one row for all environments, or one per"):
        scene().build(points, [device, device])["corners.position"] = rows[:points]


@pytest.mark.parametrize("name", ["box.mass", "ground.position", "hull.law.stiffness"])
def test_invalid_value_changes_nothing_on_any_part(name, devices, device):
    _, model = both(device, devices)
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(20)
    before = {name: model[name] for name in model}
    sensors = {name: model.sensor(name) for name in model.sensor_names}
    values = model[name] + 0.5
    values[-1] = 1e39
    with pytest.raises(ValueError, match="does not fit into float32"):
        model[name] = values
    values[-1] = np.nan
    with pytest.raises(ValueError, match="got nan"):
        model[name] = values
    for other, kept in before.items():
        np.testing.assert_array_equal(model[other], kept, err_msg=other)
    assert not model.varies(name) or name == "box.mass"
    for sensor, kept in sensors.items():
        np.testing.assert_array_equal(model.sensor(sensor), kept, err_msg=sensor)


def test_failed_upload_to_the_last_device_changes_nothing_on_any_part(device, monkeypatch):
    model = scene().build(6, [device] * 3)
    mass, energy = model["ball.mass"], model.sensor("ball.kinetic_energy")
    upload, left = DeviceField.upload, 2

    def failing(device_field, content, envs):
        nonlocal left
        left -= 1
        if left == -1:
            raise RuntimeError("Failed to allocate")
        return upload(device_field, content, envs)

    with monkeypatch.context() as patch:
        patch.setattr(DeviceField, "upload", failing)
        with pytest.raises(RuntimeError, match="Failed to allocate"):
            model["ball.mass"] = np.arange(1.0, 7.0)
    np.testing.assert_array_equal(model["ball.mass"], mass)
    np.testing.assert_array_equal(model.sensor("ball.kinetic_energy"), energy)
    assert not model.varies("ball.mass")


def test_unknown_names_and_invalid_masks_are_refused_on_several_devices(device):
    one, other = (scene().build(4, where) for where in (device, [device, device]))
    for wrong in (
        lambda model: model["ball.mas"],
        lambda model: model.__setitem__("ball.mas", 1.0),
        lambda model: model["touch.gap"],
        lambda model: model.sensor("touch.gab"),
        lambda model: model.__setitem__("ball.mass", [1.0, 2.0]),
        lambda model: model.reset([True, False]),
        lambda model: wc.Simulation(model, dt=1e-50),
    ):
        warnings_of = []
        for model in (one, other):
            with pytest.raises((KeyError, ValueError)) as caught:
                wrong(model)
            warnings_of.append((caught.type, str(caught.value)))
        assert warnings_of[0] == warnings_of[1]
    assert "ball.mas" not in other
    with pytest.raises(TypeError, match=r"model must come from Scene\.build"):
        wc.Simulation(scene(), dt=1e-3)


# Resets and failures


def test_masked_resets_reach_the_right_environments_on_several_devices(devices, device):
    one, other = both(device, devices)
    sims = [wc.Simulation(model, dt=1e-3, deterministic=True) for model in (one, other)]
    rng = np.random.default_rng(5)
    masks = [rng.random(ENVS) < 0.5, np.arange(ENVS) < 4, np.arange(ENVS) >= 4, np.zeros(ENVS, bool)]
    for mask in masks:
        for sim in sims:
            sim.step(50)
            sim.reset(mask)
        assert_same_state(one, other)
        assert one.time == other.time > 0
    # These resets are partial even if together they cover all environments. So the present state does not follow
    # the initial state.
    for model in (one, other):
        model["box.position"] = (0, 0, 1.0)
    assert_same_state(one, other)
    for sim in sims:
        sim.reset()
        assert sim.time == 0.0
        sim.model["ball.position"] = (0, 0, 2.0)
    assert (other.sensor("ball.position") == (0, 0, 2)).all()
    assert_same_state(one, other)


def test_diverged_environment_is_reported_with_its_global_number(devices, device):
    def made(where):
        scene = wc.Scene()
        ground = scene.add_surface(square(), name="ground")
        ball = scene.add_body(1.0, (1e-2, 1e-2, 1e-2), position=(0, 0, 0.09), name="ball")
        material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
        scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, material, radius=0.1, name="touch")
        model = scene.build(ENVS, where)
        stiffness = np.full(ENVS, 1e4)
        stiffness[[2, 5]] = 1e38
        model["touch.law.stiffness"] = stiffness
        return model

    recordings = []
    for where in (device, devices):
        model = made(where)
        with pytest.warns(RuntimeWarning, match=f"2 of {ENVS} environments turned non-finite .*: 2, 5"):
            recordings.append(wc.Simulation(model, dt=1e-3).run(0.05, ["ball.position"], every=1e-2))
        health = model.health()
        assert health.frozen.tolist() == [2, 5]
        assert health.envs == ENVS
        assert recordings[-1].attrs["frozen_environments"] == [2, 5]
    assert_same_recordings(*recordings)


@pytest.mark.parametrize("looked_at", [4096, 5])
def test_warnings_are_issued_once_with_global_environment_numbers(looked_at, device, monkeypatch):
    for module in (step_warnings, friction_warnings):
        monkeypatch.setattr(module, "MAX_CHECKED_ENVS", looked_at)

    def warnings_of(where):
        model = dropped_sphere(
            wc.laws.Hooke(stiffness=1e3), friction=wc.friction.Tanh(mu=0.3), envs=6, device=where
        )
        model["touch.law.stiffness"] = [1e3, 1e3, 1e3, 1e3, 1e9, 1e3]
        model["touch.friction.mu"] = [0.3, 0.3, 0.3, 0.3, 0.3, 30.0]
        model["scene.gravity"] = (0, 0, -10)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            sim = wc.Simulation(model, dt=1e-3)
            sim.step()
            sim.reset()
            sim.step()
        return [str(warning.message) for warning in caught]

    alone, split = warnings_of(device), warnings_of([device] * 3)
    assert alone == split
    assert any("in environment 4" in sentence for sentence in split)
    assert any("in environment 5" in sentence for sentence in split) == (looked_at > 5)
    assert len(set(split)) == len(split)


@pytest.mark.parametrize("crossing_substeps", [1, 4])
def test_interrupt_leaves_all_parts_at_one_time(crossing_substeps, devices, device):
    _, model = both(device, devices)
    sim = wc.Simulation(model, dt=1e-3, crossing_substeps=crossing_substeps)
    sim.step(64)
    timer = threading.Timer(1.0, signal.raise_signal, (signal.SIGINT,))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        sim.step(10**7)
    timer.join()
    assert sim.steps > 64
    for part in model.parts:
        assert part.time == sim.time
        np.testing.assert_allclose(part.arrays.time.numpy(), sim.time, rtol=1e-5)
