"""Shape contact in a scene against hand values, closed forms, and the same contact on a mesh."""

import itertools
import json
import warnings
from typing import Any

import numpy as np
import pytest
import warp as wp
from scenes import square
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation
from warpcontact.kernels.shapes import base

import warpcontact as wc

NAMES = ("separated", "penetrating", "deep")
RUBBER = wc.ContactMaterial(
    law=wc.laws.HuntCrossley(stiffness=1e5, exponent=1.5, restitution=0.7),
    friction=wc.friction.CundallStrack(mu_static=0.4, mu_dynamic=0.4, stiffness=2e4, damping=5.0),
    rolling=wc.friction.Tanh(mu=0.01, velocity_scale=1e-2),
    torsion=wc.friction.Tanh(mu=0.4, velocity_scale=1e-2),
)
STEEL = wc.ContactMaterial(law=wc.laws.HuntCrossley(stiffness=1e7, exponent=1.5, restitution=1.0))
SENSORS = ("gap", "normal", "normal_force", "friction_force", "torque", "slip_speed", "approach_speed", "point")


@pytest.fixture(scope="module")
def oracle(shared):
    return json.loads((shared / "spec" / "oracle_kinematics.json").read_text())


@pytest.mark.parametrize(("precision", "tolerance"), [("float32", 2e-6), ("float64", 1e-12)])
def test_tilted_ellipsoids_match_reference(oracle, device, precision, tolerance):
    scene = wc.Scene(gravity=(0, 0, 0))
    i, j = (scene.add_body(1.0, (1.0, 1.0, 1.0), name=name) for name in "ij")
    first = scene.add_shape(i, wc.shapes.Ellipsoid((1.0, 0.6, 0.4)))
    second = scene.add_shape(j, wc.shapes.Ellipsoid((0.8, 0.5, 0.3)))
    scene.add_shape_contact(second, first, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0)), name="touch")
    model = scene.build(3, device, precision)
    model["j.position"] = [oracle[name]["c_j"] for name in NAMES]
    velocity = oracle["separated"]["velocity"]
    for body in "ij":
        turns = [oracle[name][f"A_{body}"] for name in NAMES]
        model[f"{body}.orientation"] = Rotation.from_matrix(turns).as_quat()
        model[f"{body}.linear_velocity"] = velocity[f"v_{body}"]
        model[f"{body}.angular_velocity"] = velocity[f"w_{body}"]
    for quantity, key in (("gap", "gap"), ("point_a", "P_j"), ("point_b", "P_i"), ("normal", "n_i")):
        expected_value = [oracle[name][key] for name in NAMES]
        np.testing.assert_allclose(model.sensor(f"touch.{quantity}"), expected_value, rtol=0, atol=tolerance)
    # The approach speed at K equals that of both points, because they lie on one normal.
    rates = [-oracle[name]["velocity"]["gap_rate"] for name in NAMES[1:]]
    np.testing.assert_allclose(model.sensor("touch.approach_speed")[1:], rates, rtol=0, atol=tolerance)
    assert model.sensor("touch.status").tolist() == [
        wc.ContactStatus.OPEN,
        wc.ContactStatus.CONTACT,
        wc.ContactStatus.CONTACT,
    ]
    assert model.sensor("touch.converged").tolist() == [1, 1, 1]
    np.testing.assert_allclose(model.sensor("touch.normal_force")[0], 0.0)
    depths = [-oracle[name]["gap"] for name in NAMES[1:]]
    np.testing.assert_allclose(model.sensor("touch.normal_force")[1:], depths, rtol=tolerance * 10)


@pytest.mark.slow
def test_pose_derivatives_match_differences_of_sensors(device):
    model = two_ellipsoids(device, "float64", envs=1)
    model["b.position"] = (0.05, 0.03, 0.29)
    for quantity in ("gap", "normal", "point_a", "point_b"):
        # Derivatives with respect to the body of the first shape, b: position, then rotation about its center of
        # mass.
        for key, given in (("position", model["b.position"]), ("orientation", model["b.orientation"])):
            by = "position" if key == "position" else "rotation"
            expected_value = model.sensor(f"touch.{quantity}_by_{by}_a")[0]
            for axis, way in enumerate(np.eye(3)):
                ends = []
                for step in (-1e-5, 1e-5):
                    if key == "position":
                        model["b.position"] = given + step * way
                    else:
                        turned = Rotation.from_rotvec(step * way) * Rotation.from_quat(given)
                        model["b.orientation"] = turned.as_quat()
                    ends.append(model.sensor(f"touch.{quantity}")[0])
                model[f"b.{key}"] = given
                # Central differences: error of the square of the step, and of rounding divided by the step.
                difference = (ends[1] - ends[0]) / 2e-5
                np.testing.assert_allclose(expected_value[..., axis], difference, rtol=1e-6, atol=1e-7)
    axes = model["shape_a.semi_axes"]
    for axis, way in enumerate(np.eye(3)):
        ends = []
        for step in (-1e-5, 1e-5):
            model["shape_a.semi_axes"] = axes + step * way
            ends.append(model.sensor("touch.gap")[0])
        model["shape_a.semi_axes"] = axes
        expected_value = model.sensor("touch.gap_by_semi_axes_b")[0, axis]
        assert expected_value == pytest.approx((ends[1] - ends[0]) / 2e-5, rel=1e-6, abs=1e-7)
    recording = wc.Simulation(model, dt=1e-4).run(
        1e-3, ["touch.point_a_by_rotation_b", "touch.gap_by_semi_axes_a"]
    )
    assert recording["touch.point_a_by_rotation_b"].dims == ("time", "env", "row", "column")


def sphere_on_plane(smooth, device, precision, envs=1, bullet=False):
    """A ball above a plane; ``bullet`` adds a body that flies between plates in all environments but one."""
    scene = wc.Scene()
    moving = {"linear_velocity": (1.0, 0.2, 0), "angular_velocity": (0, 3.0, 5.0)}
    ball = scene.add_body(0.5, (5e-4, 5e-4, 5e-4), (0, 0, 0.06), **moving, name="ball")
    if smooth:
        sphere = scene.add_shape(ball, wc.shapes.Sphere(0.05), name="sphere")
        scene.add_shape_contact(
            sphere, scene.add_shape(None, wc.shapes.Plane(), name="floor"), RUBBER, name="touch"
        )
    else:
        ground = scene.add_surface(square(10.0))
        scene.add_contact(scene.add_point(ball, (0, 0, 0)), ground, RUBBER, radius=0.05, name="touch")
    if bullet:
        flying = scene.add_body(0.1, (1e-4, 1e-4, 1e-4), (20, 0, 0.1), name="bullet")
        tip = scene.add_point(flying, (0, 0, 0))
        material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e6))
        for name, height, turn in (("low", 0.0, (0, 0, 0, 1)), ("high", 0.2, (1, 0, 0, 0))):
            plate = scene.add_surface(square(1.0), position=(20, 0, height), orientation=turn)
            scene.add_contact(tip, plate, material, swept=True, name=name)
    model = scene.build(envs, device, precision)
    if bullet:
        model["bullet.linear_velocity"] = [(0, 0, 0)] + [(0, 0, -20.0)] * (envs - 1)
    return model


def test_sphere_shape_on_plane_matches_flat_mesh(device):
    runs = []
    for smooth in (True, False):
        sim = wc.Simulation(sphere_on_plane(smooth, device, "float64"), dt=2e-4)
        # The ball falls, slides, spins and rolls, with models of which one has history.
        names = [f"touch.{name}" for name in SENSORS]
        runs.append(sim.run(0.5, [*names, "ball.angular_velocity"], every=1e-2))
    smooth, mesh = runs
    assert (smooth["touch.normal_force"] > 0).sum() > 20
    for name in (*names, "ball.angular_velocity"):
        # Both use the same values in the same formulas; the mesh rounds its vertices in addition.
        scale = float(np.abs(mesh[name]).max())
        np.testing.assert_allclose(smooth[name], mesh[name], rtol=0, atol=1e-9 * scale, err_msg=name)


def spheres(positions, velocities, radius, device, material=STEEL, precision="float64", envs=1):
    """Returns the model of spheres in a row, each in contact with the next."""
    scene = wc.Scene(gravity=(0, 0, 0))
    shapes = []
    for number, (x, v) in enumerate(zip(positions, velocities, strict=True)):
        inertia = (0.4 * radius**2,) * 3
        body = scene.add_body(1.0, inertia, (x, 0, 0), linear_velocity=(v, 0, 0), name=f"ball_{number}")
        shapes.append(scene.add_shape(body, wc.shapes.Sphere(radius), name=f"sphere_{number}"))
    for number, (shape, other) in enumerate(itertools.pairwise(shapes)):
        scene.add_shape_contact(shape, other, material, name=f"touch_{number}")
    return scene.build(envs, device, precision)


def test_impact_of_two_sphere_shapes_conserves_momentum_and_has_restitution(device):
    model = spheres((-0.1001, 0.1001), (1.0, -0.5), 0.1, device, envs=3)
    wanted = np.array([1.0, 0.7, 0.3])
    model["touch_0.law.restitution"] = wanted
    energy, momentum = (model.sensor(f"scene.{name}") for name in ("kinetic_energy", "linear_momentum"))
    sim = wc.Simulation(model, dt=1e-5)
    sim.step(1000)
    assert (model.sensor("touch_0.gap") > 0).all()
    velocity = [model.sensor(f"ball_{number}.linear_velocity")[:, 0] for number in range(2)]
    # Steps are 1/350 of the contact; the error of semi-implicit Euler is their square.
    np.testing.assert_allclose((velocity[1] - velocity[0]) / 1.5, wanted, atol=2e-3)
    np.testing.assert_allclose(model.sensor("scene.linear_momentum"), momentum, atol=1e-12)
    np.testing.assert_allclose(model.sensor("scene.kinetic_energy")[0], energy[0], rtol=1e-4)


def test_chain_of_sphere_shapes_conserves_momentum_and_energy(device):
    radius = 0.1
    model = spheres(2 * radius * np.arange(5) - [1e-4, 0, 0, 0, 0], (1.0, 0, 0, 0, 0), radius, device)
    sim = wc.Simulation(model, dt=5e-6)
    sim.step(6000)
    assert model.sensor("scene.linear_momentum")[0, 0] == pytest.approx(1.0, abs=1e-12)
    # Symplectic steps of 1/700 of a contact.
    assert model.sensor("scene.kinetic_energy")[0] == pytest.approx(0.5, rel=1e-4)
    # All contacts act at the same time, so the last sphere does not take all of the speed, unlike in sequential
    # impacts.
    last = model.sensor("ball_4.linear_velocity")[0, 0]
    assert last == pytest.approx(chain_of_hertz_springs(5)[-1], abs=1e-4)
    assert last < 0.99


def chain_of_hertz_springs(count):
    """Returns the velocities of touching balls of 1 kg after the first arrives with 1 m/s."""

    def rates(_, state):
        x, v = np.split(state, 2)
        force = 1e7 * np.maximum(x[:-1] - x[1:], 0.0) ** 1.5
        return np.concatenate([v, np.append(0.0, force) - np.append(force, 0.0)])

    start = np.zeros(2 * count)
    start[count] = 1.0
    return solve_ivp(rates, (0.0, 0.1), start, rtol=1e-10, atol=1e-13, max_step=1e-4).y[count:, -1]


def test_meshed_spheres_converge_to_the_sphere_shape(device):
    errors = []
    place = np.array([0.2, 0.15, 1.09])
    for level in (2, 3, 4):
        scene = wc.Scene(gravity=(0, 0, 0))
        ball = scene.add_body(1.0, (0.1, 0.1, 0.1), name="ball")
        material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0))
        meshed = scene.add_surface(wc.meshes.icosphere(1.0, level))
        scene.add_contact(scene.add_point(ball, (0, 0, 0)), meshed, material, radius=0.2, name="mesh")
        shapes = [scene.add_shape(body, wc.shapes.Sphere(r)) for body, r in ((ball, 0.2), (None, 1.0))]
        scene.add_shape_contact(*shapes, material, name="smooth")
        model = scene.build(20, device, "float64")
        turns = Rotation.random(20, random_state=1)
        model["ball.position"] = turns.apply(place)
        error = np.abs(model.sensor("mesh.gap") - model.sensor("smooth.gap"))
        # To the millimeter of the facets; exact for the sphere.
        np.testing.assert_allclose(model.sensor("smooth.gap"), np.linalg.norm(place) - 1.2, atol=1e-14)
        errors.append(error.mean())
    # Halving the edge length divides the error by four.
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2.0, atol=0.2)


def two_ellipsoids(device, precision="float32", envs=4):
    """Two ellipsoids that collide obliquely, spin, stick, slide and separate."""
    scene = wc.Scene(gravity=(0, 0, 0))
    moving = {"linear_velocity": (0.5, 0.1, -2.0), "angular_velocity": (2, 1, 5)}
    bodies = [
        scene.add_body(1.0, (0.02, 0.03, 0.04), (0, 0, 0), name="a"),
        scene.add_body(0.5, (0.01, 0.03, 0.02), (0.25, 0.1, 0.42), **moving, name="b"),
    ]
    axes = ((0.3, 0.2, 0.2), (0.25, 0.15, 0.1))
    shapes = [
        scene.add_shape(body, wc.shapes.Ellipsoid(size), name=f"shape_{body.name}")
        for body, size in zip(bodies, axes, strict=True)
    ]
    material = wc.ContactMaterial(
        law=wc.laws.HuntCrossley(stiffness=1e5, exponent=1.5, restitution=0.7),
        friction=wc.friction.CundallStrack(mu_static=0.4, mu_dynamic=0.4, stiffness=2e4, damping=5.0),
    )
    scene.add_shape_contact(shapes[1], shapes[0], material, name="touch")
    model = scene.build(envs, device, precision)
    model["shape_a.semi_axes"] = np.array(axes[0]) * np.linspace(0.99, 1.0, envs)[:, None]
    return model


def state_of(model):
    return {name: array.numpy().copy() for name, array in vars(model.state).items()}


def test_shape_contact_conserves_momentum(device):
    model = two_ellipsoids(device, "float64")
    names = ("linear_momentum", "angular_momentum")
    before = {name: model.sensor(f"scene.{name}") for name in names}
    recording = wc.Simulation(model, dt=1e-4).run(0.2, ["touch.normal_force", "touch.friction_force"])
    assert (recording["touch.normal_force"].max("time") > 0).all()
    assert (np.abs(recording["touch.friction_force"]).max(("time", "axis")) > 0).all()
    np.testing.assert_allclose(model.sensor("scene.linear_momentum"), before["linear_momentum"], atol=1e-12)
    # Rotations are integrated to second order. An unbalanced torque would be of the size of the impact.
    np.testing.assert_allclose(model.sensor("scene.angular_momentum"), before["angular_momentum"], atol=1e-4)


def test_shape_contact_results_do_not_depend_on_graphs_slices_and_threads(device):
    runs = []
    for options in ({}, {"capture_graphs": False}, {"threads": 1}, {"threads": 2, "distance_cache": False}):
        model = two_ellipsoids(device, envs=5)
        wc.Simulation(model, dt=1e-4, deterministic=True, **options).step(1500)
        runs.append(state_of(model))
    for name, values in runs[0].items():
        assert np.isfinite(values).all()
        for other in runs[1:]:
            np.testing.assert_array_equal(values, other[name], err_msg=name)
    alone = two_ellipsoids(device, envs=1)
    alone["shape_a.semi_axes"] = (0.3, 0.2, 0.2)
    wc.Simulation(alone, dt=1e-4).step(1500)
    np.testing.assert_array_equal(state_of(alone)["body_position"][0], runs[0]["body_position"][-1])


def test_reset_clears_shape_contact_history_of_masked_environments(device):
    model = two_ellipsoids(device)
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(1075)
    stretched = model.sensor("touch.friction.spring")
    assert (np.abs(stretched).max(axis=1) > 0).all()
    sim.reset([True, False, True, False])
    np.testing.assert_array_equal(model.sensor("touch.friction.spring")[::2], 0.0)
    np.testing.assert_array_equal(model.sensor("touch.friction.spring")[1::2], stretched[1::2])
    sim.reset()
    sim.step(1500)
    again = two_ellipsoids(device)
    wc.Simulation(again, dt=1e-4).step(1500)
    for name, values in state_of(model).items():
        np.testing.assert_array_equal(values, state_of(again)[name], err_msg=name)


@pytest.mark.slow
def test_shape_contacts_on_several_devices_equal_one_device(device):
    """Contact history, results and failure counts of each environment equal those of the model on one device."""
    runs = []
    for where in (device, [device, device]):
        model = two_ellipsoids(where, envs=5)
        sim = wc.Simulation(model, dt=1e-4, deterministic=True)
        names = (
            "touch.gap",
            "touch.point",
            "touch.friction.spring",
            "touch.curvature_2",
            "touch.gap_by_position_a",
        )
        recording = sim.run(0.12, [*names, "a.position"], every=1e-3)
        sim.reset([True, False, False, False, True])
        sim.step(200)
        runs.append((model, recording))
    (whole, together), (split, apart) = runs
    assert [part.envs for part in split.parts] == [3, 2]
    assert (np.abs(together["touch.friction.spring"]).max(("time", "axis")) > 0).all()
    for name in (*names, "a.position"):
        np.testing.assert_array_equal(apart[name], together[name], err_msg=name)
        np.testing.assert_array_equal(split.sensor(name), whole.sensor(name), err_msg=name)
    assert (split["shape_a.semi_axes"] == whole["shape_a.semi_axes"]).all()
    assert split.unsolved_contacts()["touch"].shape == (5,)


def test_shape_contact_with_substeps_has_the_history_of_mesh_contact(device):
    """If a bullet crosses plates, substeps have the same effect on a shape contact as on a mesh contact."""
    names = [f"touch.{name}" for name in (*SENSORS, "friction.spring")]
    runs = []
    for smooth in (True, False):
        model = sphere_on_plane(smooth, device, "float64", envs=2, bullet=True)
        sim = wc.Simulation(model, dt=2e-4, crossing_substeps=4)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", wc.ContactWarning)  # the step is long for the plates, on purpose
            runs.append(sim.run(0.2, names, every=1e-3))
        assert (model.sensor("low.crossings") > 5).tolist() == [False, True]
    smooth, mesh = runs
    for name in names:
        scale = float(np.abs(mesh[name]).max())
        assert scale > 0, name
        # As without the bullet.
        np.testing.assert_allclose(smooth[name], mesh[name], rtol=0, atol=1e-9 * scale, err_msg=name)
    # Shorter steps do change the result.
    force = smooth["touch.normal_force"].values
    assert np.abs(force[:, 0] - force[:, 1]).max() > 1e-6 * force.max()


def test_shape_contact_of_sets_has_one_contact_per_item(device):
    scene = wc.Scene()
    grains = scene.add_bodies([(x, 0.0, 0.1) for x in range(4)], mass=1.0, inertia=(1.0, 1.0, 1.0), name="grains")
    others = scene.add_bodies([(x, 0.1, 0.1) for x in range(4)], mass=1.0, inertia=(1.0, 1.0, 1.0))
    radii = np.array([0.05, 0.1, 0.12, 0.2])
    sizes = scene.add_shape(grains, [wc.shapes.Sphere(radius) for radius in radii], name="sizes")
    alike = scene.add_shape(others, wc.shapes.Sphere(0.05))
    floor = scene.add_shape(None, wc.shapes.Plane())
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3))
    scene.add_shape_contact(sizes, floor, material, name="on_floor")
    scene.add_shape_contact(floor, alike, material, name="under")
    scene.add_shape_contact(sizes, alike, material, name="pairs")
    model = scene.build(2, device, "float64")
    np.testing.assert_allclose(model.sensor("on_floor.gap"), [0.1 - radii] * 2, atol=1e-15)
    np.testing.assert_allclose(model.sensor("pairs.gap"), [0.05 - radii] * 2, atol=1e-15)
    np.testing.assert_allclose(model.sensor("under.gap"), 0.05)
    np.testing.assert_allclose(model.sensor("under.normal"), np.broadcast_to([0, 0, -1.0], (2, 4, 3)))
    np.testing.assert_allclose(
        model.sensor("grains.force")[..., 2], 1e3 * np.maximum(radii - 0.1, 0.0) * [[1], [1]]
    )
    model["sizes.radius"] = [[0.1] * 4, [0.11] * 4]
    np.testing.assert_allclose(model.sensor("on_floor.gap"), [[0.0] * 4, [-0.01] * 4], atol=1e-15)
    wc.Simulation(model, dt=1e-3).run(0.01, ["pairs.gap", "on_floor.point"])


def test_shape_contact_status_has_documented_codes(device):
    model = sphere_on_plane(True, device, "float32", envs=4)
    model["ball.position"] = [(0, 0, 0.06), (0, 0, 0.045), (0, 0, 0.01), (0, 0, 0.045)]
    model["touch.max_depth"] = 0.02
    model["touch.enabled"] = [True, True, True, False]
    codes = [
        wc.ContactStatus.OPEN,
        wc.ContactStatus.CONTACT,
        wc.ContactStatus.WRONG_SIDE,
        wc.ContactStatus.DISABLED,
    ]
    assert model.sensor("touch.status").tolist() == codes
    np.testing.assert_array_equal(model.sensor("touch.normal_force") > 0, [False, True, False, False])
    np.testing.assert_allclose(model.sensor("touch.gap"), [0.01, -0.005, -0.04, np.nan], rtol=1e-5)


def test_shape_contact_gap_is_invariant_far_from_the_origin(device):
    gaps = []
    for far in (0.0, 3.0e6):
        model = sphere_on_plane(True, device, "float32")
        model["floor.position"] = (far, -far, far)
        model["ball.position"] = (far, -far, far + 0.0499)
        gaps.append(model.sensor("touch.gap")[0])
    assert gaps[0] == pytest.approx(-1e-4, rel=1e-5)
    # Two float32 numbers resolve 2^-48 of 3000 km.
    assert gaps[1] == pytest.approx(gaps[0], abs=2e-8)


def test_shape_contact_warns_of_too_long_step_and_initial_overlap():
    model = sphere_on_plane(True, "cpu", "float32", envs=2)
    model["ball.position"] = [(0, 0, 0.06), (0, 0, 0.03)]
    with pytest.warns(wc.ContactWarning) as said:
        wc.Simulation(model, dt=5e-3).step(1)
    texts = [str(one.message) for one in said]
    assert any("touch: dt = 0.005 s is too long: a contact lasts" in text for text in texts)
    assert any("touch: initial penetration is 0.02 m in environment 1" in text for text in texts)


def test_hertz_stiffness_of_crossed_cylinder_shapes_matches_closed_form(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    law = wc.laws.HertzElastic(modulus=1e9)
    depth, quarter = 1e-4, (0.5**0.5, 0, 0, 0.5**0.5)
    for number, (angle, radii) in enumerate([(0.5 * np.pi, (0.1, 0.1)), (np.pi / 3, (0.1, 0.05))]):
        # One axis is along y, the other is rotated from there about z.
        body = scene.add_body(1.0, (1.0, 1.0, 1.0), (number, 0, sum(radii) - depth), name=f"body_{number}")
        turned = (Rotation.from_rotvec((0, 0, angle)) * Rotation.from_quat(quarter)).as_quat()
        lower = scene.add_shape(None, wc.shapes.Cylinder(radii[0], 1.0), (number, 0, 0), quarter)
        upper = scene.add_shape(body, wc.shapes.Cylinder(radii[1], 1.0), (0, 0, 0), turned)
        scene.add_shape_contact(upper, lower, wc.ContactMaterial(law=law), name=f"touch_{number}")
    model = scene.build(1, device, "float64")
    # With equal radii at right angles, the stiffness is that of a sphere on a plane.
    expected_value = 4 / 3 * 1e9 * np.sqrt(0.1) * depth**1.5
    assert model.sensor("touch_0.normal_force")[0] == pytest.approx(expected_value, rel=1e-6)
    # A + B and B − A of the two, after Johnson, Contact Mechanics (4.3).
    first, second = 1 / 0.1, 1 / 0.05
    apart = np.sqrt(first**2 + second**2 + 2 * first * second * np.cos(2 * np.pi / 3))
    curvatures = [0.5 * (first + second - apart), 0.5 * (first + second + apart)]
    found = [model.sensor(f"touch_1.curvature_{number}")[0] for number in (1, 2)]
    np.testing.assert_allclose(found, curvatures, rtol=1e-9)
    # The same plane-strain modulus for all: E = 1 − ν², the other body rigid.
    elliptic = wc.laws.Hertz.elliptic(1e9, 0.0, 1 / curvatures[0], 1 / curvatures[1])
    assert model.sensor("touch_1.normal_force")[0] == pytest.approx(elliptic.stiffness * depth**1.5, rel=1e-5)


class Odd(wc.shapes.Shape):
    """Inherits the kind of a sphere, with a support function that has no maximum."""

    radius: float = wc.parameter("m", "radius", above=0.0)

    @wp.func
    def support(p: Any, n: wp.vec3d):
        return wp.vec3d(p.radius * n[1], -p.radius * n[0], wp.float64(0.0))

    @wp.func
    def expand(p: Any, n: wp.vec3d):
        found = base.SupportExpansion()
        found.point = wp.vec3d(p.radius * n[1], -p.radius * n[0], wp.float64(0.0))
        return found

    @wp.func
    def margin(p: Any):
        return wp.float64(0.0)

    @wp.func
    def rolling_ball_radius(p: Any):
        return wp.float64(0.0)

    @wp.func
    def extents(p: Any):
        return wp.vec3d(p.radius, p.radius, p.radius)

    @wp.func
    def inscribed_center(p: Any):
        return wp.vec3d()

    @wp.func
    def inscribed_radius(p: Any):
        return p.radius


def test_unconverged_shape_contact_has_no_force_and_warns(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(1.0, (1.0, 1.0, 1.0), (0.1, 0.05, 0.3), name="body")
    egg = scene.add_shape(body, wc.shapes.Ellipsoid((0.3, 0.2, 0.1)), name="egg")
    odd = scene.add_shape(None, Odd(0.3), name="odd")
    scene.add_shape_contact(egg, odd, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3)), name="touch")
    model = scene.build(2, device)
    model["touch.enabled"] = [False, True]
    with pytest.warns(RuntimeWarning, match="'egg' and 'odd' did not converge in 1 of 2 environments"):
        recording = wc.Simulation(model, dt=1e-4).run(
            1e-3, ["touch.status", "touch.normal_force", "touch.failures"]
        )
    assert (recording["touch.status"].sel(env=1) == wc.ContactStatus.NOT_CONVERGED).all()
    assert (recording["touch.normal_force"] == 0.0).all()
    assert recording["touch.failures"].values[-1].tolist() == [0, 10]
    assert "touch.curvature_1" not in model.sensor_names
    model.reset()
    assert model.sensor("touch.failures").tolist() == [0, 0]


def test_invalid_shape_input_is_refused_with_its_name():
    scene = wc.Scene()
    body = scene.add_body(1.0, (1.0, 1.0, 1.0), name="body")
    grains = scene.add_bodies(np.zeros((3, 3)), mass=1.0, inertia=(1.0, 1.0, 1.0), name="grains")
    ball, floor = (
        scene.add_shape(body, wc.shapes.Sphere(0.1), name="ball"),
        scene.add_shape(None, wc.shapes.Plane()),
    )
    several, few = (
        scene.add_shape(bodies, wc.shapes.Sphere(0.1))
        for bodies in (grains, scene.add_bodies(np.zeros((2, 3)), mass=1.0, inertia=(1.0, 1.0, 1.0)))
    )
    material = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0))
    with pytest.raises(TypeError, match=r"form of 'x' must be an instance of a class of wc\.shapes, got 0\.1"):
        scene.add_shape(body, 0.1, name="x")
    with pytest.raises(ValueError, match=r"x.position must be 3 numbers"):
        scene.add_shape(body, wc.shapes.Sphere(0.1), (0, 0), name="x")
    with pytest.raises(ValueError, match=r"form of 'x' must be one form or 3, one for each body, got a list of 2"):
        scene.add_shape(grains, [wc.shapes.Sphere(0.1)] * 2, name="x")
    with pytest.raises(ValueError, match="of one class for all bodies, got Sphere and Plane"):
        scene.add_shape(grains, [wc.shapes.Sphere(0.1), wc.shapes.Plane(), wc.shapes.Sphere(0.1)])
    with pytest.raises(ValueError, match=r"x.mask must be a whole number from 0 to 0xffffffff"):
        scene.add_shape(body, wc.shapes.Sphere(0.1), name="x", mask=-1)
    with pytest.raises(ValueError, match="both shapes are fixed to body 'body'"):
        scene.add_shape_contact(ball, scene.add_shape(body, wc.shapes.Plane()), material)
    with pytest.raises(ValueError, match="two sets of shapes must have the same size, got 3"):
        scene.add_shape_contact(several, few, material)
    with pytest.raises(
        ValueError, match=r"other_shape of 'x' must come from add_shape of this scene, got Body 'body'"
    ):
        scene.add_shape_contact(ball, body, material, name="x")
    with pytest.raises(TypeError, match=r"material of 'x' must be a wc\.ContactMaterial"):
        scene.add_shape_contact(ball, floor, material.law, name="x")
    with pytest.raises(ValueError, match=r"x.kappa must be at least 0 and at most 1, got 2"):
        scene.add_shape_contact(ball, floor, material, kappa=2.0, name="x")
    with pytest.raises(ValueError, match=r"x.torsion_radius is given, but its material has no torsion"):
        scene.add_shape_contact(ball, floor, material, torsion_radius=0.1, name="x")
    area = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e6))
    with pytest.raises(ValueError, match="was given no area"):
        scene.add_shape_contact(ball, floor, area)
    assert scene.shape_contacts == []
    scene.add_shape_contact(ball, floor, material, name="touch")
    model = scene.build(2, "cpu")
    with pytest.raises(ValueError, match=r"ball.radius must be greater than 0"):
        model["ball.radius"] = -1.0
    with pytest.raises(KeyError, match="sensor"):
        model["touch.gap"]
    with pytest.raises(KeyError, match=r"there are|did you mean|has"):
        model["touch.law.restitution"]
