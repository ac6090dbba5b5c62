"""Bodies at rest under nonsmooth body contact: parts of any shape, stacks, a pyramid and an arch.

After they have settled they do not move, with heights and reactions in closed form, and a push holds below the limit of friction
only. Slow tests cover a minute.
"""

import numpy as np
import pytest
import resting_scenes as scenes
from nonsmooth_scenes import rigid
from resting_scenes import GRAVITY, SIDE, Rest, push

import warpcontact as wc

MU = 0.5
DT = 2e-3  # s
#: Gap at which a point counts as closed [m], by precision.
CLOSED = {"float64": 1e-9, "float32": 1e-6}
#: Residual at which the solver ends, relative to the impulse of a weight; in float32 below its default, so that drift is.
TOLERANCE = {"float64": 1e-8, "float32": 2e-6}
#: Tolerance of forces, which are sums over points, by precision.
RESIDUAL = {"float64": 1e-6, "float32": 2e-5}

durations = pytest.mark.parametrize("seconds", [1.0, pytest.param(60.0, marks=pytest.mark.slow)])
both_precisions = pytest.mark.parametrize("precision", ["float64", "float32"])


def material(name):
    """Returns the material of all contacts."""
    return rigid(mu=MU)


def simulation(model, **options):
    options["tolerance"] = TOLERANCE[model.precision]
    return wc.Simulation(model, dt=DT, integrator=wc.integrators.MoreauJean(**options))


def check_rest(sim, bodies, seconds, *, carried=1, envs=slice(None)):
    """Steps a simulation and checks that bodies do not move in ``envs``; each carries up to ``carried`` bodies of 1 kg."""
    # The residual impulse acts at up to SIDE/√2 from the center of a cube.
    speed = TOLERANCE[sim.model.precision] * carried * GRAVITY * DT
    spin = speed * (SIDE / np.sqrt(2)) / (SIDE**2 / 6)
    rest = Rest(sim.model, bodies)
    sim.step(round(seconds / DT))
    rest.check(speed=max(speed, 1e-6), spin=max(spin, 1e-6), envs=envs)


def stepped_slide(factor, steps):
    """Returns speed and displacement after ``steps`` with a push of ``factor`` times μ N, above 1 [m/s, m]."""
    acceleration = (factor - 1) * MU * GRAVITY
    # The mean velocity of each step is that in its middle, for θ = ½.
    return acceleration * steps * DT, acceleration * (steps * DT) ** 2 / 2


@durations
@both_precisions
@pytest.mark.parametrize("floor", ["half-space", "mesh"])
def test_parts_of_any_shape_rest_and_hold_a_push(floor, precision, seconds, device):
    factors = np.array([0.0, 0.98, 1.02])
    # Cones are supported on half-spaces only.
    known = {name: part for name, part in scenes.parts().items() if floor == "half-space" or name != "cone"}
    scene = scenes.parts_on_floor(floor, material, known, gap=1e-3)
    model = scene.build(envs=len(factors), device=device, precision=precision)
    sim = simulation(model)
    sim.step(100)
    before = Rest(model, scene.bodies)
    for name, part in known.items():
        push(model, name, factors * MU * GRAVITY, part.height)
    sim.step(100)
    speed, way = stepped_slide(factors[2], 100)
    for name, part in known.items():
        position, start = model.sensor(f"{name}.position").astype(float), before.start[name][0]
        np.testing.assert_allclose(position[:2, 2], part.height, atol=2 * CLOSED[precision], err_msg=name)
        np.testing.assert_allclose(
            model.sensor(f"{name}_touch.force")[0], [0, 0, GRAVITY], atol=GRAVITY * RESIDUAL[precision]
        )
        moved = (position - start)[:, 0]
        assert abs(moved[1]) < CLOSED[precision], name
        assert moved[2] == pytest.approx(way, rel=1e-3), name
        assert model.sensor(f"{name}.linear_velocity")[2, 0] == pytest.approx(speed, rel=1e-3), name
        push(model, name, np.array([0.0, factors[1] * MU * GRAVITY, 0.0]), part.height)
    sim.step(50)
    check_rest(sim, scene.bodies, seconds)


@durations
@pytest.mark.parametrize(
    ("solver", "precision"), [("auto", "float64"), ("auto", "float32"), ("gauss_seidel", "float64")]
)
def test_stacks_of_ten_boxes_rest(solver, precision, seconds, device):
    """Aligned, offset, turned and unequal boxes; see ``scenes.vary_stacks``."""
    count, gap = 10, 1e-3
    scene = scenes.tower(count, "half-space", material, gap=gap)
    model = scene.build(envs=len(scenes.STACKS), device=device, precision=precision)
    sides, masses, _ = scenes.vary_stacks(model, count, gap=gap)
    model.reset()
    sim = simulation(model, solver=solver)
    sim.step(500)
    check_rest(sim, scene.bodies, seconds, carried=count)
    names = [f"box_{i}" for i in range(count)]
    carried = np.cumsum(masses[::-1], axis=0)[::-1] * GRAVITY
    for i, name in enumerate(names):
        np.testing.assert_allclose(model.sensor(f"{name}_on.normal_force"), carried[i], rtol=1e-5)
        # Action and reaction: the wrench on a body is that of its contacts.
        force = model.sensor(f"{name}_on.force").astype(float)
        if i + 1 < count:
            force -= model.sensor(f"{names[i + 1]}_on.force")
        np.testing.assert_allclose(model.sensor(f"{name}.force"), force, atol=1e-5 * carried[i].max())
    # Gaps of closed points, and overlap from impacts in which Gauss–Seidel ended before it converged.
    overlap = 5e-6 if solver == "gauss_seidel" else 1e-7
    expected = np.cumsum(sides, axis=0) - sides / 2
    found = np.array([model.sensor(f"{name}.position")[:, 2] for name in names], dtype=float)
    np.testing.assert_allclose(found, expected, atol=count * CLOSED[precision] + overlap)


@both_precisions
def test_pushed_boxes_of_a_stack_hold_up_to_the_limit_of_friction(precision, device):
    """The uppermost and the lowest of ten boxes are pushed at their bases."""
    count, steps = 10, 250
    factors = np.array([0.98, 1.02, 0.98, 1.02])
    scene = scenes.tower(count, "half-space", material)
    model = scene.build(envs=len(factors), device=device, precision=precision)
    sim = simulation(model)
    sim.step(50)
    top, bottom = count - 1, 0
    push(model, f"box_{top}", MU * GRAVITY * factors * [1, 1, 0, 0], SIDE / 2)
    push(model, f"box_{bottom}", count * MU * GRAVITY * factors * [0, 0, 1, 1], SIDE / 2)
    sim.step(steps)
    for env, pushed in ((0, top), (2, bottom)):
        touch = f"box_{pushed}_on"
        friction = np.linalg.norm(model.sensor(f"{touch}.friction_force")[env])
        normal = model.sensor(f"{touch}.normal_force")[env]
        assert friction / (MU * normal) == pytest.approx(factors[env], rel=RESIDUAL[precision])
        speed, way = stepped_slide(factors[env + 1], steps)
        assert model.sensor(f"box_{pushed}.linear_velocity")[env + 1, 0] == pytest.approx(speed, rel=5e-3)
        assert model.sensor(f"box_{pushed}.position")[env + 1, 0] == pytest.approx(way, rel=5e-3)
    check_rest(sim, scene.bodies, 0.5, carried=count, envs=[0, 2])


@durations
@both_precisions
def test_pyramid_of_five_boxes_rests(precision, seconds, device):
    """Each of four boxes carries a quarter of the fifth one."""
    gap = 1e-3
    scene = scenes.pyramid("mesh", material, gap=gap)
    model = scene.build(device=device, precision=precision)
    sim = simulation(model)
    sim.step(300)
    check_rest(sim, scene.bodies, seconds)
    assert model.sensor("top.position")[0, 2] == pytest.approx(1.5 * SIDE, abs=3 * CLOSED[precision])
    upper, centers = model.sensor("top_on.force")[0, :, 2], model.sensor("top_on.center")[0, :, :2]
    scenes.check_balance(upper, centers, GRAVITY, rtol=RESIDUAL[precision])
    for i in range(4):
        assert model.sensor(f"box_{i}_on.force")[0, 2] == pytest.approx(
            GRAVITY + upper[i], rel=RESIDUAL[precision]
        )


@durations
@both_precisions
def test_arch_of_mesh_wedges_rests(precision, seconds, device):
    """A half circle of seven wedges carries itself with a thrust that statics allow."""
    scene = scenes.arch("mesh", material)
    model = scene.build(device=device, precision=precision)
    sim = simulation(model)
    sim.step(500)
    check_rest(sim, scene.bodies, seconds, carried=scenes.WEDGES / 2)
    force, centers = model.sensor("feet.force")[0], model.sensor("feet.center")[0]
    # Loads follow from their places within each end.
    scenes.check_balance(force[:, 2], centers[:, :2], scenes.WEDGES * GRAVITY, rtol=RESIDUAL[precision])
    assert force[0, 0] == pytest.approx(-force[1, 0], rel=RESIDUAL[precision])
    low, high = scenes.thrust_range()
    assert low < force[0, 0] < min(high, MU * force[0, 2])
