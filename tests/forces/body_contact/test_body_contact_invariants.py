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


def triangulated_box(size, seed):
    """Returns a box whose sides are triangulated at random: points on edges and sides, and random diagonals."""
    rng = np.random.default_rng(seed)
    half = np.array(size) / 2
    splits = [np.r_[-1.0, np.sort(rng.uniform(-0.9, 0.9, rng.integers(0, 3))), 1.0] for _ in range(3)]
    vertices, faces = [], []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        u, v = splits[first], splits[second]
        for sign in (-1.0, 1.0):
            for i in range(len(u) - 1):
                for k in range(len(v) - 1):
                    corners = np.zeros((4, 3))
                    corners[:, axis] = sign
                    corners[:, first] = [u[i], u[i + 1], u[i + 1], u[i]]
                    corners[:, second] = [v[k], v[k], v[k + 1], v[k + 1]]
                    corners = corners if sign > 0 else corners[::-1]
                    start = len(vertices)
                    vertices += list(corners)
                    kind = rng.integers(0, 3)
                    if kind == 2:
                        # A point inside, with one triangle for each edge.
                        vertices.append(rng.dirichlet(np.ones(4)) @ corners)
                        faces += [[start + m, start + (m + 1) % 4, start + 4] for m in range(4)]
                    elif kind == 1:
                        faces += [[start, start + 1, start + 2], [start, start + 2, start + 3]]
                    else:
                        faces += [[start + 1, start + 2, start + 3], [start + 1, start + 3, start]]
    return wc.Mesh(half * np.array(vertices), np.array(faces))


def test_force_does_not_depend_on_the_triangulation_of_a_box(device):
    """Each environment has other triangulations of the same two boxes."""
    count, meshes = 60, 10
    size = (SIDE, 0.8 * SIDE, 1.3 * SIDE)
    position, orientation = poses(count)
    results = []
    for seed in (0, 1):
        scene = wc.Scene(gravity=(0, 0, 0))
        body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="upper_body")
        boxes = [triangulated_box(size, 100 * seed + i) for i in range(meshes)]
        upper = scene.add_surface(boxes if seed else [wc.meshes.box(size)], body, name="upper")
        lower = scene.add_surface(boxes[::-1] if seed else [wc.meshes.box(size)], name="lower")
        material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K))
        scene.add_body_contact(upper, lower, material, name="press")
        model = scene.build(envs=count, device=device, precision="float64")
        model["upper_body.position"], model["upper_body.orientation"] = position, orientation
        if seed:
            model["upper.mesh"] = model["lower.mesh"] = np.arange(count) % meshes
        results.append([model.sensor(f"press.{key}") for key in ("force", "torque", "area", "depth", "reference")])
    assert (np.linalg.norm(results[0][0], axis=1) > 0).sum() > count / 3
    for plain, other in zip(*results, strict=True):
        # Rounding of points on edges and sides, 1e-17 m, over the smallest depths.
        np.testing.assert_allclose(other, plain, atol=1e-9 * np.abs(plain).max())


def test_tilted_box_has_no_side_force_on_a_box_as_on_a_plane(device):
    """Without friction, an edge or a vertex of a box on a face is pushed along the normal of the face."""
    count = 90
    rng = np.random.default_rng(4)
    tilts = np.radians(np.tile([0.1, 1.0, 5.0, 15.0, 30.0, 45.0], count // 6))
    turns = Rotation.from_rotvec(np.column_stack([np.zeros((count, 2)), rng.uniform(0, 2 * np.pi, count)]))
    axes = rng.normal(size=(count, 2))
    axes[::3] = [0.0, 1.0]  # an edge that is parallel to the face
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    rotations = turns * Rotation.from_rotvec(np.column_stack([tilts[:, None] * axes, np.zeros(count)]))
    corners = SIDE / 2 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    lowest = np.array([rotation.apply(corners)[:, 2].min() for rotation in rotations])
    position = np.zeros((count, 3))
    position[:, 2] = -lowest - rng.uniform(1e-5, 2e-3, count)
    results = []
    for mesh, on_plane in ((False, True), (False, False), (True, False)):
        scene = wc.Scene(gravity=(0, 0, 0))
        body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="body")
        if mesh:
            upper = scene.add_surface(wc.meshes.box((SIDE,) * 3), body)
            lower = scene.add_surface(wc.meshes.box((1.0, 1.0, 0.2)), position=(0, 0, -0.1))
        else:
            upper = scene.add_shape(body, wc.shapes.RoundedBox((SIDE / 2,) * 3))
            lower = scene.add_shape(None, wc.shapes.RoundedBox((0.5, 0.5, 0.1)), position=(0, 0, -0.1))
        if on_plane:
            lower = scene.add_shape(None, wc.shapes.Plane())
        material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K))
        scene.add_body_contact(upper, lower, material, name="press")
        model = scene.build(envs=count, device=device, precision="float64")
        model["body.position"], model["body.orientation"] = position, rotations.as_quat()
        results.append((model.sensor("press.force"), model.sensor("press.torque")))
    force, torque = results[0]
    assert force[:, 2].min() > 0
    bottom = (
        np.array([rotation.apply(corners[corners[:, 2] < 0])[:, 2] for rotation in rotations]) + position[:, 2:]
    )
    # If a wall that leans inward is partly below the plane, a half-space also carries what is beyond the section of the box with
    # the plane, which is narrower by the depth times the tangent of the tilt. It is so if more than the lowest vertex, or the
    # lowest edge, is below.
    sunk = (bottom < 0).sum(axis=1) > np.where(np.arange(count) % 3 == 0, 2, 1)
    assert 10 < sunk.sum() < count - 10
    tolerance = 1e-9 + sunk * -bottom.min(axis=1) * np.tan(tilts) / SIDE
    for own_force, own_torque in results:
        assert (np.linalg.norm(own_force[:, :2], axis=1) <= 1e-12 * own_force[:, 2]).all()
        assert (np.abs(own_force - force)[:, 2] <= tolerance * force[:, 2]).all()
        assert (np.linalg.norm(own_torque - torque, axis=1) <= tolerance * SIDE * force[:, 2]).all()


def test_one_environment_equals_the_same_among_many_bitwise(device):
    count = 4096
    position, orientation = poses(count)
    many = two_boxes(device, count)
    many["upper_body.position"], many["upper_body.orientation"] = position, orientation
    forces = many.sensor("press.force")
    one = two_boxes(device, 1)
    for i in range(0, count, 512):
        one["upper_body.position"], one["upper_body.orientation"] = position[i], orientation[i]
        np.testing.assert_array_equal(one.sensor("press.force")[0], forces[i])
