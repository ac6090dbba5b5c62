"""Launches of all launch shapes name the arguments of their kernels; nothing is compiled."""

import pytest
from gpu_schedule_on_cpu import build_all_face_grids
from test_fused_step_gpu import HILLS, MATERIAL, SINGLE_BODY_SCENES

import warpcontact as wc
from warpcontact.forces import launch_shape
from warpcontact.stepping.requirements import KernelLister
from warpcontact.stepping.slice_stepper import StepBuffers, Stepper


def spheres(scene):
    """Several bodies with one contact each."""
    ground = scene.add_surface(HILLS, name="ground")
    for number in range(3):
        ball = scene.add_body(1.0, (4e-3, 4e-3, 4e-3), position=(number, 0.0, 0.5))
        scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, MATERIAL, radius=0.1)


SCENES = {name: SINGLE_BODY_SCENES[name] for name in ("sphere", "points in clusters")} | {"spheres": spheres}
CASES = [(scene, grids, small) for scene in SCENES for grids in (False, True) for small in (False, True)]


def kernels_of(model, *, queues, fused, cached=True):
    """Returns the names of the kernels of all launches of a simulation."""
    buffers = StepBuffers(model, integrator := wc.integrators.SemiImplicitEuler())
    plan = KernelLister(
        model,
        count=1,
        uses_cache=cached,
        ordered_sum=not queues,
        one_thread_per_contact=queues,
        write_outputs=False,
        semi_implicit_euler=True,
        fastest_shape=launch_shape.AUTO if fused else launch_shape.STAGED,
    )
    stepper = Stepper(plan, integrator, buffers, substeps=1, captured=False)
    return {kernel.key.split("__")[-1] for kernels in stepper.launches() for kernel in kernels}


@pytest.mark.parametrize(("name", "grids", "small"), CASES)
def test_launches_of_all_shapes_name_the_arguments_of_their_kernels(name, grids, small, monkeypatch):
    monkeypatch.setattr(launch_shape, "FUSE_STAGES", True)
    if grids:
        build_all_face_grids(monkeypatch)
    if not small:
        monkeypatch.setattr(launch_shape, "SMALL_LAUNCH", 0)
    scene = wc.Scene()
    SCENES[name](scene)
    model = scene.build(envs=2, device="cpu")
    found = {
        (queues, fused): kernels_of(model, queues=queues, fused=fused)
        for queues in (False, True)
        for fused in (False, True)
    }
    assert "closest_point" in kernels_of(model, queues=True, fused=False, cached=False)
    assert "contact_force" in found[False, False] & found[True, False]
    fused_on_cpu = "update_sets" if name == "spheres" else "fused_steps"
    fused_on_gpu = ("fused_in_grid" if name == "spheres" else "fused_step") if grids else "process_contacts"
    assert fused_on_cpu in found[False, True] or grids
    assert fused_on_gpu in found[True, True]
