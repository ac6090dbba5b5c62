"""Body contact of thin bodies that are pressed in by more than their thickness: the contact is not lost."""

import numpy as np
import pytest

import warpcontact as wc

K = 1e8  # Pa/m
SIDE, THICKNESS = 0.2, 0.01
HOOKE = wc.laws.Hooke(stiffness=1e5)
PLATE = wc.shapes.RoundedBox((SIDE / 2, SIDE / 2, THICKNESS / 2))
COIN = wc.shapes.Cylinder(SIDE / 2, THICKNESS / 2)
# Depths of the lower face, also below that at which the upper face enters [m].
DEPTHS = np.array([0.5, 1.0 - 1e-6, 1.0 + 1e-6, 2.0]) * THICKNESS


def pressed(upper, lower, law, device):
    """Normal forces on a horizontal plate with its lower face at the depths below the top of a solid, z = 0 [N]."""
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="body")
    first = scene.add_surface(upper, body) if isinstance(upper, wc.Mesh) else scene.add_shape(body, upper)
    if isinstance(lower, wc.Mesh):
        second = scene.add_surface(lower, position=(0, 0, -0.25))
    else:
        second = scene.add_shape(None, lower, position=(0, 0, -0.25 * isinstance(lower, wc.shapes.RoundedBox)))
    scene.add_body_contact(first, second, wc.ContactMaterial(law=law), name="press")
    model = scene.build(envs=len(DEPTHS), device=device, precision="float64")
    model["body.position"] = [(0.01, 0.02, 0.5 * THICKNESS - depth) for depth in DEPTHS]
    np.testing.assert_allclose(model.sensor("press.force")[:, :2], 0.0, atol=1e-6)
    return model.sensor("press.normal_force"), model.sensor("press.area")


@pytest.mark.parametrize(
    "upper", [PLATE, wc.meshes.box((SIDE, SIDE, THICKNESS)), COIN], ids=["box", "mesh", "cylinder"]
)
def test_force_on_a_plate_below_a_half_space_is_that_of_its_thickness(upper, device):
    force, area = pressed(upper, wc.shapes.Plane(), HOOKE, device)
    np.testing.assert_allclose(force, 1e5 * np.minimum(DEPTHS, THICKNESS), rtol=1e-6)
    own = SIDE**2 * (np.pi / 4 if upper is COIN else 1.0)
    np.testing.assert_allclose(area, own, rtol=1e-6)


@pytest.mark.parametrize(
    "lower", [wc.shapes.RoundedBox((0.5, 0.5, 0.25)), wc.meshes.box((1, 1, 0.5))], ids=["box", "mesh"]
)
@pytest.mark.parametrize("per_area", [True, False], ids=["per area", "mean"])
def test_force_on_a_plate_inside_a_thick_body_is_that_of_its_depth(per_area, lower, device):
    law = wc.laws.ElasticFoundation(stiffness=K) if per_area else HOOKE
    force, area = pressed(PLATE, lower, law, device)
    np.testing.assert_allclose(force, (K * SIDE**2 if per_area else 1e5) * DEPTHS, rtol=1e-6)
    np.testing.assert_allclose(area, SIDE**2, rtol=1e-6)


def test_thick_body_around_a_fixed_plate_is_pushed_off_it(device):
    # The surface of the second solid is wholly inside the first one.
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="body")
    first = scene.add_shape(body, wc.shapes.RoundedBox((0.5, 0.5, 0.25)))
    second = scene.add_shape(None, PLATE, position=(0, 0, -THICKNESS / 2))
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=K))
    scene.add_body_contact(first, second, material, name="press")
    model = scene.build(device=device, precision="float64")
    model["body.position"] = (0.0, 0.0, 0.25 - 2.0 * THICKNESS)
    # The top of the plate is 2 thicknesses above the lower face of the body.
    np.testing.assert_allclose(
        model.sensor("press.force")[0], [0, 0, K * SIDE**2 * 2.0 * THICKNESS], rtol=1e-6, atol=1e-6
    )


@pytest.mark.parametrize("law", [wc.laws.ElasticFoundation(stiffness=K), HOOKE], ids=["per area", "mean"])
@pytest.mark.parametrize(
    "upper", [wc.shapes.RoundedBox((0.03,) * 3), wc.shapes.Cylinder(0.03, 0.03)], ids=["box", "cylinder"]
)
def test_plate_never_pulls_a_body(upper, law, device):
    """At any depth up to one and a half times its thickness, upright and tilted, in the middle and across an edge."""
    depths = np.linspace(0.0, 1.5 * THICKNESS, 151)[1:]
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="body")
    plate = scene.add_shape(None, PLATE, position=(0, 0, -0.5 * THICKNESS))
    scene.add_body_contact(scene.add_shape(body, upper), plate, wc.ContactMaterial(law=law), name="press")
    model = scene.build(envs=len(depths), device=device, precision="float64")
    for x, tilt in ((0.0, 0.0), (0.01, 0.05), (0.09, 0.0), (SIDE / 2, 0.02)):
        model["body.position"] = np.column_stack([np.full_like(depths, x), 0 * depths, 0.03 - depths])
        model["body.orientation"] = np.tile([0.0, np.sin(tilt / 2), 0.0, np.cos(tilt / 2)], (len(depths), 1))
        assert model.sensor("press.force")[:, 2].min() > 0
