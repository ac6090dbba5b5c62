"""Known failures of impulse schemes: large mass ratios, lost restitution, growing overlap, wrong contact modes."""

import numpy as np
import pytest
from nonsmooth_scenes import HARD, G, add_box, ball, rigid
from scenes import square

import warpcontact as wc


def test_light_ball_next_to_heavy_one_moves_as_alone(device):
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(50.0), name="ground")
    for name, mass, radius, x in (("light", 1e-3, 0.05, 0.0), ("heavy", 1e5, 1.0, 4.0)):
        inertia = (0.4 * mass * radius**2,) * 3
        body = scene.add_body(mass, inertia, position=(x, 0.0, radius - 1e-6), name=name)
        scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, rigid(0.0, 0.3), radius=radius)
    model = scene.build(device=device)
    model["light.linear_velocity"] = (0.2, 0.0, 0.0)
    wc.Simulation(model, 1e-3, HARD).step(1000)
    # Rolling at 5/7 of its speed, to the accumulated residuals of a thousand solves.
    np.testing.assert_allclose(model.sensor("light.linear_velocity")[0], [1.0 / 7.0, 0, 0], atol=2e-4)
    assert model.sensor("light.position")[0, 2] == pytest.approx(0.05, abs=2e-5)


@pytest.mark.parametrize("solver", ["gauss_seidel", "accelerated"])
def test_restitution_that_adds_no_energy_is_not_limited(device, solver):
    # A box falls on four points simultaneously, without friction: the distribution of impulses is not unique, the work
    # is.
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    ground = scene.add_surface(square(50.0), name="ground")
    feet = [(x, y, -0.1) for x in (-0.2, 0.2) for y in (-0.3, 0.3)]
    add_box(scene, (0.4, 0.6, 0.2), ground, rigid(1.0), feet=feet, position=(0, 0, 0.105))
    model = scene.build(envs=64, device=device, precision="float64")
    rng = np.random.default_rng(3)
    model["box.linear_velocity"] = np.stack([*rng.normal(size=(2, 64)), -rng.uniform(0.5, 2.0, 64)], axis=1)
    model["box.angular_velocity"] = rng.uniform(-1.0, 1.0, (64, 3))
    before = model.sensor("scene.kinetic_energy")
    wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(solver=solver)).step(10)
    # The energy of rotating bodies is constant to second order: 1e-3 s at 1 rad/s.
    np.testing.assert_allclose(model.sensor("scene.kinetic_energy"), before, rtol=1e-5)
    assert model.sensor("scene.restitution_limited").sum() == 0


def test_restitution_is_not_limited_without_bounces(device):
    model = ball(0.0, height=1e-4, device=device)
    simulation = wc.Simulation(model, 1e-3, HARD)
    simulation.step(50)
    assert model.sensor("scene.restitution_limited")[0] == 0
    model["touch.law.restitution"] = 0.5
    simulation.step(20)
    model["touch.law.restitution"] = 0.0
    before = model.sensor("scene.restitution_limited")[0]
    simulation.step(20)
    assert model.sensor("scene.restitution_limited")[0] == before


def test_overlap_recovers_within_recovery_time(device):
    model = ball(0.0, height=-0.01, device=device)
    simulation = wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(recovery_time=0.05))
    simulation.step(50)
    # The overlap decays by 1/e; the gap is that at half a step.
    assert model.sensor("touch.gap")[0] == pytest.approx(-0.01 / np.e, rel=0.05)
    simulation.step(1000)
    assert 0.0 > model.sensor("touch.gap")[0] > -1e-5
    assert model.sensor("touch.normal_force")[0] == pytest.approx(G, rel=1e-3)


def test_rocking_capsule_does_not_sink(device):
    """The only contact point jumps from one end to the other, and the ends are released for a step alternately."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    body = scene.add_body(1.0, (0.008, 0.008, 0.0012), position=(0, 0, 0.0499), name="log")
    lying = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    body_shape = scene.add_shape(body, wc.shapes.Capsule(0.05, 0.1), orientation=lying)
    plate = scene.add_shape(None, wc.shapes.Plane(), name="plate")
    scene.add_shape_contact(body_shape, plate, rigid(0.0, 0.4), name="touch")
    model = scene.build(device=device, precision="float64")
    model["log.angular_velocity"] = (0.0, 0.1, 0.0)
    run = wc.Simulation(model, 1e-3, wc.integrators.MoreauJean()).run(2.0, ["touch.penetration"], every=0.1)
    # The overlap of 0.1 mm at the start remains. Up to g h² more is kept, and an end that was released falls for a step.
    assert run["touch.penetration"].values.max() < 1e-4 + 2.0 * G * 1e-3**2


def test_slipping_contact_has_slip_mode_and_dynamic_friction(device):
    material = wc.ContactMaterial(
        law=wc.laws.Rigid(),
        friction=wc.friction.Stribeck(mu_static=0.3, mu_dynamic=0.05, stribeck_speed=0.1),
    )
    scene = wc.Scene(gravity=(G * np.sin(0.35), 0.0, -G * np.cos(0.35)))
    ground = scene.add_surface(square(50.0), name="ground")
    body = scene.add_body(1.0, (1.0,) * 3, motion=wc.motions.Translation(), position=(0, 0, 0.1), name="block")
    scene.add_contact(scene.add_point(body, (0, 0, -0.1)), ground, material, name="touch")
    model = scene.build(envs=3, device=device, precision="float64")
    model["block.linear_velocity"] = [(0.5, 0, 0), (0.6, 0.1, 0), (0.7, -0.2, 0)]
    data = wc.Simulation(model, 2e-3, HARD).run(1.0, ["touch.mode", "block.linear_velocity"])
    assert (data["touch.mode"].values[2:] == wc.ContactMode.SLIP).all()
    speed = 0.5 + G * (np.sin(0.35) - 0.05 * np.cos(0.35)) * 1.0
    # The first step is a new contact, with the static coefficient.
    first = G * 0.25 * np.cos(0.35) * 2e-3
    assert data["block.linear_velocity"].values[-1, 0, 0] == pytest.approx(speed - first, abs=first)


def test_rotating_body_conserves_angular_momentum_in_float32(device):
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    body = scene.add_body(1.0, (1.0, 2.0, 2.5), angular_velocity=(0.1, 0.2, 1.0))
    ground = scene.add_surface(square(), position=(0, 0, -9.0))
    scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, rigid())
    model = scene.build(device=device)
    before = model.sensor("scene.angular_momentum")
    wc.Simulation(model, 1e-3, HARD).step(10_000)
    # Rounding of single steps, 1e-7, accumulates at random.
    np.testing.assert_allclose(model.sensor("scene.angular_momentum"), before, atol=3e-4)


def test_stacked_boxes_come_to_rest_with_overlap_recovery(device):
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    below = scene.add_surface(square(20.0), name="ground")
    feet = [(x, y, -0.25) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    for number in range(3):
        place = (0.0, 0.0, 0.25 + 0.5 * number)
        body = add_box(scene, (0.5,) * 3, below, rigid(0.5, 0.5), name=f"box{number}", feet=feet, position=place)
        below = scene.add_surface(wc.meshes.box((0.5,) * 3), body, name=f"top{number}")
    model = scene.build(device=device, precision="float64")
    simulation = wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(recovery_time=0.02))
    simulation.step(500)
    failures, restitution_limited = (
        model.sensor(f"scene.{name}")[0] for name in ("solve_failures", "restitution_limited")
    )
    simulation.step(1000)
    assert model.sensor("scene.kinetic_energy")[0] < 1e-9
    assert model.sensor("scene.closed_contacts")[0] == 12
    assert model.sensor("scene.solve_failures")[0] == failures
    assert model.sensor("scene.restitution_limited")[0] == restitution_limited
    # The remaining penetration is at most the fall of a body in one step, for each contact.
    assert -4.0 * G * 1e-6 < model.sensor("box0_feet.gap").min() <= 0.0


def test_recovery_time_below_time_step_is_refused(device):
    with pytest.raises(ValueError, match=r"recovery_time must be at least dt = 0\.001 s, got 0\.0005 s"):
        wc.Simulation(ball(device=device), 1e-3, wc.integrators.MoreauJean(recovery_time=5e-4))


@pytest.mark.parametrize("solver", ["auto", "accelerated"])
def test_contacts_of_one_fixed_body_are_not_coupled(device, solver):
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    table = scene.add_body(1.0, (1.0,) * 3, motion=wc.motions.Fixed(), name="table")
    top = scene.add_surface(square(5000.0), table, name="top")
    for name, place, mu in (("slow", 0.0, 0.3), ("fast", 50.0, 0.0)):
        body = scene.add_body(1e-3, (1e-6,) * 3, position=(0, place, 0.05 - 1e-6), name=name)
        scene.add_contact(scene.add_point(body, (0, 0, 0)), top, rigid(mu=mu), radius=0.05, name=f"{name}_touch")
    model = scene.build(device=device)
    model["fast.linear_velocity"] = (1000.0, 0.0, 0.0)
    wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(solver=solver)).step(200)
    # Accurate to its own residual. With the residuals of the other environment, the error would be a thousand
    # times larger.
    assert model.sensor("slow_touch.normal_force")[0] == pytest.approx(1e-3 * G, rel=2e-4)
    assert model.sensor("slow_touch.gap")[0] > -2e-5
