"""Multi-step launch of single-body environments on a CPU gives the results of stage-by-stage steps."""

import numpy as np
import pytest
from test_fused_step_gpu import SINGLE_BODY_SCENES, assert_same, built, states

import warpcontact as wc
from warpcontact.forces.launch_shape import AUTO, FUSED_CONTACT
from warpcontact.stepping import staged_start
from warpcontact.stepping.recorder import Recorder
from warpcontact.stepping.slice_stepper import StepChunk

pytestmark = [pytest.mark.launch_shapes, pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")]
KEYS = ("normal_force", "friction_force", "gap", "status")


def contact_sensors(model):
    """Returns contact sensors and the contact history."""
    history = model.arrays.history
    return [
        *(model.sensor(f"touch.{key}") for key in KEYS),
        *(getattr(history, key).numpy() for key in ("armed", "entry_speed")),
    ]


def names_of(launches):
    return [launch.kernel.key.split("__")[-1] for launch in launches]


def stepper_of(sim):
    return sim._prepared[1]._steppers[0]


def kernels_of(sim):
    return set(names_of(stepper_of(sim)._steps[0].full))


@pytest.mark.parametrize(
    ("name", "precision"),
    [
        *((name, "float32") for name in SINGLE_BODY_SCENES),
        pytest.param("points in clusters", "float64", marks=pytest.mark.slow),
        pytest.param("sphere with history", "float64", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("graphs", [True, False], ids=["graphs", "launches"])
def test_fused_steps_equal_staged_steps(name, precision, graphs):
    model = built(SINGLE_BODY_SCENES[name], "cpu", precision)
    sim = wc.Simulation(model, dt=1e-3, capture_graphs=graphs)
    other = built(SINGLE_BODY_SCENES[name], "cpu", precision)
    staged = wc.Simulation(other, dt=1e-3, launch_shape=FUSED_CONTACT)
    touched = False
    # One launch for each count, with and without graph capture.
    for count in (2, 73, 8, 64, 3, 300, 130):
        sim.step(count)
        staged.step(count)
        assert_same(states(model), states(other))
        assert_same(contact_sensors(model), contact_sensors(other))
        np.testing.assert_array_equal(model.arrays.time.numpy(), other.arrays.time.numpy())
        touched |= (model.sensor("touch.normal_force") > 0).any()
    assert touched
    assert kernels_of(sim) == {"fused_steps"}
    assert "fused_steps" not in kernels_of(staged)
    stepper = stepper_of(sim)
    # One graph serves any number of steps.
    assert {chunk for chunk, _ in stepper._graphs} == ({StepChunk(1)} if graphs else set())
    assert len(stepper._steps[0].full) == 1


def test_failed_environment_in_fused_steps_keeps_its_state_and_others_continue():
    found = []
    for shape in (AUTO, FUSED_CONTACT):
        model = built(SINGLE_BODY_SCENES["box with external force"], "cpu")
        sim = wc.Simulation(model, dt=1e-3, launch_shape=shape)
        sim.step(100)
        force = model["body.external_force"]
        # Overflow of float32, immediately and after some steps.
        force[3], force[5] = 1e38, 1e35
        model["body.external_force"] = force
        sim.step(200)
        health = model.health()
        found.append([*states(model), model.arrays.time.numpy(), health.frozen, health.times])
    assert_same(*found)
    np.testing.assert_array_equal(found[0][-2], [3, 5])
    assert np.isfinite(found[0][0]).all()


@pytest.mark.parametrize("every", [1, 5, 70])
def test_frames_of_fused_steps_have_every_recorded_step(every):
    def recorded(shape=AUTO):
        model = built(SINGLE_BODY_SCENES["with history"], "cpu")
        sim = wc.Simulation(model, dt=1e-3, launch_shape=shape)
        names = ["body.position", "touch.normal_force", "scene.kinetic_energy"]
        recorder = Recorder(model, names, 210 // every + 1, poses=False)
        recorder.start()
        for _ in sim.advance(recorder, 210, every, start=0.0):
            pass
        return stepper_of(sim), [*states(model), *recorder.frames().values()]

    stepper, own = recorded()
    assert names_of(stepper._steps[0].full) == ["fused_steps"]
    # The step after a frame uses the contact candidates of its evaluation.
    after_frame = names_of(stepper._step_after_evaluation)
    assert "fused_steps" not in after_frame
    assert after_frame[-1] == "copy_state"
    # All other steps are one launch. With 70 steps per frame, the frame is delivered before the next step begins.
    chunks = {chunk for chunk, _ in stepper._graphs if chunk.after_evaluation}
    assert (StepChunk(min(every, 2), after_evaluation=True, evaluates=True) in chunks) == (every < 70)
    assert all(names_of(stepper.graph(chunk)).count("fused_steps") == (chunk.steps > 1) for chunk in chunks)
    assert_same(own, recorded(FUSED_CONTACT)[1])


@pytest.mark.slow
def test_integrator_subclass_is_not_fused():
    asked = []

    class Own(wc.integrators.SemiImplicitEuler):
        def step_stages(self, plan, *arguments, **options):
            asked.append(plan)
            return super().step_stages(plan, *arguments, **options)

    sim = wc.Simulation(built(SINGLE_BODY_SCENES["with history"], "cpu"), dt=1e-3, integrator=Own())
    sim.step(20)
    assert asked
    assert "fused_steps" not in kernels_of(sim)


@pytest.mark.parametrize(
    "sensors", [pytest.param(["body.position"], marks=pytest.mark.slow), ["touch.normal_force"]]
)
def test_all_kernels_of_a_recorded_run_are_precompiled(sensors, monkeypatch):
    ahead = []
    monkeypatch.setattr(staged_start, "load_all", lambda kernels, *_, **__: ahead.extend(kernels))
    model = built(SINGLE_BODY_SCENES["with history"], "cpu")
    sim = wc.Simulation(model, dt=1e-3)
    recorder = Recorder(model, sensors, 5, poses=False)
    recorder.start()
    for _ in sim.advance(recorder, 20, 5, start=0.0):
        pass
    stepper = stepper_of(sim)
    assert bool(stepper._step_after_evaluation) == (sensors == ["touch.normal_force"])
    assert {one.kernel for launches in stepper.launches() for one in launches} <= set(ahead)
