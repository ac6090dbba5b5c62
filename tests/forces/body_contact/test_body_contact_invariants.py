"""Invariants of body contact: balance, symmetry, continuity, and independence of frame, triangulation and environment."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import warpcontact as wc

K = 1e8  # Pa/m
SIDE = 0.1  # m


def two_boxes(device, envs, *, free=False, sizes=((SIDE,) * 3, (SIDE,) * 3), mesh=False):
    """Returns a model of one box on another one, without friction."""
    scene = wc.Scene(gravity=(0, 0, 0))
    solids = []
    for name, size in zip(("upper", "lower"), sizes, strict=True):
        body = (
            scene.add_body(mass=1.0, inertia=(1, 1, 1), name=f"{name}_body") if free or name == "upper" else None
        )
        if mesh:
            solids.append(scene.add_surface(wc.meshes.box(size), body=body, name=name))
        else:
            solids.append(scene.add_shape(body, wc.shapes.RoundedBox(tuple(np.array(size) / 2)), name=name))
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K))
    scene.add_body_contact(*solids, material, name="press")
    return scene.build(envs=envs, device=device, precision="float64")


def poses(count, seed=3):
    """Returns random poses of an upper box that overlap a lower box centered at the origin."""
    rng = np.random.default_rng(seed)
    rotations = Rotation.random(count, random_state=seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return rng.uniform(0.6, 1.2, (count, 1)) * SIDE * directions, rotations.as_quat()


@pytest.mark.parametrize("mesh", [False, True])
def test_wrenches_of_two_free_bodies_balance(mesh, device):
    count = 300
    model = two_boxes(device, count, free=True, mesh=mesh)
    position, orientation = poses(count)
    model["upper_body.position"], model["upper_body.orientation"] = (
        position + np.array([1.0, -2.0, 0.5]),
        orientation,
    )
    model["lower_body.position"] = np.tile([1.0, -2.0, 0.5], (count, 1))
    dt = 1e-6
    wc.Simulation(model, dt=dt).step()
    momentum = sum(model.sensor(f"{name}_body.linear_velocity") for name in ("upper", "lower"))
    # Moments about the origin of the lower box; masses and inertias are 1.
    turn = sum(model.sensor(f"{name}_body.angular_velocity") for name in ("upper", "lower"))
    turn += np.cross(position, model.sensor("upper_body.linear_velocity"))
    touching = np.linalg.norm(model.sensor("press.force"), axis=1) > 0
    assert touching.sum() > count / 3
    scale = dt * np.linalg.norm(model.sensor("press.force"), axis=1).max()
    assert np.abs(momentum).max() < 1e-12 * scale
    assert np.abs(turn).max() < 1e-12 * scale


def test_exchanged_bodies_have_the_opposite_force(device):
    count = 200
    position, orientation = poses(count)
    model = two_boxes(device, count)
    model["upper_body.position"], model["upper_body.orientation"] = position, orientation
    # The lower box in the frame of the upper one.
    inverse = Rotation.from_quat(orientation).inv()
    exchanged = two_boxes(device, count)
    exchanged["upper_body.position"] = -inverse.apply(position)
    exchanged["upper_body.orientation"] = inverse.as_quat()
    force = model.sensor("press.force")
    back = -Rotation.from_quat(orientation).apply(exchanged.sensor("press.force"))
    # Rounding of coordinates, 1e-17 m, times stiffness and area of contact.
    np.testing.assert_allclose(back, force, atol=1e-9 * np.abs(force).max())
    touching = np.linalg.norm(force, axis=1) > 0
    of_exchanged, share = (one.sensor("press.reference")[touching] for one in (exchanged, model))
    np.testing.assert_allclose(of_exchanged, 1 - share, atol=1e-9)


def test_force_does_not_depend_on_the_world_frame(device):
    count = 100
    position, orientation = poses(count)
    turn, shift = Rotation.from_rotvec([0.3, -1.1, 0.7]), np.array([3.0, -2.0, 5.0])
    model = two_boxes(device, count)
    model["upper_body.position"], model["upper_body.orientation"] = position, orientation
    moved = two_boxes(device, count)
    moved["upper_body.position"] = turn.apply(position) + shift
    moved["upper_body.orientation"] = (turn * Rotation.from_quat(orientation)).as_quat()
    moved["lower.position"], moved["lower.orientation"] = shift, turn.as_quat()
    force = model.sensor("press.force")
    # Rounding of positions of 6 m, 1e-15 m, over the smallest depths.
    np.testing.assert_allclose(
        turn.inv().apply(moved.sensor("press.force")), force, atol=1e-8 * np.abs(force).max()
    )


def test_mesh_box_equals_box_shape(device):
    count = 200
    position, orientation = poses(count)
    results = []
    for mesh in (False, True):
        model = two_boxes(device, count, mesh=mesh)
        model["upper_body.position"], model["upper_body.orientation"] = position, orientation
        results.append([model.sensor(f"press.{key}") for key in ("force", "torque", "area", "depth")])
    for of_shape, of_mesh in zip(*results, strict=True):
        np.testing.assert_allclose(of_mesh, of_shape, atol=1e-10 * np.abs(of_shape).max())


def sweep(device, kind, count):
    """Returns forces of a box 1 mm deep in another one, whose pose changes in ``count`` equal steps."""
    x = np.linspace(0.0, 1.0, count)[:, None]
    position = np.array([0.0, 0.0, SIDE - 1e-3]) + 0 * x
    rotation = Rotation.identity(count)
    if kind == "offset":
        position = position + x * [1.05 * SIDE, 0.0, 0.0]
    elif kind == "yaw":
        rotation = Rotation.from_rotvec(x * [0, 0, np.pi / 2])
    elif kind == "tilt":
        rotation = Rotation.from_rotvec(x * [0, 0.2, 0])
    else:
        rotation = Rotation.from_rotvec(x * [0.9, 1.3, 0.4])
    model = two_boxes(device, count)
    model["upper_body.position"], model["upper_body.orientation"] = position, rotation.as_quat()
    return model.sensor("press.force")


@pytest.mark.parametrize("kind", ["offset", "yaw", "tilt", "tumble"])
def test_force_is_continuous_in_pose(kind, device):
    coarse, fine = (np.abs(np.diff(sweep(device, kind, n), axis=0)).max() for n in (401, 1601))
    # The largest change of a continuous force falls to a quarter with a quarter of the step; a jump stays.
    assert fine < 0.4 * coarse


@pytest.mark.parametrize("offset", [0.0, 1e-12, 1e-7, 1e-2])
def test_equal_boxes_carry_the_load_of_their_common_area(offset, device):
    model = two_boxes(device, 1)
    model["upper_body.position"] = [offset, 0.0, SIDE - 1e-3]
    expected = [0.0, 0.0, K * 1e-3 * SIDE * (SIDE - offset)]
    # Error of the depth by rounding: 1e-17 m of 1e-3 m.
    np.testing.assert_allclose(model.sensor("press.force")[0], expected, rtol=1e-12, atol=1e-9)


def test_force_of_scaled_mesh_boxes_grows_with_the_cube_of_the_scale(device):
    scales = np.array([1e-2, 1.0, 1e2])
    model = two_boxes(device, 3, mesh=True)
    rotation = Rotation.from_rotvec([0.1, 0.2, 0.3])
    model["upper.scale"], model["lower.scale"] = scales, scales
    model["upper_body.position"] = scales[:, None] * [0.01, 0.02, 1.1 * SIDE]
    model["upper_body.orientation"] = np.tile(rotation.as_quat(), (3, 1))
    force = model.sensor("press.force") / scales[:, None] ** 3
    assert np.linalg.norm(force[1]) > 0
    np.testing.assert_allclose(force, np.tile(force[1], (3, 1)), rtol=1e-10, atol=1e-10 * np.abs(force[1]).max())


def test_one_environment_equals_the_same_among_many_bitwise(device):
    count = 64
    position, orientation = poses(count)
    many = two_boxes(device, count)
    many["upper_body.position"], many["upper_body.orientation"] = position, orientation
    forces = many.sensor("press.force")
    one = two_boxes(device, 1)
    for i in range(0, count, 16):
        one["upper_body.position"], one["upper_body.orientation"] = position[i], orientation[i]
        np.testing.assert_array_equal(one.sensor("press.force")[0], forces[i])
