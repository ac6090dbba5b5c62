"""Import of NewtonMaterialAPI, NewtonSceneAPI, NewtonMassAPI and NewtonCollisionAPI."""

import numpy as np
import pytest
from physics_stages import COLLIDER, WEIGHT, body, mesh, moved, prim, stage

import warpcontact as wc

pytestmark = pytest.mark.installed

SINGLE = 1e-6  # attributes are in single precision
BOUND = 'prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]'
PLANE = 'uniform token axis = "Z"\n'


def read(tmp_path, content, *, metadata=None, **options):
    # Trusted: avoids the start of a process, which takes a second.
    return wc.Scene.from_usd(stage(tmp_path, content, **(metadata or {})), trusted=True, **options)


def material(name="m", apis='"NewtonMaterialAPI"', **values):
    lines = "\n".join(f"float {key.replace('_', ':')} = {value}" for key, value in values.items())
    return prim("Material", name, f"prepend apiSchemas = [{apis}]", lines)


def ball(kind="Sphere", sizes="double radius = 0.1\n", bound="m"):
    binding = f"rel material:binding:physics = </{bound}>\n" if bound else ""
    return body("ball", "float physics:mass = 3\n" + prim(kind, "skin", BOUND, sizes + binding))


def floor(kind="Plane", sizes=PLANE, bound="m"):
    binding = f"rel material:binding:physics = </{bound}>\n" if bound else ""
    return prim(kind, "floor", BOUND, sizes + binding)


def pair(tmp_path, materials, *, one=None, other=None, **options):
    """Contact of a ball of 0.1 m and 3 kg with a floor: its material, and the scene."""
    scene = read(tmp_path, materials + (ball() if one is None else one) + (other or floor()), **options)
    contacts = [*scene.shape_contacts, *scene.contacts, *scene.body_contacts]
    return contacts[0].material, scene


def test_stiffness_and_damping_of_materials_are_those_of_the_law(tmp_path):
    given = {"newton_contactStiffness": 12345.0, "newton_contactDamping": 67.0, "physics_dynamicFriction": 0.3}
    found, scene = pair(tmp_path, material(**given))
    assert (found.law.stiffness, found.law.damping) == pytest.approx((12345.0, 67.0), rel=SINGLE)
    assert found.law.restitution is None
    assert not any("settings of other programs" in remark for remark in scene.import_warnings)


def test_values_of_two_materials_are_averaged_only_if_both_are_authored(tmp_path):
    one = material("m", newton_contactStiffness=1e4, newton_rollingFriction=0.01, newton_contactDamping="-inf")
    two = material("n", newton_contactStiffness=3e4, physics_restitution=0.4)
    found, _ = pair(tmp_path, one + two, other=floor(bound="n"))
    assert (found.law.stiffness, found.law.restitution) == pytest.approx((2e4, 0.2), rel=SINGLE)
    # Radius 0.1 m: the torque is μ R N = 0.01 m × N.
    assert found.rolling.mu_dynamic == pytest.approx(0.1, rel=SINGLE)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"dynamic": 0.3}, (0.3, 0.3)),
        ({"static": 0.6}, (0.6, 0.6)),
        ({"static": 0.6, "dynamic": 0.0}, (0.6, 0.0)),
        ({}, (0.5, 0.5)),
    ],
)
def test_unauthored_coefficient_of_friction_is_not_zero(tmp_path, values, expected):
    named = {f"physics_{key}Friction": value for key, value in values.items()}
    found, scene = pair(tmp_path, material(apis='"PhysicsMaterialAPI"', **named))
    assert (found.friction.mu_static, found.friction.mu_dynamic) == pytest.approx(expected, rel=SINGLE)
    assert any("/m: the material has no authored friction" in remark for remark in scene.import_warnings) == (
        not values
    )
    # With a collider without material, 0.5, dynamic friction does not exceed static friction either.
    mixed, _ = pair(tmp_path, material(apis='"PhysicsMaterialAPI"', **named), other=floor(bound=None))
    assert mixed.friction.mu_static >= mixed.friction.mu_dynamic


def test_torsional_friction_is_the_torsion_radius(tmp_path):
    found, scene = pair(tmp_path, material(newton_torsionalFriction=0.02))
    (contact,) = scene.shape_contacts
    assert found.torsion.mu_dynamic * float(contact.torsion_radius) == pytest.approx(0.02, rel=SINGLE)
    # A spring with the period of the contact: J/r² of a solid sphere, in a contact of 3 kg.
    effective = 0.4 * 3.0 * 0.1**2 / 0.02**2
    assert found.torsion.stiffness / effective == pytest.approx(found.law.stiffness / 3.0, rel=1e-5)


@pytest.mark.parametrize(
    ("one", "other", "radius"),
    [
        (ball(), floor(), 0.1),
        (ball(), floor("Cube", "double size = 1\n" + moved(0, 0, -1)), 0.1),
        (ball(), floor("Sphere", "double radius = 0.3\n" + moved(0, 0, -1)), 0.075),
        (ball(), floor("Mesh", mesh("(-2,-2,0), (2,-2,0), (2,2,0), (-2,2,0)", "0,1,2,3", "4")), 0.1),
        (ball("Cylinder", "double radius = 0.2\ndouble height = 1\n"), floor(), 0.2),
        (ball("Capsule", "double radius = 0.2\ndouble height = 1\n"), floor(), 0.2),
        (ball("Cube", "double size = 1\n"), floor(), None),
        (ball("Capsule", "double radius = 0.2\n"), floor("Capsule", "double radius = 0.2\n"), None),
        (ball("Mesh", mesh()), floor(), None),
    ],
)  # fmt: skip
def test_rolling_friction_without_radius_is_reported(tmp_path, one, other, radius):
    found, scene = pair(tmp_path, material(newton_rollingFriction=0.01), one=one, other=other)
    named = [
        remark for remark in scene.import_warnings if "newton:rollingFriction is ignored in 1 contacts" in remark
    ]
    if radius is None:
        assert isinstance(found.rolling, wc.friction.Frictionless)
        assert named
    else:
        assert found.rolling.mu_static == pytest.approx(0.01 / radius, rel=SINGLE)
        assert not named


def test_rolling_friction_among_many_spheres_needs_equal_radii(tmp_path):
    for radius, rolls in ((0.1, True), (0.2, False)):
        sizes = [0.1] * 39 + [radius]
        content = "".join(
            body(f"grain_{i}", prim("Sphere", "skin", BOUND, f"double radius = {size}\n"
                 "rel material:binding:physics = </m>\n"), moved(0.5 * i, 0, 0))
            for i, size in enumerate(sizes)
        )  # fmt: skip
        (pile,) = read(tmp_path, material(newton_rollingFriction=0.01) + content).particle_contacts
        # 1/R = 1/R₁ + 1/R₂.
        assert getattr(pile.material.rolling, "mu_static", None) == (pytest.approx(0.2) if rolls else None)


def test_units_of_materials_are_those_of_the_stage(tmp_path):
    values = {"contactStiffness": 1e7, "contactDamping": 1e5, "rollingFriction": 1.0, "torsionalFriction": 2.0}
    named = {f"newton_{key}": value for key, value in values.items()}
    skin = ball("Sphere", "double radius = 10\n")
    metadata = {"metres": 0.01, "header": "kilogramsPerUnit = 0.001\n"}
    found, scene = pair(tmp_path, material(**named), one=skin, metadata=metadata)
    assert (found.law.stiffness, found.law.damping) == pytest.approx((1e4, 1e2), rel=SINGLE)
    assert found.rolling.mu_static == pytest.approx(0.01 / 0.1, rel=SINGLE)
    assert float(scene.shape_contacts[0].torsion_radius) == pytest.approx(0.02, rel=SINGLE)


def test_each_value_without_a_counterpart_is_reported(tmp_path):
    given = {
        "physics_restitution": 0.5,
        "newton_contactDamping": 67.0,
        "newton_contactFrictionGain": 1000.0,
        "newton_contactAdhesion": 0.001,
    }
    skin = ball("Sphere", "double radius = 0.1\nfloat newton:contactMargin = 0.002\n").replace(
        '"PhysicsCollisionAPI"', '"NewtonCollisionAPI"'
    )
    _, scene = pair(tmp_path, material(**given), one=skin)
    warnings_text = "\n".join(scene.import_warnings)
    for sentence in (
        "/m: newton:contactFrictionGain 1000 is ignored",
        "/m: newton:contactAdhesion 0.001 is ignored",
        "/ball/skin: newton:contactMargin 0.002 is ignored",
        "1 contacts use newton:contactDamping and ignore physics:restitution",
    ):
        assert sentence in warnings_text


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("contactStiffness", 0, "must be greater than 0, got 0"),
        ("contactStiffness", "inf", "must be greater than 0, got inf"),
        ("contactDamping", -1, "must be at least 0, got -1"),
        ("rollingFriction", "nan", "must be at least 0, got nan"),
        ("torsionalFriction", -0.1, "must be at least 0, got -0.1"),
    ],
)
def test_material_value_out_of_range_is_refused(tmp_path, name, value, message):
    with pytest.raises(wc.UsdError, match=f"/m: newton:{name} {message}"):
        pair(tmp_path, material(**{f"newton_{name}": value}))


def scene_of(tmp_path, settings, apis='"NewtonSceneAPI"'):
    physics = prim("PhysicsScene", "physics", f"prepend apiSchemas = [{apis}]", settings)
    return read(tmp_path, physics + body(content=WEIGHT))


def test_time_step_and_iterations_of_the_stage_are_suggested_by_the_scene(tmp_path):
    settings = "uniform int newton:timeStepsPerSecond = 400\nuniform int newton:maxSolverIterations = 50"
    scene = scene_of(tmp_path, settings)
    assert (scene.suggested_dt, scene.suggested_iterations) == (0.0025, 50)
    for nothing in ("", "uniform int newton:maxSolverIterations = -1"):
        scene = scene_of(tmp_path, nothing)
        assert (scene.suggested_dt, scene.suggested_iterations) == (None, None)
    with pytest.raises(wc.UsdError, match="/physics: newton:timeStepsPerSecond must be at least 1, got 0"):
        scene_of(tmp_path, "uniform int newton:timeStepsPerSecond = 0")


def test_disabled_gravity_is_zero(tmp_path):
    scene = scene_of(tmp_path, "bool newton:gravityEnabled = 0")
    np.testing.assert_array_equal(scene.gravity, 0.0)
    assert any("newton:gravityEnabled is off" in remark for remark in scene.import_warnings)


def test_schemas_of_newton_include_those_of_usd_physics(tmp_path):
    tensor = "double[] newton:inertia = [1, 2, 2.5, 0.1, 0.2, 0.3]\nfloat physics:mass = 7\n"
    apis = 'prepend apiSchemas = ["PhysicsRigidBodyAPI", "NewtonMassAPI"]'
    hull = 'uniform token physics:approximation = "boundingCube"\n'
    part = prim("Mesh", "part", 'prepend apiSchemas = ["NewtonMeshCollisionAPI"]', mesh(more=hull))
    scene = read(tmp_path, body("box", tensor + part, apis=apis))
    (box,) = scene.bodies
    assert float(box.mass) == pytest.approx(7.0)
    np.testing.assert_allclose(box.inertia, [[1, 0.1, 0.2], [0.1, 2, 0.3], [0.2, 0.3, 2.5]], rtol=1e-12)
    assert scene.shapes[0].form() == wc.shapes.RoundedBox((1.0, 1.0, 1.0))
    root = prim("Xform", "robot", 'prepend apiSchemas = ["NewtonArticulationRootAPI"]')
    with pytest.raises(wc.UsdError, match="/robot: an articulation"):
        read(tmp_path, root + body("box", tensor + part, apis=apis))


@pytest.mark.parametrize(
    ("tensor", "message"),
    [
        ("[1, 2, 2.5]", "must be 6 finite numbers"),
        ("[1, 2, nan, 0, 0, 0]", "must be 6 finite numbers"),
        ("[1, 2, -2.5, 0, 0, 0]", "must have positive principal moments"),
        ("[1, 1, 1, 2, 0, 0]", "must have positive principal moments"),
    ],
)
def test_unphysical_inertia_tensor_is_refused(tmp_path, tensor, message):
    apis = 'prepend apiSchemas = ["PhysicsRigidBodyAPI", "NewtonMassAPI"]'
    content = f"double[] newton:inertia = {tensor}\n{prim('Cube', 'part', COLLIDER, 'double size = 1')}"
    with pytest.raises(wc.UsdError, match=f"/box: newton:inertia {message}"):
        read(tmp_path, body("box", content, apis=apis))


def test_mass_of_a_shell_is_refused_or_replaced_by_that_of_a_solid(tmp_path):
    apis = 'prepend apiSchemas = ["NewtonCollisionAPI", "NewtonMassAPI"]'
    content = body(
        "box", prim("Cube", "part", apis, 'double size = 1\nuniform token newton:massModel = "shell"\n')
    )
    with pytest.raises(wc.UsdError, match="/box/part: newton:massModel shell"):
        read(tmp_path, content)
    scene = read(tmp_path, content, skip_unsupported=True)
    assert float(scene.bodies[0].mass) == pytest.approx(1000.0)


@pytest.mark.slow
def test_rolling_and_spinning_ball_slows_down_by_the_friction_of_its_material(tmp_path):
    values = {"rollingFriction": 0.002, "torsionalFriction": 0.004}
    stuff = material(**{f"newton_{key}": value for key, value in values.items()}, physics_dynamicFriction=0.5)
    degrees = np.degrees([0.0, 10.0, 20.0]).tolist()
    moving = f"vector3f physics:velocity = (1, 0, 0)\nvector3f physics:angularVelocity = {tuple(degrees)}\n"
    skin = prim("Sphere", "skin", BOUND, "double radius = 0.1\nrel material:binding:physics = </m>\n")
    scene = read(
        tmp_path, stuff + body("ball", "float physics:mass = 3\n" + moving + skin, moved(0, 0, 0.1)) + floor()
    )
    simulation = wc.Simulation(scene.build(device="cpu", precision="float64"), dt=1e-4)
    names = ["ball.linear_velocity", "ball.angular_velocity"]
    found = simulation.run(0.5, names, every=0.25)
    v, w = (found[name].values[:, 0] for name in names)
    # A rolling solid sphere: (1 + 2/5) a = ρ g/R; a spinning one: (2/5) m R² α = τ m g. The ball has settled in
    # the second half.
    assert (v[1, 0] - v[2, 0]) / 0.25 == pytest.approx(0.002 / 0.1 * 9.81 / 1.4, rel=1e-3)
    assert (w[1, 2] - w[2, 2]) / 0.25 == pytest.approx(0.004 * 9.81 / (0.4 * 0.1**2), rel=1e-3)
