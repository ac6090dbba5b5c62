"""What a model takes of memory is known before it is taken, and follows from what allocates."""

import gc
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from case_marks import slow_except
from memory_scenes import MIB, SCENES, ball_scene, busy_scene, of_arrays, with_room
from scenes import dropped_sphere

import warpcontact as wc
from warpcontact import available, footprint
from warpcontact.available import HOST
from warpcontact.build import draw_up
from warpcontact.cli import main

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "terrain_drop.toml"


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", slow_except(SCENES, lambda name: name in ("busy", "pile")))
def test_the_estimate_is_what_the_arrays_take(name, precision, device, counted):
    scene = SCENES[name]()
    envs = 13
    draft = draw_up(scene, device, precision)
    assert counted.used == 0  # nothing is allocated before it is known to fit
    planned = draft.memory(envs)
    del draft
    gc.collect()
    counted.used = 0
    model = scene.build(envs, device, precision)
    sim = wc.Simulation(model, dt=1e-4, capture_graphs=False)
    gc.collect()
    assert of_arrays(model.memory(), model) == counted.used
    assert planned.needs == model.memory().needs
    # What is widened, and what is measured, comes on top.
    mass = np.linspace(1, 2, envs)
    model["ball.mass"] = mass
    model["ball.position"] = np.zeros((envs, 3))
    varied, needs = ["ball.mass", "ball.position"], {"energies"}
    if name != "nothing to touch":
        model["touch.law.stiffness"] = 1e5 * mass
        model["ground.scale"] = mass
        model["centre.position"] = 0.01 * np.ones((envs, 3))
        varied += ["touch.law.stiffness", "ground.scale", "centre.position"]
        model.sensor("touch.point")
        needs.add("points")
    if name == "coupled":
        model["spring.rest_length"] = mass
        model["body_1.motion.amplitude"] = mass
        varied += ["spring.rest_length", "body_1.motion.amplitude"]
        for sensor in ("body_0.reaction_force", "body_2.displacement", "keep.force"):
            model.sensor(sensor)
        needs |= {"reactions", "coordinates", "contact_couplings"}
    if name == "smooth":
        model["egg.semi_axes"] = np.linspace(0.1, 0.3, 3 * envs).reshape(envs, 3)
        model["lie.law.modulus"] = 1e8 * mass[:, None] * np.ones(3)
        varied += ["egg.semi_axes", "lie.law.modulus"]
        for sensor in ("lie.point", "stand.curvature_1", "rest.gap_by_position_a"):
            model.sensor(sensor)
        needs |= {"shape_points", "shape_curvatures", "shape_gradients"}
    model.sensor("scene.kinetic_energy")
    gc.collect()
    assert of_arrays(sim.memory(), model) == counted.used
    planned = draw_up(scene, device, precision).memory(envs, varied)
    actual = model.memory()
    assert planned.of("parameters") == actual.of("parameters")
    measured = model.measures_needs(model.device, needs, envs)
    assert actual.of("measures") == sum(need.size for need in measured)


def test_a_split_model_takes_what_its_parts_take(device, counted):
    scene, envs, where = busy_scene(), 14, [device] * 3
    planned = draw_up(scene, where).memory(envs)
    gc.collect()
    counted.used = 0
    model = scene.build(envs, where)
    sim = wc.Simulation(model, dt=1e-4, capture_graphs=False)
    gc.collect()
    memory = sim.memory()
    assert of_arrays(memory, model) == counted.used
    assert planned.needs == model.memory().needs
    assert (memory.envs, memory.device) == (envs, device)
    for purpose in ("state", "contacts", "cache", "surfaces", "parameters", "stepping"):
        assert memory.of(purpose) == sum(part.memory().of(purpose) for part in model.parts)
    # One more is on one of the devices; what each of them holds in any case is there three times.
    one = wc.Simulation(scene.build(envs, device), dt=1e-4, capture_graphs=False)
    assert memory.of("surfaces") == 3 * one.memory().of("surfaces")
    whole, alone = model.footprint(), one.model.footprint()
    assert whole.bytes_per_env == pytest.approx(alone.bytes_per_env)
    assert whole.fixed_bytes == pytest.approx(3 * alone.fixed_bytes)
    model["ball.mass"] = np.linspace(1, 2, envs)
    gc.collect()
    assert draw_up(scene, where).memory(envs, ["ball.mass"]).of("parameters") == model.memory().of("parameters")


def test_as_many_threads_step_all_parts_on_the_cpu():
    """Each has steps of each part, however many environments there are."""
    one, two = (draw_up(ball_scene(), where).memory(1000, threads=2) for where in ("cpu", ["cpu", "cpu"]))
    assert two.of("launches") == 2 * one.of("launches")
    assert draw_up(ball_scene(), "cpu").memory(100_000, threads=2).of("launches") == one.of("launches")
    assert draw_up(ball_scene(), "cpu").memory(1, threads=2).of("launches") == one.of("launches") // 2


def test_one_environment_more_takes_as_much_as_is_said(device):
    draft = draw_up(busy_scene(), device)
    one, other = draft.memory(256 * 1000, ["ball.mass"]), draft.memory(256 * 1001, ["ball.mass"])
    added = other.device_bytes + other.host_bytes - one.device_bytes - one.host_bytes
    assert added == pytest.approx(256 * one.bytes_per_env, rel=0.02)


def test_a_footprint_says_what_for_and_where(device):
    model = ball_scene().build(16384, device)
    memory = model.memory()
    text = str(memory)
    for purpose in ("state", "contacts", "cache", "surfaces", "parameters", "stepping", "launches"):
        assert memory.of(purpose) > 0
        assert f"  {purpose}" in text
    assert text.startswith("16384 environments on ")
    assert "MiB" in repr(memory)
    assert memory.of("surfaces") <= memory.fixed_bytes < memory.bytes_per_env * 16384
    assert " in any case" in text
    if model.device.is_cpu:
        assert memory.device_bytes == 0  # there is one memory, the host's
        assert memory.places == (HOST,)
        assert "memory of this machine (the CPU has no other): " in text
    else:
        assert memory.places == (str(model.device), HOST)
        assert memory.device_bytes > memory.of("state")


def test_footprints_of_parts_add_up_by_device():
    first = footprint.Footprint(
        3, "cuda:0", (footprint.Need("state", "cuda:0", 30, 10.0), footprint.Need("launches", HOST, 5))
    )
    second = footprint.Footprint(2, "cuda:1", (footprint.Need("state", "cuda:1", 20, 10.0),))
    both = first + second
    assert (both.envs, both.device) == (5, "cuda:0, cuda:1")
    assert [both.on(place) for place in both.places] == [30, 20, 5]
    assert both.places == ("cuda:0", "cuda:1", HOST)
    assert (both.device_bytes, both.host_bytes, both.of("state")) == (50, 5, 50)


@pytest.mark.parametrize(
    ("size", "text"),
    [(0, "0 B"), (1023, "1023 B"), (1024, "1 KiB"), (1.5 * 2**30, "1.5 GiB"), (1020 * MIB, "1020 MiB")],
)
def test_bytes_are_readable(size, text):
    assert footprint.readable(size) == text


def test_what_cannot_be_captured_takes_no_graphs(device):
    draft = draw_up(busy_scene(), device)
    assert draft.memory(9, crossing_substeps=4).of("launches") < draft.memory(9).of("launches")
    model = busy_scene().build(9, device)
    sim = wc.Simulation(model, dt=1e-4, crossing_substeps=4)
    assert sim.memory().of("launches") == draft.memory(9, crossing_substeps=4).of("launches")


def test_a_recording_takes_what_is_planned(device):
    from warpcontact.recorder import Recorder

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
    needs = size.needs(device, 7, 5)
    assert sum(need.size for need in needs if need.purpose == "buffers") == rings
    assert sum(need.size for need in needs if need.purpose == "recording") == stored


def test_plan_tells_and_runs_nothing(device, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["plan", str(EXAMPLE), "--device", device]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert out.startswith("1024 environments on ")
    for part in ("state", "recording", "available: ", "on disk: up to ", "1024 environments: all at once"):
        assert part in out
    assert main([*words, "--shard", "100", "--duration", "1"]) == 0
    assert "shards of" in capsys.readouterr().out
    with_room(monkeypatch, 120 * MIB)
    assert main([*words, "--envs", "100000"]) == 0
    assert "one after another" in capsys.readouterr().out
    assert main([*words, "--envs", "100000", "--shard", "100000"]) == 1
    out = capsys.readouterr().out
    assert "shard 100000: 100000 environments need" in out
    assert "at most " in out
    with_room(monkeypatch, MIB)
    assert main(words) == 1
    assert "not even one environment" in capsys.readouterr().out
    assert main(["run", str(EXAMPLE), "--device", device]) == 2
    assert "not even one environment fits" in capsys.readouterr().err
    with_room(monkeypatch, 10 * MIB)  # enough to look at the scene, not to record
    assert main([*words, "--duration", "3000"]) == 1
    assert "does not fit: not even one environment" in capsys.readouterr().out
    assert main(["run", *words[1:], "--duration", "3000"]) == 2
    assert "not even one environment fits" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert main([*words, "--shard", "0"]) == 2
    assert "--shard 0: shard must be a whole number of at least 1, got 0" in capsys.readouterr().err


# Sensors of all kinds of needs that one point on a mesh has.
RECORDED = ("scene.kinetic_energy", "scene.linear_momentum", "touch.gap", "touch.normal_force", "touch.point")

GROWTH = """
import ctypes, gc, sys
import numpy as np
import warp as wp
wp.config.log_level = wp.LOG_ERROR
import warpcontact as wc
from warpcontact.recorder import Recorder

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
    recorded = recorder.size().needs(device, envs, len(recorder.times))
    memory = memory.with_needs([*many.needs_of_frames(recorder.needs), *recorded])
place = "host" if device == "cpu" else device
# What the scene takes in any case is taken a second time.
print(used() - before, memory.on(place))
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
def test_the_estimate_is_what_the_process_grows_by(kind, envs, steps, names, device):
    """Within 15 %: also what is not in arrays, such as launches and graphs, and what allocators add."""
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
def test_the_process_has_at_its_peak_what_is_planned(envs, changes, tmp_path):
    """Within 15 %, libraries and all; a first process compiles, which takes more and has nothing to do with it."""
    if available.used() is None:
        pytest.skip("this system does not tell how much memory a process has")
    for count in (10, envs):
        words = [sys.executable, "-c", PEAK, str(EXAMPLE), str(tmp_path / str(count)), str(count)]
        words += ["duration=0.01", *changes]
        result = subprocess.run(words, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
    planned, peak = map(int, result.stdout.split()[-2:])
    assert planned == pytest.approx(peak, rel=0.15), (planned / 2**20, peak / 2**20)
