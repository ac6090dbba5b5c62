"""Frames recorded during steps equal sensors evaluated between steps, and do not change the steps."""

import threading

import memory_scenes
import numpy as np
import pytest
import warp as wp
from test_particle_force_sums import particle_scene
from test_step_schedules import ENVS, SCENES, STATE, start

import warpcontact as wc
from warpcontact.forces import launch_shape
from warpcontact.forces.execution_plan import ExecutionPlan, force_stages
from warpcontact.model.model import ZERO_WITHOUT_CONTACT
from warpcontact.model.sensor_evaluation import can_evaluate_by_slice
from warpcontact.stepping import requirements, slice_stepper, worker_pool
from warpcontact.stepping.recorder import Recorder
from warpcontact.stepping.slice_stepper import StepChunk
from warpcontact.system.capture_lock import exclusive_capture_lock

CONTACT = (*ZERO_WITHOUT_CONTACT, "gap", "normal", "status")
NEUTRAL = [key for key in CONTACT if key in ZERO_WITHOUT_CONTACT]
pytestmark = pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")


def names_of(model, keys):
    contacts = [f"{contact.name}.{key}" for contact in model.scene.contacts for key in keys]
    return [*contacts, *(f"{body.name}.{key}" for body in model.scene.bodies for key in ("force", "torque"))]


def simulation(name, device, precision="float32", **options):
    model = SCENES[name]().build(envs=ENVS, precision=precision, device=device)
    start(model)
    return wc.Simulation(model, dt=1e-3, **options)


def evaluate_uncached(model):
    """Evaluates contacts with the cache cleared; restores the cache afterwards."""
    cache = model.arrays.cache
    kept = [(array, wp.clone(array)) for array in (cache.face_count, cache.nearest)]
    cache.face_count.zero_()
    cache.nearest.fill_(-1)
    plan = ExecutionPlan(model, model.envs, uses_cache=False, ordered_sum=True)
    for launch in force_stages(plan, model.arrays.state, model.zero_step, model.active_status):
        launch.launch()
    for array, before in kept:
        wp.copy(array, before)


def assert_equal(model, names, seen):
    for name, values in zip(names, seen, strict=True):
        np.testing.assert_array_equal(values, model.last_value(name), err_msg=name)


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("name", SCENES)
def test_cached_data_does_not_change_sensors(name, precision, device):
    sim = simulation(name, device, precision)
    model = sim.model
    names = names_of(model, CONTACT)
    for _ in range(25):
        sim.step(20)
        model.evaluate()
        seen = [model.last_value(name) for name in names]
        evaluate_uncached(model)
        assert_equal(model, names, seen)


@pytest.mark.parametrize("name", ["box of points on terrain", "latched on a ball", "with history", "two bodies"])
def test_contact_force_evaluation_equals_full_evaluation(name, device):
    """Also if contacts are culled: after steps, resets, and poses that the user sets without a step."""
    sim = simulation(name, device)
    model = sim.model
    names = names_of(model, NEUTRAL)

    def check():
        model.evaluate_needs({"wrenches"})
        seen = [model.last_value(name) for name in names]
        evaluate_uncached(model)
        assert_equal(model, names, seen)
        return any(np.asarray(values).any() for values in seen)

    touched = False
    for _ in range(25):
        sim.step(20)
        touched = check() or touched
    assert touched
    deep = model.state.body_position.numpy()
    model.state.body_position.assign(deep - np.array([0.0, 0.0, 0.02], deep.dtype))
    check()  # of contacts that are not in the history
    model.state.body_position.assign(deep + np.array([0.0, 0.0, 5.0], deep.dtype))
    sim.step(2)
    check()
    sim.reset(np.arange(ENVS) % 2 == 0)
    check()
    sim.reset()
    check()


@pytest.mark.parametrize(("threads", "size", "graphs"), [(1, 128, True), (3, 2, True), (2, 3, False)])
@pytest.mark.parametrize("name", ["box of points on terrain", "two bodies", "with history"])
@pytest.mark.parametrize("keys", [CONTACT, NEUTRAL], ids=["all_contacts", "active_contacts"])
def test_recorded_frames_equal_sensors_at_the_same_steps(keys, name, threads, size, graphs, device, monkeypatch):
    plain = simulation(name, device)
    names = [*names_of(plain.model, keys), "body.position", "body.orientation", "body.kinetic_energy"]
    stopped = simulation(name, device)
    expected = []
    for _ in range(30):
        stopped.step(7)
        expected.append([stopped.model.sensor(key) for key in names])

    monkeypatch.setattr(requirements, "MAX_SLICE", size)
    monkeypatch.setattr(worker_pool, "SERIAL_SECONDS", 0.0)
    sim = simulation(name, device, threads=threads, capture_graphs=graphs)
    model = sim.model
    needs = {need for key in names for need in model.find_sensor(key).needs}
    model.ensure_sensor_arrays(needs)
    sources = [model.sensors[key].array(model.arrays) for key in names]
    results = [np.zeros_like(np.stack([of[k] for of in expected])) for k in range(len(names))]
    taken = np.zeros(model.envs, dtype=int)

    def take(part, own, number):
        assert part is model
        assert (taken[own] == number).all()
        for source, result in zip(sources, results, strict=True):
            result[before + number, own] = source.numpy()[own]
        taken[own] += 1

    before = 0
    sim.step_with_callback(20, 7, needs, take)
    before = 20
    taken[:] = 0
    sim.step_with_callback(10, 7, needs, take)
    for k, key in enumerate(names):
        np.testing.assert_array_equal(results[k], np.stack([of[k] for of in expected]), err_msg=key)
    # The evaluations did not change the steps.
    plain.step(210)
    for body in model.scene.bodies:
        for key in STATE:
            sensor = f"{body.name}.{key}"
            np.testing.assert_array_equal(model.sensor(sensor), plain.model.sensor(sensor), err_msg=sensor)
    assert sim.steps == plain.steps == 210


@pytest.mark.parametrize("every", [1, pytest.param(2, marks=pytest.mark.slow), 5])
@pytest.mark.parametrize("name", SCENES)
def test_steps_are_unchanged_by_recorded_frames(name, every, device):
    """The next step reuses the contact candidates that a frame evaluates."""
    plain, sim = simulation(name, device), simulation(name, device)
    model = sim.model
    needs = {need for key in names_of(model, NEUTRAL) for need in model.find_sensor(key).needs}
    sim.step_with_callback(300 // every, every, needs, lambda part, own, number: None)
    plain.step(300)
    for body in model.scene.bodies:
        for key in STATE:
            sensor = f"{body.name}.{key}"
            np.testing.assert_array_equal(model.sensor(sensor), plain.model.sensor(sensor), err_msg=sensor)


@pytest.fixture
def release_graphs(monkeypatch):
    """Captures graphs of as many steps as release kernels do."""
    monkeypatch.setattr(slice_stepper, "SHORT_GRAPH_STEPS", slice_stepper.CPU_GRAPH_STEPS)


@pytest.mark.usefixtures("release_graphs")
def test_steps_after_frames_are_captured_as_graphs(device):
    sim = simulation("two bodies", device)
    needs = sim.model.find_sensor("lower.normal_force").needs

    def captured():
        _, made = sim._prepared
        return {chunk for stepper in made._steppers for chunk, _ in stepper._graphs}

    # On a GPU a frame is evaluated when it is complete, and eight steps are four replays of two.
    on_cpu = sim.model.device.is_cpu
    first = {StepChunk(8), StepChunk(0, evaluates=True)} if on_cpu else {StepChunk(2)}
    sim.step_with_callback(1, 8, needs, lambda part, own, number: None)
    assert captured() == first
    sim.step_with_callback(2, 4, needs, lambda part, own, number: None)
    assert captured() == first | {StepChunk(2)} | (
        {StepChunk(4, after_evaluation=True, evaluates=True)} if on_cpu else set()
    )
    sim.step_with_callback(2, 20, needs, lambda part, own, number: None)
    # No graph has this number of steps: the first graph takes the remainder, and the others eight each.
    known = (
        {StepChunk(4, after_evaluation=True, evaluates=True), StepChunk(4, after_evaluation=True)}
        if on_cpu
        else set()
    )
    assert captured() == first | {StepChunk(2)} | known


def test_successive_recordings_have_their_own_frames(device):
    """Graphs include the evaluations of their recording; those of another recording are not replayed."""
    sim, plain = (simulation("two bodies", device) for _ in range(2))
    names = ["lower.normal_force", "scene.kinetic_energy", "scene.linear_momentum"]
    made = []
    for number in range(3):
        recorder = Recorder(sim.model, names[: 3 - number % 2], 5, poses=number == 0)
        recorder.start()
        for _ in sim.advance(recorder, 40, 10, start=sim.time):
            pass
        made.append(recorder.frames())
        before = {name: values.copy() for name, values in made[-1].items()}
        sim.step(7)
        sim.step_with_callback(1, 7, recorder.needs, lambda part, own, number: None)
        sim.step(3)
        for name, values in made[-1].items():
            np.testing.assert_array_equal(values, before[name], err_msg=name)
    for frames in made:
        for number in range(5):
            plain.step(10 if number else 0)
            for name, values in frames.items():
                np.testing.assert_array_equal(values[number], plain.model.sensor(name), err_msg=f"{name} {number}")
        plain.step(17)


def test_evaluation_needs_cover_all_sensors(device):
    models = [make().build(device=device) for make in memory_scenes.SCENES.values()]
    needs_of = [{need for sensor in model.sensors.values() for need in sensor.needs} for model in models]
    for model, needs in zip(models, needs_of, strict=True):
        assert model.check_needs(needs) == needs
    assert set().union(*needs_of) == {need for model in models for need in model.needs}


@pytest.mark.parametrize("name", ["two bodies", "nonsmooth", "particles"])
def test_contact_evaluation_does_not_accumulate_wrenches(name, device):
    """If a frame excludes their sensor, wrenches are unchanged or recomputed, never accumulated."""
    model = (particle_scene if name == "particles" else SCENES["two bodies"])().build(envs=ENVS, device=device)
    if name != "particles":
        start(model)
    integrator = wc.integrators.MoreauJean() if name == "nonsmooth" else None
    wc.Simulation(model, dt=1e-3, integrator=integrator).step(300)
    wrenches = model.parts[0].arrays.wrenches
    model.evaluate_needs({"wrenches"})
    before = [wrenches.force.numpy().copy(), wrenches.torque.numpy().copy()]
    assert np.abs(before[0]).max() > 1.0
    for _ in range(3):
        model.evaluate_needs({"contacts"})
    np.testing.assert_array_equal(wrenches.force.numpy(), before[0])
    np.testing.assert_array_equal(wrenches.torque.numpy(), before[1])


@pytest.mark.parametrize(
    ("frames", "every", "needs", "message"),
    [
        (-1, 1, (), "frames must be a whole number of at least 0, got -1"),
        (1, 0, (), "every must be a whole number of at least 1, got 0"),
        (1, 2.0, (), "every must be a whole number of at least 1, got 2.0"),
        (
            1,
            1,
            ("bodies", "contacts"),
            r"unknown needs \['bodies'\]; possible needs: \['all_distances', 'contacts'",
        ),
    ],
)
def test_invalid_frames_are_refused(frames, every, needs, message, device):
    sim = simulation("two bodies", device)
    with pytest.raises(ValueError, match=message):
        sim.step_with_callback(frames, every, set(needs), lambda part, own, number: None)
    assert sim.steps == 0


def _graphs_of(sim):
    return {key: id(graph) for key, graph in sim._prepared[1]._steppers[0]._graphs.items()}


@pytest.mark.usefixtures("release_graphs")
def test_recorders_with_equal_needs_share_one_capture(device):
    sim = simulation("two bodies", device)
    sim.step(100)
    replayed = [_graphs_of(sim)]
    for name in ("lower.normal_force", "upper.normal_force"):
        recorder = Recorder(sim.model, [name], 5, poses=False)
        recorder.start()
        for _ in sim.advance(recorder, 40, 10, start=sim.time):
            pass
        replayed.append(_graphs_of(sim))
    assert replayed[1] == replayed[2]
    # Graphs without frames are unchanged.
    assert replayed[0].items() <= replayed[1].items()
    if sim.model.device.is_cpu:
        frame, eight = StepChunk(10, after_evaluation=True, evaluates=True), StepChunk(8)
        assert {(frame, frozenset(recorder.needs)), (eight, frozenset())} <= replayed[1].keys()
        stepper = sim._prepared[1]._steppers[0]
        # The first of ten steps skips the broad phase.
        for chunk, detections in ((frame, 9), (eight, 8)):
            kernels = [launch.kernel.key for launch in stepper.graph(chunk)]
            kernel_name, launches = (
                ("update_sets", len(sim.model.groups)) if launch_shape.FUSE_STAGES else ("closest_point", 1)
            )
            # With staged kernels, the evaluation of the frame uses the same kernel as a step.
            evaluations = 0 if launch_shape.FUSE_STAGES else int(chunk.evaluates)
            assert sum(kernel_name in name for name in kernels) == detections * launches + evaluations


def test_evaluation_launches_wait_for_capture_in_another_thread(device):
    sim = simulation("two bodies", device)
    sim.step(8)
    stepper = sim._prepared[1]._steppers[0]
    needs = frozenset(("contacts",))
    preparations = [lambda: sim.model.parts[0].evaluation_launches(needs)]
    if sim.model.device.is_cpu:
        # On a GPU no step reuses contact candidates of an evaluation.
        preparations.append(lambda: stepper.prepare_step_after_evaluation(needs))
    for prepare in preparations:
        ended = threading.Event()
        waiting = threading.Thread(target=lambda work=prepare, end=ended: (work(), end.set()))
        with exclusive_capture_lock():
            waiting.start()
            assert not ended.wait(0.2)
        waiting.join(10.0)
        assert ended.is_set()


def test_frames_of_nonsmooth_contact_contain_all_environments(device):
    """Nonsmooth contacts are evaluated after their step in one launch, so such frames wait for all slices."""
    scene = SCENES["two bodies"]()
    model = scene.build(envs=ENVS, device=device)
    start(model)
    sim = wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean(), threads=2)
    needs = {*model.find_sensor("lower.normal_force").needs}
    assert not can_evaluate_by_slice(model, model.device, nonsmooth=True, needs=needs)
    frames = []

    def take(part, own, number):
        assert (own.start, own.stop, number) == (0, ENVS, len(frames))
        frames.append(part.last_value("lower.normal_force"))

    sim.step_with_callback(4, 100, needs, take)
    np.testing.assert_array_equal(frames[-1], model.sensor("lower.normal_force"))
    assert np.max(frames) > 0.0


def test_contact_force_is_zero_after_change_from_nonsmooth_to_compliant(device):
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((2, 2), (2, 2)), name="ground")
    ball = scene.add_body(1.0, (0.1, 0.1, 0.1), position=(0, 0, 0.1), name="ball")
    law = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, law, radius=0.1, name="touch")
    model = scene.build(envs=2, device=device)
    soft = wc.Simulation(model, dt=1e-3)
    wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean()).step(10)
    assert (model.sensor("touch.normal_force") > 1.0).all()
    model.state.body_position.assign(np.full((2, 1, 3), (0.0, 0.0, 1.0), dtype=np.float32))
    soft.step()
    np.testing.assert_array_equal(model.sensor("touch.normal_force"), 0.0)


def test_contact_force_is_zero_after_lost_contact_without_history(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(wc.meshes.grid((2, 2), (2, 2)), name="ground")
    ball = scene.add_body(1.0, (0.1, 0.1, 0.1), position=(0, 0, 0.2), name="ball")
    law = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, law, radius=0.1, name="touch")
    model = scene.build(envs=2, device=device)
    sim = wc.Simulation(model, dt=1e-6, distance_cache=False)
    sim.step()
    np.testing.assert_array_equal(model.sensor("touch.normal_force"), 0.0)
    start = model.state.body_position.numpy().copy()
    model.state.body_position.assign(start - np.array([0.0, 0.0, 0.11], dtype=np.float32))
    sim.step()
    # The displacement since the last evaluation is zero to rounding.
    model.state.body_position.assign(start)
    model.state.body_linear_velocity.zero_()
    np.testing.assert_array_equal(model.sensor("touch.normal_force"), 0.0)
