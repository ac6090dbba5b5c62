"""Outcomes equal those computed from a recording of every step, and closed forms."""

from typing import Any

import numpy as np
import pytest
import warp as wp
from scenes import dropped_sphere, square

import warpcontact as wc

STIFFNESS, MASS = 1.0e4, 1.0
SPEEDS = np.array([1.0, 2.0, 3.0])
DT = 1.0e-5
OMEGA = np.sqrt(STIFFNESS / MASS)
# Number of steps until the slowest sphere has bounced, from a height of 10 mm.
STEPS = 4500


class Power(wc.Outcome):
    """Mean of the cube over time."""

    memory = (0.0, 0.0)

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        m[0] += x * x * x * dt
        m[1] += dt
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0] / m[1]


def model_of(law, envs=3, precision="float64", device="cpu", **options):
    model = dropped_sphere(law, mass=MASS, height=0.01, envs=envs, precision=precision, device=device, **options)
    speeds = np.resize(SPEEDS, envs)
    model["ball.linear_velocity"] = np.stack([0 * speeds, 0 * speeds, -speeds], axis=1)
    return model


ELASTIC = {
    "peak": wc.outcomes.Max("touch.normal_force"),
    "impulse": wc.outcomes.Integral("touch.normal_force"),
    "deepest": wc.outcomes.Max("touch.penetration"),
    "first": wc.outcomes.FirstTime("touch.penetration", above=0.0),
    "time": wc.outcomes.Duration("touch.penetration", above=0.0),
    "times": wc.outcomes.Count("touch.penetration", above=0.0),
    "change": wc.outcomes.Change("ball.linear_momentum", component="z"),
    "restitution": wc.outcomes.Restitution("touch"),
    "work": wc.outcomes.Work("touch"),
    "end": wc.outcomes.Final("ball.position"),
}


def test_outcomes_of_elastic_bounce_match_half_sine(device):
    model = model_of(wc.laws.Hooke(stiffness=STIFFNESS), device=device)
    sim = wc.Simulation(model, DT, outcomes=ELASTIC)
    sim.step(STEPS)
    found = sim.outcomes()
    # With ω dt = 1e-3, the scheme is of second order for the motion: relative error 1e-6 in force and impulse. The
    # start of contact is resolved to one step, v dt of penetration: the square of 1e-3 at the end of a half sine.
    np.testing.assert_allclose(found["peak"], SPEEDS * MASS * OMEGA, rtol=1e-5)
    np.testing.assert_allclose(found["deepest"], SPEEDS / OMEGA, rtol=1e-5)
    np.testing.assert_allclose(found["impulse"], 2.0 * MASS * SPEEDS, rtol=1e-5)
    np.testing.assert_allclose(found["change"], 2.0 * MASS * SPEEDS, rtol=1e-5)
    np.testing.assert_allclose(found["restitution"], 1.0, rtol=1e-5)
    np.testing.assert_allclose(found["first"], 0.01 / SPEEDS, atol=1.01 * DT)
    np.testing.assert_allclose(found["time"], np.pi / OMEGA, atol=2.0 * DT)
    np.testing.assert_array_equal(found["times"], 1.0)
    energy = 0.5 * MASS * SPEEDS**2
    np.testing.assert_allclose(found["work"] / energy, 0.0, atol=1e-5)
    np.testing.assert_array_equal(found["end"], model.sensor("ball.position"))
    assert found["end"].dims == ("env", "axis")
    assert found["impulse"].attrs["units"] == "N·s"
    assert found["time"].attrs["units"] == "s"
    assert found["peak"].attrs["long_name"] == "largest touch.normal_force"
    assert (found["status"] == wc.EnvironmentStatus.ACTIVE).all()
    np.testing.assert_allclose(found["end_time"], STEPS * DT, rtol=1e-12)


@pytest.mark.parametrize("restitution", [0.3, 0.8])
def test_restitution_and_work_outcomes_match_damped_law(restitution):
    law = wc.laws.KelvinVoigt(stiffness=STIFFNESS, restitution=restitution)
    sim = wc.Simulation(model_of(law), DT, outcomes={key: ELASTIC[key] for key in ("restitution", "work")})
    sim.step(STEPS)
    found = sim.outcomes()
    out = sim.model.sensor("ball.linear_velocity")[:, 2]
    # The law cuts the force at zero before δ is zero, so the last state in contact has the speed of separation.
    np.testing.assert_allclose(found["restitution"], out / SPEEDS, rtol=1e-3)
    lost = 0.5 * MASS * (SPEEDS**2 - out**2)
    # In the first and last step of contact the dashpot force jumps, over v dt relative to v/ω: 2 ω dt.
    np.testing.assert_allclose(found["work"], lost, rtol=4.0 * OMEGA * DT)


def test_restitution_outcome_is_nan_for_contact_without_approach():
    model = model_of(wc.laws.Hooke(stiffness=STIFFNESS), 3)
    start = model["ball.position"].copy()
    start[:, 2] -= 0.01 + 1e-3  # 1 mm penetration
    model["ball.position"] = start
    # At rest, separating, approaching.
    model["ball.linear_velocity"] = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.0, 0.0, -0.1]]
    sim = wc.Simulation(model, DT, outcomes={key: ELASTIC[key] for key in ("restitution", "deepest")})
    sim.step(STEPS)
    assert not (sim.model.sensor("touch.penetration") > 0.0).any()
    assert (sim.outcomes()["deepest"] > 0.9e-3).all()
    found = sim.outcomes()["restitution"].values
    assert np.isnan(found[:2]).all()
    assert found[2] > 1.0  # it started with elastic energy


def recorded(quantities, envs=3, steps=400, dt=2.0e-4, **options):
    law = wc.laws.HuntCrossley(stiffness=1.0e5, exponent=1.5, restitution=0.6)
    friction = wc.friction.Tanh(mu=0.4, velocity_scale=1e-2)
    model = model_of(law, envs, "float32", gravity=(1.0, 0.0, -9.81), friction=friction)
    return model, wc.Simulation(model, dt, **options).run(steps * dt, record=quantities, every=dt)


# Without the dashpot of a law that uses the step length, because a sensor is instantaneous.
REDUCED = {
    "Max": lambda x, t, dt: x.max(axis=0),
    "Min": lambda x, t, dt: x.min(axis=0),
    "Range": lambda x, t, dt: x.max(axis=0) - x.min(axis=0),
    "Integral": lambda x, t, dt: (x[:-1] * dt).sum(axis=0),
    "Mean": lambda x, t, dt: x[:-1].mean(axis=0),
    "Rms": lambda x, t, dt: np.sqrt((x[:-1] ** 2).mean(axis=0)),
    "Initial": lambda x, t, dt: x[0],
    "Final": lambda x, t, dt: x[-1],
    "Change": lambda x, t, dt: x[-1] - x[0],
    "TimeOfMax": lambda x, t, dt: t[x.argmax(axis=0)],
}


@pytest.mark.slow
def test_every_outcome_matches_recording_of_every_step():
    names = ["ball.position", "ball.linear_velocity", "ball.kinetic_energy", "touch.gap", "scene.linear_momentum"]
    _, recording = recorded(names)
    outcomes = {
        f"{kind}_{i}": getattr(wc.outcomes, kind)(name) for kind in REDUCED for i, name in enumerate(names)
    }
    outcomes["speed"] = wc.outcomes.Max("ball.linear_velocity", component="norm")
    outcomes["low"] = wc.outcomes.Duration("ball.position", component="z", below=0.104)
    outcomes["dips"] = wc.outcomes.Count("ball.position", component="z", below=0.104)
    outcomes["fall"] = wc.outcomes.FirstTime("ball.linear_velocity", component="z", above=0.5)
    outcomes["own"] = Power("touch.gap")
    model, again = recorded(names, outcomes=outcomes)
    # Monitors do not change the state.
    for name in names:
        np.testing.assert_array_equal(again[name], recording[name], err_msg=name)
    sim = wc.Simulation(model, 2.0e-4, outcomes=outcomes)
    sim.reset()
    sim.step(400)
    found = sim.outcomes()
    time = recording["time"].to_numpy()
    dt = 2.0e-4
    for kind, reduced in REDUCED.items():
        for i, name in enumerate(names):
            expected = reduced(recording[name].to_numpy().astype(float), time, dt)
            # The order of summation differs.
            np.testing.assert_allclose(
                found[f"{kind}_{i}"], expected, rtol=1e-12, atol=1e-12, err_msg=f"{kind} {name}"
            )
    velocity = recording["ball.linear_velocity"].to_numpy().astype(float)
    np.testing.assert_allclose(found["speed"], np.linalg.norm(velocity, axis=-1).max(axis=0), rtol=1e-14)
    below = recording["ball.position"].to_numpy()[..., 2] < 0.104
    np.testing.assert_allclose(found["low"], below[:-1].sum(axis=0) * dt, rtol=1e-12)
    starts = below & ~np.concatenate([np.zeros_like(below[:1]), below[:-1]])
    np.testing.assert_array_equal(found["dips"], starts.sum(axis=0))
    rises = velocity[..., 2] > 0.5
    np.testing.assert_allclose(found["fall"], time[rises.argmax(axis=0)], rtol=1e-12)
    gap = recording["touch.gap"].to_numpy().astype(float)[:-1]
    np.testing.assert_allclose(found["own"], (gap**3).mean(axis=0), rtol=1e-12, atol=1e-15)


SOME = {
    "peak": wc.outcomes.Max("touch.normal_force"),
    "work": wc.outcomes.Work("touch"),
    "far": wc.outcomes.Max("touch.gap"),
    "path": wc.outcomes.Integral("ball.linear_velocity", component="norm"),
}
WATCH = {
    "outcomes": SOME,
    "stop": {"high": wc.StopCondition("ball.position", component="z", above=0.108, lasting=2e-3)},
    "events": wc.ContactEvents(["touch"], most=3),
}


def bits(envs=5, steps=600, first=0, count=None, device="cpu", **options):
    law = wc.laws.HuntCrossley(stiffness=1.0e5, exponent=1.5, restitution=0.6)
    count = envs if count is None else count
    model = model_of(law, count, "float32", device=device, gravity=(0.0, 0.0, -9.81))
    speeds = np.linspace(0.5, 3.0, envs)[first : first + count]
    model["ball.linear_velocity"] = np.stack([0 * speeds, 0 * speeds, -speeds], axis=1)
    sim = wc.Simulation(model, 1.0e-4, **WATCH, **options)
    # In two parts of different length.
    sim.step(steps // 3 + 1)
    sim.step(steps - steps // 3 - 1)
    both = {f"outcome {name}": values.to_numpy() for name, values in sim.outcomes().items()}
    return both | {f"event {name}": values.to_numpy() for name, values in sim.events().items()}


@pytest.mark.parametrize(
    "options",
    [{"threads": 2}, {"capture_graphs": False}, {"device": ["cpu", "cpu"]}, {"distance_cache": False}],
    ids=str,
)
def test_outcomes_are_bitwise_identical_for_any_schedule(options):
    expected, found = bits(envs=9, threads=1), bits(envs=9, **options)
    assert expected.keys() == found.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)
    assert (expected["outcome stopped_by"] == 0).any()


def test_outcomes_of_an_environment_alone_are_identical(device):
    expected, found = bits(envs=7, device=device), bits(envs=7, first=3, count=1, device=device)
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values[3:4], err_msg=name)


def test_reset_restarts_outcomes_of_masked_environments():
    model = model_of(wc.laws.Hooke(stiffness=STIFFNESS))
    outcomes = {key: ELASTIC[key] for key in ("peak", "first", "times")}
    sim = wc.Simulation(model, 1e-4, outcomes=outcomes, events=wc.ContactEvents(["touch"], most=2))
    sim.step(400)
    before = sim.outcomes()
    sim.reset(np.array([False, True, False]))
    after = sim.outcomes()
    assert after["peak"][1] == 0.0
    assert np.isnan(after["first"][1])
    assert after["times"][1] == 0.0
    assert np.isnan(sim.events()["time"][1]).all()
    sim.step(400)
    again = sim.outcomes()
    for name in outcomes:
        assert after[name][0] == before[name][0]
        assert again[name][1] == before[name][1]


def test_outcomes_raise_after_another_simulation_stepped_and_restart():
    model = model_of(wc.laws.Hooke(stiffness=STIFFNESS))
    first = wc.Simulation(model, 1e-4, outcomes={"peak": ELASTIC["peak"]})
    first.step(450)  # until all have left the ground
    second = wc.Simulation(model, 1e-4, outcomes={"peak": ELASTIC["peak"]})
    with pytest.raises(RuntimeError, match="another simulation stepped the model since"):
        first.outcomes()
    second.step(1)
    np.testing.assert_array_equal(second.outcomes()["peak"], 0.0)
    first.step(1)
    np.testing.assert_array_equal(first.outcomes()["peak"], 0.0)


def test_outcomes_of_sets_are_per_item_or_reduced():
    scene = wc.Scene(gravity=(0.0, 0.0, -9.81))
    ground = scene.add_surface(square(), name="ground")
    box = scene.add_body(mass=1.0, inertia=(0.01,) * 3, position=(0, 0, 0.099), name="box")
    corners = scene.add_points(box, [(x, y, -0.1) for x in (-0.1, 0.1) for y in (-0.1, 0.1)], name="corners")
    law = wc.laws.KelvinVoigt(stiffness=2.0e3, damping=10.0)
    scene.add_contact(corners, ground, wc.ContactMaterial(law=law), name="feet")
    model = scene.build(envs=2)
    folds = ("each", "sum", "max", "min")
    outcomes = {key: wc.outcomes.Integral("feet.normal_force", items=key) for key in folds}
    outcomes["normal"] = wc.outcomes.Final("feet.normal")
    sim = wc.Simulation(model, 1e-4, outcomes=outcomes)
    sim.step(20)
    found = sim.outcomes()
    assert found["each"].dims == ("env", "item")
    assert found["normal"].dims == ("env", "item", "axis")
    np.testing.assert_allclose(found["each"].sum("item"), found["sum"], rtol=1e-12)
    # All four points carry equal loads.
    np.testing.assert_allclose(found["sum"], 4.0 * found["max"], rtol=1e-4)
    assert (found["min"] <= found["max"]).all()


def test_max_gap_outcome_disables_the_distance_cache():
    # Distant contacts are evaluated only if an outcome needs their gap.
    model = model_of(wc.laws.Hooke(stiffness=STIFFNESS))
    sim = wc.Simulation(model, 1e-4, outcomes={"far": wc.outcomes.Max("touch.gap")})
    assert not sim.distance_cache
    sim.step(1500)
    position = sim.model.sensor("ball.position")[:, 2]
    np.testing.assert_allclose(sim.outcomes()["far"], position - 0.1, rtol=1e-6)


def test_nonsmooth_contacts_have_impulse_and_force_outcomes_in_every_step():
    scene = wc.Scene()
    ground = scene.add_surface(square(), name="ground")
    ball = scene.add_body(mass=2.0, inertia=(0.01,) * 3, position=(0, 0, 0.3), name="ball")
    rigid = wc.ContactMaterial(law=wc.laws.Rigid(restitution=0.5))
    scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, rigid, radius=0.1, name="touch")
    model = scene.build(envs=2, precision="float64")
    dt = 1.0e-3
    outcomes = {
        "blow": wc.outcomes.Max("touch.impulse", component="z"),
        "peak": wc.outcomes.Max("touch.normal_force"),
        "total": wc.outcomes.Integral("touch.normal_force"),
        "loss": wc.outcomes.Final("scene.impact_dissipation"),
        "moved": wc.outcomes.Change("ball.linear_momentum", component="z"),
    }
    steps = 280
    sim = wc.Simulation(
        model, dt, wc.integrators.MoreauJean(), outcomes=outcomes, events=wc.ContactEvents(["touch"], most=4)
    )
    recording = sim.run(steps * dt, record=["touch.impulse", "touch.normal_force"], every=dt)
    found, events = sim.outcomes(), sim.events()
    impulse = recording["touch.impulse"].to_numpy()[..., 2]
    force = recording["touch.normal_force"].to_numpy()
    np.testing.assert_array_equal(found["blow"], impulse.max(axis=0))
    np.testing.assert_array_equal(found["peak"], force.max(axis=0))
    # The force of a state is the mean over the previous step; the next step adds it to the sum.
    np.testing.assert_allclose(found["total"], (force[:-1] * dt).sum(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found["total"], found["moved"] + 2.0 * 9.81 * steps * dt, rtol=1e-9)
    np.testing.assert_array_equal(found["loss"], model.sensor("scene.impact_dissipation"))
    first = recording["time"].to_numpy()[(impulse > 0.0).argmax(axis=0)]
    np.testing.assert_allclose(events["time"][:, 0], first, rtol=1e-12)
    with pytest.raises(ValueError, match=r"got the nonsmooth contact 'touch'.*touch\.law\.restitution"):
        wc.Simulation(model, dt, wc.integrators.MoreauJean(), outcomes={"e": wc.outcomes.Restitution("touch")})
    force = wc.outcomes.Max("ball.force", component="z")
    with pytest.raises(ValueError, match=r"ball\.force is not computed in every step, so only Final can use it"):
        wc.Simulation(model, dt, wc.integrators.MoreauJean(), outcomes={"f": force})


def test_shape_contacts_and_springs_can_be_monitored():
    scene = wc.Scene()
    ball = scene.add_body(mass=1.0, inertia=(4e-3,) * 3, position=(0, 0, 0.11), name="ball")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=STIFFNESS))
    shapes = scene.add_shape(ball, wc.shapes.Sphere(0.1)), scene.add_shape(None, wc.shapes.Plane())
    scene.add_shape_contact(*shapes, material, name="tap")
    hook, centre = scene.add_point(None, (0, 0, 0.5)), scene.add_point(ball, (0, 0, 0))
    scene.add_spring_damper(hook, centre, stiffness=20.0, rest_length=0.3, name="spring")
    model = scene.build(envs=2)
    names = ["tap.normal_force", "tap.penetration", "tap.gap", "spring.length", "spring.force"]
    outcomes = {f"largest_{i}": wc.outcomes.Max(name) for i, name in enumerate(names)}
    sim = wc.Simulation(model, 1e-4, outcomes=outcomes, events=wc.ContactEvents(["tap"]))
    recording = sim.run(0.08, record=names, every=1e-4)
    found = sim.outcomes()
    for i, name in enumerate(names):
        np.testing.assert_allclose(found[f"largest_{i}"], recording[name].max("time"), rtol=1e-6, err_msg=name)
    touches = recording["tap.penetration"].to_numpy() > 0.0
    first = recording["time"].to_numpy()[touches.argmax(axis=0)]
    np.testing.assert_allclose(sim.events()["time"][:, 0], first, rtol=1e-12)


def test_memory_estimate_includes_outcomes_and_events():
    plain, watched = (
        wc.Simulation(model_of(wc.laws.Hooke(stiffness=STIFFNESS), envs=64), 1e-4, **options)
        for options in ({}, {"outcomes": ELASTIC, "events": wc.ContactEvents(["touch"], most=10)})
    )
    before, after = plain.memory(), watched.memory()
    assert "outcomes" not in {need.purpose for need in before.items}
    # Each outcome stores its values, two at least, in float64. Each event stores a time and a code. There is a
    # small remainder.
    results = dict.fromkeys(ELASTIC, 1) | {"end": 3}
    numbers = sum(results[name] * max(2, len(one.memory)) for name, one in ELASTIC.items())
    least = 64 * (8 * numbers + 10 * 12)
    counted = sum(need.size for need in after.items if need.purpose == "outcomes")
    assert least <= counted <= least + 64 * 16
    # The estimate equals the allocation, because both use the same allocation plans.
    kept = watched.model.parts[0].monitor.outcome_states
    assert sum(one.memory.capacity for one in kept) == 64 * 8 * numbers


@pytest.mark.parametrize(
    ("outcome", "problem"),
    [
        (
            lambda: wc.outcomes.Max("touch.nrmal_force"),
            r"outcomes\['x'\]: no sensor 'touch.nrmal_force'; did you",
        ),
        (lambda: wc.outcomes.Max("touch.gap", component="z"), r"touch\.gap has no components, got component='z'"),
        (lambda: wc.outcomes.Max("ball.position", component="w"), r"has 'x', 'y', 'z', 'norm', got component='w'"),
        (lambda: wc.outcomes.Max("touch.gap", items="sum"), r"has no items, got items='sum'"),
        (lambda: wc.outcomes.Max("touch.gap", items="all"), r"Max\.items must be one of 'each', 'sum'.*got 'all'"),
        (lambda: wc.outcomes.Max("touch.gap", above=1.0), r"Max has no condition, and takes neither"),
        (lambda: wc.outcomes.FirstTime("touch.gap"), r"FirstTime takes either above or below, got neither"),
        (lambda: wc.outcomes.Count("touch.gap", above=np.nan), r"Count\.above must be finite, got nan"),
    ],
)
def test_invalid_outcome_is_refused(outcome, problem):
    model = model_of(wc.laws.Hooke(stiffness=STIFFNESS))
    with pytest.raises((ValueError, KeyError), match=problem):
        wc.Simulation(model, 1e-4, outcomes={"x": outcome()})


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_every_library_outcome_can_be_computed(precision, device):
    model = model_of(wc.laws.Hooke(stiffness=STIFFNESS), precision=precision, device=device)
    outcomes = {}
    for name, kind in wc.outcomes.OUTCOMES.items():
        condition = {"below": 0.105} if kind.conditional else {}
        of_contact = issubclass(kind, wc.outcomes.OfContact)
        outcomes[name] = kind("touch") if of_contact else kind("ball.position", component="z", **condition)
    sim = wc.Simulation(model, 1e-4, outcomes=outcomes)
    before = sim.outcomes()
    assert np.isnan(before["Mean"]).all()
    assert (before["Count"] == 0.0).all()
    sim.step(450)
    found = sim.outcomes()
    for name in wc.outcomes.OUTCOMES:
        assert np.isfinite(found[name]).all(), name
    assert (found["Initial"] > found["Min"]).all()


def test_reserved_outcome_names_are_refused():
    model = model_of(wc.laws.Hooke(stiffness=STIFFNESS))
    with pytest.raises(ValueError, match="'status' is a reserved name"):
        wc.Simulation(model, 1e-4, outcomes={"status": wc.outcomes.Max("touch.gap")})
    with pytest.raises(TypeError, match=r"outcomes\['x'\] must be like .*got the class Max; call it"):
        wc.Simulation(model, 1e-4, outcomes={"x": wc.outcomes.Max})


def test_custom_outcome_with_compile_error_is_explained():
    class Broken(wc.Outcome):
        @wp.func
        def update(m: Any, x: Any, time: Any, dt: Any):
            m[0] = x * 2.0
            return m

        @wp.func
        def result(m: Any, time: Any):
            return m[0]

    model = model_of(wc.laws.Hooke(stiffness=STIFFNESS))
    with pytest.raises(TypeError, match=r"outcomes\['x'\]: Broken does not compile(.|\n)*wp\.float64\(1\.5\)"):
        wc.Simulation(model, 1e-4, outcomes={"x": Broken("touch.gap")})
    with pytest.raises(TypeError, match=r"Empty\.update must be a device function"):
        type("Empty", (wc.Outcome,), {})
