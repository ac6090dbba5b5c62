"""A model split over several devices is, in every result, the model that is not.

It is split over one device several times, and with ``--device cuda:0`` on a machine of several GPUs over them all.
"""

import json
import signal
import threading
import warnings

import numpy as np
import pytest
import warp as wp
from scenes import dropped_sphere, square

import warpcontact as wc
from warpcontact import advice, crew, friction_advice
from warpcontact.cli import main
from warpcontact.parameters import Upload

ENVS = 7
STICKY = wc.Template(
    law=wc.laws.HuntCrossley(stiffness=2e4, restitution=0.5),
    friction=wc.frictions.CundallStrack(mu_static=0.6, mu_dynamic=0.4, stiffness=1e3, damping=1.0),
)
SMOOTH = wc.Template(law=wc.laws.KelvinVoigt(stiffness=2e3, damping=4.0), friction=wc.frictions.Tanh(mu=0.5))


@pytest.fixture(params=["two", "three", "all GPUs"])
def devices(request, device):
    """What a model is split over."""
    if request.param != "all GPUs":
        return [device] * {"two": 2, "three": 3}[request.param]
    if not device.startswith("cuda") or wp.get_cuda_device_count() < 2:
        pytest.skip("asked for with --device cuda:0 on a machine of at least two GPUs")
    return "cuda"


def scene():
    """A box of points that remembers where it stuck, and a small fast sphere, on a terrain."""
    made = wc.Scene()
    ground = made.add_surface(wc.meshes.sinusoidal_terrain((4, 4), (20, 20), amplitude=0.1), name="ground")
    box = made.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 0.35), name="box")
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    made.add_contact(made.add_points(box, 0.1 * corners, name="corners"), ground, STICKY, radius=0.01, name="hull")
    ball = made.add_body(0.2, (1e-3, 1e-3, 1e-3), position=(0.5, 0, 0.6), linear_velocity=(0, 0, -40), name="ball")
    made.add_contact(
        made.add_point(ball, (0, 0, 0), name="centre"), ground, SMOOTH, radius=0.02, swept=True, name="touch"
    )
    return made


def varied(model):
    """Gives every environment its own start and parameters."""
    spread = np.linspace(0.0, 1.0, model.envs)
    still = 0.0 * spread
    model["box.mass"] = 0.5 + spread
    model["hull.law.restitution"] = 0.2 + 0.6 * spread
    model["touch.radius"] = 0.02 + 0.03 * spread
    model["touch.friction.mu"] = 0.7
    model["box.position"] = np.stack([spread - 0.5, 0.3 - spread, 0.22 + 0.1 * spread], axis=1)
    model["box.linear_velocity"] = (0.5, 0, -2)
    model["ball.linear_velocity"] = np.stack([spread, still, -40.0 * spread], axis=1)
    return model


def both(device, devices, envs=ENVS, precision="float32"):
    """Returns the model, and the same split over ``devices``."""
    return tuple(varied(scene().build(envs, where, precision)) for where in (device, devices))


def assert_same_recordings(one, other):
    assert list(one.variables) == list(other.variables)
    for name in one.variables:
        assert one[name].dims == other[name].dims
        assert one[name].attrs == other[name].attrs
        np.testing.assert_array_equal(one[name].values, other[name].values, err_msg=name)
    assert {**one.attrs, "device": ""} == {**other.attrs, "device": ""}


def assert_same_state(one, other):
    for name in one.reading_names:
        np.testing.assert_array_equal(one.reading(name), other.reading(name), err_msg=name)


# What is where


def test_environments_are_side_by_side_and_spread_evenly(device):
    model = scene().build(11, [device] * 4)
    assert isinstance(model, wc.SplitModel)
    assert [part.envs for part in model.parts] == [3, 3, 3, 2]
    assert [(own.start, own.stop) for _, own in model.shares()] == [(0, 3), (3, 6), (6, 9), (9, 11)]
    assert all(isinstance(part, wc.Model) for part in model.parts)
    assert [str(where) for where in model.devices] == [device] * 4
    assert repr(model) == (
        f"<SplitModel of 11 environments: 2 bodies, 9 contacts, float32 on {', '.join([device] * 4)}>"
    )


def test_no_device_is_left_without_an_environment(device):
    assert len(scene().build(2, [device] * 4).parts) == 2
    alone = scene().build(1, [device] * 4)
    assert isinstance(alone, wc.Model)
    assert alone.parts == (alone,)
    assert isinstance(scene().build(3, [device]), wc.Model)


def test_all_gpus_are_those_that_cuda_shows(device):
    count = wp.get_cuda_device_count()
    if not count:
        pytest.skip("there is no GPU")
    model = scene().build(2 * count, "cuda")
    assert [str(where) for where in model.devices] == [f"cuda:{number}" for number in range(count)]


def test_parts_share_their_state_without_a_copy(devices, device):
    _, model = both(device, devices)
    wc.Simulation(model, dt=1e-3).step(5)
    gathered = np.concatenate([part.state.body_position.numpy() for part in model.parts])
    np.testing.assert_array_equal(gathered[:, 0], model.reading("box.position").astype(np.float32))
    last = model.parts[-1]
    moved = last.state.body_position.numpy().copy()
    moved[-1, 1] = (0, 0, 9)
    last.state.body_position.assign(moved)
    # What rounding left of the last position is still added.
    np.testing.assert_allclose(model.reading("ball.position")[-1], (0, 0, 9), atol=1e-6)


def test_environments_of_a_batch_are_numbered_through(device):
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


def test_what_only_a_part_has_is_refused_with_where_it_is(device):
    model = scene().build(4, [device, device])
    with pytest.raises(AttributeError, match=r"has no one state: take model\.parts\[0\]\.state"):
        _ = model.state
    with pytest.raises(AttributeError, match=r"has no one state: take model\.parts\[0\]\.state"):
        _ = wc.Simulation(model, dt=1e-3).state
    with pytest.raises(AttributeError, match=r"has no one device: take model\.devices"):
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
def test_devices_that_are_not_there_are_refused_with_those_that_are(wrong, message):
    with pytest.raises(ValueError, match=message):
        scene().build(4, wrong)


def test_all_gpus_of_a_machine_without_one_are_refused():
    if wp.is_cuda_available():
        pytest.skip("there is a GPU")
    with pytest.raises(ValueError, match=r"one of cpu on this machine, which has no GPU, .* got 'cuda'"):
        scene().build(4, "cuda")


def test_what_is_measured_on_one_device_refuses_several(device):
    with pytest.raises(ValueError, match=f"device must be a single one, got .*, which is {device}, {device}"):
        wc.bench([device, device])


# Results


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"crossing_steps": 4},
        {"graphs": False},
        {"distance_cache": False, "threads": 1},
        {"threads": 3, "integrator": wc.integrators.SemiImplicitEuler()},
    ],
    ids=lambda options: " ".join(options) or "as it comes",
)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_recordings_are_the_same_bits(options, precision, devices, device, monkeypatch):
    monkeypatch.setattr(crew, "ALONE", 0)
    recordings = []
    for model in both(device, devices, precision=precision):
        sim = wc.Simulation(model, dt=1e-3, deterministic=True, **options)
        recordings.append(sim.run(0.15, model.reading_names, every=5e-3))
        assert sim.steps == 150
    assert (recordings[0]["touch.crossings"] > 0).any()
    assert (recordings[0]["hull.normal_force"] > 0).any()
    assert_same_recordings(*recordings)


def test_frames_are_drained_from_a_small_ring_of_each_part(devices, device, monkeypatch):
    models = both(device, devices)
    large = wc.Simulation(models[0], dt=1e-3, deterministic=True).run(0.05, ["ball.position", "hull.gap"])
    monkeypatch.setattr("warpcontact.recorder.RING_BYTES", 500)
    small = wc.Simulation(models[1], dt=1e-3, deterministic=True).run(0.05, ["ball.position", "hull.gap"])
    assert_same_recordings(large, small)


def test_what_sets_environments_apart_is_recorded_with_one_on_each_device(device):
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


def test_readings_between_steps_and_evaluations_are_the_same(devices, device):
    one, other = both(device, devices)
    assert one.reading_names == other.reading_names
    assert one.find_reading("touch.gap").unit == other.find_reading("touch.gap").unit
    sims = [wc.Simulation(model, dt=1e-3, deterministic=True) for model in (one, other)]
    for count in (0, 1, 40, 33):
        for sim in sims:
            sim.step(count)
        assert_same_state(one, other)
    for model in (one, other):
        model.evaluate()
    assert one.time == other.time == sims[1].time
    assert [part.time for part in other.parts] == [one.time] * len(other.parts)


# Parameters


def test_parameters_are_the_same_shared_and_per_environment(devices, device):
    one, other = (scene().build(ENVS, where) for where in (device, devices))
    assert list(one) == list(other)
    rng = np.random.default_rng(4)
    for number, name in enumerate(one):
        assert name in other
        assert one.find_parameter(name).limits == other.find_parameter(name).limits
        values = one[name]
        if name.endswith((".mass", ".stiffness", ".radius", "position", "velocity")):
            # In turn one value for all and one for each environment.
            values = values + rng.uniform(0.001, 0.002, values.shape)
            values = values[0] if number % 2 and values.ndim == 1 else values
        one[name] = values
        other[name] = values
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)
        assert one.varies(name) == other.varies(name)
    for model in (one, other):
        wc.Simulation(model, dt=1e-3, deterministic=True).step(100)
    assert_same_state(one, other)


def test_a_shape_that_may_mean_two_things_is_judged_by_all_environments(device):
    """One row for each environment, or one for each point of a set, of as many as a part has environments."""
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
    with pytest.raises(ValueError, match="may be meant for all environments or one row for each"):
        scene().build(points, [device, device])["corners.position"] = rows[:points]


@pytest.mark.parametrize("name", ["box.mass", "ground.position", "hull.law.stiffness"])
def test_a_value_that_does_not_fit_changes_nothing_on_any_part(name, devices, device):
    _, model = both(device, devices)
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(20)
    before = {name: model[name] for name in model}
    readings = {name: model.reading(name) for name in model.reading_names}
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
    for reading, kept in readings.items():
        np.testing.assert_array_equal(model.reading(reading), kept, err_msg=reading)


def test_a_failure_on_the_way_to_the_last_device_changes_nothing_on_any(device, monkeypatch):
    model = scene().build(6, [device] * 3)
    mass, energy = model["ball.mass"], model.reading("ball.kinetic_energy")
    send, left = Upload.send, 2

    def failing(upload, content, envs):
        nonlocal left
        left -= 1
        if left == -1:
            raise RuntimeError("Failed to allocate")
        return send(upload, content, envs)

    with monkeypatch.context() as patch:
        patch.setattr(Upload, "send", failing)
        with pytest.raises(RuntimeError, match="Failed to allocate"):
            model["ball.mass"] = np.arange(1.0, 7.0)
    np.testing.assert_array_equal(model["ball.mass"], mass)
    np.testing.assert_array_equal(model.reading("ball.kinetic_energy"), energy)
    assert not model.varies("ball.mass")


def test_unknown_names_and_wrong_masks_are_refused_as_always(device):
    one, other = (scene().build(4, where) for where in (device, [device, device]))
    for wrong in (
        lambda model: model["ball.mas"],
        lambda model: model.__setitem__("ball.mas", 1.0),
        lambda model: model["touch.gap"],
        lambda model: model.reading("touch.gab"),
        lambda model: model.__setitem__("ball.mass", [1.0, 2.0]),
        lambda model: model.reset([True, False]),
        lambda model: wc.Simulation(model, dt=1e-50),
    ):
        said = []
        for model in (one, other):
            with pytest.raises((KeyError, ValueError)) as caught:
                wrong(model)
            said.append((caught.type, str(caught.value)))
        assert said[0] == said[1]
    assert "ball.mas" not in other
    with pytest.raises(TypeError, match=r"model must come from Scene\.build"):
        wc.Simulation(scene(), dt=1e-3)


# Resets and failures


def test_resets_by_mask_reach_the_right_environments(devices, device):
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
    # However they add up, these were no complete resets: the present state does not follow the initial one.
    for model in (one, other):
        model["box.position"] = (0, 0, 1.0)
    assert_same_state(one, other)
    for sim in sims:
        sim.reset()
        assert sim.time == 0.0
        sim.model["ball.position"] = (0, 0, 2.0)
    assert (other.reading("ball.position") == (0, 0, 2)).all()
    assert_same_state(one, other)


def test_an_environment_that_diverges_is_reported_by_its_number_in_all(devices, device):
    def made(where):
        scene = wc.Scene()
        ground = scene.add_surface(square(), name="ground")
        ball = scene.add_body(1.0, (1e-2, 1e-2, 1e-2), position=(0, 0, 0.09), name="ball")
        template = wc.Template(law=wc.laws.Hooke(stiffness=1e4))
        scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, template, radius=0.1, name="touch")
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
def test_warnings_come_once_and_number_environments_in_all(looked_at, device, monkeypatch):
    for module in (advice, friction_advice):
        monkeypatch.setattr(module, "LOOKED_AT", looked_at)

    def said(where):
        model = dropped_sphere(
            wc.laws.Hooke(stiffness=1e3), friction=wc.frictions.Tanh(mu=0.3), envs=6, device=where
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

    alone, split = said(device), said([device] * 3)
    assert alone == split
    assert any("in environment 4" in sentence for sentence in split)
    assert any("in environment 5" in sentence for sentence in split) == (looked_at > 5)
    assert len(set(split)) == len(split)


@pytest.mark.parametrize("crossing_steps", [1, 4])
def test_an_interruption_leaves_all_parts_at_one_time(crossing_steps, devices, device):
    _, model = both(device, devices)
    sim = wc.Simulation(model, dt=1e-3, crossing_steps=crossing_steps)
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


# Who waits for whom


class Listed:
    """A device by name, which cannot be a key, like those of Warp."""

    __hash__ = None

    def __init__(self, name):
        self.name, self.is_cuda, self.is_cpu = name, name != "cpu", name == "cpu"

    def __str__(self):
        return self.name


class Piece:
    """Stands for a slice, and writes down who steps it."""

    envs = 10**6

    def __init__(self, name, captured, log, meeting=None):
        self.device, self.captured, self.log, self.meeting = Listed(name), captured, log, meeting

    def capture(self, count):
        pass

    def step(self, count):
        if self.meeting is not None:
            self.meeting.wait(timeout=10.0)  # a BrokenBarrierError if the others are not stepped meanwhile
        self.log.append((str(self.device), threading.current_thread() is threading.main_thread()))


def test_gpus_that_the_host_decides_about_do_not_wait_for_each_other():
    log, meeting = [], threading.Barrier(3)
    pieces = [Piece(name, False, log, meeting) for name in ("cuda:0", "cuda:1", "cpu")]
    assert list(crew.Crew(pieces, 1).step(8)) == [8]
    assert sorted(name for name, _ in log) == ["cpu", "cuda:0", "cuda:1"]


def test_of_one_gpu_only_one_slice_is_launched_at_a_time():
    log = []
    pieces = [Piece(name, False, log) for name in ("cuda:0", "cuda:1", "cuda:0")]
    made = crew.Crew(pieces, 8)
    list(made.step(8))
    assert made._threads == 2
    assert sorted(name for name, _ in log) == ["cuda:0", "cuda:0", "cuda:1"]


def test_graphs_are_given_to_gpus_in_turn_before_the_cpu_begins():
    log = []
    pieces = [Piece(name, True, log) for name in ("cpu", "cuda:0", "cpu", "cuda:1")]
    list(crew.Crew(pieces, 2).step(32))
    assert log[:2] == [("cuda:0", True), ("cuda:1", True)]
    assert [name for name, _ in log[2:]] == ["cpu", "cpu"]
    assert not any(alone for _, alone in log[2:])


# Experiments and the command line

STUDY = """
duration = 0.05
dt = 1e-3
envs = 5
surface = [{ name = "ground", mesh = { shape = "grid", size = [2, 2] } }]
body = [{ name = "ball", mass = 1, inertia = [4e-3, 4e-3, 4e-3], position = [0, 0, 0.11] }]
point = [{ name = "centre", body = "ball", position = [0, 0, 0] }]
template = [{ name = "rubber", law = { type = "Hooke", stiffness = 1e4 } }]
contact = [{ name = "touch", points = "centre", surface = "ground", template = "rubber", radius = 0.1 }]
[variation]
"ball.mass" = { uniform = [0.5, 2] }
"""


def test_an_experiment_is_the_same_on_several_devices(devices, device, tmp_path):
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


def test_the_command_line_takes_several_devices(device, tmp_path, capsys):
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    assert main(["run", str(path), "--out", str(tmp_path / "out"), "--device", f"{device},{device}"]) == 0
    assert f"compiling for {device}, {device}" in capsys.readouterr().err
    assert main(["plan", str(path), "--device", f"{device},{device}", "--shard", "2"]) == 0
    assert "shards of 2, one after another" in capsys.readouterr().out
    assert main(["run", str(path), "--out", str(tmp_path / "none"), "--device", "cpu,cuda:99"]) == 2
    assert "--device cpu,cuda:99: device[1] must be one of cpu" in capsys.readouterr().err
