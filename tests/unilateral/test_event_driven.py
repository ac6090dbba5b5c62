"""Event-driven integration against closed forms: impact times, Zeno points, stick and slip, lift-off, paradoxes."""

import json
import math

import numpy as np
import pytest
from rigid_scenes import G, ball, block, box_inertia, rigid, turned_about_y
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import warpcontact as wc
from warpcontact.unilateral import EventDriven, EventKind, ParadoxError

# Event times are roots to rounding; positions are integrated to 1e-12 per step.
EXACT = 1.0e-10


def body_of(run, name, quantity="position"):
    return run[f"{name}.{quantity}"].values


def test_event_driven_ball_bounces_at_closed_form_times_until_its_zeno_point():
    run = EventDriven(ball(height=1.0, restitution=0.8)).run(5.0)
    impacts = run.events_of("IMPACT")
    t1, e = math.sqrt(2.0 / G), 0.8
    times = [t1 * (1.0 + 2.0 * sum(e**i for i in range(1, n))) for n in range(1, 6)]
    np.testing.assert_allclose([one.time for one in impacts[:5]], times, rtol=0, atol=1e-12)
    speeds = G * t1 * e ** np.arange(5)
    np.testing.assert_allclose([one.approach_speed for one in impacts[:5]], speeds, rtol=1e-12)
    np.testing.assert_allclose([one.separation_speed for one in impacts[:5]], e * speeds, rtol=1e-12)
    np.testing.assert_allclose([one.impulse[2] for one in impacts[:5]], 2.0 * (1.0 + e) * speeds, rtol=1e-12)
    (rest,) = run.events_of("REST", "touch")
    assert rest.time == pytest.approx(t1 * (1.0 + e) / (1.0 - e), abs=EXACT)
    assert run.times[-1] == 5.0
    after = run.times > rest.time
    np.testing.assert_allclose(body_of(run, "ball")[after], [[0.0, 0.0, 0.1]] * after.sum(), atol=1e-15)
    assert (body_of(run, "ball", "linear_velocity")[after] == 0.0).all()
    # Penetration is at most one rounding of the height.
    assert body_of(run, "ball")[:, 2].min() > 0.1 - 1e-15


def test_event_driven_ball_and_sliding_match_reference(shared):
    oracle = json.loads((shared / "spec" / "oracle_signorini.json").read_text())
    given = oracle["ball"]
    run = EventDriven(ball(height=given["h"], restitution=given["e"])).run(2.7)
    impacts = run.events_of("IMPACT")[:5]
    np.testing.assert_allclose([one.time for one in impacts], given["impact_times"], rtol=1e-12)
    np.testing.assert_allclose([one.approach_speed for one in impacts], given["pre_speed"], rtol=1e-12)
    # The energy of the first state after each impact gives the next apex height.
    for one, apex in zip(impacts, given["apex"][1:], strict=False):
        after = run.states[int(np.flatnonzero(run.times == one.time)[-1])]
        height = after.position[0, 2] - 0.1 + after.linear_velocity[0, 2] ** 2 / (2.0 * G)
        assert height == pytest.approx(apex, rel=1e-12)
    given = oracle["slide"]
    run = EventDriven(block(mu=given["mu"], velocity=given["v0"])).run(0.7)
    assert run.events_of("STICK")[0].time == pytest.approx(given["t_stop"], abs=EXACT)
    assert body_of(run, "box")[-1, 0] == pytest.approx(given["x_stop"], abs=EXACT)
    slope, limit = math.radians(given["incline_deg"]), given["stick_if_mu_ge"]
    run = EventDriven(block(mu=given["mu"], slope=slope)).run(0.5)
    speed = np.linalg.norm(body_of(run, "box", "linear_velocity")[-1])
    assert speed == pytest.approx(0.5 * given["a_incline"], abs=EXACT)
    assert wc.unilateral.equilibrium(block(mu=limit * (1.0 + 1e-9), slope=slope)).holds


def test_event_driven_reports_an_impact_at_the_start():
    for every in (None, 0.01):
        run = EventDriven(ball(height=0.0, restitution=0.8, velocity=(0.0, 0.0, -1.0))).run(0.05, every)
        (hit,) = run.events
        assert (hit.kind, hit.time, hit.approach_speed) == (EventKind.IMPACT, 0.0, 1.0)
        assert hit.separation_speed == pytest.approx(0.8, rel=1e-14)
        np.testing.assert_array_equal(body_of(run, "ball", "linear_velocity")[0], (0.0, 0.0, -1.0))
    # An impact at the start has a state before and a state after it.
    run = EventDriven(ball(height=0.0, restitution=0.8, velocity=(0.0, 0.0, -1.0))).run(0.05)
    assert run.times[:2].tolist() == [0.0, 0.0]
    assert body_of(run, "ball", "linear_velocity")[1, 2] == pytest.approx(0.8, rel=1e-14)
    # A contact that remains closed is not an event.
    assert not EventDriven(ball(height=0.0, mu=0.3)).run(0.1).events


def test_event_driven_run_continues_and_leaves_the_model_unchanged():
    model = ball(height=1.0, restitution=0.8)
    engine = EventDriven(model)
    parts = [engine.run(0.7, every=0.1), engine.run(0.8, every=0.1)]
    whole = EventDriven(model).run(1.5, every=0.1)
    np.testing.assert_allclose(whole.times, 0.1 * np.arange(16), atol=1e-15)
    np.testing.assert_allclose(body_of(parts[1], "ball"), body_of(whole, "ball")[7:], atol=1e-12)
    assert [str(one) for part in parts for one in part.events] == [str(one) for one in whole.events]
    np.testing.assert_array_equal(model.sensor("ball.position"), [[0.0, 0.0, 1.1]])
    assert model.time == 0.0
    assert "2 IMPACT" in str(whole)


def test_event_driven_sliding_block_stops_at_closed_form_time_and_position():
    mu, v = 0.3, 2.0
    run = EventDriven(block(mu=mu, velocity=v)).run(1.0)
    stop = run.events_of(EventKind.STICK, "feet")
    assert {one.item for one in stop} == {0, 1, 2, 3}
    np.testing.assert_allclose([one.time for one in stop], v / (mu * G), atol=EXACT)
    last = body_of(run, "box")[-1]
    np.testing.assert_allclose(last, (v**2 / (2.0 * mu * G), 0.0, 1.0), atol=EXACT)
    assert np.abs(body_of(run, "box", "linear_velocity")[-1]).max() < 1e-14


def test_event_driven_block_on_slope_slides_or_sticks():
    slope = math.radians(20.0)
    run = EventDriven(block(mu=0.3, slope=slope)).run(0.5)
    along = (math.cos(slope), 0.0, -math.sin(slope))
    displacement = body_of(run, "box")[-1] - body_of(run, "box")[0]
    acceleration = G * (math.sin(slope) - 0.3 * math.cos(slope))
    np.testing.assert_allclose(displacement, 0.125 * acceleration * np.array(along), atol=EXACT)
    sticks = EventDriven(block(mu=0.4, slope=slope)).run(0.5)
    assert not sticks.events
    np.testing.assert_allclose(body_of(sticks, "box")[-1], body_of(sticks, "box")[0], atol=1e-14)
    # A block thrown up the slope slides back, or stays.
    up = EventDriven(block(mu=0.3, slope=slope, velocity=-1.0)).run(0.5)
    turn = 1.0 / (G * (math.sin(slope) + 0.3 * math.cos(slope)))
    back = up.events_of("SLIP")
    np.testing.assert_allclose([one.time for one in back], turn, atol=EXACT)
    displacement = (body_of(up, "box")[-1] - body_of(up, "box")[0]) @ along
    assert displacement == pytest.approx(-0.5 * turn + 0.5 * acceleration * (0.5 - turn) ** 2, abs=EXACT)


def test_event_driven_sliding_ball_rolls_at_five_sevenths_of_its_speed():
    run = EventDriven(ball(height=0.0, mu=0.3, velocity=(2.0, 0.0, 0.0))).run(0.5)
    (rolls,) = run.events
    assert rolls.kind is EventKind.STICK
    assert rolls.time == pytest.approx(2.0 * 2.0 / (7.0 * 0.3 * G), abs=EXACT)
    np.testing.assert_allclose(body_of(run, "ball", "linear_velocity")[-1], (10.0 / 7.0, 0.0, 0.0), atol=EXACT)
    np.testing.assert_allclose(
        body_of(run, "ball", "angular_velocity")[-1], (0.0, 100.0 / 7.0, 0.0), atol=100.0 * EXACT
    )


def test_event_driven_backspin_reverses_a_ball():
    # v − ω R = 2 + 5: with v₀ = 2, ω R = −5 the ball ends at (5 · 2 − 2 · 5)/7 = 0; with −6 it returns.
    run = EventDriven(ball(height=0.0, mu=0.2, velocity=(2.0, 0.0, 0.0), spin=(0.0, -60.0, 0.0))).run(1.2)
    np.testing.assert_allclose(
        body_of(run, "ball", "linear_velocity")[-1, 0], (5.0 * 2.0 - 2.0 * 6.0) / 7.0, atol=EXACT
    )
    assert run.events_of("STICK")[0].time == pytest.approx(2.0 * 8.0 / (7.0 * 0.2 * G), abs=EXACT)


def test_event_driven_block_tips_about_its_edge():
    push, height, end = 40.0, 1.8, 0.3
    run = EventDriven(block(push, height, mu=0.9)).run(end)
    inertia = box_inertia(10.0, (1.0, 1.0, 2.0))[1]

    def slopes(_, y):
        # Rotation about the edge: the force acts at the center, with the torque of the point of application.
        x, z = -0.5 * math.cos(y[0]) + math.sin(y[0]), 0.5 * math.sin(y[0]) + math.cos(y[0])
        moment = push * z + push * (height - 1.0) + 10.0 * G * x
        return [y[1], moment / (inertia + 10.0 * 1.25)]

    expected = solve_ivp(slopes, (0.0, end), [0.0, 0.0], rtol=1e-12, atol=1e-14).y[:, -1]
    _, qy, _, qw = body_of(run, "box", "orientation")[-1]
    assert 2.0 * math.atan2(qy, qw) == pytest.approx(expected[0], abs=EXACT)
    assert body_of(run, "box", "angular_velocity")[-1, 1] == pytest.approx(expected[1], abs=EXACT)
    # The points of the edge stick from start to end, the others separate immediately: there are no events.
    assert not run.events


@pytest.mark.slow
def test_event_driven_bead_leaves_sphere_at_zero_normal_force():
    start = 0.3
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    dome = scene.add_shape(None, wc.shapes.Sphere(1.0), name="dome")
    place = 1.1 * np.array([math.sin(start), 0.0, math.cos(start)])
    bead = scene.add_body(mass=1.0, inertia=[0.004] * 3, position=place, name="bead")
    small = scene.add_shape(bead, wc.shapes.Sphere(0.1), name="small")
    scene.add_shape_contact(small, dome, rigid(0.0), name="touch")
    run = EventDriven(scene.build(device="cpu", precision="float64")).run(1.0)
    (leaves,) = run.events
    assert leaves.kind is EventKind.LIFT_OFF
    at = int(np.argmin(np.abs(run.times - leaves.time)))
    # m v²/R = m g cos θ with v² = 2 g R (cos θ₀ − cos θ).
    cosine = 2.0 / 3.0 * math.cos(start)
    height = body_of(run, "bead")[at, 2] / 1.1
    assert height == pytest.approx(cosine, abs=EXACT)
    speed = np.linalg.norm(body_of(run, "bead", "linear_velocity")[at])
    assert speed == pytest.approx(math.sqrt(1.1 * G * cosine), abs=EXACT)


def pendulum(restitution):
    """A bar of 2 kg and 1 m on a revolute joint, which hits a wall when it hangs straight down."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    wall = scene.add_surface(
        wc.meshes.grid((40.0, 40.0), (1, 1)), orientation=turned_about_y(0.5 * math.pi), name="wall"
    )
    start = math.radians(30.0)
    bar = scene.add_body(
        mass=2.0,
        inertia=box_inertia(2.0, (0.02, 0.02, 1.0)),
        position=(0.5 * math.sin(start), 0.0, -0.5 * math.cos(start)),
        orientation=turned_about_y(-start),
        motion=wc.motions.Hinge(axis=(0, 1, 0), anchor=(0, 0, 0)),
        name="bar",
    )
    scene.add_contact(scene.add_point(bar, (0, 0, -0.5)), wall, rigid(0.0, restitution), name="stop")
    return scene.build(device="cpu", precision="float64"), start


@pytest.mark.slow
def test_event_driven_pendulum_rebounds_from_a_stop():
    model, start = pendulum(restitution=0.5)
    run = EventDriven(model).run(1.6, every=0.01)
    inertia = box_inertia(2.0, (0.02, 0.02, 1.0))[1] + 2.0 * 0.25
    first, second = run.events_of("IMPACT")[:2]
    # Energy: ½ I ω² = m g l (1 − cos θ₀); the speed of the end is ω · 1 m.
    speed = math.sqrt(2.0 * 2.0 * G * 0.5 * (1.0 - math.cos(start)) / inertia)
    assert first.approach_speed == pytest.approx(speed, abs=EXACT)
    assert first.separation_speed == pytest.approx(0.5 * speed, abs=EXACT)
    # The joint has a share of the impulse: the impulse at the end is I Δω.
    np.testing.assert_allclose(first.impulse, (inertia * 1.5 * speed, 0.0, 0.0), atol=EXACT)
    assert second.approach_speed == pytest.approx(0.5 * speed, abs=EXACT)

    def slopes(_, y):
        return [y[1], -2.0 * G * 0.5 * math.sin(y[0]) / inertia]

    def down(_, y):
        return y[0]

    down.terminal, down.direction = True, -1
    swing = solve_ivp(slopes, (0.0, 3.0), [start, 0.0], "DOP853", events=down, rtol=1e-13, atol=1e-15)
    assert first.time == pytest.approx(swing.t_events[0][0], abs=EXACT)
    np.testing.assert_allclose(np.linalg.norm(body_of(run, "bar"), axis=1), 0.5, atol=1e-15)


def test_event_driven_block_leaves_shaken_table_at_closed_form_time():
    amplitude, frequency = 0.1, 2.0
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    motion = wc.motions.Harmonic(direction=(0, 0, 1), amplitude=amplitude, frequency=frequency)
    table = scene.add_body(mass=1.0, inertia=(1, 1, 1), motion=motion, name="table")
    top = scene.add_surface(wc.meshes.grid((4.0, 4.0), (1, 1)), table, name="top")
    brick = scene.add_body(
        mass=1.0, inertia=[0.1] * 3, position=(0, 0, 0.1), motion=wc.motions.Translation(), name="brick"
    )
    scene.add_contact(scene.add_point(brick, (0, 0, -0.1)), top, rigid(0.0), name="touch")
    run = EventDriven(scene.build(device="cpu", precision="float64")).run(0.07)
    rate = 2.0 * math.pi * frequency
    # The table accelerates downwards with g at sin ωt = g/(a ω²). Its velocities and accelerations are differences
    # over 1e-6 s and 2e-5 s, with relative rounding of 1e-10 and 1e-6.
    leaves = math.asin(G / (amplitude * rate**2)) / rate
    assert run.events_of("LIFT_OFF")[0].time == pytest.approx(leaves, abs=1e-6)


def test_event_driven_brick_slides_on_horizontally_shaken_table():
    amplitude, rate, mu = 0.1, 2.0 * math.pi, 0.2
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    motion = wc.motions.Harmonic(direction=(1, 0, 0), amplitude=amplitude, frequency=1.0)
    table = scene.add_body(mass=1.0, inertia=(1, 1, 1), motion=motion, name="table")
    top = scene.add_surface(wc.meshes.grid((4.0, 4.0), (1, 1)), table, name="top")
    brick = scene.add_body(
        mass=1.0, inertia=[0.1] * 3, position=(0, 0, 0.1), motion=wc.motions.Translation(), name="brick"
    )
    scene.add_contact(scene.add_point(brick, (0, 0, -0.1)), top, rigid(mu), name="touch")
    run = EventDriven(scene.build(device="cpu", precision="float64")).run(0.3)
    # The table starts with a ω. Friction accelerates the brick with μ g until both speeds are equal, then
    # decelerates it.
    turns = brentq(lambda t: mu * G * t - amplitude * rate * math.cos(rate * t), 0.0, 0.25)
    speed = mu * G * (2.0 * turns - 0.3)
    displacement = 0.5 * mu * G * turns**2 + mu * G * turns * (0.3 - turns) - 0.5 * mu * G * (0.3 - turns) ** 2
    # Accelerations of the table are differences in time, accurate to 1e-6.
    assert body_of(run, "brick", "linear_velocity")[-1, 0] == pytest.approx(speed, abs=1e-6)
    assert body_of(run, "brick")[-1, 0] == pytest.approx(displacement, abs=1e-6)


def test_event_driven_detects_collision_of_fast_balls_within_a_step():
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    shapes = []
    for name, x, y, v in (("left", -1.0, 0.0, 50.0), ("right", 1.0, 0.06, -50.0)):
        body = scene.add_body(
            mass=1.0, inertia=[1.0] * 3, position=(x, y, 0), linear_velocity=(v, 0, 0), name=name
        )
        shapes.append(scene.add_shape(body, wc.shapes.Sphere(0.05), name=f"{name}_ball"))
    scene.add_particle_contact(shapes, rigid(0.0, 1.0), name="balls")
    model = scene.build(device="cpu", precision="float64")
    run = EventDriven(model, step=0.02).run(0.04)
    (hit,) = run.events
    assert hit.time == pytest.approx((1.0 - 0.04) / 50.0, abs=1e-14)  # 0.08 apart along x, 0.06 across
    assert hit.label == "balls: left_ball on right_ball"
    # Equal masses exchange their velocity components along the line of centers.
    line = np.array([-0.8, -0.6, 0.0])
    expected = np.array([50.0, 0.0, 0.0]) + 80.0 * line
    np.testing.assert_allclose(body_of(run, "left", "linear_velocity")[-1], expected, atol=1e-12)
    momentum = body_of(run, "left", "linear_velocity") + body_of(run, "right", "linear_velocity")
    np.testing.assert_allclose(momentum, 0.0, atol=1e-12)


def rod(mu, angle, speed):
    """A rod of 1 kg and 2 m that slides on its lower end, tilted against its motion."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(wc.meshes.grid((40.0, 40.0), (1, 1)), name="ground")
    bar = scene.add_body(
        mass=1.0,
        inertia=(1.0 / 3.0, 1.0 / 3.0, 0.001),
        position=(-math.cos(angle), 0.0, math.sin(angle)),
        orientation=turned_about_y(angle - 0.5 * math.pi),
        linear_velocity=(speed, 0.0, 0.0),
        name="rod",
    )
    scene.add_contact(scene.add_point(bar, (0, 0, -1.0)), ground, rigid(mu), name="tip")
    return scene.build(device="cpu", precision="float64")


def test_event_driven_raises_paradox_error_for_painleve_rod():
    angle = math.radians(45.0)
    # 1/m + (cos² − μ sin cos)/I < 0 for a thin rod: μ > (1 + 3 cos²)/(3 sin cos) = 5/3 at 45°.
    with pytest.raises(
        ParadoxError, match=r"t = 0 s: slip of tip increases its own normal force.*Painlevé"
    ) as caught:
        EventDriven(rod(5.0 / 3.0 + 0.01, angle, 1.0)).run(0.1)
    assert str(caught.value.run) == "event-driven run from 0 s to 0 s: no events"
    run = EventDriven(rod(5.0 / 3.0 - 0.2, angle, 1.0)).run(0.02)
    assert not run.events_of("LIFT_OFF")
    # For sliding in the opposite direction friction lifts, and there is no paradox.
    EventDriven(rod(5.0 / 3.0 + 0.01, angle, -1.0)).run(0.02)


def test_event_driven_tumbling_block_never_gains_energy():
    model = block(mu=0.4, lift=0.3, restitution=0.5)
    model["box.orientation"] = np.array([0.1, 0.3, 0.05, 0.9]) / np.linalg.norm([0.1, 0.3, 0.05, 0.9])
    model["box.position"] = (0.0, 0.0, 1.6)
    model["box.angular_velocity"] = (0.5, 2.0, 1.0)
    run = EventDriven(model).run(1.0)
    assert len(run.events_of("IMPACT")) > 3
    energy = []
    inertia = box_inertia(10.0, (1.0, 1.0, 2.0))
    from scipy.spatial.transform import Rotation

    for state in run.states:
        spin = Rotation.from_quat(state.orientation[0]).inv().apply(state.angular_velocity[0])
        moving = 5.0 * (state.linear_velocity[0] ** 2).sum() + 0.5 * (inertia * spin**2).sum()
        energy.append(moving + 10.0 * G * state.position[0, 2])
    # Steps are accurate to 1e-12 of about 150 J.
    assert np.diff(energy).max() < 1e-9


@pytest.mark.slow
def test_event_driven_rocking_block_loses_energy_as_housner_and_comes_to_rest():
    model = block(mu=0.9)
    tilt = 2e-3
    # Rotation about the edge at x = 0.5, which is fixed.
    model["box.position"] = (
        0.5 - 0.5 * math.cos(tilt) + math.sin(tilt),
        0.0,
        0.5 * math.sin(tilt) + math.cos(tilt),
    )
    model["box.orientation"] = turned_about_y(tilt)
    run = EventDriven(model).run(0.3)
    hits = run.events_of("IMPACT")
    times = sorted({round(one.time, 9) for one in hits})
    rate = body_of(run, "box", "angular_velocity")[:, 1]
    ratios = []
    for time in times[:5]:
        at = np.flatnonzero(np.abs(run.times - time) < 1e-7)
        ratios.append(rate[at[-1]] / rate[at[0]])
    # 1 − (3/2) sin² α of a slender block with tan α = 1/2.
    np.testing.assert_allclose(ratios, 0.7, atol=1e-9)
    rests = run.events_of("REST")
    assert {one.item for one in rests} == {0, 1, 2, 3}
    # Late half cycles of rocking decrease by the same ratio, t ∝ ω: each impact is close to the limit.
    assert 0.0 < rests[0].time - times[-1] < 1e-4
    after = run.times > rests[0].time
    assert after.any()
    np.testing.assert_allclose(body_of(run, "box")[after, 2], 1.0, atol=1e-12)
    assert np.abs(rate[after]).max() < 1e-12


def test_event_driven_newton_restitution_with_friction_adds_no_energy():
    # A rod whose end slides when it hits the ground (Kane and Levinson): restitution 0.9 and large friction.
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(wc.meshes.grid((40.0, 40.0), (1, 1)), name="ground")
    bar = scene.add_body(mass=1.0, inertia=(1.0 / 3.0, 1.0 / 3.0, 0.001), name="rod")
    scene.add_contact(scene.add_point(bar, (0, 0, -1.0)), ground, rigid(0.9, 0.9), name="tip")
    model = scene.build(device="cpu", precision="float64")
    gained = 0
    for angle in np.radians([20.0, 35.0, 50.0, 65.0]):
        for slip in (-3.0, -1.0, 1.0, 3.0):
            model["rod.position"] = (0.0, 0.0, math.cos(angle) + 1e-5)
            model["rod.orientation"] = turned_about_y(angle)
            model["rod.linear_velocity"] = (slip, 0.0, -1.0)
            run = EventDriven(model).run(1e-3)
            before, after = run.states[0], run.states[-1]
            energy = [
                0.5 * (state.linear_velocity[0] ** 2).sum()
                + (state.angular_velocity[0] ** 2).sum() / 6.0
                + G * state.position[0, 2]
                for state in (before, after)
            ]
            hit = run.events[0]
            gained += hit.separation_speed < 0.9 * hit.approach_speed - 1e-9
            assert energy[1] <= energy[0] + 1e-9
    # In some of them, Newton's law without the limit would have added energy.
    assert gained > 0


def test_event_driven_raises_for_contact_of_two_prescribed_bodies():
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_shape(None, wc.shapes.Plane(), name="ground")
    motion = wc.motions.Harmonic(direction=(0, 0, 1), amplitude=-0.2, frequency=1.0)
    press = scene.add_body(mass=1.0, inertia=[0.4] * 3, position=(0, 0, 1.1), motion=motion, name="press")
    ram = scene.add_shape(press, wc.shapes.Sphere(1.0), name="ram")
    scene.add_shape_contact(ram, ground, rigid(0.3), name="touch")
    with pytest.raises(ParadoxError, match=r"touch must open, but neither body can move: both are fixed"):
        EventDriven(scene.build(device="cpu", precision="float64")).run(0.25)


@pytest.mark.slow
def test_event_driven_raises_for_ball_at_concave_edge_of_a_mesh():
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    corners = [(-4, -5, 0), (2, -5, 0), (2, 5, 0), (-4, 5, 0), (2, -5, 5), (2, 5, 5)]
    faces = [(0, 1, 2), (0, 2, 3), (1, 4, 5), (1, 5, 2)]
    room = scene.add_surface(wc.Mesh(np.array(corners, dtype=float), np.array(faces)), name="room")
    body = scene.add_body(
        mass=1.0, inertia=[0.004] * 3, position=(1.8, 0, 0.1), linear_velocity=(20.0, 0, 0), name="ball"
    )
    scene.add_contact(scene.add_point(body, (0, 0, 0)), room, rigid(0.0, 0.5), radius=0.1, name="touch")
    with pytest.raises(RuntimeError, match=r"at t = 0.005 s touch close and open repeatedly: at a concave edge"):
        EventDriven(scene.build(device="cpu", precision="float64")).run(0.1)


def test_event_driven_raises_for_unsupported_input():
    deep = block(lift=-1e-3)
    with pytest.raises(ValueError, match=r"feet\[0\] starts with a penetration of 0.001 m"):
        EventDriven(deep).run(0.1)
    engine = EventDriven(ball())
    with pytest.raises(ValueError, match="duration must be greater than 0, got 0 s"):
        engine.run(0.0)
    with pytest.raises(ValueError, match="zeno must be greater than 0, got 0 s"):
        EventDriven(ball(), zeno=0.0)
    with pytest.raises(KeyError, match=r"no 'ball.place' in an event-driven run; available: position"):
        engine.run(0.1)["ball.place"]
    with pytest.raises(ValueError, match="most_events must be a whole number, at least 1, got 0"):
        EventDriven(ball(), most_events=0)
    with pytest.raises(ValueError, match=r"method must be one of 'projection', .*, got 'enumeration'"):
        EventDriven(ball(), method="enumeration")
    with pytest.raises(ValueError, match=r"method must be one of 'projection', .*, got 'newton'"):
        wc.unilateral.equilibrium(ball(), method="newton")
    with pytest.raises(ValueError, match=r"kind must be one of 'IMPACT', .*, got 'impact'"):
        engine.run(0.1).events_of("impact")
    with pytest.raises(KeyError, match="no contact 'wall' in the scene; available: touch"):
        engine.run(0.1).events_of("IMPACT", "wall")
    # Infinite bouncing without loss has no accumulation point.
    with pytest.raises(RuntimeError, match="more than 5 events up to t = "):
        EventDriven(ball(restitution=1.0), most_events=5).run(20.0)
