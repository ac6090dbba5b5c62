"""Kinds of contacts of imported pairs: body contact, and the others where it is not supported."""

import re

import pytest
from physics_stages import COLLIDER, CUBE, SIDES, WEIGHT, body, contact_pairs, mesh, moved, prim, stage

import warpcontact as wc
from warpcontact.usd.importing import contacts

OPEN = mesh("(-2,-2,0), (2,-2,0), (2,2,0), (-2,2,0)", "0,1,2,3", "4")
COLLIDERS = {
    "sphere": ("Sphere", "double radius = 1"),
    "ellipsoid": ("Sphere", "double radius = 1\n" + moved(0, 0, 0, scale=(1, 1, 2))),
    "cube": ("Cube", "double size = 2"),
    "mesh": ("Mesh", mesh()),
    "plane": ("Plane", 'uniform token axis = "Z"'),
    "open": ("Mesh", OPEN),
    "inward": ("Mesh", mesh(indices=", ".join(",".join(reversed(side.split(","))) for side in SIDES.split(", ")))),
}  # fmt: skip


def read(path, **options):
    """Imported scene; read in this process, because a reader process takes longer than the import."""
    return wc.Scene.from_usd(path, trusted=True, **options)


def pair(tmp_path, first, second, **options):
    """Scene of a body with one collider, and a static collider."""
    (kind, content), (other_kind, other_content) = COLLIDERS[first], COLLIDERS[second]
    one = body(content=WEIGHT + "\n" + prim(kind, "one", COLLIDER, content), pose=moved(0, 0, 3))
    return read(stage(tmp_path, one + prim(other_kind, "two", COLLIDER, other_content)), **options)


def kinds(scene):
    """Number of body contacts, shape contacts and contacts of points."""
    return len(scene.body_contacts), len(scene.shape_contacts), len(scene.contacts)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("cube", "plane"), ("cube", "cube"), ("cube", "mesh"), ("cube", "open"), ("mesh", "plane"), ("mesh", "cube"),
        ("mesh", "mesh"), ("mesh", "open"), ("open", "cube"), ("open", "mesh"),
    ],
)  # fmt: skip
def test_pair_of_faces_has_body_contact(tmp_path, first, second):
    scene = pair(tmp_path, first, second)
    assert kinds(scene) == (1, 0, 0)
    (contact,) = scene.body_contacts
    assert contact.name == ("two_one" if first == "open" else "one_two")
    assert {one.name for one in contact.pairs[0]} == {"one", "two"}
    # A half-space or open mesh is the second solid, so that sensors are of the other one.
    assert contact.pairs[0][1].name == ("one" if first == "open" else "two")


@pytest.mark.parametrize("other", ["plane", "cube", "sphere"])
@pytest.mark.parametrize("curved", ["sphere", "ellipsoid"])
def test_sphere_or_ellipsoid_on_a_shape_has_shape_contact(tmp_path, curved, other):
    scene = pair(tmp_path, curved, other)
    assert kinds(scene) == (0, 1, 0)
    assert not any("no body contact" in remark for remark in scene.import_warnings)


@pytest.mark.parametrize("surface", ["mesh", "open"])
def test_sphere_on_a_mesh_has_contact_at_all_minima(tmp_path, surface):
    scene = pair(tmp_path, "sphere", surface)
    assert kinds(scene) == (0, 0, 1)
    assert scene.contacts[0].minima == "all"


def test_requested_samples_keep_contact_at_points_of_meshes(tmp_path):
    scene = pair(tmp_path, "mesh", "mesh", samples=20)
    assert kinds(scene) == (0, 0, 2)
    assert [one.points.count for one in scene.contacts] == [20, 20]
    # Samples have no meaning for a pair without a mesh.
    assert kinds(pair(tmp_path, "cube", "plane", samples=20)) == (1, 0, 0)


@pytest.mark.parametrize(
    ("first", "second", "options", "found", "reason"),
    [
        ("open", "plane", {}, (0, 0, 1), "of sample points, because .* both half-spaces or open surfaces"),
        ("mesh", "inward", {}, (0, 0, 2), "of sample points, because .* surface 'two' are oriented inward, with a volume"),
        ("cube", "plane", {"torsion": wc.friction.Coulomb(mu=0.1)}, (0, 1, 0), "at one point, .* has torsion Coulomb"),
    ],
    ids=["open mesh on a plane", "inward mesh", "material of one point"],
)  # fmt: skip
def test_pair_without_body_contact_is_reported_with_the_reason(tmp_path, first, second, options, found, reason):
    given = {}
    if options:
        law = wc.laws.Hooke(stiffness=1e4)
        given = {"material": wc.ContactMaterial(law=law, friction=wc.friction.Coulomb(mu=0.5), **options)}
    scene = pair(tmp_path, first, second, **given)
    assert kinds(scene) == found
    (remark,) = [one for one in scene.import_warnings if "no body contact" in one]
    assert remark.startswith("1 pairs have contact ")
    assert re.search(reason, remark)


def test_law_per_area_is_the_pressure_of_body_contact(tmp_path):
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e8))
    scene = pair(tmp_path, "cube", "plane", material=material)
    assert scene.body_contacts[0].material is material
    model = scene.build(device="cpu", precision="float64")
    model["body.position"] = (0.0, 0.0, 0.999)
    # k A δ of a face of 2 m.
    assert model.sensor("one_two.normal_force")[0] == pytest.approx(1e8 * 4.0 * 1e-3, rel=1e-9)


def bricks(count, floor="", filtered=None):
    part = prim("Cube", "brick", COLLIDER, "double size = 0.2")
    pairs = f"rel physics:filteredPairs = </stone_{filtered}>\n" if filtered else ""
    apis = 'prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsFilteredPairsAPI"]'
    return floor + "".join(
        body(f"stone_{i}", pairs * (i == 0) + part, moved(0.3 * i, 0, 0.1), apis) for i in range(count)
    )


def test_many_pairs_of_one_material_are_one_body_contact(tmp_path):
    floor = prim("Plane", "floor", COLLIDER, 'uniform token axis = "Z"')
    path = stage(tmp_path, bricks(9, floor, filtered=3))
    scene = read(path)
    # 35 pairs of bricks with the same effective mass, and 9 with the floor.
    assert sorted(one.count for one in scene.body_contacts) == [1] * 9 + [35]
    pairs = {frozenset(pair) for pair in contact_pairs(scene)}
    names = ["brick", *(f"brick_{i}" for i in range(2, 10))]
    expected = {frozenset((one, other)) for one in names for other in (*names, "floor") if one != other}
    assert pairs == expected - {frozenset(("brick", "brick_4"))}


def test_body_contact_of_lists_has_the_same_pairs_as_single_ones(tmp_path, monkeypatch):
    path = stage(tmp_path, bricks(5, filtered=3))
    single = set(map(frozenset, contact_pairs(read(path))))
    monkeypatch.setattr(contacts, "MIN_BODY_PAIRS", 2)
    (several,) = read(path).body_contacts
    assert {frozenset(one.name for one in pair) for pair in several.pairs} == single


def test_torsional_friction_of_a_body_contact_is_reported(tmp_path):
    values = "float newton:torsionalFriction = 0.02\n"
    stuff = prim("Material", "m", 'prepend apiSchemas = ["PhysicsMaterialAPI", "NewtonMaterialAPI"]', values)
    bound = 'prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]'
    binding = "rel material:binding:physics = </m>\n"
    box = body(content=WEIGHT + "\n" + prim("Mesh", "one", bound, mesh(CUBE) + "\n" + binding))
    floor = prim("Plane", "two", bound, 'uniform token axis = "Z"\n' + binding)
    scene = read(stage(tmp_path, stuff + box + floor))
    assert kinds(scene) == (1, 0, 0)
    assert isinstance(scene.body_contacts[0].material.torsion, wc.friction.Frictionless)
    assert any("newton:torsionalFriction is ignored in 1 body contacts" in one for one in scene.import_warnings)


BOUND = 'prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"]'


def of_materials(*names, group=""):
    """Static floor, and bodies with a cube each, with physics materials of these names."""
    stuff = "".join(prim("Material", name, 'prepend apiSchemas = ["PhysicsMaterialAPI"]') for name in set(names))
    bound = [f"rel material:binding:physics = </{name}>\n" for name in names]
    parts = prim("Plane", "floor", BOUND, 'uniform token axis = "Z"\n' + bound[0])
    for i, binding in enumerate(bound[1:]):
        parts += body(
            f"body_{i}", f"{WEIGHT}\n" + prim("Cube", f"box_{i}", BOUND, binding), moved(3 * i, 0, 0.999)
        )
    return stuff + parts + group


def elastic(stiffness):
    return wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=stiffness))


def test_table_of_materials_is_by_names_of_physics_materials(tmp_path):
    table = {("steel", "steel"): elastic(1e8), ("rubber", "steel"): elastic(1e6), None: None}
    scene = read(stage(tmp_path, of_materials("steel", "steel", "rubber", "rubber")), material=table)
    found = {frozenset(one.name for one in c.pairs[0]): c.material.law.stiffness for c in scene.body_contacts}
    soft = [("box_1", "floor"), ("box_2", "floor"), ("box_0", "box_1"), ("box_0", "box_2")]
    assert found == {frozenset(("box_0", "floor")): 1e8} | {frozenset(pair): 1e6 for pair in soft}
    model = scene.build(device="cpu", precision="float64")
    # k A δ of a face of 2 m.
    assert model.sensor("box_0_floor.normal_force")[0] == pytest.approx(1e8 * 4.0 * 1e-3, rel=1e-9)
    assert model.sensor("box_1_floor.normal_force")[0] == pytest.approx(1e6 * 4.0 * 1e-3, rel=1e-9)


def test_bin_of_several_materials_with_groups_has_the_pairs_of_usdphysics(tmp_path):
    """Physics materials of each collider, a collision group that does not collide with itself, and filtered pairs."""
    group = prim(
        "PhysicsCollisionGroup",
        "fingers",
        'prepend apiSchemas = ["CollectionAPI:colliders"]',
        "rel collection:colliders:includes = [</body_0>, </body_1>]\nrel physics:filteredGroups = </fingers>",
    )
    scene = read(stage(tmp_path, of_materials("steel", "steel", "rubber", "rubber", group=group)))
    names = ["floor", "box_0", "box_1", "box_2"]
    expected = {frozenset((one, other)) for one in names for other in names if one != other}
    assert {frozenset(pair) for pair in contact_pairs(scene)} == expected - {frozenset(("box_0", "box_1"))}
    assert [one.physics_material for one in scene.shapes] == ["steel", "steel", "rubber", "rubber"]


@pytest.mark.parametrize(
    ("table", "error", "message"),
    [
        ({("steel", "steel"): elastic(1e8)}, wc.UsdError, "no entry for colliders with .*'rubber'"),
        (
            {("stele", "steel"): elastic(1e8), None: None},
            ValueError,
            "'stele', but no collider .* 'rubber', 'steel'",
        ),
        ({"steel": elastic(1e8)}, TypeError, "a key must be a pair of names"),
        ({None: "soft"}, TypeError, r"from_usd\.material\[None\] must be a wc.ContactMaterial"),
    ],
)
def test_invalid_table_of_materials_is_refused(tmp_path, table, error, message):
    with pytest.raises(error, match=message):
        read(stage(tmp_path, of_materials("steel", "steel", "rubber")), material=table)


@pytest.mark.parametrize("other", ["plane", "cube", "mesh"])
@pytest.mark.parametrize("curved", ["sphere", "ellipsoid"])
def test_curved_collider_has_body_contact_with_a_law_per_area(tmp_path, curved, other):
    assert kinds(pair(tmp_path, curved, other, material=elastic(1e8))) == (1, 0, 0)
