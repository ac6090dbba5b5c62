"""Faces of a contact coupling: selection, areas, integration points, and wrenches on both bodies."""

import json

import numpy as np
import pytest
from contact_coupling_scenes import divided_box

import warpcontact as wc

K1, K2, RANGE, THICK = 4e6, 2e3, 0.02, 0.2
FRICTION = wc.friction.Tanh(mu=0.3, velocity_scale=0.01)


def box_over_plane(mesh, case, device, precision="float64", **options):
    """Returns the model of a fixed box above a plane, with the parameters of ``case`` of the oracle."""
    half = 0.5 * np.radians(case["R_deg"])
    scene = wc.Scene(gravity=(0, 0, 0))
    plane = scene.add_surface(wc.meshes.grid((2.0, 2.0)), name="plane")
    box = scene.add_body(
        **{"mass": 1.0, "inertia": [0.1] * 3, "position": case["rb"], "name": "box"},
        orientation=(0.0, np.sin(half), 0.0, np.cos(half)),
        linear_velocity=case["vb"],
        angular_velocity=case["wb"],
    )
    hull = scene.add_surface(mesh, box, name="hull")
    made = wc.ContactRange(k1=K1, k2=K2, effective_range=RANGE)
    scene.add_contact_coupling(hull, plane, made, FRICTION, name="keep", **options)
    return scene.build(device=device, precision=precision)


@pytest.fixture(scope="module")
def oracle(shared):
    return json.loads((shared / "spec" / "oracle_contact_coupling.json").read_text())["mesh"]


@pytest.mark.parametrize("name", ["flat", "flat_spin", "tilt"])
def test_coupling_force_of_all_facing_faces_matches_reference_at_each_mesh_level(oracle, name, device):
    case = oracle[name]
    for level in case["levels"]:
        model = box_over_plane(divided_box(level["n"]), case, device, facing="all")
        scale = np.linalg.norm(level["force"])
        for prefix in ("keep", "box"):  # force of the coupling, and force on the body
            np.testing.assert_allclose(model.sensor(f"{prefix}.force")[0], level["force"], atol=1e-10 * scale)
            np.testing.assert_allclose(model.sensor(f"{prefix}.torque")[0], level["moment"], atol=1e-10 * scale)
        assert (model.sensor("keep_first.status") == wc.ContactStatus.CONTACT).sum() == level["faces_in_range"]
        wc.Simulation(model, dt=1e-4).step()
        assert model.sensor("keep.effective_area")[0] == pytest.approx(level["area_in_range"], rel=1e-12)


@pytest.mark.parametrize("name", ["flat", "flat_spin", "tilt"])
def test_coupling_force_in_float32_matches_reference(oracle, name, device):
    case = oracle[name]
    for level in case["levels"]:
        model = box_over_plane(divided_box(level["n"]), case, device, "float32", facing="all")
        scale = np.linalg.norm(level["force"])
        # A distance of 1 cm, from a height of 11 cm, is accurate to 1e-8 m, which is 1e-6 of the remaining range.
        np.testing.assert_allclose(model.sensor("keep.force")[0], level["force"], rtol=0, atol=2e-6 * scale)
        np.testing.assert_allclose(model.sensor("keep.torque")[0], level["moment"], rtol=0, atol=2e-6 * scale)


def test_coupling_force_in_float32_is_invariant_far_from_the_origin(device):
    forces = []
    for origin in (np.zeros(3), np.array([1e6, -2e5, 3e5])):
        scene = wc.Scene(gravity=(0, 0, 0))
        plane = scene.add_surface(wc.meshes.grid((2.0, 2.0), (20, 20)), position=origin, name="plane")
        box = scene.add_body(
            1.0, [0.1] * 3, origin + np.array([0, 0, 0.11]), linear_velocity=(0.2, 0, -0.5), name="box"
        )
        hull = scene.add_surface(divided_box(4), box, name="hull")
        made = wc.ContactRange(k1=K1, k2=K2, effective_range=RANGE)
        scene.add_contact_coupling(hull, plane, made, FRICTION, sides="average", name="keep")
        model = scene.build(device=device, precision="float32")
        forces.append(model.sensor("keep.force")[0])
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-6)


def test_side_walls_do_not_contribute_with_projected_areas(oracle, device):
    for n in (1, 16):
        model = box_over_plane(divided_box(n), oracle["flat"], device)
        np.testing.assert_allclose(model.sensor("keep.force")[0], [-1476.0, 0.0, 4920.0], rtol=1e-12, atol=1e-9)
        wc.Simulation(model, dt=1e-4).step()
        # The walls are within range but do not face the box.
        assert model.sensor("keep.effective_area")[0] == pytest.approx(0.12, rel=1e-12)
        assert model.sensor("keep.minimum_distance")[0] == pytest.approx(0.01, rel=1e-12)


def sunk_volume(size, degrees, height):
    """Volume of the part of a box that is below the range; rotated about y, with its center at a height."""
    angle = np.radians(degrees)
    x, z = 0.5 * size[0], 0.5 * size[2]
    corners = np.array([(-x, -z), (x, -z), (x, z), (-x, z)])
    turned = corners @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    turned[:, 1] += height
    cut = []
    for a, b in zip(turned, np.roll(turned, -1, axis=0), strict=True):
        if a[1] < RANGE:
            cut.append(a)
        if (a[1] < RANGE) != (b[1] < RANGE):
            cut.append(a + (RANGE - a[1]) / (b[1] - a[1]) * (b - a))
    px, pz = np.array(cut).T
    return 0.5 * abs((px * np.roll(pz, -1) - pz * np.roll(px, -1)).sum()) * size[1]


def test_projected_force_converges_to_volume_in_range_faster_with_more_points(device):
    """As with buoyancy, the total is the volume within the range above the projection of each face."""
    case = {"R_deg": 2.0, "rb": [0, 0, 0.115], "vb": [0, 0, 0], "wb": [0, 0, 0]}
    limit = K1 * sunk_volume((0.4, 0.3, THICK), 2.0, 0.115)
    errors = {}
    for points in (1, 3, 7):
        forces = [
            box_over_plane(divided_box(n), case, device, quadrature=points).sensor("keep.force")[0, 2]
            for n in (4, 8, 16, 32)
        ]
        errors[points] = np.abs(np.array(forces) / limit - 1.0)
    # The boundary of the range cuts faces, which no quadrature rule integrates exactly. The mean error over all
    # levels is compared, because a single level may be exact by chance.
    mean = {points: float(np.exp(np.log(values).mean())) for points, values in errors.items()}
    assert errors[1][-1] < 2e-3
    assert mean[3] < 0.3 * mean[1]
    assert mean[7] < 0.1 * mean[1]


@pytest.mark.parametrize("points", [1, 3, 6, 7])
def test_quadrature_rules_are_exact_to_their_order(points):
    from warpcontact.meshes.sample import ORDERS, face_points

    corner = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    found = face_points(wc.Mesh(corner, [[0, 1, 2]]), points, np.ones(1, dtype=bool))
    assert len(found) == points
    x, y, _ = found.positions.T
    assert found.positions.min() > -1e-16
    exact = []
    for order in range(8):
        for i in range(order + 1):
            # ∫ xⁱ yʲ over the triangle: i! j!/(i + j + 2)!.
            integral = np.prod(range(1, i + 1)) * np.prod(range(1, order - i + 1)) / np.prod(range(1, order + 3))
            exact.append((order, abs((found.areas * x**i * y ** (order - i)).sum() - integral) < 1e-15))
    assert all(right for order, right in exact if order <= ORDERS[points])
    assert not all(right for order, right in exact if order == ORDERS[points] + 1)


@pytest.mark.parametrize("sides", ["first", "average"])
def test_coupling_between_two_bodies_conserves_momentum(sides, device):
    scene = wc.Scene(gravity=(0, 0, 0))
    turn = np.array([0.1, 0.2, 0.05, 1.0])
    bodies = [
        scene.add_body(3.0, [0.02] * 3, (0, 0, 0.23), turn / np.linalg.norm(turn), (0.3, 0, -1.0), name="upper"),
        scene.add_body(5.0, [0.03, 0.04, 0.05], (0.05, 0, 0), angular_velocity=(0, 1.0, 0), name="lower"),
    ]
    surfaces = [
        scene.add_surface(divided_box(6, (0.2, 0.2, 0.2)), body, name=f"of_{body.name}") for body in bodies
    ]
    made = wc.ContactRange(k1=2e7, k2=1e4, effective_range=RANGE)
    coupling = scene.add_contact_coupling(*surfaces, made, FRICTION, sides=sides, name="keep")
    assert [contact.name for contact in coupling.contacts] == ["keep_first", "keep_second"][
        : len(coupling.contacts)
    ]
    model = scene.build(device=device, precision="float64")
    names = ("scene.linear_momentum", "scene.angular_momentum")
    before = [model.sensor(name)[0] for name in names]
    sim = wc.Simulation(model, dt=1e-4)
    peak = 0.0
    for _ in range(30):
        sim.step(20)
        force = model.sensor("keep.force")[0]
        peak = max(peak, np.linalg.norm(force))
        # The coupling is the only force element, so its wrench is that of the body, for either assignment of
        # sides.
        np.testing.assert_allclose(force, model.sensor("upper.force")[0], atol=1e-9)
        np.testing.assert_allclose(model.sensor("keep.torque")[0], model.sensor("upper.torque")[0], atol=1e-9)
    assert peak > 100.0
    after = [model.sensor(name)[0] for name in names]
    # 600 steps with a few roundings of 1e-16 of 5 kg·m/s. The position update does not change angular momentum,
    # because both bodies get the force at the same point.
    np.testing.assert_allclose(after[0], before[0], atol=2e-13)
    np.testing.assert_allclose(after[1], before[1], atol=2e-13)
    assert model.sensor("keep.minimum_distance")[0] < RANGE


def test_both_sides_share_one_set_of_parameters(device):
    scene = wc.Scene(gravity=(0, 0, 0))
    plate = scene.add_surface(wc.meshes.grid((0.2, 0.1)), name="plate")
    block = scene.add_body(1.0, [1.0] * 3, (0, 0, 0.06), name="block")
    hull = scene.add_surface(wc.meshes.box((0.2, 0.1, 0.1)), block, name="hull")
    made = wc.ContactRange(k1=K1, effective_range=RANGE)
    scene.add_contact_coupling(hull, plate, made, FRICTION, sides="average", name="keep")
    model = scene.build(envs=2, device=device, precision="float64")
    # Equal areas face each other at a distance of 1 cm, so each coupling has half of the force.
    whole = 0.02 * K1 * 0.01
    for name in ("keep_first", "keep_second"):
        np.testing.assert_allclose(model.sensor(f"{name}.normal_force").sum(axis=1), 0.5 * whole, rtol=1e-12)
    model["keep.k1"] = [K1, 2.0 * K1]
    np.testing.assert_allclose(model.sensor("keep.force")[:, 2], [whole, 2.0 * whole], rtol=1e-12)
    np.testing.assert_array_equal(model["keep_second.law.k1"], [K1, 2.0 * K1])
    model["keep.effective_range"] = [0.02, 0.03]
    np.testing.assert_allclose(model.sensor("keep.force")[:, 2], [whole, 4.0 * whole], rtol=1e-12)
    model["keep.enabled"] = [1, 0]
    np.testing.assert_allclose(model.sensor("block.force")[:, 2], [whole, 0.0], rtol=1e-12)
    # The area scales with the surface. The scaled surface is lower by half of its growth.
    model["keep.enabled"], model["hull.scale"] = 1, [1.0, 1.1]
    model["block.position"] = [[0, 0, 0.06], [0, 0, 0.065]]
    first = model.sensor("keep_first.normal_force").sum(axis=1)
    np.testing.assert_allclose(first, [0.5 * whole, 0.5 * 1.21 * 4.0 * whole], rtol=1e-12)


def test_facing_test_uses_surface_orientation(device):
    """The orientation of its surface turns a vertical wall towards the plane; inactive faces never face it."""
    scene = wc.Scene(gravity=(0, 0, 0))
    plane = scene.add_surface(wc.meshes.grid((2.0, 2.0)), name="plane")
    block = scene.add_body(1.0, [1.0] * 3, (0, 0, 0.01), name="block")
    wall = wc.Mesh([[0, -0.1, -0.1], [0, 0.1, -0.1], [0, 0.1, 0.1], [0, -0.1, 0.1]], [[0, 1, 2], [0, 2, 3]])
    # Its normal is +x; a quarter turn about y makes it horizontal.
    laid = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    surface = scene.add_surface(wall, block, orientation=laid, active_faces=[0], name="wall")
    made = wc.ContactRange(k1=K1, effective_range=RANGE)
    coupling = scene.add_contact_coupling(surface, plane, made, name="keep")
    assert coupling.contacts[0].count == 1
    model = scene.build(envs=3, device=device, precision="float64")
    half = np.radians(30.0) * 0.5
    model["wall.orientation"] = [laid, (0, np.sin(np.pi / 4 + half), 0, np.cos(np.pi / 4 + half)), (0, 0, 0, 1)]
    forces = model.sensor("keep.force")[:, 2]
    # The centroid of the face is off the rotation axis.
    gap = model.sensor("keep_first.gap")[:, 0]
    np.testing.assert_allclose(forces[0], K1 * 0.02 * 0.01, rtol=1e-12)
    np.testing.assert_allclose(forces[1], -K1 * 0.02 * np.cos(np.radians(30.0)) * min(gap[1], 0.0), rtol=1e-12)
    assert forces[2] == 0.0


def test_couplings_and_contacts_in_one_scene_match_separate_scenes(device):
    """Three couplings of two compiled types, and a contact that shares the compiled code with one of them."""
    kinds = {
        "slick": {"facing": "all"},
        "bare": {},
        "rough": {"friction": FRICTION, "sides": "average"},
        "pins": None,
    }

    def built(names):
        scene = wc.Scene(gravity=(0, 0, 0))
        plane = scene.add_surface(wc.meshes.grid((1.0, 1.0), (8, 8)), name="plane")
        for number, name in enumerate(kinds):
            place = (0.1 * number, 0.0, 0.112 + 0.001 * number)
            body = scene.add_body(
                1.0, [0.1] * 3, place, (0.01, 0, 0, np.sqrt(1 - 1e-4)), (0.2, 0, -0.5), name=f"b_{name}"
            )
            hull = scene.add_surface(divided_box(8), body, name=f"of_{name}")
            if name not in names:
                continue
            if kinds[name] is None:
                law = wc.ContactMaterial(law=wc.laws.ContactRange(k1=K1))
                scene.add_surface_contact(hull, plane, law, samples="centroids", radius=0.03, name=name)
            else:
                made = wc.ContactRange(k1=K1 * (1 + number), k2=K2, effective_range=RANGE + 0.001 * number)
                scene.add_contact_coupling(hull, plane, made, **kinds[name], name=name)
        return scene.build(envs=2, device=device, precision="float64")

    def seen(model, name):
        wc.Simulation(model, dt=1e-5, deterministic=True).step(5)
        keys = ("force", "torque", "effective_area", "minimum_distance")
        own = [model.sensor(f"{name}.{key}") for key in keys] if kinds[name] is not None else []
        return [*own, model.sensor(f"b_{name}.force"), model.sensor(f"b_{name}.position")]

    together = built(kinds)
    for name in kinds:
        together.reset()
        apart = seen(built([name]), name)
        assert np.abs(apart[-2]).max() > 100.0
        for one, other in zip(seen(together, name), apart, strict=True):
            np.testing.assert_array_equal(one, other)
