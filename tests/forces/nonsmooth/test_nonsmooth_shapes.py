"""Nonsmooth shape contact equals that of the same sphere on a flat mesh, and closed forms."""

import numpy as np
import pytest
from nonsmooth_scenes import HARD, LOSSES, G, rigid
from scenes import square

import warpcontact as wc

RADIUS = 0.1
INERTIA = (0.4 * RADIUS**2,) * 3  # solid ball of 1 kg
THROWN = {"position": (0, 0, 0.15), "linear_velocity": (1.5, 0.3, -2.0), "angular_velocity": (3.0, -2.0, 9.0)}


def sphere(material, *, smooth=True, start=THROWN, gravity=G, contact=None, **built):
    """A solid ball of 1 kg above a plane at z = 0, which is a shape or a mesh."""
    scene = wc.Scene(gravity=(0.0, 0.0, -gravity))
    body = scene.add_body(1.0, INERTIA, name="ball", **start)
    options = {"name": "touch", **(contact or {})}
    if smooth:
        plane = scene.add_shape(None, wc.shapes.Plane(), name="plane")
        scene.add_shape_contact(scene.add_shape(body, wc.shapes.Sphere(RADIUS)), plane, material, **options)
    else:
        ground = scene.add_surface(square(50.0), name="ground")
        scene.add_contact(scene.add_point(body, (0.0, 0.0, 0.0)), ground, material, radius=RADIUS, **options)
    return scene.build(**{"precision": "float64", **built})


def test_nonsmooth_sphere_on_plane_matches_flat_mesh(device):
    material = rigid(0.6, 0.1, rolling=wc.friction.Coulomb(mu=0.05), torsion=wc.friction.Coulomb(mu=0.2))
    names = ["ball.position", "ball.angular_velocity", "touch.gap", *LOSSES]
    names += [f"touch.{key}" for key in ("impulse", "mode", "normal_force", "friction_force", "torque")]
    names += ["touch.slip_speed", "touch.approach_speed"]
    runs = [
        wc.Simulation(
            sphere(material, smooth=smooth, contact={"torsion_radius": 0.02}, device=device), 1e-3, HARD
        ).run(2.0, names)
        for smooth in (True, False)
    ]
    # Two implementations give the same contact point, to rounding; the residual of the solver is 1e-10.
    for name in names:
        np.testing.assert_allclose(runs[0][name], runs[1][name], rtol=1e-8, atol=1e-8, err_msg=name)
    assert set(np.unique(runs[0]["touch.mode"])) == set(wc.ContactMode)
    assert (np.abs(runs[0]["touch.torque"].values[-1, 0]) > 1e-6).any()


def test_nonsmooth_sliding_sphere_shape_ends_up_rolling(device):
    speed = 3.0
    start = {"position": (0.0, 0.0, RADIUS), "linear_velocity": (speed, 0.0, 0.0)}
    # With the contact point on the surface of the ball, so that the lever arm is its radius.
    model = sphere(rigid(mu=0.2), start=start, contact={"kappa": 1.0}, device=device)
    wc.Simulation(model, 1e-3, HARD).step(1000)
    velocity = model.sensor("ball.linear_velocity")[0, 0]
    assert velocity == pytest.approx(5.0 / 7.0 * speed, rel=1e-8)
    assert RADIUS * model.sensor("ball.angular_velocity")[0, 1] == pytest.approx(velocity, rel=1e-8)
    assert model.sensor("touch.mode")[0] == wc.ContactMode.STICK
    assert model.sensor("touch.normal_force")[0] == pytest.approx(G, rel=1e-9)


def test_nonsmooth_shape_restitution_and_friction_can_vary_by_environment(device):
    start = {"position": (0.0, 0.0, RADIUS + 0.01), "linear_velocity": (2.0, 0.0, -3.0)}
    model = sphere(rigid(0.5, 0.1), start=start, gravity=0.0, envs=3, device=device)
    model["touch.law.restitution"] = [0.0, 0.4, 1.0]
    model["touch.friction.mu"] = [0.0, 0.1, 0.05]
    simulation = wc.Simulation(model, 1e-3, HARD)
    data = simulation.run(0.01, ["touch.impulse"])
    after = model.sensor("ball.linear_velocity")
    assert after[:, 2] == pytest.approx([0.0, 1.2, 3.0], abs=1e-9)
    # Sliding removes μ (1 + e) v.
    assert after[:, 0] == pytest.approx([2.0, 2.0 - 0.1 * 4.2, 2.0 - 0.05 * 6.0], abs=1e-9)
    assert data["touch.impulse"].values.sum(axis=0)[:, 2] == pytest.approx([3.0, 4.2, 6.0], abs=1e-9)
    model["touch.law.restitution"] = 0.25
    simulation.reset()
    simulation.step(10)
    assert model.sensor("ball.linear_velocity")[:, 2] == pytest.approx(0.75, abs=1e-9)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_nonsmooth_sphere_bounces_off_ellipsoid_along_its_normal(precision, device):
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    body = scene.add_body(1.0, INERTIA, position=(0.3, 0.1, 0.9), linear_velocity=(0.0, 0.0, -2.0), name="ball")
    hill = scene.add_shape(None, wc.shapes.Ellipsoid((1.0, 0.6, 0.4)), name="hill")
    ball = scene.add_shape(body, wc.shapes.Sphere(RADIUS), name="sphere")
    scene.add_shape_contact(ball, hill, rigid(0.8), name="touch")
    model = scene.build(device=device, precision=precision)
    before = model.sensor("ball.linear_velocity")[0]
    data = wc.Simulation(model, 1e-3, HARD).run(0.4, ["touch.impulse", "touch.normal", "touch.gap"])
    hit = int(np.flatnonzero(np.linalg.norm(data["touch.impulse"].values[:, 0], axis=1))[0])
    impulse = data["touch.impulse"].values[hit, 0].astype(float)
    normal = impulse / np.linalg.norm(impulse)
    after = model.sensor("ball.linear_velocity")[0]
    tolerance = 1e-4 if precision == "float32" else 1e-9
    assert after == pytest.approx(before - 1.8 * (before @ normal) * normal, abs=tolerance)
    # The normal of the middle of the step differs from that of the end by at most v h.
    assert normal == pytest.approx(data["touch.normal"].values[hit, 0], abs=2.0 * 1e-3 / RADIUS)
    assert -data["touch.gap"].values.min() <= 2.0 * 1e-3


def test_nonsmooth_spheres_exchange_momentum_as_newton(device):
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    shapes = []
    for name, place, velocity in (("one", 0.0, 2.0), ("two", 0.25, -0.5)):
        options = {"position": (place, 0, 0), "linear_velocity": (velocity, 0, 0), "name": name}
        shapes.append(scene.add_shape(scene.add_body(1.0, INERTIA, **options), wc.shapes.Sphere(RADIUS)))
    scene.add_shape_contact(*shapes, rigid(0.7), name="touch")
    model = scene.build(device=device, precision="float64", envs=2)
    model["touch.law.restitution"] = [0.7, 1.0]
    wc.Simulation(model, 1e-3, HARD).step(100)
    one, two = (model.sensor(f"{name}.linear_velocity")[:, 0] for name in ("one", "two"))
    assert one + two == pytest.approx(1.5, abs=1e-12)
    assert two - one == pytest.approx([0.7 * 2.5, 2.5], abs=1e-9)


@pytest.fixture(scope="module")
def three(device):
    """Three balls on a plane with the same contact model; the middle one is nonsmooth."""
    scene = wc.Scene(gravity=(0.0, 0.0, -G))
    plane = scene.add_shape(None, wc.shapes.Plane(), name="plane")
    material = wc.ContactMaterial(
        law=wc.laws.KelvinVoigt(stiffness=1e5, damping=100.0),
        friction=wc.friction.CundallStrack(mu_static=0.4, mu_dynamic=0.3, stiffness=1e4, damping=10.0),
    )
    for number, name in enumerate(("left", "middle", "right")):
        start = {**THROWN, "position": (0.0, float(number), 0.15)}
        ball = scene.add_shape(scene.add_body(1.0, INERTIA, name=name, **start), wc.shapes.Sphere(RADIUS))
        scene.add_shape_contact(ball, plane, material, name=f"{name}_touch")
    model = scene.build(device=device, precision="float64", envs=3)
    model["middle.linear_velocity"] = [(1.0, 0.2, -1.0), (1.0, 0.2, -2.0), (1.0, 0.2, -3.0)]
    return model, wc.integrators.MoreauJean(compliant=["left_touch", "right_touch"])


def state(model):
    names = [
        "left.position",
        "middle.position",
        "right.position",
        "middle.angular_velocity",
        "middle_touch.impulse",
    ]
    return np.concatenate([model.sensor(name).ravel() for name in names])


def test_compliant_and_nonsmooth_shape_contacts_can_share_a_scene(three):
    model, integrator = three
    simulation = wc.Simulation(model, 2e-4, integrator)
    simulation.reset()
    data = simulation.run(
        0.5,
        [
            *("left.position", "right.position", "middle.force"),
            *("left_touch.normal_force", "middle_touch.normal_force", "middle_touch.friction_force"),
        ],
    )
    left, right = (data[f"{name}.position"].values for name in ("left", "right"))
    # Different positions are rounded differently.
    np.testing.assert_allclose(left[..., [0, 2]], right[..., [0, 2]], rtol=1e-12)
    assert left[..., 2].min() < RADIUS - 1e-3
    assert (data["left_touch.normal_force"].values > 0).any()
    force = data["middle_touch.friction_force"].values.copy()
    force[..., 2] += data["middle_touch.normal_force"].values
    np.testing.assert_allclose(data["middle.force"], force, atol=1e-9)
    assert force[-1, :, 2] == pytest.approx(G, rel=1e-6)
    # A law without restitution is inelastic here.
    assert np.abs(model.sensor("middle.linear_velocity")[:, 2]).max() < 1e-9
    assert "left_touch.impulse" not in model.sensor_names
    assert "middle_touch.impulse" in model.sensor_names


def test_nonsmooth_shapes_are_bitwise_identical_with_graphs_threads_and_resets(three):
    model, integrator = three
    results = []
    for options in ({}, {"capture_graphs": False, "threads": 1}):
        simulation = wc.Simulation(model, 1e-3, integrator, **options)
        simulation.reset()
        simulation.step(150)
        results.append(state(model))
    simulation.reset(np.array([True, False, True]))
    simulation.step(7)
    simulation.reset()
    assert model.sensor("middle_touch.impulse") == pytest.approx(0.0)
    simulation.step(150)
    results.append(state(model))
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])


def test_nonsmooth_shapes_are_unchanged_by_sensor_evaluation(three):
    model, integrator = three
    simulation = wc.Simulation(model, 1e-3, integrator)
    results = []
    for evaluate in (False, True):
        simulation.reset()
        for _ in range(30):
            simulation.step(5)
            if evaluate:
                model.sensor("middle_touch.approach_speed")
        results.append(state(model))
    np.testing.assert_array_equal(*results)


def test_simulations_with_different_integrators_use_their_own_contacts(three):
    """Normal forces of the compliant law return with a compliant integrator, and disappear again."""
    model, integrator = three
    hard = wc.Simulation(model, 2e-4, integrator)
    hard.reset()
    hard.step(1000)
    assert model.sensor("middle_touch.normal_force") == pytest.approx(G, rel=1e-6)
    soft = wc.Simulation(model, 2e-5)
    assert "middle_touch.impulse" not in model.sensor_names
    soft.step(5000)
    assert model.sensor("middle_touch.penetration") == pytest.approx(G / 1e5, rel=1e-2)
    assert model.sensor("middle.force")[:, 2] == pytest.approx(G, rel=1e-2)
    hard.step(1)
    # An existing contact has at least the impulse of g h per unit mass.
    assert (model.sensor("middle_touch.normal_force") > 0.9 * G).all()
    force = model.sensor("middle_touch.friction_force")
    force[:, 2] += model.sensor("middle_touch.normal_force")
    assert model.sensor("middle.force") == pytest.approx(force)
