"""Nonsmooth body contact of curved solids with each other and with polyhedra: gaps, rest, rolling."""

import itertools
from typing import Any

import numpy as np
import pytest
import warp as wp
from convex_separation import SIZES, excess, separation, separation_along
from nonsmooth_scenes import G, rigid
from scipy.spatial.transform import Rotation

import warpcontact as wc

FORMS = {
    "sphere": wc.shapes.Sphere(SIZES["sphere"]),
    "capsule": wc.shapes.Capsule(*SIZES["capsule"]),
    "cylinder": wc.shapes.Cylinder(*SIZES["cylinder"]),
    "cone": wc.shapes.Cone(*SIZES["cone"]),
    "ellipsoid": wc.shapes.Ellipsoid(SIZES["ellipsoid"]),
    "box": wc.shapes.RoundedBox(SIZES["box"]),
}
CURVED = [name for name in FORMS if name != "box"]
#: Half of the gap at which a point counts as closed is left [m].
CLOSED = 1e-9


class Still(wc.Motion):
    """No motion under any forces."""

    @wp.func
    def displacement(p: Any, t: Any):
        """Returns the displacement at the time ``t``."""
        return wp.vec3d()


def moreau_jean(**options):
    return wc.integrators.MoreauJean(**options)


def test_smallest_gap_is_the_separation_of_the_solids(device):
    """Random poses of all pairs, with gaps and overlaps of 10 µm to 0.2 mm, within the margin of a pair at rest."""
    seconds = [*FORMS, "mesh"]
    pairs = list(itertools.product(CURVED, seconds))
    wanted = np.array([-2e-4, -1e-5, 1e-5, 5e-5])
    scene = wc.Scene()
    for i, (one, other) in enumerate(pairs):
        body = scene.add_body(1.0, (0.01,) * 3, name=f"body{i}", motion=Still())
        solid = scene.add_shape(body, FORMS[one])
        if other == "mesh":
            below = scene.add_surface(wc.meshes.box(2 * np.array(SIZES["box"])))
        else:
            below = scene.add_shape(None, FORMS[other])
        scene.add_body_contact(solid, below, rigid(mu=0.5), name=f"touch{i}")
    model = scene.build(envs=len(wanted), device=device, precision="float64")
    rng = np.random.default_rng(3)
    expected = np.empty((len(pairs), len(wanted)))
    normals, places = np.empty((len(pairs), len(wanted), 3)), []
    for i, (one, other) in enumerate(pairs):
        kind = "box" if other == "mesh" else other
        turns = Rotation.random(len(wanted), random_state=i)
        positions = rng.normal(size=(len(wanted), 3))
        for env, turn in enumerate(turns):
            # From far away towards the other solid, along the normal.
            position = 0.5 * positions[env] / np.linalg.norm(positions[env])
            for _ in range(2):
                gap, normal = separation(one, kind, position, turn.as_matrix())
                position = position + (wanted[env] - gap) * normal
            expected[i, env], normals[i, env] = separation(one, kind, position, turn.as_matrix())
            positions[env] = position
        places.append((one, kind, positions, turns.as_matrix()))
        model[f"body{i}.position"], model[f"body{i}.orientation"] = positions, turns.as_quat()
    wc.Simulation(model, dt=1e-3, integrator=moreau_jean()).step(1)
    for i, (one, kind, positions, turns) in enumerate(places):
        gaps, points = model.sensor(f"touch{i}.point_gap"), model.sensor(f"touch{i}.point")
        contact_normals = model.sensor(f"touch{i}.normal")
        for env, (position, turn) in enumerate(zip(positions, turns, strict=True)):
            case = f"{pairs[i]} {env}"
            deepest = np.nanargmin(gaps[env])
            gap, normal = gaps[env, deepest], normals[i, env]
            # A face of a polyhedron is preferred to an edge by 1e-3 of the size of the smaller solid, 0.1 m or more. Otherwise, the
            # grid finds no larger separation.
            bias = 1e-4 if kind == "box" else 1e-10
            assert expected[i, env] < gap + bias, case
            if gap > 0.0:
                assert gap == pytest.approx(expected[i, env], abs=max(bias, 1e-5)), case
            else:
                normal = contact_normals[env]
                along = separation_along(one, kind, position, turn, normal[None])
                # The deepest point is above a face, and the lowest one of the curved solid may be outside its outline.
                assert along < gap + 1e-10, case
                assert along > (expected[i, env] - bias if kind == "box" else gap - 1e-10), case
            # Both points are on their solids, so that the solids are not farther apart. The normal of the grid is less exact.
            on_second = points[env, deepest] - 0.5 * gap * normal
            on_first = turn.T @ (points[env, deepest] + 0.5 * gap * normal - position)
            tolerance = 1e-9 if kind != "box" and gap < 0.0 else 2e-4 * 0.2
            assert abs(excess(kind, on_second)) < tolerance, case
            assert abs(excess(one, on_first)) < tolerance, case


RADIUS, HALF, MASS = 0.1, 0.15, 5.0
#: Moments of inertia of a cylinder of these sizes across and along its axis, over its mass.
ACROSS, ALONG = (3 * RADIUS**2 + (2 * HALF) ** 2) / 12, RADIUS**2 / 2
LYING = Rotation.from_rotvec([np.pi / 2, 0, 0])


def rest_scene():
    """Cylinders on cylinders, standing, lying and crossed, cones, ellipsoids and capsules on boxes, meshes and cylinders.

    Returns the scene and for each body its start and the position of its center at rest, with NaN where friction decides.
    """
    scene = wc.Scene(gravity=(0, 0, -G))
    cylinder = wc.shapes.Cylinder(RADIUS, HALF)
    groove = np.sqrt((2 * RADIUS) ** 2 - 0.12**2)
    cone = wc.shapes.Cone(RADIUS, 0.2)
    ellipsoid = wc.shapes.Ellipsoid((0.12, 0.1, 0.05))
    table, box = wc.meshes.box((1.0, 1.0, 0.2)), wc.shapes.RoundedBox((0.5, 0.5, 0.1))
    lying = LYING.as_quat()
    upright = (0.0, 0.0, 0.0, 1.0)
    # Form, its offset along z from the center of mass, orientation, place at rest, and solids below it: forms and places.
    cases = {
        "standing": (cylinder, 0.0, upright, (0.03, 0.02, 2 * HALF), [(cylinder, upright, (0, 0, 0))]),
        "offset": (cylinder, 0.0, upright, (0.09, 0, 2 * HALF), [(cylinder, upright, (0, 0, 0))]),
        "lying": (cylinder, 0.0, lying, (0, 0, groove), [(cylinder, lying, (x, 0.05, 0)) for x in (-0.12, 0.12)]),
        "on_end": (cylinder, 0.0, lying, (0, 0.02, HALF + RADIUS), [(cylinder, upright, (0, 0, 0))]),
        "cone_on_box": (cone, -0.05, upright, (0, 0, 0.15), [(box, upright, (0, 0, 0))]),
        "cone_on_mesh": (cone, -0.05, upright, (0, 0, 0.15), [(table, upright, (0, 0, 0))]),
        "cone_on_cylinder": (cone, -0.05, upright, (0.02, 0, HALF + 0.05), [(cylinder, upright, (0, 0, 0))]),
        "ellipsoid": (ellipsoid, 0.0, upright, (0, 0, 0.15), [(box, upright, (0, 0, 0))]),
        "ellipsoid_on_mesh": (ellipsoid, 0.0, upright, (0, 0, 0.15), [(table, upright, (0, 0, 0))]),
        "capsule": (wc.shapes.Capsule(RADIUS, HALF), 0.0, lying, (0, 0.02, HALF + RADIUS), [(cylinder, upright, (0, 0, 0))]),
    }  # fmt: skip
    for number, (name, (form, offset, orientation, place, below)) in enumerate(cases.items()):
        shift = np.array([2.0 * number, 0, 0])
        inertia = MASS * np.array([ACROSS, ACROSS, ALONG])
        body = scene.add_body(MASS, inertia, position=shift + place, orientation=orientation, name=name)
        solid = scene.add_shape(body, form, position=(0, 0, offset))
        others = []
        for other, turn, at in below:
            if isinstance(other, wc.Mesh):
                others.append(scene.add_surface(other, position=shift + at, orientation=turn))
            else:
                others.append(scene.add_shape(None, other, position=shift + at, orientation=turn))
        scene.add_body_contact(solid, others, rigid(mu=0.5), name=f"{name}_touch")
    return scene, {name: case[3] for name, case in cases.items()}


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_curved_solids_rest_on_each_other(precision, device):
    """Each starts at rest, and dropped by 1 mm with a tilt of 1°, and ends at its height in closed form."""
    scene, places = rest_scene()
    model = scene.build(envs=2, device=device, precision=precision)
    tilt = Rotation.from_rotvec([0.01, 0.014, 0.0])
    for name in places:
        start, turn = model[f"{name}.position"][0], Rotation.from_quat(model[f"{name}.orientation"][0])
        model[f"{name}.position"] = np.stack([start, start + np.array([0, 0, 1e-3])])
        model[f"{name}.orientation"] = np.stack([turn.as_quat(), (tilt * turn).as_quat()])
    sim = wc.Simulation(model, dt=2e-3, integrator=moreau_jean())
    sim.step(1000)
    before = {name: model.sensor(f"{name}.position") for name in places}
    sim.step(250)
    # A gap of 1 µm counts as closed in float32, and positions 20 m away are rounded to 1e-6 m. The solver leaves 1e-5 of g h = 0.02 m/s
    # there, at arms of 0.05 m.
    height, speed, spin = (CLOSED, 1e-6, 1e-6) if precision == "float64" else (3e-6, 1e-6, 4e-6)
    for number, (name, place) in enumerate(places.items()):
        position = model.sensor(f"{name}.position")
        np.testing.assert_allclose(position[0], place + np.array([2.0 * number, 0, 0]), atol=height, err_msg=name)
        np.testing.assert_allclose(position[1, 2], place[2], atol=1e-4, err_msg=name)
        # Nothing stops the rolling of a cylinder or capsule on a flat end, and of an ellipsoid, after they were dropped.
        still = slice(0, 1 if name.startswith(("ellipsoid", "on_end", "capsule")) else 2)
        np.testing.assert_allclose(position[still], before[name][still], atol=1e-6, err_msg=name)
        assert np.abs(model.sensor(f"{name}.linear_velocity")[still]).max() < speed, name
        assert np.abs(model.sensor(f"{name}.angular_velocity")[still]).max() < spin, name
        force = model.sensor(f"{name}_touch.force").reshape(2, -1, 3)[still, :, 2].sum(axis=1)
        np.testing.assert_allclose(force, MASS * G, rtol=1e-6 if precision == "float64" else 1e-4, err_msg=name)


def test_log_pile_of_cylinders_stands_with_the_forces_of_statics(device):
    """Two cylinders side by side on a box carry a third: N = W/(2 cos 30° + 2 sin 30° tan 15°), friction N tan 15°."""
    scene = wc.Scene(gravity=(0, 0, -G))
    floor = scene.add_shape(None, wc.shapes.RoundedBox((1.0, 1.0, 0.1)), position=(0, 0, -0.1))
    cylinder = wc.shapes.Cylinder(RADIUS, HALF)
    places = [(-RADIUS, 0, RADIUS), (RADIUS, 0, RADIUS), (0, 0.03, RADIUS * (1 + np.sqrt(3)))]
    logs = []
    for i, place in enumerate(places):
        body = scene.add_body(
            MASS,
            MASS * np.array([ACROSS, ACROSS, ALONG]),
            position=place,
            orientation=LYING.as_quat(),
            name=f"log{i}",
        )
        logs.append(scene.add_shape(body, cylinder))
    for i in range(2):
        scene.add_body_contact(logs[i], floor, rigid(mu=0.5), name=f"floor{i}")
        scene.add_body_contact(logs[2], logs[i], rigid(mu=0.5), name=f"upper{i}")
    model = scene.build(envs=1, device=device, precision="float64")
    sim = wc.Simulation(model, dt=2e-3, integrator=moreau_jean())
    sim.step(1000)
    for i, place in enumerate(places):
        np.testing.assert_allclose(model.sensor(f"log{i}.position")[0], place, atol=1e-7)
        assert np.abs(model.sensor(f"log{i}.linear_velocity")).max() < 1e-6
        assert np.abs(model.sensor(f"log{i}.angular_velocity")).max() < 1e-6
    angle = np.pi / 12
    normal = 0.5 * MASS * G / (np.cos(2 * angle) + np.sin(2 * angle) * np.tan(angle))
    for i in range(2):
        np.testing.assert_allclose(model.sensor(f"upper{i}.normal_force"), normal, rtol=1e-5)
        friction = np.linalg.norm(model.sensor(f"upper{i}.friction_force"), axis=-1)
        np.testing.assert_allclose(friction, normal * np.tan(angle), rtol=1e-4)
        np.testing.assert_allclose(model.sensor(f"floor{i}.normal_force"), 1.5 * MASS * G, rtol=1e-5)


def test_cylinder_rolls_on_a_cylinder_without_slip_as_the_pendulum_that_it_is(device):
    """Down from the top of a fixed cylinder: θ̈ = 2 g sin θ/(3 (R + r)), with constant energy, until friction is used up."""
    scene = wc.Scene(gravity=(0, 0, -G))
    fixed = scene.add_shape(None, wc.shapes.Cylinder(2 * RADIUS, 2 * HALF), orientation=LYING.as_quat())
    body = scene.add_body(MASS, MASS * np.array([ACROSS, ACROSS, ALONG]), name="roll")
    solid = scene.add_shape(body, wc.shapes.Cylinder(RADIUS, HALF))
    scene.add_body_contact(solid, fixed, rigid(mu=1.0), name="touch")
    model = scene.build(envs=2, device=device, precision="float64")
    start, distance = 0.2, 3 * RADIUS
    model["roll.position"] = (distance * np.sin(start), 0, distance * np.cos(start))
    model["roll.orientation"] = LYING.as_quat()
    errors = []
    for dt in (1e-3, 5e-4):
        model.reset()
        sim = wc.Simulation(model, dt=dt, integrator=moreau_jean())
        sim.step(round(0.3 / dt))
        position, spin = model.sensor("roll.position")[0], model.sensor("roll.angular_velocity")[0]
        velocity = model.sensor("roll.linear_velocity")[0]
        angle = np.arctan2(position[0], position[2])
        # Without slip the speed of the center is r ω.
        np.testing.assert_allclose(np.linalg.norm(velocity), RADIUS * spin[1], rtol=1e-3)
        np.testing.assert_allclose(spin[[0, 2]], 0, atol=1e-8)
        energy = 0.75 * MASS * velocity @ velocity + MASS * G * position[2]
        errors.append(abs(energy / (MASS * G * distance * np.cos(start)) - 1.0))
        # θ̇² = 4 g (cos θ₀ − cos θ)/(3 (R + r))
        rate = np.sqrt(4 * G * (np.cos(start) - np.cos(angle)) / (3 * distance))
        np.testing.assert_allclose(np.linalg.norm(velocity), distance * rate, rtol=5e-3)
    assert errors[0] < 1e-3
    assert errors[1] < 0.6 * errors[0]
