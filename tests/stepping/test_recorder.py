"""Recordings: names, dimensions, units, times."""

import numpy as np
import pytest
import xarray as xr
from scenes import dropped_sphere, square

import warpcontact as wc
from warpcontact.forces.sensor import Sensor
from warpcontact.stepping import requirements, worker_pool
from warpcontact.stepping.frame_recording import record_frames
from warpcontact.stepping.recorder import Recorder, check_item_dimensions, item_dimension_of

WATCHED = ["ball.position", "touch.gap", "touch.normal_force", "scene.kinetic_energy"]


def falling(device, envs=5):
    model = dropped_sphere(
        wc.laws.Hooke(stiffness=1e4), height=0.02, gravity=(0, 0, -9.81), envs=envs, device=device
    )
    model["ball.mass"] = np.linspace(1.0, 2.0, envs)
    return wc.Simulation(model, dt=1e-3, threads=2)


def read_by_stopping(device, frames, stride):
    sim = falling(device)
    seen = []
    for number in range(frames):
        sim.step(stride if number else 0)
        seen.append([sim.model.sensor(name) for name in WATCHED])
    values = [np.stack(of) for of in zip(*seen, strict=True)]
    assert (values[WATCHED.index("touch.normal_force")] > 0.0).any()
    return values


@pytest.fixture
def in_slices(monkeypatch):
    """Makes several threads share a few environments."""
    monkeypatch.setattr(requirements, "MAX_SLICE", 2)
    monkeypatch.setattr(worker_pool, "SERIAL_SECONDS", 0.0)


def test_recording_is_a_labeled_data_set(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), gravity=(0, 0, -9.81), envs=3, device=device)
    sim = wc.Simulation(model, dt=1e-3)
    names = model.sensor_names
    recording = sim.run(0.05, names, every=0.01)
    assert isinstance(recording, xr.Dataset)
    np.testing.assert_allclose(recording.time, np.arange(6) * 0.01)
    assert recording.env.values.tolist() == [0, 1, 2]
    for name in names:
        assert recording[name].dims[:2] == ("time", "env"), name
        assert recording[name].attrs["units"], name
        assert recording[name].attrs["long_name"], name
    assert recording["ball.position"].dims == ("time", "env", "axis")
    assert recording["ball.orientation"].dims == ("time", "env", "component")
    assert recording["touch.gap"].attrs["units"] == "m"
    assert recording["touch.status"].attrs["flag_meanings"].split()[1] == "CONTACT"
    assert recording["ball.orientation"].sel(component="w").values[0, 0] == 1.0
    # The last frame is the current state.
    for name in names:
        np.testing.assert_array_equal(recording[name].values[-1], model.sensor(name), err_msg=name)


def test_sensors_of_a_frame_belong_to_one_state(device):
    """Gap and position of a frame belong to the same time, not one step apart."""
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), velocity=(0, 0, -1.0), height=0.02, device=device)
    recording = wc.Simulation(model, dt=1e-3).run(0.04, ["ball.position", "touch.gap", "touch.normal_force"])
    height = recording["ball.position"].sel(axis="z").values[:, 0]
    np.testing.assert_allclose(recording["touch.gap"].values[:, 0], height - 0.1, atol=2e-8)
    force = 1e4 * np.maximum(0.1 - height, 0)
    np.testing.assert_allclose(recording["touch.normal_force"].values[:, 0], force, atol=2e-3)
    assert force.max() > 50


def test_poses_and_radii_are_recorded_for_replay(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), envs=2, device=device)
    model["touch.radius"] = [0.1, 0.2]
    sim = wc.Simulation(model, dt=1e-3)
    recording = sim.run(0.01)
    replay = {"ball.position", "ball.orientation", "ball.mass", "ball.inertia", "touch.radius"}
    assert set(recording.data_vars) == replay
    np.testing.assert_allclose(recording["touch.radius"], [0.1, 0.2])
    assert recording.scene is model.scene
    assert set(sim.run(0.01, ["touch.gap"], poses=False).data_vars) == {"touch.gap"}


def test_parameters_that_vary_by_environment_are_recorded(device):
    model = dropped_sphere(wc.laws.HuntCrossley(stiffness=1e4, restitution=0.5), envs=3, device=device)
    model["touch.law.restitution"] = [0.2, 0.4, 0.6]
    model["ball.position"] = [(0, 0, 1), (0, 0, 2), (0, 0, 3)]
    recording = wc.Simulation(model, dt=1e-3).run(0.01)
    assert recording["touch.law.restitution"].dims == ("env",)
    np.testing.assert_allclose(recording["touch.law.restitution"], [0.2, 0.4, 0.6])
    assert recording["ball.position.initial"].dims == ("env", "axis")
    np.testing.assert_allclose(recording["ball.position.initial"].sel(axis="z"), [1, 2, 3])
    assert "touch.law.stiffness" not in recording


def test_sensors_of_sets_have_an_item_axis(device):
    scene = wc.Scene()
    ground = scene.add_surface(square())
    body = scene.add_body(1.0, (1, 1, 1), position=(0, 0, 1), name="body")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3))
    scene.add_contact(scene.add_points(body, np.eye(3)), ground, material, name="hull")
    model = scene.build(envs=2, device=device)
    record = ["hull.gap", "hull.normal"]
    recording = wc.Simulation(model, dt=1e-3).run(2e-3, record)
    assert recording["hull.gap"].dims == ("time", "env", "item")
    assert recording["hull.normal"].dims == ("time", "env", "item", "axis")
    np.testing.assert_allclose(recording["hull.gap"].values[0, 0], [1, 1, 2], atol=1e-6)
    # Two sets of different size have separate dimensions.
    scene.add_contact(scene.add_points(body, np.ones((2, 3))), ground, material, name="pair")
    recording = wc.Simulation(scene.build(device=device), dt=1e-3).run(2e-3, ["hull.gap", "pair.gap"])
    assert recording["hull.gap"].dims == ("time", "env", "hull.item")
    assert recording["pair.gap"].shape == (3, 1, 2)


def test_scene_totals_are_sums_over_bodies(device):
    scene = wc.Scene()
    scene.add_body(1.0, (1, 1, 1), linear_velocity=(1, 0, 0), name="one")
    scene.add_body(
        2.0, (1, 2, 3), position=(0, 1, 0), linear_velocity=(0, 0, 2), angular_velocity=(0, 0, 1), name="two"
    )
    model = scene.build(envs=2, device=device)
    np.testing.assert_allclose(model.sensor("scene.linear_momentum"), [(1, 0, 4)] * 2)
    np.testing.assert_allclose(model.sensor("scene.kinetic_energy"), 0.5 + 4 + 1.5)
    # (0, 1, 0) × 2 (0, 0, 2) and the spin 3.
    np.testing.assert_allclose(model.sensor("scene.angular_momentum"), [(4, 0, 3)] * 2)
    model["two.position"] = (0, 0, 3)
    np.testing.assert_allclose(model.sensor("scene.potential_energy"), 2 * 9.81 * 3, rtol=1e-6)
    recording = wc.Simulation(model, dt=1e-3).run(2e-3, ["scene.linear_momentum", "scene.kinetic_energy"])
    assert recording["scene.linear_momentum"].dims == ("time", "env", "axis")


def test_frames_are_drained_from_a_small_ring_buffer(device, monkeypatch):
    monkeypatch.setattr("warpcontact.stepping.frame_buffers.RING_BYTES", 7 * 3 * 4 * 4)
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), envs=4, device=device)
    small = wc.Simulation(model, dt=1e-3).run(0.05, ["ball.position", "touch.gap"])
    monkeypatch.undo()
    large = wc.Simulation(dropped_sphere(wc.laws.Hooke(stiffness=1e4), envs=4, device=device), dt=1e-3).run(
        0.05, ["ball.position", "touch.gap"]
    )
    for name in large.data_vars:
        np.testing.assert_array_equal(small[name], large[name])


@pytest.mark.parametrize("stride", [1, 7, 40])
def test_recording_equals_sensors_between_steps(stride, device, in_slices):
    recording = falling(device).run(0.1, WATCHED, every=stride * 1e-3, poses=False)
    expected = read_by_stopping(device, 100 // stride + 1, stride)
    for name, values in zip(WATCHED, expected, strict=True):
        np.testing.assert_array_equal(recording[name], values, err_msg=name)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_sensors_of_every_kind_are_recorded(precision, device, in_slices):
    """Consecutive recordings use separate memory."""
    scene = wc.Scene()
    ground = scene.add_surface(square())
    friction = wc.friction.LuGre(mu_static=0.6, mu_dynamic=0.5, stribeck_speed=0.01, stiffness=1e3)
    material = wc.ContactMaterial(law=wc.laws.HuntCrossley(stiffness=1e4, restitution=0.5), friction=friction)
    for name, x in (("one", 0.0), ("two", 0.4)):
        body = scene.add_body(1.0, (0.01, 0.01, 0.01), position=(x, 0, 0.06), name=name)
        scene.add_contact(scene.add_points(body, 0.05 * np.eye(3)), ground, material, name=f"feet_of_{name}")
    sims = [
        wc.Simulation(scene.build(envs=5, precision=precision, device=device), dt=1e-3, threads=2) for _ in "ab"
    ]
    for sim in sims:
        sim.model["two.linear_velocity"] = np.linspace((0, 0, -1), (2, 0, -2), 5)
    sim, stopped = sims
    names = [name for name in sim.model.sensor_names if sim.model.are_by_slice(sim.model.find_sensor(name).needs)]
    assert {"one.position", "feet_of_two.status", "feet_of_two.friction.deflection", "scene.kinetic_energy"} <= {
        *names
    }
    recordings = [sim.run(0.08, names, poses=False) for _ in range(2)]
    for recording in recordings:
        for number in range(81):
            stopped.step(int(number > 0))
            for name in names:
                expected = stopped.model.sensor(name)
                np.testing.assert_array_equal(recording[name].values[number], expected, err_msg=f"{name} {number}")
    assert (recordings[0]["feet_of_two.normal_force"].values > 0.0).any()


@pytest.mark.parametrize("blocks", [1, 2, 3])
def test_blocks_contain_successive_pieces_of_a_recording(blocks, device, in_slices):
    """A block is unchanged until as many further blocks as exist were started."""
    sim = falling(device)
    recorder = Recorder(sim.model, WATCHED, 3, poses=False, blocks=blocks)
    recorder.start()
    shown, kept, done, written = [], [], [], 0
    for steps in sim.advance(recorder, 110, 7, start=0.0):
        # All frames that are due are written, in blocks of the given size.
        assert written + recorder.taken == steps // 7 + 1
        assert sim.steps == steps
        done.append(steps)
        if recorder.taken == 3:
            shown.append(recorder.series())
            kept += [block.copy(deep=True) for block in shown[len(kept) : len(shown) - blocks + 1]]
            written += 3
            recorder.rewind()
    kept += [*shown[len(kept) :], recorder.series()]
    assert (done[0], done[-1], [block.time.size for block in kept]) == (0, 110, [3, 3, 3, 3, 3, 1])
    expected = read_by_stopping(device, 16, 7)
    for name, values in zip(WATCHED, expected, strict=True):
        np.testing.assert_array_equal(np.concatenate([block[name] for block in kept]), values, err_msg=name)
    np.testing.assert_allclose(np.concatenate([block.time for block in kept]), 7e-3 * np.arange(16))


@pytest.mark.parametrize(
    "options",
    [{}, {"capture_graphs": False}, {"quarantine": "reset"}],
    ids=["graphs", "launches", "all_environments"],
)
def test_frames_of_many_chunks_have_their_numbers(options, device, in_slices):
    """Many frames per call, after an earlier recording, before the worker pool has measured its speed."""
    sim = wc.Simulation(falling(device).model, dt=1e-3, threads=2, **options)
    recorder = Recorder(sim.model, WATCHED, 60, poses=False)
    recorder.start()
    recorder.take(0.0)
    record_frames(sim, recorder, 7, 3, 0.0, 0, follows_frame=False)
    record_frames(sim, recorder, 50, 3, 0.0, 21, follows_frame=True)
    expected = read_by_stopping(device, 58, 3)
    for name, values in zip(WATCHED, expected, strict=True):
        np.testing.assert_array_equal(recorder.frames()[name], values, err_msg=name)
    np.testing.assert_allclose(recorder.series().time, 3e-3 * np.arange(58))


@pytest.mark.parametrize("sensors", [[], ["touch.normal_force"], WATCHED], ids=["poses", "forces", "all_sensors"])
def test_frames_of_split_chunks_equal_sensors_between_steps(sensors, device, in_slices, monkeypatch):
    """With few slices a work item has few frames, and starts from the contact candidates of the last frame."""
    taken = []
    step = worker_pool._run_item

    def seen(stepper, turn, frames):
        taken.append(turn)
        step(stepper, turn, frames)

    monkeypatch.setattr(worker_pool, "_run_item", seen)
    sim = falling(device)
    recorder = Recorder(sim.model, [*sensors, WATCHED[0]], 60, poses=False)
    recorder.start()
    recorder.take(0.0)
    record_frames(sim, recorder, 3, 3, 0.0, 0, follows_frame=False)
    sim._prepared[1]._chunk_sizer.steps = 1000
    taken.clear()
    record_frames(sim, recorder, 54, 3, 0.0, 9, follows_frame=True)
    if sim.model.device.is_cpu:
        # 162 steps of three slices: each item takes half of the remaining steps, in whole frames.
        assert sorted((turn.frame, len(turn.chunks)) for turn in taken) == [
            turn for turn in ((4, 30), (34, 14), (48, 8), (56, 2)) for _ in range(3)
        ]
    assert all(way.after_evaluation for turn in taken for way in turn.chunks)
    expected = dict(zip(WATCHED, read_by_stopping(device, 58, 3), strict=True))
    for name, values in recorder.frames().items():
        np.testing.assert_array_equal(values, expected[name], err_msg=name)


def test_scene_totals_are_summed_in_item_order(device):
    """For so many items that NumPy would sum in another order; the result is never −0."""
    scene = wc.Scene(gravity=(0, 0, 0))
    position = 10.0 * np.random.default_rng(4).normal(size=(40, 3))
    scene.add_bodies(position, 1.0, (1.0, 1.0, 1.0), name="stones")
    model = scene.build(envs=3, device=device)
    velocity = np.random.default_rng(5).normal(size=(3, 40, 3))
    velocity[2] = -0.0
    model["stones.linear_velocity"] = velocity
    sim = wc.Simulation(model, dt=1e-3)
    names = ["scene.linear_momentum", "scene.kinetic_energy", "stones.kinetic_energy"]
    recording = sim.run(0.02, names, every=1e-2, poses=False)
    momenta, energies, each = (recording[name].values for name in names)
    total = np.zeros((3, 3))
    for one in velocity.astype(np.float32).swapaxes(0, 1):
        total += one
    assert momenta.shape == (3, 3, 3)
    for frame in momenta:
        np.testing.assert_array_equal(frame, total)
    assert not np.signbit(momenta[:, 2]).any()
    total = np.zeros((3, 3))
    for one in np.moveaxis(each, 2, 0):
        total += one
    assert (total != each.sum(axis=2)).any()
    np.testing.assert_array_equal(energies, total)


def test_restarted_recorder_begins_with_an_empty_block(device):
    sim = falling(device)
    recorder = Recorder(sim.model, WATCHED, 2, poses=False)
    frames = {name: np.zeros((1, *values.shape[1:])) for name, values in recorder.frames().items()}
    with pytest.raises(RuntimeError, match="0 of 2 frames free"):
        recorder.continue_from(frames, np.zeros(1))
    for _ in range(2):
        recorder.start()
        assert (recorder.taken, recorder.free_frames) == (0, 2)
        recorder.take(0.0)
    with pytest.raises(RuntimeError, match="2 of 2 frames free, but 3 are required"):
        recorder.continue_from(frames, np.zeros(3))


def test_frames_beyond_recorder_capacity_are_refused(device):
    sim = falling(device)
    recorder = Recorder(sim.model, WATCHED, 3, poses=False)
    with pytest.raises(RuntimeError, match=r"0 of 3 frames free, but 1 are required"):
        recorder.take(0.0)
    recorder.start()
    recorder.take(0.0)
    frames = recorder.frames()
    with pytest.raises(RuntimeError, match=r"2 of 3 frames free, but 3 are required"):
        record_frames(sim, recorder, 3, 1, 0.0, 0, follows_frame=False)
    assert (sim.steps, recorder.taken) == (0, 1)
    done = []
    with pytest.raises(RuntimeError, match=r"0 of 3 frames free, but 1 are required"):
        done += sim.advance(recorder, 11, 1, start=0.0, taken=1)
    assert (sim.steps, recorder.taken) == (2, 3)
    for name, values in frames.items():
        np.testing.assert_array_equal(values, recorder.frames()[name][:1], err_msg=name)


def test_time_continues_in_a_second_run(device):
    sim = wc.Simulation(dropped_sphere(wc.laws.Hooke(stiffness=1e4), device=device), dt=1e-3)
    sim.run(0.01)
    second = sim.run(0.01, every=5e-3)
    np.testing.assert_allclose(second.time, [0.01, 0.015, 0.02])
    # A duration between two steps is rounded up; frames stay at multiples of the interval.
    third = sim.run(0.0125, every=5e-3)
    np.testing.assert_allclose(third.time, [0.02, 0.025, 0.03])
    assert sim.steps == 33


def test_unknown_sensors_are_refused_before_the_run(device):
    sim = wc.Simulation(dropped_sphere(wc.laws.Hooke(stiffness=1e4), device=device), dt=1e-3)
    with pytest.raises(KeyError, match=r"did you mean 'touch\.gap'"):
        sim.run(0.01, ["touch.gab"])
    assert sim.steps == 0


def test_sensors_of_one_dimension_with_different_items_are_refused_before_the_run():
    """Such as those of a force element of a user; a name of the items separates them."""
    scene = wc.Scene()
    body = scene.add_body(1.0, (1, 1, 1), name="body")
    scene.add_points(body, np.eye(3), name="corners")

    def sensor(name, items, **options):
        return Sensor(f"net.{name}", "N", "force", lambda _: None, items=items, **options)

    nodes, edges = sensor("node", 5), sensor("edge", 8)
    assert item_dimension_of(scene, nodes) == "net.item"
    with pytest.raises(ValueError, match=r"'net\.node' has 5 items and 'net\.edge' has 8.*dimension 'net\.item'"):
        check_item_dimensions(scene, [nodes, edges])
    named = sensor("edge", 8, items_of="edge")
    check_item_dimensions(scene, [nodes, named])
    assert item_dimension_of(scene, named) == "net.edge.item"
