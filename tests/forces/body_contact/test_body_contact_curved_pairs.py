"""Body contact of two curved shapes: closed forms, symmetry, continuity, and the motion of curved shapes at rest and rolling."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import warpcontact as wc

K = 1e8  # Pa/m
RADIUS, LENGTH = 0.05, 0.1
FORMS = {
    "sphere": lambda: wc.shapes.Sphere(RADIUS),
    "ellipsoid": lambda: wc.shapes.Ellipsoid((0.05, 0.03, 0.08)),
    "cylinder": lambda: wc.shapes.Cylinder(RADIUS, LENGTH),
    "cone": lambda: wc.shapes.Cone(0.06, 0.12),
    "capsule": lambda: wc.shapes.Capsule(0.04, 0.08),
}
LYING = Rotation.from_rotvec([0, np.pi / 2, 0])


def pair(first, second, envs, device, *, exchanged=False):
    """Returns a model of two curved shapes on free bodies, without friction."""
    scene = wc.Scene(gravity=(0, 0, 0))
    solids = []
    for name, kind in (("upper", first), ("lower", second)):
        body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name=f"{name}_body")
        solids.append(scene.add_shape(body, FORMS[kind](), name=name))
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K))
    scene.add_body_contact(*(solids[::-1] if exchanged else solids), material, name="press")
    return scene.build(envs=envs, device=device, precision="float64")


def test_spheres_have_the_force_of_their_common_volume(device):
    depth = np.array([1e-6, 1e-4, 1e-3, 5e-3])
    direction = np.array([1.0, 2.0, 3.0]) / np.sqrt(14)
    model = pair("sphere", "sphere", 4, device)
    model["upper_body.position"] = np.outer(2 * RADIUS - depth, direction)
    # Two caps of half the depth.
    volume = 2 * np.pi * (depth / 2) ** 2 * (RADIUS - depth / 6)
    np.testing.assert_allclose(model.sensor("press.force"), np.outer(K * volume, direction), rtol=1e-6)
    np.testing.assert_allclose(model.sensor("press.depth"), depth, rtol=1e-9)
    assert np.abs(model.sensor("press.torque")).max() < 1e-9 * K * volume.max() * RADIUS


@pytest.mark.parametrize("shift", [0.0, 0.03])
def test_cylinders_side_by_side_have_the_force_of_their_common_volume(shift, device):
    depth = np.array([1e-6, 1e-4, 1e-3, 5e-3])
    distance = 2 * RADIUS - depth
    model = pair("cylinder", "cylinder", 4, device)
    model["upper_body.position"] = np.column_stack([distance, 0 * depth, np.full(4, shift)])
    half = np.sqrt(RADIUS**2 - distance**2 / 4)
    area = 2 * (RADIUS**2 * np.arctan2(half, distance / 2) - distance / 2 * half)
    # Quadrature of a long rectangle in polar coordinates: 1e-3.
    np.testing.assert_allclose(model.sensor("press.force")[:, 0], K * area * (2 * LENGTH - shift), rtol=2e-3)
    # Ends next to the common length turn the common plane by the order of the depth over the radius.
    assert np.abs(model.sensor("press.force")[:, 1:]).max() < 1e-4 * K * area.max() * LENGTH


def test_crossed_cylinders_press_as_paraboloids(device):
    depth = np.array([1e-6, 1e-5, 1e-4])
    model = pair("cylinder", "cylinder", 3, device)
    model["upper_body.position"] = np.column_stack([0 * depth, 0 * depth, 2 * RADIUS - depth])
    model["upper_body.orientation"] = Rotation.from_rotvec([np.pi / 2, 0, 0]).as_quat()
    model["lower_body.orientation"] = LYING.as_quat()
    # π d² R for d ≪ R; the next term is −5 d/R.
    np.testing.assert_allclose(model.sensor("press.force")[:, 2], K * np.pi * depth**2 * RADIUS, rtol=1e-3)


@pytest.mark.parametrize("offset", [0.0, 1e-9, 0.02, 0.06])
def test_stacked_cylinders_carry_the_load_of_their_common_area(offset, device):
    depth = np.array([1e-6, 1e-4, 1e-3])
    model = pair("cylinder", "cylinder", 3, device)
    model["upper_body.position"] = np.column_stack([np.full(3, offset), 0 * depth, 2 * LENGTH - depth])
    area = 2 * RADIUS**2 * np.arccos(offset / 2 / RADIUS) - offset / 2 * np.sqrt(4 * RADIUS**2 - offset**2)
    force = model.sensor("press.force")
    # Quadrature of an outline with two corners: up to 4e-3. It is exact for a circle.
    np.testing.assert_allclose(force[:, 2], K * area * depth, rtol=4e-3 if offset > 0.01 else 1e-8)
    assert np.abs(force[:, :2]).max() < 1e-5 * force.max()


def test_sphere_on_the_end_of_a_cylinder_presses_as_on_a_half_space(device):
    depth = np.array([1e-5, 1e-4, 1e-3])
    model = pair("sphere", "cylinder", 3, device)
    model["upper_body.position"] = np.column_stack([0.01 + 0 * depth, 0 * depth, LENGTH + RADIUS - depth])
    force = model.sensor("press.force")
    np.testing.assert_allclose(force[:, 2], K * np.pi * depth**2 * (RADIUS - depth / 3), rtol=1e-6)
    assert np.abs(force[:, :2]).max() < 1e-6 * force.max()


PAIRS = [
    ("sphere", "cylinder"),
    ("cylinder", "cylinder"),
    ("capsule", "capsule"),
    ("ellipsoid", "cone"),
    ("cone", "cylinder"),
]


@pytest.mark.parametrize(("first", "second"), PAIRS)
def test_depth_grows_from_zero_and_wrenches_balance(first, second, device):
    """No contact starts at a finite depth, in random directions and orientations; exchanged solids have opposite forces."""
    count = 20
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rotations = [Rotation.random(count, random_state=seed) for seed in (4, 5)]
    models = [pair(first, second, count, device, exchanged=exchanged) for exchanged in (False, True)]
    for model in models:
        model["upper_body.orientation"], model["lower_body.orientation"] = (one.as_quat() for one in rotations)
    near, far = np.full(count, 0.02), np.full(count, 0.4)
    for _ in range(35):
        middle = (near + far) / 2
        models[0]["upper_body.position"] = directions * middle[:, None]
        too_deep = models[0].sensor("press.depth") > 1e-4
        near, far = np.where(too_deep, middle, near), np.where(too_deep, far, middle)
    position = directions * near[:, None]
    for model in models:
        model["upper_body.position"] = position
        wc.Simulation(model, dt=1e-6).step()
    # Depth is along the common plane, and the last distance 1e-11 m from that of 0.1 mm.
    np.testing.assert_allclose(models[0].sensor("press.depth"), 1e-4, rtol=2e-2)
    force = models[0].sensor("press.force")
    assert (np.linalg.norm(force, axis=1) > 0).all()
    # The plane is found by iteration from either solid.
    np.testing.assert_allclose(models[1].sensor("press.force"), -force, atol=2e-2 * np.abs(force).max())
    for model in models:
        momentum = sum(model.sensor(f"{name}_body.linear_velocity") for name in ("upper", "lower"))
        turn = sum(model.sensor(f"{name}_body.angular_velocity") for name in ("upper", "lower"))
        turn += np.cross(position, model.sensor("upper_body.linear_velocity"))
        scale = 1e-6 * np.abs(force).max()
        assert np.abs(momentum).max() < 1e-11 * scale
        assert np.abs(turn).max() < 1e-11 * scale


def sweep(first, second, path, count, device):
    """Returns force and torque of a pair whose pose changes in ``count`` equal steps."""
    x = np.linspace(0.0, 1.0, count)[:, None]
    model = pair(first, second, count, device)
    heights = {"sphere": RADIUS, "cylinder": LENGTH, "capsule": 0.12, "cone": 0.0}
    if path == "slide off the end":
        position = [0.001, 0.004, heights[first] + LENGTH - 1e-3] + x * [0.1, 0.0, 0.0]
        rotation = Rotation.from_rotvec(np.tile([0.003, 0.01, 0.2], (count, 1)))
    elif path == "turn around the normal":
        position = np.tile([0.003, 0.004, (RADIUS if first == "cylinder" else 0.04) + RADIUS - 1e-3], (count, 1))
        rotation = Rotation.from_rotvec(x * [0, 0, np.pi / 2]) * LYING
        model["lower_body.orientation"] = LYING.as_quat()
    else:
        position = np.tile([0.06, 0.05, 0.08], (count, 1))
        rotation = Rotation.from_rotvec(x * [0.9, 1.3, 0.4])
    model["upper_body.position"], model["upper_body.orientation"] = position, rotation.as_quat()
    return np.column_stack([model.sensor("press.force"), model.sensor("press.torque") / RADIUS])


@pytest.mark.parametrize(
    ("first", "second", "path"),
    [
        ("sphere", "cylinder", "slide off the end"),
        ("cylinder", "cylinder", "slide off the end"),
        ("cylinder", "cylinder", "turn around the normal"),
        ("capsule", "cylinder", "turn around the normal"),
        ("cylinder", "cylinder", "tumble"),
        ("capsule", "capsule", "tumble"),
    ],
)
def test_force_is_continuous_in_pose(first, second, path, device):
    coarse, fine = (sweep(first, second, path, count, device) for count in (401, 1601))
    changes = [np.abs(np.diff(values, axis=0)).max() for values in (coarse, fine)]
    assert np.abs(coarse).max() > 1.0
    # The largest change of a continuous force falls to a quarter with a quarter of the step; a jump stays.
    assert changes[1] < 0.5 * changes[0]


MASS = 1.0


def material(damping):
    friction = wc.friction.CundallStrack.from_overshoot(
        mu_static=0.5, mu_dynamic=0.5, stiffness=1e5, mass=MASS, overshoot=0.01
    )
    return wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=2e7, damping=damping), friction=friction)


def test_curved_shapes_come_to_rest(device):
    """On a half-space, a box, a mesh box and each other, after a fall, tilted by 0.7°."""
    scene = wc.Scene()
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    upright = Rotation.identity()
    shapes = {
        "standing": (wc.shapes.Cylinder(0.03, 0.05), upright, 0.05),
        "lying": (wc.shapes.Cylinder(0.03, 0.05), LYING, 0.03),
        "capsule": (wc.shapes.Capsule(0.03, 0.04), LYING, 0.03),
        "cone": (wc.shapes.Cone(0.04, 0.06), upright, 0.015),
        "ball": (wc.shapes.Sphere(0.04), upright, 0.04),
    }
    names = []
    for i, (name, (shape, turn, height)) in enumerate(shapes.items()):
        for j, below in enumerate(("plane", "box", "mesh", "post")):
            if (below == "post" and name != "standing") or (below == "mesh" and name != "lying"):
                continue
            place = np.array([0.5 * i, 0.5 * j, 0.1])
            top = 0.2
            if below == "plane":
                support, top = floor, 0.0
            elif below == "box":
                support = scene.add_shape(None, wc.shapes.RoundedBox((0.15, 0.15, 0.1)), place)
            elif below == "mesh":
                support = scene.add_surface(wc.meshes.box((0.3, 0.3, 0.2)), position=place)
            else:
                support = scene.add_shape(None, wc.shapes.Cylinder(0.1, 0.1), place)
            tilt = Rotation.from_rotvec([0.01, 0.006, 0.0]) * turn
            body = scene.add_body(
                mass=MASS,
                inertia=(1e-3, 1e-3, 5e-4) if name != "ball" else (6.4e-4,) * 3,
                position=(place[0] + 0.013, place[1] + 0.017, top + height + 3e-4),
                orientation=tilt.as_quat(),
                name=f"{name}_{below}",
            )
            solid = scene.add_shape(body, shape, (0, 0, -0.015 if name == "cone" else 0.0))
            scene.add_body_contact(
                solid, support, material(50.0 if name == "ball" else 200.0), name=f"touch_{name}_{below}"
            )
            names.append(f"{name}_{below}")
    model = scene.build(envs=1, device=device, precision="float64")
    sim = wc.Simulation(model, dt=1e-4)
    sim.step(7_000)
    before = [model.sensor(f"{name}.position")[0] for name in names]
    sim.step(500)
    for name, position in zip(names, before, strict=True):
        assert np.abs(model.sensor(f"{name}.linear_velocity")).max() < 1e-6, name
        assert np.abs(model.sensor(f"{name}.angular_velocity")).max() < 1e-6, name
        assert np.abs(model.sensor(f"{name}.position")[0] - position).max() < 1e-7, name
        assert model.sensor(f"touch_{name}.force")[0, 2] == pytest.approx(9.81 * MASS, rel=1e-6), name


def test_stack_of_cylinders_stays_at_rest(device):
    scene = wc.Scene()
    below = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    radius, height, foundation = 0.04, 0.1, 2e7
    depth = 0.0
    for i in range(3):
        depth += (3 - i) * MASS * 9.81 / (foundation * np.pi * radius**2)
        body = scene.add_body(
            mass=MASS,
            inertia=(1.2e-3, 1.2e-3, 8e-4),
            position=(0, 0, (i + 0.5) * height - depth),
            name=f"body_{i}",
        )
        solid = scene.add_shape(body, wc.shapes.Cylinder(radius, height / 2))
        scene.add_body_contact(solid, below, material(50.0), name=f"touch_{i}")
        below = solid
    model = scene.build(envs=1, device=device, precision="float64")
    wc.Simulation(model, dt=2.5e-5).step(2_000)
    for i in range(3):
        assert np.abs(model.sensor(f"body_{i}.linear_velocity")).max() < 1e-9
        assert np.abs(model.sensor(f"body_{i}.angular_velocity")).max() < 1e-9
        assert model.sensor(f"touch_{i}.force")[0, 2] == pytest.approx((3 - i) * 9.81 * MASS, rel=1e-9)


def test_rolling_shapes_keep_their_speed(device):
    """Without damping, the elastic force of a rolling solid has no torque, and friction none either."""
    scene = wc.Scene()
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    radius = 0.03
    lying = Rotation.from_rotvec([np.pi / 2, 0, 0]).as_quat()
    depths = {"cylinder": 6.0996e-4, "ball": 2.3074e-3}
    for i, (name, depth) in enumerate(depths.items()):
        shape = wc.shapes.Cylinder(radius, 0.05) if name == "cylinder" else wc.shapes.Sphere(radius)
        body = scene.add_body(
            mass=MASS,
            inertia=(4e-4, 4e-4, 4.5e-4) if name == "cylinder" else (3.6e-4,) * 3,
            position=(0, i, radius - depth),
            orientation=lying,
            linear_velocity=(0.5, 0, 0),
            # Without slip at the center of pressure, half of the depth below the plane.
            angular_velocity=(0, 0.5 / (radius - depth / 2), 0),
            name=name,
        )
        scene.add_body_contact(scene.add_shape(body, shape), floor, material(0.0), name=f"touch_{name}")
    model = scene.build(envs=1, device=device, precision="float64")
    wc.Simulation(model, dt=1e-4).step(5_000)
    for name in depths:
        velocity = model.sensor(f"{name}.linear_velocity")[0]
        assert velocity[0] == pytest.approx(0.5, rel=1e-2), name
        assert abs(velocity[1]) < 1e-6, name
        # Seven turns per second, of which the pressure has no memory.
        assert np.linalg.norm(model.sensor(f"touch_{name}.friction_force")) < 1e-2 * 9.81 * MASS, name
