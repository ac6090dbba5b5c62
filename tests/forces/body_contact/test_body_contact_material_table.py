"""Body contact with a table of contact materials by pair of physics materials, and with groups and masks."""

import numpy as np
import pytest

import warpcontact as wc

SIDE, DEPTH = 0.1, 1e-3  # m


def material(stiffness, mu=0.0):
    """Returns a contact material with pressure and Coulomb friction."""
    return wc.ContactMaterial(
        law=wc.laws.ElasticFoundation(stiffness=stiffness), friction=wc.friction.Coulomb(mu=mu)
    )


STEEL, MIXED, RUBBER = material(1e8, 0.1), material(1e7, 0.5), material(1e6, 0.9)
TABLE = {("steel", "steel"): STEEL, ("rubber", "steel"): MIXED, ("rubber", "rubber"): RUBBER}


def bin_scene(names=("steel", "steel", "rubber", "rubber"), mesh=False, **options):
    """Returns a scene of a floor and a stack of boxes, each 1 mm deep in the one below, and the list of its solids."""
    scene = wc.Scene(gravity=(0, 0, 0))
    solids = [scene.add_shape(None, wc.shapes.Plane(), name="floor", physics_material=names[0])]
    for i, name in enumerate(names[1:]):
        height = (i + 0.5) * SIDE - (i + 1) * DEPTH
        body = scene.add_body(mass=1.0, inertia=(1, 1, 1), position=(0, 0, height), name=f"body_{i}")
        own = {"name": f"box_{i}", "physics_material": name, **options.get(f"box_{i}", {})}
        if mesh:
            solids.append(scene.add_surface(wc.meshes.box((SIDE,) * 3), body, **own))
        else:
            solids.append(scene.add_shape(body, wc.shapes.RoundedBox((SIDE / 2,) * 3), **own))
    return scene, solids


@pytest.mark.parametrize("mesh", [False, True])
def test_each_pair_has_the_material_of_its_entry(mesh, device):
    scene, solids = bin_scene(mesh=mesh)
    contact = scene.add_body_contact(solids, TABLE, name="bin")
    model = scene.build(envs=2, device=device, precision="float64")
    numbers = {frozenset((one.name, other.name)): i for i, (one, other) in enumerate(contact.pairs)}
    expected = {
        frozenset(("box_0", "floor")): STEEL,
        frozenset(("box_0", "box_1")): MIXED,
        frozenset(("box_1", "box_2")): RUBBER,
    }
    force = model.sensor("bin.normal_force")
    for pair, one in expected.items():
        item = numbers[pair]
        assert contact.materials[item] is one
        np.testing.assert_array_equal(model["bin.friction.mu"][:, item], one.friction.mu)
        np.testing.assert_allclose(force[:, item], one.law.stiffness * SIDE**2 * DEPTH, rtol=1e-9)
    # Parameters have one value per environment and pair.
    model["bin.law.stiffness"] = model["bin.law.stiffness"] * np.array([[1.0], [2.0]])
    np.testing.assert_allclose(model.sensor("bin.normal_force"), force * [[1.0], [2.0]], rtol=1e-12)


def test_pairs_of_a_table_hold_up_to_their_friction_with_impulses(device):
    """Three boxes side by side on a floor are pushed with 0.6 of their weight; only that of rubber holds."""
    scene = wc.Scene()
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor", physics_material="steel")
    bodies = []
    for i, name in enumerate(("steel", "rubber", "ice")):
        body = scene.add_body(
            mass=1.0,
            inertia=[1e-2 / 6] * 3,
            position=(0, 0.2 * i, 0.05),
            external_force=(0.6 * 9.81, 0, 0),
            name=name,
        )
        scene.add_shape(body, wc.shapes.RoundedBox((0.05,) * 3), (0, 0, 0), physics_material=name)
        bodies.append(body)
    rigid = [
        wc.ContactMaterial(law=wc.laws.Rigid(), friction=wc.friction.Coulomb(mu=mu)) for mu in (0.3, 0.7, 0.0)
    ]
    table = {("steel", "steel"): rigid[0], ("steel", "rubber"): rigid[1], ("ice", "steel"): rigid[2], None: None}
    contact = scene.add_body_contact([floor, *bodies], table, name="bin")
    assert contact.count == 5
    model = scene.build(device=device, precision="float64")
    wc.Simulation(model, dt=2e-3, integrator=wc.integrators.MoreauJean()).step(50)
    speed = [model.sensor(f"{body.name}.linear_velocity")[0, 0] for body in bodies]
    np.testing.assert_allclose(speed, [0.3 * 9.81 * 0.1, 0.0, 0.6 * 9.81 * 0.1], atol=1e-9)


def test_default_entry_is_for_all_other_pairs():
    scene, solids = bin_scene(names=(None, "steel", "rubber", None))
    contact = scene.add_body_contact(solids, {("steel", "rubber"): MIXED, None: RUBBER})
    found = {
        frozenset((one.name, other.name)): own
        for (one, other), own in zip(contact.pairs, contact.materials, strict=True)
    }
    assert found.pop(frozenset(("box_0", "box_1"))) is MIXED
    assert set(found.values()) == {RUBBER}
    assert len(found) == 5


def test_entries_without_material_are_pairs_without_contact():
    scene, solids = bin_scene()
    contact = scene.add_body_contact(solids, {("steel", "steel"): STEEL, None: None})
    assert [(one.name, other.name) for one, other in contact.pairs] == [("box_0", "floor")]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {("steel", "steel"): STEEL, ("rubber", "rubber"): RUBBER},
            r"no entry for the pair \('rubber', 'steel'\)",
        ),
        ({**TABLE, ("steel", "rubber"): MIXED}, r"is the same pair as another entry"),
        (
            {**TABLE, ("stele", "steel"): STEEL},
            r"an entry for 'stele', but no solid .* there are: 'rubber', 'steel'",
        ),
        ({("steel", "steel"): None, None: None}, r"must have an entry that is a wc\.ContactMaterial"),
        (
            {**TABLE, ("rubber", "rubber"): wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))},
            r"same classes of law and friction, .* ElasticFoundation\(.*\) with Coulomb\(mu\), and Hooke\(stiffness\)",
        ),
        (
            {None: wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1.0, area=1.0))},
            r"bin\.material\[None\]: the law of its material has an area",
        ),
    ],
)
def test_invalid_tables_are_refused(table, message):
    scene, solids = bin_scene()
    with pytest.raises(ValueError, match=message):
        scene.add_body_contact(solids, table, name="bin")
    assert not scene.body_contacts


def test_solid_without_physics_material_needs_a_default():
    scene, solids = bin_scene(names=("steel", "steel", None, "rubber"))
    with pytest.raises(ValueError, match=r"'box_1' has no physics_material, .* no default entry"):
        scene.add_body_contact(solids, TABLE)


@pytest.mark.parametrize("key", ["steel", ("steel",), ("steel", 1), ("steel", "")])
def test_invalid_keys_of_a_table_are_refused(key):
    scene, solids = bin_scene()
    with pytest.raises(TypeError, match="a key must be a pair of names of physics materials"):
        scene.add_body_contact(solids, {**TABLE, key: STEEL})


@pytest.mark.parametrize("mesh", [False, True])
def test_groups_and_masks_select_pairs(mesh):
    """Boxes of group 2 do not touch each other."""
    parts = {f"box_{i}": {"group": 2, "mask": 1} for i in range(2)}
    scene, solids = bin_scene(mesh=mesh, **parts)
    contact = scene.add_body_contact(solids, STEEL)
    found = {frozenset((one.name, other.name)) for one, other in contact.pairs}
    assert len(found) == 5
    assert frozenset(("box_0", "box_1")) not in found


def test_groups_without_common_pair_are_refused():
    scene, solids = bin_scene(**{f"box_{i}": {"mask": 0} for i in range(3)})
    with pytest.raises(ValueError, match="exclude, groups and masks leave no pair"):
        scene.add_body_contact(solids, STEEL)
    with pytest.raises(ValueError, match="mask must be a whole number from 0 to 0xffffffff"):
        scene.add_surface(wc.meshes.box((1, 1, 1)), mask=-1)


def test_lists_of_solids_are_excluded_from_each_other():
    scene, solids = bin_scene()
    contact = scene.add_body_contact(solids, STEEL, exclude=[(solids[1:], [solid.body for solid in solids[1:]])])
    assert [(one.name, other.name) for one, other in contact.pairs] == [(f"box_{i}", "floor") for i in range(3)]
