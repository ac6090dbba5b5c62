"""Fused step of single-body environments on a GPU, here run on a CPU with warps of one thread."""

import numpy as np
import pytest
import warp as wp
from case_marks import slow_except
from gpu_schedule_on_cpu import build_all_face_grids, use_work_queues

import warpcontact as wc
from warpcontact.forces import execution_plan, launch_shape
from warpcontact.stepping.integrators import SemiImplicitEuler

pytestmark = pytest.mark.launch_shapes
STATE = ("position", "orientation", "linear_velocity", "angular_velocity")
MATERIAL = wc.ContactMaterial(
    law=wc.laws.KelvinVoigt(stiffness=2e3, damping=4.0),
    friction=wc.friction.Tanh(mu=0.5, velocity_scale=0.01),
)
STUCK = wc.ContactMaterial(
    law=wc.laws.HuntCrossley(stiffness=2e4, restitution=0.5),
    friction=wc.friction.CundallStrack(mu_static=0.6, mu_dynamic=0.4, stiffness=1e3, damping=1.0),
    rolling=wc.friction.Tanh(mu=0.05, velocity_scale=0.01),
    torsion=wc.friction.CundallStrack(mu_static=0.2, mu_dynamic=0.1, stiffness=1e2, damping=0.1),
)
HILLS = wc.meshes.sinusoidal_terrain((4, 4), (30, 30), amplitude=0.15, wavelength=1.3)
ENVS = 45


def box(count, material=MATERIAL, radius=0.01, **body):
    """A box of points on hills."""

    def make(scene):
        ground = scene.add_surface(HILLS, name="ground")
        body_ = scene.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 0.5), name="body", **body)
        points = np.random.default_rng(3).uniform(-0.1, 0.1, (count, 3))
        points[np.arange(count), np.arange(count) % 3] = np.where(np.arange(count) % 2, 0.1, -0.1)
        scene.add_contact(scene.add_points(body_, points), ground, material, radius=radius, name="touch")

    return make


def box_with_areas(scene):
    """A box whose contacts have area weights of the part that faces the ground."""
    ground = scene.add_surface(HILLS, name="ground")
    body = scene.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 0.5), name="body")
    shell = scene.add_surface(wc.meshes.box((0.2, 0.2, 0.2)), body, name="shell")
    law = wc.laws.ElasticFoundation(stiffness=4e4, damping=200.0)
    scene.add_surface_contact(shell, ground, wc.ContactMaterial(law=law), samples=30, name="touch")


def body_with_surface(scene):
    """A ball with a triangle mesh among points that are fixed to the world."""
    body = scene.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 0.6), name="body")
    shell = scene.add_surface(wc.meshes.icosphere(0.3, 3), body, name="shell")
    line = np.linspace(-0.6, 0.6, 6)
    x, y = (grid.ravel() for grid in np.meshgrid(line, line))
    points = scene.add_points(None, np.stack([x, y, 0.2 * (x**2 + y**2)], axis=1))
    scene.add_contact(points, shell, STUCK, radius=0.02, name="touch")


SINGLE_BODY_SCENES = {
    "sphere": box(1, radius=0.09),
    "few points": box(6),
    "points in clusters": box(60),
    "with history": box(20, STUCK),
    "sphere with history": box(1, STUCK, radius=0.09),
    "box with external force": box(12, external_force=(1.0, 0.0, 0.5), external_torque=(0.0, 0.02, 0.0)),
    "box with area weights": box_with_areas,
    "body with the surface": body_with_surface,
}


def built(make, device, precision="float32"):
    scene = wc.Scene()
    make(scene)
    model = scene.build(envs=ENVS, precision=precision, device=device)
    rng = np.random.default_rng(1)
    position = model["body.position"]
    position += rng.uniform((-0.5, -0.5, 0.0), (0.5, 0.5, 0.3), (ENVS, 3))
    model["body.position"] = position
    model["body.linear_velocity"] = rng.normal(0, 0.7, (ENVS, 3))
    model["body.angular_velocity"] = rng.normal(0, 2.0, (ENVS, 3))
    return model


def states(model):
    return [model.sensor(f"body.{key}") for key in STATE]


def assert_same(left, right):
    for value, other in zip(left, right, strict=True):
        np.testing.assert_array_equal(value, other)


@pytest.fixture
def fused_launches(monkeypatch, device):
    """Makes a CPU step as a GPU does; collects the kernels of the prepared steps."""
    kernels = []
    prepare = SemiImplicitEuler.step_stages

    def outcome_name(*args, **options):
        launches = prepare(*args, **options)
        if all(isinstance(launch, wp.Launch) for launch in launches):
            kernels.append([launch.kernel.key.split("__")[-1] for launch in launches])
        return launches

    if device == "cpu":
        build_all_face_grids(monkeypatch)
        use_work_queues(monkeypatch)
    monkeypatch.setattr(SemiImplicitEuler, "step_stages", outcome_name)
    return kernels


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
# Scenes of other structure run only with --thorough, and all of them on a GPU.
@pytest.mark.parametrize(
    ("name", "precision"),
    slow_except(
        [
            *((name, "float32") for name in SINGLE_BODY_SCENES),
            ("sphere", "float64"),
            ("points in clusters", "float64"),
        ],
        lambda case: case in [(name, "float32") for name in ("sphere", "points in clusters", "with history")],
    ),
)
def test_fused_step_equals_staged_step(name, precision, device, fused_launches, monkeypatch):
    # As on a GPU: warps of 22 environments, and one warp with the remainder.
    monkeypatch.setattr(execution_plan, "FULL_WARPS", 2)
    model = built(SINGLE_BODY_SCENES[name], device, precision)
    sim = wc.Simulation(model, dt=1e-3)
    uncached = wc.Simulation(
        other := built(SINGLE_BODY_SCENES[name], device, precision), dt=1e-3, distance_cache=False
    )
    touched = np.zeros(ENVS, dtype=bool)
    for _ in range(6):
        sim.step(100)
        uncached.step(100)
        assert_same(states(model), states(other))
        touched |= (model.sensor("touch.normal_force") > 0).any(axis=1)
        np.testing.assert_array_equal(model.sensor("touch.gap"), other.sensor("touch.gap"))
        np.testing.assert_array_equal(model.sensor("touch.friction_force"), other.sensor("touch.friction_force"))
    assert touched.sum() >= 8
    assert ["fused_step"] in fused_launches


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
@pytest.mark.parametrize("few", [True, False], ids=["small", "large"])
@pytest.mark.parametrize(
    "name",
    slow_except(["sphere", "points in clusters", "with history"], lambda name: name == "points in clusters"),
)
def test_fused_and_monitored_steps_can_alternate(name, few, device, fused_launches, monkeypatch):
    """Both variants maintain distances and contact history for each other; monitors see no outdated contacts."""
    if not few:
        monkeypatch.setattr(launch_shape, "SMALL_LAUNCH", 0)
    outcomes = {
        "most": wc.outcomes.Max("touch.normal_force"),
        "least": wc.outcomes.Min("touch.approach_speed"),
        "deepest": wc.outcomes.Max("touch.penetration"),
    }

    def both(model, **options):
        return {
            key: wc.Simulation(model, dt=1e-3, outcomes=key and outcomes, **options) for key in (None, "watched")
        }

    simulations = both(model := built(SINGLE_BODY_SCENES[name], device))
    uncached = both(other := built(SINGLE_BODY_SCENES[name], device), distance_cache=False)
    rng = np.random.default_rng(2)
    for piece in range(40):
        key = "watched" if piece % 2 else None
        count = int(rng.integers(1, 30))
        for own in (simulations, uncached):
            own[key].step(count)
        if piece % 3 == 0:
            assert_same(states(model), states(other))
        if key:
            for outcome_name in outcomes:
                found, due = (own[key].outcomes()[outcome_name].values for own in (simulations, uncached))
                np.testing.assert_array_equal(found, due, err_msg=f"{outcome_name} of piece {piece}")
    assert {len(kernels) > 1 for kernels in fused_launches} == {True, False}


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
def test_fused_step_uses_changes_made_between_steps(device, fused_launches):
    def raised(model):
        model["body.position"] = model.sensor("body.position") + np.array([0.0, 0.0, 0.02])

    def left_out(model):
        model["touch.enabled"] = np.arange(ENVS) % 2

    def let_in(model):
        model["touch.enabled"] = 1

    def larger(model):
        model["touch.radius"] = 0.015

    def shared(model):
        model["touch.force_scale"] = 0.5

    changes = [raised, left_out, let_in, larger, shared, lambda model: model.reset(np.arange(ENVS) % 3 == 0)]
    simulations = [
        wc.Simulation(built(SINGLE_BODY_SCENES["with history"], device), dt=1e-3, **options)
        for options in ({}, {"distance_cache": False})
    ]
    for change in changes:
        for sim in simulations:
            sim.step(150)
            change(sim.model)
            sim.step(50)
        assert_same(states(simulations[0].model), states(simulations[1].model))
    assert ["fused_step"] in fused_launches


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
def test_failed_fused_step_keeps_last_valid_state(device, fused_launches):
    model = built(SINGLE_BODY_SCENES["with history"], device)
    sim = wc.Simulation(model, dt=1e-3)
    uncached = wc.Simulation(
        other := built(SINGLE_BODY_SCENES["with history"], device), dt=1e-3, distance_cache=False
    )
    for one in (sim, uncached):
        one.step(400)
        touching = int((one.model.sensor("touch.normal_force") > 0).any(axis=1).argmax())
        force = np.zeros((ENVS, 3))
        force[touching] = 1e30
        one.model["body.external_force"] = force
        one.step(5)
        assert one.model.health().frozen.tolist() == [touching]
    assert_same(states(model), states(other))
    for name in ("entry_speed", "armed"):
        ours, theirs = (getattr(one.arrays.history, name).numpy()[touching] for one in (model, other))
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(model.sensor("touch.normal_force"), other.sensor("touch.normal_force"))


def two_bodies(scene):
    SINGLE_BODY_SCENES["few points"](scene)
    scene.add_body(1.0, (1e-3, 1e-3, 1e-3), name="other")


def with_a_joint(scene):
    box(6, motion=wc.motions.Hinge(axis=(0, 1, 0), anchor=(0.3, 0, 0.5)))(scene)


def with_a_spring(scene):
    SINGLE_BODY_SCENES["few points"](scene)
    body = scene.bodies[0]
    ends = (scene.add_point(body, (0, 0, 0)), scene.add_point(None, (0, 0, 2)))
    scene.add_spring_damper(*ends, stiffness=10.0, damping=1.0, rest_length=1.0, name="spring")


def on_two_surfaces(scene):
    SINGLE_BODY_SCENES["few points"](scene)
    wall = scene.add_surface(wc.meshes.grid((4, 4), (3, 3)), position=(0, 0, -1), name="wall")
    scene.add_contact(scene.points[0], wall, MATERIAL, name="second")


def with_a_latch(scene):
    ground = scene.add_surface(HILLS, name="ground")
    body = scene.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 0.5), name="body")
    scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, MATERIAL, entry="latched", name="touch")


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
@pytest.mark.parametrize(
    "make",
    slow_except(
        [two_bodies, with_a_joint, with_a_spring, on_two_surfaces, with_a_latch],
        lambda make: make is with_a_spring,
    ),
)
def test_scenes_without_fused_step_use_several_launches(make, device, fused_launches):
    scene = wc.Scene()
    make(scene)
    wc.Simulation(scene.build(envs=2, device=device), dt=1e-3).step(2)
    assert fused_launches
    assert all("fused_step" not in kernels for kernels in fused_launches)
