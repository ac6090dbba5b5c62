"""Nonsmooth contact with holes of meshes: a tetrahedron in a ring, an angle that pivots on the edge of a hole, and nuts on a larger hole."""

import numpy as np
import pytest
from nonsmooth_scenes import rigid
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import warpcontact as wc

SECTORS, INNER, OUTER, HALF_HEIGHT = 24, 5e-3, 10e-3, 4e-3  # of the ring [m]
EDGE = 18e-3  # of the tetrahedron [m]


def ring(inner=INNER, outer=OUTER, half_height=HALF_HEIGHT, sides=0):
    """Returns the mesh of a ring about z, with ``sides`` outer sides at the distance ``outer``, and its convex sectors, each (8, 3)."""
    angles = 2 * np.pi * np.arange(SECTORS) / SECTORS
    outline = [(inner, -half_height), (outer, -half_height), (outer, half_height), (inner, half_height)]
    vertices = np.array([(r * np.cos(a), r * np.sin(a), z) for a in angles for r, z in outline])
    if sides:
        half = np.pi / sides
        vertices.reshape(SECTORS, 4, 3)[:, 1:3, :2] /= np.cos((angles + half) % (2 * half) - half)[:, None, None]
    faces, sectors = [], []
    for i in range(SECTORS):
        this, following = 4 * i + np.arange(4), 4 * ((i + 1) % SECTORS) + np.arange(4)
        sectors.append(vertices[np.concatenate([this, following])])
        for k in range(4):
            a, b, c, d = this[k], this[(k + 1) % 4], following[(k + 1) % 4], following[k]
            faces += [(a, c, b), (a, d, c)]
    return wc.Mesh(vertices, np.array(faces)), sectors


def test_tetrahedron_in_a_ring_rests_without_overlap(device):
    """It touches the ring on edges that cross, while faces touch elsewhere."""
    mesh, sectors = ring()
    corners = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) * EDGE / np.sqrt(8)
    scene = wc.Scene()
    below = scene.add_surface(mesh, name="ring")
    part = scene.add_body(1e-3, (1e-3 * EDGE**2 / 20,) * 3, name="part")
    solid = scene.add_surface(
        wc.Mesh(corners, np.array([(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)])), part, name="tetrahedron"
    )
    scene.add_body_contact(solid, below, rigid(mu=0.4), name="touch")
    model = scene.build(envs=24, device=device, precision="float64")
    model["part.position"] = np.column_stack(
        [np.random.default_rng(3).normal(0, 2e-3, (24, 2)), np.full(24, 16e-3)]
    )
    model["part.orientation"] = Rotation.random(24, random_state=4).as_quat()
    wc.Simulation(model, 1e-3, wc.integrators.MoreauJean()).step(600)
    depth = np.zeros(24)
    turns = Rotation.from_quat(model.sensor("part.orientation")).as_matrix()
    for env, (position, turn) in enumerate(zip(model.sensor("part.position"), turns, strict=True)):
        placed = corners @ turn.T + position
        for sector in sectors:
            # Zero is as deep in the Minkowski difference as the solids overlap.
            hull = ConvexHull((sector[:, None] - placed).reshape(-1, 3))
            depth[env] = max(depth[env], -hull.equations[:, 3].max())
    # What impacts leave; without the crossings it is 1.2 % in this run, and up to 39 % in others.
    assert depth.max() < 0.002 * EDGE


@pytest.mark.parametrize("dt", [1e-3, 2e-4])
def test_part_that_pivots_on_the_edge_of_a_hole_gains_no_energy(dt, device):
    """Each side face of its arm crosses an edge of the hole, and is next to the wall of the hole: no room on both sides."""
    # An arm of 140 mm along x, and a leg of 80 mm down into the hole; both are 20 mm thick and 30 mm wide.
    outline = np.array([(0, -0.08), (0.02, -0.08), (0.02, 0), (0.14, 0), (0.14, 0.02), (0, 0.02)])
    corners = np.concatenate([np.insert(outline, 1, y, axis=1) for y in (-0.015, 0.015)])
    side = np.array([(2, 3, 4), (2, 4, 5), (2, 5, 0), (2, 0, 1)])
    i, k = np.arange(6), np.roll(np.arange(6), -1)
    faces = np.concatenate(
        [side, side[:, ::-1] + 6, np.column_stack([k, i, i + 6]), np.column_stack([k, i + 6, k + 6])]
    )
    center = np.array([0.0106 / 0.22, 0.0, -0.0018 / 0.22])  # of the areas 0.14 × 0.02 and 0.02 × 0.08 m²
    mass, inertia = 0.3564, 1e-6 * np.array([[310, 0, -247], [0, 955, 0], [-247, 0, 698]])
    scene = wc.Scene()
    plate = scene.add_surface(ring(0.05, 0.15, 6e-3)[0], name="plate")
    above = np.array([-0.02, 0, 0.011])
    body = scene.add_body(mass, inertia, center + above, name="part")
    part = scene.add_surface(wc.Mesh(corners, faces), body, -center, name="angle")
    scene.add_body_contact(part, plate, rigid(restitution=0.1, mu=0.5), name="touch")
    model = scene.build(device=device, precision="float64")
    run = wc.Simulation(model, dt, wc.integrators.MoreauJean(tolerance=1e-6)).run(
        0.3, ["scene.kinetic_energy"], every=dt
    )
    energy = run["scene.kinetic_energy"].values[:, 0] + 9.81 * mass * run["part.position"].values[:, 0, 2]
    # Displacements lift the part by errors of order h² per step; a fall of 5 mm has 17 mJ.
    assert np.diff(energy).max() < 1e-6
    assert energy[-1] < energy[0]


def test_nuts_on_a_larger_hole_are_not_pushed_by_its_wall(device):
    """Edges of a nut are nearly parallel to edges of the hole inside of them; their common normals point to the wall."""
    envs, rng = 16, np.random.default_rng(3)
    scene = wc.Scene()
    plate = scene.add_surface(ring(0.015, 0.06, 4e-3)[0], name="plate")
    mass = 0.0684
    body = scene.add_body(mass, mass * np.array([1e-4, 1e-4, 1.8e-4]), name="part")
    nut = scene.add_surface(ring(0.01, 0.0173, 6e-3, sides=6)[0], body, name="nut")
    scene.add_body_contact(nut, plate, rigid(restitution=0.1, mu=0.5), name="touch")
    model = scene.build(envs=envs, device=device, precision="float64")
    turns = Rotation.from_euler("xyz", rng.uniform(-12, 12, (envs, 3)), degrees=True)
    model["part.orientation"] = turns.as_quat()
    model["part.position"] = np.column_stack([rng.uniform(-2e-3, 2e-3, (envs, 2)), np.full(envs, 0.016)])
    wc.Simulation(model, 1e-3, wc.integrators.MoreauJean(tolerance=1e-6)).step(1000)
    np.testing.assert_allclose(model.sensor("touch.normal_force"), mass * 9.81, rtol=1e-4)
    # An error of order h² per impact, at up to 0.3 m/s; the nuts overlap the wall by up to 4 mm if they sink.
    assert model.sensor("touch.depth").max() < 1e-5
