"""Reuse of the points of nonsmooth pairs at rest: agreement with a new search, changes that require one, checkpoints."""

import numpy as np
import pytest
from nonsmooth_scenes import G, rigid
from scipy.spatial.transform import Rotation
from warpcontact.kernels.manifolds.records import RESULTS_REUSED, RESULTS_SEARCHED
from warpcontact.kernels.manifolds.reuse import REUSE_DISTANCE

import warpcontact as wc

HALF = np.array([0.1, 0.06, 0.04])
RADIUS = 0.04
#: Largest displacement since a search, of all pairs of ``pairs_at_small_gaps``, whose smaller solids have a size of 0.2 m [m].
DISPLACEMENT = 0.2 * REUSE_DISTANCE
REUSED, SEARCHED = int(RESULTS_REUSED), int(RESULTS_SEARCHED)
# Pairs whose only point is between the nearest points of both solids.
NEAREST = (
    *("ball_on_ball", "ball_on_ridge", "ridge_on_ball", "log_on_log", "log_on_ridge", "ridge_on_log"),
    *("corner_on_log", "egg_on_egg", "rim_on_ridge", "tip_on_ball"),
)
# Pairs with solids that roll: their points do not turn with the solid.
ROLLING = ("ball_on_block", "log_on_floor", "log_on_block", "block_on_log")


def pairs_at_small_gaps(envs, device, seed=0):
    """Bodies without gravity at gaps of 2·10⁻⁵ m and small angles to the solids below, with different slow velocities.

    Returns the model and, by contact, the height of the body at which its lowest points have no gap.
    """
    scene = wc.Scene(gravity=(0, 0, 0))
    floor = scene.add_shape(None, wc.shapes.Plane())
    grid = scene.add_surface(wc.meshes.grid((2.0, 2.0), (7, 7)), position=(100, 0, 0))
    lying = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    heights = {}

    def add(name, x, make, below, height, *, exchanged=False, **placement):
        body = scene.add_body(1.0, (1e-2,) * 3, name=f"{name}_body", position=(x, 0, height + 2e-5))
        solid = make(body, **placement)
        scene.add_body_contact(*((below, solid) if exchanged else (solid, below)), rigid(), name=name)
        heights[name] = height

    def box(body, **placement):
        return scene.add_shape(body, wc.shapes.RoundedBox(tuple(HALF)), **placement)

    def block(x):
        return scene.add_shape(None, wc.shapes.RoundedBox((0.09, 0.11, 0.05)), position=(x, 0, -0.05))

    def cylinder(body, **placement):
        return scene.add_shape(body, wc.shapes.Cylinder(RADIUS, 0.1), **placement)

    def bracket(body, **placement):
        return scene.add_surface(wc.meshes.box(tuple(2 * HALF)), body, **placement)

    add("box_on_floor", 0, box, floor, HALF[2])
    add("box_on_block", 10, box, block(10), HALF[2])
    add("block_on_box", 20, box, block(20), HALF[2], exchanged=True)
    add("box_on_grid", 100, bracket, grid, HALF[2])
    on_edge = Rotation.from_rotvec([np.pi / 4, 0, 0]).as_quat()
    ridge = scene.add_shape(
        None, wc.shapes.RoundedBox((0.1, 0.05, 0.05)), position=(30, 0, 0), orientation=on_edge
    )
    across = (Rotation.from_rotvec([0, 0, 1.0]) * Rotation.from_rotvec([np.pi / 4, 0, 0])).as_quat()
    bar = wc.shapes.RoundedBox((0.1, 0.05, 0.05))
    add(
        "bar_on_ridge",
        30,
        lambda body, **p: scene.add_shape(body, bar, **p),
        ridge,
        0.1 * np.sqrt(2),
        orientation=across,
    )
    add("ball_on_block", 40, lambda body: scene.add_shape(body, wc.shapes.Sphere(0.1)), block(40), 0.1)
    add("log_on_floor", 50, cylinder, floor, RADIUS, orientation=lying)
    add("log_on_block", 60, cylinder, block(60), RADIUS, orientation=lying)
    add("block_on_log", 70, cylinder, block(70), RADIUS, orientation=lying, exchanged=True)
    add("can_on_block", 80, cylinder, block(80), 0.1)
    # Nearest points of two solids.
    along_y = (Rotation.from_rotvec([0, 0, np.pi / 2]) * Rotation.from_rotvec([np.pi / 4, 0, 0])).as_quat()
    top = 0.05 * np.sqrt(2)

    def shape(one):
        return lambda body, **placement: scene.add_shape(body, one, **placement)

    def ridge_at(x, orientation):
        return scene.add_shape(None, bar, position=(x, 0, 0), orientation=orientation)

    def log_at(x):
        position = (x, 0, -RADIUS)
        return scene.add_shape(None, wc.shapes.Cylinder(RADIUS, 0.1), position=position, orientation=lying)

    ball, cone = shape(wc.shapes.Sphere(0.1)), shape(wc.shapes.Cone(0.1, 0.2))
    round_below = scene.add_shape(None, wc.shapes.Sphere(0.06), position=(110, 0, -0.06))
    add("ball_on_ball", 110, ball, round_below, 0.1)
    add("ball_on_ridge", 120, ball, ridge_at(120, on_edge), 0.1 + top)
    add("ridge_on_ball", 130, ball, ridge_at(130, on_edge), 0.1 + top, exchanged=True)
    turned = (Rotation.from_rotvec([0, 0, np.pi / 2]) * Rotation.from_quat(lying)).as_quat()
    add("log_on_log", 140, cylinder, log_at(140), RADIUS, orientation=turned)
    add("log_on_ridge", 150, cylinder, ridge_at(150, along_y), RADIUS + top, orientation=lying)
    add("ridge_on_log", 160, cylinder, ridge_at(160, along_y), RADIUS + top, orientation=lying, exchanged=True)
    corner = Rotation.align_vectors([[0, 0, -1]], [[1, 1, 1]])[0].as_quat()
    cube = shape(wc.shapes.RoundedBox((0.1, 0.1, 0.1)))
    add("corner_on_log", 170, cube, log_at(170), 0.1 * np.sqrt(3), orientation=corner)
    egg = wc.shapes.Ellipsoid((0.1, 0.08, 0.06))
    add(
        "egg_on_egg",
        180,
        shape(egg),
        scene.add_shape(None, egg, position=(180, 0, -0.06), orientation=(0, 0, np.sqrt(0.5), np.sqrt(0.5))),
        0.06,
    )
    tilted = Rotation.from_rotvec([np.pi / 4, 0, 0]).as_quat()
    lowest = np.sqrt(0.5) * np.array([0.1 - RADIUS, 0.1 + RADIUS])
    # Its lowest point is below the center of mass.
    can = {"position": (0, -lowest[0], 0), "orientation": tilted}
    add("rim_on_ridge", 190, cylinder, ridge_at(190, along_y), lowest[1] + top, **can)
    upside_down = (1.0, 0.0, 0.0, 0.0)
    round_below = scene.add_shape(None, wc.shapes.Sphere(0.1), position=(200, 0, -0.1))
    add("tip_on_ball", 200, cone, round_below, 0.2, orientation=upside_down)
    model = scene.build(envs=envs, device=device, precision="float64")
    rng = np.random.default_rng(seed)
    for name in heights:
        position = np.array(model[f"{name}_body.position"])
        # The gap of nearest points grows with the square of the offset.
        spread = 5e-4 if name in NEAREST else 0.02
        position[:, :2] += rng.uniform(-spread, spread, size=(envs, 2))
        model[f"{name}_body.position"] = position
        tilts = np.concatenate(
            [rng.uniform(-1e-4, 1e-4, size=(envs, 2)), rng.uniform(-0.5, 0.5, size=(envs, 1))], 1
        )
        model[f"{name}_body.orientation"] = Rotation.from_rotvec(tilts).as_quat()
        # In each step of 1 ms a tenth of the displacement up to which points are reused, and a turn that adds as much.
        linear = rng.normal(size=(envs, 3))
        model[f"{name}_body.linear_velocity"] = (
            100 * DISPLACEMENT * linear / np.linalg.norm(linear, axis=1, keepdims=True)
        )
        angular = rng.normal(size=(envs, 3))
        angular *= 100 * DISPLACEMENT / 0.12 / np.linalg.norm(angular, axis=1, keepdims=True)
        model[f"{name}_body.angular_velocity"] = angular
    return model, list(heights)


def manifolds_of(model):
    """The manifolds of a model, which are of one set."""
    (found,) = [one for one in model.parts[0].force_elements if one.family == "body contact"]
    return found.active_manifolds


def origins_of(model):
    """Origins of the results of the last step, (envs, pairs)."""
    return manifolds_of(model).pairs.results.numpy().copy()


def normals_of(model, name):
    """Normals of the last evaluation of a contact with one point, (envs, 3)."""
    manifolds = manifolds_of(model)
    (slots,) = [slots for contact, (_, slots) in manifolds.contacts.items() if contact.name == name]
    is_present = manifolds.points.is_present.numpy()[:, slots] == 1
    np.testing.assert_array_equal(is_present.sum(axis=1), 1)
    return manifolds.points.normal.numpy()[:, slots][is_present]


def found_orientation(sim, name):
    """Orientations of the body of a pair, (envs, 4)."""
    return sim.model.sensor(f"{name}_body.orientation")


class Search:
    """Searches the points of another model with the same scene, without history."""

    def __init__(self, model):
        self.model = model
        self.sim = wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean())
        self.sim.step()

    def at(self, state, sensors):
        self.sim.reset()
        for name in ("position", "position_remainder", "orientation", "linear_velocity", "angular_velocity"):
            getattr(self.sim.state, f"body_{name}").assign(getattr(state, f"body_{name}"))
        return {name: self.model.sensor(name) for name in sensors}


def nearest_points(points, gaps, others, other_gaps):
    """Distances of points (envs, points, 3) from the nearest ones of others, and the differences of their gaps, without NaN."""
    between = points[:, :, None] - others[:, None]
    distance = np.where(np.isnan(between).any(axis=-1), np.inf, np.linalg.norm(between, axis=-1))
    nearest = distance.argmin(axis=2)
    is_point = np.isfinite(distance.min(axis=2))
    offset = np.take_along_axis(between, nearest[:, :, None, None], axis=2)[:, :, 0]
    return offset[is_point], (gaps - np.take_along_axis(other_gaps, nearest, axis=1))[is_point], is_point


def test_points_that_are_reused_are_those_of_a_new_search(device):
    """Gaps to second order in the displacement, and positions of solids that roll; other positions to the displacement.

    They do not drift, because the displacement since the search limits the number of steps in which points are reused.
    """
    envs, steps = 16, 24
    model, names = pairs_at_small_gaps(envs, device)
    search = Search(pairs_at_small_gaps(envs, device)[0])
    sim = wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean())
    sensors = [f"{name}.{key}" for name in names for key in ("point", "point_gap")]
    origins = []
    for step in range(steps):
        sim.step()
        origins.append(origins_of(model))
        if step % 4 != 3:
            continue
        found = {name: model.sensor(name) for name in sensors}
        expected = search.at(sim.state, sensors)
        for name in names:
            places, gaps = (found[f"{name}.{key}"] for key in ("point", "point_gap"))
            other_places, other_gaps = (expected[f"{name}.{key}"] for key in ("point", "point_gap"))
            offsets, differences, is_point = nearest_points(places, gaps, other_places, other_gaps)
            if name == "can_on_block":
                # Which points of a circular edge are chosen depends on those of the last step, and its lowest point moves fast.
                same = np.linalg.norm(offsets, axis=1) < DISPLACEMENT
                assert same.sum() > 2 * envs
                assert np.abs(differences[same]).max() < DISPLACEMENT**2 / HALF[2]
                continue
            assert is_point.any(axis=1).all()
            assert (np.isnan(gaps).sum(axis=1) == np.isnan(other_gaps).sum(axis=1)).all()
            # A line of a cylinder has a slope of up to 10⁻⁴ where it is cut by an edge.
            slides = name in ("log_on_block", "block_on_log")
            assert np.abs(differences).max() < (1e-4 * DISPLACEMENT if slides else DISPLACEMENT**2 / HALF[2])
            limit = 1e-5 * DISPLACEMENT if name in NEAREST else 1.2 * DISPLACEMENT
            assert np.linalg.norm(offsets, axis=1).max() < limit, name
            if name in NEAREST:
                np.testing.assert_allclose(normals_of(model, name), normals_of(search.model, name), atol=1e-12)
            if name in ROLLING:
                # Across the axis of a cylinder; a ball has none.
                turns = Rotation.from_quat(found_orientation(sim, name)).as_matrix()
                across = turns[:, :, 1] if name != "ball_on_block" else turns[:, :, 0]
                env = np.nonzero(is_point)[0]
                assert np.abs((offsets * across[env]).sum(axis=1)).max() < 1e-4 * DISPLACEMENT
    origins = np.array(origins)
    assert set(np.unique(origins)) == {REUSED, SEARCHED}
    reused = (origins == REUSED).mean(axis=(0, 1))
    assert (reused > 0.6).all()
    # Bodies move by at least a tenth of the displacement in a step.
    for start in range(steps - 10):
        assert (origins[start : start + 11] == SEARCHED).any(axis=0).all()


def resting_boxes(envs, device, precision="float64"):
    """A box as a mesh on a box, at rest, with a parameter of each kind that its points depend on."""
    scene = wc.Scene(gravity=(0, 0, -G))
    body = scene.add_body(1.0, (1e-2,) * 3, name="box", position=(0, 0, 0.05))
    solid = scene.add_surface(wc.meshes.box((0.2, 0.2, 0.1)), body, name="faces")
    floor = scene.add_shape(None, wc.shapes.RoundedBox((0.3, 0.3, 0.1)), position=(0, 0, -0.1), name="floor")
    scene.add_body_contact(solid, floor, rigid(mu=0.5), name="touch")
    return scene.build(envs=envs, device=device, precision=precision)


CHANGES = {
    "touch.kappa": (0.5, 0.25),
    "touch.margin": (0.0, 1e-3),
    "touch.enabled": (1, 0),
    "faces.scale": (1.0, 1.0 + 1e-9),
    "faces.position": ((0, 0, 0), (0, 0, 1e-6)),
    "floor.half_extents": ((0.3, 0.3, 0.1), (0.3, 0.31, 0.1)),
    "floor.orientation": ((0, 0, 0, 1), (0, 0, np.sin(1e-6), np.cos(1e-6))),
}


def test_changed_parameters_lead_to_a_new_search(device):
    """Each in one environment; the others reuse their points. Also after a reset, and when enabled again."""
    model = resting_boxes(len(CHANGES) + 1, device)
    sim = wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean())
    sim.step(300)
    assert (origins_of(model) == REUSED).all()
    for i, (name, (before, after)) in enumerate(CHANGES.items()):
        values = np.array([before] * model.envs, dtype=float)
        values[i] = after
        model[name] = values
        sim.step()
        # Disabled pairs have no points to reuse.
        changed = (np.arange(model.envs) == i) | (model["touch.enabled"] == 0)
        expected = np.where(changed, SEARCHED, REUSED)[:, None]
        np.testing.assert_array_equal(origins_of(model), expected, err_msg=name)
        sim.step(20)
    count = (~np.isnan(model.sensor("touch.point_gap"))).sum(axis=1)
    np.testing.assert_array_equal(count, np.where(model["touch.enabled"] == 1, 4, 0))
    model["touch.enabled"] = 1
    sim.step(100)
    assert (origins_of(model) == REUSED).all()
    sim.reset(np.arange(model.envs) == 3)
    sim.step()
    np.testing.assert_array_equal(origins_of(model)[:, 0] == SEARCHED, np.arange(model.envs) == 3)


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_simulation_that_reuses_points_continues_bitwise_identically_from_a_checkpoint(
    tmp_path, precision, device
):
    """Steps between searches, and sensors that are read between steps, do not change the results."""
    models = [resting_boxes(3, device, precision) for _ in range(2)]
    for model in models:
        # Turns slowly without friction, so that points are reused in some steps and searched in others.
        model["touch.friction.mu"] = [0.0, 0.5, 0.0]
        model["box.angular_velocity"] = [[0, 0, 3e-5], [0, 0, 0], [0, 0, 1e-5]]
    first, second = (wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean()) for model in models)
    first.step(101)
    first.save(tmp_path / "state.npz")
    second.load(tmp_path / "state.npz")
    seen = []
    for _ in range(12):
        first.step()
        seen.append(origins_of(models[0]))
        second.step()
        np.testing.assert_array_equal(seen[-1], origins_of(models[1]))
        models[1].sensor("touch.point")
    for key in ("box.position", "box.orientation", "box.angular_velocity", "touch.point_force", "touch.point_gap"):
        np.testing.assert_array_equal(models[0].sensor(key), models[1].sensor(key))
    assert {REUSED, SEARCHED} == set(np.unique(seen))
    assert (models[0].sensor("touch.normal_force") > 0).all()


def test_slow_rolling_is_neither_driven_nor_braked(device):
    """The velocity of a ball and a cylinder is constant; points that lag by the displacement would add 10⁻⁶ m/s in a second."""
    scene = wc.Scene(gravity=(0, 0, -G))
    floor = scene.add_shape(None, wc.shapes.Plane())
    block = scene.add_shape(None, wc.shapes.RoundedBox((0.3, 0.3, 0.1)), position=(2, 0, -0.1))
    lying = (np.sqrt(0.5), 0, 0, np.sqrt(0.5))
    speeds = np.array([0.0, 1e-8, 1e-6, 1e-5])
    names = []
    for x, below in ((0, floor), (2, block)):
        for y, name, shape in ((0, "ball", wc.shapes.Sphere(0.1)), (0.2, "log", wc.shapes.Cylinder(0.1, 0.05))):
            body = scene.add_body(1.0, (4e-3,) * 3, name=f"{name}_{x}", position=(x, y, 0.1))
            names.append(body.name)
            solid = scene.add_shape(body, shape, orientation=lying)
            pair = (below, solid) if x else (solid, below)
            scene.add_body_contact(*pair, rigid(mu=0.5), name=f"roll_{body.name}")
    model = scene.build(envs=len(speeds), device=device, precision="float64")
    for name in names:
        model[f"{name}.linear_velocity"] = speeds[:, None] * [1, 0, 0]
        model[f"{name}.angular_velocity"] = speeds[:, None] * [0, 10, 0]
    sim = wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean(tolerance=1e-10))
    sim.step(1000)
    assert (origins_of(model)[1] == REUSED).all()
    for name in names:
        found = model.sensor(f"{name}.linear_velocity")[:, 0]
        np.testing.assert_allclose(found, speeds, atol=1e-9, err_msg=name)


#: Height of the end of the fourth leg of the table above the floor [m]: within the margin g dt² of the long steps, and not of the short ones.
RAISED = 2e-3


def table_with_a_short_leg(device):
    """Returns a model of a table at rest on three legs of a mesh; the fourth one ends above the floor."""
    scene = wc.Scene(gravity=(0, 0, -G))
    vertices, faces = [], []
    for x, y in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
        leg = wc.meshes.box((0.02, 0.02, 0.1))
        bottom = RAISED if (x, y) == (1, 1) else 0.0
        faces.append(np.array(leg.faces) + sum(len(one) for one in vertices))
        vertices.append(leg.vertices + np.array([0.1 * x, 0.1 * y, 0.05 + bottom]))
    mesh = wc.Mesh(np.concatenate(vertices), np.concatenate(faces))
    # The center of mass is above the triangle of the three legs.
    table = scene.add_body(1.0, (1e-2,) * 3, name="table")
    solid = scene.add_surface(mesh, table, position=(0.05, 0.05, 0.0))
    scene.add_body_contact(solid, scene.add_shape(None, wc.shapes.Plane()), rigid(mu=0.5), name="touch")
    return scene.build(envs=1, device=device, precision="float64")


def test_points_are_searched_again_after_a_change_of_the_step_length(device):
    """A longer step has a larger margin, so that a point that was too far away is found, and lost again with the shorter step."""
    model = table_with_a_short_leg(device)
    sims = {dt: wc.Simulation(model, dt=dt, integrator=wc.integrators.MoreauJean()) for dt in (1e-3, 2e-2)}
    for dt, highest in ((1e-3, 0.0), (2e-2, RAISED), (1e-3, 0.0), (2e-2, RAISED)):
        for origin in (SEARCHED, REUSED, REUSED):
            sims[dt].step()
            assert (origins_of(model) == origin).all()
            # Sensors would be evaluated for a step of no length.
            gaps = manifolds_of(model).points.gap.numpy()[0]
            np.testing.assert_allclose(np.sort(gaps), [0.0, 0.0, 0.0, highest], atol=1e-9)
        np.testing.assert_allclose(model.sensor("touch.normal_force"), G, rtol=1e-6)
