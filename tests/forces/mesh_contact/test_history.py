"""Laws and friction models with history variables: passivity, accuracy, resets and rotation of the history."""

from typing import Any

import custom_law
import numpy as np
import pytest
import warp as wp
from scenes import dropped_sphere, square
from scipy.spatial.transform import Rotation
from warpcontact.kernels.types import ENV_FROZEN

import warpcontact as wc

pytestmark = pytest.mark.usefixtures("write_step_outputs")

F = wc.friction
G = 9.81
FRICTION_WITH_HISTORY = [
    F.CundallStrack(mu_static=0.5, mu_dynamic=0.3, stiffness=1e4, damping=2.0),
    F.Mindlin(mu_static=0.5, mu_dynamic=0.3, shear_modulus=1e5, damping=2.0),
    F.Dahl(mu=0.4, stiffness=1e3),
    F.LuGre(mu_static=0.5, mu_dynamic=0.3, stribeck_speed=0.05, stiffness=1e3, damping=0.3),
    custom_law.TwoBristles(mu=0.2, stiffness=1e4),
]
LARGEST = {"CundallStrack": 0.5, "Mindlin": 0.5, "Dahl": 0.4, "LuGre": 0.5, "TwoBristles": 0.4}


def name_of(value):
    return type(value).__name__


def test_samples_cover_every_friction_model_with_history():
    assert {friction for friction in F.CATALOGUE if friction.memories} <= {
        type(friction) for friction in FRICTION_WITH_HISTORY
    }


def driven(friction, velocity, dt, device, depth=1e-3, precision="float64"):
    """Moves a sphere of large mass along ``velocity`` (steps, envs, 2), at penetration ``depth`` (steps, envs)
    [m].

    Returns F·v dt, F and N.
    """
    steps, envs = velocity.shape[:2]
    depth = np.broadcast_to(depth, (steps, envs))
    model = dropped_sphere(
        wc.laws.Hooke(stiffness=1e4), friction=friction, mass=1e9, velocity=(0, 0, 0), envs=envs, device=device,
        precision=precision,
    )  # fmt: skip
    sim = wc.Simulation(model, dt=dt)
    forces, normals = np.zeros((steps, envs, 2)), np.zeros((steps, envs))
    speed, place = np.zeros((envs, 1, 3)), np.zeros((envs, 1, 3))
    for i in range(steps):
        place[:, 0, 2] = 0.1 - depth[i]
        sim.state.body_position.assign(place.astype(precision))
        speed[:, 0, :2] = velocity[i]
        sim.state.body_linear_velocity.assign(speed.astype(precision))
        sim.step()
        # The force of the step: the history was advanced with this velocity, and the force has not changed since.
        forces[i] = model.arrays.contacts.friction_force.numpy()[:, 0, :2]
        normals[i] = model.arrays.contacts.normal_force.numpy()[:, 0]
    return np.einsum("sei,sei->se", forces, velocity) * dt, forces, normals


def random_velocities(steps, envs, seed):
    """Smooth random slip with stops, reversals and turns, from presliding to fast sliding."""
    rng = np.random.default_rng(seed)
    nodes = rng.normal(size=(steps // 25 + 2, envs, 2)) * rng.choice(
        [0.0, 0.02, 0.2, 1.0], (steps // 25 + 2, envs, 1)
    )
    at = np.arange(steps) / 25.0
    low = at.astype(int)
    share = (at - low)[:, None, None]
    return ((1 - share) * nodes[low] + share * nodes[low + 1]) * np.logspace(-2, 1, envs)[:, None]


@pytest.mark.parametrize("friction", FRICTION_WITH_HISTORY, ids=name_of)
def test_friction_with_history_stays_in_its_cone_and_is_passive(friction, device):
    velocity = random_velocities(600, 24, seed=3)
    work, forces, normals = driven(friction, velocity, 1e-3, device)
    size = np.linalg.norm(forces, axis=2)
    assert (size <= LARGEST[type(friction).__name__] * normals * (1 + 1e-12)).all()
    # The history begins at zero, so the contact never returns more energy than it received.
    given = np.cumsum(work, axis=0)
    assert (given <= 1e-12 * np.abs(given).max(axis=0)).all()
    # Springs do return energy; a pure dashpot would not.
    assert (work > 0).any(axis=0).sum() > 12


@pytest.mark.parametrize(
    "friction",
    [
        F.CundallStrack(mu_static=0.2, mu_dynamic=0.4, stiffness=1e4),
        F.Mindlin(mu_static=0.2, mu_dynamic=0.4, shear_modulus=1e5),
        F.LuGre(mu_static=0.2, mu_dynamic=0.4, stribeck_speed=0.05, stiffness=1e3),
    ],
    ids=name_of,
)
def test_dynamic_friction_above_static_friction_is_passive(friction, device):
    """The dynamic limit then also applies in stick. A spring that alternated between both would create energy."""
    work, _, _ = driven(friction, random_velocities(600, 24, seed=4), 1e-3, device)
    given = np.cumsum(work, axis=0)
    assert (given <= 1e-12 * np.abs(given).max(axis=0)).all()
    _, forces, normals = driven(friction, np.full((400, 1, 2), 1.0), 1e-3, device)
    np.testing.assert_allclose(np.linalg.norm(forces[-1], axis=1), 0.4 * normals[-1], rtol=1e-6)


@pytest.mark.parametrize("friction", FRICTION_WITH_HISTORY, ids=name_of)
def test_small_oscillation_of_slip_is_nearly_lossless(friction, device):
    """Presliding: slip below the range of the springs recovers its work on reversal."""
    amplitude, steps = 2e-6, 6000
    dt = 3 * 2 * np.pi / 100 / steps
    time = dt * np.arange(steps)
    velocity = np.zeros((steps, 1, 2))
    velocity[:, 0, 0] = amplitude * 100 * np.cos(100 * time)
    friction = {
        "CundallStrack": F.CundallStrack(mu_static=0.5, mu_dynamic=0.3, stiffness=1e4),
        "Mindlin": F.Mindlin(mu_static=0.5, mu_dynamic=0.3, shear_modulus=1e5),
        "LuGre": F.LuGre(mu_static=0.5, mu_dynamic=0.3, stribeck_speed=0.05, stiffness=1e3),
    }.get(type(friction).__name__, friction)
    work, forces, _ = driven(friction, velocity, dt, device)
    taken, given = -work[work < 0].sum(), work[work > 0].sum()
    assert given > 0.98 * taken
    # In phase with displacement: a spring, F = −k x.
    place = np.cumsum(velocity[:, 0, 0]) * dt
    stiffness = -(forces[:, 0, 0] @ place) / (place @ place)
    expected = {
        "CundallStrack": 1e4,
        "Mindlin": 8 * 1e5 * np.sqrt(0.1 * 1e-3),
        "Dahl": 1e3 * 10,
        "LuGre": 1e3 * 10,
        "TwoBristles": 1.5e4,
    }[type(friction).__name__]
    np.testing.assert_allclose(stiffness, expected, rtol=5e-3)


def test_steady_slip_has_the_dynamic_coefficient(device):
    """With μ_s as the only criterion, the slider would stick again, with a force anywhere between μ_d and μ_s."""
    velocity = np.full((400, 1, 2), 0.05)
    for friction in FRICTION_WITH_HISTORY[:2]:
        _, forces, normals = driven(friction, velocity, 1e-4, device)
        coefficient = np.linalg.norm(forces, axis=2) / normals
        start = int(np.argmax(coefficient[:, 0] == coefficient.max()))
        # The trial force at the first slip exceeded μ_s by at most the stretch of one step.
        assert 0.45 < coefficient.max() <= 0.5
        np.testing.assert_allclose(coefficient[start + 1 :], 0.3, rtol=1e-12)


def test_mindlin_spring_keeps_force_on_loading_and_stretch_on_unloading(device):
    """Mindlin: dF = 8 G* a dξ. An oscillating load adds no energy to the spring on loading or unloading."""
    friction = F.Mindlin(mu_static=10.0, mu_dynamic=10.0, shear_modulus=1e5)
    model = dropped_sphere(
        wc.laws.Hooke(stiffness=1e4), friction=friction, mass=1e9, velocity=(0, 0, 0), device=device,
        precision="float64",
    )  # fmt: skip
    sim = wc.Simulation(model, dt=1e-3)

    def go(depth, speed):
        sim.state.body_position.assign(np.array([[[0, 0, 0.1 - depth]]]))
        sim.state.body_linear_velocity.assign(np.array([[[speed, 0, 0]]], dtype=float))
        sim.step()
        return -model.arrays.contacts.friction_force.numpy()[0, 0, 0]

    go(4e-3, 0.0)
    patch = np.sqrt(0.1 * np.array([4e-3, 1e-3]))
    np.testing.assert_allclose(go(4e-3, 0.1), 8e5 * patch[0] * 1e-4)
    shallow = 8e5 * patch[1] * 1e-4
    np.testing.assert_allclose(go(1e-3, 0.0), shallow)
    np.testing.assert_allclose(go(4e-3, 0.0), shallow)
    np.testing.assert_allclose(go(4e-3, 0.1), shallow + 8e5 * patch[0] * 1e-4)


@pytest.mark.parametrize(
    "friction",
    [
        F.CundallStrack(mu_static=0.5, mu_dynamic=0.3, stiffness=1e5, damping=500.0),
        F.CundallStrack(mu_static=0.4, mu_dynamic=0.4, stiffness=1e4, damping=1e4),
        F.Mindlin(mu_static=0.5, mu_dynamic=0.4, shear_modulus=1e6, damping=500.0),
    ],
    ids=["CundallStrack", "stiff dashpot", "Mindlin"],
)
def test_friction_with_slow_dashpot_is_passive(friction, device):
    """c/k much larger than dt, slow slip after fast slip, varying load: published return maps create energy here."""
    rng = np.random.default_rng(8)
    velocity = random_velocities(600, 24, seed=9)
    velocity[:, 0] = np.tile([0.05] + [0.01] * 9, 60)[:, None] * (1.0, 0.0)
    depth = 1e-3 * (1.0 + np.cumsum(rng.normal(size=(600, 24)), axis=0) / 40.0).clip(0.2, 4.0)
    depth[:, 0] = 1e-3
    work, forces, normals = driven(friction, velocity, 1e-4, device, depth=depth)
    assert (np.linalg.norm(forces, axis=2) <= friction.mu_static * normals * (1 + 1e-12)).all()
    given = np.cumsum(work, axis=0)
    assert (given <= 1e-12 * np.abs(given).max(axis=0)).all()
    # Slip that never reverses is opposed at all times.
    assert (forces[:, 0, 0] < 0).all()


@pytest.mark.parametrize("damping", [0.0, 180.0, 500.0, 5000.0])
@pytest.mark.parametrize("speed", [2.5, 5.0])
def test_oblique_impact_in_full_slip_loses_velocity_as_coulomb(speed, damping, device):
    # FORCE_LAWS G14: v_t' = v_t − μ (1 + e) v_n while v_t ≥ (7/2) μ (1 + e) v_n; e = 1, v_n = 1, μ = 0.3.
    friction = F.CundallStrack(mu_static=0.3, mu_dynamic=0.3, stiffness=2e5 / 7, damping=damping)
    model = dropped_sphere(
        wc.laws.Hooke(stiffness=1e5), friction=friction, height=1e-4, velocity=(speed, 0, -1), kappa=0.0,
        device=device, precision="float64",
    )  # fmt: skip
    wc.Simulation(model, dt=1e-5).step(1300)
    assert model.sensor("touch.status")[0] == wc.ContactStatus.OPEN
    # Until the spring reaches its limit, its force is smaller: 3e-5 s at 5 m/s and μ N/k, of second order in its
    # range.
    np.testing.assert_allclose(model.sensor("ball.linear_velocity")[0, 0], speed - 0.6, rtol=1e-3)


def test_bristle_damping_decreases_with_speed(device):
    """LuGre: σ₁ exp(−(s/v_d)²), measured at the start of slip."""
    options = {"mu_static": 90.0, "mu_dynamic": 90.0, "stribeck_speed": 1.0, "stiffness": 1e-3, "damping": 2.0}
    speeds = np.array([[0.5, 0.0], [1.0, 0.0], [2.0, 0.0]])
    for limit, expected in ((None, 2.0 * speeds[:, 0]), (1.0, 2.0 * speeds[:, 0] * np.exp(-(speeds[:, 0] ** 2)))):
        _, forces, normals = driven(F.LuGre(**options, damping_speed=limit), speeds[None], 1e-6, device)
        np.testing.assert_allclose(-forces[0, :, 0] / normals[0], expected, rtol=1e-6)


# Laws


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_law_with_history_of_peak_penetration_has_closed_form_restitution(precision, device):
    ratio = np.array([1.0, 2.0, 4.0, 16.0])
    model = dropped_sphere(
        custom_law.Plastic(loading=1e5, unloading=1e5), height=1e-3, velocity=(0, 0, -1), envs=4, device=device,
        precision=precision,
    )  # fmt: skip
    model["touch.law.unloading"] = 1e5 * ratio
    sim = wc.Simulation(model, dt=1e-5)
    for speed in (1.0, 2.0):
        sim.state.body_linear_velocity.fill_(model.types.vec3(0.0, 0.0, -speed))
        sim.step(2000)
        # e = √(k₁/k₂). A second impact of the same bodies starts with cleared history.
        rebound = model.sensor("ball.linear_velocity")[:, 2]
        np.testing.assert_allclose(rebound, speed / np.sqrt(ratio), rtol=2e-3)
        sim.state.body_position.fill_(model.types.vec3(0.0, 0.0, 0.101))


# Resets, transfers and evaluation of the history


def pushed(friction, device, envs=3, precision="float64", **options):
    """A sphere at rest under its weight with a stretched tangential spring."""
    model = dropped_sphere(
        wc.laws.Hooke(stiffness=1e4), friction=friction, gravity=(0, 0, -G), height=-G / 1e4, velocity=(0, 0, 0),
        envs=envs, device=device, precision=precision, **options,
    )  # fmt: skip
    model["ball.inertia"] = (1e6, 1e6, 1e6)
    model["ball.linear_velocity"] = (0.05, 0.02, 0.0)
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(20)
    return model, sim


@pytest.mark.parametrize("friction", FRICTION_WITH_HISTORY, ids=name_of)
def test_sensor_evaluation_does_not_advance_history(friction, device):
    model, sim = pushed(friction, device)
    other, twin = pushed(friction, device)
    first = model.sensor("touch.friction_force")
    assert np.linalg.norm(first[0]) > 0.1
    for _ in range(3):
        np.testing.assert_array_equal(model.sensor("touch.friction_force"), first)
    sim.step(10)
    twin.step(10)
    np.testing.assert_array_equal(model.sensor("ball.position"), other.sensor("ball.position"))


@pytest.mark.parametrize("friction", FRICTION_WITH_HISTORY, ids=name_of)
def test_sensor_value_is_the_force_of_the_next_step(friction, device):
    """Also directly after the first contact, because the history stores the time since it was advanced."""
    model = dropped_sphere(
        wc.laws.Hooke(stiffness=1e4), friction=friction, height=1e-4, velocity=(0.3, 0.1, -1), envs=2,
        device=device, precision="float64",
    )  # fmt: skip
    sim = wc.Simulation(model, dt=1e-4)
    touched = 0
    for _ in range(12):
        predicted = model.sensor("touch.friction_force")
        sim.step()
        acted = model.arrays.contacts.friction_force.numpy()[:, 0]
        # The impulse missed at the first contact is included to 1e-6 of the penetration, also if none was missed.
        np.testing.assert_allclose(acted, predicted, rtol=1e-6)
        touched += bool(np.abs(acted).max() > 0)
    assert touched > 8


def test_history_starts_at_the_instant_of_contact(device):
    """If a contact is detected 0.3 steps after it began, its spring is stretched by 0.3 steps."""
    friction = F.CundallStrack(mu_static=10.0, mu_dynamic=10.0, stiffness=1e4)
    model = dropped_sphere(
        wc.laws.Hooke(stiffness=1e4), friction=friction, height=0.7e-4, velocity=(0.3, 0, -1), device=device,
        precision="float64",
    )  # fmt: skip
    model["ball.inertia"] = (1e6, 1e6, 1e6)
    wc.Simulation(model, dt=1e-4).step()
    np.testing.assert_allclose(model.sensor("touch.friction_force")[0], (-1e4 * 0.3 * 0.3e-4, 0, 0), rtol=1e-6)


@pytest.mark.parametrize("friction", FRICTION_WITH_HISTORY, ids=name_of)
def test_reset_clears_history_of_masked_environments(friction, device):
    model, sim = pushed(friction, device)
    start, _ = pushed(friction, device)
    start.reset()
    before = model.sensor("touch.friction_force")
    model.reset(np.array([False, True, False]))
    after = model.sensor("touch.friction_force")
    np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])
    np.testing.assert_array_equal(after[1], start.sensor("touch.friction_force")[1])
    # From there the run repeats that from the start.
    sim.reset()
    sim.step(20)
    np.testing.assert_array_equal(model.sensor("touch.friction_force"), before)


@pytest.mark.parametrize("friction", FRICTION_WITH_HISTORY, ids=name_of)
def test_history_is_cleared_when_the_contact_ends(friction, device):
    model, sim = pushed(friction, device)
    held = sim.state.body_position.numpy().copy()
    sim.state.body_position.fill_(model.types.vec3(0.0, 0.0, 1.0))
    sim.step()
    sim.state.body_position.assign(held)
    sim.state.body_linear_velocity.fill_(model.types.vec3(0.0, 0.0, 0.0))
    # Except for the spin that friction caused.
    np.testing.assert_allclose(model.sensor("touch.friction_force"), 0.0, atol=1e-9)
    assert (model.sensor("touch.normal_force") > 1.0).all()


def test_history_of_frozen_environment_is_unchanged(device):
    model, sim = pushed(FRICTION_WITH_HISTORY[0], device)
    status = model.arrays.status.numpy().copy()
    status[1] = ENV_FROZEN
    model.arrays.status.assign(status)
    ((_, memory, kept),) = model.groups[0].histories()
    before = memory.numpy().copy(), kept.numpy().copy()
    sim.step(3)
    for array, old in zip((memory, kept), before, strict=True):
        np.testing.assert_array_equal(array.numpy()[1], old[1])
        assert not np.array_equal(array.numpy()[0], old[0])
    model.evaluate()
    np.testing.assert_array_equal(memory.numpy()[1], before[0][1])


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize(
    "friction", [FRICTION_WITH_HISTORY[0], FRICTION_WITH_HISTORY[3], FRICTION_WITH_HISTORY[4]], ids=name_of
)
def test_history_vectors_rotate_with_the_bodies(friction, precision, device):
    """Two bodies that rotate together: the force of a stretched spring rotates with them, about any axis."""
    scene = wc.Scene(gravity=(0, 0, 0))
    carrier = scene.add_body(1e15, (1e15, 1e15, 1e15), name="carrier")
    plate = scene.add_surface(square(), carrier, orientation=(0.5, 0.5, 0.5, 0.5))
    rider = scene.add_body(1e15, (1e15, 1e15, 1e15), name="rider")
    scene.add_contact(
        scene.add_point(rider, (0, 0, 0)), plate, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4), friction=friction),
        name="touch",
    )  # fmt: skip
    model = scene.build(device=device, precision=precision)
    normal = Rotation.from_quat((0.5, 0.5, 0.5, 0.5)).apply((0, 0, 1))
    at = Rotation.from_quat((0.5, 0.5, 0.5, 0.5)).apply((0.3, 0.2, -1e-3))
    model["rider.position"] = at
    slide = 0.002 * Rotation.from_quat((0.5, 0.5, 0.5, 0.5)).apply((1.0, -0.5, 0))
    model["rider.linear_velocity"] = slide
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(50)
    at = model.sensor("rider.position")[0]
    spin = np.array([1.0, -2.0, 1.5])

    def ride():
        """Places the rider on the rotated carrier, with the carrier's velocity there."""
        turned = Rotation.from_quat(model.sensor("carrier.orientation")[0])
        place = turned.apply(at)
        sim.state.body_position.assign(np.array([[np.zeros(3), place]]).astype(precision))
        sim.state.body_linear_velocity.assign(np.array([[np.zeros(3), np.cross(spin, place)]]).astype(precision))
        sim.state.body_angular_velocity.fill_(model.types.vec3(*spin))
        return turned

    ride()
    force = model.sensor("touch.friction_force")[0]
    assert np.linalg.norm(force) > 0.5
    for _ in range(1000):
        turned = ride()
        sim.step()
    acted = model.arrays.contacts.friction_force.numpy()[0, 0]
    # In float32, the rounded velocities of the two bodies give a small slip that accumulates.
    tolerance = 1e-9 if precision == "float64" else 2e-3
    np.testing.assert_allclose(acted, turned.apply(force), atol=tolerance * np.linalg.norm(force))
    np.testing.assert_allclose(acted @ turned.apply(normal), 0.0, atol=1e-5 * np.linalg.norm(force))


# Declarations


ADVANCE, FORCE = custom_law.TwoBristles.advance, custom_law.Viscous.force


@wp.func
def without_return(p: Any, s: Any, m: Any):
    m.spring = m.spring + m.elapsed * s.velocity


@wp.func
def spring_force(p: Any, s: Any, m: Any):
    return -m.spring


MISTAKES = [
    (
        {"spring": wc.history("m", "", tangent=True), "force": spring_force},
        r"Wrong\.advance must be a wp\.func of \(coeff",
    ),
    ({"advance": ADVANCE, "force": FORCE}, r"Wrong\.advance has nothing to advance"),
    (
        {"spring": wc.history("m", ""), "force": FORCE},
        r"Wrong\.force must take 3 arguments, \(coefficients, state, his",
    ),
    (
        {"spring": wc.history("m", ""), "advance": without_return, "force": spring_force},
        r"Wrong\.advance returns nothing; .*return m",
    ),
    ({"elapsed": wc.history("s", "")}, r"Wrong\.elapsed must have another name"),
    (
        {"a": wc.history("m", ""), "__annotations__": {"a": float}},
        r"Wrong\.a must not be a parameter and a history variable",
    ),
    ({"drag": wc.history("m", "")}, r"Wrong\.drag must not be a parameter and a history variable"),
]


@pytest.mark.parametrize(("body", "message"), MISTAKES)
def test_invalid_history_declaration_is_explained(body, message):
    base = F.Viscous if "drag" in body else wc.Friction
    with pytest.raises(TypeError, match=message):
        type("Wrong", (base,), body)()


def test_history_variable_can_be_inherited_from_a_mixin(device):
    class Spring:
        spring = wc.history("m", "stretch", tangent=True)

    class Mixed(Spring, wc.Friction):
        """With the history of another class."""

        advance = custom_law.Sprung.advance
        force = custom_law.Sprung.force

    assert list(Mixed.memories) == ["spring"]
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), friction=Mixed(), height=-1e-3, device=device)
    assert model.sensor("touch.friction.spring").shape == (1, 3)


def test_law_with_tangent_history_is_refused():
    with pytest.raises(TypeError, match=r"Sideways\.drift: a law acts along the normal"):

        class Sideways(wc.Law):
            """Stores a direction in its history."""

            drift = wc.history("m", "drift", tangent=True)


def test_history_of_a_contact_set_has_item_axis(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    ground = scene.add_surface(square())
    body = scene.add_body(1e15, (1e15, 1e15, 1e15), linear_velocity=(0, 0.1, 0), name="body")
    feet = scene.add_points(body, [(x, 0, -1e-3) for x in (-0.1, 0.0, 0.1)])
    plain = scene.add_point(body, (0, 0.2, -1e-3))
    for points, friction, name in ((plain, F.Tanh(mu=0.1), "plain"), (feet, FRICTION_WITH_HISTORY[0], "feet")):
        scene.add_contact(
            points, ground, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4), friction=friction), name=name
        )
    model = scene.build(envs=2, device=device)
    sim = wc.Simulation(model, dt=1e-4)
    recording = sim.run(1e-3, ["feet.friction.spring", "feet.friction.sliding"])
    assert recording["feet.friction.spring"].dims == ("time", "env", "item", "axis")
    np.testing.assert_allclose(recording["feet.friction.spring"][-1, 1, :, 1], 0.1 * 9e-4, rtol=1e-5)
    assert recording["feet.friction.sliding"].dims == ("time", "env", "item")
    assert recording["feet.friction.spring"].attrs["units"] == "m"
