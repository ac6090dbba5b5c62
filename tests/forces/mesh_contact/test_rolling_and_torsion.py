"""Rolling and torsional friction: torques of friction models against relative rotation of two bodies."""

import numpy as np
import pytest
from scenes import dropped_sphere, square

import warpcontact as wc

F = wc.friction
G = 9.81
R = 0.05


def ball_on_plate(*, gravity=(0.0, 0.0, -G), device="cpu", envs=1, precision="float64", stiffness=1e5, **parts):
    """A solid ball of 1 kg and 50 mm in equilibrium on a plate under the normal weight."""
    scene = wc.Scene(gravity=gravity)
    plate = scene.add_surface(square(100.0), name="plate")
    ball = scene.add_body(1.0, [0.4 * R * R] * 3, position=(0, 0, R + gravity[2] / stiffness), name="ball")
    options = {key: parts.pop(key) for key in ("torsion_radius",) if key in parts}
    parts.setdefault("friction", F.CundallStrack(mu_static=0.5, mu_dynamic=0.5, stiffness=1e5, damping=50.0))
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=stiffness), **parts)
    scene.add_contact(
        scene.add_point(ball, (0, 0, 0)), plate, material, radius=R, kappa=0.0, name="touch", **options
    )
    return scene.build(envs=envs, device=device, precision=precision)


def test_rolling_resistance_decelerates_ball_as_closed_form(device):
    # FORCE_LAWS G12: μ_r = 0.01, from 1 m/s: (5/7) μ_r g = 0.07007142857 m/s², 7.135575943 m in 14.27115189 s.
    model = ball_on_plate(rolling=F.Tanh(mu=0.01, velocity_scale=1e-4), stiffness=1e6, device=device)
    model["ball.linear_velocity"] = (1.0, 0, 0)
    model["ball.angular_velocity"] = (0, 1.0 / R, 0)
    sim = wc.Simulation(model, dt=1e-3)
    recording = sim.run(14.5, ["ball.linear_velocity"], every=0.1)
    speed = recording["ball.linear_velocity"].sel(axis="x", env=0)
    # δ/R = 2e-4 of the lever arm of friction.
    np.testing.assert_allclose((speed.sel(time=10) - speed.sel(time=2)) / 8, -0.07007142857, rtol=3e-4)
    np.testing.assert_allclose(recording["ball.position"].sel(axis="x", env=0)[-1], 7.135575943, rtol=3e-4)
    assert abs(float(speed[-1])) < 1e-5


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_rolling_spring_holds_ball_on_a_slope(precision, device):
    """Type C: at rest below tan θ = μ_r; above, rolling with a = (5/7) g (sin θ − μ_r cos θ)."""
    spring = F.CundallStrack(mu_static=0.05, mu_dynamic=0.05, stiffness=2e4, damping=100.0)
    model = ball_on_plate(rolling=spring, envs=3, device=device, precision=precision)
    slope = np.arctan([0.02, 0.045, 0.1])
    model["scene.gravity"] = G * np.column_stack([np.sin(slope), 0 * slope, -np.cos(slope)])
    sim = wc.Simulation(model, dt=2e-4)
    sim.step(2500)
    place, speed = model.sensor("ball.position")[:, 0], model.sensor("ball.linear_velocity")[:, 0]
    sim.step(2500)
    # A spring ignores displacements per step below half a rounding of its stretch, at most 2e-5 m.
    unfelt = 2500 * 0.5 * np.spacing(np.array(2e-5, precision))
    np.testing.assert_allclose(model.sensor("ball.position")[:2, 0], place[:2], rtol=1e-6, atol=unfelt)
    assert (place[:2] < 1e-4).all()
    acceleration = (model.sensor("ball.linear_velocity")[2, 0] - speed[2]) / 0.5
    expected = 5 / 7 * G * (np.sin(slope[2]) - 0.05 * np.cos(slope[2]))
    np.testing.assert_allclose(acceleration, expected, rtol=5e-3)


def test_ball_on_slope_rolls_or_slips_as_closed_form(device):
    # FORCE_LAWS G11: 25°, (5/7) g sin θ = 2.961346534 m/s² above μ = 0.1332307595. At μ = 0.05 it slips with
    # 3.701341178 m/s², and its angular acceleration is 1.111359924 m/s² over R.
    slope = np.radians(25.0)
    gravity = (G * np.sin(slope), 0, -G * np.cos(slope))
    model = ball_on_plate(gravity=gravity, stiffness=1e6, envs=3, device=device)
    mu = np.array([0.05, 0.13, 0.14])
    model["touch.friction.mu_static"] = mu
    model["touch.friction.mu_dynamic"] = mu
    sim = wc.Simulation(model, dt=2e-4)
    sim.step(1000)
    speed, spin = model.sensor("ball.linear_velocity")[:, 0], model.sensor("ball.angular_velocity")[:, 1]
    sim.step(2500)
    acceleration = (model.sensor("ball.linear_velocity")[:, 0] - speed) / 0.5
    spinning = (model.sensor("ball.angular_velocity")[:, 1] - spin) / 0.5 * R
    assert spinning[1] < 0.98 * acceleration[1]
    # δ/R = 2e-4 of the lever arm of friction.
    np.testing.assert_allclose(acceleration[[0, 2]], [3.701341178, 2.961346534], rtol=3e-4)
    np.testing.assert_allclose(spinning[[0, 2]], [1.111359924, 2.961346534], rtol=4e-4)


def test_ball_in_groove_rolls_as_closed_form(device):
    # FORCE_LAWS G25: 90° groove at 20°: 1.864009781 m/s², N = 0.6644630244 m g on either side, μ > 0.1143848092.
    slope, half = np.radians(20.0), np.radians(45.0)
    scene = wc.Scene(gravity=(G * np.sin(slope), 0, -G * np.cos(slope)))
    friction = F.CundallStrack(mu_static=0.2, mu_dynamic=0.2, stiffness=1e6, damping=100.0)
    material = wc.ContactMaterial(law=wc.laws.KelvinVoigt(stiffness=1e6, damping=200.0), friction=friction)
    # Starts at the equilibrium penetration. Otherwise the tangential springs would stretch sideways and carry
    # load.
    depth = 0.6644630244 * G / 1e6
    ball = scene.add_body(1.0, [0.4 * R * R] * 3, position=(0, 0, (R - depth) * np.sqrt(2)), name="ball")
    centre = scene.add_point(ball, (0, 0, 0))
    for name, turn in (("left", half), ("right", -half)):
        side = scene.add_surface(square(50.0), orientation=(np.sin(turn / 2), 0, 0, np.cos(turn / 2)))
        scene.add_contact(centre, side, material, radius=R, kappa=0.0, name=name)
    model = scene.build(device=device, precision="float64")
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(4000)
    speed = model.sensor("ball.linear_velocity")[0, 0]
    sim.step(4000)
    acceleration = (model.sensor("ball.linear_velocity")[0, 0] - speed) / 0.4
    np.testing.assert_allclose(acceleration, 1.864009781, rtol=3e-4)
    for name in ("left", "right"):
        np.testing.assert_allclose(model.sensor(f"{name}.normal_force")[0], 0.6644630244 * G, rtol=1e-5)


def test_viscous_rolling_resistance_decays_speed_exponentially(device):
    """Type B: dv/dt = −(5/7) β g v."""
    model = ball_on_plate(rolling=F.Viscous(drag=0.05), stiffness=1e6, device=device)
    model["ball.linear_velocity"] = (1.0, 0, 0)
    model["ball.angular_velocity"] = (0, 1.0 / R, 0)
    wc.Simulation(model, dt=1e-3).step(2000)
    expected = np.exp(-5 / 7 * 0.05 * G * 2.0)
    np.testing.assert_allclose(model.sensor("ball.linear_velocity")[0, 0], expected, rtol=4e-4)


def test_torsional_friction_stops_spinning_ball_as_closed_form(device):
    # FORCE_LAWS G24: ω = 50 rad/s, μ = 0.3, a = 1 mm: 25.48419980 s (uniform pressure), 28.84221417 s (Hertz).
    arms = 1e-3 * np.array([2 / 3, 3 * np.pi / 16])
    model = ball_on_plate(torsion=F.Tanh(mu=0.3, velocity_scale=1e-5), torsion_radius=1e-3, envs=2, device=device)
    model["touch.torsion_radius"] = arms
    model["ball.angular_velocity"] = (0, 0, 50.0)
    recording = wc.Simulation(model, dt=1e-3).run(29.0, ["ball.angular_velocity"], every=0.01)
    spin = recording["ball.angular_velocity"].sel(axis="z")
    stops = [float(spin.time[np.argmax(spin.values[:, i] < 0.02)]) for i in range(2)]
    # One frame, and the last 0.01 rad/s of the regularized model.
    np.testing.assert_allclose(stops, [25.48419980, 28.84221417], atol=0.03)
    np.testing.assert_allclose(spin[1000], 50.0 - 10.0 * 0.3 * G * arms / 1e-3, rtol=1e-4)


def test_torsion_radius_follows_the_overlap(device):
    """(3π/16) √(R δ) μ N, with a different load in each environment."""
    mass = np.array([0.5, 1.0, 4.0])
    law = wc.laws.Hertz(stiffness=1e7)
    scene = wc.Scene(gravity=(0, 0, -G))
    plate = scene.add_surface(square())
    ball = scene.add_body(1.0, (1e3, 1e3, 1e3), position=(0, 0, 0.05), angular_velocity=(0, 0, 5), name="ball")
    material = wc.ContactMaterial(law=law, torsion=F.CoulombThreshold(mu=0.3, threshold=1e-6))
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), plate, material, radius=R, name="touch")
    model = scene.build(envs=3, device=device, precision="float64")
    depth = (mass * G / 1e7) ** (2 / 3)
    model["ball.position"] = np.column_stack([0 * depth, 0 * depth, R - depth])
    expected = -3 * np.pi / 16 * np.sqrt(R * depth) * 0.3 * mass * G
    np.testing.assert_allclose(model.sensor("touch.torque")[:, 2], expected, rtol=1e-9)
    np.testing.assert_allclose(model.sensor("ball.torque")[:, 2], expected, rtol=1e-9)


@pytest.mark.parametrize("stop", [F.Tanh(mu=0.3, velocity_scale=1e-3), F.LuGre(
    mu_static=0.4, mu_dynamic=0.3, stribeck_speed=0.01, stiffness=1e4, damping=3.0)], ids=["Tanh", "LuGre"],
)  # fmt: skip
def test_rolling_and_torsional_torques_are_reciprocal_and_dissipative(stop, device):
    """A ball against a free plate: linear and angular momentum are conserved, and energy decreases."""
    scene = wc.Scene(gravity=(0, 0, 0))
    carrier = scene.add_body(3.0, (0.2, 0.3, 0.4), position=(0, 0, -0.1), name="carrier")
    plate = scene.add_surface(square(), carrier, position=(0, 0, 0.1))
    ball = scene.add_body(
        1.0, [0.4 * R * R] * 3, position=(0.1, 0.2, R + 1e-4), linear_velocity=(0.3, -0.2, -1),
        angular_velocity=(5, -8, 20), name="ball",
    )  # fmt: skip
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e5), friction=stop, rolling=stop, torsion=stop)
    scene.add_contact(
        scene.add_point(ball, (0, 0, 0)), plate, material, radius=R, torsion_radius=0.02, name="touch"
    )
    model = scene.build(device=device, precision="float64")
    names = ["scene.linear_momentum", "scene.angular_momentum", "scene.kinetic_energy", "touch.torque"]
    recording = wc.Simulation(model, dt=1e-5).run(0.02, names, every=1e-5)
    linear, angular, energy = (recording[name].values[:, 0] for name in names[:3])
    couple = np.abs(recording["touch.torque"].values[:, 0])
    assert (couple.max(axis=0) > 0.1).all()
    assert couple[-1].max() == 0.0  # contact has ended
    np.testing.assert_allclose(linear, linear[:1].repeat(len(linear), 0), atol=1e-12)
    # r × m v about the origin of the world; r is the position before the forces of the step.
    np.testing.assert_allclose(angular[-1], angular[0], atol=1e-4 * np.linalg.norm(angular[0]))
    assert energy[-1] < energy[0] - 1e-2


def test_rolling_resistance_opposes_motion_in_any_direction(device):
    """The torque is −μ_r R N ω_t/|ω_t| for any tangential direction; spin about the normal does not change it."""
    rng = np.random.default_rng(4)
    spins = rng.normal(size=(20, 3)) * 10
    model = ball_on_plate(rolling=F.CoulombThreshold(mu=0.02, threshold=1e-6), envs=20, device=device)
    model["ball.angular_velocity"] = spins
    tangential = spins * (1, 1, 0)
    expected = -0.02 * R * G * tangential / np.linalg.norm(tangential, axis=1)[:, None]
    np.testing.assert_allclose(model.sensor("touch.torque"), expected, atol=1e-12)


@pytest.mark.parametrize("part", ["rolling", "torsion"])
def test_rolling_or_torsion_without_radius_is_refused(part):
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0), **{part: F.Tanh(mu=0.1)})
    scene = wc.Scene()
    ground = scene.add_surface(square())
    point = scene.add_point(scene.add_body(1.0, (1, 1, 1)), (0, 0, 0))
    with pytest.raises(ValueError, match=f"the {part} of its material, Tanh, needs a radius"):
        scene.add_contact(point, ground, material)


def test_torsion_radius_without_torsion_is_refused():
    with pytest.raises(ValueError, match=r"touch\.torsion_radius is given, but its material has no torsion"):
        dropped_sphere(wc.laws.Hooke(stiffness=1.0), torsion_radius=0.1)


def test_anisotropic_torsion_is_refused():
    with pytest.raises(
        ValueError, match=r"ContactMaterial\.torsion must be an isotropic friction model, got Elliptic"
    ):
        wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0), torsion=F.Elliptic(mu_1=0.1, mu_2=0.2))


def test_parameters_of_friction_rolling_and_torsion_exist(device):
    model = ball_on_plate(
        friction=F.Tanh(mu=0.1), rolling=F.Tanh(mu=0.2), torsion=F.Tanh(mu=0.3), envs=2, device=device
    )
    assert [float(model[f"touch.{part}.mu"][0]) for part in ("friction", "rolling", "torsion")] == [0.1, 0.2, 0.3]
    assert "touch.torsion_radius" not in model
    model["touch.rolling.mu"] = [0.0, 0.4]
    model["ball.angular_velocity"] = (0, 50.0, 0)
    np.testing.assert_allclose(model.sensor("touch.torque")[:, 1], [0, -0.4 * R * G], rtol=1e-9)


def test_friction_model_for_spheres_requires_a_radius(device):
    friction = F.Mindlin(mu_static=0.4, mu_dynamic=0.3, shear_modulus=1e6)
    scene = wc.Scene()
    ground = scene.add_surface(square())
    point = scene.add_point(scene.add_body(1.0, (1, 1, 1)), (0, 0, 0))
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0), friction=friction)
    with pytest.raises(ValueError, match=r"touch: the friction of its material, Mindlin, needs a radius"):
        scene.add_contact(point, ground, material, name="touch")
    model = dropped_sphere(wc.laws.Hooke(stiffness=1.0), friction=friction, device=device)
    with pytest.raises(ValueError, match=r"touch\.radius must be greater than 0, got 0 m"):
        model["touch.radius"] = 0.0
