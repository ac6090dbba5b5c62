"""Body contact of spheres, ellipsoids, cylinders, cones and capsules with half-spaces, boxes and meshes."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import warpcontact as wc

K = 1e8  # Pa/m
SIZES = {
    "Sphere": (0.05,),
    "Ellipsoid": (0.05, 0.03, 0.08),
    "Cylinder": (0.05, 0.1),
    "Cone": (0.06, 0.12),
    "Capsule": (0.04, 0.08),
}
BOX = (0.2, 0.24, 0.16)


def form(kind, sizes):
    """Returns a shape of a class with these sizes."""
    return getattr(wc.shapes, kind)(
        sizes if kind == "Ellipsoid" else sizes[0], *sizes[1:] if kind != "Ellipsoid" else ()
    )


def pressed(kind, lower, envs, device, *, exchanged=False, free=False, reference="auto", precision="float64"):
    """Returns a model of a curved shape on ``body`` in contact with a mesh or another shape, without friction."""
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="body")
    upper = scene.add_shape(body, form(kind, SIZES[kind]), name="upper")
    below = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="below") if free or exchanged else None
    if isinstance(lower, wc.Mesh):
        support = scene.add_surface(lower, body=below, name="lower")
    else:
        support = scene.add_shape(below, lower, name="lower")
    solids = (support, upper) if exchanged else (upper, support)
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K))
    scene.add_body_contact(*solids, material, name="press", reference=reference)
    return scene.build(envs=envs, device=device, precision=precision)


def box():
    return wc.shapes.RoundedBox(tuple(np.array(BOX) / 2))


def poses(count, seed=3):
    """Returns poses of a curved shape near a box centered at the origin."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return rng.uniform(0.11, 0.2, (count, 1)) * directions, Rotation.random(count, random_state=seed)


def surface_points(sizes, kind, rows=25, columns=64):
    """Returns vertices (rows × columns) of a shape of revolution or an ellipsoid; the first and last row are points."""
    angle = np.linspace(0.0, np.pi, rows)
    # Polygons of equal area.
    meridian = np.sqrt(angle[1] / np.sin(angle[1]))
    if kind in ("Sphere", "Ellipsoid"):
        radius, height = meridian * np.sin(angle), -meridian * np.cos(angle)
        scale = np.broadcast_to(np.array(sizes), 3)
    elif kind == "Capsule":
        # The equator is in both halves.
        angle = np.insert(angle, rows // 2, np.pi / 2)
        radius = meridian * sizes[0] * np.sin(angle)
        height = -meridian * sizes[0] * np.cos(angle)
        height += np.where(np.arange(rows + 1) <= rows // 2, -sizes[1], sizes[1])
        scale = np.ones(3)
    else:
        top = (sizes[0], sizes[1]) if kind == "Cylinder" else (0.0, sizes[1])
        bottom = (sizes[0], -sizes[1] if kind == "Cylinder" else 0.0)
        corners = np.array([(0.0, bottom[1]), bottom, top, (0.0, top[1])])
        corners = corners[: 4 if kind == "Cylinder" else 3]
        radius, height = corners.T
        scale = np.ones(3)
    around = np.arange(columns) * 2 * np.pi / columns
    radius = radius * np.sqrt(2 * np.pi / columns / np.sin(2 * np.pi / columns))
    ring = np.stack([np.cos(around), np.sin(around)], axis=1)
    inner = np.concatenate(
        [np.column_stack([r * ring, np.full(columns, h)]) for r, h in zip(radius[1:-1], height[1:-1], strict=True)]
    )
    return scale * np.concatenate([[[0, 0, height[0]]], inner, [[0, 0, height[-1]]]]), len(radius) - 2, columns


def mesh_of(kind):
    """Returns a fine closed mesh of a curved shape."""
    vertices, rings, columns = surface_points(SIZES[kind], kind)
    faces = []
    for i in range(columns):
        k = (i + 1) % columns
        faces.append((0, 1 + k, 1 + i))
        for ring in range(rings - 1):
            a = 1 + ring * columns
            faces += [(a + i, a + k, a + columns + k), (a + i, a + columns + k, a + columns + i)]
        a = 1 + (rings - 1) * columns
        faces.append((a + i, a + k, len(vertices) - 1))
    return wc.Mesh(vertices, np.array(faces))


def groove(case):
    """Returns the mesh of a prism with two walls that meet along the y axis."""
    half, length = case["half_angle"], case["wall_length"]
    x, z = length * np.sin(half), length * np.cos(half)
    outline = np.array([(0, 0), (-x, z), (-x, -0.1), (x, -0.1), (x, z)])
    vertices = np.concatenate([np.insert(outline, 1, y, axis=1) for y in (-0.2, 0.2)])
    faces = [(0, 1, 2), (0, 2, 3), (0, 3, 4)]
    faces += [tuple(5 + i for i in face[::-1]) for face in faces]
    for i in range(5):
        k = (i + 1) % 5
        faces += [(k, i, 5 + i), (k, 5 + i, 5 + k)]
    return wc.Mesh(vertices, np.array(faces))


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_force_and_moment_equal_closed_forms(precision, shared, device):
    cases = [
        case
        for case in json.loads((shared / "spec" / "oracle_patches.json").read_text())["cases"]
        if case.get("body_a", {}).get("shape") in ("sphere", "cylinder", "capsule")
        and case["law"]["type"] == "elastic_foundation"
    ]
    assert len(cases) == 8
    scene = wc.Scene(gravity=(0, 0, 0))
    for number, case in enumerate(cases):
        first, second = case["body_a"], case["body_b"]
        body = scene.add_body(
            mass=1.0,
            inertia=(1, 1, 1),
            position=first["position"],
            orientation=first.get("orientation", (0, 0, 0, 1)),
        )
        sizes = [first[key] for key in ("radius", "half_length") if key in first]
        upper = scene.add_shape(body, form(first["shape"].title(), sizes))
        if second["shape"] == "plane":
            lower = scene.add_shape(None, wc.shapes.Plane())
        elif second["shape"] == "box":
            lower = scene.add_shape(
                None, wc.shapes.RoundedBox(tuple(np.array(second["size"]) / 2)), second["position"]
            )
        else:
            lower = scene.add_surface(groove(second))
        law = wc.laws.ElasticFoundation(stiffness=case["law"]["k"])
        scene.add_body_contact(upper, lower, wc.ContactMaterial(law=law), name=f"press_{number}")
    model = scene.build(envs=1, device=device, precision=precision)
    for number, case in enumerate(cases):
        found = {key: model.sensor(f"press_{number}.{key}")[0] for key in ("force", "torque", "area", "depth")}
        magnitude = np.linalg.norm(case["force"])
        tolerance = case["rel_tol"]
        if precision == "float32":
            # Rounding of positions in float32, 6e-9 m for coordinates up to 0.1 m, over the depth.
            tolerance = max(tolerance, 2e-8 / found["depth"] + 1e-6)
        assert np.linalg.norm(found["force"] - case["force"]) <= tolerance * magnitude, case["name"]
        size = 2 * case["body_a"].get("half_length", case["body_a"]["radius"])
        assert np.linalg.norm(found["torque"] - case["moment"]) <= tolerance * magnitude * size, case["name"]
        assert found["area"] == pytest.approx(case["area"], rel=5 * tolerance)


@pytest.mark.parametrize("on_box", [False, True])
@pytest.mark.parametrize("kind", ["Ellipsoid", "Cone"])
def test_pole_pressed_into_a_face_has_the_force_of_the_closed_form(kind, on_box, device):
    depth = np.array([1e-4, 1e-3, 5e-3])
    model = pressed(kind, box() if on_box else wc.shapes.Plane(), 3, device)
    a, b, c = SIZES["Ellipsoid"]
    radius, height = SIZES["Cone"]
    if kind == "Ellipsoid":
        volume, top = np.pi * a * b * depth**2 * (3 * c - depth) / (3 * c**2), c
    else:
        volume, top = np.pi * (radius / height) ** 2 * depth**3 / 3, height
        model["body.orientation"] = [1.0, 0.0, 0.0, 0.0]  # tip down
    position = np.zeros((3, 3))
    position[:, 2] = top - depth + (BOX[2] / 2 if on_box else 0.0)
    model["body.position"] = position
    # Quadrature of the tip, which is not smooth.
    np.testing.assert_allclose(
        model.sensor("press.force")[:, 2], K * volume, rtol=1e-6 if kind == "Ellipsoid" else 1e-4
    )
    np.testing.assert_allclose(model.sensor("press.depth"), depth, rtol=1e-9)
    assert np.abs(model.sensor("press.torque")).max() < 1e-4 * K * volume.max() * radius


def volume_below_plane(kind, position, rotation, slices=20_000):
    """Returns volume and center of the part of a shape below z = 0, from discs along its axis (ellipsoid: closed form)."""
    sizes = SIZES[kind]
    matrix = rotation.as_matrix()
    if kind in ("Sphere", "Ellipsoid"):
        scale = np.broadcast_to(np.array(sizes), 3)
        normal = scale * matrix[2]
        stretch = np.linalg.norm(normal)
        depth = np.clip(1.0 - position[2] / stretch, 0.0, 2.0)
        center = -3 * (2 - depth) ** 2 / (4 * (3 - depth))
        volume = np.pi * depth**2 * (1 - depth / 3) * scale.prod()
        return volume, position + matrix @ (scale * normal / stretch * center)
    half = sizes[1] + (sizes[0] if kind == "Capsule" else 0.0)
    lower = 0.0 if kind == "Cone" else -half
    step = (half - lower) / slices
    z = lower + (np.arange(slices) + 0.5) * step
    radius = np.full(slices, sizes[0])
    if kind == "Cone":
        radius = sizes[0] * (1 - z / sizes[1])
    elif kind == "Capsule":
        radius = np.sqrt(np.maximum(sizes[0] ** 2 - (z - np.clip(z, -sizes[1], sizes[1])) ** 2, 0.0))
    axis = matrix[:, 2]
    sine = np.sqrt(1 - axis[2] ** 2)
    across = (np.array([0, 0, 1]) - axis[2] * axis) / sine
    edge = np.clip(-(position[2] + z * axis[2]) / (sine * radius), -1.0, 1.0)
    area = radius**2 * (np.pi - np.arccos(edge) + edge * np.sqrt(1 - edge**2))
    moment = -2 / 3 * radius**3 * (1 - edge**2) ** 1.5
    volume = area.sum() * step
    center = position * area.sum() + axis * (z * area).sum() + across * moment.sum()
    return volume, center * step / max(volume, 1e-300)


@pytest.mark.parametrize("kind", list(SIZES))
def test_force_on_a_half_space_is_that_of_the_volume_below(kind, device):
    """At any depth, also of a solid that is wholly below the plane."""
    count = 100
    rng = np.random.default_rng(1)
    position = np.column_stack([rng.normal(size=(count, 2)), rng.uniform(-0.15, 0.12, count)])
    rotations = Rotation.random(count, random_state=2)
    model = pressed(kind, wc.shapes.Plane(), count, device)
    model["body.position"], model["body.orientation"] = position, rotations.as_quat()
    expected = [volume_below_plane(kind, *pose) for pose in zip(position, rotations, strict=True)]
    volume, center = (np.array(column) for column in zip(*expected, strict=True))
    force = model.sensor("press.force")
    assert np.abs(force[:, :2]).max() <= 1e-12 * force.max()
    # Quadrature: 1e-4 for usual depths, and up to 3e-3 from depths of half of the solid on.
    np.testing.assert_allclose(force[:, 2], K * volume, rtol=4e-3, atol=1e-6 * K * volume.max())
    usual = (volume > 0) & (model.sensor("press.depth") < 0.3 * min(SIZES[kind]))
    assert usual.sum() >= 2
    np.testing.assert_allclose(force[usual, 2], K * volume[usual], rtol=6e-4)
    moment = np.cross(center - position, force)
    error = np.linalg.norm(model.sensor("press.torque") - moment, axis=1)
    assert (error <= 3e-3 * np.abs(force[:, 2]) * max(SIZES[kind])).all()


@pytest.mark.parametrize("kind", list(SIZES))
def test_edges_and_vertices_of_a_box_act_as_on_a_fine_mesh(kind, device):
    """Also the rims of cylinders and cones, with the same weights of both references."""
    count = 24
    model = pressed(kind, box(), count, device)
    position, rotations = poses(count)
    model["body.orientation"] = rotations.as_quat()
    # Move to a depth of 2 mm.
    directions = position / np.linalg.norm(position, axis=1, keepdims=True)
    near, far = np.full(count, 0.05), np.full(count, 0.5)
    for _ in range(30):
        middle = (near + far) / 2
        model["body.position"] = directions * middle[:, None]
        too_deep = model.sensor("press.depth") > 2e-3
        near, far = np.where(too_deep, middle, near), np.where(too_deep, far, middle)
    fine = pressed_mesh(kind, count, device)
    for one in (model, fine):
        one["body.position"], one["body.orientation"] = directions * far[:, None], rotations.as_quat()
    force, expected = (one.sensor("press.force") for one in (model, fine))
    share, expected_share = (one.sensor("press.reference") for one in (model, fine))
    assert (share < 0.99).sum() > count / 4
    assert (share > 0.99).sum() > count / 8
    np.testing.assert_allclose(share, expected_share, atol=0.02)
    error = np.linalg.norm(force - expected, axis=1) / np.linalg.norm(expected, axis=1)
    # Facets of the mesh deviate by up to 4 % of the depth. Depths D of few samples on the mesh differ, and columns of the tip
    # of a cone that end beyond its axis do not count.
    assert np.median(error) < (3e-2 if kind in ("Sphere", "Ellipsoid", "Capsule") else 5e-3)
    assert np.quantile(error, 0.85) < 0.08


def pressed_mesh(kind, envs, device):
    """Returns a model of the mesh of a curved shape in contact with a box."""
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="body")
    upper = scene.add_surface(mesh_of(kind), body=body, name="upper")
    lower = scene.add_shape(None, box(), name="lower")
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K))
    scene.add_body_contact(upper, lower, material, name="press")
    return scene.build(envs=envs, device=device, precision="float64")


@pytest.mark.parametrize("kind", list(SIZES))
def test_exchanged_solids_have_the_opposite_wrench(kind, device):
    count = 100
    position, rotations = poses(count)
    results = []
    for exchanged in (False, True):
        model = pressed(kind, box(), count, device, exchanged=exchanged, free=True)
        model["body.position"], model["body.orientation"] = position, rotations.as_quat()
        wc.Simulation(model, dt=1e-6).step()
        results.append(model)
    one, other = results
    force = one.sensor("press.force")
    assert (np.linalg.norm(force, axis=1) > 0).sum() > count / 4
    np.testing.assert_allclose(other.sensor("press.force"), -force, atol=1e-9 * np.abs(force).max())
    np.testing.assert_allclose(
        one.sensor("press.reference") + other.sensor("press.reference"),
        one.sensor("press.status") != int(wc.ContactStatus.OPEN),
        atol=1e-9,
    )
    for model in results:
        # Masses and inertias are 1.
        momentum = sum(model.sensor(f"{name}.linear_velocity") for name in ("body", "below"))
        turn = sum(model.sensor(f"{name}.angular_velocity") for name in ("body", "below"))
        turn += np.cross(position, model.sensor("body.linear_velocity"))
        scale = 1e-6 * np.abs(force).max()
        assert np.abs(momentum).max() < 1e-12 * scale
        assert np.abs(turn).max() < 1e-12 * scale


@pytest.mark.parametrize("kind", list(SIZES))
def test_mesh_box_equals_box_shape_in_any_frame(kind, device):
    count = 60
    position, rotations = poses(count)
    turn, shift = Rotation.from_rotvec([0.3, -1.1, 0.7]), np.array([3.0, -2.0, 5.0])
    model = pressed(kind, box(), count, device)
    model["body.position"], model["body.orientation"] = position, rotations.as_quat()
    moved = pressed(kind, wc.meshes.box(BOX), count, device)
    moved["body.position"] = turn.apply(position) + shift
    moved["body.orientation"] = (turn * rotations).as_quat()
    moved["lower.position"], moved["lower.orientation"] = shift, turn.as_quat()
    force = model.sensor("press.force")
    # Rounding of positions of 6 m, 1e-15 m, over the smallest depths; directions of u and v differ.
    np.testing.assert_allclose(
        turn.inv().apply(moved.sensor("press.force")), force, atol=1e-4 * np.abs(force).max()
    )


def sweep(kind, path, count, device):
    """Returns force and torque of a shape whose pose changes in ``count`` equal steps."""
    x = np.linspace(0.0, 1.0, count)[:, None]
    sizes = SIZES[kind]
    model = pressed(kind, box(), count, device)
    if path == "slide off":
        rotation = Rotation.from_rotvec(np.tile([0.002, 0.01, 0.3], (count, 1)))
        height = {"Cone": 0.0, "Capsule": sum(sizes)}.get(kind, sizes[-1])
        position = [-0.02, 0.013, BOX[2] / 2 + height - 1e-3] + x * [0.19, 0.0, 0.0]
    else:
        rotation = Rotation.from_rotvec(x * [0.9, 1.3, 0.4])
        position = np.tile([0.1, 0.09, 0.11], (count, 1))
    model["body.position"], model["body.orientation"] = position, rotation.as_quat()
    return np.column_stack([model.sensor("press.force"), model.sensor("press.torque") / max(sizes)])


@pytest.mark.parametrize("path", ["slide off", "tumble"])
@pytest.mark.parametrize("kind", list(SIZES))
def test_force_is_continuous_in_pose(kind, path, device):
    coarse, fine = (sweep(kind, path, count, device) for count in (401, 1601))
    changes = [np.abs(np.diff(values, axis=0)).max() for values in (coarse, fine)]
    assert np.abs(coarse).max() > 1.0
    # The largest change of a continuous force falls to a quarter with a quarter of the step; a jump stays.
    assert changes[1] < max(0.5 * changes[0], 1e-9 * np.abs(coarse).max())


def test_sizes_and_kinds_of_pairs_may_differ(device):
    """Sizes per environment; boxes and curved shapes in one contact."""
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="body")
    first = scene.add_shape(body, wc.shapes.Cylinder(0.05, 0.1), name="cylinder")
    second = scene.add_shape(body, wc.shapes.RoundedBox((0.1, 0.1, 0.1)), (0.5, 0, 0), name="box")
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K))
    scene.add_body_contact([first, second], floor, material, name="press")
    model = scene.build(envs=3, device=device, precision="float64")
    radius, length = np.array([0.01, 0.05, 0.2]), np.array([0.1, 0.1, 0.099])
    model["cylinder.radius"], model["cylinder.half_length"] = radius, length
    model["body.position"] = [0.0, 0.0, 0.098]
    expected = np.column_stack([K * np.pi * radius**2 * (length - 0.098), np.full(3, K * 0.04 * 2e-3)])
    np.testing.assert_allclose(model.sensor("press.force")[..., 2], expected, rtol=1e-9)


@pytest.mark.parametrize("kind", list(SIZES))
def test_open_surface_acts_as_a_half_space(kind, device):
    half_space = pressed(kind, wc.shapes.Plane(), 1, device)
    # On the edge of a flat end, or on the tip of a cone: the solid is not wider below the surface.
    half_space["body.orientation"] = Rotation.from_rotvec([3.1 if kind == "Cone" else 0.7, 0.0, 0.3]).as_quat()
    # The depth at z = 0 is the height of the origin above the lowest point.
    height = half_space.sensor("press.depth")[0]
    surface = pressed(kind, wc.meshes.grid((1.0, 1.0), (7, 7)), 1, device)
    surface["body.orientation"] = half_space["body.orientation"]
    for model in (half_space, surface):
        model["body.position"] = [0.01, 0.02, height - 2e-3]
    assert surface.sensor("press.reference")[0] == 1.0
    force = half_space.sensor("press.force")[0]
    # Quadrature: the mesh has edges below the solid.
    np.testing.assert_allclose(surface.sensor("press.force")[0], force, atol=1e-4 * force[2])
    np.testing.assert_allclose(surface.sensor("press.depth"), 2e-3, rtol=0.3)
