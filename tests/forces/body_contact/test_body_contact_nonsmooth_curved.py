"""Nonsmooth body contact of curved solids: rest, rolling, edges, the flat ends and circular edges of cylinders."""

import numpy as np
import pytest
from nonsmooth_scenes import G, rigid
from scipy.spatial.transform import Rotation

import warpcontact as wc

RADIUS, HALF, MASS = 0.1, 0.15, 5.0
SHAPES = {
    "cylinder": wc.shapes.Cylinder(RADIUS, HALF),
    "capsule": wc.shapes.Capsule(RADIUS, HALF),
    "sphere": wc.shapes.Sphere(RADIUS),
}
FLOORS = ["plane", "box", "sheet"]
#: Half of the height of a box of side 0.6 m that stands on its edge.
RIDGE = 0.3 * np.sqrt(2)
#: Half of the gap at which a point counts as closed is left [m].
CLOSED = 1e-9


def add_floor(scene, kind):
    """Adds a floor with its upper side at z = 0."""
    if kind == "plane":
        return scene.add_shape(None, wc.shapes.Plane(), name="floor")
    if kind == "box":
        return scene.add_shape(None, wc.shapes.RoundedBox((2, 1, 0.1)), position=(0, 0, -0.1), name="floor")
    return scene.add_surface(wc.meshes.grid((4.0, 2.0), (15, 7)), name="floor")


def scene_of(shapes, floors, *, mu=0.5, gravity=(0, 0, -G), inertia=(0.04, 0.04, 0.025)):
    """Bodies of one shape each, all in contact with the floors only."""
    scene = wc.Scene(gravity=gravity)
    for number, (shape, floor) in enumerate(zip(shapes, floors, strict=True)):
        body = scene.add_body(MASS, inertia, name=f"body{number}")
        solid = scene.add_shape(body, shape, name=f"shape{number}")
        scene.add_body_contact(solid, floor(scene), rigid(mu=mu), name=f"touch{number}")
    return scene


def on_ridge(scene):
    """Adds a box on its edge, which is along y at the height ``RIDGE``."""
    turn = Rotation.from_rotvec([0, np.pi / 4, 0]).as_quat()
    return scene.add_shape(None, wc.shapes.RoundedBox((0.3, 1.0, 0.3)), orientation=turn)


def stepped(model, steps, dt=2e-3, **options):
    sim = wc.Simulation(model, dt=dt, integrator=wc.integrators.MoreauJean(**options))
    sim.step(steps)
    return sim


@pytest.mark.parametrize("floor", FLOORS)
def test_curved_solids_come_to_rest(floor, device):
    """Cylinders lying and standing, capsules lying, and spheres, each dropped with and without a tilt."""
    scene = wc.Scene(gravity=(0, 0, -G))
    below = add_floor(scene, floor)
    cases = {
        "cylinder": [((0, 0, 0), HALF, 4), ((0.05, 0.03, 0), HALF, 4), ((np.pi / 2 - 0.05, 0, 0), RADIUS, 2)],
        "capsule": [
            ((np.pi / 2, 0, 0), RADIUS, 2),
            ((np.pi / 2 - 0.1, 0, 0.2), RADIUS, 2),
            ((1.5, 0, 0), RADIUS, 2),
        ],
        "sphere": [((0, 0, 0), RADIUS, 1)] * 3,
    }
    # The bodies do not touch each other.
    for name, shape in SHAPES.items():
        solid = scene.add_shape(scene.add_body(MASS, (0.04, 0.04, 0.025), name=name), shape)
        scene.add_body_contact(solid, below, rigid(mu=0.5), name=f"{name}_touch")
    model = scene.build(envs=3, device=device, precision="float64")
    for name, own in cases.items():
        model[f"{name}.position"] = [(0, 0, z + 0.02) for _, z, _ in own]
        model[f"{name}.orientation"] = [Rotation.from_rotvec(turn).as_quat() for turn, _, _ in own]
    sim = stepped(model, 750)
    before = {name: model.sensor(f"{name}.position") for name in cases}
    sim.step(250)
    for name, own in cases.items():
        position = model.sensor(f"{name}.position")
        np.testing.assert_allclose(position[:, 2], [z for _, z, _ in own], atol=CLOSED)
        np.testing.assert_allclose(position, before[name], atol=1e-8)
        assert np.abs(model.sensor(f"{name}.linear_velocity")).max() < 1e-7
        assert np.abs(model.sensor(f"{name}.angular_velocity")).max() < 1e-7
        np.testing.assert_allclose(model.sensor(f"{name}_touch.normal_force"), MASS * G, rtol=1e-6)
        points = (~np.isnan(model.sensor(f"{name}_touch.point_gap"))).sum(axis=1)
        np.testing.assert_array_equal(points, [count for _, _, count in own])
        np.testing.assert_allclose(model.sensor(f"{name}_touch.load_ratio"), 1.0, rtol=0.2)


def test_cones_and_ellipsoids_rest_on_a_plane(device):
    scene = wc.Scene(gravity=(0, 0, -G))
    plane = add_floor(scene, "plane")
    forms = {"cone": wc.shapes.Cone(RADIUS, 0.3), "ellipsoid": wc.shapes.Ellipsoid((0.1, 0.08, 0.05))}
    for name, form in forms.items():
        # The base of a cone is at the origin of its shape.
        offset = (0, 0, -0.075) if name == "cone" else (0, 0, 0)
        solid = scene.add_shape(scene.add_body(MASS, (0.04, 0.04, 0.025), name=name), form, position=offset)
        scene.add_body_contact(solid, plane, rigid(mu=0.5), name=f"{name}_touch")
    model = scene.build(envs=1, device=device, precision="float64")
    model["cone.position"], model["ellipsoid.position"] = (0, 0, 0.08), (0, 0, 0.055)
    model["cone.orientation"] = Rotation.from_rotvec([0.03, 0, 0]).as_quat()
    stepped(model, 750)
    np.testing.assert_allclose(model.sensor("cone.position")[0, 2], 0.075, atol=CLOSED)
    np.testing.assert_allclose(model.sensor("ellipsoid.position")[0, 2], 0.05, atol=CLOSED)
    assert np.abs(model.sensor("cone.angular_velocity")).max() < 1e-7
    np.testing.assert_allclose(model.sensor("cone_touch.load_ratio"), 1.0, rtol=0.2)


@pytest.mark.parametrize(
    ("name", "factor"),
    [("cylinder", 0.5), ("capsule", 0.5), ("sphere", 0.4)],
    ids=["cylinder", "capsule", "sphere"],
)
def test_rolling_down_a_slope_matches_the_closed_form(name, factor, device):
    """x = ½ g sin(α) t²/(1 + I/(m r²)), on a plane, and without bumps on a box and over the edges of a flat mesh."""
    slope, steps, dt = 0.1, 400, 1e-3
    inertia = (0.05, 0.05, factor * MASS * RADIUS**2)
    if name == "sphere":
        inertia = (factor * MASS * RADIUS**2,) * 3
    for kind in FLOORS:
        floors = [lambda scene, kind=kind: add_floor(scene, kind)]
        gravity = (G * np.sin(slope), 0, -G * np.cos(slope))
        scene = scene_of([SHAPES[name]], floors, gravity=gravity, inertia=inertia)
        model = scene.build(envs=1, device=device, precision="float64")
        model["body0.position"] = (0, 0, RADIUS)
        model["body0.orientation"] = Rotation.from_rotvec([np.pi / 2, 0, 0]).as_quat()
        stepped(model, steps, dt)
        right = 0.5 * G * np.sin(slope) / (1 + factor) * (steps * dt) ** 2
        np.testing.assert_allclose(model.sensor("body0.position")[0], [right, 0, RADIUS], atol=1e-8)
        spin = right * 2 / (steps * dt) / RADIUS
        np.testing.assert_allclose(model.sensor("body0.angular_velocity")[0], [0, spin, 0], atol=1e-6)


def test_rolling_solids_do_not_sink(device):
    """An error of second order in h per step must not add up, neither over the steps nor where a contact point jumps."""
    shapes = [
        wc.shapes.Ellipsoid((0.015, 0.012, 0.01)),
        wc.shapes.Cone(0.012, 0.02),
        wc.shapes.Cylinder(0.012, 0.015),
    ]
    scene = scene_of(
        shapes, [lambda scene: scene.add_shape(None, wc.shapes.Plane())] * 3, inertia=(5e-4, 4e-4, 3e-4)
    )
    model = scene.build(envs=4, device=device, precision="float64")
    depth = {}
    for dt in (2e-3, 1e-3):
        model.reset()
        for number in range(3):
            seed = np.random.default_rng(number)
            model[f"body{number}.position"] = (number, 0, 0.03)
            model[f"body{number}.orientation"] = Rotation.random(4, random_state=number).as_quat()
            model[f"body{number}.linear_velocity"] = np.column_stack([seed.normal(0, 0.5, (4, 2)), np.zeros(4)])
            model[f"body{number}.angular_velocity"] = seed.normal(0, 20, (4, 3))
        names = [f"touch{number}.depth" for number in range(3)]
        run = wc.Simulation(model, dt, wc.integrators.MoreauJean(tolerance=1e-6)).run(3.0, names, every=0.02)
        depth[dt] = np.array([run[name].max().item() for name in names])
    # Errors up to g h² are kept. That of a step is up to r ω² h², here with r = 0.02 m and ω up to 50 rad/s.
    assert (depth[1e-3] < (G + 0.02 * 50**2) * 1e-3**2).all()
    assert (depth[1e-3] < 0.4 * depth[2e-3]).all()


def test_curved_solids_balance_on_a_ridge(device):
    """Capsules along and across an edge, a standing cylinder, and a box on a lying cylinder, which is then second."""
    scene = wc.Scene(gravity=(0, 0, -G))
    ridge = on_ridge(scene)
    lying = Rotation.from_rotvec([np.pi / 2, 0, 0]).as_quat()
    log = scene.add_shape(None, SHAPES["cylinder"], position=(3, 0, 0), orientation=lying)
    cases = {
        "across": (SHAPES["capsule"], ridge, (0, 0, RIDGE + RADIUS), [0, np.pi / 2, 0]),
        "along": (SHAPES["capsule"], ridge, (0, 0, RIDGE + RADIUS), [np.pi / 2, 0, 0]),
        "standing": (SHAPES["cylinder"], ridge, (0, 0, RIDGE + HALF), [0, 0, 0]),
        "box": (wc.shapes.RoundedBox((0.1, 0.1, 0.05)), log, (3, 0, RADIUS + 0.05), [0, 0, 0]),
    }
    for name, (shape, below, _, _) in cases.items():
        solid = scene.add_shape(scene.add_body(MASS, (0.04, 0.04, 0.025), name=name), shape)
        scene.add_body_contact(solid, below, rigid(mu=0.5), name=f"{name}_touch")
    model = scene.build(envs=1, device=device, precision="float64")
    for name, (_, _, position, turn) in cases.items():
        model[f"{name}.position"] = position
        model[f"{name}.orientation"] = Rotation.from_rotvec(turn).as_quat()
    # An unstable equilibrium: rounding grows by e per 0.1 s.
    stepped(model, 50)
    for name, (_, _, position, _) in cases.items():
        np.testing.assert_allclose(model.sensor(f"{name}.position")[0], position, atol=1e-6)
        np.testing.assert_allclose(model.sensor(f"{name}_touch.normal_force"), MASS * G, rtol=1e-5)
        np.testing.assert_allclose(model.sensor(f"{name}_touch.normal")[0], [0, 0, 1], atol=1e-5)


def test_cylinder_on_the_edge_of_a_table_stands_or_tips(device):
    """Standing with its center of mass inside the edge or outside, and lying across it."""
    floors = [lambda scene: add_floor(scene, "box")]
    model = scene_of([SHAPES["cylinder"]], floors).build(envs=3, device=device, precision="float64")
    model["body0.position"] = [(1.95, 0, HALF), (2.01, 0, HALF), (1.95, 0, RADIUS)]
    turns = Rotation.from_rotvec([[0, 0, 0], [0, 0, 0], [0, np.pi / 2, 0]])
    model["body0.orientation"] = turns.as_quat()
    sim = stepped(model, 100, 1e-3)
    stands = [0, 2]
    start = [(1.95, 0, HALF), (1.95, 0, RADIUS)]
    np.testing.assert_allclose(model.sensor("body0.position")[stands], start, atol=1e-7)
    np.testing.assert_allclose(model.sensor("touch0.normal_force")[stands], MASS * G, rtol=1e-6)
    # The edge is then in the flat end, whose normal is that of the contact.
    tilt = Rotation.from_quat(model.sensor("body0.orientation")[1])
    np.testing.assert_allclose(model.sensor("touch0.normal")[1], tilt.apply([0, 0, 1]), atol=2e-3)
    assert model.sensor("body0.angular_velocity")[1, 1] > 0.3
    sim.step(500)
    np.testing.assert_allclose(model.sensor("body0.position")[stands], start, atol=1e-7)
    assert model.sensor("body0.position")[1, 2] < 0.0


def test_circular_edge_of_a_tilted_cylinder_lands_on_an_edge(device):
    """The circular edge crosses the edge at its lowest point, and carries the weight there, below the center of mass."""
    # The lowest point of the circular edge is below the center if tan(tilt) is its ratio of radius to half length.
    tilt = np.arctan2(RADIUS, HALF)
    model = scene_of([SHAPES["cylinder"]], [on_ridge]).build(envs=1, device=device, precision="float64")
    height = RIDGE + np.hypot(RADIUS, HALF)
    model["body0.position"] = (0, 0, height + 1e-3)
    model["body0.orientation"] = Rotation.from_rotvec([tilt, 0, 0]).as_quat()
    stepped(model, 60, 1e-3)
    np.testing.assert_allclose(model.sensor("body0.position")[0], [0, 0, height], atol=1e-6)
    np.testing.assert_allclose(model.sensor("touch0.normal")[0], [0, 0, 1], atol=1e-4)
    np.testing.assert_allclose(model.sensor("touch0.center")[0], [0, 0, RIDGE], atol=1e-5)
    np.testing.assert_allclose(model.sensor("touch0.normal_force"), MASS * G, rtol=1e-4)


def test_capsules_and_spheres_rest_on_capsules(device):
    """Parallel capsules touch at the two ends of their common length, crossed ones and a sphere at one point."""
    scene = wc.Scene(gravity=(0, 0, -G))
    lying = Rotation.from_rotvec([np.pi / 2, 0, 0])
    below = scene.add_shape(None, SHAPES["capsule"], orientation=lying.as_quat(), name="below")
    slider = wc.motions.Slider(axis=(0, 0, 1))
    for name, shape in (("capsule", SHAPES["capsule"]), ("sphere", SHAPES["sphere"])):
        solid = scene.add_shape(scene.add_body(MASS, (0.04, 0.04, 0.025), name=name, motion=slider), shape)
        scene.add_body_contact(solid, below, rigid(), name=f"{name}_touch")
    model = scene.build(envs=3, device=device, precision="float64")
    # Parallel with a common length from y = -0.1 to 0.15 m, crossed, and nearly parallel.
    model["capsule.position"] = [(0, 0.05, 0.205), (0, 0, 0.205), (0, 0, 0.205)]
    turns = [lying, Rotation.from_rotvec([0, np.pi / 2, 0]), Rotation.from_rotvec([0, 0, 0.05]) * lying]
    model["capsule.orientation"] = [turn.as_quat() for turn in turns]
    model["sphere.position"] = [(0, 0.1, 0.205), (0, 0.2, 0.205), (0.05, 0, 0.21)]
    stepped(model, 100)
    # The sphere beyond the end of the capsule, and the one next to its axis, are lower.
    heights = [2 * RADIUS, np.sqrt(4 * RADIUS**2 - 0.05**2), np.sqrt(4 * RADIUS**2 - 0.05**2)]
    np.testing.assert_allclose(model.sensor("capsule.position")[:, 2], 2 * RADIUS, atol=CLOSED)
    np.testing.assert_allclose(model.sensor("sphere.position")[:, 2], heights, atol=1e-8)
    for name in ("capsule", "sphere"):
        np.testing.assert_allclose(model.sensor(f"{name}_touch.force")[:, 2], MASS * G, rtol=1e-6)
    points, forces = model.sensor("capsule_touch.point"), model.sensor("capsule_touch.point_force")
    loaded = forces[0, :, 2] > 1.0
    np.testing.assert_allclose(sorted(points[0, loaded, 1]), [-0.1, 0.15], atol=1e-9)
    assert (forces[1:, :, 2] > 1.0).sum(axis=1).tolist() == [1, 1]


def pile_of_solids(device):
    """Boxes, a cylinder, a capsule and a cone above each other over a floor with four walls."""
    scene = wc.Scene(gravity=(0, 0, -G))
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1e8))
    turns = [[0, 0, 0], [0, -np.pi / 2, 0], [0, np.pi / 2, 0], [np.pi / 2, 0, 0], [-np.pi / 2, 0, 0]]
    places = [(0, 0, 0), (0.15, 0, 0), (-0.15, 0, 0), (0, 0.15, 0), (0, -0.15, 0)]
    walls = [
        scene.add_shape(None, wc.shapes.Plane(), position=place, orientation=Rotation.from_rotvec(turn).as_quat())
        for place, turn in zip(places, turns, strict=True)
    ]
    box = wc.shapes.RoundedBox((0.05, 0.07, 0.04))
    forms = [
        box,
        wc.shapes.Cylinder(0.05, 0.06),
        box,
        wc.shapes.Capsule(0.04, 0.05),
        wc.shapes.Cone(0.06, 0.1),
        box,
    ]
    solids = []
    for number, form in enumerate(forms):
        body = scene.add_body(2.0, (4e-3,) * 3, position=(0, 0, 0.12 + 0.2 * number), name=f"body{number}")
        solids.append(scene.add_shape(body, form))
    scene.add_body_contact(solids, walls, material, name="walls")
    scene.add_body_contact(solids, material, name="parts")
    model = scene.build(envs=4, device=device, precision="float64")
    for number in range(len(forms)):
        model[f"body{number}.orientation"] = Rotation.random(4, random_state=number).as_quat()
    return model, len(forms)


def test_pile_of_solids_has_no_overlap_of_its_volumes(device):
    """The depth of the overlap is computed from columns, whose geometry is independent of that of the points."""
    model, count = pile_of_solids(device)
    sim = stepped(model, 1500, 1e-3, recovery_time=0.02)
    poses = [[model.sensor(f"body{i}.{key}") for key in ("position", "orientation")] for i in range(count)]
    assert (poses[-1][0][:, 2] > 0.0).all()
    assert sim.model.sensor("parts.normal_force").sum() > 0
    columns, _ = pile_of_solids(device)
    for i, (position, orientation) in enumerate(poses):
        columns[f"body{i}.position"], columns[f"body{i}.orientation"] = position, orientation
    columns.reset()
    # A step moves a point of a body with 10 rad/s by ½ ω² r h² = 4e-6 m off its tangent; the sum over 20 ms remains.
    assert columns.sensor("parts.depth").max() < 1e-4
    assert columns.sensor("walls.depth").max() < 1e-4
