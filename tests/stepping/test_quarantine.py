"""A failed environment keeps its last valid state, with cause and time; others are unaffected."""

import numpy as np
import pytest
from scenes import dropped_sphere

import warpcontact as wc
from warpcontact.model.quarantine import CADENCE

DT = 1.0e-3


def falling(envs=4, **options):
    """Balls in free fall from rest, 100 m above a square."""
    return dropped_sphere(
        wc.laws.Hooke(stiffness=1e4),
        gravity=(0.0, 0.0, -10.0),
        height=100.0,
        velocity=(0.0, 0.0, 0.0),
        envs=envs,
        **options,
    )


@pytest.mark.parametrize("integrator", [wc.integrators.SemiImplicitEuler(), wc.integrators.MoreauJean()])
def test_limits_freeze_an_environment_at_the_last_state_within_them(integrator, device):
    model = falling(precision="float64", device=device)
    model["scene.max_speed"] = [np.inf, 5.0, np.inf, 1e4]
    model["scene.max_distance"] = [np.inf, np.inf, 99.0, 1e6]
    sim = wc.Simulation(model, DT, integrator)
    sim.step(1000)
    health = model.health()
    assert health.frozen.tolist() == [1, 2]
    assert health.causes == (wc.FailureCause.TOO_FAST, wc.FailureCause.TOO_FAR)
    # The ball starts 100.1 m away, beyond the limit from the first step. The speed limit of 5 m/s is reached after
    # 0.5 s.
    np.testing.assert_allclose(health.times, [0.5, 0.0], atol=1.5 * DT)
    speed = -model.sensor("ball.linear_velocity")[:, 2]
    assert 5.0 - 2 * 10.0 * DT <= speed[1] <= 5.0
    np.testing.assert_allclose(speed[[0, 3]], 10.0, rtol=1e-9)
    report = str(health)
    assert "1 of 4 environments became faster than scene.max_speed" in report
    assert (
        "1 of 4 environments went beyond scene.max_distance and are frozen at their last valid state: 2" in report
    )
    found = sim.outcomes()
    assert found["cause"].to_numpy().tolist() == [0, 2, 3, 0]
    assert found["status"].to_numpy().tolist() == [0, 2, 2, 0]
    np.testing.assert_array_equal(found["end_time"][1:3], health.times)


def test_limits_apply_to_joints_and_prescribed_motions():
    scene = wc.Scene(max_speed=2.0)
    slider = wc.motions.Slider(axis=(0, 0, 1))
    scene.add_body(mass=1.0, inertia=(0.1,) * 3, motion=slider, name="slider")
    model = scene.build()
    sim = wc.Simulation(model, DT)
    sim.step(400)
    health = model.health()
    assert health.causes == (wc.FailureCause.TOO_FAST,)
    np.testing.assert_allclose(health.times, 2.0 / 9.81, atol=1.5 * DT)


def test_limits_are_ordinary_parameters():
    scene = wc.Scene(max_speed=3.0, max_distance=7.0)
    scene.add_body(mass=1.0, inertia=(0.1,) * 3, name="ball")
    model = scene.build(envs=2)
    assert model["scene.max_speed"].tolist() == [3.0, 3.0]
    model["scene.max_distance"] = [1.0, np.inf]
    assert model["scene.max_distance"].tolist() == [1.0, np.inf]
    with pytest.raises(ValueError, match=r"scene\.max_speed\[1\] must be greater than 0, got -1 m/s"):
        model["scene.max_speed"] = [1.0, -1.0]
    with pytest.raises(ValueError, match="max_speed must be greater than 0, got 0 m/s"):
        wc.Scene(max_speed=0.0)
    # A limit whose square overflows float32 has no effect and raises no error.
    model["scene.max_speed"] = 1e30
    wc.Simulation(model, DT).step()
    assert model.health().good


def test_non_finite_environment_leaves_a_thousand_others_unchanged():
    expected = falling(1000)
    wc.Simulation(expected, DT).step(50)
    model = falling(1000)
    sim = wc.Simulation(model, DT, outcomes={"low": wc.outcomes.Min("ball.position", component="z")})
    sim.step(20)
    velocity = model.state.body_linear_velocity.numpy().copy()
    velocity[500] = np.nan
    model.state.body_linear_velocity.assign(velocity)
    sim.step(30)
    others = np.arange(1000) != 500
    for name in ("position", "linear_velocity", "orientation"):
        found, of = (one.sensor(f"ball.{name}") for one in (model, expected))
        np.testing.assert_array_equal(found[others], of[others])
    health = model.health()
    assert health.frozen.tolist() == [500]
    assert health.causes == (wc.FailureCause.NON_FINITE,)
    np.testing.assert_allclose(health.times, 20 * DT)
    found = sim.outcomes()
    # The outcome keeps earlier values and excludes the failed state.
    assert np.isfinite(found["low"]).all()
    assert found["low"][500] > found["low"][499]


def spinning_up(envs, first=0, **options):
    """Environments from ``first`` to ``envs`` exceed the speed limit one after the other."""
    speeds = np.linspace(1.0, 3.0, 5)[first : first + envs]
    model = falling(envs)
    model["scene.max_speed"] = speeds
    return wc.Simulation(model, DT, quarantine="reset", **options)


OUTCOMES = {"low": wc.outcomes.Min("ball.position", component="z"), "first": wc.outcomes.Initial("ball.position")}


def test_reset_environment_restarts_and_is_counted():
    sim = spinning_up(5, outcomes=OUTCOMES)
    steps = 10 * CADENCE
    sim.step(steps)
    found = sim.outcomes()
    # Each environment fails after v/g, is reset at the next check, and so on.
    expected = []
    for speed in np.linspace(1.0, 3.0, 5):
        fails = int(np.floor(speed / 10.0 / DT + 1e-6)) + 1
        expected.append(steps // (CADENCE * -(-fails // CADENCE)))
    np.testing.assert_array_equal(found["resets"], expected)
    assert (found["resets"] > 0).all()
    assert (found["end_time"] < steps * DT).all()
    # Outcomes cover the time since the reset.
    fallen = found["low"].to_numpy() - 100.1
    np.testing.assert_allclose(fallen, -0.5 * 10.0 * found["end_time"] ** 2, atol=0.03)
    # Environments that the user resets start with zero resets.
    sim.reset(np.array([True, False, False, False, False]))
    assert sim.outcomes()["resets"].to_numpy().tolist() == [0, *expected[1:]]


def test_quarantine_checks_do_not_depend_on_steps_per_call():
    results = []
    for pieces in ([500], [1, 63, 64, 100, 272], [7] * 71 + [3]):
        sim = spinning_up(5, outcomes=OUTCOMES)
        for count in pieces:
            sim.step(count)
        results.append((sim.outcomes(), sim.model.sensor("ball.position")))
    for found, position in results[1:]:
        np.testing.assert_array_equal(position, results[0][1])
        for name in found:
            np.testing.assert_array_equal(found[name], results[0][0][name])


def test_quarantine_reset_is_identical_for_an_environment_alone():
    many, alone = spinning_up(5, outcomes=OUTCOMES), spinning_up(1, first=2, outcomes=OUTCOMES)
    for sim in (many, alone):
        sim.step(500)
    for name, values in alone.outcomes().items():
        np.testing.assert_array_equal(values, many.outcomes()[name][2:3])


def test_quarantine_error_names_first_environment_with_time_and_cause():
    model = falling()
    model["scene.max_speed"] = [np.inf, 3.0, 2.0, 2.0]
    model.first_env = 100
    sim = wc.Simulation(model, DT, quarantine="raise")
    with pytest.raises(
        wc.QuarantineError, match=r"environment 102 failed at 0\.2 s: TOO_FAST, and 1 more"
    ) as caught:
        sim.step(1000)
    assert (caught.value.env, caught.value.cause, caught.value.count) == (102, wc.FailureCause.TOO_FAST, 2)
    # The status is checked every ``CADENCE`` steps, and all environments stop at that step.
    assert sim.steps == CADENCE * -(-201 // CADENCE)


def test_unknown_quarantine_policy_is_refused():
    with pytest.raises(ValueError, match="quarantine must be one of 'freeze', 'reset', 'raise', got 'explode'"):
        wc.Simulation(falling(1), DT, quarantine="explode")


@pytest.mark.parametrize("evaluate", [False, True], ids=["step", "evaluation_first"])
def test_reset_environment_has_no_wrenches_of_its_failure(evaluate, device):
    """Moreau–Jean steps prescribe the motion of driven bodies before they compute wrenches."""
    scene = wc.Scene()
    motion = wc.motions.Harmonic(direction=(1.0, 0.0, 0.0), amplitude=0.02, frequency=1.0)
    plate = scene.add_body(1.0, (1.0, 1.0, 1.0), motion=motion)
    floor = scene.add_surface(wc.meshes.box((1.0, 1.0, 0.2)), body=plate, position=(0, 0, -0.1))
    ball = scene.add_body(1.0, (0.1, 0.1, 0.1), position=(0, 0, 0.0999), name="ball")
    material = wc.ContactMaterial(law=wc.laws.KelvinVoigt(stiffness=1e4, damping=20.0))
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), floor, material, radius=0.1, name="touch")
    model = scene.build(envs=2, device=device)
    sim = wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean(compliant=("touch",)))
    # A damping force that overflows float32.
    model["touch.law.damping"] = [20.0, 3e38]
    model["ball.linear_velocity"] = (0.0, 0.0, -5.0)
    sim.step(3)
    assert model.health().frozen.tolist() == [1]
    model["touch.law.damping"] = 20.0
    model["ball.linear_velocity"] = (0.0, 0.0, 0.0)
    sim.reset()
    if evaluate:
        model.sensor("touch.normal_force")
    sim.step(3)
    assert model.health().good
