"""Models that do not fit into memory are rejected before allocation, with the number that would fit."""

import numpy as np
import pytest
from memory_scenes import MIB, ball_scene, set_available_memory
from scenes import dropped_sphere

import warpcontact as wc
from warpcontact.building.plan import plan_model
from warpcontact.storage import memory_estimate
from warpcontact.system import resources


def test_too_many_environments_are_refused_before_allocation(device, monkeypatch, counting_allocator):
    set_available_memory(monkeypatch, 400 * MIB)
    with pytest.raises(MemoryError) as caught:
        ball_scene().build(10_000_000, device)
    assert counting_allocator.used == 0
    message = str(caught.value)
    assert message.startswith("10000000 environments need ")
    assert "of which 340 MiB can be used (85% of the 400 MiB available)" in message
    most = caught.value.max_envs
    batches = -(-10_000_000 // most)
    assert f"at most {most} environments fit on {device}" in message
    assert f"run them in {batches} batches of {-(-10_000_000 // batches)}" in message
    assert caught.value.needed > caught.value.available == int(0.85 * 400 * MIB)
    # This number fits, and one more does not.
    draft = plan_model(ball_scene(), device)
    available = memory_estimate.available_memory_for(draft.memory(1))
    assert memory_estimate.shortage(draft.memory(most, capture_graphs=False), available) is None
    assert memory_estimate.shortage(draft.memory(most + 1, capture_graphs=False), available) is not None
    set_available_memory(monkeypatch, 100_000)
    with pytest.raises(MemoryError, match="not even one environment fits"):
        ball_scene().build(1, device)


def test_memory_error_names_the_device_with_too_little_memory(monkeypatch):
    def split(envs):
        """Memory for twice as many on the first device as on the second."""
        return memory_estimate.total(
            memory_estimate.MemoryEstimate(
                envs // 2, name, (memory_estimate.MemoryItem("state", name, size * envs // 2, size),)
            )
            for name, size in (("cuda:0", 2 * MIB), ("cuda:1", MIB))
        )

    available = {"cuda:0": 200 * MIB, "cuda:1": 20 * MIB}
    monkeypatch.setattr(resources, "_device", available.get)
    with pytest.raises(MemoryError) as caught:
        memory_estimate.require(split, 100)
    assert str(caught.value) == (
        "100 environments need 50 MiB of the memory of cuda:1, of which 17 MiB can be used (85% of the 20 MiB "
        "available); at most 34 environments fit on cuda:0, cuda:1: run them in 3 batches of 34"
    )
    memory_estimate.require(split, 34)


def test_split_model_is_refused_before_allocation(device, monkeypatch, counting_allocator):
    set_available_memory(monkeypatch, 400 * MIB)
    with pytest.raises(MemoryError, match=r"at most \d+ environments fit on \w+") as caught:
        ball_scene().build(10_000_000, [device] * 2)
    assert counting_allocator.used == 0
    draft = plan_model(ball_scene(), [device] * 2)
    available = memory_estimate.available_memory_for(draft.memory(1))
    most = caught.value.max_envs
    assert memory_estimate.shortage(draft.memory(most, capture_graphs=False), available) is None
    assert memory_estimate.shortage(draft.memory(most + 1, capture_graphs=False), available) is not None


def test_simulation_is_refused_before_allocation_of_step_buffers(monkeypatch):
    model = ball_scene().build(200_000, "cpu")
    set_available_memory(monkeypatch, 8 * MIB)
    message = r"to step them, 200000 environments need .* at most \d+ environments fit on cpu"
    with pytest.raises(MemoryError, match=message):
        wc.Simulation(model, dt=1e-4)


def test_nothing_is_refused_if_available_memory_is_unknown(device, monkeypatch):
    set_available_memory(monkeypatch, None)
    assert ball_scene().build(2, device).envs == 2
    draft = plan_model(ball_scene(), device)
    assert memory_estimate.available_memory_for(draft.memory(10**12)) == ()


def test_recording_is_refused_before_the_run_if_it_does_not_fit(device, monkeypatch):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), envs=100, device=device)
    sim = wc.Simulation(model, dt=1e-4)
    set_available_memory(monkeypatch, 64 * MIB)
    with pytest.raises(MemoryError) as caught:
        sim.run(10.0, ["touch.normal", "touch.gap"])
    message = str(caught.value)
    assert message.startswith("the recording of 100001 frames: 100 environments need ")
    assert "make every" in message
    assert "times as long, or record less" in message
    assert "ball.position 229 MiB" in message  # the largest array: in float64
    assert sim.steps == 0
    assert len(sim.run(0.01, ["touch.gap"], every=1e-3).time) == 11
    set_available_memory(monkeypatch, 1000)
    with pytest.raises(MemoryError, match="not even one frame fits"):
        sim.run(0.01, ["touch.gap"])
    with pytest.raises(MemoryError, match="100 environments need"):
        model.sensor("touch.point")


@pytest.mark.parametrize("parts", [1, 2])
def test_parameter_values_per_environment_are_refused_if_they_do_not_fit(parts, device, monkeypatch):
    model = ball_scene().build(1000, [device] * parts)
    mass = np.linspace(1, 2, 1000)
    set_available_memory(monkeypatch, 5000)  # the host stores 8 bytes of each
    message = r"^for a value of ball\.mass in each, 1000 environments need .*; at most \d+ environments fit on"
    with pytest.raises(MemoryError, match=message):
        model["ball.mass"] = mass
    assert not model.varies("ball.mass")
    assert (model["ball.mass"] == 0.5).all()
    model["ball.mass"] = 2.0
    assert (model["ball.mass"] == 2.0).all()
    set_available_memory(monkeypatch, 50_000)
    model["ball.mass"] = mass
    set_available_memory(monkeypatch, 5000)  # no further allocation
    model["ball.mass"] = 2.0 * mass
    assert (model["ball.mass"] == 2.0 * mass).all()


def test_sensor_arrays_of_all_parts_are_refused_together(device, monkeypatch):
    """Arrays that fit separately for each part may not fit for all."""
    model = ball_scene().build(100, [device] * 2)
    sim = wc.Simulation(model, dt=1e-4, capture_graphs=False)
    part = model.parts[0]
    needed = sum(need.size for need in part.sensor_memory(part.device, {"points"}, part.envs))
    set_available_memory(monkeypatch, int(1.5 * needed / 0.85))
    with pytest.raises(MemoryError, match=r"^to measure them, 100 environments need"):
        model.sensor("touch.point")
    with pytest.raises(MemoryError, match=r"^to measure them, 100 environments need"):
        sim.run(1e-3, ["touch.point"])
    assert [part.unallocated({"points"}) for part in model.parts] == [["points"]] * 2
    set_available_memory(monkeypatch, None)
    assert model.sensor("touch.point").shape == (100, 3)
