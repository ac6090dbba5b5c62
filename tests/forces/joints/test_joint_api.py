"""API of joints: values per environment and device, model sensors, steps, files, errors and warnings."""

import warnings
from typing import Any

import numpy as np
import pytest
import warp as wp
from scenes import dropped_sphere, square
from scipy.spatial.transform import Rotation
from warpcontact.kernels.integrators import semi_implicit
from warpcontact.kernels.joints import step as constrained
from warpcontact.kernels.types import ENV_FROZEN

import warpcontact as wc
from warpcontact.forces.execution_plan import ExecutionPlan
from warpcontact.scene.mobility import mobility_along, mobility_of

HINGE = wc.motions.Hinge(axis=(0, 1, 0), anchor=(0, 0, 1))
HINGE_ABOVE = wc.motions.Hinge(axis=(0, 1, 0), anchor=(0, 0, 5))
POSE = {"mass": 1.0, "inertia": (0.1, 0.1, 0.1), "position": (0.5, 0, 1)}


def add(motion=HINGE, scene=None, **options):
    scene = wc.Scene() if scene is None else scene
    scene.add_body(**(POSE | {"name": "arm"} | options), motion=motion)
    return scene


BAD = [
    (lambda: add("Hinge"), TypeError, "arm.motion must be an instance of a class of wc.motions, got 'Hinge'"),
    (lambda: add(wc.motions.Hinge), TypeError, "arm.motion must be an instance of a class of wc.motions"),
    (
        lambda: wc.motions.Hinge(axis=(0, 0, 0), anchor=(0, 0, 0)),
        ValueError,
        r"Hinge.axis must be a direction, got \[0.0, 0.0, 0.0\]",
    ),
    (
        lambda: wc.motions.Slider(axis=(0, 1)),
        ValueError,
        r"Slider.axis must be 3 numbers, got shape \(2,\); .* model\['<body>.motion.axis'\]",
    ),
    (lambda: wc.motions.Ball(anchor=(0, 0, np.nan)), ValueError, r"Ball.anchor\[2\] must be finite, got nan m"),
    (
        lambda: wc.motions.Harmonic(direction=(0, 0, 1), frequency=1),
        ValueError,
        "exactly one of amplitude and angle",
    ),
    (
        lambda: wc.motions.Table(times=(0, 0), displacements=((0, 0, 0),) * 2),
        ValueError,
        "Table.times must be at least two increasing times",
    ),
    (
        lambda: wc.motions.Table(times=(0, 1), displacements=((0, 0, 0),)),
        ValueError,
        "Table.displacements must have one row for each of 2 times, got 1",
    ),
    (
        lambda: wc.motions.Table(times=(0, 1)),
        ValueError,
        "Table takes displacements or rotations or both, got none",
    ),
    (
        lambda: add(angular_velocity=(1, 1, 0)),
        ValueError,
        r"arm.angular_velocity must be along the axis of its motion Hinge, got \[1.0, 1.0, 0.0\]",
    ),
    (
        lambda: add(angular_velocity=(0, 2, 0), linear_velocity=(0, 0, 1)),
        ValueError,
        r"arm.linear_velocity must be left out or \(0, 0, -1\) with this angular velocity and its motion Hinge",
    ),
    (
        lambda: add(wc.motions.Slider(axis=(1, 0, 0)), linear_velocity=(0, 0, 1)),
        ValueError,
        "arm.linear_velocity must be along the axis of its motion Slider",
    ),
    (
        lambda: add(wc.motions.Planar(normal=(1, 0, 0)), linear_velocity=(1, 0, 1)),
        ValueError,
        "arm.linear_velocity must be in the plane of its motion Planar",
    ),
    (
        lambda: add(wc.motions.Translation(), angular_velocity=(0, 0, 1)),
        ValueError,
        "arm.angular_velocity must be zero with its motion Translation",
    ),
    (
        lambda: add(wc.motions.Fixed(), linear_velocity=(0, 0, 1)),
        ValueError,
        "arm.linear_velocity must be zero with its motion Fixed",
    ),
    (
        lambda: add(wc.motions.Harmonic(direction=(0, 0, 1), amplitude=1, frequency=1), linear_velocity=(0, 0, 1)),
        ValueError,
        "arm.linear_velocity must be zero: it follows from its motion Harmonic",
    ),
    (wc.Motion, TypeError, r"Motion.displacement must be a wp.func of \(coefficients, time\)"),
]


@pytest.mark.parametrize(("make", "error", "message"), BAD, ids=[message[:40] for _, _, message in BAD])
def test_invalid_joint_raises(make, error, message):
    with pytest.raises(error, match=message):
        make()


def test_model_of_free_bodies_compiles_no_joint_kernel(device):
    model = dropped_sphere(wc.laws.Hooke(stiffness=1e4), device=device)
    assert not model.has_joints
    assert not model.of_family("joints")
    assert not [name for name in model if ".motion." in name]
    assert not [name for name in model.sensor_names if "reaction" in name]
    made = constrained.semi_implicit_euler.cache_info().currsize
    one = wc.Simulation(model, dt=1e-3)
    one.step()
    assert constrained.semi_implicit_euler.cache_info().currsize == made
    plan, state = ExecutionPlan(model, 1, uses_cache=True, ordered_sum=True), model.arrays.state
    kernels = [launch.kernel for launch in one.integrator.step_stages(plan, one.times.full, state, state, None)]
    assert semi_implicit.semi_implicit_euler(model.types.real, False, plan.other_forces, False) in kernels


def test_free_body_is_bitwise_unaffected_by_a_jointed_body(device):
    alone, beside = wc.Scene(), wc.Scene()
    for scene in (alone, beside):
        scene.add_body(1.0, (0.1, 0.3, 0.2), angular_velocity=(1, 2, 3), name="stone")
    add(scene=beside)
    positions = []
    for scene in (alone, beside):
        model = scene.build(device=device)
        wc.Simulation(model, dt=1e-3).step(50)
        positions.append((model.sensor("stone.position"), model.sensor("stone.orientation")))
    for one, other in zip(*positions, strict=True):
        np.testing.assert_array_equal(one, other)


def mixed():
    """An arm on a joint that strikes a plate on a shaker."""
    scene = add()
    arm = scene.bodies[0]
    shaker = scene.add_body(
        1.0,
        (1, 1, 1),
        position=(0, 0, 0.4),
        motion=wc.motions.Harmonic(direction=(0, 0, 1), amplitude=0.05, frequency=2.0),
        name="shaker",
    )
    plate = scene.add_surface(square(), shaker, name="plate")
    tip = scene.add_point(arm, (0.2, 0, 0))
    law = wc.laws.KelvinVoigt(stiffness=1e4, restitution=0.6)
    scene.add_contact(
        tip,
        plate,
        wc.ContactMaterial(law=law, friction=wc.friction.Tanh(mu=0.2)),
        radius=0.05,
        name="touch",
    )
    return scene


VALUES = {
    "arm.motion.anchor": [(0, 0, 1), (0, 0, 1.1), (0.1, 0, 1), (0, 0.2, 0.9)],
    "arm.motion.axis": [(0, 1, 0), (0, 2, 0), (0.1, 1, 0), (0, -1, 0)],
    "shaker.motion.frequency": [1.0, 1.7, 3.1, 4.3],
}
NAMES = ("arm.position", "arm.orientation", "arm.angular_velocity", "shaker.position", "touch.normal_force")


@pytest.fixture(scope="module")
def run(device):
    """Runs the scene with different values per environment; returns the model and its results."""

    def go(split=1, steps=700, **options):
        model = mixed().build(envs=4, device=[device] * split)
        for name, values in VALUES.items():
            model[name] = values
        sim = wc.Simulation(model, dt=1e-3, **options)
        sim.step(steps)
        return model, [model.sensor(name) for name in NAMES]

    return go


def test_jointed_environments_are_bitwise_identical_for_any_schedule(run, device):
    model, expected = run()
    # All arms have struck the plate, and some are in contact now.
    assert (model.sensor("touch.normal_force") > 0.0).any()
    for name in ("arm.position", "shaker.position"):
        assert len(np.unique(model.sensor(name).round(6), axis=0)) == 4, name
    for options in ({"split": 2}, {"capture_graphs": False}, {"distance_cache": False}):
        for name, one, other in zip(NAMES, expected, run(**options)[1], strict=True):
            np.testing.assert_array_equal(one, other, err_msg=f"{name} {options}")
    alone = mixed().build(envs=1, device=device)
    for name, values in VALUES.items():
        alone[name] = values[2]
    wc.Simulation(alone, dt=1e-3).step(700)
    for name, several in zip(NAMES, expected, strict=True):
        np.testing.assert_array_equal(alone.sensor(name)[0], several[2], err_msg=name)


def test_reset_environment_returns_to_initial_joint_state_and_frozen_one_stays(run):
    model, _ = run(steps=0)
    begin = [model.sensor(name) for name in NAMES]
    sim = wc.Simulation(model, dt=1e-3)
    sim.step(300)
    status = model.arrays.status.numpy()
    status[1] = ENV_FROZEN
    model.arrays.status.assign(status)
    held = [model.sensor(name)[1] for name in NAMES[:-1]]
    sim.step(100)
    for name, value in zip(NAMES, held, strict=False):
        np.testing.assert_array_equal(model.sensor(name)[1], value, err_msg=name)
    sim.reset([True, True, False, True])
    assert model.arrays.time.numpy()[[0, 1, 3]].tolist() == [0, 0, 0]
    for name, value in zip(NAMES, begin, strict=True):
        np.testing.assert_array_equal(model.sensor(name)[[0, 1, 3]], value[[0, 1, 3]], err_msg=name)
    # Each environment uses its own clock.
    t = model.arrays.time.numpy()[2]
    height = 0.4 + 0.05 * np.sin(2 * np.pi * 3.1 * t)
    np.testing.assert_allclose(model.sensor("shaker.position")[2, 2], height, rtol=1e-12)


def test_initial_velocities_are_projected_onto_the_joint(device):
    model = add().build(envs=2, device=device, precision="float64")
    model["arm.angular_velocity"] = [(3, 2, 1), (0, 4, 0)]
    model["arm.linear_velocity"] = (7, 8, 9)
    np.testing.assert_allclose(model.sensor("arm.angular_velocity"), [(0, 2, 0), (0, 4, 0)])
    np.testing.assert_allclose(model.sensor("arm.linear_velocity"), [(0, 0, -1), (0, 0, -2)])
    model["arm.motion.axis"] = (0, 0, 5)
    np.testing.assert_allclose(model.sensor("arm.angular_velocity"), [(0, 0, 1), (0, 0, 0)])
    np.testing.assert_array_equal(model["arm.motion.axis"], [(0, 0, 1)] * 2)


@pytest.mark.parametrize("parts", [1, 8])
def test_swept_contact_with_substeps_stops_a_revolute_arm(parts, device):
    """Substeps begin with velocities of another time, also for the joint."""
    scene = wc.Scene(gravity=(0, 0, 0))
    hinge = wc.motions.Hinge(axis=(0, 1, 0), anchor=(0, 0, 0))
    arm = scene.add_body(
        1.0, (0.1,) * 3, position=(0.5, 0, 0.2), angular_velocity=(0, 10, 0), motion=hinge, name="arm"
    )
    lift = wc.motions.Harmonic(direction=(0, 0, 1), amplitude=1e-3, frequency=1.0)
    carrier = scene.add_body(1.0, (1, 1, 1), motion=lift, name="lift")
    plate = scene.add_surface(square(), carrier, name="plate")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=2e4))
    scene.add_contact(scene.add_point(arm, (0, 0, 0)), plate, material, swept=True, name="touch")
    model = scene.build(device=device, precision="float64")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        wc.Simulation(model, dt=2e-3, crossing_substeps=parts).step(60)
    assert model.sensor("touch.crossings")[0] == 1
    place, rate = model.sensor("arm.position")[0], model.sensor("arm.angular_velocity")[0]
    assert place[2] > 0.0
    np.testing.assert_allclose(model.sensor("arm.linear_velocity")[0], np.cross(rate, place), atol=1e-13)
    # Elastic contact: the plate, which rises at 2π mm/s, adds twice that over a lever arm of 0.5 m. The contact
    # lasts about 10 steps.
    np.testing.assert_allclose(rate[1], -10.0 - 2 * 2 * np.pi * 1e-3 / 0.5, atol=0.04)
    t = model.arrays.time.numpy()[0]
    np.testing.assert_allclose(model.sensor("lift.position")[0, 2], 1e-3 * np.sin(2 * np.pi * t), rtol=1e-10)


def test_substeps_do_not_change_a_pendulum_without_crossing(device):
    """Velocities belong to half a step earlier; after a change to substeps they belong to a later time."""
    scene = wc.Scene(gravity=(0, 0, -9.81))
    scene.add_body(1.0, (0.1,) * 3, position=(0.5, 0, 5.0), motion=HINGE_ABOVE, name="arm")
    harmonic = wc.motions.Harmonic(direction=(1, 0, 0), amplitude=0.1, frequency=2.0)
    scene.add_body(1.0, (0.1,) * 3, motion=harmonic, name="lift")
    stone = scene.add_body(1.0, (0.1,) * 3, position=(0, 0, 0.51), linear_velocity=(0, 0, -10), name="stone")
    ground = scene.add_surface(square(), name="ground")
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3))
    scene.add_contact(scene.add_point(stone, (0, 0, 0)), ground, material, swept=True, name="touch")
    model = scene.build(device=device, precision="float64")
    dt, angles = 5e-3, []
    for parts in (1, 8):
        model.reset()
        wc.Simulation(model, dt, crossing_substeps=parts).step(11)
        assert model.sensor("touch.crossings")[0] == 1
        angles.append(model.sensor("arm.angle")[0])
        t = 11 * dt
        mean = 0.1 * (np.sin(4 * np.pi * t) - np.sin(4 * np.pi * (t - dt))) / dt
        # To dt²/24 of its third derivative.
        np.testing.assert_allclose(model.sensor("lift.linear_velocity")[0, 0], mean, atol=4e-4)
    # A velocity that is dt/2 too early in one step would give an error of dt²/2 α = 1.8e-4 rad. The remaining
    # error is of third order.
    np.testing.assert_allclose(angles[0], angles[1], atol=2e-5)


def test_contact_duration_estimate_uses_the_mobility_of_a_jointed_body(device):
    """A door is harder to move near its hinge: I/d², not the mass, determines the duration of contact."""

    def shortest(motion):
        scene = wc.Scene(gravity=(0, 0, 0))
        door = scene.add_body(1.0, (0.1, 0.1, 0.1), position=(0.5, 0, 0), motion=motion)
        wall = scene.add_surface(square(5.0), position=(0, 0, -0.5))
        tip = scene.add_point(door, (-0.4, 0, 0))
        scene.add_contact(tip, wall, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4)), name="touch")
        with pytest.warns(wc.ContactWarning, match="a contact lasts (.*) s in") as caught:
            wc.Simulation(scene.build(device=device), dt=0.02).step()
        return float(str(caught[0].message).partition("lasts ")[2].partition(" s")[0])

    free = shortest(wc.motions.Free())
    hinged = shortest(wc.motions.Hinge(axis=(0, 1, 0), anchor=(0, 0, 0)))
    inertia = 0.1 + 0.5**2
    # π √(m*/K), printed with two digits: m* = 1 kg, and I/d² = 35 kg.
    np.testing.assert_allclose(free, np.pi * np.sqrt(1.0 / 1e4), rtol=0.02)
    np.testing.assert_allclose(hinged, np.pi * np.sqrt(inertia / 0.1**2 / 1e4), rtol=0.03)


def test_prescribed_and_fixed_bodies_are_kinematic_in_usd(device, tmp_path):
    from pxr import Usd, UsdPhysics

    scene = add()
    add(wc.motions.Fixed(), scene, name="post")
    add(wc.motions.Prescribed(), scene, name="belt")
    model = scene.build(device=device)
    wc.export_usd(wc.Simulation(model, dt=1e-3).run(2e-3), tmp_path / "a.usda")
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    kinematic = {
        prim.GetName(): UsdPhysics.RigidBodyAPI(prim).GetKinematicEnabledAttr().Get()
        for prim in stage.TraverseAll()
        if prim.HasAPI(UsdPhysics.RigidBodyAPI) and prim.GetName() in ("arm", "post", "belt")
    }
    assert kinematic == {"arm": False, "post": True, "belt": True}


@pytest.mark.parametrize(
    "motion",
    [
        wc.motions.Free(),
        wc.motions.Translation(),
        wc.motions.Slider(axis=(1, 2, 0)),
        wc.motions.Planar(normal=(0, 1, 1)),
        wc.motions.Hinge(axis=(0, 1, 1), anchor=(0.2, 0.1, 0.8)),
        wc.motions.Ball(anchor=(0.2, 0.1, 0.8)),
        wc.motions.Fixed(),
    ],
    ids=lambda motion: type(motion).__name__,
)
def test_mobility_of_jointed_body_matches_response_of_a_step(motion, device):
    """The mobility used for warnings equals the response of a step to a small impulse: δv along the force."""
    scene = wc.Scene(gravity=(0, 0, 0))
    arm = scene.add_body(
        2.0, (0.3, 0.2, 0.15), POSE["position"], (0.5, 0.1, 0.3, np.sqrt(0.65)), motion=motion, name="arm"
    )
    model = scene.build(device=device, precision="float64")
    place, n = np.array([[0.1, 0.3, -0.2]]), np.array([[0.6, 0.0, 0.8]])
    dt, force = 1e-6, 1e-3 * n[0]
    model["arm.external_force"], model["arm.external_torque"] = force, np.cross(place[0], force)
    wc.Simulation(model, dt).step()
    v, w = model.sensor("arm.linear_velocity")[0], model.sensor("arm.angular_velocity")[0]
    moved = (v + np.cross(w, place[0])) @ n[0] / (1e-3 * dt)
    # First-order differences over a step of 1e-6 s with velocities of 1e-9.
    np.testing.assert_allclose(mobility_along(model, arm, place, n)[0], moved, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("motion", [HINGE, wc.motions.Ball(anchor=(0, 0, 1))], ids=["Hinge", "Ball"])
def test_largest_mobility_of_jointed_body_is_found_over_all_directions(motion, device):
    """The warnings use the largest mobility over all directions and contact points."""
    scene = wc.Scene()
    ground = scene.add_surface(square())
    arm = scene.add_body(
        2.0, (0.3, 0.2, 0.15), POSE["position"], (0.5, 0.1, 0.3, np.sqrt(0.65)), motion=motion, name="arm"
    )
    places = np.array([(0.1, 0.3, -0.2), (0.3, 0.0, 0.1), (-0.1, 0.1, 0.0)])
    law = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0))
    contact = scene.add_contact(scene.add_points(arm, places), ground, law)
    model = scene.build(device=device, precision="float64")
    rng = np.random.default_rng(5)
    directions = rng.standard_normal((20_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    arms = Rotation.from_quat(model["arm.orientation"][0]).apply(places)
    yields = [mobility_along(model, arm, np.broadcast_to(place, directions.shape), directions) for place in arms]
    most = np.max(yields)
    # Among 20 000 random directions, the nearest to the maximum is about 0.01 rad off.
    np.testing.assert_allclose(mobility_of(model, contact, arm).linear[0, 0], most, rtol=1e-3)
    assert mobility_of(model, contact, arm).linear[0, 0] >= most * (1.0 - 1e-12)


class Root(wc.Spring):
    """f = k √(x − x₀): NaN for lengths below the rest length."""

    stiffness: float = wc.parameter("N/√m", "stiffness k")

    @wp.func
    def force(p: Any, s: Any):
        return p.stiffness * wp.sqrt(s.extension)


JOINTS = {
    "free": None,
    "fixed": wc.motions.Fixed(),
    "translation": wc.motions.Translation(),
    "planar": wc.motions.Planar(normal=(0, 1, 0)),
    "hinge": HINGE,
    "slider": wc.motions.Slider(axis=(1, 0, 0)),
    "ball": wc.motions.Ball(anchor=(0, 0, 1)),
    "prescribed": wc.motions.Prescribed(),
    "driven": wc.motions.Harmonic(direction=(0, 0, 1), amplitude=0.1, frequency=1.0),
}


def test_non_finite_load_freezes_its_environment_for_every_joint(device):
    """Also if the body cannot move in the direction of the load; each environment has another body under it."""
    scene = wc.Scene(gravity=(0, 0, 0))
    for name, motion in JOINTS.items():
        body = scene.add_body(**POSE, motion=motion, name=name)
        ends = scene.add_point(body, (0, 0, 0)), scene.add_point(None, (0.5, 1, 1))
        scene.add_spring_damper(*ends, spring=Root(stiffness=1.0), rest_length=0.5, name=f"{name}_spring")
    model = scene.build(envs=len(JOINTS) + 1, device=device)
    expected = scene.build(device=device)
    wc.Simulation(expected, dt=1e-3).step(10)
    for number, name in enumerate(JOINTS):
        model[f"{name}_spring.rest_length"] = np.where(np.arange(len(JOINTS) + 1) == number, 3.0, 0.5)
    start = {name: model.sensor(f"{name}.position") for name in JOINTS}
    wc.Simulation(model, dt=1e-3).step(10)
    assert model.health().frozen.tolist() == list(range(len(JOINTS)))
    for name in JOINTS:
        place = model.sensor(f"{name}.position")
        np.testing.assert_array_equal(place[:-1], start[name][:-1], err_msg=name)
        np.testing.assert_array_equal(place[-1], expected.sensor(f"{name}.position")[0], err_msg=name)
