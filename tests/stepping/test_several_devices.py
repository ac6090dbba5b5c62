"""A model split over several devices gives the results of the same model on one device.

The same device is used several times, or all GPUs of the machine with ``--device cuda:0``.
"""

import json

import numpy as np
import pytest
import warp as wp
from split_models import assert_same_recordings, assert_same_state, both, scene

import warpcontact as wc
from warpcontact.cli import main
from warpcontact.stepping import worker_pool

# Distribution of environments


def test_environments_are_split_evenly_and_contiguously(device):
    model = scene().build(11, [device] * 4)
    assert isinstance(model, wc.SplitModel)
    assert [part.envs for part in model.parts] == [3, 3, 3, 2]
    assert [(own.start, own.stop) for _, own in model.shares()] == [(0, 3), (3, 6), (6, 9), (9, 11)]
    assert all(isinstance(part, wc.Model) for part in model.parts)
    assert [str(where) for where in model.devices] == [device] * 4
    assert repr(model) == (
        f"<SplitModel of 11 environments: 2 bodies, 9 contacts, float32 on {', '.join([device] * 4)}>"
    )


def test_every_device_has_at_least_one_environment(device):
    assert len(scene().build(2, [device] * 4).parts) == 2
    alone = scene().build(1, [device] * 4)
    assert isinstance(alone, wc.Model)
    assert alone.parts == (alone,)
    assert isinstance(scene().build(3, [device]), wc.Model)


def test_cuda_device_means_all_visible_gpus(device):
    count = wp.get_cuda_device_count()
    if not count:
        pytest.skip("there is no GPU")
    model = scene().build(2 * count, "cuda")
    assert [str(where) for where in model.devices] == [f"cuda:{number}" for number in range(count)]


def test_parts_share_their_state_without_copy(devices, device):
    _, model = both(device, devices)
    wc.Simulation(model, dt=1e-3).step(5)
    gathered = np.concatenate([part.state.body_position.numpy() for part in model.parts])
    np.testing.assert_array_equal(gathered[:, 0], model.sensor("box.position").astype(np.float32))
    last = model.parts[-1]
    moved = last.state.body_position.numpy().copy()
    moved[-1, 1] = (0, 0, 9)
    last.state.body_position.assign(moved)
    # The sensor adds the rounding remainder of the last position.
    np.testing.assert_allclose(model.sensor("ball.position")[-1], (0, 0, 9), atol=1e-6)


def test_environments_of_a_batch_are_numbered_consecutively(device):
    model = scene().build(7, [device] * 3)
    assert [part.first_env for part in model.parts] == [0, 3, 5]
    model.first_env = 100
    assert [(part.first_env, own) for part, own in model.shares()] == [
        (100, slice(0, 3)),
        (103, slice(3, 5)),
        (105, slice(5, 7)),
    ]
    recording = wc.Simulation(model, dt=1e-3).run(1e-3)
    assert recording["env"].values.tolist() == list(range(100, 107))


def test_attributes_of_a_single_part_are_refused_with_a_remedy(device):
    model = scene().build(4, [device, device])
    with pytest.raises(AttributeError, match=r"has no single state: use model\.parts\[0\]\.state"):
        _ = model.state
    with pytest.raises(AttributeError, match=r"has no single state: use model\.parts\[0\]\.state"):
        _ = wc.Simulation(model, dt=1e-3).state
    with pytest.raises(AttributeError, match=r"has no single device: use model\.devices"):
        _ = model.device
    assert not hasattr(model, "state")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("cuda:99", "device must be 'auto' or one of cpu.*, got 'cuda:99'"),
        ("gpu", "device must be 'auto' or one of cpu.*, or a list of devices, got 'gpu'"),
        (None, "device must be 'auto' or one of cpu.*, got None"),
        ([], r"device must list at least one of cpu.*, got \[\]"),
        (["cpu", "cuda"], r"device\[1\] must be one of cpu.*, got 'cuda'"),
        (["auto"], r"device\[0\] must be one of cpu.*, got 'auto'"),
    ],
)
def test_missing_devices_are_refused_with_available_ones(wrong, message):
    with pytest.raises(ValueError, match=message):
        scene().build(4, wrong)


def test_cuda_device_is_refused_without_a_gpu():
    if wp.is_cuda_available():
        pytest.skip("there is a GPU")
    with pytest.raises(ValueError, match=r"one of cpu on this machine, which has no GPU, .* got 'cuda'"):
        scene().build(4, "cuda")


def test_bench_refuses_several_devices(device):
    with pytest.raises(ValueError, match=f"device must be a single one, got .*, which is {device}, {device}"):
        wc.bench([device, device])


# Results


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"crossing_substeps": 4},
        {"capture_graphs": False},
        {"distance_cache": False, "threads": 1},
        {"threads": 3, "integrator": wc.integrators.SemiImplicitEuler()},
    ],
    ids=lambda options: " ".join(options) or "default",
)
@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
def test_recordings_on_several_devices_are_bitwise_identical(options, precision, devices, device, monkeypatch):
    monkeypatch.setattr(worker_pool, "SERIAL_SECONDS", 0.0)
    recordings = []
    for model in both(device, devices, precision=precision):
        sim = wc.Simulation(model, dt=1e-3, deterministic=True, **options)
        recordings.append(sim.run(0.15, model.sensor_names, every=5e-3))
        assert sim.steps == 150
    assert (recordings[0]["touch.crossings"] > 0).any()
    assert (recordings[0]["hull.normal_force"] > 0).any()
    assert_same_recordings(*recordings)


def test_frames_are_drained_from_a_small_ring_buffer_of_each_part(devices, device, monkeypatch):
    models = both(device, devices)
    large = wc.Simulation(models[0], dt=1e-3, deterministic=True).run(0.05, ["ball.position", "hull.gap"])
    monkeypatch.setattr("warpcontact.stepping.frame_buffers.RING_BYTES", 500)
    small = wc.Simulation(models[1], dt=1e-3, deterministic=True).run(0.05, ["ball.position", "hull.gap"])
    assert_same_recordings(large, small)


def test_varied_parameters_are_recorded_with_one_environment_per_device(device):
    recordings = []
    for where in (device, [device, device]):
        model = scene().build(2, where)
        model["touch.friction.mu"] = [0.1, 0.2]
        model["hull.law.stiffness"] = [3e4, 3e4]
        recordings.append(wc.Simulation(model, dt=1e-3).run(2e-3))
    assert "touch.friction.mu" in recordings[1]
    assert "hull.law.stiffness" in recordings[1]
    assert "hull.friction.stiffness" not in recordings[1]
    assert_same_recordings(*recordings)


def test_sensors_and_evaluations_on_several_devices_equal_one_device(devices, device):
    one, other = both(device, devices)
    assert one.sensor_names == other.sensor_names
    assert one.find_sensor("touch.gap").unit == other.find_sensor("touch.gap").unit
    sims = [wc.Simulation(model, dt=1e-3, deterministic=True) for model in (one, other)]
    for count in (0, 1, 40, 33):
        for sim in sims:
            sim.step(count)
        assert_same_state(one, other)
    for model in (one, other):
        model.evaluate()
    assert one.time == other.time == sims[1].time
    assert [part.time for part in other.parts] == [one.time] * len(other.parts)


# Experiments and the command line

STUDY = """
duration = 0.05
dt = 1e-3
envs = 5
surface = [{ name = "ground", mesh = { shape = "grid", size = [2, 2] } }]
body = [{ name = "ball", mass = 1, inertia = [4e-3, 4e-3, 4e-3], position = [0, 0, 0.11] }]
point = [{ name = "centre", body = "ball", position = [0, 0, 0] }]
material = [{ name = "rubber", law = { type = "Hooke", stiffness = 1e4 } }]
contact = [{ name = "touch", points = "centre", surface = "ground", material = "rubber", radius = 0.1 }]
[variation]
"ball.mass" = { uniform = [0.5, 2] }
"""


def test_experiment_on_several_devices_equals_one_device(devices, device, tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    experiment = wc.Experiment.from_toml(path)
    model = experiment.model(device=devices)
    np.testing.assert_array_equal(model["ball.mass"], experiment.model(device=device)["ball.mass"])
    alone = experiment.run(tmp_path / "alone", device=device)
    split = experiment.run(tmp_path / "split", device=devices)
    alone.recording.attrs["device"] = split.recording.attrs["device"]
    assert_same_recordings(alone.recording, split.recording)
    names = json.loads((tmp_path / "split/run.json").read_text())["device"].split(", ")
    assert [name.partition(" ")[0] for name in names] == [str(where) for where in model.devices]
    assert (tmp_path / "split/animation.usdc").exists()


def test_command_line_accepts_several_devices(device, tmp_path, capsys):
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--device", f"{device},{device}"]) == 0
    assert f"compiling for {device}, {device}" in capsys.readouterr().err
    assert main(["plan", str(path), "--device", f"{device},{device}", "--shard", "2"]) == 0
    assert "shards of 2, one after another" in capsys.readouterr().out
    assert main(["run", str(path), "--out", str(tmp_path / "none"), "--device", "cpu,cuda:99"]) == 2
    assert "--device cpu,cuda:99: device[1] must be one of cpu" in capsys.readouterr().err
