"""Motion under body contact: vibration, rest, stacks, and friction of patches in closed form."""

import numpy as np
import pytest
from part_meshes import prism
from scipy.spatial.transform import Rotation

import warpcontact as wc

GRAVITY = 9.81
CUBE = 0.2  # m
MASS = 8.0  # kg
K = 2e7  # Pa/m
INERTIA = MASS * CUBE**2 / 6


def cube_on_plane(
    device,
    envs=1,
    *,
    damping=0.0,
    friction=None,
    gravity=(0, 0, -GRAVITY),
    size=(CUBE, CUBE, CUBE),
    precision="float64",
):
    """Returns a model of a box above a half-space, at its depth at rest."""
    scene = wc.Scene(gravity=gravity)
    depth = MASS * GRAVITY / (K * size[0] * size[1])
    body = scene.add_body(mass=MASS, inertia=[INERTIA] * 3, position=(0, 0, size[2] / 2 - depth), name="cube")
    shape = scene.add_shape(body, wc.shapes.RoundedBox(tuple(np.array(size) / 2)), name="shape")
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    law = wc.laws.ElasticFoundation(stiffness=K, damping=damping)
    scene.add_body_contact(shape, floor, wc.ContactMaterial(law=law, friction=friction), name="touch")
    return scene.build(envs=envs, device=device, precision=precision)


def angular_frequency(times, values):
    """Returns the angular frequency of an oscillation about its mean, from its zero crossings."""
    values = values - values.mean()
    up = np.flatnonzero((values[:-1] < 0) & (values[1:] >= 0))
    crossings = times[up] - values[up] * (times[up + 1] - times[up]) / (values[up + 1] - values[up])
    return 2 * np.pi / np.diff(crossings).mean()


def test_heave_and_rocking_have_the_frequencies_of_the_closed_form(device):
    model = cube_on_plane(device, envs=2)
    depth = MASS * GRAVITY / (K * CUBE**2)
    model["cube.position"] = [[0, 0, CUBE / 2 - 1.01 * depth], [0, 0, CUBE / 2 - depth]]
    angle = 1e-5
    model["cube.orientation"] = [[0, 0, 0, 1], [0, np.sin(angle / 2), 0, np.cos(angle / 2)]]
    dt = 1e-5
    recording = wc.Simulation(model, dt=dt).run(0.8, record=["cube.position", "cube.orientation"], every=1e-4)
    times = recording["time"].values
    heave = recording["cube.position"].values[:, 0, 2]
    rocking = recording["cube.orientation"].values[:, 1, 1]
    expected_heave = np.sqrt(K * CUBE**2 / MASS)
    expected_rocking = np.sqrt((K * CUBE**4 / 12 - MASS * GRAVITY * (CUBE / 2 - depth)) / INERTIA)
    # First order in dt ω = 5e-4, and in the amplitude.
    assert angular_frequency(times, heave) == pytest.approx(expected_heave, rel=1e-3)
    assert angular_frequency(times, rocking) == pytest.approx(expected_rocking, rel=2e-3)


def cundall_strack(mu):
    """Returns friction with a stiff, well damped spring."""
    return wc.friction.CundallStrack.from_overshoot(
        mu_static=mu, mu_dynamic=mu, stiffness=1e6, mass=MASS, overshoot=0.01
    )


def test_tilted_cube_comes_to_rest(device):
    model = cube_on_plane(device, envs=2, damping=50.0, friction=cundall_strack(0.5))
    angle = np.radians(5)
    tilt = [0, np.sin(angle / 2), 0, np.cos(angle / 2)]
    model["cube.position"] = [[0, 0, 0.12], [0, 0, 0.12]]
    model["cube.orientation"] = [tilt, [tilt[1] / 2, tilt[1], 0.0, tilt[3]]]
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(20_000)
    before = model.sensor("cube.position")
    sim.step(10_000)
    depth = MASS * GRAVITY / (K * CUBE**2)
    np.testing.assert_allclose(model.sensor("cube.position")[:, 2], CUBE / 2 - depth, atol=1e-9)
    assert np.abs(model.sensor("cube.linear_velocity")).max() < 1e-9
    assert np.abs(model.sensor("cube.angular_velocity")).max() < 1e-9
    assert np.abs(model.sensor("cube.position") - before).max() < 1e-9
    np.testing.assert_allclose(model.sensor("touch.normal_force"), MASS * GRAVITY, rtol=1e-9)


def test_friction_of_a_patch_holds_and_slides_at_its_limits(device):
    """Force and torque at rest below μ N and μ N r_f; motion above them."""
    mu = 0.5
    load = mu * MASS * GRAVITY
    radius = CUBE * (np.sqrt(2) + np.arcsinh(1)) / 6  # of friction of a square
    model = cube_on_plane(device, envs=4, damping=50.0, friction=cundall_strack(mu))
    force, torque = np.zeros((4, 3)), np.zeros((4, 3))
    force[:2, 0] = np.array([0.98, 1.02]) * load
    torque[2:, 2] = np.array([0.98, 1.02]) * load * radius
    model["cube.external_force"], model["cube.external_torque"] = force, torque
    # A force at the center of mass tips: its torque moves the center of pressure.
    torque[:2, 1] = -force[:2, 0] * CUBE / 2
    model["cube.external_torque"] = torque
    sim = wc.Simulation(model, dt=5e-5)
    sim.step(20_000)
    speed = np.abs(model.sensor("cube.linear_velocity")[:, 0])
    spin = np.abs(model.sensor("cube.angular_velocity")[:, 2])
    assert speed[0] < 1e-6
    assert speed[1] == pytest.approx(0.02 * load / MASS * sim.time, rel=0.1)
    assert spin[2] < 1e-6
    assert spin[3] == pytest.approx(0.02 * load * radius / INERTIA * sim.time, rel=0.1)


def test_coulomb_friction_of_sliding_and_spinning_squares(device):
    """Friction without history acts at each point: force μ N in pure sliding, torque μ N r_f in pure spin."""
    friction = wc.friction.Tanh(mu=0.5, velocity_scale=1e-9)
    model = cube_on_plane(device, envs=2, friction=friction)
    model["cube.linear_velocity"] = [[1.0, 0, 0], [0, 0, 0]]
    model["cube.angular_velocity"] = [[0, 0, 0], [0, 0, 1.0]]
    load = 0.5 * MASS * GRAVITY
    np.testing.assert_allclose(model.sensor("touch.friction_force")[0], [-load, 0, 0], atol=1e-9 * load)
    radius = CUBE * (np.sqrt(2) + np.arcsinh(1)) / 6
    # Quadrature of a direction field that is singular at the center.
    assert model.sensor("touch.torque")[1, 2] == pytest.approx(-load * radius, rel=5e-3)


@pytest.mark.parametrize(
    ("offset", "steps"), [(0.0, 10_000), pytest.param(0.005, 120_000, marks=pytest.mark.slow)]
)
def test_stack_of_boxes_stays_at_rest(offset, steps, device):
    """Offset boxes tilt slightly, and the tower swings for some seconds."""
    scene = wc.Scene()
    law = wc.laws.ElasticFoundation(stiffness=K, damping=50.0)
    friction = cundall_strack(0.5)
    below = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    height = 0.0
    for i in range(4):
        area = CUBE * (CUBE - (offset if i else 0.0))
        height -= (4 - i) * MASS * GRAVITY / (K * area)
        body = scene.add_body(
            mass=MASS,
            inertia=[INERTIA] * 3,
            position=(offset * i, 0, height + (i + 0.5) * CUBE),
            name=f"box_{i}",
        )
        shape = scene.add_shape(body, wc.shapes.RoundedBox((CUBE / 2,) * 3), name=f"shape_{i}")
        material = wc.ContactMaterial(law=law, friction=friction)
        scene.add_body_contact(shape, below, material, name=f"touch_{i}")
        below = shape
    model = scene.build(envs=1, device=device, precision="float64")
    sim = wc.Simulation(model, dt=5e-5)
    sim.step(steps)
    before = [model.sensor(f"box_{i}.position") for i in range(4)]
    sim.step(10_000)
    for i in range(4):
        assert np.abs(model.sensor(f"box_{i}.position") - before[i]).max() < 1e-6
        assert np.abs(model.sensor(f"box_{i}.linear_velocity")).max() < 1e-6
        weight = (4 - i) * MASS * GRAVITY
        assert model.sensor(f"touch_{i}.force")[0, 2] == pytest.approx(weight, rel=1e-6)


def test_patches_of_a_pair_share_the_stiffness_of_friction(device):
    """A cube in a right-angled groove of one mesh has two patches; a push along it stretches one spring in total."""
    side, wall, stick, push = 0.1, 0.05, 2e4, 1.0
    outline = [[0, 0], [0.3, 0], [0.3, wall], [wall, wall], [wall, 0.3], [0, 0.3]]
    groove = prism(outline, [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]], 0.4)
    # Walls at 45° that meet along x.
    sine = np.sqrt(0.5)
    axes = Rotation.from_matrix(np.array([[0, -sine, sine], [0, sine, sine], [-1, 0, 0]]).T)
    scene = wc.Scene(gravity=(0, 0, -GRAVITY))
    below = scene.add_surface(groove, orientation=axes.as_quat(), name="groove")
    place = axes.apply([wall + side / 2, wall + side / 2, 0])
    body = scene.add_body(
        mass=1.0, inertia=[side**2 / 6] * 3, position=place, orientation=axes.as_quat(), name="cube"
    )
    shape = scene.add_shape(body, wc.shapes.RoundedBox((side / 2,) * 3))
    friction = wc.friction.CundallStrack.from_overshoot(
        mu_static=0.5, mu_dynamic=0.5, stiffness=stick, mass=1.0, overshoot=0.01
    )
    law = wc.laws.ElasticFoundation(stiffness=K, damping=50.0)
    scene.add_body_contact(shape, below, wc.ContactMaterial(law=law, friction=friction), name="touch")
    model = scene.build(device=device, precision="float64")
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(5000)
    before = model.sensor("cube.position")[0]
    # At the height of the contact, so that the push does not tip.
    arm = before[2] - model.sensor("touch.center")[0, 2]
    model["cube.external_force"], model["cube.external_torque"] = (push, 0, 0), (0, -arm * push, 0)
    sim.step(8000)
    moved = model.sensor("cube.position")[0] - before
    # The overdamped spring approaches its stretch with the time constant c/k = 0.07 s.
    np.testing.assert_allclose(moved, [push / stick, 0, 0], rtol=1e-3, atol=1e-8)
    np.testing.assert_allclose(model.sensor("touch.friction_force")[0, 0], -push, rtol=1e-6)


def test_slow_rotation_in_float32_is_not_lost_to_rounding(device):
    """A step turns the cube by 1e-8 rad, which the rounding of an orientation of 90° about x exceeds."""
    model = cube_on_plane(device, envs=2, gravity=(0, 0, 0), precision="float32")
    model["cube.position"] = (0, 0, 1)
    model["cube.orientation"] = (np.sqrt(0.5), 0, 0, np.sqrt(0.5))
    # In the second environment the inertia is not isotropic; it spins about a principal axis.
    model["cube.inertia"] = [np.diag([INERTIA] * 3), np.diag([INERTIA, 2 * INERTIA, 3 * INERTIA])]
    rate, dt, steps = 1e-4, 1e-4, 20_000
    model["cube.angular_velocity"] = (rate, 0, 0)
    wc.Simulation(model, dt=dt).step(steps)
    start, end = Rotation.from_quat([np.sqrt(0.5), 0, 0, np.sqrt(0.5)]), model.sensor("cube.orientation")
    turned = (Rotation.from_quat(end.astype(float)) * start.inv()).as_rotvec()
    # Two components of the first and the last quaternion are rounded by up to 3e-8.
    np.testing.assert_allclose(turned, [[rate * dt * steps, 0, 0]] * 2, atol=4 * np.sqrt(2) * 3e-8)


def test_orientation_of_any_length_is_normalized_in_float32(device):
    model = cube_on_plane(device, gravity=(0, 0, 0), precision="float32")
    model["cube.position"] = (0, 0, 1)
    model.state.body_orientation.assign(np.array([[[0.0, 0.0, 1.8, 2.4]]], dtype=np.float32))
    wc.Simulation(model, dt=1e-4).step(2)
    np.testing.assert_allclose(model.sensor("cube.orientation")[0], [0, 0, 0.6, 0.8], atol=1e-7)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_simulation_loaded_from_checkpoint_continues_bitwise_identically(tmp_path, precision, device):
    """The history of a sliding and spinning patch, the entry speed, and rounding remainders are stored."""
    models = [
        cube_on_plane(device, envs=2, damping=50.0, friction=cundall_strack(0.5), precision=precision)
        for _ in range(2)
    ]
    for model in models:
        model["cube.linear_velocity"] = [[0.02, 0.01, 0], [0, 0, -0.1]]
        model["cube.angular_velocity"] = [[0, 0, 0.5], [0.1, 0, 0]]
    first, second = (wc.Simulation(model, dt=1e-4) for model in models)
    first.step(300)
    first.save(tmp_path / "state.npz")
    second.load(tmp_path / "state.npz")
    for sim in (first, second):
        sim.step(200)
    for key in ("cube.position", "cube.angular_velocity", "touch.force", "touch.torque"):
        np.testing.assert_array_equal(models[0].sensor(key), models[1].sensor(key))
    assert (np.abs(models[0].sensor("touch.friction_force")).max(axis=1) > 0).all()
