"""Launch shapes of a CUDA device give bitwise the results of one kernel per stage on the same device.

The staged step queries the closest point of every contact and launches one kernel per stage. Each case runs once
with the staged step and once with the launch shape that ``launch_shape.choose_shape`` selects, and checks the
names of their kernels. ``.ci/gpu`` runs these tests, with ``--device cuda:0 --kernels=release``.
"""

import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from warpcontact.kernels.particles.base import WAS_IN_CONTACT

import warpcontact as wc
from warpcontact.benchmark.scenes import DT
from warpcontact.benchmark.simulation import simulation
from warpcontact.forces import execution_plan, launch_shape
from warpcontact.forces.launch_shape import STAGED, choose_shape
from warpcontact.forces.particle_contact.contact_set import ParticleContactSet

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
pytestmark = [
    pytest.mark.usefixtures("cuda"),
    pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning"),
    pytest.mark.skipif(not BENCHMARKS.is_dir(), reason="benchmark scenes are in a checkout only"),
]

LANES = 32
ENVS = 45
# Benchmark bodies fall for 0.29 s before the first contact.
STEPS, PARTS = 600, 6
GRAVITY = np.array([0.0, 0.0, -9.81])
SENSORS = (
    "gap", "penetration", "normal", "point", "status", "normal_force", "friction_force", "approach_speed",
    "slip_speed", "torque",
)  # fmt: skip
PARTICLE_SENSORS = ("contacts", "coordination", "normal_force", "max_penetration", "force")

# Kernels of the launch shapes that are selected for many threads only.
GPU_KERNELS = frozenset(
    {
        "fused_step", "fused_in_grid", "fused_remaining", "detect_in_grid", "detect_remaining", "enqueue_contacts",
        "probe_cluster_centers", "process_contacts", "compact_contacts",
    }
)  # fmt: skip
FUSED_STEP = frozenset({"fused_step"})
FUSED_CONTACT = frozenset({"fused_in_grid"})
GRID = frozenset({"detect_in_grid"})
QUEUES = frozenset({"enqueue_contacts", "probe_cluster_centers", "process_contacts", "compact_contacts"})

HILLS = wc.meshes.sinusoidal_terrain((4, 4), (30, 30), amplitude=0.15, wavelength=1.3)
SMOOTH = wc.ContactMaterial(
    law=wc.laws.KelvinVoigt(stiffness=2e3, damping=4.0),
    friction=wc.friction.Tanh(mu=0.5, velocity_scale=0.01),
)
# Friction and torsion have history variables.
STICKING = wc.ContactMaterial(
    law=wc.laws.HuntCrossley(stiffness=2e4, restitution=0.5),
    friction=wc.friction.CundallStrack(mu_static=0.6, mu_dynamic=0.4, stiffness=1e3, damping=1.0),
    rolling=wc.friction.Tanh(mu=0.05, velocity_scale=0.01),
    torsion=wc.friction.CundallStrack(mu_static=0.2, mu_dynamic=0.1, stiffness=1e2, damping=0.1),
)


@pytest.fixture(scope="session")
def cuda(device):
    """The CUDA device under test."""
    if not device.startswith("cuda"):
        pytest.skip("needs --device cuda:N: these launch shapes are selected on a CUDA device only")
    if not launch_shape.FUSE_STAGES:
        pytest.fail("needs --kernels=release: with quick kernels all steps are staged")
    return device


def points_of_box(count, half=0.1):
    """Returns points on the surface of a cube, the first eight its vertices."""
    vertices = half * np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    points = np.random.default_rng(3).uniform(-half, half, (count, 3))
    points[np.arange(count), np.arange(count) % 3] = np.where(np.arange(count) % 2, half, -half)
    points[:8] = vertices[:count]
    return points


def add_box(scene, count, material=SMOOTH, **contact):
    """Adds hills and a box with contact points."""
    ground = scene.add_surface(HILLS, name="ground")
    body = scene.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 0.5), name="body")
    points = scene.add_points(body, points_of_box(count))
    scene.add_contact(points, ground, material, name="touch", **contact)
    return body


def box(count, material=SMOOTH, **contact):
    """Returns a function that makes the scene of a box on hills."""

    def make():
        scene = wc.Scene()
        add_box(scene, count, material, **contact)
        return scene

    return make


def box_of_two_materials():
    """A box with two contact sets of different materials."""
    scene = wc.Scene()
    body = add_box(scene, 40)
    feet = scene.add_points(body, points_of_box(8))
    scene.add_contact(feet, scene.surfaces[0], STICKING, radius=0.02, name="feet")
    return scene


def box_on_a_spring():
    """A box with one cluster of contacts and a spring-damper."""
    scene = wc.Scene()
    body = add_box(scene, 8)
    ends = scene.add_point(body, (0, 0, 0)), scene.add_point(None, (0, 0, 2))
    scene.add_spring_damper(*ends, stiffness=1.0, damping=0.1, rest_length=1.0, name="spring")
    return scene


def latched_sphere():
    """A sphere falls on a ball of triangles, with a latched contact."""
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.icosphere(0.4, 3), name="ground")
    body = scene.add_body(0.5, (1e-3, 1e-3, 1e-3), position=(0, 0, 0.6), name="body")
    center = scene.add_point(body, (0, 0, 0))
    scene.add_contact(center, ground, STICKING, radius=0.1, entry="latched", name="touch")
    return scene


def several_bodies():
    """A box of points falls on a free box with a surface, and both fall on the ground."""
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((6, 6), (5, 5)), name="ground")
    size = np.array([0.4, 0.5, 0.3])
    lower = scene.add_body(
        2.0, (0.03, 0.04, 0.05), position=(0, 0, 0.4), angular_velocity=(1, 2, 0.5), name="lower"
    )
    shell = scene.add_surface(wc.meshes.box(size), lower, name="shell")
    upper = scene.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 0.8), name="upper")
    points = scene.add_points(upper, points_of_box(40))
    feet = scene.add_points(lower, 5.0 * size * points_of_box(8))
    scene.add_contact(points, shell, STICKING, radius=0.01, name="on_shell")
    scene.add_contact(feet, ground, STICKING, radius=0.01, name="on_ground")
    scene.add_contact(points, ground, SMOOTH, name="missed")
    return scene


def sticking_particles():
    """Particles with friction history fall on hills."""
    scene = wc.Scene()
    ground = scene.add_surface(HILLS, name="ground")
    places = [(0.19 * x, 0.19 * y, 0.35 + 0.19 * z) for x in range(2) for y in range(2) for z in range(2)]
    heap = scene.add_bodies(places, 1.0, [4e-3] * 3, name="body")
    scene.add_contact(scene.add_point(heap, (0, 0, 0)), ground, STICKING, radius=0.1, name="touch")
    scene.add_particle_contact(scene.add_shape(heap, wc.shapes.Sphere(0.1)), STICKING, name="heap")
    return scene


def benchmark_scenes():
    """Returns the benchmark scenes by name."""
    name = "benchmarks_scenes"
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, BENCHMARKS / "benchmark_scenes.py")
        sys.modules[name] = module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    return sys.modules[name].SCENES


def benchmark(name, envs=ENVS):
    """Returns a function that makes the simulation of a benchmark scene."""
    return lambda device, **options: simulation(benchmark_scenes()[name], envs, device, **options)


def small(make_scene, precision="float32", spread=0.5, **settings):
    """Returns a function that makes a simulation with a random start in each environment.

    Args:
        make_scene: Makes the scene.
        precision: Precision of the model.
        spread: Largest horizontal displacement of the bodies of an environment [m].
        settings: Options of ``Simulation``.
    """

    def make(device, **options):
        model = make_scene().build(envs=ENVS, precision=precision, device=device)
        rng = np.random.default_rng(1)
        moved = rng.uniform((-spread, -spread, 0.0), (spread, spread, 0.3), (ENVS, 3))
        for body in model.scene.bodies:
            position = model[f"{body.name}.position"]
            axes = (ENVS, *[1] * (position.ndim - 2), 3)
            model[f"{body.name}.position"] = position + moved.reshape(axes)
            for name, size in (("linear_velocity", 0.7), ("angular_velocity", 2.0)):
                values = model[f"{body.name}.{name}"]
                model[f"{body.name}.{name}"] = values + rng.normal(0, size, position.shape)
        return wc.Simulation(model, dt=DT, **settings, **options)

    return make


@dataclass(frozen=True)
class Case:
    """A simulation, the thresholds that select a launch shape, and the kernels of this shape.

    Attributes:
        make: Returns the simulation for a device and options of ``Simulation``.
        kernels: Kernels of the step among ``GPU_KERNELS``.
        few: Value of ``launch_shape.SMALL_LAUNCH``; with 0 every number of contacts counts as many. Default: the
            constant.
        warps: Value of ``execution_plan.FULL_WARPS``. Default: the constant.
        queues: Number of launches that process a work queue.
        accepts: Whether the integration kernel also accepts the step.
        threads: Threads of the first launch. Default: not checked.
    """

    make: Callable[..., wc.Simulation]
    kernels: frozenset[str]
    few: int = launch_shape.SMALL_LAUNCH
    warps: int = execution_plan.FULL_WARPS
    queues: int = 0
    accepts: bool = False
    threads: int | None = None


# One launch takes the whole step. A warp has 32 environments of one contact, or one to 32 of several contacts.
FUSED_STEPS = {
    "fused step, sphere": Case(benchmark("W1"), FUSED_STEP, threads=2 * LANES),
    "fused step, 8 points, one warp per environment": Case(benchmark("W2p8"), FUSED_STEP, threads=ENVS * LANES),
    "fused step, 64 points, one warp per environment": Case(benchmark("W2p64"), FUSED_STEP, threads=ENVS * LANES),
    "fused step, 64 points, 22 environments per warp": Case(
        benchmark("W2p64"), FUSED_STEP, few=0, warps=2, threads=3 * LANES
    ),
    "fused step, friction history": Case(small(box(20, STICKING, radius=0.01)), FUSED_STEP, threads=ENVS * LANES),
    "fused step, friction history, 22 environments per warp": Case(
        small(box(20, STICKING, radius=0.01)), FUSED_STEP, few=0, warps=2, threads=3 * LANES
    ),
    "fused step, float64": Case(small(box(20), "float64"), FUSED_STEP, threads=ENVS * LANES),
}
# One launch computes narrow phase and contact force, for contact sets of one contact. A second launch searches for
# the closest points that the face grid does not contain, if there are many contacts.
FUSED_CONTACTS = {
    "fused contact, particles": Case(benchmark("W3"), FUSED_CONTACT),
    "fused contact, many particles": Case(benchmark("W3"), FUSED_CONTACT | {"fused_remaining"}, few=0),
    "fused contact, many particles with friction history": Case(
        small(sticking_particles), FUSED_CONTACT | {"fused_remaining"}, few=0
    ),
}
# Broad and narrow phase in the face grid, with a second launch as above.
FACE_GRIDS = {
    "face grid, several bodies": Case(small(several_bodies, spread=0.1), GRID),
    "face grid, latched sphere": Case(small(latched_sphere, spread=0.2), GRID),
    "face grid, many latched spheres": Case(small(latched_sphere, spread=0.2), GRID | {"detect_remaining"}, few=0),
    "face grid, two materials, float64": Case(small(box_of_two_materials, "float64"), GRID),
    "face grid, nonsmooth contact": Case(small(box(8), integrator=wc.integrators.MoreauJean()), GRID),
    # The integration kernel also accepts the step of a single body with one cluster of contacts.
    "face grid, accepting integration": Case(small(box_on_a_spring), GRID, accepts=True),
}
# Surfaces of swept points have no face grid, so their queues use the face cache.
WORK_QUEUES = {
    "queues and face grid, several bodies": Case(small(several_bodies, spread=0.1), QUEUES, few=0, queues=2),
    "queues and face grid, latched box": Case(small(box(20, entry="latched")), QUEUES, few=0, queues=2),
    "queues and face cache, swept box": Case(small(box(20, swept=True)), QUEUES, queues=2),
    "queues and face cache, many swept boxes": Case(small(box(20, swept=True)), QUEUES, few=0, queues=3),
}
CASES = FUSED_STEPS | FUSED_CONTACTS | FACE_GRIDS | WORK_QUEUES


def step_launches(sim):
    """Returns the launches of a step."""
    (stepper,) = sim.worker_pool()._steppers
    return stepper._steps[0].full


def step_kernels(sim):
    """Returns the names of the kernels of a step, in order of their launches."""
    return [launch.kernel.key.split("__")[-1] for launch in step_launches(sim)]


def separate_sums(plan):
    """Returns the launch shape of a plan, with separate kernels for sums of wrenches and acceptance."""
    return replace(choose_shape(plan), integrator_sums=False, integrator_accepts=False)


def start(case, device, monkeypatch, *, staged, **options):
    """Returns a simulation after its first step, which prepares the launches.

    Args:
        case: The case; its thresholds are restored afterwards.
        device: The device.
        monkeypatch: Fixture.
        staged: Whether steps are staged. They are launched one by one, with wrenches summed in a fixed order.
        options: Further options of ``Simulation``.
    """
    with monkeypatch.context() as patch:
        if staged:
            patch.setattr(launch_shape, "choose_shape", separate_sums)
            patch.setattr(ParticleContactSet, "sums_by_body", False)
            options |= {
                "distance_cache": False, "deterministic": True, "capture_graphs": False, "launch_shape": STAGED,
            }  # fmt: skip
        else:
            patch.setattr(launch_shape, "SMALL_LAUNCH", case.few)
            patch.setattr(execution_plan, "FULL_WARPS", case.warps)
        sim = case.make(device, **options)
        # The warnings of the first step would compile kernels for another block size.
        sim.warned_at_start = True
        sim.step(1)
    return sim


def start_both(case, device, monkeypatch):
    """Returns a simulation with the launch shape of a case, and one with staged steps."""
    sim = start(case, device, monkeypatch, staged=False)
    kernels = step_kernels(sim)
    assert set(kernels) & GPU_KERNELS == case.kernels, kernels
    assert kernels.count("process_contacts") == case.queues, kernels
    accepts = "semi_implicit_euler" in kernels and "advance_history" not in kernels
    assert accepts == case.accepts, kernels
    if case.threads is not None:
        assert step_launches(sim)[0].bounds.size == case.threads
    staged = start(case, device, monkeypatch, staged=True)
    kernels = step_kernels(staged)
    assert not set(kernels) & GPU_KERNELS, kernels
    assert "closest_point" in kernels, kernels
    return sim, staged


def state_of(sim):
    """Returns the state arrays by name."""
    return {name: array.numpy().copy() for name, array in vars(sim.model.state).items()}


def history_of(sim):
    """Returns the contact history by name."""
    model = sim.model
    history = model.arrays.history
    found = {"entry_speed": history.entry_speed.numpy()}
    if model.tracks_faces:
        found |= {name: getattr(history, name).numpy() for name in ("armed", "face", "crossings")}
    for number, group in enumerate(model.groups):
        for part, formula in group.contact_model._asdict().items():
            if not formula.memories:
                continue
            values = getattr(group.history_in, part).numpy()
            found |= {f"history of {part} {number}: {field}": values[field] for field in values.dtype.names}
    for contact_set in model.of_family("particle contact"):
        closed = (contact_set.pair_records.flags.numpy() & WAS_IN_CONTACT) != 0
        found[f"{contact_set.contact.name} closed"] = closed
        found[f"{contact_set.contact.name} entry_speed"] = np.where(
            closed, contact_set.pair_records.entry_speed.numpy(), -1.0
        )
    return {name: array.copy() for name, array in found.items()}


def sensors_of(sim):
    """Returns the contact sensors by name."""
    scene = sim.model.scene
    names = [f"{contact.name}.{key}" for contact in scene.contacts for key in SENSORS]
    names += [f"{contact.name}.{key}" for contact in scene.particle_contacts for key in PARTICLE_SENSORS]
    return {name: np.asarray(sim.model.sensor(name)) for name in names}


def assert_bitwise(found, expected, when):
    """Raises an error that names the first array with different bits."""
    assert found.keys() == expected.keys()
    for name, values in found.items():
        np.testing.assert_array_equal(values, expected[name], err_msg=f"{name} {when}")
        assert values.tobytes() == expected[name].tobytes(), f"{name} {when}: signs of zeros or NaN differ"


def assert_equal(sim, other):
    """Compares states, contact history and contact sensors of two simulations bitwise."""
    when = f"after {sim.steps} steps"
    for values_of in (state_of, history_of, sensors_of):
        assert_bitwise(values_of(sim), values_of(other), when)


def deflected(before, after, seconds):
    """Returns which environments have a velocity that differs from free fall by more than 0.01 m/s."""
    velocities = [state["body_linear_velocity"].astype(float) for state in (before, after)]
    return (np.abs(velocities[1] - velocities[0] - seconds * GRAVITY) > 1e-2).any(axis=(1, 2))


@pytest.mark.parametrize("name", CASES)
def test_launch_shape_equals_staged_steps(name, cuda, monkeypatch):
    sim, staged = start_both(CASES[name], cuda, monkeypatch)
    first = state_of(sim)
    moved = np.zeros(ENVS, dtype=bool)
    for part in range(1, PARTS + 1):
        count = part * STEPS // PARTS - sim.steps
        for one in (sim, staged):
            one.step(count)
        assert_equal(sim, staged)
        moved |= deflected(first, state_of(sim), (sim.steps - 1) * DT)
    assert moved.sum() >= 8
    assert sim.model.health().good


@pytest.mark.parametrize("name", [
    "fused step, friction history",
    "fused contact, many particles with friction history",
    "queues and face grid, latched box",
])  # fmt: skip
def test_launch_shape_equals_staged_steps_after_changes(name, cuda, monkeypatch):
    """Changes of state and parameters invalidate cached distances."""

    def raised(model):
        model["body.position"] = model.sensor("body.position") + np.array([0.0, 0.0, 0.02])

    changes = [
        raised,
        lambda model: model.__setitem__("touch.enabled", np.arange(ENVS) % 2),
        lambda model: model.__setitem__("touch.enabled", 1),
        lambda model: model.__setitem__("touch.radius", 0.12),
        lambda model: model.__setitem__("touch.force_scale", 0.5),
        lambda model: model.reset(np.arange(ENVS) % 3 == 0),
    ]
    both = start_both(CASES[name], cuda, monkeypatch)
    for change in changes:
        for sim in both:
            sim.step(120)
            change(sim.model)
            sim.step(30)
        assert_equal(*both)


@pytest.mark.parametrize("name", [
    "fused step, 64 points, 22 environments per warp",
    "fused contact, many particles",
    "queues and face cache, many swept boxes",
])  # fmt: skip
def test_gpu_run_is_repeated_bitwise(name, cuda, monkeypatch):
    first, second = (start(CASES[name], cuda, monkeypatch, staged=False) for _ in range(2))
    for sim in (first, second):
        assert "initialize_wrenches" not in step_kernels(sim)  # no atomic sums
        sim.step(STEPS)
    assert_equal(first, second)


def test_deterministic_gpu_run_of_many_clusters_is_repeated_bitwise(cuda, monkeypatch):
    """Wrenches of more than 16 clusters are summed with atomics, except in deterministic runs."""
    case = Case(small(box(300)), GRID)
    atomic = start(case, cuda, monkeypatch, staged=False)
    assert "initialize_wrenches" in step_kernels(atomic)
    first, second = (start(case, cuda, monkeypatch, staged=False, deterministic=True) for _ in range(2))
    staged = start(case, cuda, monkeypatch, staged=True)
    for sim in (first, second, staged):
        assert "sum_wrenches" in step_kernels(sim)
        sim.step(STEPS)
    assert_equal(first, second)
    assert_equal(first, staged)


@pytest.mark.parametrize(
    ("name", "envs", "kernels", "threads"),
    [
        ("W2p8", 262_144, FUSED_STEP, 262_144),
        ("W3", 16_384, FUSED_CONTACT | {"fused_remaining"}, None),
    ],
)
def test_launch_shape_of_real_size_equals_staged_steps(name, envs, kernels, threads, cuda, monkeypatch):
    """Thresholds are unchanged. One environment alone gives the same as among all others."""
    sim, staged = start_both(Case(benchmark(name, envs), kernels, threads=threads), cuda, monkeypatch)
    chosen = envs // 3
    alone = benchmark(name, 1)(cuda)
    alone.model["body.position"] = sim.model["body.position"][chosen : chosen + 1]
    alone.reset()
    alone.warned_at_start = True
    for one in (sim, staged, alone):
        one.step(STEPS - one.steps)
    assert_equal(sim, staged)
    for values_of in (state_of, history_of, sensors_of):
        of_one = {key: values[chosen : chosen + 1] for key, values in values_of(sim).items()}
        assert_bitwise(of_one, values_of(alone), f"of environment {chosen} alone and among {envs}")
