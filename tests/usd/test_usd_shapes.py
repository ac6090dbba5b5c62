"""Shapes and shape contacts on USD stages: primitives, meshes, sizes per environment, forces."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdValidation
from recorded_usd_scene import arrows

import warpcontact as wc
from warpcontact.scene.shapes import tessellate

SOFT = wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3))
FORMS = {
    "ball": wc.shapes.Sphere(0.1),
    "egg": wc.shapes.Ellipsoid((0.2, 0.1, 0.15)),
    "rod": wc.shapes.Capsule(0.05, 0.2),
    "can": wc.shapes.Cylinder(0.1, 0.2),
    "hat": wc.shapes.Cone(0.1, 0.3),
    "brick": wc.shapes.RoundedBox((0.1, 0.2, 0.3), 0.02),
    "pillow": wc.shapes.Superellipsoid((0.1, 0.2, 0.3), (0.5, 0.7)),
    "ring": wc.shapes.Torus(0.2, 0.05),
}


@pytest.fixture(scope="module")
def stage(device, tmp_path_factory):
    scene = wc.Scene()
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    for number, (name, form) in enumerate(FORMS.items()):
        body = scene.add_body(1.0, (0.1, 0.1, 0.1), (number, 0, 0.09), name=f"body_{name}")
        shape = scene.add_shape(body, form, (0.0, 0.0, 0.01), name=name)
        if name == "ball":
            scene.add_shape_contact(shape, floor, SOFT, name="touch")
    grains = scene.add_bodies([(x, 1.0, 1.0) for x in range(3)], mass=1.0, inertia=(1.0, 1.0, 1.0), name="grains")
    scene.add_shape(grains, [wc.shapes.Sphere(r) for r in (0.1, 0.2, 0.3)], name="sizes")
    model = scene.build(2, device)
    model["ball.radius"] = [0.1, 0.12]
    names = [f"touch.{key}" for key in ("normal_force", "normal", "point", "curvature_2")]
    recording = wc.Simulation(model, dt=1e-3).run(0.003, names)
    path = wc.export_usd(recording, tmp_path_factory.mktemp("usd") / "shapes.usda")
    return Usd.Stage.Open(str(path))


def bounds(prim):
    box = UsdGeom.BBoxCache(0.0, [UsdGeom.Tokens.default_]).ComputeLocalBound(prim).ComputeAlignedRange()
    return np.array([box.GetMin(), box.GetMax()])


@pytest.mark.parametrize(
    ("name", "kind", "low", "high"),
    [
        ("egg", "Mesh", (-0.2, -0.1, -0.15), (0.2, 0.1, 0.15)),
        ("rod", "Capsule", (-0.05, -0.05, -0.25), (0.05, 0.05, 0.25)),
        ("can", "Cylinder", (-0.1, -0.1, -0.2), (0.1, 0.1, 0.2)),
        ("hat", "Cone", (-0.1, -0.1, 0.0), (0.1, 0.1, 0.3)),
        ("brick", "Mesh", (-0.1, -0.2, -0.3), (0.1, 0.2, 0.3)),
        ("pillow", "Mesh", (-0.1, -0.2, -0.3), (0.1, 0.2, 0.3)),
        ("ring", "Mesh", (-0.25, -0.25, -0.05), (0.25, 0.25, 0.05)),
    ],
)
def test_usd_shapes_have_the_size_of_their_parameters(stage, name, kind, low, high):
    prim = stage.GetPrimAtPath(f"/World/env_0/body_{name}/{name}")
    assert prim.GetTypeName() == kind
    # Shifted by 0.01 m; single precision.
    np.testing.assert_allclose(bounds(prim), np.add([low, high], (0, 0, 0.01)), atol=1e-6)


def test_usd_shape_colliders_pass_all_validators(stage):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [error.GetErrorAsString() for error in errors] == []


def test_usd_shape_sizes_are_those_of_each_environment(stage):
    radii = [
        stage.GetPrimAtPath(f"/World/env_{env}/body_ball/ball").GetAttribute("radius").Get() for env in (0, 1)
    ]
    assert radii == pytest.approx([0.1, 0.12])
    plane = stage.GetPrimAtPath("/World/Surfaces/floor")
    assert plane.GetTypeName() == "Plane"
    sizes = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/env_1/grains/sizes"))
    np.testing.assert_allclose(sizes.GetScalesAttr().Get(), np.repeat([[0.1], [0.2], [0.3]], 3, axis=1), rtol=1e-6)
    places = np.array(sizes.GetPositionsAttr().Get(3.0))
    np.testing.assert_allclose(places[:, :2], [(0, 1), (1, 1), (2, 1)], atol=1e-6)


def test_usd_shape_contacts_have_sensors_and_arrows(stage):
    contact = stage.GetPrimAtPath("/World/env_1/contacts/touch")
    assert contact.GetAttribute("warpcontact:curvature2").Get(0.0) == pytest.approx(1 / 0.12)
    assert contact.GetAttribute("warpcontact:normalForce").Get(1.0) > 0.0
    _, force = arrows(stage, "/World/env_1/contacts/touch/force", 1.0)
    assert force[0, 2] > 0.0


@pytest.mark.parametrize("form", [*FORMS.values()], ids=[*FORMS])
def test_tessellated_shapes_are_outward_and_enclose_their_volume(form):
    vertices, faces = tessellate(type(form), {key: np.array(value) for key, value in form.parameters().items()})
    a, b, c = vertices[faces].transpose(1, 0, 2)
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    known = {
        "Sphere": 4 / 3 * np.pi * 1e-3,
        "Ellipsoid": 4 / 3 * np.pi * 3e-3,
        "Capsule": np.pi * (0.05**2 * 0.4 + 4 / 3 * 0.05**3),
        "Cylinder": np.pi * 0.1**2 * 0.4,
        "Cone": np.pi * 0.1**2 * 0.1,
        "Torus": 2 * np.pi**2 * 0.2 * 0.05**2,
    }
    # Flat triangles are inside the shape, by the square of their size.
    if type(form).__name__ in known:
        assert volume == pytest.approx(known[type(form).__name__], rel=0.02)
    else:
        assert 0.0 < volume < 8 * 6e-3
