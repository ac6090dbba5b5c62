"""Compilation of kernels: parallel on a CPU before the first step; without FMA contraction on a GPU."""

import os
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import warp as wp
from nonsmooth_scenes import block
from test_fused_contact import balls
from test_step_schedules import STUCK, falling_on, two_bodies
from warpcontact.kernels.integrators import semi_implicit

import warpcontact as wc
from warpcontact.forces import contact_groups
from warpcontact.forces.couplings import springs
from warpcontact.forces.joints import joint_data
from warpcontact.forces.shape_contact import contact_sets
from warpcontact.stepping import staged_start
from warpcontact.system.compilation import load_all
from warpcontact.system.kernel_builds import current_build

CPU = SimpleNamespace(is_cuda=False, is_cpu=True)


@pytest.mark.parametrize("threads", [1, 64, 256])
def test_fma_is_disabled_on_gpu_only(threads):
    kernel = semi_implicit.semi_implicit_euler(wp.float32)
    of_cpu = kernel.module.get_module_hash(threads)
    build = current_build(kernel, SimpleNamespace(is_cuda=True, is_cpu=False))
    assert not build.module.resolve_options(wp.config, threads)["fuse_fp"]
    assert build.module.get_module_hash(threads) != of_cpu
    # The options of a build do not change, because processes in the background compile it.
    assert kernel.module.resolve_options(wp.config, threads)["fuse_fp"]
    assert kernel.module.get_module_hash(threads) == of_cpu
    assert build.options.get("cuda_max_registers") == kernel.options.get("cuda_max_registers")


class Kernel:
    """A stand-in for a kernel, with a module that ``load`` loads."""

    def __init__(self, load):
        self.module = SimpleNamespace(hashers={}, load=lambda *_, **__: load())


def test_kernels_are_compiled_in_parallel():
    all_at_once = threading.Barrier(3)
    load_all([Kernel(lambda: all_at_once.wait(timeout=60)) for _ in range(3)], CPU, 3)


def test_each_kernel_is_compiled_once_and_in_one_thread_if_single_threaded():
    loaded = []

    def load(number):
        loaded.append((number, threading.current_thread()))

    kernels = [Kernel(lambda number=number: load(number)) for number in range(5)]
    load_all([*kernels, *kernels], CPU, 1)
    assert loaded == [(number, threading.current_thread()) for number in range(5)]
    loaded.clear()
    load_all([*kernels, *kernels], CPU, 3)
    assert sorted(number for number, _ in loaded) == list(range(5))
    load_all([], CPU, 3)


@pytest.mark.parametrize("place", [0, 1], ids=["same thread", "another thread"])
def test_compilation_error_is_raised_and_stops_further_compilation(place):
    begun, failed, more = threading.Event(), threading.Event(), []

    def fails():
        assert begun.wait(timeout=60)
        threading.Timer(0.2, failed.set).start()
        raise ValueError("no such law")

    def takes_longer():
        begun.set()
        assert failed.wait(timeout=60)

    kernels = [Kernel(takes_longer), Kernel(lambda: more.append(1))]
    kernels.insert(place, Kernel(fails))
    with pytest.raises(ValueError, match="no such law"):
        load_all(kernels, CPU, 2)
    assert not more


def test_process_can_end_with_a_step():
    # No thread can be started at interpreter shutdown.
    code = """
import threading, time, warpcontact as wc
scene = wc.Scene()
scene.add_body(1.0, (1, 1, 1), name="body")
sim = wc.Simulation(scene.build(envs=1, device="cpu"), dt=1e-3)

def late():
    threading.main_thread().join()
    sim.step()
    print(sim.steps, "step")

threading.Thread(target=late).start()
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "1 step" in ended.stdout, ended.stderr


def particles():
    scene = wc.Scene()
    balls()(scene)
    return wc.Simulation(scene.build(envs=3, device="cpu"), dt=1e-3)


def crossing():
    scene = falling_on(wc.meshes.grid((4, 4), (5, 5)), material=STUCK, swept=True)()
    return wc.Simulation(scene.build(envs=3, device="cpu"), dt=1e-3, crossing_substeps=3)


def bodies():
    outcomes = {"highest": wc.outcomes.Max("upper.normal_force")}
    return wc.Simulation(two_bodies().build(envs=3, device="cpu"), dt=1e-3, outcomes=outcomes)


def nonsmooth():
    integrator = wc.integrators.MoreauJean()
    return wc.Simulation(block(0.3, envs=3, device="cpu"), dt=1e-3, integrator=integrator)


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
@pytest.mark.parametrize("make", [particles, crossing, bodies, nonsmooth])
def test_all_step_and_frame_kernels_are_precompiled(make, monkeypatch):
    compiled = set()

    def load_them(kernels, device, threads, **options):
        kernels = list(kernels)
        compiled.update(kernels)
        load_all(kernels, device, threads, **options)

    monkeypatch.setattr(staged_start, "load_all", load_them)
    sim = make()
    sensor = next(name for name in sim.model.sensor_names if name.endswith("normal_force"))
    recording = sim.run(0.02, record=[sensor], every=5e-3)
    assert np.isfinite(recording[sensor]).all()
    (stepper, *_) = sim._prepared[1]._steppers
    launches = [*stepper.launches(), *stepper._evaluations.values(), stepper._step_after_evaluation]
    launched = {launch.kernel for some in launches for launch in some}
    assert len(launched) > 3
    # The kernel that copies a frame compiles in negligible time.
    assert {kernel.key for kernel in launched - compiled} <= {"record_frame__locals__take_frame"}


class OwnLaw(wc.Law):
    stiffness: float = wc.parameter("N/m", "stiffness")

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.penetration


def all_kinds(law):
    """Point, shape and particle contact, a spring and a joint with models of the library, except the normal law."""
    scene = wc.Scene()
    material = wc.ContactMaterial(law=law, friction=wc.friction.Tanh(mu=0.3, velocity_scale=0.1))
    ground = scene.add_surface(wc.meshes.grid((4.0, 4.0)))
    slow = wc.motions.Harmonic(direction=(0, 0, 1), amplitude=0.1, frequency=1.0)
    ball, other, moved = (
        scene.add_body(1.0, (1, 1, 1), (x, 0, 1), motion=motion) for x, motion in ((0, None), (1, None), (2, slow))
    )
    middle = scene.add_point(ball, (0, 0, 0))
    scene.add_contact(middle, ground, material, radius=0.1)
    round_ones = [scene.add_shape(body, wc.shapes.Sphere(0.1)) for body in (ball, other, moved)]
    scene.add_shape_contact(round_ones[0], round_ones[2], material)
    scene.add_particle_contact(round_ones[:2], material)
    scene.add_spring_damper(middle, scene.add_point(None, (0, 0, 2)), spring=wc.springs.Linear(stiffness=1.0))
    return scene


@pytest.mark.parametrize(("law", "compiled"), [(wc.laws.Hooke, 0), (OwnLaw, 3)])
def test_build_compiles_kernels_of_custom_classes(law, compiled, monkeypatch):
    loaded = []
    for module in (contact_groups, joint_data, contact_sets, springs):
        monkeypatch.setattr(module, "load", lambda kernel, device: loaded.append(kernel))
    all_kinds(law(stiffness=1e4)).build(device="cpu")
    assert len(loaded) == compiled


BOUNCE = """
import sys
import warpcontact as wc
sys.path.insert(0, sys.argv[1])
from scenes import dropped_sphere
law = wc.laws.HuntCrossley(stiffness=1e5, restitution=0.6)
model = dropped_sphere(law, envs=3, velocity=(0.3, 0.0, -1.0), device="cpu")
model["ball.mass"] = [0.5, 1.0, 2.0]
wc.Simulation(model, dt=1e-4).step(800)
assert (model.sensor("ball.linear_velocity")[:, 2] > 0.0).all()
keys = ("position", "orientation", "linear_velocity", "angular_velocity")
print(b"".join(model.sensor(f"ball.{key}").tobytes() for key in keys).hex())
"""


def run_with(mode, code, *words):
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, *words],
        env={**os.environ, "WARPCONTACT_COMPILE": mode},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_quick_and_release_kernels_give_bitwise_identical_results():
    modes = ("quick", "release", "background")
    found = [run_with(mode, BOUNCE, str(Path(__file__).parents[1])) for mode in modes]
    assert [one.returncode for one in found] == [0, 0, 0], "".join(one.stderr for one in found)
    assert len({one.stdout.split()[-1] for one in found}) == 1


def test_unknown_compile_mode_is_refused():
    result = run_with("fast", "import warpcontact.kernels.lowlevel.unique_kernel")
    assert result.returncode == 1
    assert "WARPCONTACT_COMPILE must be one of background, release, quick, got 'fast'" in result.stderr
