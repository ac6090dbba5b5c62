"""Complete steps against closed forms: rest, rolling, sliding, creeping, spinning, conservation."""

import numpy as np
import pytest
from closed_forms import creep_speed, sliding_acceleration
from scenes import dropped_sphere, square

import warpcontact as wc

G = 9.81


def test_free_fall_matches_the_scheme(device):
    model = dropped_sphere(
        wc.laws.Hooke(stiffness=1e4), gravity=(0, 0, -G), height=10.0, velocity=(1, 0, 0), device=device
    )
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(1000)
    # Semi-implicit Euler falls by ½ g t² (1 + dt/t). 1000 additions of 1e-2 to 10 in float32 lose about 1e-4.
    np.testing.assert_allclose(
        model.sensor("ball.position")[0], (1.0, 0.0, 10.1 - 0.5 * G * 1.001), rtol=1e-5, atol=2e-4
    )
    np.testing.assert_allclose(model.sensor("ball.linear_velocity")[0], (1, 0, -G), rtol=1e-5)


def test_static_penetration_is_weight_over_stiffness(device):
    mass = np.array([0.5, 1.0, 2.0])
    model = dropped_sphere(
        wc.laws.KelvinVoigt(stiffness=1e4, damping=100.0),
        gravity=(0, 0, -G), velocity=(0, 0, 0), envs=3, device=device,
    )  # fmt: skip
    model["ball.mass"] = mass
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(2000)
    # float32 loses a displacement dt v below half a digit of 0.1, 3.7e-9 m. The last speed, 3.7e-6 m/s, leaves a
    # dashpot force of 3.7e-4 N, or 3.7e-8 m. The rounding of the position adds one digit.
    np.testing.assert_allclose(model.sensor("touch.penetration"), mass * G / 1e4, atol=5e-8)
    np.testing.assert_allclose(model.sensor("ball.position")[:, 2], 0.1 - mass * G / 1e4, atol=5e-8)


def test_static_penetration_of_body_on_four_points_matches_reference(device):
    # FORCE_LAWS G7: m = 2 kg on four points, K = 1e6 N/m^1.5.
    scene = wc.Scene()
    ground = scene.add_surface(square())
    table = scene.add_body(2.0, (0.1, 0.1, 0.1), position=(0.05, 0.02, 0.2), name="table")
    legs = scene.add_points(table, [(x, y, -0.2) for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
    law = wc.laws.HuntCrossley(stiffness=1e6, restitution=0.5)
    scene.add_contact(legs, ground, wc.ContactMaterial(law=law), name="touch")
    model = scene.build(device=device, precision="float64")
    wc.Simulation(model, dt=1e-4).step(10000)
    # The reference has ten digits. One second is about 30 time constants of the damping at rest.
    np.testing.assert_allclose(model.sensor("touch.penetration")[0], 2.886861893e-4, rtol=1e-9)


def test_sliding_sphere_rolls_at_five_sevenths_of_its_speed(device):
    # FORCE_LAWS G10: v₀ = 3 m/s, μ = 0.2, R = 0.05 m.
    model = dropped_sphere(
        wc.laws.KelvinVoigt(stiffness=1e5, damping=300.0),
        friction=wc.friction.RegularizedCoulomb(mu=0.2, velocity_scale=1e-3),
        radius=0.05, gravity=(0, 0, -G), velocity=(3, 0, 0), height=-G / 1e5, device=device,
    )  # fmt: skip
    sim = wc.Simulation(model, dt=2e-4)
    recording = sim.run(1.0, ["ball.linear_velocity", "ball.position"], every=2e-3)
    speed = recording["ball.linear_velocity"].sel(axis="x").values[:, 0]
    np.testing.assert_allclose(speed[-1], 15 / 7, rtol=1e-3)
    # Deceleration is μ g until t = 2 v₀/(7 μ g).
    half = recording.time.values <= 0.4
    np.testing.assert_allclose(speed[half], 3.0 - 0.2 * G * recording.time.values[half], rtol=1e-3)
    where = recording["ball.position"].interp(time=0.4368719965).sel(axis="x").values[0]
    np.testing.assert_allclose(where, 1.123385134, rtol=2e-3)


def block_on_incline(slope, mu, velocity_scale, device):
    """A block on four points, on a slope made by tilted gravity."""
    scene = wc.Scene(gravity=(G * np.sin(slope), 0, -G * np.cos(slope)))
    ground = scene.add_surface(square(20.0))
    half, height = 0.2, 0.05
    block = scene.add_body(1.0, (0.01, 0.01, 0.02), position=(0, 0, height), name="block")
    feet = scene.add_points(block, [(x, y, -height) for x in (-half, half) for y in (-half, half)])
    law = wc.laws.KelvinVoigt(stiffness=1e5, damping=200.0)
    material = wc.ContactMaterial(law=law, friction=wc.friction.Tanh(mu=mu, velocity_scale=velocity_scale))
    scene.add_contact(feet, ground, material, name="touch")
    return scene.build(device=device)


def test_block_slides_down_an_incline_as_coulomb(device):
    slope = np.radians(30.0)
    model = block_on_incline(slope, 0.3, 1e-3, device)
    sim = wc.Simulation(model, dt=2e-4)
    sim.step(2500)  # settled, and far above v_s
    early = model.sensor("block.linear_velocity")[0, 0]
    sim.step(2500)
    late = model.sensor("block.linear_velocity")[0, 0]
    np.testing.assert_allclose((late - early) / 0.5, sliding_acceleration(slope, 0.3), rtol=0.01)
    np.testing.assert_allclose(sliding_acceleration(slope, 0.3), 2.356287237, rtol=1e-9)


def test_block_creeps_as_tanh_friction_predicts(device):
    # FORCE_LAWS G9: 10°, μ = 0.3, k_t = 100 s/m.
    slope = np.radians(10.0)
    model = block_on_incline(slope, 0.3, 0.01, device)
    wc.Simulation(model, dt=2e-4).step(5000)
    speed = model.sensor("block.linear_velocity")[0, 0]
    np.testing.assert_allclose(creep_speed(slope, 0.3, 0.01), 6.742317056e-3, rtol=1e-9)
    # The block tips by some microradians: the normal forces of its four points differ, but not their sum.
    np.testing.assert_allclose(speed, creep_speed(slope, 0.3, 0.01), rtol=2e-3)


@pytest.mark.parametrize(
    ("mu", "tangential", "expected", "spin"),
    # FORCE_LAWS G14: v_n = 2, e = 0.7, R = 0.05; sliding throughout, then rolling.
    [(0.1, 3.0, 2.66, 17.0), (0.4, 1.0, 5.0 / 7.0, 14.28571429)],
)
def test_oblique_impact_of_a_sphere_matches_rigid_body_theory(mu, tangential, expected, spin, device):
    model = dropped_sphere(
        wc.laws.HuntCrossley(stiffness=1e6, restitution=0.7),
        friction=wc.friction.RegularizedCoulomb(mu=mu, velocity_scale=1e-3),
        # The force at the deepest point has the radius as its lever arm, as in the rigid oracle.
        radius=0.05, height=1e-4, velocity=(tangential, 0, -2.0), kappa=1.0, device=device,
    )  # fmt: skip
    wc.Simulation(model, dt=1e-5).step(3000)
    velocity = model.sensor("ball.linear_velocity")[0]
    np.testing.assert_allclose(velocity[2], 1.4, rtol=2e-3)
    np.testing.assert_allclose(velocity[0], expected, rtol=2e-3)
    np.testing.assert_allclose(model.sensor("ball.angular_velocity")[0, 1], spin, rtol=2e-3)


def spinning(inertia, omega, device, precision="float32", orientation=(0, 0, 0, 1)):
    scene = wc.Scene(gravity=(0, 0, 0))
    scene.add_body(
        2.0, inertia, linear_velocity=(0.3, -0.2, 0.1), angular_velocity=omega, orientation=orientation, name="top"
    )
    return scene.build(device=device, precision=precision)


def test_free_symmetric_top_precesses_at_closed_form_rate(device):
    # FORCE_LAWS G15: I = (0.02, 0.02, 0.035), ω = (2, 0, 30) in the body: the axis precesses about L at 52.538
    # rad/s.
    model = spinning((0.02, 0.02, 0.035), (2.0, 0.0, 30.0), device, "float64")
    momentum = model.sensor("top.angular_momentum")[0] - np.cross(
        model.sensor("top.position")[0], model.sensor("top.linear_momentum")[0]
    )
    period = 2 * np.pi / 52.53808143
    steps = 2000
    sim = wc.Simulation(model, dt=period / steps)
    sim.step(steps)
    x, y, z, w = model.sensor("top.orientation")[0]
    axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    # After one revolution about L the axis has its initial direction.
    np.testing.assert_allclose(axis, (0, 0, 1), atol=1e-5)
    cosine = momentum @ (0, 0, 1) / np.linalg.norm(momentum)
    np.testing.assert_allclose(np.degrees(np.arccos(cosine)), 2.181641404, rtol=1e-7)


def test_asymmetric_top_flips_as_closed_form(device):
    # FORCE_LAWS G15b: I = (1, 2, 3), ω₀ = (0.1, 5, 0): after half a period ω = (0.1, −5, 0) in the body.
    model = spinning((1.0, 2.0, 3.0), (0.1, 5.0, 0.0), device, "float64")
    half = 7.340968435 / 2
    steps = 8000
    wc.Simulation(model, dt=half / steps).step(steps)
    x, y, z, w = model.sensor("top.orientation")[0]
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    np.testing.assert_allclose(rotation.T @ model.sensor("top.angular_velocity")[0], (0.1, -5, 0), atol=2e-3)


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 1e-5), ("float64", 1e-13)])
def test_free_bodies_conserve_momentum(precision, tolerance, device):
    model = spinning((1.0, 2.0, 3.0), (0.1, 5.0, 1.0), device, precision, orientation=(0.5, 0.5, 0.5, 0.5))
    before = {key: model.sensor(f"top.{key}")[0] for key in ("linear_momentum", "angular_momentum")}
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(2000)
    np.testing.assert_array_equal(model.sensor("top.linear_momentum")[0], before["linear_momentum"])
    # 2000 roundings of a momentum of size 10 as a random walk, with inertias up to 3: 10 ε √2000 · 3.
    np.testing.assert_allclose(
        model.sensor("top.angular_momentum")[0], before["angular_momentum"], atol=10 * tolerance
    )


def test_energy_of_a_free_body_converges_at_second_order(device):
    errors = []
    for steps in (200, 400, 800):
        model = spinning((1.0, 2.0, 3.0), (0.5, 5.0, 1.0), device, "float64")
        start = model.sensor("top.kinetic_energy")[0]
        wc.Simulation(model, dt=2.0 / steps).step(steps)
        errors.append(abs(model.sensor("top.kinetic_energy")[0] - start) / start)
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert errors[-1] < 1e-4
    assert (orders > 1.8).all(), (errors, orders)


def test_bounce_height_converges_at_first_order(device):
    """Height after a damped bounce, against a reference with a much smaller step."""

    def height(dt):
        model = dropped_sphere(
            wc.laws.HuntCrossley(stiffness=1e5, restitution=0.6),
            gravity=(0, 0, -G), height=0.05, velocity=(0, 0, 0), device=device, precision="float64",
        )  # fmt: skip
        sim = wc.Simulation(model, dt=dt)
        sim.step(round(0.2 / dt))
        return model.sensor("ball.position")[0, 2]

    reference = height(1.25e-6)
    coarse, fine = (abs(height(dt) - reference) for dt in (2e-4, 2.5e-5))
    # With a step eight times smaller, the error falls by four to sixteen, because the phase of the first contact
    # is arbitrary.
    assert 4 < coarse / fine < 16
    assert fine < 1e-4


def test_contact_of_two_bodies_conserves_momentum(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    block = scene.add_body(3.0, (0.05, 0.05, 0.05), angular_velocity=(0.1, 0.2, -0.3), name="block")
    surface = scene.add_surface(wc.meshes.box((0.4, 0.4, 0.4)), block)
    ball = scene.add_body(
        2.0, (0.02, 0.02, 0.02), position=(0.4, 0.05, 0.02), linear_velocity=(-1, 0, 0), name="ball"
    )
    material = wc.ContactMaterial(
        law=wc.laws.HuntCrossley(stiffness=1e6, restitution=0.6), friction=wc.friction.Tanh(mu=0.3)
    )
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), surface, material, radius=0.1, name="touch")
    model = scene.build(device=device, precision="float64")
    linear, angular = model.sensor("scene.linear_momentum"), model.sensor("scene.angular_momentum")
    energy = model.sensor("scene.kinetic_energy")
    sim = wc.Simulation(model, dt=1e-4)
    recording = sim.run(0.3, ["touch.normal_force"], every=1e-3)
    assert recording["touch.normal_force"].max() > 100
    np.testing.assert_allclose(model.sensor("scene.linear_momentum"), linear, atol=1e-13)
    # Positions advance with the new velocities, so x⁺ × v⁺ = x × v⁺: a step conserves angular momentum.
    np.testing.assert_allclose(model.sensor("scene.angular_momentum"), angular, atol=1e-13)
    assert model.sensor("scene.kinetic_energy")[0] < energy[0]
