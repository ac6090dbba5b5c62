"""Nonsmooth body contact: landing, friction, sliding off an edge, meshes that are not convex, history."""

import numpy as np
import pytest
from nonsmooth_scenes import G, rigid
from scipy.spatial.transform import Rotation

import warpcontact as wc

SIDE, MASS, MU = 0.2, 8.0, 0.5
SOLVERS = ["auto", "gauss_seidel", "accelerated"]
OPEN, CONTACT, DISABLED = wc.ContactStatus.OPEN, wc.ContactStatus.CONTACT, wc.ContactStatus.DISABLED


def add_cube(scene, name, side=SIDE, mass=MASS, mesh=False, **motion):
    """Adds a cube as a shape or a mesh on a body; returns its solid."""
    body = scene.add_body(mass, (mass * side**2 / 6,) * 3, name=name, **motion)
    if mesh:
        return scene.add_surface(wc.meshes.box((side,) * 3), body, name=f"{name}_faces")
    return scene.add_shape(body, wc.shapes.RoundedBox((side / 2,) * 3), name=f"{name}_shape")


def add_floor(scene, kind):
    """Adds a floor with its upper side at z = 0."""
    if kind == "plane":
        return scene.add_shape(None, wc.shapes.Plane(), name="floor")
    if kind == "box":
        return scene.add_shape(None, wc.shapes.RoundedBox((1, 1, 0.1)), position=(0, 0, -0.1), name="floor")
    return scene.add_surface(wc.meshes.grid((2.0, 2.0), (5, 5)), name="floor")


def cube_on(floor, *, mu=MU, envs=1, precision="float64", device="cpu", mesh=False, law=None):
    """A cube whose lower side is at z = 0."""
    scene = wc.Scene(gravity=(0, 0, -G))
    material = rigid(mu=mu) if law is None else wc.ContactMaterial(law=law)
    cube = add_cube(scene, "cube", mesh=mesh, position=(0, 0, SIDE / 2))
    scene.add_body_contact(cube, add_floor(scene, floor), material, name="touch")
    return scene.build(envs=envs, device=device, precision=precision)


def moreau_jean(**options):
    return wc.integrators.MoreauJean(**options)


@pytest.mark.parametrize("solver", SOLVERS)
def test_tilted_cube_comes_to_rest(solver, device):
    """A cube that lands on a vertex and an edge, on a plane, and as a mesh on a box."""
    for floor, mesh in (("plane", False), ("box", True)):
        model = cube_on(floor, mesh=mesh, envs=2, device=device)
        model["cube.position"] = (0, 0, 0.12)
        tilts = Rotation.from_rotvec(np.deg2rad([[5.0, 0, 0], [3.0, 4.0, 20.0]]))
        model["cube.orientation"] = tilts.as_quat()
        sim = wc.Simulation(model, dt=2e-3, integrator=moreau_jean(solver=solver))
        sim.step(500)
        before = model.sensor("cube.position")
        sim.step(1000)
        position = model.sensor("cube.position")
        # Half of the gap at which a point counts as closed.
        np.testing.assert_allclose(position[:, 2], SIDE / 2, atol=1e-9)
        np.testing.assert_allclose(position, before, atol=1e-8)
        assert np.abs(model.sensor("cube.linear_velocity")).max() < 1e-8
        assert np.abs(model.sensor("cube.angular_velocity")).max() < 1e-8
        np.testing.assert_allclose(model.sensor("touch.normal_force"), MASS * G, rtol=1e-6)
        np.testing.assert_allclose(model.sensor("touch.load_ratio"), 1.0, rtol=1e-5)


@pytest.mark.parametrize("solver", SOLVERS)
def test_friction_holds_up_to_its_limit(solver, device):
    duration, limit = 1.0, MU * MASS * G
    factors = np.array([0.98, 1.02])
    model = cube_on("box", envs=2, device=device)
    model["cube.external_force"] = np.outer(factors * limit, [np.cos(0.4), np.sin(0.4), 0])
    wc.Simulation(model, dt=2e-3, integrator=moreau_jean(solver=solver)).step(round(duration / 2e-3))
    way = np.linalg.norm(model.sensor("cube.position")[:, :2], axis=1)
    assert way[0] < 1e-9
    assert way[1] == pytest.approx(0.5 * 0.02 * limit / MASS * duration**2, rel=1e-6)
    np.testing.assert_allclose(model.sensor("touch.normal_force"), MASS * G, rtol=1e-6)
    assert model.sensor("touch.friction_force")[1, :2] == pytest.approx(
        -limit * np.array([np.cos(0.4), np.sin(0.4)]), rel=1e-6
    )


def test_cube_that_slides_off_an_edge_is_carried_until_its_center_has_passed(device):
    scene = wc.Scene(gravity=(0, 0, -G))
    cube = add_cube(scene, "cube", position=(0.85, 0, SIDE / 2), linear_velocity=(1.0, 0, 0))
    scene.add_body_contact(cube, add_floor(scene, "box"), rigid(), name="touch")
    model = scene.build(envs=1, device=device, precision="float64")
    sim = wc.Simulation(model, dt=1e-3, integrator=moreau_jean())
    names = ["cube.position", "cube.angular_velocity", "touch.normal_force", "scene.kinetic_energy"]
    names += ["scene.potential_energy", "touch.reference"]
    run = sim.run(0.4, names, every=5e-3)
    x, z = run["cube.position"].values[:, 0, [0, 2]].T
    carried = (x < 0.999) & (np.arange(len(x)) > 0)
    # Tolerance of the solver, 1e-8, relative to the impulse of each point.
    np.testing.assert_allclose(run["touch.normal_force"].values[carried, 0], MASS * G, rtol=2e-6)
    np.testing.assert_allclose(z[x < 0.999], SIDE / 2, atol=1e-9)
    assert np.abs(run["cube.angular_velocity"].values[x < 0.999]).max() < 1e-6
    # The edge is then in the lower face of the cube, which is the reference.
    tipping = (x > 1.005) & (run["touch.normal_force"].values[:, 0] > 0)
    assert tipping.sum() > 5
    assert not run["touch.reference"].values[tipping].any()
    assert run["cube.angular_velocity"].values[-1, 0, 1] > 1.0
    energy = (run["scene.kinetic_energy"] + run["scene.potential_energy"]).values[:, 0]
    # The edge slides without friction, so only its first impacts take energy.
    assert np.diff(energy).max() < 1e-3 * MASS * G * SIDE


def voxels(cells, edge):
    """Returns the closed mesh around unit cells, scaled by ``edge``, with merged vertices."""
    corners: dict = {}
    faces = []
    for cell in sorted(cells):
        for axis in range(3):
            for sign in (-1, 1):
                step = np.eye(3, dtype=int)[axis] * sign
                if tuple(np.add(cell, step)) in cells:
                    continue
                u, v = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
                start = np.add(cell, np.eye(3, dtype=int)[axis] * (sign > 0))
                loop = [start, start + u, start + u + v, start + v][::sign]
                numbers = [corners.setdefault(tuple(p.tolist()), len(corners)) for p in loop]
                faces += [numbers[:3], [numbers[0], *numbers[2:]]]
    return wc.Mesh(np.array(list(corners), dtype=float) * edge, faces)


def test_table_of_four_legs_stands_on_its_outer_corners(device):
    cells = {(x, y, 3) for x in range(5) for y in range(5)}
    cells |= {(x, y, z) for x in (0, 4) for y in (0, 4) for z in range(3)}
    mesh = voxels(cells, 0.1)
    for floor in ("plane", "box", "sheet"):
        scene = wc.Scene(gravity=(0, 0, -G))
        body = scene.add_body(MASS, (1, 1, 1), position=(-0.25, -0.25, 5e-3), name="table")
        # The center of mass is 0.05 m off the middle of the table.
        top = scene.add_surface(mesh, body, position=(-0.25, -0.3, -0.2), name="top")
        scene.add_body_contact(top, add_floor(scene, floor), rigid(mu=MU), name="touch")
        model = scene.build(envs=1, device=device, precision="float64")
        model["table.position"] = (0, 0, 0.205)
        wc.Simulation(model, dt=2e-3, integrator=moreau_jean()).step(300)
        np.testing.assert_allclose(model.sensor("table.position")[0], [0, 0, 0.2], atol=1e-9)
        assert not np.abs(model.sensor("table.angular_velocity")).max() > 1e-9
        present = ~np.isnan(model.sensor("touch.point_gap")[0])
        points, force = model.sensor("touch.point")[0][present], model.sensor("touch.point_force")[0][present]
        order = np.lexsort(np.round(points[:, :2], 6).T)
        right = [(x, y, 0) for y in (-0.3, 0.2) for x in (-0.25, 0.25)]
        np.testing.assert_allclose(points[order], right, atol=1e-8)
        # Moments about the center of mass vanish.
        assert force[:, 2].sum() == pytest.approx(MASS * G)
        np.testing.assert_allclose(model.sensor("touch.torque")[0], 0, atol=1e-6)
        np.testing.assert_allclose(force[order, 2], MASS * G * np.array([0.2, 0.2, 0.3, 0.3]), rtol=1e-2)


def test_cube_in_a_groove_of_one_mesh_is_carried_by_both_walls(device):
    """Two patches with their own normals: each wall of a right-angled groove carries m g/√2."""
    half, depth = 0.5, 0.4
    outline = [(-half, 0), (-half, -half), (half, -half), (half, 0), (depth, 0), (0, -depth), (-depth, 0)]
    scene = wc.Scene(gravity=(0, 0, -G))
    block = scene.add_surface(prism(outline, 0.6), name="block")
    turn = Rotation.from_rotvec([0, np.pi / 4, 0]).as_quat()
    lowest = SIDE / np.sqrt(2) - depth
    cube = add_cube(scene, "cube", mesh=True, position=(0, 0, lowest + 1e-3), orientation=turn)
    scene.add_body_contact(cube, block, rigid(), name="touch")
    model = scene.build(envs=1, device=device, precision="float64")
    wc.Simulation(model, dt=2e-3, integrator=moreau_jean()).step(300)
    np.testing.assert_allclose(model.sensor("cube.position")[0], [0, 0, lowest], atol=1e-8)
    force = model.sensor("touch.point_force")[0]
    for sign in (-1, 1):
        wall = force[sign * force[:, 0] > 1e-3]
        assert len(wall) == 4
        np.testing.assert_allclose(wall.sum(axis=0), [sign * MASS * G / 2, 0, MASS * G / 2], atol=1e-4)
    assert model.sensor("touch.normal_force")[0] == pytest.approx(np.sqrt(2) * MASS * G, rel=1e-6)


def prism(outline, length):
    """Returns the closed mesh of a star-shaped outline (x, z), seen counter-clockwise from −y, along y."""
    count = len(outline)
    points = np.array([(x, y, z) for y in (-length / 2, length / 2) for x, z in outline])
    center = 2 * count
    points = np.vstack([points, [(0, y, -0.45) for y in (-length / 2, length / 2)]])
    faces = []
    for i in range(count):
        k = (i + 1) % count
        faces += [(i, count + k, k), (i, count + i, count + k)]
        faces += [(center, i, k), (center + 1, count + k, count + i)]
    return wc.Mesh(points, faces)


def test_simulation_loaded_from_checkpoint_continues_bitwise_identically(tmp_path, device):
    """Features, references and impulses of points are stored."""
    models = [cube_on("box", envs=2, device=device) for _ in range(2)]
    for model in models:
        model["cube.linear_velocity"] = [[0.5, 0.1, 0], [0, 0, -0.1]]
        model["cube.angular_velocity"] = [[0, 0, 2.0], [1.0, 0.5, 0]]
    first, second = (wc.Simulation(model, dt=1e-3, integrator=moreau_jean()) for model in models)
    first.step(30)
    first.save(tmp_path / "state.npz")
    second.load(tmp_path / "state.npz")
    for sim in (first, second):
        sim.step(40)
    for key in ("cube.position", "cube.angular_velocity", "touch.force", "touch.point_force", "touch.torque"):
        np.testing.assert_array_equal(models[0].sensor(key), models[1].sensor(key))
    assert (models[0].sensor("touch.normal_force") > 0).all()


def test_reset_simulation_repeats_bitwise_identically(device):
    model = cube_on("box", device=device)
    model["cube.angular_velocity"] = [[1.0, 0.5, 0.3]]
    sim = wc.Simulation(model, dt=1e-3, integrator=moreau_jean())
    runs = []
    for _ in range(2):
        sim.reset()
        sim.step(100)
        runs.append([model.sensor(key) for key in ("cube.position", "touch.point_force")])
    for first, second in zip(*runs, strict=True):
        np.testing.assert_array_equal(first, second)


def test_results_of_solids_that_were_moved_apart_are_those_of_distant_ones(device):
    """Results of distant pairs are not written again in each step, also if sensors were read in between, and after a reset."""
    keys = ("status", "depth", "normal", "center", "area", "force", "reference", "point", "point_gap", "overflow")
    model, distant = (cube_on("box", envs=3, device=device) for _ in range(2))
    distant["cube.position"] = (0, 0, 1.0)
    sims = [wc.Simulation(one, dt=1e-3, integrator=moreau_jean()) for one in (model, distant)]

    def move_to(height):
        state = sims[0].state
        state.body_position.assign(np.full((3, 1, 3), (0, 0, height)))
        state.body_linear_velocity.zero_()

    sims[0].step(20)
    resting = {key: model.sensor(f"touch.{key}") for key in keys}
    assert (resting["status"] == CONTACT).all()
    assert (resting["force"][:, 2] > 0).all()
    move_to(1.0)
    # Impulses of the last step are shown with the new positions.
    assert (model.sensor("touch.normal")[:, 2] == 1).all()
    for sim in sims:
        sim.step(2)
    for key in keys:
        np.testing.assert_array_equal(model.sensor(f"touch.{key}"), distant.sensor(f"touch.{key}"))
    sims[0].reset([False, True, False])
    sims[0].step(20)
    np.testing.assert_array_equal(model.sensor("touch.status"), [OPEN, CONTACT, OPEN])
    for key in keys:
        np.testing.assert_array_equal(model.sensor(f"touch.{key}")[1], resting[key][1])
    model["touch.enabled"] = [0, 0, 1]
    move_to(SIDE / 2)
    sims[0].step()
    np.testing.assert_array_equal(model.sensor("touch.status"), [DISABLED, DISABLED, CONTACT])


def test_area_sensors_of_points_are_nan(device):
    model = cube_on("plane", device=device)
    wc.Simulation(model, dt=1e-3, integrator=moreau_jean()).step(5)
    for key in ("area", "volume", "max_pressure"):
        assert np.isnan(model.sensor(f"touch.{key}")).all()
    assert model.sensor("touch.status")[0] == wc.ContactStatus.CONTACT
    np.testing.assert_allclose(model.sensor("touch.normal")[0], [0, 0, 1])
    np.testing.assert_allclose(model.sensor("touch.center")[0], [0, 0, 0], atol=1e-9)
    assert model.sensor("touch.depth")[0] < 1e-9


def test_compliant_law_is_nonsmooth_unless_contact_is_compliant(device):
    """Restitution of the law is used; with ``compliant`` its force is, also in the same set."""
    law = wc.laws.ElasticFoundation(stiffness=2e7, damping=20.0)
    model = cube_on("plane", device=device, law=law)
    sim = wc.Simulation(model, dt=1e-3, integrator=moreau_jean())
    sim.step(20)
    assert model.sensor("cube.position")[0, 2] == pytest.approx(SIDE / 2, abs=1e-9)
    sim = wc.Simulation(model, dt=1e-4, integrator=moreau_jean(compliant=["touch"]))
    sim.step(5000)
    assert SIDE / 2 - model.sensor("cube.position")[0, 2] == pytest.approx(MASS * G / (2e7 * SIDE**2), rel=1e-3)
    assert model.sensor("touch.area")[0] == pytest.approx(SIDE**2)


def test_rigid_body_contact_needs_moreau_jean():
    model = cube_on("plane")
    with pytest.raises(
        ValueError, match=r"touch\.law is Rigid, which has no force; use the integrator MoreauJean"
    ):
        wc.Simulation(model, dt=1e-3)


@pytest.mark.parametrize("impacts", ["simultaneous", "sequential"])
def test_cube_bounces_with_its_restitution(impacts, device):
    """A cube that lands flat separates with e times its speed, also if its points close within the step only."""
    scene = wc.Scene(gravity=(0, 0, 0))
    cube = add_cube(scene, "cube", linear_velocity=(0, 0, -1.0))
    scene.add_body_contact(cube, add_floor(scene, "plane"), rigid(0.5, MU), name="touch")
    model = scene.build(envs=3, device=device, precision="float64")
    model["cube.position"] = [(0, 0, SIDE / 2 + gap) for gap in (1e-2, 1.02e-2, 1.07e-2)]
    wc.Simulation(model, dt=1e-3, integrator=moreau_jean(impacts=impacts)).step(40)
    np.testing.assert_allclose(model.sensor("cube.linear_velocity"), [[0, 0, 0.5]] * 3, atol=1e-7)
    np.testing.assert_allclose(model.sensor("cube.angular_velocity"), 0, atol=1e-7)


def test_margin_shows_larger_gaps_and_does_not_change_the_motion(device):
    """Without a margin, points are found up to 10⁻³ of the size, and the distance of two steps."""
    gap = 5e-3
    scene = wc.Scene(gravity=(0, 0, -G))
    plane = add_floor(scene, "plane")
    cube = add_cube(scene, "cube", position=(0, 0, SIDE / 2 + gap))
    tube = scene.add_body(1.0, (0.1,) * 3, position=(1, 0, 0.1 + gap), name="tube")
    cylinder = scene.add_shape(tube, wc.shapes.Cylinder(0.1, 0.2), orientation=(np.sqrt(0.5), 0, 0, np.sqrt(0.5)))
    for name, solid in (("touch", cube), ("roll", cylinder)):
        scene.add_body_contact(solid, plane, rigid(mu=0.5), name=name)
    model = scene.build(envs=2, device=device, precision="float64")
    for name in ("touch", "roll"):
        model[f"{name}.margin"] = [0.0, 0.01]
    sim = wc.Simulation(model, dt=1e-3, integrator=moreau_jean())
    sim.step()
    for name, count in (("touch", 4), ("roll", 2)):
        found = model.sensor(f"{name}.point_gap")
        assert np.isnan(found[0]).all()
        # Sensors of the step are those at its middle, after half of the fall of g h².
        np.testing.assert_allclose(found[1, :count], gap - 0.5 * G * 1e-3**2, atol=1e-12)
    # After the impact, both come to rest at the same places.
    sim.step(100)
    for body in ("cube", "tube"):
        position = model.sensor(f"{body}.position")
        np.testing.assert_allclose(position[1], position[0], atol=1e-12)
        np.testing.assert_allclose(position[:, 2], 0.1, atol=1e-9)


def test_points_that_close_act_in_the_plane_of_the_deepest_point_of_their_patch(device):
    """Points of different heights could not stick while one of them closes: friction would grow until one slips."""
    model = cube_on("box", mesh=True, envs=3, device=device)
    tilts = np.array([1e-3, 1e-4, 1e-5])
    model["cube.orientation"] = Rotation.from_rotvec(tilts[:, None] * [[0.0, 1.0, 0.0]]).as_quat()
    # The lower edge is 1 µm deep.
    model["cube.position"] = np.outer(SIDE / 2 * (np.cos(tilts) + np.sin(tilts)) - 1e-6, (0, 0, 1))
    wc.Simulation(model, dt=1e-3, integrator=moreau_jean()).step(1)
    rows = model.nonsmooth.rows.numpy()[:, :4]
    # Gap over step, but for half of the gap at which a point counts as closed.
    np.testing.assert_allclose(-rows["recovery"].min(axis=1), (SIDE * tilts - 1e-6) / 1e-3, rtol=1e-3)
    heights = np.einsum("eij,eij->ei", rows["arm_1"], rows["normal"])
    # Rounding of the arms.
    assert np.ptp(heights, axis=1).max() < 1e-15
