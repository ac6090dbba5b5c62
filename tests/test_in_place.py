"""Bodies alone in their environment take many steps in one launch on a CPU; nothing else comes of it."""

import numpy as np
import pytest
from test_alone import ALONE, assert_same, built, states

import warpcontact as wc
from warpcontact import simulation
from warpcontact.recorder import Recorder
from warpcontact.schedule import Span
from warpcontact.slices import Way

pytestmark = [pytest.mark.launch_shapes, pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")]
KEYS = ("normal_force", "friction_force", "gap", "status")


def told(model):
    """Returns sensors of contacts, and what is known of them from step to step."""
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
    return set(names_of(stepper_of(sim)._steps[0].whole))


@pytest.mark.parametrize(
    ("name", "precision"),
    [
        *((name, "float32") for name in ALONE),
        ("points in blocks", "float64"),
        pytest.param("a sphere with memory", "float64", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("graphs", [True, False], ids=["graphs", "launches"])
def test_the_steps_of_an_environment_come_to_what_stages_do(name, precision, graphs, monkeypatch):
    model = built(ALONE[name], "cpu", precision)
    sim = wc.Simulation(model, dt=1e-3, capture_graphs=graphs)
    with monkeypatch.context() as patch:
        patch.setattr(Span, "in_place", False)
        other = built(ALONE[name], "cpu", precision)
        staged = wc.Simulation(other, dt=1e-3)
        staged.step(1)
    sim.step(1)
    touched = False
    # In one launch each, captured or not.
    for count in (1, 73, 8, 64, 3, 300, 130):
        sim.step(count)
        staged.step(count)
        assert_same(states(model), states(other))
        assert_same(told(model), told(other))
        np.testing.assert_array_equal(model.arrays.time.numpy(), other.arrays.time.numpy())
        touched |= (model.sensor("touch.normal_force") > 0).any()
    assert touched
    assert kernels_of(sim) == {"step_in_place"}
    assert "step_in_place" not in kernels_of(staged)
    stepper = stepper_of(sim)
    # The same for any number.
    assert {way for way, _ in stepper._graphs} == ({Way(1)} if graphs else set())
    assert len(stepper._steps[0].whole) == 1


def test_one_that_fails_stays_where_it_was_and_the_others_go_on(monkeypatch):
    found = []
    for in_place in (True, False):
        with monkeypatch.context() as patch:
            if not in_place:
                patch.setattr(Span, "in_place", False)
            model = built(ALONE["a pushed box"], "cpu")
            sim = wc.Simulation(model, dt=1e-3)
            sim.step(100)
            force = model["body.external_force"]
            # Beyond what a number holds, at once and after some steps.
            force[3], force[5] = 1e38, 1e35
            model["body.external_force"] = force
            sim.step(200)
            health = model.health()
            found.append([*states(model), model.arrays.time.numpy(), health.frozen, health.times])
    assert_same(*found)
    np.testing.assert_array_equal(found[0][-2], [3, 5])
    assert np.isfinite(found[0][0]).all()


@pytest.mark.parametrize("every", [1, 5, 70])
def test_frames_see_every_step_that_is_due(every, monkeypatch):
    def recorded():
        model = built(ALONE["with memory"], "cpu")
        sim = wc.Simulation(model, dt=1e-3)
        names = ["body.position", "touch.normal_force", "scene.kinetic_energy"]
        recorder = Recorder(model, names, 210 // every + 1, poses=False)
        recorder.start()
        for _ in sim.advance(recorder, 210, every, start=0.0):
            pass
        return stepper_of(sim), [*states(model), *recorder.frames().values()]

    stepper, own = recorded()
    assert names_of(stepper._steps[0].whole) == ["step_in_place"]
    # The step after a frame knows what is near.
    after_look = names_of(stepper._after_look)
    assert "step_in_place" not in after_look
    assert after_look[-1] == "adopt"
    # The others, if there are any, are one launch. Of 70 steps a frame is handed on before the next begins.
    known = {way for way, _ in stepper._graphs if way.known}
    assert (Way(min(every, 2), known=True, looks=True) in known) == (every < 70)
    assert all(names_of(stepper.graph(way)).count("step_in_place") == (way.steps > 1) for way in known)
    monkeypatch.setattr(Span, "in_place", False)
    assert_same(own, recorded()[1])


@pytest.mark.slow
def test_a_subclass_with_steps_of_its_own_is_asked_for_them():
    asked = []

    class Own(wc.integrators.SemiImplicitEuler):
        def step_stages(self, span, *arguments, **options):
            asked.append(span)
            return super().step_stages(span, *arguments, **options)

    sim = wc.Simulation(built(ALONE["with memory"], "cpu"), dt=1e-3, integrator=Own())
    sim.step(20)
    assert asked
    assert "step_in_place" not in kernels_of(sim)


@pytest.mark.parametrize(
    "sensors", [pytest.param(["body.position"], marks=pytest.mark.slow), ["touch.normal_force"]]
)
def test_all_that_a_recorded_run_launches_is_compiled_ahead(sensors, monkeypatch):
    ahead = []
    monkeypatch.setattr(simulation, "load_all", lambda kernels, *_: ahead.extend(kernels))
    model = built(ALONE["with memory"], "cpu")
    sim = wc.Simulation(model, dt=1e-3)
    recorder = Recorder(model, sensors, 5, poses=False)
    recorder.start()
    for _ in sim.advance(recorder, 20, 5, start=0.0):
        pass
    stepper = stepper_of(sim)
    assert bool(stepper._after_look) == (sensors == ["touch.normal_force"])
    assert {one.kernel for launches in stepper.launches() for one in launches} <= set(ahead)
