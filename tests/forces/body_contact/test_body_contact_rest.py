"""Bodies at rest under compliant body contact: parts of any shape, stacks, a pyramid and an arch.

After they have settled they do not move, with heights and reactions in closed form, and a push holds below the limit of friction
only. Slow tests cover a minute.
"""

import numpy as np
import pytest
import resting_scenes as scenes
from part_meshes import random_hull
from resting_scenes import GRAVITY, HALF, RADIUS, SIDE, Rest, push
from scipy.optimize import brentq, root
from scipy.spatial import ConvexHull, HalfspaceIntersection
from scipy.spatial.transform import Rotation

import warpcontact as wc

MU = 0.5
DEPTH = 2e-4  # m, of parts at rest
STICK = 2e4  # N/m, of friction; low, because steps must be short for its damping where a body has several contacts
#: Fractions of a push, as it grows without exciting vibrations.
RAMP = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, 101) / 100)

CASES = ("floor", "precision", "seconds")
SHORT = [("half-space", "float64", 0.5), ("mesh", "float32", 0.5)]
LONG = [
    pytest.param("mesh", "float64", 60.0, marks=pytest.mark.slow),
    pytest.param("half-space", "float32", 60.0, marks=pytest.mark.slow),
]
durations = pytest.mark.parametrize(CASES, SHORT + LONG)


def foundation(stiffness, *, damping=50.0, stick=STICK, mass=1.0, overshoot=0.01, mu=MU):
    """Returns a material of ``stiffness`` [Pa/m] whose friction is damped for a slip that moves ``mass`` [kg]."""
    friction = wc.friction.CundallStrack.from_overshoot(
        mu_static=mu, mu_dynamic=mu, stiffness=stick, mass=mass, overshoot=overshoot
    )
    law = wc.laws.ElasticFoundation(stiffness=stiffness, damping=damping)
    return wc.ContactMaterial(law=law, friction=friction)


def heights(model, names):
    """Returns the heights of bodies [m], (bodies, envs)."""
    return np.array([model.sensor(f"{name}.position")[:, 2] for name in names], dtype=float)


def reactions(model, names):
    """Returns the vertical forces of contacts [N], (contacts, envs)."""
    return np.array([model.sensor(f"{name}.force")[:, 2] for name in names], dtype=float)


def submerged(vertices, floor):
    """Returns volume [m³] and center [m] of the part of a convex hull below z = 0; on a mesh, of that below its section there."""
    below, above = vertices[vertices[:, 2] <= 0], vertices[vertices[:, 2] > 0]
    # All segments from below to above, whose crossings have the section as their hull.
    fraction = below[:, None, 2] / (below[:, None, 2] - above[None, :, 2])
    crossings = (below[:, None] + fraction[..., None] * (above[None] - below[:, None])).reshape(-1, 3)
    # The hull is thin: it is computed with its height scaled to its width.
    scale = np.array([1.0, 1.0, SIDE / -below[:, 2].min()])
    hull = ConvexHull(np.concatenate([below, crossings]) * scale)
    if floor == "mesh":
        walls = np.insert(ConvexHull(crossings[:, :2]).equations, 2, 0.0, axis=1)
        inside = np.array([*crossings[:, :2].mean(axis=0), -0.1 * SIDE])
        hull = ConvexHull(HalfspaceIntersection(np.concatenate([hull.equations, walls]), inside).intersections)
    # Tetrahedra from a point inside to the faces; their volumes are positive.
    apex = hull.points.mean(axis=0)
    corners = hull.points[hull.simplices] - apex
    volumes = np.abs(np.linalg.det(corners)) / 6
    center = apex + (volumes @ corners.sum(axis=1)) / 4 / volumes.sum()
    return volumes.sum() / scale.prod(), center / scale


def floating_depth(mesh, stiffness, weight, floor):
    """Returns the depth at which a convex body floats: its weight is ``stiffness`` times the volume below z = 0 [m]."""
    lowest = mesh.vertices[:, 2].min()

    def residual(x):
        # Depth in µm, and two tilts in µrad.
        turned = Rotation.from_rotvec(1e-6 * np.array([x[1], x[2], 0.0])).apply(np.array(mesh.vertices))
        volume, center = submerged(turned - [0, 0, lowest + 1e-6 * x[0]], floor)
        return [stiffness * volume / weight - 1, *(center[:2] / SIDE)]

    base = (mesh.vertices[:, 2] < lowest + 1e-9).sum()
    assert base >= 3
    found = root(residual, [1e6 * DEPTH, 0.0, 0.0], tol=1e-12)
    assert np.abs(found.fun).max() < 1e-9
    return 1e-6 * found.x[0]


def segment(depth):
    """Returns the area of a circle of ``RADIUS`` below a chord at ``depth`` [m²]."""
    height = RADIUS - depth
    return RADIUS**2 * np.arccos(height / RADIUS) - height * np.sqrt(RADIUS**2 - height**2)


def foundations(floor):
    """Returns stiffness [Pa/m], depth at rest and its tolerance [m] of each part on its own foundation.

    Parts with a flat base are ``DEPTH`` deep, the hull nearly so.
    """
    slope = RADIUS / scenes.CONE_HEIGHT
    _, _, base = random_hull(SIDE / 2, seed=5)
    volumes = {
        "cube": SIDE**2 * DEPTH,
        "standing": np.pi * RADIUS**2 * DEPTH,
        "ell": SIDE**2 * 5 / 9 * DEPTH,
        "bracket": 2 * 0.03 * 0.08 * DEPTH,
        # Columns on a face stand on the section of a cone with it, which is smaller than its base.
        "cone": np.pi * (RADIUS - slope * DEPTH) ** 2 * DEPTH
        if floor == "mesh"
        else np.pi / (3 * slope) * (RADIUS**3 - (RADIUS - slope * DEPTH) ** 3),
    }
    found = {name: (GRAVITY / volume, DEPTH, 1e-9) for name, volume in volumes.items()}
    # Quadrature errors of curved surfaces are below 1e-4 of the force, which grows with the depth or faster.
    found["cone"] = (found["cone"][0], DEPTH, 1e-4 * DEPTH)
    # Faces next to the base of the hull enlarge its area.
    stiffness = GRAVITY / (1.5 * 0.5 * abs(np.linalg.det(base[1:] - base[0])) * DEPTH)
    hull = scenes.parts()["hull"].solid
    found["hull"] = (stiffness, floating_depth(hull, stiffness, GRAVITY, floor), 1e-9)
    # Deeper: their area of contact is a part of the area below them.
    volume = 2 * RADIUS * 2 * HALF * DEPTH
    for name, caps in (("lying", 0.0), ("capsule", 1.0)):

        def excess(depth, caps=caps):
            return 2 * HALF * segment(depth) + caps * np.pi * depth**2 * (RADIUS - depth / 3) - volume

        depth = brentq(excess, 0, RADIUS, xtol=1e-15)
        found[name] = (GRAVITY / volume, depth, 1e-4 * depth)
    return found


def push_gradually(sim, pushes, seconds):
    """Lets pushes grow as ``RAMP``.

    Args:
        sim: The simulation.
        pushes: Body name, force by environment [N], and arm below the center [m].
        seconds: Duration [s].
    """
    for fraction in RAMP:
        for name, force, arm in pushes:
            push(sim.model, name, fraction * force, arm)
        sim.step(round(seconds / len(RAMP) / sim.dt))


def check_slide(speed, use, stretch, mu, ramp, seconds):
    """Checks the speed of a body after a push above the limit of friction.

    Args:
        speed: Speed [m/s].
        use: Force of friction that the push needs, over its limit, above 1.
        stretch: Displacement by springs at the limit [m].
        mu: Coefficient of friction.
        ramp: Time in which the push grows as ``RAMP`` [s].
        seconds: Time since then [s].
    """
    excess = use * RAMP - 1
    gained = mu * GRAVITY * (np.maximum(excess, 0).mean() * ramp + excess[-1] * seconds)
    # Before it slides, it moves as springs are stretched, at most as fast as in the middle of the ramp.
    rates = np.diff(use * RAMP) * len(RAMP) / ramp
    low, high = gained + stretch * rates[np.argmax(excess > 0) - 1], gained + stretch * rates.max()
    # The face leans back and forth as the body begins to slide.
    assert 0.995 * low < speed < 1.005 * high


@durations
def test_parts_of_any_shape_rest_and_hold_a_push(floor, precision, seconds, device):
    dt, ramp = 4e-4, 0.4
    factors = np.array([0.0, 0.98, 1.02])
    expected = foundations(floor)
    names = list(expected)
    scene = scenes.parts_on_floor(floor, lambda name: foundation(expected[name][0], overshoot=0.1), names)
    model = scene.build(envs=len(factors), device=device, precision=precision)
    sim = wc.Simulation(model, dt=dt)
    assert sim.check() == []
    sim.step(round(1.0 / dt))
    before = Rest(model, scene.bodies)
    # Pushes act at the height of the contact, so that they do not tip.
    arms = heights(model, names) - [model.sensor(f"{name}_touch.center")[:, 2] for name in names]
    pushes = [(name, factors * MU * GRAVITY, arm[0]) for name, arm in zip(names, arms, strict=True)]
    push_gradually(sim, pushes, ramp)
    sim.step(round(0.5 / dt))
    np.testing.assert_allclose(reactions(model, [f"{name}_touch" for name in names]), GRAVITY, rtol=2e-6)
    for name, force, arm in pushes:
        part, (_, depth, tolerance) = scenes.parts()[name], expected[name]
        if precision == "float32":
            tolerance += 1e-7 * part.height  # rounding
        position, start = model.sensor(f"{name}.position").astype(float), before.start[name][0]
        assert position[0, 2] == pytest.approx(part.height - depth, abs=tolerance), name
        # The stretch of the spring.
        moved = (position - start)[:, 0]
        assert moved[1] == pytest.approx(force[1] / STICK, rel=1e-3), name
        speed = model.sensor(f"{name}.linear_velocity")[2, 0]
        check_slide(speed, factors[2], MU * GRAVITY / STICK, MU, ramp, 0.5)
        push(model, name, np.array([0.0, force[1], 0.0]), arm)
    sim.step(round(0.5 / dt))
    rest = Rest(model, scene.bodies)
    sim.step(round(seconds / dt))
    rest.check()


def settle(sim, seconds):
    """Steps with kinetic damping: bodies of an environment are stopped whenever its kinetic energy has decreased."""
    model = sim.model
    last = np.zeros(model.envs)
    for _ in range(round(seconds / sim.dt / 10)):
        sim.step(10)
        energy = model.sensor("scene.kinetic_energy").reshape(-1)
        stopped = energy < last
        last = np.where(stopped, 0.0, energy)
        for array in (model.state.body_linear_velocity, model.state.body_angular_velocity):
            values = array.numpy()
            values[stopped] = 0.0
            array.assign(values)


@durations
def test_stacks_of_ten_boxes_rest(floor, precision, seconds, device):
    """Aligned, offset, turned and unequal boxes; see ``scenes.vary_stacks``."""
    # Large boxes, because steps can be longer at the same ratio of depth and size; a soft tower of ten would buckle.
    side, count, stiffness, dt = 1.0, 10, 5e4, 4e-4
    scene = scenes.tower(
        count, floor, lambda name: foundation(stiffness, damping=6.0, stick=2e3, mass=0.25), side=side
    )
    model = scene.build(envs=len(scenes.STACKS), device=device, precision=precision)
    sides, masses, turns = scenes.vary_stacks(model, count, side=side, offset=0.02)
    model.reset()
    sim = wc.Simulation(model, dt=dt)
    assert sim.check() == []
    settle(sim, 5.0)
    sim.step(round(0.2 / dt))
    rest = Rest(model, scene.bodies)
    sim.step(round(seconds / dt))
    rest.check()
    names = [f"box_{i}" for i in range(count)]
    touches = [f"{name}_on" for name in names]
    carried = np.cumsum(masses[::-1], axis=0)[::-1] * GRAVITY
    np.testing.assert_allclose(reactions(model, touches), carried, rtol=2e-6)
    # The center of pressure is below the center of mass of all boxes above it. Swaying at 1e-6 m/s with 4 rad/s, 10 m high, moves it.
    places = np.array([model.sensor(f"{name}.position")[:, :2] for name in names], dtype=float)
    moments = np.cumsum((masses[..., None] * places)[::-1], axis=0)[::-1] * GRAVITY
    centers = np.array([model.sensor(f"{touch}.center")[:, :2] for touch in touches])
    np.testing.assert_allclose(centers, moments / carried[..., None], atol=4e-6)
    # Heights of all but the offset boxes, which lean.
    areas = np.minimum(sides, np.concatenate([sides[:1], sides[:-1]])) ** 2
    areas[1:, 2] = scenes.overlap_of_turned_squares(side, np.diff(turns[:, 2]))
    expected = np.cumsum(sides, axis=0) - sides / 2 - np.cumsum(carried / (stiffness * areas), axis=0)
    straight = [0, 2, 3]
    rounding = 1e-7 if precision == "float32" else 0.0
    np.testing.assert_allclose(heights(model, names)[:, straight], expected[:, straight], rtol=rounding, atol=1e-9)


def leaning_stack(count, pushed, force, stiffness):
    """Returns the places along x and tilts about y of cubes in a stack, (count,) [m, rad], one of which is pushed at its base.

    Contacts are springs for shear, and for a moment about their center, that of a square foundation. Each box carries the
    weight of those above it, also where they have moved.
    """
    rocking = stiffness * SIDE**4 / 12
    places, tilts, slips = np.zeros((3, count))
    for _ in range(30):
        place = tilt = 0.0
        for i in range(count):
            weight = (count - i) * GRAVITY
            pushes = force if i <= pushed else 0.0
            center = place + tilt * SIDE / 2 if i else 0.0
            # The center of the common area is that of the base on the floor, and between boxes the mean of both faces.
            shift = slips[i] / 2 if i else slips[i]
            moment = pushes * (pushed - i) * SIDE + GRAVITY * (places[i:] - center - shift).sum()
            below, tilt = tilt, tilt + moment / rocking
            # The normal force has a component along x on a face that leans.
            slips[i] = (pushes + weight * (below + tilt) / 2) / STICK
            place = center + slips[i] + tilt * SIDE / 2
            places[i], tilts[i] = place, tilt
    return places, tilts


def test_pushed_boxes_of_a_stack_hold_up_to_the_limit_of_friction(device):
    """The uppermost and the lowest of four boxes are pushed at their bases."""
    count, stiffness, mu, dt, ramp, seconds = 4, 2e8, 0.1, 7.5e-5, 0.3, 0.5
    scene = scenes.tower(count, "half-space", lambda name: foundation(stiffness, damping=20.0, mu=mu, mass=0.25))
    factors = np.array([0.98, 1.02, 0.98, 1.02])
    model = scene.build(envs=len(factors), device=device, precision="float64")
    sim = wc.Simulation(model, dt=dt)
    assert sim.check() == []
    sim.step(round(0.2 / dt))
    top, bottom = count - 1, 0
    limits = {top: mu * GRAVITY, bottom: mu * count * GRAVITY}
    pushes = [
        (f"box_{top}", factors * limits[top] * [1, 1, 0, 0], SIDE / 2),
        (f"box_{bottom}", factors * limits[bottom] * [0, 0, 1, 1], SIDE / 2),
    ]
    push_gradually(sim, pushes, ramp)
    sim.step(round(seconds / dt))
    for env, pushed in ((0, top), (2, bottom)):
        places, tilts = leaning_stack(count, pushed, factors[env] * limits[pushed], stiffness)
        found = [model.sensor(f"box_{i}.position")[env, 0] for i in range(count)]
        # Depths shift centers of pressure by up to a permille of the size of a face.
        np.testing.assert_allclose(found, places, rtol=4e-3)
        assert abs(model.sensor(f"box_{pushed}.linear_velocity")[env, 0]) < 1e-6
        # Friction is along the face, which leans.
        lean = (tilts[pushed - 1] + tilts[pushed]) / 2 if pushed else 0.0
        touch = f"box_{pushed}_on"
        friction = np.linalg.norm(model.sensor(f"{touch}.friction_force")[env])
        use = friction / (mu * model.sensor(f"{touch}.normal_force")[env])
        assert use == pytest.approx(factors[env] + lean / mu, rel=2e-4)
        speed = model.sensor(f"box_{pushed}.linear_velocity")[env + 1, 0]
        check_slide(speed, factors[env + 1] * use / factors[env], places[pushed] / factors[env], mu, ramp, seconds)


@durations
def test_pyramid_of_five_boxes_rests(floor, precision, seconds, device):
    """Each of four boxes carries a quarter of the fifth one."""
    dt = 3e-4
    scene = scenes.pyramid(floor, lambda name: foundation(5e6, stick=5e3, mass=0.25))
    model = scene.build(device=device, precision=precision)
    sim = wc.Simulation(model, dt=dt)
    assert sim.check() == []
    sim.step(round(0.8 / dt))
    rest = Rest(model, scene.bodies)
    sim.step(round(seconds / dt))
    rest.check()
    # Symmetric: rounding alone makes loads unequal.
    rounding = 1e-6 if precision == "float32" else 1e-9
    np.testing.assert_allclose(model.sensor("top_on.force")[0, :, 2], GRAVITY / 4, rtol=rounding)
    lower = [model.sensor(f"box_{i}_on.force")[0, 2] for i in range(4)]
    np.testing.assert_allclose(lower, GRAVITY * 5 / 4, rtol=rounding)


@durations
def test_arch_of_mesh_wedges_rests(floor, precision, seconds, device):
    """Each end of a half circle of seven wedges carries half of its weight."""
    dt = 3e-4
    scene = scenes.arch(floor, lambda name: foundation(5e6, stick=5e3, mass=0.25))
    model = scene.build(device=device, precision=precision)
    sim = wc.Simulation(model, dt=dt)
    assert sim.check() == []
    sim.step(round(2.0 / dt))
    rest = Rest(model, scene.bodies)
    sim.step(round(seconds / dt))
    rest.check()
    rounding = 1e-5 if precision == "float32" else 1e-7
    force = model.sensor("feet.force")[0]
    np.testing.assert_allclose(force[:, 2], scenes.WEDGES * GRAVITY / 2, rtol=rounding)
    # The horizontal thrusts are opposite.
    assert force[0, 0] == pytest.approx(-force[1, 0], rel=rounding)
    low, high = scenes.thrust_range()
    assert low < force[0, 0] < min(high, MU * force[0, 2])
