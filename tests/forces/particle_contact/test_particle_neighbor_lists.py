"""Neighbor lists do not change results, for any skin, slices, threads and evaluations in between."""

import warnings

import numpy as np
import pytest

import warpcontact as wc
from warpcontact.forces.particle_contact import contact_set

COUNT = 60
# Material with history: a tangential spring, and the impact speed.
MATERIAL = wc.ContactMaterial(
    law=wc.laws.LankaraniNikravesh(stiffness=2e5, exponent=1.5, restitution=0.6),
    friction=wc.friction.CundallStrack(mu_static=0.5, mu_dynamic=0.4, stiffness=5e3, damping=1.0),
)


def scene(skin=0.02, **options):
    """Returns spheres of radii 1:3 that fly into each other."""
    rng = np.random.default_rng(3)
    radii = rng.uniform(0.05, 0.15, COUNT)
    positions = rng.uniform(-0.6, 0.6, (COUNT, 3))
    made = wc.Scene(gravity=(0, 0, 0))
    spin = 5 * rng.normal(size=(COUNT, 3))
    balls = made.add_bodies(positions, 0.5, [0.002] * 3, (0, 0, 0, 1), -3 * positions, spin, name="ball")
    shape = made.add_shape(balls, [wc.shapes.Sphere(float(radius)) for radius in radii], name="shape")
    made.add_particle_contact(shape, MATERIAL, name="pile", skin=skin, **({"max_neighbors": 40} | options))
    return made


def state_bytes(model):
    """Returns the bytes of the state of all bodies."""
    state = model.state
    arrays = (state.body_position, state.body_orientation, state.body_linear_velocity, state.body_angular_velocity)
    return np.concatenate([array.numpy() for array in arrays], axis=-1)


STEPS, DT = 1000, 2e-4


@pytest.fixture(scope="module", params=["float32", "float64"])
def run(request, device):
    """A model after its steps, with the final states."""
    model = scene().build(envs=3, device=device, precision=request.param)
    # Environments differ.
    velocity = model["ball.linear_velocity"]
    model["ball.linear_velocity"] = velocity * np.array([1.0, 0.9, 1.1])[:, None, None]
    start = model.state.body_linear_velocity.numpy().copy()
    sim = wc.Simulation(model, dt=DT, deterministic=True)
    sim.step(STEPS)
    return model, state_bytes(model).copy(), start


def rerun(run, made, device, **options):
    """Returns the final states of the same run of another scene, and its model."""
    model = made.build(envs=3, device=device, precision=run[0].precision)
    model["ball.linear_velocity"] = run[0]["ball.linear_velocity"]
    wc.Simulation(model, dt=DT, deterministic=True, **options).step(STEPS)
    return state_bytes(model), model


def test_results_are_bitwise_identical_for_any_skin(run, device):
    """A wide skin rebuilds lists rarely, a narrow one often; contact history is transferred with the pairs."""
    end, wide = rerun(run, scene(skin=0.15), device)
    np.testing.assert_array_equal(end, run[1])
    often, seldom = (
        model.of_family("particle contact")[0].cell_list.build_count.numpy().min() for model in (run[0], wide)
    )
    assert often > 5 * seldom > 0


def test_neighbor_lists_of_all_pairs_give_bitwise_identical_results(run, device, monkeypatch):
    """A few shapes use lists of all pairs, which are never rebuilt."""
    monkeypatch.setattr(contact_set, "ALL_PAIRS_LIMIT", COUNT)
    end, model = rerun(run, scene(), device)
    assert model.of_family("particle contact")[0].all_pairs
    np.testing.assert_array_equal(end, run[1])


def test_neighbor_lists_of_offset_capsules_give_bitwise_identical_results(device, monkeypatch):
    """Two shapes per body, offset and rotating: any skin, lists of all pairs, and far from the origin."""
    rng = np.random.default_rng(8)
    positions = rng.uniform(-0.4, 0.4, (30, 3))
    turns = rng.normal(size=(30, 4))
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    spin = 10 * rng.normal(size=(30, 3))
    far = np.array([2.0**22, -(2.0**21), 0.0])  # where a single float32 resolves half a meter
    ends, models = [], []
    for skin, few, centre in ((0.01, 32, 0.0), (0.1, 32, 0.0), (0.1, 60, 0.0), (0.01, 32, far)):
        monkeypatch.setattr(contact_set, "ALL_PAIRS_LIMIT", few)
        made = wc.Scene(gravity=(0, 0, 0))
        # Multiples of 2^-20 m are exact next to the center with a 24-bit remainder, so all runs start alike.
        places = np.round(positions * 2.0**20) / 2.0**20
        rods = made.add_bodies(places + centre, 1.0, [0.01, 0.02, 0.025], turns, -2 * positions, spin, name="rod")
        shapes = [
            made.add_shape(rods, wc.shapes.Capsule(0.04, 0.08), position=(0.02, 0.0, 0.01)),
            made.add_shape(rods, wc.shapes.Sphere(0.06), position=(-0.05, 0.02, 0.0)),
        ]
        made.add_particle_contact(shapes, MATERIAL, name="pile", skin=skin, max_neighbors=59)
        model = made.build(device=device)
        wc.Simulation(model, dt=DT, deterministic=True).step(1500)
        ends.append(state_bytes(model)[..., 3:])
        models.append(model)
    changed = np.linalg.norm(models[0].sensor("rod.linear_velocity") + 2 * positions, axis=-1)
    assert (changed > 0.5).mean() > 0.8
    often, seldom = (
        model.of_family("particle contact")[0].cell_list.build_count.numpy().min() for model in models[:2]
    )
    assert often > 5 * seldom > 0
    assert models[2].of_family("particle contact")[0].all_pairs
    for end in ends[1:3]:
        np.testing.assert_array_equal(end, ends[0])
    # Positions have the same resolution there, but are rounded differently.
    np.testing.assert_allclose(ends[3], ends[0], atol=1e-2)


def test_particle_results_are_bitwise_identical_for_any_slices_and_threads(run, device, monkeypatch):
    """Slices of one environment, one thread, and no graphs."""
    monkeypatch.setattr("warpcontact.stepping.requirements.MAX_SLICE", 1)
    end, _ = rerun(run, scene(), device, threads=1, capture_graphs=False)
    np.testing.assert_array_equal(end, run[1])


def test_particle_environment_alone_is_bitwise_identical(run, device):
    """Results do not depend on other environments."""
    model = scene().build(device=device, precision=run[0].precision)
    model["ball.linear_velocity"] = run[0]["ball.linear_velocity"][1:2]
    wc.Simulation(model, dt=DT, deterministic=True).step(STEPS)
    np.testing.assert_array_equal(state_bytes(model)[0], run[1][1])


def test_evaluation_of_another_state_keeps_particle_history(run, device):
    """Evaluating another state, far from that of the lists, does not change the history."""
    model = scene().build(envs=3, device=device, precision=run[0].precision)
    model["ball.linear_velocity"] = run[0]["ball.linear_velocity"]
    sim = wc.Simulation(model, dt=DT, deterministic=True)
    for _ in range(4):
        sim.step(STEPS // 4)
        position = model.state.body_position
        here = position.numpy().copy()
        assert model.sensor("pile.contacts").min() > 0
        position.assign(here * 50)
        assert model.sensor("pile.contacts").max() == 0
        position.assign(here)
    np.testing.assert_array_equal(state_bytes(model), run[1])


def test_reset_restores_initial_particle_state(run, device):
    """A reset environment repeats its run; the others continue."""
    model = scene().build(envs=3, device=device, precision=run[0].precision)
    model["ball.linear_velocity"] = run[0]["ball.linear_velocity"]
    sim = wc.Simulation(model, dt=DT, deterministic=True)
    sim.step(STEPS // 2)
    model.reset(np.array([False, True, False]))
    sim.step(STEPS // 2)
    half = state_bytes(model)
    np.testing.assert_array_equal(half[[0, 2]], run[1][[0, 2]])
    sim.step(STEPS // 2)
    np.testing.assert_array_equal(state_bytes(model)[1], run[1][1])


def test_particle_results_split_over_devices_are_bitwise_identical(run, device):
    """Each part of a model has the particle contacts of its environments; sensors combine them."""
    model = scene().build(envs=3, device=[device, device], precision=run[0].precision)
    model["ball.linear_velocity"] = run[0]["ball.linear_velocity"]
    wc.Simulation(model, dt=DT, deterministic=True).step(STEPS)
    np.testing.assert_array_equal(np.concatenate([state_bytes(part) for part in model.parts]), run[1])
    assert model.contact_pairs("pile").equals(run[0].contact_pairs("pile"))


def test_particle_contact_conserves_momentum(run):
    """Forces and torques are opposite at one point, so linear and angular momentum are conserved."""
    model = run[0]
    mass, inertia = 0.5, 0.002
    # Velocities are rounded in every step to the precision of the model.
    within = 2e-4 if model.precision == "float32" else 1e-11
    velocity, spin = model["ball.linear_velocity"], model["ball.angular_velocity"]
    linear = mass * velocity.sum(axis=1)
    angular = (mass * np.cross(model["ball.position"], velocity) + inertia * spin).sum(axis=1)
    np.testing.assert_allclose(model.sensor("scene.linear_momentum"), linear, atol=within)
    np.testing.assert_allclose(model.sensor("scene.angular_momentum"), angular, atol=within)
    changed = np.linalg.norm(model.sensor("ball.linear_velocity") - velocity, axis=-1)
    assert np.mean(changed > 0.5) > 0.8


def test_failed_particle_environment_is_frozen_and_others_continue(run, device):
    """A state that becomes non-finite freezes its environment only."""
    model = scene().build(envs=3, device=device, precision=run[0].precision)
    model["ball.linear_velocity"] = run[0]["ball.linear_velocity"]
    velocity = model.state.body_linear_velocity
    broken = velocity.numpy().copy()
    broken[1, 5] = np.nan
    velocity.assign(broken)
    wc.Simulation(model, dt=DT, deterministic=True).step(STEPS)
    assert model.health().frozen.tolist() == [1]
    np.testing.assert_array_equal(state_bytes(model)[[0, 2]], run[1][[0, 2]])


def test_neighbor_list_overflow_raises(device):
    """Neighbors beyond the capacity are not dropped silently: the next check raises an error with a remedy."""
    model = scene(skin=0.15, max_neighbors=2).build(device=device)
    with pytest.raises(
        RuntimeError, match=r"pile: a particle had \d+ neighbors more.*Increase max_neighbors.*reduce skin"
    ):
        model.sensor("pile.contacts")
    with pytest.raises(RuntimeError, match="neighbors more"):
        wc.Simulation(model, dt=DT).run(2 * DT)


def test_radii_beyond_neighbor_capacity_are_refused(device):
    """The capacity follows from the radii of the scene; radii that need more are rejected."""
    model = scene(max_neighbors=None).build(device=device)
    radii = model["shape.radius"]
    smaller = radii.copy()
    smaller[0, :40] = 0.02
    with pytest.raises(ValueError, match=r"pile: with these radii 'shape\[\d+\]' can have \d+ neighbors.*entries"):
        model["shape.radius"] = smaller
    np.testing.assert_array_equal(model["shape.radius"], radii)


def test_particle_results_with_substeps_are_bitwise_identical_for_any_skin(device):
    """A step in which a swept point crosses a surface is first tried as a whole; its lists do not change results."""
    places = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), axis=-1).reshape(-1, 3) * 0.045 + [0, 0, 0.1]
    fast = np.arange(64)[:, None] % 3 == 0
    ends = []
    for skin in (0.003, 0.03):
        made = wc.Scene()
        balls = made.add_bodies(places, 0.1, [1.6e-5] * 3, linear_velocities=fast * [0.3, 0.1, -20.0], name="ball")
        floor = made.add_surface(wc.meshes.grid((4, 4), (8, 8)))
        stiff = wc.ContactMaterial(
            law=wc.laws.LankaraniNikravesh(stiffness=1e6, exponent=1.5, restitution=0.6),
            friction=MATERIAL.friction,
        )
        made.add_contact(made.add_point(balls, (0, 0, 0)), floor, stiff, swept=True, name="floor")
        shape = made.add_shape(balls, wc.shapes.Sphere(0.02))
        made.add_particle_contact(shape, stiff, skin=skin, max_neighbors=40, name="pile")
        model = made.build(device=device)
        sim = wc.Simulation(model, dt=2e-4, crossing_substeps=4, deterministic=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", wc.ContactWarning)  # the step is too long for this floor, on purpose
            sim.step(600)
        assert model.sensor("floor.crossings").sum() > 10
        assert model.health().good
        ends.append(state_bytes(model))
    np.testing.assert_array_equal(*ends)
