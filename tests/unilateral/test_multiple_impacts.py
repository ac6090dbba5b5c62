"""Multiple impacts of bodies in contact: simultaneous and sequential rule in both integrators."""

from itertools import product

import numpy as np
import pytest
from case_marks import slow_except
from nonsmooth_scenes import G, rigid
from scenes import square

import warpcontact as wc

RULES = ("simultaneous", "sequential")
MASSES = np.array([[1.0] * 5, [1.0] * 5, [2.0, 1.0, 0.5, 3.0, 1.0], [0.5, 4.0, 1.0, 1.0, 2.0]])
RESTITUTION = np.array([1.0, 0.5, 1.0, 0.7])


def row_of_balls(
    count, *, gap=0.0, restitution=1.0, mu=None, spin=0.0, particles=False, motion=None, envs=1, **options
):
    """Balls of radius 50 mm in a row along x, ``gap`` apart; the first arrives from 20 mm away at 1 m/s."""
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    shapes = []
    for i in range(count):
        place = (i * (0.1 + gap) - 0.02 * (i == 0), 0.0, 0.0)
        first = {"linear_velocity": (1.0, 0.0, 0.0), "angular_velocity": (0.0, spin, 0.0)} if i == 0 else {}
        if motion is not None:
            first["motion"] = motion
        body = scene.add_body(1.0, (1e-3,) * 3, position=place, name=f"ball_{i}", **first)
        shapes.append(scene.add_shape(body, wc.shapes.Sphere(0.05), name=f"shape_{i}"))
    material = rigid(restitution, mu)
    if particles:
        scene.add_particle_contact(shapes, material, name="all")
    else:
        for i in range(count - 1):
            scene.add_shape_contact(shapes[i], shapes[i + 1], material, name=f"touch_{i}")
    return scene.build(envs=envs, **{"precision": "float64", **options})


def velocities(model, count):
    return np.stack([model.sensor(f"ball_{i}.linear_velocity") for i in range(count)], axis=1)


def by_steps(model, count, rule, *, dt=1e-3, duration=0.04):
    """Returns the velocities (envs, bodies, 3) after time stepping."""
    sim = wc.Simulation(model, dt, wc.integrators.MoreauJean(impacts=rule))
    sim.reset()
    sim.step(round(duration / dt))
    assert not model.sensor("scene.solve_failures").any()
    return velocities(model, count)


def by_events(model, count, rule, *, env=0, duration=0.04):
    """Returns the velocities (bodies, 3) of one environment after event-driven integration."""
    model.reset()
    state = wc.unilateral.EventDriven(model, env, impacts=rule)
    state.run(duration)
    return state.state.linear_velocity


def simultaneous(mass, restitution, before):
    """Returns the velocities along the row that solve 0 ≤ P ⟂ U⁺ + e U⁻ ≥ 0, by enumeration of active contacts."""
    count = len(mass)
    H = np.diff(np.eye(count), axis=0)
    W = H / mass @ H.T
    lacking = H @ before + restitution * np.minimum(H @ before, 0.0)
    for pressed in map(np.array, product([False, True], repeat=count - 1)):
        P = np.zeros(count - 1)
        P[pressed] = np.linalg.solve(W[np.ix_(pressed, pressed)], -lacking[pressed])
        if (P > -1e-12).all() and (W @ P + lacking > -1e-12).all():
            return before + H.T @ P / mass
    raise AssertionError("no solution")


def sequential(mass, restitution, before):
    """Returns the velocities along the row after a sequence of pair impacts, the fastest first."""
    v = before.copy()
    for _ in range(10_000):
        approach = v[:-1] - v[1:]
        i = int(np.argmax(approach > approach.max() * (1.0 - 1e-9)))
        if approach[i] < 1e-10:
            return v
        P = (1.0 + restitution) * approach[i] / (1.0 / mass[i] + 1.0 / mass[i + 1])
        v[i] -= P / mass[i]
        v[i + 1] += P / mass[i + 1]
    raise AssertionError("no end")


@pytest.fixture(scope="module")
def five(device):
    """Five balls in contact: equal and unequal masses, with and without loss."""
    model = row_of_balls(5, envs=len(MASSES), device=device)
    for i in range(5):
        model[f"ball_{i}.mass"] = MASSES[:, i]
    for i in range(4):
        model[f"touch_{i}.law.restitution"] = RESTITUTION
    return model


@pytest.mark.parametrize("rule", RULES)
def test_both_integrators_equal_the_closed_form_of_touching_balls(five, rule):
    closed = {"simultaneous": simultaneous, "sequential": sequential}[rule]
    first = np.eye(5)[0]
    expected = np.array([closed(m, e, first) for m, e in zip(MASSES, RESTITUTION, strict=True)])
    stepped = by_steps(five, 5, rule)
    np.testing.assert_allclose(stepped[..., 0], expected, atol=1e-6)
    # Equal masses without loss, and unequal masses with loss; the event-driven reference takes seconds for each.
    for env in (0, 3):
        np.testing.assert_allclose(by_events(five, 5, rule, env=env)[:, 0], expected[env], atol=1e-8)
    np.testing.assert_allclose((MASSES * stepped[..., 0]).sum(axis=1), MASSES[:, 0], rtol=1e-12)
    energy = (MASSES * stepped[..., 0] ** 2).sum(axis=1)
    # Solved to 1e-8 in each step.
    assert (energy <= MASSES[:, 0] * (1.0 + 1e-6)).all()
    np.testing.assert_allclose(energy[RESTITUTION == 1.0], MASSES[RESTITUTION == 1.0, 0], rtol=1e-6)


def test_closed_forms_have_the_known_velocities():
    first = np.eye(5)[0]
    np.testing.assert_allclose(simultaneous(np.ones(5), 1.0, first), (-0.6, 0.4, 0.4, 0.4, 0.4), atol=1e-12)
    np.testing.assert_allclose(simultaneous(np.ones(3), 1.0, first[:3]), (-1 / 3, 2 / 3, 2 / 3), atol=1e-12)
    np.testing.assert_allclose(sequential(np.ones(5), 1.0, first), (0, 0, 0, 0, 1), atol=1e-12)


@pytest.mark.parametrize("rule", RULES)
def test_balls_apart_collide_one_after_the_other_under_both_rules(rule, device):
    model = row_of_balls(3, gap=1e-3, device=device)
    for after in (by_steps(model, 3, rule, dt=1e-4)[0], by_events(model, 3, rule)):
        np.testing.assert_allclose(after[:, 0], (0, 0, 1), atol=1e-6)


@pytest.mark.parametrize(
    ("rule", "expected"), [("simultaneous", (-1 / 3, 2 / 3, 2 / 3)), ("sequential", (0, 0, 1))]
)
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_touching_particles_equal_the_closed_form(rule, expected, precision, device):
    model = row_of_balls(3, particles=True, precision=precision, device=device)
    np.testing.assert_allclose(by_steps(model, 3, rule)[0, :, 0], expected, atol=1e-4)


def test_sequential_impacts_of_bodies_on_sliders_equal_the_closed_form(device):
    model = row_of_balls(3, motion=wc.motions.Slider(axis=(1, 0, 0)), device=device)
    np.testing.assert_allclose(by_steps(model, 3, "sequential")[0, :, 0], (0, 0, 1), atol=1e-6)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.slow
def test_both_integrators_agree_on_multiple_impacts_with_friction(rule, device):
    """A spinning ball hits two balls in contact: normal velocities follow the rule, and friction adds slip."""
    model = row_of_balls(3, mu=0.2, spin=30.0, device=device)
    stepped, exact = by_steps(model, 3, rule, dt=1e-4)[0], by_events(model, 3, rule)
    assert abs(exact[1, 2]) > 0.1
    # The spin is unchanged before the impact; contacts within a step are closed.
    np.testing.assert_allclose(stepped, exact, atol=1e-3)


@pytest.mark.parametrize("rule", RULES)
def test_body_landing_on_several_points_bounces_without_rotation(rule, device):
    """Contacts of one pair of bodies collide together, under both rules."""
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    ground = scene.add_surface(square(2.0), name="ground")
    box = scene.add_body(1.0, (0.01,) * 3, position=(0, 0, 0.06), linear_velocity=(0, 0, -1), name="ball_0")
    feet = scene.add_points(box, [(x, y, -0.05) for x in (-0.1, 0.05) for y in (-0.05, 0.1)])
    scene.add_contact(feet, ground, rigid(0.5), name="feet")
    model = scene.build(device=device, precision="float64")
    for after in (by_steps(model, 1, rule)[0], by_events(model, 1, rule)):
        np.testing.assert_allclose(after[0], (0, 0, 0.5), atol=1e-6)
    np.testing.assert_allclose(model.sensor("ball_0.angular_velocity")[0], 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("rule", "gap"),
    slow_except(
        product(RULES, (0.0, 1e-16, 5e-10)), lambda case: case in (("simultaneous", 0.0), ("sequential", 5e-10))
    ),
)
def test_body_on_a_mesh_at_gap_zero_is_closed(rule, gap, device):
    """A ball that just touches a floor is hit from above, e = 0.5: the result depends on the floor."""
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    ground = scene.add_surface(square(2.0), name="ground")
    shapes = []
    for i, (height, speed) in enumerate([(0.05 + gap, 0.0), (0.17, -1.0)]):
        body = scene.add_body(
            1.0, (1e-3,) * 3, position=(0, 0, height), linear_velocity=(0, 0, speed), name=f"ball_{i}"
        )
        shapes.append(scene.add_shape(body, wc.shapes.Sphere(0.05)))
        scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, rigid(0.5), radius=0.05, name=f"floor_{i}")
    scene.add_shape_contact(shapes[1], shapes[0], rigid(0.5), name="touch")
    model = scene.build(device=device, precision="float64")
    # The floor reacts as one body of infinite mass in the row.
    mass, before = np.array([1e9, 1.0, 1.0]), np.array([0.0, 0.0, -1.0])
    closed = {"simultaneous": simultaneous, "sequential": sequential_from_above}[rule]
    expected = closed(mass, 0.5, before)[1:]
    np.testing.assert_allclose(by_events(model, 2, rule)[:, 2], expected, atol=1e-6)
    np.testing.assert_allclose(by_steps(model, 2, rule)[0, :, 2], expected, atol=1e-6)


def sequential_from_above(mass, restitution, before):
    return -sequential(mass[::-1], restitution, -before[::-1])[::-1]


def supported_balls(count, envs, device, precision="float64"):
    """Stacked balls of 1 kg on a floor under gravity, e = 1; another ball falls from 10 mm above them at 2 m/s."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    ground = scene.add_surface(square(2.0), name="ground")
    shapes = []
    for i in range(count):
        top = {"linear_velocity": (0.0, 0.0, -2.0)} if i == count - 1 else {}
        place = (0.0, 0.0, 0.05 + 0.1 * i + (0.01 if top else 0.0))
        body = scene.add_body(1.0, (1e-3,) * 3, position=place, name=f"ball_{i}", **top)
        shapes.append(scene.add_shape(body, wc.shapes.Sphere(0.05)))
        if i == 0:
            scene.add_contact(scene.add_point(body, (0, 0, 0)), ground, rigid(1.0), radius=0.05, name="floor")
    for i in range(count - 1):
        scene.add_shape_contact(shapes[i], shapes[i + 1], rigid(1.0), name=f"touch_{i}")
    return scene.build(envs=envs, device=device, precision=precision)


def energy_above_rest(data, model, count):
    """Returns the energy (time, envs) relative to the potential energy of all balls at rest on each other."""
    total = data["scene.kinetic_energy"].values + data["scene.potential_energy"].values
    return total - sum(model[f"ball_{i}.mass"] * G * (0.05 + 0.1 * i) for i in range(count))


def test_sequential_impact_on_a_supported_ball_converges_to_the_closed_form(device):
    """The impulse of the weight does work during the impact, which restitution loses: both are of order dt."""
    top_mass = np.array([0.5, 0.1, 0.3, 0.5, 0.5])
    e = np.array([1.0, 1.0, 1.0, 0.999, 0.5])
    model = supported_balls(2, len(e), device)
    model["ball_1.mass"] = top_mass
    model["floor.law.restitution"] = model["touch_0.law.restitution"] = e
    sensors = ["ball_0.linear_velocity", "ball_1.linear_velocity"]
    sensors += ["scene.kinetic_energy", "scene.potential_energy"]
    errors = []
    for dt in (1e-3, 1e-4):
        sim = wc.Simulation(model, dt, wc.integrators.MoreauJean(impacts="sequential"))
        sim.reset()
        data = sim.run(0.01, sensors)
        lower, upper = (data[name].values[..., 2] for name in sensors[:2])
        after = int(np.argmax(upper[:, 0] > 0.0))
        speed = -upper[after - 1]
        expected = [
            sequential_from_above(np.array([1e9, 1.0, m]), one_e, np.array([0.0, 0.0, -v]))[1:]
            for m, one_e, v in zip(top_mass, e, speed, strict=True)
        ]
        found = np.stack([lower[after], upper[after]], axis=1)
        errors.append(np.abs(found - expected).max(axis=1))
        energy = energy_above_rest(data, model, 2)
        assert (energy <= energy[0] * (1.0 + 1e-6)).all()
        # The energy limit of restitution removes no more than this work.
        np.testing.assert_allclose(energy[-1, :3], energy[0, :3], rtol=1e-5)
    errors = np.array(errors)
    # Limited restitution costs up to three times the velocity of gravity in a step.
    assert (errors[0] < 3.0 * G * 1e-3).all()
    np.testing.assert_allclose(errors[0, :3] / errors[1, :3], 10.0, rtol=0.1)
    assert (errors[:, 4] < 1e-6).all()


def test_energy_of_elastic_balls_under_gravity_is_kept_by_sequential_impacts(device):
    envs, rng = 8, np.random.default_rng(5)
    model = supported_balls(4, envs, device)
    for i in range(4):
        model[f"ball_{i}.mass"] = rng.uniform(0.2, 3.0, envs)
    sim = wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(impacts="sequential"))
    data = sim.run(1.0, ["scene.kinetic_energy", "scene.potential_energy"])
    energy = energy_above_rest(data, model, 4)
    np.testing.assert_allclose(energy, np.broadcast_to(energy[0], energy.shape), rtol=1e-3)
    # A closed contact that separates with less than g h is held, which may lift each ball by as much.
    held = sum(model[f"ball_{i}.mass"] for i in range(4)) * (G * 1e-3) ** 2 / 8.0
    assert (np.diff(energy, axis=0) <= held + 1e-6 * energy[0]).all()
    assert not model.sensor("scene.solve_failures").any()


def test_unknown_impact_rule_is_refused(device):
    with pytest.raises(ValueError, match="impacts must be one of 'simultaneous', 'sequential', got 'together'"):
        wc.integrators.MoreauJean(impacts="together")
    with pytest.raises(ValueError, match="impacts must be one of"):
        wc.unilateral.EventDriven(row_of_balls(2, device=device), impacts="together")


def test_experiment_settings_select_the_impact_rule():
    from warpcontact.experiment.observation import IntegratorSettings

    assert IntegratorSettings(type="MoreauJean", impacts="sequential").make().impacts == "sequential"
