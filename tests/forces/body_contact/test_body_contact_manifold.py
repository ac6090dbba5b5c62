"""Points of nonsmooth body contact: gaps of random boxes, crossing edges, exchange of bodies, conservation."""

import numpy as np
import pytest
import trimesh
from nonsmooth_scenes import G, rigid
from scipy.spatial.transform import Rotation

import warpcontact as wc

HALF_1, HALF_2 = np.array([0.1, 0.06, 0.03]), np.array([0.05, 0.12, 0.08])
#: Size of the smaller box, relative to which faces are preferred to edges.
SIZE = 0.2


def two_boxes(envs, device, material, *, exchanged=False):
    """A box as a shape and a box as a mesh, in free space; with ``exchanged`` the second one is the first solid."""
    scene = wc.Scene(gravity=(0, 0, 0))
    bodies = [
        scene.add_body(1.0, (half**2).sum() - half**2, name=name)
        for name, half in (("one", HALF_1), ("other", HALF_2))
    ]
    solids = [
        scene.add_shape(bodies[0], wc.shapes.RoundedBox(tuple(HALF_1))),
        scene.add_surface(wc.meshes.box(tuple(2 * HALF_2)), bodies[1]),
    ]
    scene.add_body_contact(*(solids[::-1] if exchanged else solids), material, name="touch")
    return scene.build(envs=envs, device=device, precision="float64")


def separations(offsets, turns):
    """Separations of pairs of boxes along the 6 normals of faces and the 9 of pairs of edges, and back, by projection.

    Returns the separations (pairs, 30) and the unit vectors (pairs, 30, 3); the first 12 are those of faces.
    """
    axes_1, axes_2 = (turn.as_matrix().swapaxes(1, 2) for turn in turns)
    across = np.cross(axes_1[:, :, None], axes_2[:, None]).reshape(-1, 9, 3)
    across /= np.linalg.norm(across, axis=2, keepdims=True)
    axes = np.concatenate([axes_1, axes_2, -axes_1, -axes_2, across, -across], axis=1)
    reach = [
        np.abs(np.einsum("pai,pki->pak", axes, own)) @ half for own, half in ((axes_1, HALF_1), (axes_2, HALF_2))
    ]
    return np.einsum("pai,pi->pa", axes, offsets) - reach[0] - reach[1], axes


def test_smallest_gap_of_random_boxes_is_their_separation(device):
    """Against projections onto all 15 axes; face and edge contacts, in overlap and apart."""
    count = 300
    rng = np.random.default_rng(0)
    turns = [Rotation.random(count, random_state=seed) for seed in (1, 2)]
    targets = rng.choice([-1e-2, -1e-3, -1e-4, 3e-5], size=count)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    low, high = np.zeros(count), np.ones(count)
    for _ in range(60):
        middle = 0.5 * (low + high)
        apart = separations(middle[:, None] * directions, turns)[0].max(axis=1) > targets
        low, high = np.where(apart, low, middle), np.where(apart, middle, high)
    offsets = low[:, None] * directions
    every, axes = separations(offsets, turns)
    gaps, normals = every.max(axis=1), axes[np.arange(count), every.argmax(axis=1)]
    # Edges count if they are farther apart than faces by 10⁻³ of the size.
    advantage = every[:, 12:].max(axis=1) - every[:, :12].max(axis=1)
    decided = (advantage < 0) | (advantage > 1e-3 * SIZE)
    assert 100 < (advantage > 1e-3 * SIZE).sum() < 200
    model = two_boxes(count, device, rigid())
    model["one.position"], model["one.orientation"] = offsets, turns[0].as_quat()
    model["other.orientation"] = turns[1].as_quat()
    with pytest.warns(wc.ContactWarning, match="initial penetration is 0.01 m"):
        wc.Simulation(model, dt=1e-9, integrator=wc.integrators.MoreauJean()).step(1)
    found = np.nanmin(model.sensor("touch.point_gap"), axis=1)
    assert decided.sum() > 280
    np.testing.assert_allclose(found[decided], gaps[decided], atol=1e-12)
    np.testing.assert_allclose(found, gaps, atol=1e-3 * SIZE)
    closed = decided & (gaps < 0)
    np.testing.assert_allclose(model.sensor("touch.normal")[closed], normals[closed], atol=1e-9)
    np.testing.assert_allclose(model.sensor("touch.depth")[closed], -gaps[closed], atol=1e-12)


def test_collisions_conserve_momentum_and_do_not_depend_on_the_order_of_bodies(device):
    envs = 20
    rng = np.random.default_rng(3)
    turns = [Rotation.random(envs, random_state=seed) for seed in (4, 5)]
    directions = rng.normal(size=(envs, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    spins = rng.normal(size=(envs, 3))
    ends = []
    for exchanged in (False, True):
        model = two_boxes(envs, device, rigid(0.3, 0.4), exchanged=exchanged)
        model["one.position"], model["one.orientation"] = 0.3 * directions, turns[0].as_quat()
        model["one.linear_velocity"], model["one.angular_velocity"] = -2.0 * directions, spins
        model["other.orientation"] = turns[1].as_quat()
        sim = wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean())
        run = sim.run(0.2, ["scene.kinetic_energy", "touch.force"], every=1e-3)
        momentum = sum(model.sensor(f"{name}.linear_velocity") for name in ("one", "other"))
        np.testing.assert_allclose(momentum, -2.0 * directions, atol=1e-12)
        turning = 0.0
        for name, half in (("one", HALF_1), ("other", HALF_2)):
            to_world = Rotation.from_quat(model.sensor(f"{name}.orientation"))
            inertia = (half**2).sum() - half**2
            spin = model.sensor(f"{name}.angular_velocity")
            turning += to_world.apply(inertia * to_world.inv().apply(spin))
            turning += np.cross(model.sensor(f"{name}.position"), model.sensor(f"{name}.linear_velocity"))
        start = turns[0].apply(((HALF_1**2).sum() - HALF_1**2) * turns[0].inv().apply(spins))
        # Displacements by lost gaps, of up to 10 µm at 2 m/s, change the moments of the linear momenta.
        np.testing.assert_allclose(turning, start, atol=2e-5)
        energy = run["scene.kinetic_energy"].values
        assert (np.diff(energy, axis=0) < 1e-9).all()
        hit = (run["touch.force"].values != 0).any(axis=(0, 2))
        assert hit.sum() > 15
        assert (energy[-1] < energy[0])[hit].all()
        ends.append(model.sensor("one.linear_velocity"))
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-6)


def test_crossing_edges_rest_on_each_other(device):
    """Bars on their edges, the upper one guided vertically: one point, also of nearly parallel edges."""
    half = 0.05
    angles = np.deg2rad([90.0, 45.0, 10.0, 1.0])
    scene = wc.Scene(gravity=(0, 0, -G))
    on_edge = Rotation.from_rotvec([np.pi / 4, 0, 0])
    lower = scene.add_shape(
        None, wc.shapes.RoundedBox((0.5, half, half)), position=(0, 0, 0), orientation=on_edge.as_quat()
    )
    upper = scene.add_body(2.0, (1, 1, 1), name="bar", motion=wc.motions.Slider(axis=(0, 0, 1)))
    solid = scene.add_shape(upper, wc.shapes.RoundedBox((0.5, half, half)))
    scene.add_body_contact(solid, lower, rigid(), name="touch")
    model = scene.build(envs=len(angles), device=device, precision="float64")
    height = 2 * np.sqrt(2) * half
    model["bar.position"] = (0, 0, height + 1e-3)
    model["bar.orientation"] = (Rotation.from_rotvec([[0, 0, a] for a in angles]) * on_edge).as_quat()
    wc.Simulation(model, dt=2e-3, integrator=wc.integrators.MoreauJean()).step(100)
    np.testing.assert_allclose(model.sensor("bar.position")[:, 2], height, atol=2e-9)
    assert np.abs(model.sensor("bar.linear_velocity")).max() < 1e-9
    np.testing.assert_allclose(model.sensor("touch.force")[:, 2], 2.0 * G, rtol=1e-6)
    count = (~np.isnan(model.sensor("touch.point_gap"))).sum(axis=1)
    np.testing.assert_array_equal(count, 1)
    np.testing.assert_allclose(model.sensor("touch.normal"), [[0, 0, 1]] * len(angles), atol=1e-9)


@pytest.mark.parametrize("floor", ["plane", "box"])
def test_prism_with_many_faces_rests_on_four_points(floor, device):
    """At most four of the 64 vertices of its base are used; lying, it rolls onto a facet."""
    prism = trimesh.creation.cylinder(radius=0.1, height=0.2, sections=64)
    scene = wc.Scene(gravity=(0, 0, -G))
    body = scene.add_body(5.0, (0.03, 0.03, 0.025), name="prism")
    solid = scene.add_surface(wc.Mesh(prism.vertices, prism.faces), body, name="faces")
    if floor == "plane":
        below = scene.add_shape(None, wc.shapes.Plane())
    else:
        below = scene.add_shape(None, wc.shapes.RoundedBox((1, 1, 0.1)), position=(0, 0, -0.1))
    scene.add_body_contact(solid, below, rigid(mu=0.5), name="touch")
    model = scene.build(envs=3, device=device, precision="float64")
    turns = Rotation.from_rotvec([[0, 0, 0], [0.05, 0.03, 0.1], [np.pi / 2, 0, 0]])
    # Slightly turned about its axis, the lying prism rolls onto a facet.
    turns *= Rotation.from_rotvec([[0, 0, 0], [0, 0, 0], [0, 0, 0.045]])
    model["prism.position"] = [(0, 0, 0.101), (0, 0, 0.11), (0, 0, 0.101)]
    model["prism.orientation"] = turns.as_quat()
    sim = wc.Simulation(model, dt=2e-3, integrator=wc.integrators.MoreauJean())
    sim.step(1000)
    lying = 0.1 * np.cos(np.pi / 64)
    np.testing.assert_allclose(model.sensor("prism.position")[:, 2], [0.1, 0.1, lying], atol=1e-6)
    assert np.abs(model.sensor("prism.linear_velocity")).max() < 1e-6
    assert np.abs(model.sensor("prism.angular_velocity")).max() < 1e-6
    np.testing.assert_allclose(model.sensor("touch.normal_force"), 5.0 * G, rtol=1e-5)
    np.testing.assert_array_equal((~np.isnan(model.sensor("touch.point_gap"))).sum(axis=1), 4)
    np.testing.assert_allclose(model.sensor("touch.load_ratio")[:2], 1.0, rtol=0.2)
