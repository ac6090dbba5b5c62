"""Steps start with quick builds of staged kernels and take release builds, with bitwise identical results."""

import numpy as np
import pytest
from test_fused_contact import MANY
from test_fused_step_gpu import SINGLE_BODY_SCENES, assert_same, built, states
from test_fused_steps_cpu import contact_sensors, kernels_of

import warpcontact as wc
from warpcontact.forces.launch_shape import FUSED_CONTACT, LOOP_PER_ENVIRONMENT, STAGED
from warpcontact.stepping import staged_start
from warpcontact.stepping.recorder import Recorder
from warpcontact.validation.warning_levels import RunWarning

pytestmark = [pytest.mark.launch_shapes, pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")]


class Compiler:
    """Stands for the background compiler: requested kernels are compiled on command."""

    def __init__(self):
        self.requests = []
        self.compiled = set()

    def request(self, kernels):
        missing = set(kernels) - self.compiled
        self.requests.append(Request(self, missing))
        return self.requests[-1]

    def finish(self, error=""):
        """Finishes all requests."""
        for request in self.requests:
            request.error = error
            self.compiled |= request.kernels if not error else set()
            request.is_done = True


class Request:
    def __init__(self, compiler, kernels):
        self.kernels, self.count, self.error, self.is_done = kernels, len(kernels), "", False

    @property
    def compiled(self):
        return self.count if self.is_done else 0


@pytest.fixture
def compiler(monkeypatch):
    """A simulation starts with staged kernels until ``finish`` is called."""
    one = Compiler()
    monkeypatch.setattr(staged_start, "starts_quick", lambda device: True)
    monkeypatch.setattr(staged_start, "is_compiled", lambda kernel: kernel in one.compiled)
    monkeypatch.setattr(staged_start, "request", one.request)
    return one


def many_bodies(name):
    scene = wc.Scene()
    MANY[name](scene)
    model = scene.build(envs=5, device="cpu")
    velocity = model["body.linear_velocity"]
    model["body.linear_velocity"] = velocity + np.random.default_rng(1).normal(0, 0.7, (5, *velocity.shape[1:]))
    return model


MODELS = {
    **{name: lambda name=name: built(SINGLE_BODY_SCENES[name], "cpu") for name in SINGLE_BODY_SCENES},
    "balls that stick": lambda: many_bodies("balls that stick"),
}


@pytest.mark.parametrize("graphs", [True, False], ids=["graphs", "launches"])
@pytest.mark.parametrize("name", MODELS)
def test_launch_shape_changes_during_a_run_without_changing_results(name, graphs, compiler):
    model, other = MODELS[name](), MODELS[name]()
    sim = wc.Simulation(model, dt=1e-3, capture_graphs=graphs)
    reference = wc.Simulation(other, dt=1e-3, launch_shape=STAGED)
    single = model.body_count == 1
    for count in (1, 150, 30):
        sim.step(count)
        reference.step(count)
    assert sim.explain().parts[0].present_shape.name == STAGED
    assert "fused_steps" not in kernels_of(sim)
    compiler.finish()
    touched = False
    for count in (1, 8, 150, 250):
        sim.step(count)
        reference.step(count)
        assert_same(states(model), states(other))
        if single:
            assert_same(contact_sensors(model), contact_sensors(other))
            touched |= bool((model.sensor("touch.normal_force") > 0).any())
        np.testing.assert_array_equal(model.arrays.time.numpy(), other.arrays.time.numpy())
    expected = LOOP_PER_ENVIRONMENT if single else FUSED_CONTACT
    (part,) = sim.explain().parts
    assert (part.shape.name, part.present_shape.name) == (expected, expected)
    assert kernels_of(sim) & ({"fused_steps"} if single else {"update_sets"})
    assert touched or not single


@pytest.mark.parametrize("every", [1, 7, 70])
def test_launch_shape_changes_between_frames_without_changing_frames(every, compiler):
    def recorded(finish):
        model = built(SINGLE_BODY_SCENES["with history"], "cpu")
        sim = wc.Simulation(model, dt=1e-3, launch_shape="auto" if finish else STAGED)
        recorder = Recorder(
            model, ["body.position", "touch.normal_force", "scene.kinetic_energy"], 420 // every + 1, poses=False
        )
        recorder.start()
        for done in sim.advance(recorder, 420, every, start=0.0, exclusive=True):
            if done > 100 and finish:
                compiler.finish()
        return kernels_of(sim), [*states(model), *recorder.frames().values()]

    kernels, own = recorded(finish=True)
    assert kernels == {"fused_steps"}
    assert_same(own, recorded(finish=False)[1])


def test_builds_are_requested_after_the_first_chunks_and_those_of_steps_first(compiler):
    sim = wc.Simulation(MODELS["with history"](), dt=1e-3)
    for _ in range(2):
        sim.step()
        assert not compiler.requests
    explanation = str(sim.explain())
    assert explanation.endswith("present steps use quick builds of kernels")
    assert "kernels of a step:\n    fused_steps (kernels/launch_shapes/fused_steps_cpu.py)\n" in explanation
    assert "until these are compiled:\n    add_travel (kernels/broadphase/motion_bound.py)\n" in explanation
    sim.step()
    for_steps, others = compiler.requests
    assert {kernel.key.split("__")[-1] for kernel in for_steps.kernels} == {"fused_steps"}
    assert for_steps.kernels <= others.kernels
    assert str(sim.explain()).endswith(f"compiled in the background: 0 of {others.count} kernels")
    compiler.finish()
    sim.step()
    assert "background" not in str(sim.explain())
    assert "quick" not in str(sim.explain())


def test_compiled_kernels_are_used_at_once(compiler, monkeypatch):
    monkeypatch.setattr(staged_start, "is_compiled", lambda kernel: True)
    sim = wc.Simulation(MODELS["with history"](), dt=1e-3)
    sim.step(3)
    assert kernels_of(sim) == {"fused_steps"}
    assert not compiler.requests


def test_compile_takes_release_builds_at_once(compiler):
    model, other = MODELS["with history"](), MODELS["with history"]()
    sim, reference = wc.Simulation(model, dt=1e-3), wc.Simulation(other, dt=1e-3, launch_shape=STAGED)
    for one in (sim, reference):
        one.step(30)
    sim.compile()
    sim.compile()
    assert kernels_of(sim) == {"fused_steps"}
    for one in (sim, reference):
        one.step(200)
    assert_same(states(model), states(other))


def test_failed_compilation_is_reported_and_steps_remain_staged(compiler):
    model, other = MODELS["with history"](), MODELS["with history"]()
    sim, reference = wc.Simulation(model, dt=1e-3), wc.Simulation(other, dt=1e-3, launch_shape=STAGED)
    for count in (1, 1, 1, 200):
        reference.step(count)
    for _ in range(3):
        sim.step()
    compiler.finish("fused_steps: no memory")
    with pytest.warns(
        RunWarning, match=r"could not be compiled in the background: fused_steps: no memory\. Steps cont"
    ):
        sim.step(200)
    assert "fused_steps" not in kernels_of(sim)
    assert_same(states(model), states(other))


def test_several_simulations_of_a_model_change_their_launch_shapes_separately(compiler):
    model, other = MODELS["with history"](), MODELS["with history"]()
    first, second = wc.Simulation(model, dt=1e-3), wc.Simulation(model, dt=1e-3)
    reference = wc.Simulation(other, dt=1e-3, launch_shape=STAGED)
    for sim in (first, second, first):
        sim.step(60)
    compiler.finish()
    second.step(60)
    assert kernels_of(second) == {"fused_steps"}
    assert "fused_steps" not in kernels_of(first)
    first.step(60)
    assert kernels_of(first) == {"fused_steps"}
    reference.step(300)
    assert_same(states(model), states(other))
