"""A stop condition freezes an environment at the first state that satisfies it; others are unaffected."""

import numpy as np
import pytest
from scenes import dropped_sphere, square

import warpcontact as wc

DT = 1.0e-3


def falling(envs=4, precision="float64", device="cpu"):
    """Balls in free fall from different heights above a square."""
    model = dropped_sphere(
        wc.laws.KelvinVoigt(stiffness=1e4, damping=20.0),
        gravity=(0.0, 0.0, -9.81),
        velocity=(0.0, 0.0, 0.0),
        envs=envs,
        precision=precision,
        device=device,
    )
    model["ball.position"] = np.stack([[0.0, 0.0, z] for z in np.linspace(0.2, 0.5, envs)])
    return model


def landed(**options):
    return wc.StopCondition("ball.position", component="z", below=0.15, **options)


def test_stopped_environment_keeps_the_first_state_that_meets_the_condition_bitwise(device):
    model = falling(device=device)
    sim = wc.Simulation(model, DT, stop={"landed": landed()})
    free = wc.Simulation(falling(device=device), DT)
    recording = free.run(0.5, record=["ball.linear_velocity"], every=DT)
    position, time = recording["ball.position"].to_numpy(), recording["time"].to_numpy()
    first = (position[..., 2] < 0.15).argmax(axis=0)
    sim.step(333)
    at_stop = {name: model.sensor(f"ball.{name}") for name in ("position", "linear_velocity", "orientation")}
    sim.step(100)
    for name, values in at_stop.items():
        np.testing.assert_array_equal(model.sensor(f"ball.{name}"), values)
    each = np.arange(model.envs)
    np.testing.assert_array_equal(at_stop["position"], position[first, each])
    velocity = recording["ball.linear_velocity"].to_numpy()
    np.testing.assert_array_equal(at_stop["linear_velocity"], velocity[first, each])
    found = sim.outcomes()
    # Environment clocks are sums of steps.
    np.testing.assert_allclose(found["end_time"], time[first], rtol=1e-12)
    assert (found["status"] == wc.EnvironmentStatus.STOPPED).all()
    np.testing.assert_array_equal(found["stopped_by"], 0)
    assert found["stopped_by"].attrs["flag_meanings"] == "landed"
    health = model.health()
    assert health.good
    assert health.stopped.tolist() == [0, 1, 2, 3]
    assert str(health) == "0 of 4 environments are active; 4 are stopped"


def test_both_state_buffers_have_the_stopped_state():
    # Stopped after an odd and an even number of steps, that is, in either state buffer.
    model = falling()
    sim = wc.Simulation(model, DT, stop={"landed": landed()})
    seen = []
    for _ in range(400):
        sim.step()
        seen.append(model.sensor("ball.position"))
    seen = np.array(seen)
    held = seen[..., 2] < 0.15
    for env in range(model.envs):
        own = seen[held[:, env], env]
        assert len(own) > 1
        assert (own == own[0]).all()


def test_lasting_stop_condition_restarts_after_an_interruption():
    model = falling()
    lasting = 0.15
    sim = wc.Simulation(model, DT, stop={"rest": landed(lasting=lasting)})
    recording = wc.Simulation(falling(), DT).run(2.0, every=DT)
    low = recording["ball.position"].to_numpy()[..., 2] < 0.15
    run = np.zeros(model.envs, int)
    expected = np.full(model.envs, -1)
    for number, holds in enumerate(low):
        run = np.where(holds, run + 1, 0)
        # n steps after the first of n + 1 states.
        expected[(expected < 0) & (run > round(lasting / DT))] = number
    sim.step(2000)
    np.testing.assert_array_equal(np.round(sim.outcomes()["end_time"] / DT), expected)
    assert (low.argmax(axis=0) < expected - round(lasting / DT)).any(), "no break to begin anew after"


def test_first_stop_condition_in_order_is_reported_and_outcomes_are_kept():
    model = falling()
    stops = {
        "never": wc.StopCondition("ball.position", component="z", above=9.0),
        "deep": wc.StopCondition("touch.normal_force", above=0.0),
        "low": wc.StopCondition("touch.penetration", above=0.0),
    }
    outcomes = {
        "fall": wc.outcomes.Change("ball.position", component="z"),
        "n": wc.outcomes.Count("touch.penetration", above=0.0),
    }
    sim = wc.Simulation(model, DT, stop=stops, outcomes=outcomes, events=wc.ContactEvents(["touch"]))
    sim.step(500)
    found = sim.outcomes()
    np.testing.assert_array_equal(found["stopped_by"], 1)
    assert found["stopped_by"].attrs["flag_meanings"] == "never deep low"
    # Monitors evaluate the final state as well.
    np.testing.assert_array_equal(found["n"], 1.0)
    np.testing.assert_allclose(found["fall"], model.sensor("ball.position")[:, 2] - np.linspace(0.2, 0.5, 4))
    np.testing.assert_array_equal(sim.events()["time"][:, 0], found["end_time"])
    sim.step(100)
    again = sim.outcomes()
    for name in found:
        np.testing.assert_array_equal(again[name], found[name])


def test_reset_restarts_a_stopped_environment():
    model = falling()
    sim = wc.Simulation(model, DT, stop={"landed": landed(lasting=0.01)})
    sim.step(400)
    before = sim.outcomes()
    sim.reset(np.array([True, False, False, False]))
    after = sim.outcomes()
    assert after["status"].to_numpy().tolist() == [0, 6, 6, 6]
    assert after["stopped_by"].to_numpy().tolist() == [-1, 0, 0, 0]
    sim.step(400)
    np.testing.assert_array_equal(sim.outcomes()["end_time"], before["end_time"])


def test_stop_condition_does_not_change_other_environments():
    both = wc.Simulation(
        falling(), DT, stop={"high": wc.StopCondition("ball.position", component="z", above=0.45)}
    )
    alone = wc.Simulation(falling(), DT)
    for sim in (both, alone):
        sim.step(300)
    expected = alone.model.sensor("ball.position")
    found = both.model.sensor("ball.position")
    np.testing.assert_array_equal(found[:3], expected[:3])
    assert both.outcomes()["status"].to_numpy().tolist() == [0, 0, 0, 6]
    assert found[3, 2] == 0.5


def test_nonsmooth_contact_supports_stop_conditions():
    scene = wc.Scene()
    ground = scene.add_surface(square(), name="ground")
    ball = scene.add_body(mass=1.0, inertia=(0.01,) * 3, position=(0, 0, 0.3), name="ball")
    rigid = wc.ContactMaterial(law=wc.laws.Rigid(restitution=0.5))
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, rigid, radius=0.1, name="touch")
    model = scene.build(envs=2)
    stop = {"hit": wc.StopCondition("touch.impulse", component="norm", above=0.0)}
    sim = wc.Simulation(model, DT, wc.integrators.MoreauJean(), stop=stop)
    sim.step(400)
    found = sim.outcomes()
    # The impact is at √(2 · 0.2 m / g). The condition sees it in the state after the step with the impulse.
    np.testing.assert_allclose(found["end_time"], np.sqrt(0.4 / 9.81), atol=2.0 * DT)
    assert (model.sensor("ball.linear_velocity")[:, 2] > 0.9).all()


def test_stop_condition_with_substeps_is_reported_once():
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    ground = scene.add_surface(square(), name="ground")
    ball = scene.add_body(
        mass=1.0, inertia=(0.01,) * 3, position=(0, 0, 0.05), linear_velocity=(0, 0, -20.0), name="ball"
    )
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, material, name="touch", swept=True)
    model = scene.build(envs=2, precision="float64")
    model["ball.linear_velocity"] = [(0, 0, -20.0), (0, 0, -30.0)]
    outcomes = {
        "impulse": wc.outcomes.Integral("touch.normal_force"),
        "time": wc.outcomes.Duration("ball.position", component="z", above=-9.0),
    }
    stop = {"up": wc.StopCondition("ball.position", component="z", above=0.1)}
    sim = wc.Simulation(model, DT, crossing_substeps=20, outcomes=outcomes, stop=stop)
    sim.step(200)
    found = sim.outcomes()
    # Each step or substep is summed once: times equal those of the clocks, and impulses reverse the ball. The
    # error is about ω dt / 2, by which the velocity of a step differs from that of a substep.
    np.testing.assert_allclose(found["time"], found["end_time"], rtol=1e-9)
    gained = model.sensor("ball.linear_velocity")[:, 2] - [-20.0, -30.0]
    np.testing.assert_allclose(found["impulse"], gained, rtol=0.05)
    assert (found["status"] == wc.EnvironmentStatus.STOPPED).all()


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (
            lambda: wc.StopCondition("ball.position", below=0.1),
            r"stop\['x'\]: ball\.position is a vector; set component to",
        ),
        (
            lambda: wc.StopCondition("ball.positon", below=0.1),
            r"stop\['x'\]: no sensor 'ball\.positon'; did you mean",
        ),
        (lambda: wc.StopCondition("touch.gap"), "StopCondition takes either above or below, got neither"),
        (lambda: wc.StopCondition("touch.gap", above=1, below=0), "got above=1 and below=0"),
        (lambda: wc.StopCondition("touch.gap", below=0, lasting=-1), "lasting must be at least 0, got -1 s"),
        (lambda: wc.StopCondition(3, below=0), r"StopCondition\.of must be the name of a sensor"),
    ],
)
def test_invalid_stop_condition_is_refused(make, problem):
    with pytest.raises((KeyError, TypeError, ValueError), match=problem):
        wc.Simulation(falling(1), DT, stop={"x": make()})
