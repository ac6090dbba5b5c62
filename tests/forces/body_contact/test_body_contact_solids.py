"""Body contact of solids other than boxes: submerged bodies, prisms with many faces, open surfaces, refusals."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import warpcontact as wc

K = 1e8  # Pa/m
MATERIAL = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K))


def pressed(upper, lower, position, device, orientation=(0, 0, 0, 1)):
    """Returns a model of a mesh on a body in contact with a shape or mesh of the world."""
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), position=position, orientation=orientation, name="body")
    first = scene.add_surface(upper, body=body, name="upper")
    if isinstance(lower, wc.Mesh):
        second = scene.add_surface(lower, name="lower")
    else:
        second = scene.add_shape(None, lower, name="lower")
    scene.add_body_contact(first, second, MATERIAL, name="press")
    return scene.build(envs=1, device=device, precision="float64")


def mesh_of(shape):
    return wc.Mesh(shape.vertices, shape.faces)


@pytest.mark.parametrize("depth", [0.03, 0.1, 0.5])
def test_force_on_a_half_space_is_that_of_the_volume_below(depth, device):
    """Also of a body that is wholly below the plane, at the center of its volume."""
    mesh = mesh_of(trimesh.creation.icosphere(subdivisions=2, radius=0.1))
    turn = Rotation.from_rotvec([0.3, 0.2, 0.1])
    model = pressed(mesh, wc.shapes.Plane(), (0.02, 0.01, 0.1 - depth), device, turn.as_quat())
    center = np.array([0.02, 0.01, 0.1 - depth])
    sphere = trimesh.Trimesh(turn.apply(mesh.vertices.copy()) + center, mesh.faces.copy())
    vertices, faces, *_ = trimesh.intersections.slice_faces_plane(
        sphere.vertices, sphere.faces, np.array([0, 0, -1.0]), np.zeros(3)
    )
    # Volume and moments by the flux of (0, 0, z), (0, 0, x z) and (0, 0, y z), which vanishes at z = 0. The midpoints of
    # edges integrate them exactly.
    corners = vertices[faces]
    middles = 0.5 * (corners + np.roll(corners, 1, axis=1))
    area_z = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    volume = (area_z * middles[..., 2].mean(axis=1)).sum()
    moment = ((middles[..., :2] - center[:2]) * middles[..., 2:]).mean(axis=1)
    moment = (area_z[:, None] * moment).sum(axis=0)
    np.testing.assert_allclose(model.sensor("press.force")[0], [0, 0, K * volume], rtol=1e-9, atol=1e-6)
    torque = K * np.array([moment[1], -moment[0], 0.0])
    np.testing.assert_allclose(model.sensor("press.torque")[0], torque, atol=1e-9 * K * volume)
    assert model.sensor("press.depth")[0] == pytest.approx(-sphere.vertices[:, 2].min())


@pytest.mark.parametrize("sections", [5, 8, 32])
@pytest.mark.parametrize("tilt", [0.0, 0.002])
def test_prism_standing_on_a_box_carries_the_load_of_its_base(sections, tilt, device):
    """Few and many planes take different paths, with the same result as on a half-space."""
    prism = mesh_of(trimesh.creation.cylinder(radius=0.05, height=0.2, sections=sections))
    base = wc.meshes.box((0.4, 0.4, 0.1))
    turn = Rotation.from_rotvec([0, tilt, 0]).as_quat()
    on_box = pressed(prism, base, (0, 0, 0.149), device, turn)
    on_plane = pressed(prism, wc.shapes.Plane(), (0, 0, 0.099), device, turn)
    force = on_plane.sensor("press.force")[0]
    if tilt == 0.0:
        area = 0.5 * sections * 0.05**2 * np.sin(2 * np.pi / sections)
        assert force[2] == pytest.approx(K * area * 1e-3, rel=1e-9)
    # A half-space also carries what is beyond the edge of the base on the plane: δ tan(tilt) of its width.
    tolerance = 1e-9 + tilt * 1e-3 / 0.05
    np.testing.assert_allclose(on_box.sensor("press.force")[0], force, atol=tolerance * force[2])
    torque = on_plane.sensor("press.torque")[0]
    np.testing.assert_allclose(on_box.sensor("press.torque")[0], torque, atol=0.1 * tolerance * force[2])


def test_open_surface_is_the_reference(device):
    model = pressed(
        wc.meshes.box((0.1, 0.1, 0.1)), wc.meshes.grid((1.0, 1.0), (7, 7)), (0.01, 0.02, 0.049), device
    )
    np.testing.assert_allclose(model.sensor("press.force")[0], [0, 0, K * 0.01 * 1e-3], rtol=1e-9, atol=1e-6)
    assert model.sensor("press.reference")[0] == 1.0


# Both sides of a square, divided along different diagonals.
FLAT = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)]

# Four cones on one triangle, three of them with the same orientation along its edges.
CONES = (
    [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.3, 0.3, 1), (0.3, 0.3, 2), (0.3, 0.3, -1), (0.3, 0.3, -2)],
    [(i, (i + 1) % 3, top) if top < 6 else ((i + 1) % 3, i, top) for top in (3, 4, 5, 6) for i in range(3)],
)


def scene_with(*names):
    scene = wc.Scene()
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="body")
    made = {
        "box": lambda: scene.add_shape(body, wc.shapes.RoundedBox((0.1, 0.1, 0.1)), name="box"),
        "round": lambda: scene.add_shape(body, wc.shapes.RoundedBox((0.1, 0.1, 0.1), 0.01), name="round"),
        "torus": lambda: scene.add_shape(body, wc.shapes.Torus(0.1, 0.02), name="torus"),
        "sheet": lambda: scene.add_surface(wc.meshes.grid((1, 1)), body=body, name="sheet"),
        "hollow": lambda: scene.add_surface(wc.meshes.box((1, 1, 1)), body=body, flip=True, name="hollow"),
        "flat": lambda: scene.add_surface(wc.Mesh(*FLAT), body=body, name="flat"),
        "cones": lambda: scene.add_surface(wc.Mesh(*CONES), body=body, name="cones"),
        "floor": lambda: scene.add_shape(None, wc.shapes.Plane(), name="floor"),
    }
    return scene, [made[name]() for name in names]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (
            ("torus", "floor"),
            r"'torus' is a Torus; body contact supports meshes and the shapes RoundedBox, Plane, Sphere, Ellipsoid, Cylinder, Cone, Capsule",
        ),
        (("round", "floor"), r"'round' has rounded edges, of radius 0\.01 m"),
        (("sheet", "floor"), r"'sheet' is open, and must be second"),
        (
            ("hollow", "floor"),
            r"'hollow' are oriented inward, with a volume of -1 m³; .* flip of add_surface, or flipped\(\) of",
        ),
        (("flat", "floor"), r"'flat' are closed but enclose no volume; allowed: a mesh with a thickness"),
        (("cones", "floor"), r"'cones' disagree in orientation at edges of more than two faces"),
        (("floor", "box"), r"'floor' is a half-space, which must be second"),
        (("box", "box"), r"all solids are fixed to body 'body'"),
    ],
)
def test_unsupported_solids_are_refused(names, message):
    scene, solids = scene_with(*dict.fromkeys(names))
    with pytest.raises(ValueError, match=message):
        scene.add_body_contact(solids[0], solids[-1], MATERIAL)
    assert not scene.body_contacts


@pytest.mark.parametrize(
    ("material", "message"),
    [
        (wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1.0, area=1.0)), "has an area; leave it out"),
        (wc.ContactMaterial(law=wc.laws.HertzElastic(modulus=1e9)), "needs a radius of curvature"),
        (
            wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1.0), torsion=wc.friction.Tanh(mu=0.1)),
            "has torsion Tanh; body contact has no torsion friction",
        ),
    ],
)
def test_unsupported_materials_are_refused(material, message):
    scene, (box, floor) = scene_with("box", "floor")
    with pytest.raises(ValueError, match=message):
        scene.add_body_contact(box, floor, material)


def test_rounded_edges_are_refused_as_a_parameter():
    scene, (box, floor) = scene_with("box", "floor")
    scene.add_body_contact(box, floor, MATERIAL)
    model = scene.build(envs=2, device="cpu")
    with pytest.raises(
        ValueError, match=r"box\.radius must be 0 m, because the box is in body contact, got 0\.01 m"
    ):
        model["box.radius"] = [0.0, 0.01]
    np.testing.assert_array_equal(model["box.radius"], 0.0)


def test_lists_count_each_pair_once():
    scene, (box, floor) = scene_with("box", "floor")
    other = scene.add_body(mass=1.0, inertia=(1, 1, 1), position=(0, 0, 1))
    second = scene.add_shape(other, wc.shapes.RoundedBox((0.1, 0.1, 0.1)))
    contact = scene.add_body_contact([box, second], [box, second, floor], MATERIAL)
    assert contact.pairs == ((box, second), (box, floor), (second, floor))


def test_one_list_pairs_all_its_solids_except_those_excluded():
    scene = wc.Scene()
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    boxes = []
    for i in range(3):
        body = scene.add_body(mass=1.0, inertia=(1, 1, 1), position=(0, 0, i), name=f"body_{i}")
        boxes.append(scene.add_shape(body, wc.shapes.RoundedBox((0.1, 0.1, 0.1)), name=f"box_{i}"))
    bodies = [box.body for box in boxes]
    contact = scene.add_body_contact([floor, *bodies], MATERIAL, exclude=[(bodies[0], boxes[2])], name="press")
    found = [(first.name, second.name) for first, second in contact.pairs]
    # The half-space is the second of its pairs.
    assert found == [
        *((f"box_{i}", "floor") for i in range(3)),
        ("box_0", "box_1"),
        ("box_1", "box_2"),
    ]


def test_errors_of_excluded_pairs_name_the_pair():
    scene, (box, floor) = scene_with("box", "floor")
    outside = scene.add_shape(None, wc.shapes.Plane(), name="outside")
    with pytest.raises(ValueError, match=r"exclude\[0\]: 'outside' is not among the solids"):
        scene.add_body_contact(box, floor, MATERIAL, exclude=[(box, outside)])
    with pytest.raises(TypeError, match=r"exclude\[0\] must be a pair"):
        scene.add_body_contact(box, floor, MATERIAL, exclude=[box])
    with pytest.raises(ValueError, match="exclude, groups and masks leave no pair"):
        scene.add_body_contact([box, floor], MATERIAL, exclude=[(box, floor)])


def test_body_contacts_of_different_sizes_are_recorded_together(device):
    """Each has its own item dimension in a recording."""
    scene = wc.Scene()
    ground = scene.add_shape(None, wc.shapes.Plane(), name="ground")
    boxes = []
    for i in range(3):
        box = scene.add_body(mass=1.0, inertia=(1, 1, 1), position=(0, 0, 0.099 * i + 0.05), name=f"box_{i}")
        scene.add_shape(box, wc.shapes.RoundedBox((0.05, 0.05, 0.05)))
        boxes.append(box)
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e7))
    scene.add_body_contact(boxes, material, name="among")
    scene.add_body_contact(boxes[:2], ground, material, name="on_ground")
    model = scene.build(envs=2, device=device, precision="float64")
    recording = wc.Simulation(model, dt=1e-5).run(2e-5, ["among.depth", "on_ground.depth"])
    assert recording["among.depth"].dims == ("time", "env", "among.item")
    assert recording["among.depth"].sizes["among.item"] == 3
    assert recording["on_ground.depth"].sizes["on_ground.item"] == 2


@pytest.mark.parametrize("kind", ["mesh", "shape"])
def test_largest_pressure_is_that_of_columns_that_carry(kind, device):
    """Columns on side walls are longer than those of the contact, and do not carry."""
    depth = 1e-3
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), position=(0.0985, 0, 0.1 - depth), name="body")
    boxes = []
    for number, carrier in enumerate((body, None)):
        if kind == "shape":
            boxes.append(scene.add_shape(carrier, wc.shapes.RoundedBox((0.05,) * 3), name=f"box_{number}"))
        else:
            boxes.append(scene.add_surface(wc.meshes.box((0.1,) * 3), body=carrier, name=f"box_{number}"))
    scene.add_body_contact(*boxes, MATERIAL, name="press")
    model = scene.build(envs=1, device=device, precision="float64")
    # The overlap is 1.5 mm wide: columns on the walls have lengths of up to 1.5 D and count fully.
    assert model.sensor("press.max_pressure")[0] == pytest.approx(1.5 * K * depth, rel=1e-6)
    model["body.position"] = [[0.0965, 0, 0.1 - depth]]
    # 3.5 mm wide: they count less than a sixth.
    assert model.sensor("press.max_pressure")[0] == pytest.approx(K * depth, rel=1e-6)
