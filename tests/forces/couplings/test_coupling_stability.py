"""Warnings about time steps that are unstable for couplings: closed forms, and runs on both sides of the limit."""

import itertools

import numpy as np
import pytest

import warpcontact as wc
from warpcontact.forces.couplings.coupling_rows import coupling_rows
from warpcontact.scene.mobility import inverse_mass

DT = 1.0e-3
BASE_MASS, PAD_MASS = 1.5, 0.2
BASE_INERTIA, PAD_INERTIA = np.array([3.0e-3, 4.0e-3, 5.0e-3]), np.array([1.2e-5, 1.6e-5, 2.0e-5])
BASE_ARM, PAD_ARM = np.array([0.03, -0.02, 0.05]), np.array([0.006, 0.004, -0.003])
# 90° about z: the axes x, y and z of the bushing in the world.
TURNED, AXES = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)), np.array([(0, 1, 0), (-1, 0, 0), (0, 0, 1.0)])
EULER, MIDDLE, END = (
    wc.integrators.SemiImplicitEuler(),
    wc.integrators.MoreauJean(),
    wc.integrators.MoreauJean(theta=1.0),
)


def mobilities():
    """Mobility along and about the axes of the bushing, (6,): of both bodies, with their lever arms."""
    along = 1.0 / BASE_MASS + 1.0 / PAD_MASS
    linear = [
        along
        + (np.cross(BASE_ARM, axis) ** 2 / BASE_INERTIA).sum()
        + (np.cross(PAD_ARM, axis) ** 2 / PAD_INERTIA).sum()
        for axis in AXES
    ]
    return np.array([*linear, *(AXES**2 @ (1.0 / BASE_INERTIA + 1.0 / PAD_INERTIA))])


def cases(theta):
    """Stiffness and damping (cases, 6) of a bushing at its limit: 2 θ h² k w + 2 h c w = 4, in one direction each."""
    rows = []
    for direction, part in itertools.product(range(6), (1.0, 0.5, 0.0)):
        row = np.zeros((2, 6))
        w = mobilities()[direction]
        row[:, direction] = part * 4.0 / (2.0 * theta * DT**2 * w), (1.0 - part) * 4.0 / (2.0 * DT * w)
        rows.append(row)
    return np.array(rows)[:, 0], np.array(rows)[:, 1]


def pad_on_bushing(envs, device):
    scene = wc.Scene(gravity=(0, 0, 0))
    base = scene.add_body(BASE_MASS, BASE_INERTIA, name="base")
    pad = scene.add_body(PAD_MASS, PAD_INERTIA, BASE_ARM - PAD_ARM, name="pad")
    ends = scene.add_point(base, BASE_ARM), scene.add_point(pad, PAD_ARM)
    scene.add_bushing(*ends, stiffness=(0, 0, 0), orientation=TURNED, name="bushing")
    model = scene.build(envs, device, "float64")
    # So slow that all rotations stay small, even if they grow.
    model["pad.linear_velocity"] = 1.0e-12 * np.array([1.0, 2.0, 3.0])
    model["pad.angular_velocity"] = 1.0e-11 * np.array([3.0, 1.0, 2.0])
    return model


def set_bushing(model, stiffness, damping):
    """Sets stiffness and damping (…, 6) of the bushing."""
    for key, values in (("stiffness", stiffness), ("damping", damping)):
        model[f"bushing.{key}"], model[f"bushing.turn_{key}"] = values[..., :3], values[..., 3:]


def unstable(sim):
    """The sentences of the check about instability."""
    return [sentence for sentence in sim.check() if "unstable" in sentence]


@pytest.mark.parametrize(("integrator", "theta"), [(EULER, 0.5), (MIDDLE, 0.5), (END, 1.0)])
def test_bushing_grows_beyond_its_limit_only(integrator, theta, device):
    stiffness, damping = cases(theta)
    # A step that is s times longer equals s² times the stiffness and s times the damping.
    scales = np.repeat([0.9, 1.1], len(stiffness))[:, None]
    stiffness, damping = np.tile(stiffness, (2, 1)) * scales**2, np.tile(damping, (2, 1)) * scales
    model = pad_on_bushing(len(scales), device)
    set_bushing(model, stiffness, damping)
    with pytest.warns(wc.ContactWarning, match="unstable"):
        run = wc.Simulation(model, DT, integrator=integrator).run(
            25 * DT, ["bushing.force", "bushing.torque"], every=DT
        )
    # Only the direction of the environment has a force or a torque.
    size = sum(np.abs(run[f"bushing.{key}"].values).sum(axis=2) for key in ("force", "torque"))
    growth = size[-6:].max(axis=0) / size[:6].max(axis=0)
    below, above = np.split(growth, 2)
    # Oscillations below the limit keep their amplitude, which six steps sample to less than a factor of 2. The slowest
    # growth above it, of a damper, is (2.2 − 1)²⁰ = 38.
    assert (below < 2.0).all(), below
    assert (above > 20.0).all(), above


@pytest.mark.parametrize(("integrator", "theta"), [(EULER, 0.5), (MIDDLE, 0.5), (END, 1.0)])
def test_unstable_bushing_is_reported_beyond_its_limit_only(integrator, theta, device):
    model = pad_on_bushing(2, device)
    sim = wc.Simulation(model, DT, integrator=integrator)
    for stiffness, damping in zip(*cases(theta), strict=True):
        for scale, expected in ((0.9, False), (1.1, True)):
            # In the second environment.
            set_bushing(model, np.outer((0.0, scale**2), stiffness), np.outer((0.0, scale), damping))
            found = unstable(sim)
            assert bool(found) == expected, (stiffness, damping, scale)
        assert found[0].startswith("bushing: dt = 0.001 s is unstable")
        # The limit in the message: 1 ms / 1.1, to two digits.
        assert "dt < 0.00091 s in environment 1" in found[0]
    model["bushing.enabled"] = 0
    assert unstable(sim) == []


def test_accuracy_of_a_bushing_is_checked_in_each_direction(device):
    model = pad_on_bushing(2, device)
    sim = wc.Simulation(model, DT)
    for direction, name in enumerate(("along x", "along y", "along z", "about x", "about y", "about z")):
        w = mobilities()[direction]
        row = np.eye(6)[direction]
        # 20 steps per period: ω = 2π/(20 dt).
        for scale, count in ((0.98, 0), (1.02, 1)):
            set_bushing(model, scale * (2.0 * np.pi / (20.0 * DT)) ** 2 / w * row, 0.0 * row)
            assert len(sim.check()) == count
        assert sim.check()[0].startswith(f"bushing, {name}: dt = 0.001 s is too long: a period is")
        for scale, count in ((0.98, 0), (1.02, 1)):
            set_bushing(model, 0.0 * row, scale / (DT * w) * row)
            assert len(sim.check()) == count
        assert sim.check()[0].startswith(f"bushing, {name}: dt = 0.001 s is too long for its damping")


def test_couplings_of_a_body_add_up(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    block = scene.add_body(2.0, (0.1, 0.1, 0.1), name="block")
    center = scene.add_point(block, (0, 0, 0))
    scene.add_bushing(scene.add_point(None, (0, 0, 0)), center, stiffness=(0, 0, 1.0), name="bushing")
    for number, height in enumerate((-1.0, 1.0)):
        scene.add_spring_damper(
            scene.add_point(None, (0, 0, height)), center, stiffness=1.0, damping=0.0, name=f"spring_{number}"
        )
    model = scene.build(1, device, "float64")
    # Alone, each has a third of the limit 4 m/dt², and together they have 0.81 and 1.21 of it.
    for scale, expected in ((0.9, 0), (1.1, 1)):
        share = scale**2 * 4.0 * 2.0 / DT**2 / 3.0
        model["bushing.stiffness"] = (0, 0, share)
        model["spring_0.stiffness"] = model["spring_1.stiffness"] = share
        found = unstable(wc.Simulation(model, DT))
        assert len(found) == expected
    assert found[0].startswith("bushing, spring_0, spring_1: ")
    model["spring_1.enabled"] = 0
    assert unstable(wc.Simulation(model, DT)) == []


def test_chain_of_bodies_has_the_limit_of_its_fastest_mode(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    upper, lower = (scene.add_body(1.0, (0.1, 0.1, 0.1), (0, 0, -z), name=f"body_{z}") for z in (1, 2))
    ends = [scene.add_point(body, (0, 0, 0)) for body in (None, upper, lower)]
    for number, pair in enumerate(itertools.pairwise(ends)):
        scene.add_spring_damper(*pair, stiffness=1.0, name=f"spring_{number}")
    model = scene.build(2, device, "float64")
    # Eigenvalues of the stiffness matrix ((2, −1), (−1, 1)) are (3 ± √5)/2.
    limit = 4.0 / ((3.0 + np.sqrt(5.0)) / 2.0) / DT**2
    for scale, expected in ((0.99, 0), (1.01, 1)):
        for number in (0, 1):
            model[f"spring_{number}.stiffness"] = [0.1 * limit, scale**2 * limit]
        assert len(unstable(wc.Simulation(model, DT))) == expected


def test_largest_slope_of_a_table_decides(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    block = scene.add_body(1.0, (0.1, 0.1, 0.1), (0, 0, -1.0), name="block")
    # A stop: steep from 1.2 m on, away from the initial length of 1 m.
    stop = wc.springs.ForceTable(table=[(0.8, -20.0), (1.2, 20.0), (1.3, 20.0 + 0.1 * 1.0e6)])
    scene.add_spring_damper(
        scene.add_point(None, (0, 0, 0)), scene.add_point(block, (0, 0, 0)), spring=stop, name="spring"
    )
    model = scene.build(1, device, "float64")
    for scale, expected in ((0.9, 0), (1.1, 1)):
        # Limit: 2 √(m/k) = 2 ms.
        sim = wc.Simulation(model, scale * 2.0e-3)
        assert [sentence.partition(":")[0] for sentence in sim.check()] == ["spring"] * expected


@pytest.mark.parametrize(
    ("motion", "mobility"),
    [
        (wc.motions.Slider(axis=(0.6, 0, 0.8)), 0.64 / 2.0),
        # About the anchor: 0.1 + 2·0.5² = 0.6 kg·m², and the bushing is 1 m away from it.
        (wc.motions.Hinge(axis=(0, 1, 0), anchor=(-0.5, 0, 0)), 1.0 / 0.6),
        (wc.motions.Fixed(), 0.0),
    ],
)
def test_limit_includes_the_joint_of_a_body(motion, mobility, device):
    scene = wc.Scene(gravity=(0, 0, 0))
    rod = scene.add_body(2.0, (0.1, 0.1, 0.1), motion=motion, name="rod")
    ends = scene.add_point(None, (0.5, 0, 0)), scene.add_point(rod, (0.5, 0, 0))
    scene.add_bushing(*ends, stiffness=(0, 0, 1.0e6), name="bushing")
    model = scene.build(1, device, "float64")
    for scale in (0.9, 1.1):
        dt = scale * 2.0 / np.sqrt(1.0e6 * mobility) if mobility else 1.0
        assert bool(unstable(wc.Simulation(model, dt))) == (scale > 1.0 and mobility > 0.0)


def test_limit_of_random_couplings_matches_a_dense_eigenvalue_problem(device):
    rng = np.random.default_rng(3)
    scene = wc.Scene(gravity=(0, 0, 0))
    bodies = [
        scene.add_body(mass, mass * np.array([0.02, 0.03, 0.04]), rng.normal(size=3), name=f"body_{number}")
        for number, mass in enumerate(rng.uniform(0.1, 3.0, 8))
    ]
    for number in range(20):
        one, other = rng.choice(len(bodies), 2, replace=False)
        ends = [
            scene.add_point(None if is_world else bodies[body], rng.normal(size=3))
            for body, is_world in ((one, number % 5 == 0), (other, False))
        ]
        k, c = rng.uniform(1.0e3, 1.0e4), rng.uniform(0.0, 10.0)
        if number % 2:
            scene.add_spring_damper(*ends, stiffness=k, damping=c)
        else:
            turning = {"turn_stiffness": rng.uniform(0.0, 100.0, 3), "turn_damping": rng.uniform(0.0, 0.1, 3)}
            scene.add_bushing(*ends, stiffness=k * rng.random(3), damping=c * rng.random(3), **turning)
    model = scene.build(3, device, "float64")
    for body in bodies:
        model[f"{body.name}.mass"] = body.mass * rng.uniform(0.5, 2.0, 3)
    limits = dense_limits(model, bodies)
    worst = int(np.argmin(limits))
    for scale, expected in ((0.99, 0), (1.01, 1), (3.0, 1)):
        found = unstable(wc.Simulation(model, scale * limits[worst]))
        assert len(found) == expected
    assert f"dt < {limits[worst]:.2g} s in environment {worst}" in found[0]


def dense_limits(model, bodies):
    """Longest stable step of each environment: 1/h is an eigenvalue of the quadratic problem 4 M/h² − 2 C/h − K."""
    rows = [coupling_rows(model, one) for one in model.scene.couplings]
    limits = []
    for env in range(model.envs):
        size = 6 * len(bodies)
        inverse, stiffness, damping = np.zeros((3, size, size))
        for body in bodies:
            own = slice(6 * body.index, 6 * body.index + 6)
            inverse[own, own] = inverse_mass(model, body)[env]
        for one in rows:
            jacobian = np.zeros((one.count, size))
            for body, part in zip(one.bodies, one.jacobians, strict=True):
                if body is not None:
                    jacobian[:, 6 * body.index : 6 * body.index + 6] += part[env]
            stiffness += jacobian.T @ (one.stiffness[env][:, None] * jacobian)
            damping += jacobian.T @ (one.damping[env][:, None] * jacobian)
        companion = np.block(
            [[0.5 * inverse @ damping, 0.25 * inverse @ stiffness], [np.eye(size), 0.0 * inverse]]
        )
        limits.append(1.0 / np.linalg.eigvals(companion).real.max())
    return np.array(limits)
