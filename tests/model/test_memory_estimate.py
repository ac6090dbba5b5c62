"""Memory estimates of models: available before allocation, and equal to the allocated bytes."""

import gc
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from case_marks import slow_except
from memory_scenes import MIB, SCENES, array_bytes, ball_scene, mixed_scene, set_available_memory
from scenes import dropped_sphere

import warpcontact as wc
from warpcontact.building.plan import plan_model
from warpcontact.cli import main
from warpcontact.storage import memory_estimate as footprint
from warpcontact.system.resources import HOST

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "terrain_drop.toml"


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", slow_except(SCENES, lambda name: name in ("mixed", "particles")))
def test_memory_estimate_equals_allocated_arrays(name, precision, device, counting_allocator):
    scene = SCENES[name]()
    envs = 13
    draft = plan_model(scene, device, precision)
    assert counting_allocator.used == 0  # no allocation before the check
    planned = draft.memory(envs)
    del draft
    gc.collect()
    counting_allocator.used = 0
    model = scene.build(envs, device, precision)
    sim = wc.Simulation(model, dt=1e-4, capture_graphs=False)
    gc.collect()
    assert array_bytes(model.memory(), model) == counting_allocator.used
    assert planned.items == model.memory().items
    # Parameters per environment and sensors are added.
    mass = np.linspace(1, 2, envs)
    model["ball.mass"] = mass
    model["ball.position"] = np.zeros((envs, 3))
    varied, needs = ["ball.mass", "ball.position"], {"energies"}
    if name != "no contacts":
        model["touch.law.stiffness"] = 1e5 * mass
        model["ground.scale"] = mass
        model["centre.position"] = 0.01 * np.ones((envs, 3))
        varied += ["touch.law.stiffness", "ground.scale", "centre.position"]
        model.sensor("touch.point")
        needs.add("points")
    if name == "couplings":
        model["spring.rest_length"] = mass
        model["body_1.motion.amplitude"] = mass
        varied += ["spring.rest_length", "body_1.motion.amplitude"]
        for sensor in ("body_0.reaction_force", "body_2.displacement", "keep.force"):
            model.sensor(sensor)
        needs |= {"reactions", "coordinates", "contact_couplings"}
    if name == "shape contacts":
        model["egg.semi_axes"] = np.linspace(0.1, 0.3, 3 * envs).reshape(envs, 3)
        model["lie.law.modulus"] = 1e8 * mass[:, None] * np.ones(3)
        varied += ["egg.semi_axes", "lie.law.modulus"]
        for sensor in ("lie.point", "stand.curvature_1", "rest.gap_by_position_a"):
            model.sensor(sensor)
        needs |= {"shape_points", "shape_curvatures", "shape_gradients"}
    model.sensor("scene.kinetic_energy")
    gc.collect()
    assert array_bytes(sim.memory(), model) == counting_allocator.used
    planned = plan_model(scene, device, precision).memory(envs, varied)
    actual = model.memory()
    assert planned.bytes_for("parameters") == actual.bytes_for("parameters")
    measured = model.sensor_memory(model.device, needs, envs)
    assert actual.bytes_for("measures") == sum(need.size for need in measured)


def test_memory_estimate_of_split_model_is_the_sum_of_its_parts(device, counting_allocator):
    scene, envs, where = mixed_scene(), 14, [device] * 3
    planned = plan_model(scene, where).memory(envs)
    gc.collect()
    counting_allocator.used = 0
    model = scene.build(envs, where)
    sim = wc.Simulation(model, dt=1e-4, capture_graphs=False)
    gc.collect()
    memory = sim.memory()
    assert array_bytes(memory, model) == counting_allocator.used
    assert planned.items == model.memory().items
    assert (memory.envs, memory.device) == (envs, device)
    for purpose in ("state", "contacts", "cache", "surfaces", "parameters", "stepping"):
        assert memory.bytes_for(purpose) == sum(part.memory().bytes_for(purpose) for part in model.parts)
    # One more environment is on one of the devices; fixed arrays of each device count three times.
    one = wc.Simulation(scene.build(envs, device), dt=1e-4, capture_graphs=False)
    assert memory.bytes_for("surfaces") == 3 * one.memory().bytes_for("surfaces")
    whole, alone = model.memory_estimate(), one.model.memory_estimate()
    assert whole.bytes_per_env == pytest.approx(alone.bytes_per_env)
    assert whole.fixed_bytes == pytest.approx(3 * alone.fixed_bytes)
    model["ball.mass"] = np.linspace(1, 2, envs)
    gc.collect()
    assert plan_model(scene, where).memory(envs, ["ball.mass"]).bytes_for(
        "parameters"
    ) == model.memory().bytes_for("parameters")


def test_memory_estimate_counts_launches_of_each_thread_and_part():
    """Each thread has launches for each part, for any number of environments."""
    one, two = (plan_model(ball_scene(), where).memory(1000, threads=2) for where in ("cpu", ["cpu", "cpu"]))
    assert two.bytes_for("launches") == 2 * one.bytes_for("launches")
    assert plan_model(ball_scene(), "cpu").memory(100_000, threads=2).bytes_for("launches") == one.bytes_for(
        "launches"
    )
    assert (
        plan_model(ball_scene(), "cpu").memory(1, threads=2).bytes_for("launches")
        == one.bytes_for("launches") // 2
    )


def test_memory_per_environment_matches_estimate(device):
    draft = plan_model(mixed_scene(), device)
    one, other = draft.memory(256 * 1000, ["ball.mass"]), draft.memory(256 * 1001, ["ball.mass"])
    added = other.device_bytes + other.host_bytes - one.device_bytes - one.host_bytes
    assert added == pytest.approx(256 * one.bytes_per_env, rel=0.02)


def test_memory_estimate_lists_purposes_and_devices(device):
    model = ball_scene().build(16384, device)
    memory = model.memory()
    text = str(memory)
    for purpose in ("state", "contacts", "cache", "surfaces", "parameters", "stepping", "launches"):
        assert memory.bytes_for(purpose) > 0
        assert f"  {purpose}" in text
    assert text.startswith("16384 environments on ")
    assert "MiB" in repr(memory)
    assert memory.bytes_for("surfaces") <= memory.fixed_bytes < memory.bytes_per_env * 16384
    assert " fixed" in text
    if model.device.is_cpu:
        assert memory.device_bytes == 0  # the only memory is that of the host
        assert memory.locations == (HOST,)
        assert "host memory: " in text
    else:
        assert memory.locations == (str(model.device), HOST)
        assert memory.device_bytes > memory.bytes_for("state")


def test_memory_estimates_of_parts_are_summed_by_device():
    first = footprint.MemoryEstimate(
        3, "cuda:0", (footprint.MemoryItem("state", "cuda:0", 30, 10.0), footprint.MemoryItem("launches", HOST, 5))
    )
    second = footprint.MemoryEstimate(2, "cuda:1", (footprint.MemoryItem("state", "cuda:1", 20, 10.0),))
    both = first + second
    assert (both.envs, both.device) == (5, "cuda:0, cuda:1")
    assert [both.bytes_at(place) for place in both.locations] == [30, 20, 5]
    assert both.locations == ("cuda:0", "cuda:1", HOST)
    assert (both.device_bytes, both.host_bytes, both.bytes_for("state")) == (50, 5, 50)


@pytest.mark.parametrize(
    ("size", "text"),
    [(0, "0 B"), (1023, "1023 B"), (1024, "1 KiB"), (1.5 * 2**30, "1.5 GiB"), (1020 * MIB, "1020 MiB")],
)
def test_bytes_are_formatted_with_units(size, text):
    assert footprint.format_bytes(size) == text


def test_memory_estimate_without_capture_includes_no_graphs(device):
    draft = plan_model(mixed_scene(), device)
    assert draft.memory(9, crossing_substeps=4).bytes_for("launches") < draft.memory(9).bytes_for("launches")
    model = mixed_scene().build(9, device)
    sim = wc.Simulation(model, dt=1e-4, crossing_substeps=4)
    assert sim.memory().bytes_for("launches") == draft.memory(9, crossing_substeps=4).bytes_for("launches")


def test_memory_estimate_of_a_recording_equals_its_arrays(device):
    from warpcontact.stepping.recorder import Recorder

    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), envs=7, device=device)
    model["ball.mass"] = np.linspace(1, 2, 7)
    names = list(model.sensor_names)
    recorder = Recorder(model, names, 5, poses=True)
    size = recorder.size()
    recorder.start()
    for frame in range(5):
        recorder.take(float(frame))
    rings = sum(ring.memory.capacity for channel in recorder.channels for ring in channel.rings.values())
    recording = recorder.finish({})
    stored = sum(variable.nbytes for variable in recording.data_vars.values())
    assert size.on_host(7, 5) == stored
    needs = size.memory_items(device, 7, 5)
    assert sum(need.size for need in needs if need.purpose == "buffers") == rings
    assert sum(need.size for need in needs if need.purpose == "recording") == stored


def test_plan_command_prints_estimate_and_runs_nothing(device, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["plan", str(EXAMPLE), "--device", device]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert out.startswith("1024 environments on ")
    for part in ("state", "recording", "available: ", "on disk: up to ", "1024 environments: one shard"):
        assert part in out
    assert main([*words, "--shard", "100", "--duration", "1"]) == 0
    assert "shards of" in capsys.readouterr().out
    set_available_memory(monkeypatch, 120 * MIB)
    assert main([*words, "--envs", "100000"]) == 0
    assert "one after another" in capsys.readouterr().out
    assert main([*words, "--envs", "100000", "--shard", "100000"]) == 1
    out = capsys.readouterr().out
    assert "shard 100000: 100000 environments need" in out
    assert "at most " in out
    set_available_memory(monkeypatch, MIB)
    assert main(words) == 1
    assert "not even one environment" in capsys.readouterr().out
    assert main(["run", str(EXAMPLE), "--device", device]) == 2
    assert "not even one environment fits" in capsys.readouterr().err
    set_available_memory(monkeypatch, 10 * MIB)  # enough to evaluate the scene, not to record
    assert main([*words, "--duration", "3000"]) == 1
    assert "does not fit: not even one environment" in capsys.readouterr().out
    assert main(["run", *words[1:], "--duration", "3000"]) == 2
    assert "not even one environment fits" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert main([*words, "--shard", "0"]) == 2
    assert "--shard 0: shard must be a whole number of at least 1, got 0" in capsys.readouterr().err


# Sensors with all kinds of requirements of one point on a mesh.
RECORDED = ("scene.kinetic_energy", "scene.linear_momentum", "touch.gap", "touch.normal_force", "touch.point")

GROWTH = """
import ctypes, gc, sys
import numpy as np
import warp as wp
wp.config.log_level = wp.LOG_ERROR
import warpcontact as wc
from warpcontact.stepping.recorder import Recorder

kind, envs, steps, device = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
names = sys.argv[5:]

def used():
    gc.collect()
    if device != "cpu":
        wp.synchronize_device(device)
        return wp.get_mempool_used_mem_current(device)
    if trim := getattr(ctypes.CDLL(None), "malloc_trim", None):
        trim(0)  # what building freed, a later model would take without the process growing
    return 1024 * int(next(line for line in open("/proc/self/status") if line.startswith("VmRSS")).split()[1])

scene = wc.Scene()
ground = scene.add_surface(wc.meshes.sinusoidal_terrain(), name="ground")
body = scene.add_body(0.5, (5e-4,) * 3, position=(0, 0, 1), name="body")
law = wc.laws.HuntCrossley(stiffness=1e4, restitution=0.7)
material = wc.ContactMaterial(law=law, friction=wc.friction.Tanh(mu=0.4))
if kind == "sphere":
    scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, material, radius=0.05, name="touch")
else:
    corners = np.stack(np.meshgrid(*[np.linspace(-0.1, 0.1, 4)] * 3), -1).reshape(-1, 3)
    scene.add_contact(scene.add_points(body, corners), ground, material, name="touch")

def stepped(envs):
    model = scene.build(envs, device)
    model["body.mass"] = np.linspace(0.5, 1.0, envs)
    sim = wc.Simulation(model, dt=1e-4, threads=2, graphs=steps > 4)
    if not names:
        sim.step(steps)
        return sim, None
    recorder = Recorder(model, names, 1 + steps // 10, poses=True)
    recorder.start()
    for _ in sim.advance(recorder, steps, 10, start=0.0):
        pass
    return sim, recorder

one = stepped(1)
before = used()
many, recorder = stepped(envs)
memory = many.memory()
if recorder is not None:
    recorded = recorder.size().memory_items(device, envs, len(recorder.times))
    memory = memory.with_items([*many.frame_memory(recorder.needs), *recorded])
place = "host" if device == "cpu" else device
# What the scene takes in any case is taken a second time.
print(used() - before, memory.bytes_at(place))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "envs", "steps", "names"),
    [
        ("sphere", 200_000, 4, ()),
        ("box", 20_000, 4, ()),
        ("sphere", 10_000, 35, ()),
        ("sphere", 10_000, 35, ("body.position",)),
        ("sphere", 10_000, 35, RECORDED),
    ],
    ids=["spheres", "boxes of 64 points", "captured", "captured with poses", "captured with frames"],
)
def test_memory_estimate_matches_growth_of_the_process(kind, envs, steps, names, device):
    """Within 15 %, including launches, graphs and allocator overhead."""
    if device == "cpu" and not Path("/proc/self/status").is_file():
        pytest.skip("this system does not tell how much memory a process has")
    words = [sys.executable, "-c", GROWTH, kind, str(envs), str(steps), device, *names]
    result = subprocess.run(words, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    grown, estimate = map(int, result.stdout.split()[-2:])
    assert estimate == pytest.approx(grown, rel=0.15)


PEAK = """
import re, sys
import warp as wp
wp.config.log_level = wp.LOG_ERROR
import warpcontact as wc

example, folder, envs, *changes = sys.argv[1:]
experiment = wc.Experiment.from_toml(example, changes=changes)
planned = experiment.plan(envs=int(envs), device="cpu").peak
experiment.run(folder, envs=int(envs), device="cpu", progress=False)
print(planned, 1024 * int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("envs", "changes"),
    [
        (50_000, ("record={ series = false }", 'outcome.peak={ type = "Max", of = "touch.normal_force" }')),
        (10_000, ("record.every=1e-3",)),
    ],
    ids=["outcomes", "series"],
)
def test_memory_plan_matches_peak_of_the_process(envs, changes, tmp_path):
    """Within 15 %, including libraries. The first process, which compiles kernels, is not measured."""
    for count in (10, envs):
        words = [sys.executable, "-c", PEAK, str(EXAMPLE), str(tmp_path / str(count)), str(count)]
        words += ["duration=0.01", *changes]
        result = subprocess.run(words, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
    planned, peak = map(int, result.stdout.split()[-2:])
    assert planned == pytest.approx(peak, rel=0.15), (planned / 2**20, peak / 2**20)
