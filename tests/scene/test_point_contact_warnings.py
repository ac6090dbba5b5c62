"""Contacts at points between solids with faces: a build warns that body contact should replace them."""

import warnings

import pytest

import warpcontact as wc
from warpcontact import laws, shapes

HOOKE = wc.ContactMaterial(law=laws.Hooke(stiffness=1e4))
BOX = shapes.RoundedBox((0.1, 0.1, 0.1))
CUBE = wc.meshes.box((0.2, 0.2, 0.2))


def warnings_of(scene):
    """Messages of the warnings of a build."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene.build(envs=1, device="cpu")
    assert all(one.category is wc.ContactWarning for one in caught)
    return [str(one.message) for one in caught]


def bodies(scene, count):
    return [scene.add_body(mass=1.0, inertia=(0.01,) * 3, name=f"body_{i}") for i in range(count)]


@pytest.mark.parametrize(
    ("mesh", "samples", "warns"),
    [(CUBE, "vertices", True), (CUBE, "centroids", False), (CUBE, 50, False), (wc.meshes.grid((1, 1)), "vertices", False)],
    ids=["vertices", "centroids", "many points", "open surface"],
)  # fmt: skip
def test_contact_of_vertices_of_closed_meshes_is_warned_of(mesh, samples, warns):
    scene = wc.Scene()
    upper, lower = scene.add_surface(CUBE, *bodies(scene, 1)), scene.add_surface(mesh)
    scene.add_surface_contact(upper, lower, HOOKE, samples=samples, name="press")
    found = warnings_of(scene)
    assert len(found) == warns
    if warns:
        assert found[0].startswith("press: contact of the vertices of a closed mesh")
        assert "add_body_contact" in found[0]


def test_one_warning_names_the_first_contacts_of_vertices_and_counts_the_others():
    scene = wc.Scene()
    surfaces = [scene.add_surface(CUBE, body) for body in bodies(scene, 4)]
    for i in range(3):
        scene.add_surface_contact(
            surfaces[i], surfaces[i + 1], HOOKE, samples="vertices", sides="average", name=f"c{i}"
        )
    (text,) = warnings_of(scene)
    assert text.startswith("c0_first, c0_second, c1_first and 3 more: contact of the vertices")


@pytest.mark.parametrize(
    ("form", "other", "options", "warns"),
    [
        (BOX, shapes.Plane(), {}, True),
        (BOX, BOX, {}, True),
        (shapes.Cylinder(0.1, 0.1), shapes.Plane(), {}, True),
        (shapes.Capsule(0.1, 0.1), BOX, {}, True),
        (shapes.Capsule(0.1, 0.1), shapes.Capsule(0.1, 0.1), {}, False),
        (shapes.Sphere(0.1), shapes.Plane(), {}, False),
        (shapes.Ellipsoid((0.1, 0.2, 0.3)), BOX, {}, False),
        (BOX, shapes.Plane(), {"torsion": wc.friction.Coulomb(mu=0.1)}, False),
    ],
    ids=[
        "box on a half-space",
        "boxes",
        "cylinder",
        "capsule on a box",
        "capsules",
        "sphere",
        "ellipsoid on a box",
        "material of one point",
    ],
)
def test_shape_contact_of_flat_faces_is_warned_of_if_body_contact_supports_it(form, other, options, warns):
    scene = wc.Scene()
    first, second = scene.add_shape(*bodies(scene, 1), form), scene.add_shape(None, other)
    material = wc.ContactMaterial(law=laws.Hooke(stiffness=1e4), **options)
    radius = {"torsion_radius": 0.1} if options else {}
    scene.add_shape_contact(first, second, material, name="touch", **radius)
    found = warnings_of(scene)
    assert len(found) == warns
    if warns:
        assert found[0].startswith(
            "touch: shape contact has one contact point, so that solids do not come to rest"
        )
        assert "add_body_contact" in found[0]


@pytest.mark.parametrize(
    ("other", "warns"),
    [(shapes.Plane(), True), (BOX, True), (shapes.Sphere(0.1), False)],
    ids=["plane", "box", "sphere"],
)
def test_shape_contact_of_boxes_with_rounded_edges_is_warned_of_on_flat_faces(other, warns):
    scene = wc.Scene()
    rounded = scene.add_shape(*bodies(scene, 1), shapes.RoundedBox((0.1, 0.1, 0.1), radius=0.01))
    scene.add_shape_contact(rounded, scene.add_shape(None, other), HOOKE, name="touch")
    found = warnings_of(scene)
    assert len(found) == warns
    if warns:
        assert "boxes with rounded edges do not come to rest" in found[0]
        assert "add_body_contact, with boxes of radius 0 or closed meshes" in found[0]


def test_shape_contact_of_sets_is_not_warned_of_because_body_contact_has_no_sets():
    scene = wc.Scene()
    several = scene.add_bodies([(i, 0, 1) for i in range(3)], mass=1.0, inertia=(0.01,) * 3, name="several")
    scene.add_shape_contact(scene.add_shape(several, BOX), scene.add_shape(None, shapes.Plane()), HOOKE)
    assert warnings_of(scene) == []
