"""Invariants of a step: history advances once per step, frozen environments are unchanged, indices are correct."""

import custom_law
import numpy as np
import pytest
from scenes import dropped_sphere, probe, square
from scipy.spatial.transform import Rotation
from warpcontact.kernels.types import ENV_FROZEN

import warpcontact as wc
from warpcontact import ContactStatus

G = 9.81


# History


def test_every_bounce_has_its_own_entry_speed(device):
    e = np.array([0.5, 0.8])
    law = wc.laws.HuntCrossley(stiffness=1e6, restitution=0.5)
    model = dropped_sphere(law, height=1e-3, velocity=(0, 0, -1), envs=2, device=device, precision="float64")
    model["touch.law.restitution"] = e
    sim = wc.Simulation(model, dt=2e-5)
    for speed in (1.0, 3.0, 0.5):
        sim.state.body_linear_velocity.fill_(model.types.vec3(0.0, 0.0, -speed))
        sim.step(2500)
        assert (model.sensor("touch.status") == ContactStatus.OPEN).all()
        # About 500 steps per contact.
        np.testing.assert_allclose(model.sensor("ball.linear_velocity")[:, 2], e * speed, rtol=1e-3)
        sim.state.body_position.fill_(model.types.vec3(0.0, 0.0, 0.101))


def test_faster_reloading_increases_the_entry_speed(device):
    model = dropped_sphere(
        wc.laws.HuntCrossley(stiffness=1e5, restitution=0.5), height=1e-4, velocity=(0, 0, -0.1), device=device
    )
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(20)
    history = model.arrays.history.entry_speed
    np.testing.assert_allclose(history.numpy()[0, 0], 0.1, rtol=1e-3)
    sim.state.body_linear_velocity.fill_(model.types.vec3(0.0, 0.0, -2.0))
    sim.step(1)
    np.testing.assert_allclose(history.numpy()[0, 0], 2.0, rtol=1e-6)
    sim.state.body_position.fill_(model.types.vec3(0.0, 0.0, 1.0))
    sim.step(1)
    assert history.numpy()[0, 0] == -1.0


def test_slow_contacts_use_the_speed_floor(device):
    law = wc.laws.HuntCrossley(stiffness=1e5, restitution=0.5, speed_floor=0.2)
    model = dropped_sphere(law, height=-1e-3, velocity=(0, 0, -0.1), device=device, precision="float64")
    factor = wc.kernels.laws.hunt_crossley.damping_factor_of_restitution(0.5)
    expected = 1e5 * 1e-3**1.5 * (1 + factor * 0.1 / 0.2)
    np.testing.assert_allclose(model.sensor("touch.normal_force"), expected, rtol=1e-9)


LATCH = [
    # Start, options, later positions of the point, status at the end.
    ((0.5, -0.5, 0.1), {}, [(0.5, -0.5, -0.01)], ContactStatus.CONTACT),
    ((0.5, -0.5, -0.1), {}, [(0.5, -0.5, -0.01)], ContactStatus.WRONG_SIDE),
    ((0.5, -0.5, 0.1), {"max_depth": 0.05}, [(0.5, -0.5, -0.2), (0.5, -0.5, -0.01)], ContactStatus.WRONG_SIDE),
    ((0.5, -0.5, 0.1), {}, [(-0.5, 0.5, -0.01), (0.5, -0.5, -0.01)], ContactStatus.WRONG_SIDE),
    ((-0.5, 0.5, 0.1), {}, [(0.5, -0.5, -0.01)], ContactStatus.CONTACT),
    ((0.5, -0.5, 0.1), {"search_radius": 0.5}, [(0.5, -0.5, 3.0), (0.5, -0.5, -0.01)], ContactStatus.CONTACT),
    ((0.5, -0.5, -0.1), {"search_radius": 0.5}, [(0.5, -0.5, -3.0), (0.5, -0.5, -0.01)], ContactStatus.WRONG_SIDE),
    ((0.5, -0.5, 0.1), {}, [(1.5, -0.5, -0.1), (0.5, -0.5, -0.01)], ContactStatus.WRONG_SIDE),
]


@pytest.mark.parametrize(("start", "options", "path", "status"), LATCH)
def test_latch_follows_its_state_table(start, options, path, status, device):
    scene = wc.Scene(gravity=(0, 0, 0))
    # The upper left half is inactive.
    surface = scene.add_surface(square(), active_faces=[0])
    body = scene.add_body(1.0, (1, 1, 1), position=start, name="body")
    law = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0))
    point = scene.add_point(body, (0, 0, 0))
    scene.add_contact(point, surface, law, entry="latched", name="touch", **options)
    sim = wc.Simulation(scene.build(device=device), dt=1e-6)
    sim.step()
    for place in path:
        sim.state.body_position.assign(np.array([[place]], dtype=np.float32))
        sim.step()
    assert sim.model.sensor("touch.status")[0] == status


def test_disabled_contact_keeps_its_latch(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), height=0.1, entry="latched", device=device)
    sim = wc.Simulation(model, dt=1e-6)
    sim.step()
    model["touch.enabled"] = 0
    sim.state.body_position.fill_(model.types.vec3(0.0, 0.0, 0.09))
    sim.step(2)
    model["touch.enabled"] = 1
    assert model.sensor("touch.status")[0] == ContactStatus.CONTACT


# Frozen environments


def spread_of(model):
    """Returns all device arrays with one row per environment, by name."""
    a = model.arrays
    return {
        f"{part}.{name}": getattr(struct, name)
        for part, struct in (
            ("state", a.state),
            ("history", a.history),
            ("contacts", a.contacts),
            ("wrenches", a.wrenches),
        )
        for name in struct._cls.vars
    }


def test_frozen_environment_is_unchanged_by_steps(device):
    friction = wc.friction.Tanh(mu=0.4)
    model = dropped_sphere(
        wc.laws.HuntCrossley(stiffness=1e4, restitution=0.5), friction=friction, gravity=(0, 0, -G), height=-1e-3,
        velocity=(0.5, 0, 0), envs=4, device=device,
    )  # fmt: skip
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(5)
    status = model.arrays.status.numpy().copy()
    status[2] = ENV_FROZEN
    model.arrays.status.assign(status)
    # A pattern that any write would overwrite.
    rng = np.random.default_rng(8)
    before = {}
    for name, array in spread_of(model).items():
        values = array.numpy().copy()
        if np.issubdtype(values.dtype, np.floating):
            values[2] = rng.uniform(0.1, 0.9, values[2].shape)
        else:
            values[2] = 1
        array.assign(values)
        before[name] = values[2].copy()
    for count in (1, 2, 3):
        sim.step(count)
        for name, array in spread_of(model).items():
            np.testing.assert_array_equal(array.numpy()[2], before[name], err_msg=name)
    model.evaluate()
    for name, array in spread_of(model).items():
        if name.startswith(("state.", "history.")):
            np.testing.assert_array_equal(array.numpy()[2], before[name], err_msg=name)
    assert model.health().frozen.tolist() == [2]


def test_sensors_of_frozen_environment_use_its_stored_state(device):
    """Not the positions at the last detection, which may be many steps old for distant points."""
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), height=1.0, envs=2, device=device)
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(300)
    velocity = sim.state.body_linear_velocity.numpy().copy()
    velocity[1] = 1e25  # its square overflows float32
    sim.state.body_linear_velocity.assign(velocity)
    sim.step()
    assert model.health().frozen.tolist() == [1]
    np.testing.assert_allclose(model.sensor("touch.gap"), [0.699, 0.7], atol=1e-5)
    np.testing.assert_allclose(model.sensor("touch.gap"), model.sensor("ball.position")[:, 2] - 0.1, atol=1e-6)


def test_frozen_environment_is_unchanged_by_another_simulation(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), gravity=(0, 0, -G), height=-0.01, envs=4, device=device)
    stiffness = np.full(4, 1e4)
    stiffness[2] = 1e38
    model["touch.law.stiffness"] = stiffness
    wc.Simulation(model, dt=1e-3).step(10)
    held = model.sensor("ball.position")[2], model.sensor("ball.orientation")[2]
    np.testing.assert_allclose(held[0], (0, 0, 0.09), atol=1e-6)
    wc.Simulation(model, dt=1e-4).step(1)
    np.testing.assert_array_equal(model.sensor("ball.position")[2], held[0])
    np.testing.assert_array_equal(model.sensor("ball.orientation")[2], held[1])


def test_law_returning_nan_freezes_its_environment(device):
    model = dropped_sphere(custom_law.Broken(stiffness=1e4, depth=5e-3), height=1e-3, envs=2, device=device)
    model["touch.law.depth"] = [5e-3, 1.0]
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(300)
    assert model.health().frozen.tolist() == [0]


# Indices


def test_contacts_use_their_own_surface_points_and_law(device):
    """Two rotated meshes, one on a rotated body, and two friction models of one class match hand values."""
    scene = wc.Scene(gravity=(0, 0, 0))
    turn = Rotation.from_euler("xyz", [0.3, -0.4, 0.5])
    tilt = Rotation.from_euler("xyz", [-0.2, 0.1, 0.7])
    carrier = scene.add_body(1.0, (1, 1, 1), position=(5, 0, 1), orientation=tilt.as_quat(), name="carrier")
    first = scene.add_surface(square(2.0), position=(0, 0, 1), orientation=turn.as_quat(), name="first")
    second = scene.add_surface(
        wc.meshes.box((1, 1, 1)), carrier, position=(0.2, 0, 0), orientation=turn.as_quat(), name="second"
    )
    up = turn.apply((0, 0, 1))
    side = tilt.apply(turn.apply((1, 0, 0)))
    above = np.array((0, 0, 1)) + turn.apply((0.3, -0.4, -0.01))
    beside = np.array((5, 0, 1)) + tilt.apply(np.array((0.2, 0, 0)) + turn.apply((0.48, 0.1, 0.2)))
    slide, glide = turn.apply((1.0, 0, 0)), tilt.apply(turn.apply((0, 2.0, 0)))
    one = scene.add_body(1.0, (1, 1, 1), position=above, linear_velocity=slide, name="one")
    two = scene.add_body(1.0, (1, 1, 1), position=beside, linear_velocity=glide, name="two")
    for name, body, surface, stiffness, mu in (("a", one, first, 1e4, 0.2), ("b", two, second, 2e4, 0.5)):
        material = wc.ContactMaterial(
            law=wc.laws.Hooke(stiffness=stiffness), friction=wc.friction.RegularizedCoulomb(mu=mu)
        )
        scene.add_contact(scene.add_point(body, (0, 0, 0)), surface, material, name=name)
    model = scene.build(device=device, precision="float64")
    np.testing.assert_allclose(model.sensor("a.gap"), -0.01, atol=1e-12)
    np.testing.assert_allclose(model.sensor("b.gap"), -0.02, atol=1e-12)
    np.testing.assert_allclose(model.sensor("a.normal")[0], up, atol=1e-12)
    np.testing.assert_allclose(model.sensor("b.normal")[0], side, atol=1e-12)
    np.testing.assert_allclose(model.sensor("one.force")[0], 100 * up - 0.2 * 100 * slide, atol=1e-9)
    np.testing.assert_allclose(model.sensor("two.force")[0], 400 * side - 0.5 * 400 * glide / 2, atol=1e-9)
    np.testing.assert_allclose(model.sensor("carrier.force"), -model.sensor("two.force"))


def test_coincident_vertices_are_welded(device):
    """The vertices of a triangle soup have the pseudonormals of the solid."""
    cube = wc.meshes.box((1.0, 1.0, 1.0))
    soup = wc.Mesh(cube.vertices[cube.faces].reshape(-1, 3), np.arange(36).reshape(12, 3))
    rng = np.random.default_rng(9)
    points = rng.uniform(-1, 1, (2000, 3))
    one, other = probe(cube, points, radius=0.1, device=device), probe(soup, points, radius=0.1, device=device)
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


# Parameters and prepared launches


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("touch.law.stiffness", [1e4, 3e4, 9e4]),
        ("touch.law.restitution", [0.2, 0.5, 0.9]),
        ("touch.friction.mu", [0.0, 0.3, 0.9]),
        ("ball.mass", [0.5, 1.0, 2.0]),
        ("ball.inertia", [np.diag(m) for m in ((1e-3, 1e-3, 1e-3), (4e-3, 3e-3, 2e-3), (9e-3, 9e-3, 9e-3))]),
        ("scene.gravity", [(0, 0, -9), (1, 0, -9), (0, 2, -5)]),
        ("ground.position", [(0, 0, 0), (0, 0, 0.001), (0, 0, -0.002)]),
        ("ground.orientation", Rotation.from_rotvec([(0, 0, 0), (0.1, 0, 0), (0, 0.05, 0)]).as_quat()),
        ("touch.radius", [0.1, 0.101, 0.099]),
        ("touch.kappa", [0.0, 0.5, 1.0]),
        ("centre.position", [(0, 0, 0), (0.01, 0, 0), (0, 0.01, -0.001)]),
    ],
)
def test_parameter_changed_between_steps_equals_parameter_set_before(name, value, device):
    """A parameter that becomes different per environment is reallocated; prepared launches must use the new array."""

    def model():
        made = dropped_sphere(
            wc.laws.HuntCrossley(stiffness=1e4, restitution=0.5),
            friction=wc.friction.Tanh(mu=0.3), gravity=(0, 0, -G), height=-1e-3, velocity=(1, 0, 0), envs=3,
            device=device,
        )  # fmt: skip
        made["ball.angular_velocity"] = (3.0, 1.0, 2.0)
        return made

    late, early = model(), model()
    one, other = wc.Simulation(late, dt=1e-3), wc.Simulation(early, dt=1e-3)
    one.step(2)
    one.reset()
    late[name] = value
    early[name] = value
    for sim in (one, other):
        sim.step(50)
    for quantity in ("position", "orientation", "linear_velocity", "angular_velocity"):
        first, second = late.sensor(f"ball.{quantity}"), early.sensor(f"ball.{quantity}")
        np.testing.assert_array_equal(first, second)
    moved = late.sensor("ball.linear_velocity"), late.sensor("ball.angular_velocity")
    assert not np.array_equal(moved[0][0], moved[0][2]) or not np.array_equal(moved[1][0], moved[1][2])


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("ball.mass", 1e39, "body_mass: 1e.39 does not fit into float32"),
        ("ball.mass", 1e-46, "body_mass: 1e-46 does not fit into float32"),
        ("ground.position", (0, 0, 1e39), "surface_position: 1e.39 does not fit into float32"),
        ("touch.law.stiffness", 1e39, "stiffness: 1e.39 does not fit into float32"),
        ("touch.enabled", 0.7, r"touch.enabled\[0, 0\] must be 0 or 1, got 0.7"),
    ],
)
def test_values_out_of_device_range_are_refused_without_changes(name, value, message, device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), height=-1e-3, device=device)
    before, force = model[name], model.sensor("touch.normal_force")
    with pytest.raises(ValueError, match=message):
        model[name] = value
    np.testing.assert_array_equal(model[name], before)
    np.testing.assert_array_equal(model.sensor("touch.normal_force"), force)
    with pytest.raises(ValueError, match="dt: 1e-50 does not fit into float32"):
        wc.Simulation(model, dt=1e-50)


def test_parameter_value_is_a_copy():
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), envs=3)
    kept = model["ball.mass"]
    model["ball.mass"] = 9.0
    assert kept.tolist() == [1, 1, 1]
    model["ball.mass"] = kept
    assert model["ball.mass"].tolist() == [1, 1, 1]


def test_state_arrays_cannot_be_replaced():
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4))
    with pytest.raises(AttributeError):
        model.state.body_position = None


def test_simulation_time_is_the_time_of_the_state(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), device=device)
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(5)
    np.testing.assert_allclose(sim.time, 5e-3)
    np.testing.assert_allclose(wc.Simulation(model, dt=1e-4).time, 5e-3)
    model.reset()
    assert sim.time == 0.0
    assert sim.steps == 0


# Far from the origin of a mesh


@pytest.mark.parametrize("offset", [0.0, 10.0, 1000.0])
def test_floor_near_a_wall_is_nearest_far_from_the_origin(offset, device):
    """Nearly equal distances are compared by coordinate differences, which round less than coordinates."""
    corner = wc.Mesh(
        np.array([(0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0), (0, 4, 4), (0, 0, 4)]) + offset,
        [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)],
    )
    # A sphere 1 mm in the floor and 0.5 mm in the wall.
    place = np.array([(0.0995, 2.0, 0.099)]) + offset
    for precision, exact in (("float32", 2e-7 * max(offset, 1.0)), ("float64", 1e-15 * max(offset, 4.0))):
        sensors = probe(corner, place, radius=0.1, device=device, precision=precision)
        np.testing.assert_allclose(sensors["gap"], -1e-3, atol=exact)
        np.testing.assert_allclose(sensors["normal"][0], (0, 0, 1), atol=1e-6)
