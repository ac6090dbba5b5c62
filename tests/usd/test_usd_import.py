"""Import of UsdPhysics stages: units, masses, shapes, materials, gravity, and collision pairs."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from physics_stages import BODY, COLLIDER, CUBE, SIDES, WEIGHT, body, contact_pairs, mesh, moved, prim, stage
from pxr import UsdUtils
from scipy.spatial.transform import Rotation

import warpcontact as wc

pytestmark = pytest.mark.installed

# Most attributes of UsdPhysics are single precision.
SINGLE = 1e-6
SHAPE = 'prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]'


def read(tmp_path, content, *, metadata=None, **options):
    """Returns the imported scene; read in this process, because a reader process takes longer than the import."""
    return wc.Scene.from_usd(stage(tmp_path, content, **(metadata or {})), trusted=True, **options)


def one(tmp_path, content, **metadata):
    """The only body of an imported stage."""
    (found,) = read(tmp_path, content, metadata=metadata).bodies
    return found


def test_imported_body_has_mass_and_inertia_of_the_stage(tmp_path):
    weight = f"{WEIGHT}\nquatf physics:principalAxes = (0.9238795325, 0, 0, 0.3826834324)"  # 45° about z
    found = one(tmp_path, body(content=weight, pose=moved(1, 2, 3, turn=(0, 0, 90))))
    assert found.mass == pytest.approx(2.0, rel=SINGLE)
    turn = Rotation.from_euler("z", 45, degrees=True).as_matrix()
    np.testing.assert_allclose(found.inertia, turn @ np.diag([0.1, 0.2, 0.25]) @ turn.T, atol=1e-7)
    np.testing.assert_allclose(found.position, (1, 2, 3))
    np.testing.assert_allclose(Rotation.from_quat(found.orientation).as_rotvec(), (0, 0, np.pi / 2), atol=1e-12)


def test_imported_body_frame_is_at_its_scaled_center_of_mass(tmp_path):
    weight = f"{WEIGHT}\npoint3f physics:centerOfMass = (0.5, 0, 0)"
    ball = prim("Sphere", "ball", COLLIDER, "double radius = 0.25")
    content = body(content=weight + "\n" + ball, pose=moved(1, 2, 3, turn=(0, 0, 90), scale=(2, 2, 2)))
    scene = read(tmp_path, content)
    np.testing.assert_allclose(scene.bodies[0].position, (1, 3, 3), atol=1e-12)
    (shape,) = scene.shapes
    assert shape.form() == wc.shapes.Sphere(0.5)
    np.testing.assert_allclose(shape.positions[0], (-1, 0, 0), atol=1e-12)


def test_stage_units_and_up_axis_are_converted_to_si_and_z_up(tmp_path):
    content = prim("PhysicsScene", "scene") + body(
        content="float physics:mass = 2000\nfloat3 physics:diagonalInertia = (1e6, 2e6, 2.5e6)\n"
        "vector3f physics:velocity = (0, 100, 0)\nvector3f physics:angularVelocity = (0, 180, 0)",
        pose=moved(100, 200, 300),
    )
    header = "kilogramsPerUnit = 0.001\n"
    scene = read(tmp_path, content, metadata={"metres": 0.01, "up": "Y", "header": header})
    (found,) = scene.bodies
    np.testing.assert_allclose(found.position, (1, -3, 2))
    np.testing.assert_allclose(found.linear_velocity, (0, 0, 1), atol=1e-12)
    np.testing.assert_allclose(found.angular_velocity, (0, 0, np.pi), atol=1e-12)
    np.testing.assert_allclose([found.mass, *np.diag(found.inertia)], (2, 0.1, 0.2, 0.25), rtol=SINGLE)
    np.testing.assert_allclose(scene.gravity, (0, 0, -9.81), atol=1e-12)
    assert any("up axis is Y" in remark for remark in scene.import_warnings)
    # The axes of the body are those of its prim: its y axis is up.
    np.testing.assert_allclose(Rotation.from_quat(found.orientation).apply((0, 1, 0)), (0, 0, 1), atol=1e-12)


def test_stage_without_unit_is_in_centimeters_with_a_warning(tmp_path):
    scene = read(tmp_path, body(content=WEIGHT, pose=moved(100, 0, 0)), metadata={"metres": None})
    np.testing.assert_allclose(scene.bodies[0].position, (1, 0, 0))
    assert any("the unit is 0.01 m" in remark for remark in scene.import_warnings)


@pytest.mark.parametrize(
    ("scene_attributes", "expected"),
    [
        ("", (0, 0, -9.81)),
        ("float physics:gravityMagnitude = 3", (0, 0, -3)),
        ("float physics:gravityMagnitude = 0", (0, 0, 0)),
        ("vector3f physics:gravityDirection = (1, 0, 0)\nfloat physics:gravityMagnitude = 2", (2, 0, 0)),
        ("vector3f physics:gravityDirection = (0, 2, 0)", (0, 9.81, 0)),
    ],
)
def test_imported_gravity_matches_the_physics_scene(tmp_path, scene_attributes, expected):
    scene = read(tmp_path, prim("PhysicsScene", "scene", content=scene_attributes) + body(content=WEIGHT))
    np.testing.assert_allclose(scene.gravity, expected, atol=1e-12)


def solid(kind, sizes):
    return prim(kind, "part", COLLIDER, sizes)


PI = np.pi
SOLIDS = {  # volume, and principal moments over the mass, in closed form
    "Sphere": ("double radius = 0.3", 4 / 3 * PI * 0.027, [0.4 * 0.09] * 3),
    "Cube": ("double size = 0.6", 0.216, [0.06] * 3),
    "Cylinder": (
        'double radius = 0.2\ndouble height = 0.6\nuniform token axis = "X"',
        PI * 0.04 * 0.6,
        [0.02, 0.04, 0.04],
    ),
    "Cone": ("double radius = 0.2\ndouble height = 0.6", PI * 0.04 * 0.2, [0.0195, 0.0195, 0.012]),
    "Capsule": (
        'double radius = 0.2\ndouble height = 0.6\nuniform token axis = "Y"',
        PI * 0.04 * (0.6 + 0.8 / 3),
        None,
    ),
    "Mesh": (mesh(CUBE.replace("1", "0.3")), 0.216, [0.06] * 3),
}


@pytest.mark.parametrize("kind", SOLIDS)
def test_body_without_mass_has_the_mass_of_its_colliders(tmp_path, kind):
    sizes, volume, moments = SOLIDS[kind]
    found = one(tmp_path, body(content=solid(kind, sizes), apis=BODY.replace(', "PhysicsMassAPI"', "")))
    assert found.mass == pytest.approx(1000 * volume, rel=SINGLE)
    if moments is not None:
        np.testing.assert_allclose(np.diag(found.inertia) / found.mass, moments, rtol=1e-6)
    if kind == "Cone":  # a quarter of the height above its base
        np.testing.assert_allclose(found.position, (0, 0, -0.15), atol=1e-9)


def test_capsule_inertia_matches_sampling(tmp_path):
    found = one(tmp_path, body(content=solid("Capsule", SOLIDS["Capsule"][0]), apis=BODY))
    random = np.random.default_rng(0).uniform((-0.2, -0.5, -0.2), (0.2, 0.5, 0.2), (2_000_000, 3))
    axis = np.clip(random[:, 1], -0.3, 0.3)
    inside = random[np.linalg.norm(random - np.outer(axis, (0, 1, 0)), axis=1) < 0.2]
    second = inside.T @ inside / len(inside)
    # Two million points: an error of 1e-3.
    expected = np.trace(second) * np.eye(3) - second
    np.testing.assert_allclose(found.inertia / found.mass, expected, atol=2e-3 * expected.max())


def test_scaled_colliders_have_scaled_mass_and_shape(tmp_path):
    box = prim("Cube", "box", COLLIDER, "double size = 1\n" + moved(0, 0, 1, scale=(0.2, 0.4, -0.6)))
    egg = prim("Sphere", "egg", COLLIDER, "double radius = 1\n" + moved(0, 0, -1, scale=(0.1, 0.2, 0.3)))
    scene = read(tmp_path, body(content=box + egg, apis=BODY))
    volume = 0.048 + 4 / 3 * PI * 0.006
    assert scene.bodies[0].mass == pytest.approx(1000 * volume, rel=SINGLE)
    forms = [shape.form() for shape in scene.shapes]
    np.testing.assert_allclose(forms[0].half_extents, (0.1, 0.2, 0.3))
    np.testing.assert_allclose(sorted(forms[1].semi_axes), (0.1, 0.2, 0.3))
    longest = np.eye(3)[int(np.argmax(forms[1].semi_axes))]
    assert abs(Rotation.from_quat(scene.shapes[1].orientations[0]).apply(longest)[2]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("parts", "density"),
    [
        ("", 1000.0),
        ("material", 700.0),
        ("body material", 300.0),
        ("body material collider", 500.0),
    ],
)
def test_collider_density_overrides_material_and_body_density(tmp_path, parts, density):
    material = prim(
        "Material", "stuff", 'prepend apiSchemas = ["PhysicsMaterialAPI"]', "float physics:density = 700"
    )
    apis = 'prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMassAPI", "MaterialBindingAPI"]'
    own = "double size = 1\n"
    own += "float physics:density = 500\n" if "collider" in parts else ""
    own += "rel material:binding:physics = </stuff>\n" if "material" in parts else ""
    scene_attributes = "float physics:density = 300\n" if "body" in parts else ""
    scene = read(tmp_path, material + body(content=scene_attributes + prim("Cube", "part", apis, own)))
    assert scene.bodies[0].mass == pytest.approx(density, rel=SINGLE)


def test_body_mass_overrides_collider_masses(tmp_path):
    apis = 'prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMassAPI"]'
    parts = "".join(
        prim("Cube", f"part_{i}", apis, f"double size = 1\nfloat physics:mass = {i}\n" + moved(2 * i, 0, 0))
        for i in (1, 3)
    )
    alone = one(tmp_path, body(content=parts))
    assert alone.mass == pytest.approx(4.0)
    np.testing.assert_allclose(alone.position, (5, 0, 0))  # (1·2 + 3·6)/4
    np.testing.assert_allclose(np.diag(alone.inertia), (4 / 6, 4 / 6 + 12, 4 / 6 + 12), rtol=1e-12)
    with_mass = one(tmp_path, body(content="float physics:mass = 8\n" + parts))
    np.testing.assert_allclose(with_mass.inertia, 2 * alone.inertia, rtol=1e-6)
    np.testing.assert_allclose(with_mass.position, (5, 0, 0))


def test_imported_velocities_are_in_the_frame_of_the_parent(tmp_path):
    inner = body(
        content=f"{WEIGHT}\nvector3f physics:velocity = (1, 0, 0)\nvector3f physics:angularVelocity = (90, 0, 0)"
    )
    found = one(tmp_path, prim("Xform", "outer", "", moved(0, 0, 0, turn=(0, 0, 90), scale=(2, 2, 2)) + inner))
    np.testing.assert_allclose(found.linear_velocity, (0, 2, 0), atol=1e-12)
    np.testing.assert_allclose(found.angular_velocity, (0, PI / 2, 0), atol=1e-12)


def test_kinematic_bodies_are_fixed_or_keep_their_velocity(tmp_path):
    still = body("still", "bool physics:kinematicEnabled = 1")
    going = body("going", "bool physics:kinematicEnabled = 1\nvector3f physics:velocity = (1, 0, 0)")
    scene = read(tmp_path, still + going)
    assert [type(one.motion) for one in scene.bodies] == [wc.motions.Fixed, wc.motions.Prescribed]


@pytest.mark.smoke
def test_material_pair_is_averaged_to_law_and_friction(tmp_path):
    def material(name, static, dynamic, restitution):
        api = 'prepend apiSchemas = ["PhysicsMaterialAPI"]'
        values = {"staticFriction": static, "dynamicFriction": dynamic, "restitution": restitution}
        return prim("Material", name, api, "\n".join(f"float physics:{key} = {v}" for key, v in values.items()))

    ball = prim("Sphere", "ball", SHAPE, "double radius = 0.1\nrel material:binding:physics = </ice>")
    floor = prim("Plane", "floor", SHAPE, 'uniform token axis = "Z"\nrel material:binding:physics = </rough>')
    content = material("ice", 0.2, 0.1, 0.5) + material("rough", 1.0, 0.7, 0.1)
    scene = read(tmp_path, content + body(content="float physics:mass = 3\n" + ball) + floor, contact_time=0.02)
    (contact,) = scene.shape_contacts
    law, friction = contact.material.law, contact.material.friction
    assert (friction.mu_static, friction.mu_dynamic) == pytest.approx((0.6, 0.4), rel=SINGLE)
    assert law.restitution == pytest.approx(0.3, rel=SINGLE)
    # Half a period of mass and spring is the contact time.
    assert PI * np.sqrt(3.0 / law.stiffness) == pytest.approx(0.02, rel=SINGLE)
    own = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e5))
    assert read(tmp_path, content + body(content=ball) + floor, material=own).shape_contacts[0].material is own


def names(scene):
    return sorted(contact_pairs(scene))


def three(more="", filtered=""):
    """A static floor and two bodies with a box each."""
    part = [prim("Cube", f"box_{i}", COLLIDER, "double size = 1") for i in range(2)]
    bodies = "".join(body(f"body_{i}", filtered * (i == 0) + part[i], moved(3 * i, 0, 2)) for i in range(2))
    return prim("Plane", "floor", COLLIDER, 'uniform token axis = "Z"') + bodies + more


EVERY = [("box_0", "box_1"), ("box_0", "floor"), ("box_1", "floor")]


def test_all_collider_pairs_of_different_bodies_contact_if_one_moves(tmp_path):
    assert names(read(tmp_path, three())) == EVERY
    fixed = prim("Cube", "wall", COLLIDER, "double size = 1") + body(
        "held", "bool physics:kinematicEnabled = 1\n" + prim("Cube", "lid", COLLIDER, "double size = 1")
    )
    expected = sorted([*EVERY, *((f"box_{i}", other) for i in range(2) for other in ("lid", "wall"))])
    assert names(read(tmp_path, three(fixed))) == expected


def group(name, *members, filtered="", more=""):
    targets = ", ".join(f"<{one}>" for one in members)
    return prim(
        "PhysicsCollisionGroup", name, "", f"rel collection:colliders:includes = [{targets}]\n{filtered}\n{more}"
    )


@pytest.mark.parametrize(
    ("more", "left"),
    [
        (group("g", "/body_0", "/body_1", filtered="rel physics:filteredGroups = </g>"), EVERY[1:]),
        (
            group("g", "/body_0", filtered="rel physics:filteredGroups = </h>") + group("h", "/floor"),
            [EVERY[0], EVERY[2]],
        ),
        (
            group("g", "/body_0", "/floor", filtered="rel physics:filteredGroups = </g>",
                  more="bool physics:invertFilteredGroups = 1") + group("h", "/body_1"),
            [EVERY[1]],
        ),
        (
            group("g", "/body_0", filtered="rel physics:filteredGroups = </h>")
            + group("h", more='string physics:mergeGroup = "m"')
            + group("i", "/body_1", more='string physics:mergeGroup = "m"'),
            EVERY[1:],
        ),
        (group("g", "/body_0", "/body_1", filtered="rel physics:filteredGroups = </nowhere>"), EVERY),
        (
            group("g", "/body_0", filtered="rel physics:filteredGroups = </h>",
                  more="bool physics:invertFilteredGroups = 1") + group("h", "/floor"),
            EVERY[1:],
        ),
    ],
    ids=["itself", "another", "inverted", "merged", "nowhere", "inverted and ungrouped"],
)  # fmt: skip
def test_collision_groups_exclude_contacts(tmp_path, more, left):
    assert names(read(tmp_path, three(more))) == left


def test_filtered_pairs_exclude_contacts_below_both_prims(tmp_path):
    apis = BODY.replace('"PhysicsMassAPI"', '"PhysicsMassAPI", "PhysicsFilteredPairsAPI"')
    content = three(filtered="rel physics:filteredPairs = </body_1>\n").replace(BODY, apis, 1)
    assert names(read(tmp_path, content)) == EVERY[1:]


def drop(tmp_path, collider, floor, steps=3000, **options):
    """Height of a body of 1 kg above the floor after its fall."""
    content = body(content="float physics:mass = 1\n" + collider, pose=moved(0, 0, 0.301)) + floor
    scene = read(tmp_path, content, **options)
    model = scene.build(device="cpu", precision="float64")
    sim = wc.Simulation(model, dt=2e-4)
    sim.step(steps)
    assert not len(model.health().frozen)
    return float(sim.state.body_position.numpy()[0, 0, 2])


CUBE_OF = {
    "Cube": prim("Cube", "part", COLLIDER, "double size = 0.6"),
    "Mesh": prim("Mesh", "part", COLLIDER, mesh(CUBE.replace("1", "0.3"))),
    "Sphere": prim("Sphere", "part", COLLIDER, "double radius = 0.3"),
    "Cylinder": prim("Cylinder", "part", COLLIDER, "double radius = 0.2\ndouble height = 0.6"),
}
FLOOR_OF = {
    "Plane": prim("Plane", "floor", COLLIDER, 'uniform token axis = "Z"'),
    "Mesh": prim("Mesh", "floor", COLLIDER, mesh("(-2,-2,0), (2,-2,0), (2,2,0), (-2,2,0)", "0,1,2,3", "4")),
    "Cube": prim("Cube", "floor", COLLIDER, "double size = 1\n" + moved(0, 0, -0.5, scale=(4, 4, 1))),
}


@pytest.mark.slow
@pytest.mark.parametrize("floor", FLOOR_OF)
@pytest.mark.parametrize("part", CUBE_OF)
def test_imported_body_comes_to_rest_for_every_pair_of_collider_types(tmp_path, part, floor):
    # The penetration is at most g (T/π)², 0.1 mm for a contact time T of 0.01 s; twice that if each side of two
    # meshes carries half. After half a second, a fall of 1 mm has ended.
    assert drop(tmp_path, CUBE_OF[part], FLOOR_OF[floor]) == pytest.approx(0.3, abs=2.5e-4)


def test_many_spheres_of_one_material_become_particle_contact(tmp_path):
    ball = prim("Sphere", "ball", COLLIDER, "double radius = 0.1")
    scene = read(tmp_path, "".join(body(f"grain_{i}", ball, moved(0.3 * i, 0, 0)) for i in range(40)))
    (pile,) = scene.particle_contacts
    assert (pile.count, len(scene.shape_contacts)) == (40, 0)


@pytest.mark.parametrize("approximation", ["convexHull", "boundingCube", "boundingSphere", "none", "sdf"])
def test_mesh_collider_follows_its_approximation(tmp_path, approximation):
    apis = 'prepend apiSchemas = ["PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"]'
    own = mesh(more=f'uniform token physics:approximation = "{approximation}"')
    scene = read(tmp_path, body(content=WEIGHT + "\n" + prim("Mesh", "part", apis, own)))
    if approximation == "boundingCube":
        assert scene.shapes[0].form() == wc.shapes.RoundedBox((1.0, 1.0, 1.0))
    elif approximation == "boundingSphere":
        assert scene.shapes[0].form().radius == pytest.approx(np.sqrt(3.0))
    else:
        assert scene.surfaces[0].mesh.report.volume == pytest.approx(8.0)
    assert any("sdf is not applied" in remark for remark in scene.import_warnings) == (approximation == "sdf")


@pytest.mark.parametrize("scale", [(1, 1, 1), (-1, 1, 1), (-1, -1, -1)])
@pytest.mark.parametrize("hand", ["rightHanded", "leftHanded"])
def test_imported_mesh_is_outward_for_any_handedness_and_mirroring(tmp_path, scale, hand):
    indices = SIDES
    if hand == "leftHanded":
        quads = [part.split(",") for part in SIDES.split(", ")]
        indices = ", ".join(",".join(reversed(quad)) for quad in quads)
    own = mesh(indices=indices, more=f'uniform token orientation = "{hand}"\n' + moved(0, 0, 0, scale=scale))
    scene = read(tmp_path, prim("Mesh", "static", COLLIDER, own) + body(content=WEIGHT))
    assert scene.surfaces[0].mesh.report.volume == pytest.approx(8.0)
    assert not [remark for remark in scene.import_warnings if "turned" in remark]


def test_instances_are_imported_at_their_poses(tmp_path):
    (tmp_path / "part.usda").write_text(
        '#usda 1.0\n(defaultPrim = "part")\n'
        + prim("Xform", "part", "", prim("Cube", "box", COLLIDER, "double size = 1"))
    )
    apis = 'prepend references = @part.usda@\ninstanceable = true\nprepend apiSchemas = ["PhysicsRigidBodyAPI"]'
    scene = read(tmp_path, "".join(body(f"copy_{i}", pose=moved(3 * i, 0, 0), apis=apis) for i in range(2)))
    np.testing.assert_allclose([one.position for one in scene.bodies], [(0, 0, 0), (3, 0, 0)])
    assert names(scene) == [("box", "box_2")]


def test_element_names_are_valid_unique_prim_names(tmp_path):
    ball = prim("Sphere", "part", COLLIDER, "double radius = 0.1")
    long = "a" * 10_000
    content = "".join(body(name, ball, moved(i, 0, 0)) for i, name in enumerate(["scene", "part", long, "größe"]))
    scene = read(tmp_path, content)
    assert [one.name for one in scene.bodies] == ["scene_2", "part", "a" * 60, "gr__e"]
    assert [one.name for one in scene.shapes] == ["part_2", "part_3", "part_4", "part_5"]


def test_render_only_shapes_and_disabled_colliders_are_reported(tmp_path):
    look = prim("Sphere", "look", "", "double radius = 1")
    off = prim("Sphere", "off", COLLIDER, "double radius = 1\nbool physics:collisionEnabled = 0")
    scene = read(tmp_path, body(content=WEIGHT + "\n" + look + off))
    assert any("1 shapes without CollisionAPI" in remark for remark in scene.import_warnings)
    assert any("/body/off: physics:collisionEnabled is off" in remark for remark in scene.import_warnings)
    assert not scene.shapes


def test_imported_scene_runs_with_nonsmooth_contact(tmp_path):
    content = body(content="float physics:mass = 1\n" + CUBE_OF["Cube"], pose=moved(0, 0, 0.3)) + FLOOR_OF["Plane"]
    sim = wc.Simulation(
        read(tmp_path, content).build(device="cpu"), dt=2e-3, integrator=wc.integrators.MoreauJean()
    )
    sim.step(200)
    # Nonsmooth contact: penetration is limited to the tolerance of the solver.
    assert sim.state.body_position.numpy()[0, 0, 2] == pytest.approx(0.3, abs=1e-5)


def test_usdz_package_is_imported(tmp_path):
    path = stage(tmp_path, body(content=WEIGHT))
    package = tmp_path / "stage.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(path), str(package))
    assert [one.name for one in wc.Scene.from_usd(package).bodies] == ["body"]


def test_usd_reader_process_does_not_import_warp():
    root = Path(wc.__file__).parent
    folders = {"warpcontact": root, "warpcontact.meshes": root / "meshes", "warpcontact.usd": root / "usd"}
    packages = {name: str(folder) for name, folder in folders.items()}
    script = (
        "import sys, types\n"
        f"for name, folder in {packages!r}.items():\n"
        "    sys.modules[name] = types.ModuleType(name)\n"
        "    sys.modules[name].__path__ = [folder]\n"
        "import warpcontact.usd.importing.stage\n"
        "assert 'warp' not in sys.modules and 'warpcontact.scene.scene_data' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)
