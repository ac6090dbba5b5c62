"""Time-stepping nonsmooth contact against closed forms: impacts, sliding, sticking, rolling, tipping."""

import json
import warnings

import numpy as np
import pytest
from nonsmooth_scenes import ENERGY, HARD, LOSSES, G, add_box, ball, block, energy, rigid
from scenes import square

import warpcontact as wc


@pytest.fixture(scope="module")
def oracle(shared):
    return json.loads((shared / "spec" / "oracle_signorini.json").read_text())


def impact_times(model, dt, until):
    data = wc.Simulation(model, dt, HARD).run(until, ["touch.impulse", "ball.linear_velocity", "touch.gap"])
    hit = np.flatnonzero(data["touch.impulse"].values[:, 0, 2] > 0)[:5]
    return data["time"].values[hit], data


@pytest.mark.parametrize("dt", ["0.01", "0.001", pytest.param("0.0001", marks=pytest.mark.slow)])
def test_nonsmooth_bouncing_ball_matches_reference(oracle, device, dt):
    model = ball(0.8, radius=0.0, device=device)
    duration = 5.0 if dt != "0.0001" else 2.7
    times, data = impact_times(model, float(dt), duration)
    expected = oracle["moreau_jean"][dt]
    # Both take the same steps; their clocks are sums of steps.
    assert times == pytest.approx(expected["times"], abs=1e-9)
    assert np.abs(times - oracle["ball"]["impact_times"]) == pytest.approx(expected["err"], abs=1e-9)
    if duration == 5.0:
        assert -data["touch.gap"].values.min() == pytest.approx(expected["max_penetration"], abs=1e-12)
        assert abs(data["ball.linear_velocity"].values[-1, 0, 2]) < 1e-11
        assert abs(data["touch.gap"].values[-1, 0]) < 1e-4


def test_nonsmooth_impact_times_converge_at_first_order(oracle, device):
    model = ball(0.8, radius=0.0, device=device)
    errors = []
    for dt in (4e-3, 4e-4):
        simulation = wc.Simulation(model, dt, HARD)
        simulation.reset()
        times, _ = impact_times(model, dt, 2.7)
        errors.append(np.abs(times - oracle["ball"]["impact_times"]).max())
    assert 5.0 < errors[0] / errors[1] < 20.0


def test_nonsmooth_restitution_and_friction_can_vary_by_environment(device):
    model = ball(0.5, 0.1, height=0.01, velocity=(2.0, 0.0, -3.0), envs=3, gravity=0.0, device=device)
    model["touch.law.restitution"] = [0.0, 0.4, 1.0]
    model["touch.friction.mu"] = [0.0, 0.1, 2.0]
    simulation = wc.Simulation(model, 1e-3, HARD)
    simulation.run(0.01)
    after = model.sensor("ball.linear_velocity")
    assert after[:, 2] == pytest.approx([0.0, 1.2, 3.0], abs=1e-12)
    # Sliding removes μ (1 + e) v; if the ball sticks it rolls with 5/7 of the speed.
    assert after[:, 0] == pytest.approx([2.0, 2.0 - 0.1 * 4.2, 2.0 * 5.0 / 7.0], abs=1e-9)
    model["touch.law.restitution"] = 0.25
    simulation.reset()
    simulation.run(0.01)
    assert model.sensor("ball.linear_velocity")[:, 2] == pytest.approx(0.75, abs=1e-12)


def test_nonsmooth_contact_uses_restitution_and_friction_of_compliant_material(device):
    material = wc.ContactMaterial(
        law=wc.laws.HuntCrossley(stiffness=1e5, exponent=1.5, restitution=0.7),
        friction=wc.friction.Tanh(mu=0.1, velocity_scale=1e-2),
    )
    model = ball(material=material, height=0.01, velocity=(2.0, 0.0, -3.0), gravity=0.0, device=device)
    wc.Simulation(model, 1e-3, HARD).run(0.01)
    assert model.sensor("ball.linear_velocity")[0] == pytest.approx([2.0 - 0.1 * 5.1, 0.0, 2.1], abs=1e-12)


def test_nonsmooth_sliding_block_stops_as_coulomb(oracle, device):
    slide = oracle["slide"]
    model = block(slide["mu"], velocity=(slide["v0"], 0.0, 0.0), device=device)
    data = wc.Simulation(model, 1e-3, HARD).run(
        1.0, ["block.position", "block.linear_velocity", "block_feet.mode"]
    )
    speed = data["block.linear_velocity"].values[:, 0, 0]
    stopped = np.argmax(np.abs(speed) < 1e-9)
    # The first step has no contact: the points start on the plane, and contact begins below it.
    assert data["time"].values[stopped] == pytest.approx(slide["t_stop"], abs=2e-3)
    assert data["block.position"].values[-1, 0, 0] == pytest.approx(slide["x_stop"], abs=3e-3)
    assert (
        np.abs(data["block.position"].values[stopped:, 0, 0] - data["block.position"].values[-1, 0, 0]).max()
        < 1e-9
    )
    modes = data["block_feet.mode"].values[:, 0]
    assert (modes[10 : stopped - 1] == wc.ContactMode.SLIP).all()
    # The static distribution among four points is not unique; one sticking point is sufficient.
    assert (modes[stopped + 1 :] == wc.ContactMode.STICK).any(axis=1).all()


def test_nonsmooth_block_on_incline_sticks_below_friction_angle(oracle, device):
    limit = oracle["slide"]["stick_if_mu_ge"]
    model = block(0.3, slope=np.deg2rad(20.0), envs=3, device=device)
    model["block_feet.friction.mu"] = [0.3, limit - 1e-4, limit + 1e-4]
    simulation = wc.Simulation(model, 1e-3, HARD)
    simulation.step(200)
    before = model.sensor("block.linear_velocity")[:, 0]
    simulation.step(1000)
    gain = model.sensor("block.linear_velocity")[:, 0] - before
    assert gain[0] == pytest.approx(oracle["slide"]["a_incline"], rel=1e-6)
    assert gain[1] == pytest.approx(1e-4 * G * np.cos(np.deg2rad(20.0)), rel=1e-4)
    assert abs(gain[2]) < 1e-9


@pytest.mark.parametrize(
    ("push", "height", "mu", "acceleration", "tips"),
    [(20.0, 1.0, 0.5, 0.0, False), (60.0, 0.5, 0.5, 1.095, False), (40.0, 1.8, 0.9, None, True)],
    ids=["sticks", "slides", "tips"],
)
def test_nonsmooth_pushed_block_sticks_slides_or_tips(device, push, height, mu, acceleration, tips):
    model = block(mu, external_force=(push, 0.0, 0.0), device=device)
    model["block.external_torque"] = (0.0, push * (height - 1.0), 0.0)
    simulation = wc.Simulation(model, 1e-4, HARD)
    simulation.step(20)
    before = model.sensor("block.linear_velocity")[0], model.sensor("block.angular_velocity")[0]
    simulation.step(100)
    gain = (model.sensor("block.linear_velocity")[0] - before[0]) / 1e-2
    turning = (model.sensor("block.angular_velocity")[0] - before[1]) / 1e-2
    force = model.sensor("block_feet.normal_force")[0]
    friction = model.sensor("block_feet.friction_force")[0].sum(axis=0)
    if tips:
        # a = (1.377, 0.6885), α = −1.377 about the axis into the picture, N = (0, 104.985), T = −26.23
        assert gain == pytest.approx([1.377, 0.0, 0.6885], rel=2e-3, abs=1e-9)
        assert turning[1] == pytest.approx(1.377, rel=2e-3)
        assert force.sum() == pytest.approx(104.985, rel=1e-3)
        assert force[:2] == pytest.approx(0.0, abs=1e-12)
        assert friction[0] == pytest.approx(-26.23, rel=1e-3)
    else:
        assert gain == pytest.approx([acceleration, 0.0, 0.0], abs=1e-8)
        assert turning == pytest.approx(0.0, abs=1e-8)
        left = force[:2].sum()
        assert left == pytest.approx({20.0: 29.05, 60.0: 30.0}[push], rel=1e-6)
        assert force.sum() == pytest.approx(98.1, rel=1e-6)
        assert friction[0] == pytest.approx({20.0: -20.0, 60.0: -49.05}[push], rel=1e-6)


def test_nonsmooth_sliding_ball_ends_up_rolling(device):
    mu, v0, dt = 0.2, 3.0, 1e-3
    model = ball(mu=mu, height=0.0, velocity=(v0, 0.0, 0.0), device=device)
    data = wc.Simulation(model, dt, HARD).run(3.0, ["ball.linear_velocity", "ball.angular_velocity", "touch.mode"])
    v, w = data["ball.linear_velocity"].values[:, 0, 0], data["ball.angular_velocity"].values[:, 0, 1]
    rolls = 2.0 * v0 / (7.0 * mu * G)
    assert v[-1] == pytest.approx(5.0 / 7.0 * v0, rel=1e-9)
    assert v[-1] == pytest.approx(0.1 * w[-1], rel=1e-9)
    mode = data["touch.mode"].values[:, 0]
    first = np.argmax(mode == wc.ContactMode.STICK)
    assert data["time"].values[first] == pytest.approx(rolls, abs=2.0 * dt)


def test_nonsmooth_rolling_and_torsional_friction_decelerate_ball_uniformly(device):
    resistance = wc.friction.Coulomb(mu=0.02)
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(50.0), name="ground")
    material = rigid(mu=0.5, rolling=resistance, torsion=wc.friction.Coulomb(mu=0.3))
    for name, spin, velocity in (
        ("rolling", (0.0, 10.0, 0.0), (1.0, 0.0, 0.0)),
        ("spinning", (0.0, 0.0, 10.0), (0.0,) * 3),
    ):
        body = scene.add_body(
            1.0,
            (0.004,) * 3,
            position=(0.0, len(name), 0.1),
            angular_velocity=spin,
            linear_velocity=velocity,
            name=name,
        )
        scene.add_contact(
            scene.add_point(body, (0.0, 0.0, 0.0)),
            ground,
            material,
            radius=0.1,
            torsion_radius=0.01,
            kappa=1.0,
            name=f"{name}_touch",
        )
    model = scene.build(device=device, precision="float64")
    simulation = wc.Simulation(model, 1e-3, HARD)
    simulation.step(5)
    v0, w0 = model.sensor("rolling.linear_velocity")[0, 0], model.sensor("spinning.angular_velocity")[0, 2]
    simulation.step(100)
    v1, w1 = model.sensor("rolling.linear_velocity")[0, 0], model.sensor("spinning.angular_velocity")[0, 2]
    # M = μ_r R m g on a rolling ball: a = M R/(I + m R²); spinning: α = μ_t r_t m g/I.
    assert (v0 - v1) / 0.1 == pytest.approx(0.02 * G / 1.4, rel=1e-6)
    assert (w0 - w1) / 0.1 == pytest.approx(0.3 * 0.01 * G / 0.004, rel=1e-6)
    simulation.step(8000)
    # To the tolerance of the solver, relative to the speed g h of a step. The center has the velocity of K plus R
    # ω.
    for name in ("rolling", "spinning"):
        assert np.abs(model.sensor(f"{name}.angular_velocity")).max() < 1e-8 * G * 1e-3 / 0.1
        assert np.abs(model.sensor(f"{name}.linear_velocity")).max() < 2e-8 * G * 1e-3


def test_nonsmooth_energy_and_dissipation_of_sphere_balance(device):
    """θ = ½: the work of forces minus the dissipation of contacts equals the change of energy, to rounding."""
    model = ball(0.6, 0.3, velocity=(2.0, 1.0, 0.0), spin=(5.0, -3.0, 8.0), device=device)
    data = wc.Simulation(model, 2e-3, HARD).run(4.0, [*ENERGY, *LOSSES])
    total = energy(data) + sum(data[name].values for name in LOSSES)
    assert np.ptp(total) < 1e-12 * total.max()
    assert (np.diff(data["scene.friction_dissipation"].values[:, 0]) >= -1e-15).all()
    # A closed contact that separates with less than g h is held, which may lift the body by as much.
    assert (np.diff(data["scene.impact_dissipation"].values[:, 0]) >= -((G * 2e-3) ** 2) / 8.0).all()
    assert data["scene.friction_dissipation"].values[-1, 0] > 0.5


def test_nonsmooth_tumbling_boxes_never_gain_energy(device):
    rng = np.random.default_rng(3)
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    below = scene.add_surface(square(20.0), name="ground")
    material = rigid(0.5, 0.4)
    edges = np.array([0.3, 0.4, 0.2])
    body = add_box(scene, edges, below, material, name="one", position=(0.0, 0.0, 0.5))
    top = scene.add_surface(wc.meshes.box(tuple(edges)), body, name="top")
    other = add_box(scene, edges, below, material, name="two", position=(0.0, 0.0, 1.0))
    corners = 0.5 * edges * np.array(np.meshgrid(*[(-1, 1)] * 3)).T.reshape(-1, 3)
    scene.add_contact(scene.add_points(other, corners), top, material, name="between")
    envs = 16
    model = scene.build(envs=envs, device=device, precision="float64")
    model["one.angular_velocity"] = rng.normal(size=(envs, 3))
    model["two.angular_velocity"] = rng.normal(size=(envs, 3))
    model["two.linear_velocity"] = rng.normal(size=(envs, 3))
    model["one_feet.law.restitution"] = model["two_feet.law.restitution"] = rng.uniform(0, 1, size=(envs, 1))
    dt = 1e-3
    simulation = wc.Simulation(model, dt, wc.integrators.MoreauJean(iterations=2000))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        data = simulation.run(2.0, [*ENERGY, "one_feet.gap", "two_feet.gap"])
    # With friction, the solver may fail to find a solution; this is rare, and counted.
    assert model.sensor("scene.solve_failures").sum() < 2e-3 * envs * simulation.steps
    kinetic = data["scene.kinetic_energy"].values
    # A closed contact that separates with less than g h is held, which may lift the body by as much. The energy of
    # rotating bodies is constant to second order in the step.
    held = 2.0 * 24.0 * (G * dt) ** 2 / 8.0
    assert (np.diff(energy(data), axis=0) <= held + 2.0 * dt**2 * kinetic.max(axis=0)).all()
    # Without the limit, some impacts would have added energy.
    assert model.sensor("scene.restitution_limited").sum() > 0
    fastest = 8.0  # m/s, of any vertex
    for name in ("one_feet.gap", "two_feet.gap"):
        assert data[name].values.min() > -fastest * dt
    assert (energy(data)[-1] < energy(data)[0]).all()


def test_compliant_contact_converges_to_nonsmooth_contact_with_stiffness(device):
    hard = ball(height=0.05, mu=0.3, velocity=(1.0, 0.0, 0.0), device=device)
    expected = (
        wc.Simulation(hard, 1e-4, HARD).run(0.5, ["ball.position"], every=1e-2)["ball.position"].values[:, 0]
    )
    far = []
    for stiffness in (1e4, 1e6):
        material = wc.ContactMaterial(
            law=wc.laws.KelvinVoigt(stiffness=stiffness, damping=2.0 * np.sqrt(stiffness)),
            friction=wc.friction.RegularizedCoulomb(mu=0.3, velocity_scale=10.0 / stiffness**0.5),
        )
        model = ball(material=material, height=0.05, velocity=(1.0, 0.0, 0.0), device=device)
        soft = wc.Simulation(model, 1e-5).run(0.5, ["ball.position"], every=1e-2)["ball.position"].values[:, 0]
        far.append(np.abs(soft - expected).max())
    assert far[1] < 0.2 * far[0]
    assert far[1] < 1e-3


def tower(boxes, *, inset=0.9, **options):
    """Cubes of 0.5 m, stacked, each with four contact points slightly inside its vertices."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    below = scene.add_surface(square(10.0), name="ground")
    half = 0.25
    feet = [(x * inset * half, y * inset * half, -half) for x in (-1, 1) for y in (-1, 1)]
    for number in range(boxes):
        place = (3e-3 * (number % 2), 2e-3 * (number % 3), half + 2.0 * half * number)
        body = add_box(scene, (0.5,) * 3, below, rigid(mu=0.5), name=f"box{number}", feet=feet, position=place)
        below = scene.add_surface(wc.meshes.box((0.5,) * 3), body, name=f"faces{number}")
    return scene.build(precision="float64", **options)


def test_nonsmooth_stack_of_ten_boxes_is_stable_for_100_seconds(device):
    model = tower(10, device=device)
    names = [f"box{number}.position" for number in range(10)]
    simulation = wc.Simulation(model, 5e-3, HARD)
    start = np.array([model.sensor(name)[0] for name in names])
    simulation.step(2000)
    early = np.array([model.sensor(name)[0] for name in names])
    simulation.step(18000)
    late = np.array([model.sensor(name)[0] for name in names])
    # In the first steps each point sinks by about g h²; afterwards nothing creeps. Solves leave 1e-8 of the
    # impulse of ten boxes for 90 s. A tilt at a contact point moves a top that is ten times as high.
    assert np.abs(early - start).max() < 10 * 10 * G * 5e-3**2
    assert np.abs(late - early).max() < 1e-8 * (10 * G * 5e-3) * 90.0 * 10
    assert model.sensor("scene.kinetic_energy")[0] < 1e-9
    assert model.sensor("scene.closed_contacts")[0] == 40
    weight = 10 * 125.0 * G
    assert model.sensor("box0_feet.normal_force")[0].sum() == pytest.approx(weight, rel=1e-6)
