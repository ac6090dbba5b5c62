"""Contacts of which a run warns at its end: more normals than patches of a pair, which are counted, and deep overlap."""

import warnings

import numpy as np
import pytest

import warpcontact as wc

RADIUS, HEIGHT = 0.05, 0.04


def hexagon(radius, turn=0.0):
    """Corners of a regular hexagon (6, 2) [m]."""
    angle = np.arange(6) * np.pi / 3 + turn
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def socket(floor):
    """Mesh of a block with a hexagonal hole, 40 mm deep; with a ``floor`` at z = 0, or open below."""
    inner, outer = hexagon(RADIUS), hexagon(2 * RADIUS)
    lower, upper = (-0.02 if floor else 0.0), HEIGHT
    rings = [(outer, lower), (outer, upper), (inner, upper), (inner, 0.0)]
    points = [np.column_stack([corners, np.full(6, z)]) for corners, z in rings]
    faces = []
    for ring in range(len(rings) if not floor else len(rings) - 1):
        following = (ring + 1) % len(rings)
        for i in range(6):
            k = (i + 1) % 6
            a, b, c, d = 6 * ring + i, 6 * ring + k, 6 * following + k, 6 * following + i
            faces += [[a, b, c], [a, c, d]]
    if floor:
        points.append([[0, 0, lower], [0, 0, 0]])
        for i in range(6):
            k = (i + 1) % 6
            faces += [[k, i, 24], [18 + i, 18 + k, 25]]
    return wc.Mesh(np.concatenate(points), np.array(faces))


def prism():
    """Mesh of a hexagonal prism that fits into the hole, with its lower face at z = 0."""
    corners = hexagon(RADIUS)
    points = np.concatenate(
        [np.column_stack([corners, np.full(6, z)]) for z in (0.0, HEIGHT)] + [[[0, 0, 0], [0, 0, HEIGHT]]]
    )
    faces = []
    for i in range(6):
        k = (i + 1) % 6
        faces += [[i, k, 6 + k], [i, 6 + k, 6 + i], [k, i, 12], [6 + i, 6 + k, 13]]
    return wc.Mesh(points, np.array(faces))


def in_socket(parts, law, device, clearance):
    """A prism in a socket of one mesh, or of a wall for each side, with a clearance at all sides in the second environment."""
    scene = wc.Scene()
    body = scene.add_body(mass=1.0, inertia=(1e-3,) * 3, name="bolt")
    bolt = scene.add_surface(prism(), body, name="faces")
    material = wc.ContactMaterial(law=law, friction=wc.friction.Coulomb(mu=0.3))
    if parts:
        nut = [scene.add_shape(None, wc.shapes.Plane(), name="floor")]
        for i, (x, y) in enumerate(np.roll(hexagon(1.0, np.pi / 6), 0, axis=0)):
            turn = (0.0, 0.0, np.sin(i * np.pi / 6 + np.pi / 12), np.cos(i * np.pi / 6 + np.pi / 12))
            place = (RADIUS * np.sqrt(0.75) + 0.01) * np.array([x, y, 0.0]) + [0, 0, HEIGHT / 2]
            nut.append(
                scene.add_shape(None, wc.shapes.RoundedBox((0.01, RADIUS, 0.1)), place, turn, name=f"wall_{i}")
            )
    else:
        nut = [scene.add_surface(socket(True), name="nut")]
    scene.add_body_contact(bolt, nut, material, name="fit")
    model = scene.build(envs=2, device=device, precision="float64")
    model["faces.scale"] = [1.0, 1.0 - clearance]
    return model


@pytest.mark.parametrize(
    "law", [wc.laws.Rigid(), wc.laws.KelvinVoigt(stiffness=1e6, restitution=0.1)], ids=["rigid", "law"]
)
def test_more_normals_than_patches_are_counted_and_reported(law, device):
    """Six walls and a floor of one mesh; with a clearance, only the floor."""
    model = in_socket(False, law, device, 0.01)
    sim = wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean())
    with pytest.warns(
        wc.RunWarning, match=r"fit: two solids touched with more than 6 different normals in 1 of 2 env"
    ):
        sim.run(5e-3, ["fit.overflow"], every=1e-3)
    np.testing.assert_array_equal(model.sensor("fit.overflow"), [5, 0])
    sim.reset()
    np.testing.assert_array_equal(model.sensor("fit.overflow"), 0)


def test_parts_of_a_solid_have_room_for_all_normals(device):
    """A floor and six walls as solids of their own."""
    model = in_socket(True, wc.laws.Rigid(), device, 0.01)
    sim = wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean())
    with warnings.catch_warnings():
        warnings.simplefilter("error", wc.RunWarning)
        sim.run(5e-3, ["fit.overflow"], every=1e-3)
    np.testing.assert_array_equal(model.sensor("fit.overflow"), 0)
    closed = model.sensor("fit.point_gap") <= 1e-9
    assert closed[0].sum() == 7 * 4
    np.testing.assert_allclose(model.sensor("bolt.position"), 0.0, atol=1e-9)


def test_more_normals_than_friction_patches_lose_no_force(device):
    """Columns with a fifth normal belong to the most similar patch: the pressure is the same, and friction still acts."""
    law = wc.laws.ElasticFoundation(stiffness=1e7)
    stick = wc.friction.CundallStrack(mu_static=0.3, mu_dynamic=0.3, stiffness=1e5)
    found = []
    for friction in (None, stick):
        scene = wc.Scene(gravity=(0, 0, 0))
        body = scene.add_body(mass=1.0, inertia=(1e-3,) * 3, linear_velocity=(0, 0, -0.1), name="bolt")
        # Larger than the hole by 0.1 mm, and its lower face is 0.1 mm below the floor.
        bolt = scene.add_surface(prism(), body, position=(0, 0, -1e-4), scale=1.0 + 1e-4 / RADIUS)
        material = wc.ContactMaterial(law=law, friction=friction)
        scene.add_body_contact(bolt, scene.add_surface(socket(True)), material, name="fit")
        model = scene.build(device=device, precision="float64")
        found.append(model.sensor("fit.normal_force")[0])
        wc.Simulation(model, dt=1e-5).step(10)
    pressure = 1e7 * (6 * RADIUS * HEIGHT * 1e-4 * np.sqrt(0.75) + 1.5 * np.sqrt(3) * RADIUS**2 * 1e-4)
    assert found[0] == pytest.approx(pressure, rel=0.01)
    assert found[1] == pytest.approx(found[0], rel=1e-12)
    # Springs of the walls hold the body back, with up to μ N.
    friction = model.sensor("fit.friction_force")[0, 2]
    assert 0.0 < friction <= 0.3 * model.sensor("fit.normal_force")[0]


def test_run_warns_of_deep_nonsmooth_contacts(device):
    """A box that starts 2 mm in the floor remains there, unless its overlap is removed."""
    depths = np.array([0.0, 0.5e-3, 2e-3])
    found = []
    for recovery_time in (None, 5e-3):
        scene = wc.Scene()
        box = scene.add_body(mass=1.0, inertia=(1e-3,) * 3, name="box")
        shape = scene.add_shape(box, wc.shapes.RoundedBox((0.05,) * 3), name="sides")
        floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
        scene.add_body_contact(shape, floor, wc.ContactMaterial(law=wc.laws.Rigid()), name="touch")
        model = scene.build(envs=3, device=device)
        model["box.position"] = np.column_stack([np.zeros((3, 2)), 0.05 - depths])
        integrator = wc.integrators.MoreauJean(recovery_time=recovery_time)
        with warnings.catch_warnings(record=True) as issued:
            warnings.simplefilter("always")
            wc.Simulation(model, 1e-3, integrator).run(0.05, ["touch.depth"], every=0.05)
        found.append([str(one.message) for one in issued if "at the end of the run" in str(one.message)])
    assert len(found[0]) == 1
    for part in ("touch: sides and floor overlap by 0.00", "2 % of the size", "environment 2", "recovery_time"):
        assert part in found[0][0]
    assert not found[1]


def test_run_warns_of_deep_compliant_contacts(device):
    """A box at rest that sinks by 8 % or 12 % of its size."""
    scene = wc.Scene()
    box = scene.add_body(mass=1.0, inertia=(1e-3,) * 3, name="box")
    shape = scene.add_shape(box, wc.shapes.RoundedBox((0.05,) * 3), name="sides")
    floor = scene.add_shape(None, wc.shapes.Plane(), name="floor")
    law = wc.laws.ElasticFoundation(stiffness=1e5)
    scene.add_body_contact(shape, floor, wc.ContactMaterial(law=law), name="touch")
    depths = np.array([8e-3, 12e-3])
    model = scene.build(envs=2, device=device)
    model["box.mass"] = 1e5 * 0.1**2 * depths / 9.81
    model["box.position"] = np.column_stack([np.zeros((2, 2)), 0.05 - depths])
    with pytest.warns(wc.RunWarning) as issued:
        wc.Simulation(model, 1e-4).run(1e-3, ["touch.depth"], every=1e-3)
    found = [str(one.message) for one in issued if "at the end of the run" in str(one.message)]
    assert len(found) == 1
    for part in ("touch: sides and floor overlap by 0.012 m", "12 % of the size", "environment 1", "stiffer law"):
        assert part in found[0]
