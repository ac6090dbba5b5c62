"""The fused kernel of narrow phase and contact force gives the results of separate kernels."""

import numpy as np
import pytest
from case_marks import slow_except
from gpu_schedule_on_cpu import build_all_face_grids, use_work_queues
from test_fused_step_gpu import ENVS, HILLS, MATERIAL, SINGLE_BODY_SCENES, STATE, STUCK

import warpcontact as wc
from warpcontact.model.model import ZERO_WITHOUT_CONTACT

pytestmark = [pytest.mark.launch_shapes, pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")]


def balls(material=MATERIAL):
    """Several balls on hills, each with one contact; two are next to the boundary."""

    def make(scene):
        ground = scene.add_surface(HILLS, name="ground")
        places = [(0.19 * x, 0.19 * y, 0.35 + 0.19 * z) for x in range(2) for y in range(2) for z in range(2)]
        places += [(1.95, 0.0, 0.3), (2.3, 0.0, 0.3)]
        heap = scene.add_bodies(places, 1.0, [4e-3] * 3, name="body")
        scene.add_contact(scene.add_point(heap, (0, 0, 0)), ground, material, radius=0.1, name="touch")
        scene.add_particle_contact(scene.add_shape(heap, wc.shapes.Sphere(0.1)), material, name="heap")

    return make


def two_laws(scene):
    """A box with two contact sets of different materials."""
    SINGLE_BODY_SCENES["points in clusters"](scene)
    scene.add_contact(
        scene.add_points(scene.bodies[0], [(0.1, 0.1, -0.1), (-0.1, -0.1, -0.1)]),
        scene.surfaces[0],
        STUCK,
        radius=0.02,
        name="feet",
    )


MANY = {"balls": balls(), "balls that stick": balls(STUCK), "two laws": two_laws}


def run_model(make, device, precision, *, fused, monitored):
    """Returns states, and contact sensors between steps, of steps with or without the fused contact kernel."""
    scene = wc.Scene()
    make(scene)
    model = scene.build(envs=ENVS, precision=precision, device=device)
    rng = np.random.default_rng(1)
    velocity = model["body.linear_velocity"]
    model["body.linear_velocity"] = velocity + rng.normal(0, 0.7, (ENVS, *velocity.shape[1:]))
    shape = "auto" if fused else "staged"
    sim = wc.Simulation(model, dt=1e-3, deterministic=True, launch_shape=shape)
    names = [f"{contact.name}.{key}" for contact in scene.contacts for key in ZERO_WITHOUT_CONTACT]
    sensors = []
    for _ in range(6):
        sim.step(97)
        if monitored:
            # Evaluated sensors become cached data, also for contacts that cannot touch yet.
            sensors += [model.sensor(name) for name in names]
    assert any((model.sensor(name) > 0).any() for name in names if name.endswith("normal_force"))
    kernels = {launch.kernel.key.split("__")[-1] for launch in sim._prepared[1]._steppers[0]._steps[0].full}
    assert fused == bool(kernels & {"update_sets", "fused_in_grid", "fused_steps"}), kernels
    return [model.sensor(f"body.{key}") for key in STATE], sensors


@pytest.mark.parametrize("monitored", [False, True], ids=["not_monitored", "monitored"])
@pytest.mark.parametrize(
    ("name", "precision"),
    [
        *((name, "float32") for name in [*SINGLE_BODY_SCENES, *MANY]),
        ("points in clusters", "float64"),
        *slow_except(
            [(name, "float64") for name in [*SINGLE_BODY_SCENES, *MANY] if name != "points in clusters"],
            lambda case: False,
        ),
    ],
)
def test_fused_contact_on_cpu_equals_staged_contact(name, precision, monitored):
    make = {**SINGLE_BODY_SCENES, **MANY}[name]
    states, sensors = run_model(make, "cpu", precision, fused=True, monitored=monitored)
    others, also = run_model(make, "cpu", precision, fused=False, monitored=monitored)
    for left, right in zip(states + sensors, others + also, strict=True):
        np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("monitored", [False, True], ids=["not_monitored", "monitored"])
@pytest.mark.parametrize("few", [131072, 0], ids=["few", "many"])
@pytest.mark.parametrize(
    "name", slow_except(["balls", "balls that stick"], lambda name: name == "balls that stick")
)
def test_fused_contact_on_gpu_equals_staged_contact(name, few, monitored, monkeypatch, device):
    if device == "cpu":
        build_all_face_grids(monkeypatch)
        use_work_queues(monkeypatch)
    monkeypatch.setattr("warpcontact.forces.launch_shape.SMALL_LAUNCH", few)
    states, sensors = run_model(MANY[name], device, "float32", fused=True, monitored=monitored)
    others, also = run_model(MANY[name], device, "float32", fused=False, monitored=monitored)
    for left, right in zip(states + sensors, others + also, strict=True):
        np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
@pytest.mark.parametrize("fused", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_culling_of_many_contacts_on_gpu_matches_few_contacts(fused, precision, monkeypatch, device):
    """Results equal those of few contacts, whose gap is evaluated in each step; larger radii clear the cache."""
    if device == "cpu":
        build_all_face_grids(monkeypatch)
        use_work_queues(monkeypatch)
    ends = []
    for few in (131072, 0):
        monkeypatch.setattr("warpcontact.forces.launch_shape.SMALL_LAUNCH", few)
        scene = wc.Scene()
        balls()(scene)
        model = scene.build(envs=ENVS, precision=precision, device=device)
        shape = "auto" if fused else "staged"
        sim = wc.Simulation(model, dt=1e-3, deterministic=True, launch_shape=shape)
        kept = []
        for radius in (0.1, 0.12, 0.1, 0.12):
            model["touch.radius"] = radius
            assert not model.arrays.cache.clearance.numpy().any()
            sim.step(80)
            kept.append(int((model.arrays.cache.clearance.numpy() > 0).sum()))
        assert [number > 0 for number in kept] == [few == 0] * 4
        ends.append([model.sensor(f"body.{key}") for key in STATE])
    for one, other in zip(*ends, strict=True):
        np.testing.assert_array_equal(one, other)
