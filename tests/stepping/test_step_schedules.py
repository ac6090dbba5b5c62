"""Results are equal with and without caches, with graphs or launches, and in slices stepped by many threads."""

import functools
import itertools
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import warp as wp
from case_marks import slow_except
from gpu_schedule_on_cpu import build_all_face_grids, use_work_queues

import warpcontact as wc
from warpcontact.forces import launch_shape
from warpcontact.stepping import requirements, worker_pool

STATE = ("position", "orientation", "linear_velocity", "angular_velocity")
PRECISIONS = pytest.mark.parametrize("precision", ["float32", "float64"])
MATERIAL = wc.ContactMaterial(
    law=wc.laws.KelvinVoigt(stiffness=2e3, damping=4.0),
    friction=wc.friction.Tanh(mu=0.5, velocity_scale=0.01),
)
STUCK = wc.ContactMaterial(
    law=wc.laws.HuntCrossley(stiffness=2e4, restitution=0.5),
    friction=wc.friction.CundallStrack(mu_static=0.6, mu_dynamic=0.4, stiffness=1e3, damping=1.0),
)
ENVS = 24
# Scenes of every test run: many points, sizes of the search, latched and swept points, active faces, and two bodies.
FIRST = ("box of points on terrain", "latched with small search radius", "swept", "partly active", "two bodies")


def cloud(count, size, seed=3):
    """Points (count, 3) on the surface of a box of ``size``."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (count, 3))
    points[np.arange(count), np.abs(points).argmax(axis=1)] = np.sign(
        points[np.arange(count), np.abs(points).argmax(axis=1)]
    )
    return 0.5 * size * points


def terrain_with(points, radius=0.0, **contact):
    def make():
        scene = wc.Scene()
        ground = scene.add_surface(
            wc.meshes.sinusoidal_terrain((4, 4), (30, 30), amplitude=0.15, wavelength=1.3), name="ground"
        )
        body = scene.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 0.5), name="body")
        scene.add_contact(scene.add_points(body, points), ground, MATERIAL, radius=radius, name="touch", **contact)
        return scene

    return make


def falling_on(mesh, *, radius=0.05, height=0.8, material=MATERIAL, surface=None, **contact):
    def make():
        scene = wc.Scene()
        ground = scene.add_surface(mesh, name="ground", **(surface or {}))
        body = scene.add_body(0.5, (1e-3, 1e-3, 1e-3), position=(0, 0, height), name="body")
        scene.add_contact(
            scene.add_point(body, (0, 0, 0)), ground, material, radius=radius, name="touch", **contact
        )
        return scene

    return make


def two_bodies():
    """A box of points falls on a flying, rotating box, and both fall on the ground."""
    scene = wc.Scene()
    ground = scene.add_surface(wc.meshes.grid((6, 6), (5, 5)), name="ground")
    block = scene.add_body(
        2.0, (0.03, 0.04, 0.05), position=(0, 0, 0.5), angular_velocity=(1, 2, 0.5), name="block"
    )
    shell = scene.add_surface(wc.meshes.box((0.4, 0.5, 0.3)), block, name="shell")
    body = scene.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 1.0), name="body")
    points = scene.add_points(body, cloud(40, 0.2))
    corners = scene.add_points(block, 0.5 * np.array([0.4, 0.5, 0.3]) * CORNERS)
    scene.add_contact(points, shell, STUCK, name="upper")
    scene.add_contact(corners, ground, STUCK, name="lower")
    scene.add_contact(points, ground, MATERIAL, name="missed")
    return scene


def half_active(mesh):
    return {"active_faces": mesh.vertices[mesh.faces].mean(axis=1)[:, 0] > -0.1}


SHELL = wc.meshes.icosphere(0.4, 3)
PLATE = wc.meshes.grid((1.0, 0.6), (4, 3))
CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
# A floor, and a wall with its inner side towards a body on the floor. The side changes where both are equally
# near.
FOLDED = wc.Mesh(
    [(-1, -1, 0), (0.5, -1, 0), (0.5, 1, 0), (-1, 1, 0), (0.6, -1, 0), (0.6, 1, 0), (0.6, 1, 1), (0.6, -1, 1)],
    [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)],
)
FINE = wc.meshes.sinusoidal_terrain((3, 3), (50, 50), amplitude=0.05, wavelength=1.5)
SCENES = {
    "sphere on terrain": terrain_with([[0.02, 0.01, 0.0]], radius=0.08),
    "box of points on terrain": terrain_with(cloud(60, 0.2)),
    "limited penetration": terrain_with(cloud(20, 0.2), max_depth=0.05),
    "small search radius": terrain_with(cloud(20, 0.2), radius=0.01, search_radius=0.06),
    "on a ball": falling_on(SHELL),
    "on a scaled mesh": falling_on(wc.meshes.icosphere(4.0, 3), surface={"scale": 0.1}),
    "on the inner side of a ball": falling_on(SHELL.flipped(), height=0.1),
    "next to a plate": falling_on(PLATE),
    "across the boundary": falling_on(PLATE, boundary="outer"),
    "latched": falling_on(PLATE, entry="latched"),
    "latched on a ball": falling_on(SHELL, entry="latched"),
    "latched with small search radius": falling_on(SHELL, entry="latched", search_radius=0.15),
    "swept": falling_on(SHELL, swept=True),
    "folded surface": falling_on(FOLDED),
    "partly active": falling_on(SHELL, surface=half_active(SHELL)),
    "search in active faces": falling_on(SHELL, surface=half_active(SHELL), search="active"),
    "with history": falling_on(SHELL, material=STUCK),
    "two bodies": two_bodies,
    # Face caches of up to 25 and up to 48 faces; the latter are too small.
    "sphere of 3 edge lengths": falling_on(FINE, radius=0.18),
    "sphere of 8 edge lengths": falling_on(FINE, radius=0.48),
}


def start(model, seed=1):
    rng = np.random.default_rng(seed)
    for body in model.scene.bodies:
        position = model[f"{body.name}.position"]
        position[:, :2] += rng.uniform(-0.5, 0.5, (model.envs, 2))
        position[:, 2] += rng.uniform(0.0, 0.3, model.envs)
        model[f"{body.name}.position"] = position
        model[f"{body.name}.linear_velocity"] = rng.normal(0, 0.7, (model.envs, 3))
        model[f"{body.name}.angular_velocity"] = rng.normal(0, 2.0, (model.envs, 3))


def run(name, precision, device, *, steps=700, envs=ENVS, **options):
    model = SCENES[name]().build(envs=envs, precision=precision, device=device)
    start(model)
    sim = wc.Simulation(model, dt=1e-3, **options)
    states = []
    for _ in range(7):
        sim.step(steps // 7)
        states.append([model.sensor(f"{b.name}.{key}") for b in model.scene.bodies for key in STATE])
    # A body in free fall has its initial velocity plus gravity times time.
    fall = model["body.linear_velocity"] + steps * 1e-3 * model["scene.gravity"]
    pushed = np.abs(model.sensor("body.linear_velocity") - fall).max(axis=1) > 1e-2
    return states, pushed


@functools.cache
def cpu_run(name, precision):
    """Returns the states of a run on a CPU."""
    return run(name, precision, "cpu")[0]


def assert_same(left, right):
    for now, (some, others) in enumerate(zip(left, right, strict=True)):
        for value, other in zip(some, others, strict=True):
            np.testing.assert_array_equal(value, other, err_msg=f"after part {now}")


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
@pytest.mark.parametrize("few", [True, False], ids=["small", "large"])
@pytest.mark.parametrize(
    ("name", "precision"),
    # float64 has the same branches.
    slow_except(
        itertools.product(SCENES, ("float32", "float64")), lambda case: case[1] == "float32" or case[0] == "swept"
    ),
)
def test_distance_cache_does_not_change_results(name, few, precision, device, monkeypatch):
    if not few:
        if device == "cpu":
            pytest.skip("a CPU does the same for few and many")
        monkeypatch.setattr(launch_shape, "SMALL_LAUNCH", 0)
    with_cache, pushed = run(name, precision, device)
    uncached, _ = run(name, precision, device, distance_cache=False, capture_graphs=False, threads=1)
    assert pushed.sum() >= 3
    assert_same(with_cache, uncached)


@pytest.fixture(params=["clusters", "queues", "queues and face grids"])
def detection(request, monkeypatch):
    """Contact detection of a CPU, or of a GPU (work queues, with and without face grids)."""
    if request.param != "clusters":
        use_work_queues(monkeypatch)
    if request.param == "queues and face grids":
        build_all_face_grids(monkeypatch)


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
def test_latch_armed_in_a_repeated_step_is_preserved(detection):
    """The latch is armed in substeps, the point is culled, and the next evaluation is in contact."""

    def run(distance_cache):
        scene = wc.Scene(gravity=(0, 0, 0))
        ground = scene.add_surface(wc.meshes.grid((9, 9), (4, 4)), name="ground")
        for name, x, options in (("ball", 0.1, {"entry": "latched"}), ("shot", 1.1, {"swept": True})):
            body = scene.add_body(
                0.5, (1e-3, 1e-3, 1e-3), position=(x, 0.2, 1.5e-3), linear_velocity=(0, 0, -1), name=name
            )
            scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, MATERIAL, name=f"{name}_touch", **options)
        model = scene.build(device="cpu")
        model["shot.linear_velocity"] = (0, 0, -30)  # through the ground in the first step
        sim = wc.Simulation(model, dt=1e-3, crossing_substeps=3, distance_cache=distance_cache)
        states = []
        for _ in range(4):
            sim.step()
            states.append([model.sensor(f"ball.{key}") for key in STATE])
        assert model.sensor("shot_touch.crossings")[0] > 0
        assert model.sensor("ball_touch.normal_force")[0] > 0
        return states

    assert_same(run(True), run(False))


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
@pytest.mark.parametrize(
    ("arm", "places", "touches"),
    [
        # From above, past the boundary outside the search radius, to below: never armed.
        (0.02, [(1.0, 0), (-0.05, 0), (-0.05, 0)], [False, False]),
        # Flipped in between, so that of the two points another one enters the search radius first and is armed.
        (0.03, [(0.28, 0), (0.28, 1), *((z, 1) for z in np.arange(0.27, -0.05, -0.026))], [True, True]),
    ],
    ids=["out_of_reach", "into_reach"],
)
def test_points_of_a_cluster_are_armed_when_detected(arm, places, touches, detection):
    def run(distance_cache):
        scene = wc.Scene(gravity=(0, 0, 0))
        ground = scene.add_surface(wc.meshes.grid((2, 2), (4, 4)), name="ground")
        body = scene.add_body(1.0, (1, 1, 1), name="body")
        points = scene.add_points(body, [(0, 0, -arm), (0, 0, arm)])
        scene.add_contact(points, ground, MATERIAL, search_radius=0.2, entry="latched", name="touch")
        model = scene.build(device="cpu")
        sim = wc.Simulation(model, dt=1e-3, distance_cache=distance_cache)
        for height, turned in places:
            sim.state.body_position.assign(np.array([[(0.1, 0.2, height)]]))
            sim.state.body_orientation.assign(np.array([[(turned, 0.0, 0.0, 1.0 - turned)]]))
            sim.state.body_linear_velocity.zero_()
            sim.state.body_angular_velocity.zero_()
            sim.step()
        return (model.sensor("touch.normal_force")[0] > 0).tolist()

    assert run(True) == run(False) == touches


@pytest.mark.parametrize("points", [1, 3])
@pytest.mark.parametrize("speed", [0.0, -0.1])
def test_distance_cache_does_not_change_a_contact_enabled_in_overlap(points, speed, device):
    """Nothing has moved yet, so models with tangential history have no force in the first step."""

    def run(distance_cache):
        scene = wc.Scene(gravity=(0, 0, 0))
        ground = scene.add_surface(wc.meshes.grid((2.0, 2.0), (4, 4)), name="ground")
        body = scene.add_body(
            1.0, (1e-2, 1e-2, 1e-2), position=(0.1, 0.05, 0.0999), linear_velocity=(0.5, 0.3, speed), name="body"
        )
        places = scene.add_points(body, [(0.03 * i, 0.0, 0.0) for i in range(points)])
        material = wc.ContactMaterial(
            law=wc.laws.Hooke(stiffness=1e4),
            friction=wc.friction.CundallStrack(mu_static=0.6, mu_dynamic=0.5, stiffness=1e4),
        )
        scene.add_contact(places, ground, material, radius=0.1, enabled=False, name="touch")
        model = scene.build(envs=2, device=device)
        sim = wc.Simulation(model, dt=1e-4, distance_cache=distance_cache)
        sim.step(20)
        model["touch.enabled"] = True
        states = []
        for _ in range(4):
            sim.step()
            states.append([model.sensor(f"body.{key}") for key in STATE])
        return states

    cached, uncached = run(True), run(False)
    np.testing.assert_array_equal(cached[0][2][:, :2], np.float32([[0.5, 0.3]] * 2))
    assert (uncached[1][2][:, 0] < 0.5).all()
    for one, other in zip(cached, uncached, strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
def test_distance_cache_does_not_change_results_after_state_or_parameter_changes(precision, device):
    """Between steps the user sets the state, moves the surface, changes sizes or resets some environments."""

    def run(distance_cache):
        scene = wc.Scene()
        meshes = [wc.meshes.box((1.0, 1.0, 0.2)), wc.meshes.icosphere(0.5, 2)]
        ground = scene.add_surface(meshes, name="ground")
        body = scene.add_body(1.0, (4e-3, 5e-3, 6e-3), position=(0, 0, 0.8), name="body")
        points = scene.add_points(body, cloud(30, 0.2), name="points")
        scene.add_contact(points, ground, STUCK, radius=0.01, name="touch")
        model = scene.build(envs=ENVS, precision=precision, device=device)
        start(model)
        sim = wc.Simulation(model, dt=1e-3, distance_cache=distance_cache)
        rng = np.random.default_rng(8)

        def replace_state(near):
            state = sim.state.body_position.numpy().copy()
            state[::3, 0] = near + rng.normal(0, 0.02, (len(state[::3]), 3))
            sim.state.body_position.assign(state)

        changes = [
            lambda: replace_state((0.0, 0.0, 0.25)),
            lambda: replace_state((0.0, 0.0, 5.0)),
            lambda: replace_state((0.0, 0.0, 0.65)),
            lambda: model.__setitem__("ground.mesh", rng.integers(0, 2, ENVS)),
            lambda: model.__setitem__("ground.position", rng.normal(0, 0.1, (ENVS, 3))),
            lambda: model.__setitem__("ground.scale", rng.uniform(0.8, 1.3, ENVS)),
            lambda: model.__setitem__("touch.radius", 0.03),
            lambda: model.__setitem__("touch.enabled", rng.integers(0, 2, ENVS)),
            lambda: model.__setitem__("touch.enabled", True),
            lambda: model.__setitem__("points.position", cloud(30, 0.3)[None]),
            lambda: model.__setitem__("touch.max_depth", 0.05),
            lambda: sim.reset(np.arange(ENVS) % 2 == 0),
            lambda: model.sensor("touch.gap"),
        ]
        states = []
        for change in changes:
            sim.step(70)
            change()
            sim.step(1)
            states.append([model.sensor(f"body.{key}") for key in STATE])
        return states

    assert_same(run(True), run(False))


@PRECISIONS
@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
@pytest.mark.parametrize("name", ["box of points on terrain", "with history", "swept", "two bodies"])
def test_captured_steps_equal_launched_steps(name, precision, device):
    """Graphs of many steps, of two, of one, and sums of these."""

    def run(graphs):
        model = SCENES[name]().build(envs=ENVS, precision=precision, device=device)
        start(model)
        sim = wc.Simulation(model, dt=1e-3, capture_graphs=graphs)
        states = []
        for count in (1, 2, 3, 32, 65, 350, 1, 31):
            sim.step(count)
            states.append([model.sensor(f"{b.name}.{key}") for b in model.scene.bodies for key in STATE])
        states.append([[model.time]])
        return states

    assert_same(run(True), run(False))


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
@pytest.mark.parametrize("name", ["box of points on terrain", "with history", "swept", "two bodies"])
@pytest.mark.parametrize(("threads", "size"), [(2, 7), (3, 1), (5, 100)])
def test_threads_and_slices_do_not_change_results(name, threads, size, device, monkeypatch):
    alone, _ = run(name, "float32", device, threads=1)
    monkeypatch.setattr(requirements, "MAX_SLICE", size)
    monkeypatch.setattr(worker_pool, "SERIAL_SECONDS", 0.0)
    shared, _ = run(name, "float32", device, threads=threads)
    assert_same(alone, shared)


@pytest.mark.parametrize("precision", ["float32", pytest.param("float64", marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
@pytest.mark.parametrize(
    ("use_face_grids", "few"),
    [
        pytest.param(False, False, id="of many", marks=pytest.mark.slow),
        pytest.param(True, True, id="grid-small", marks=pytest.mark.slow),
        pytest.param(False, True, id="small", marks=pytest.mark.slow),
        pytest.param(True, False, id="grid-large"),
    ],
)
# Face grids of small faces next to large spheres take a CPU long to fill.
@pytest.mark.parametrize(
    "name",
    slow_except([name for name in SCENES if not name.endswith("edge lengths")], lambda name: name in FIRST),
)
def test_work_queues_do_not_change_results(name, few, use_face_grids, precision, monkeypatch):
    """Contact detection as on a GPU, here in one thread."""
    usual = cpu_run(name, precision)
    use_work_queues(monkeypatch)
    if use_face_grids:
        build_all_face_grids(monkeypatch)
    if not few:
        monkeypatch.setattr(launch_shape, "SMALL_LAUNCH", 0)
    assert_same(run(name, precision, "cpu")[0], usual)


def test_concurrent_simulations_do_not_affect_each_other(device):
    names = ["box of points on terrain", "with history", "on a ball", "two bodies"]
    alone = [run(name, "float32", device)[0] for name in names]
    # A GPU has one stream for all models, so the runs alternate.
    with ThreadPoolExecutor(len(names) if device == "cpu" else 1) as pool:
        together = list(pool.map(lambda name: run(name, "float32", device)[0], names))
    for expected, states in zip(alone, together, strict=True):
        assert_same(expected, states)


@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
@pytest.mark.parametrize("name", ["box of points on terrain", "two bodies"])
def test_deterministic_run_is_repeated_bitwise(name, device):
    first, _ = run(name, "float32", device, deterministic=True)
    second, _ = run(name, "float32", device, deterministic=True, capture_graphs=False)
    assert_same(first, second)


@pytest.mark.parametrize("crossing_substeps", [pytest.param(1, marks=pytest.mark.slow), 4])
@pytest.mark.filterwarnings("ignore::warpcontact.ContactWarning")
def test_interrupt_leaves_all_environments_at_one_time(crossing_substeps, device):
    """On Ctrl-C at any time, all environments have taken the same number of whole steps, and the clock matches."""

    def prepared():
        model = SCENES["swept"]().build(envs=ENVS, device=device)
        start(model)
        return wc.Simulation(model, dt=1e-3, crossing_substeps=crossing_substeps)

    sim = prepared()
    sim.step()
    timer = threading.Timer(0.3, signal.raise_signal, (signal.SIGINT,))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        sim.step(10**7)
    timer.join()
    assert sim.steps > 1
    assert (sim.model.arrays.status.numpy() == 0).all()
    np.testing.assert_allclose(sim.model.arrays.time.numpy(), sim.time, rtol=1e-5)
    other = prepared()
    other.step(sim.steps)
    for key in STATE:
        np.testing.assert_array_equal(sim.model.sensor(f"body.{key}"), other.model.sensor(f"body.{key}"))


def test_slow_steps_are_split_into_small_chunks():
    """For any duration and number of steps."""

    class Stepper:
        captured, device = False, wp.get_device("cpu")

        def select(self, own):
            pass

        def set_frame(self, number):
            pass

        def capture(self, chunks):
            pass

        def step(self, chunks):
            time.sleep(0.02 * sum(chunk.steps for chunk in chunks))

    assert list(worker_pool.WorkerPool([worker_pool.DeviceShare([slice(0, 1)], [Stepper()])]).step(24)) == [
        8,
        16,
        24,
    ]


@pytest.mark.parametrize("wrong", [0, -1, 1.5, True, "4"])
def test_invalid_number_of_threads_is_refused(wrong, device):
    model = SCENES["on a ball"]().build(device=device)
    with pytest.raises(ValueError, match=r"threads must be a whole number of at least 1"):
        wc.Simulation(model, dt=1e-3, threads=wrong)
