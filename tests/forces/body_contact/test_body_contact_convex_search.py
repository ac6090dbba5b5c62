"""References of nonsmooth body contact of convex meshes, against separations along all normals of their planes and edges.

Also of curved solids deep inside convex meshes, against those along all normals of planes and flat ends.
"""

from typing import Any

import numpy as np
import pytest
import trimesh
import warp as wp
from convex_separation import LENGTHS, SIZES
from facets import Convex, separations_along, separations_of_edges, separations_of_planes
from nonsmooth_scenes import rigid
from polyhedron_separation import PolyhedronSeparation
from scipy.spatial.transform import Rotation

import warpcontact as wc

#: Margin, advantage of the previous face, and of faces over edges, relative to the size.
MARGIN, HYSTERESIS, BIAS = 1e-3, 2e-4, 1e-3


class Still(wc.Motion):
    """No motion under any forces."""

    @wp.func
    def displacement(p: Any, t: Any):
        """Returns the displacement at the time ``t``."""
        return wp.vec3d()


def hull(points):
    """Returns the mesh of the hull of points, (count, 3)."""
    found = trimesh.convex.convex_hull(np.asarray(points, dtype=float))
    return wc.Mesh(found.vertices, found.faces)


def cloud(count, seed, scale=(1.0, 1.0, 1.0)):
    """Returns the hull of random points in a ball, stretched along the axes."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    points *= rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(points, axis=1, keepdims=True)
    return hull(points * scale)


def barrel(count, rings):
    """Returns a barrel about z with flat ends of ``count`` vertices."""
    angles = 2 * np.pi * np.arange(count) / count
    points = [
        (r * np.cos(a), r * np.sin(a), z)
        for z, r in ((z, 0.6 * (1 - 0.3 * abs(z) ** 3)) for z in np.linspace(-1, 1, rings))
        for a in angles
    ]
    return hull(points)


def grid_box(sizes):
    """Returns a box whose faces consist of 8 coplanar triangles each."""
    box = trimesh.creation.box(sizes).subdivide()
    return wc.Mesh(box.vertices, box.faces)


def rounded(count, seed):
    """Returns the hull of random points on a sphere."""
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return hull(points / np.linalg.norm(points, axis=1, keepdims=True))


def scaled(mesh, factor):
    """Returns a mesh ``factor`` times as large."""
    return wc.Mesh(factor * np.asarray(mesh.vertices), mesh.faces)


#: Pairs of convex meshes; sizes from 10⁻³ to 10³ m.
PAIRS = {
    "hulls": (cloud(20, 0), cloud(20, 1)),
    "millimetre hulls": (scaled(cloud(16, 2), 1e-3), scaled(cloud(24, 3), 2e-3)),
    "kilometre hulls": (scaled(cloud(20, 4), 1e3), scaled(cloud(12, 5), 5e2)),
    "barrels": (barrel(9, 4), barrel(8, 3)),
    "barrel and box": (scaled(barrel(12, 5), 0.05), wc.meshes.box((0.1, 0.08, 0.06))),
    "boxes": (wc.meshes.box((1, 2, 3)), grid_box((2, 1, 1))),
    "plates": (cloud(24, 6, (1, 1, 0.01)), grid_box((2, 2, 0.02))),
    "needles": (cloud(24, 7, (0.02, 0.02, 1)), cloud(16, 8, (0.01, 0.01, 1))),
    "needle and plate": (barrel(6, 2), cloud(20, 9, (1, 0.6, 0.03))),
    "small on large": (scaled(cloud(20, 10), 0.01), cloud(24, 11)),
    "prisms": (barrel(7, 2), barrel(11, 2)),
    "rounded": (rounded(40, 12), rounded(30, 13)),
    "tetrahedra": (cloud(4, 14), cloud(4, 15)),
}
#: Depths of the features that face each other, relative to the smaller size.
DEPTHS = (-9e-4, -5e-4, -1e-5, 0.0, 1e-9, 1e-6, 1e-4, 3e-3, 0.03, 0.1, 0.4, 1.0)
#: Angles by which features are turned from facing each other.
TURNS = (0.0, 1e-10, 1e-7, 1e-4, 1e-2, 0.3)


def feature_of(solid, rng):
    """Returns a point of a vertex, edge or plane of a ``Convex``, and an outward normal there."""
    kind = rng.integers(3)
    if kind == 0:
        vertex = rng.integers(len(solid.vertices))
        beside = solid.beside[(solid.edges == vertex).any(axis=1)].reshape(-1, 3)
        normal = rng.dirichlet(np.ones(len(beside))) @ beside
        point = solid.vertices[vertex]
    elif kind == 1:
        edge = rng.integers(len(solid.edges))
        normal = rng.dirichlet(np.ones(2)) @ solid.beside[edge]
        point = rng.dirichlet(np.ones(2)) @ solid.vertices[solid.edges[edge]]
    else:
        normal = solid.planes[rng.integers(len(solid.planes))]
        height = solid.vertices @ normal
        corners = solid.vertices[height > height.max() - 1e-9 * solid.size]
        point = rng.dirichlet(np.ones(len(corners))) @ corners
    return point, normal / np.linalg.norm(normal)


def random_pose(first, second, depth, rng):
    """Returns a pose of the first solid with features of both facing each other: position (3,) and a ``Rotation``."""
    point_1, normal_1 = feature_of(first, rng)
    point_2, normal_2 = feature_of(second, rng)
    turn = Rotation.align_vectors(-normal_2[None], normal_1[None])[0]
    turn = Rotation.from_rotvec(rng.uniform(0, 2 * np.pi) * normal_2) * turn
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(rng.choice(TURNS) * axis / np.linalg.norm(axis)) * turn
    return point_2 - depth * normal_2 - turn.apply(point_1), turn


def test_reference_has_the_largest_separation_of_all_planes_and_edges(device):
    """At first without a previous step, then with a previous step in another pose."""
    envs, rounds = 24, 2
    scene = wc.Scene(gravity=(0, 0, 0))
    solids, contacts = [], []
    for i, (one, other) in enumerate(PAIRS.values()):
        body = scene.add_body(1.0, (1, 1, 1), name=f"body{i}", motion=Still())
        first, second = scene.add_surface(one, body), scene.add_surface(other)
        contacts.append(scene.add_body_contact(first, second, rigid(), name=f"touch{i}"))
        solids.append((Convex(one.vertices), Convex(other.vertices)))
    model = scene.build(envs=envs, device=device, precision="float64")
    sim = wc.Simulation(model, dt=1e-12, integrator=wc.integrators.MoreauJean())
    [manifolds] = [found for found, _, _ in model.nonsmooth._manifold_sets.values()]
    geometries = manifolds.body_contacts.tables.geometries
    plane_normals = geometries.normal.numpy()[geometries.plane_face.numpy()]
    rng = np.random.default_rng(0)
    edges_found = faces_found = 0
    for number in range(rounds):
        places = []
        for i, (first, second) in enumerate(solids):
            depths = rng.choice(DEPTHS, envs) * min(first.size, second.size)
            poses = [random_pose(first, second, depth, rng) for depth in depths]
            places.append([(position, turn.as_matrix()) for position, turn in poses])
            model[f"body{i}.position"] = [position for position, _ in poses]
            model[f"body{i}.orientation"] = [turn.as_quat() for _, turn in poses]
        sim.step(1)
        history, points = manifolds.history, manifolds.points
        codes, counts = history.reference.numpy(), history.count.numpy()
        gaps, normals = points.gap.numpy(), points.normal.numpy()
        for i, (first, second) in enumerate(solids):
            pairs, slots = manifolds.contacts[contacts[i]]
            size = min(first.size, second.size)
            rounding = 1e-11 * max(first.size, second.size)
            bias = BIAS * size
            hysteresis = HYSTERESIS * size
            for env, (position, rotation) in enumerate(places[i]):
                case = f"{list(PAIRS)[i]}, round {number}, environment {env}"
                planes, _ = separations_of_planes(first, second, position, rotation)
                edges, _ = separations_of_edges(first, second, position, rotation)
                largest_plane = planes.max()
                largest = max(largest_plane, edges.max(initial=-np.inf))
                code, count = codes[env, pairs.start], counts[env, pairs.start]
                if largest > MARGIN * size + rounding:
                    assert count == 0, case
                    continue
                if largest < -1e-9 * size:
                    assert count > 0, case
                placed = first.vertices @ rotation.T + position
                if code > 0:
                    # A plane of the second solid, or of the first one.
                    normal = plane_normals[(code - 1) // 2]
                    if (code - 1) % 2 == 1:
                        normal = -rotation @ normal
                    found = separations_along(placed, second.vertices, normal[None])[0]
                    assert found >= largest_plane - hysteresis - rounding, case
                    assert largest <= found + bias + hysteresis + rounding, case
                    faces_found += 1
                else:
                    own = gaps[env, slots]
                    point = np.nanargmin(own)
                    normal = normals[env, slots][point]
                    found = separations_along(placed, second.vertices, normal[None])[0]
                    assert found >= largest - hysteresis - rounding, case
                    assert own[point] == pytest.approx(found, abs=rounding), case
                    edges_found += 1
    assert edges_found > 70
    assert faces_found > 300


#: Curved solids with the sizes of ``SIZES``, and convex meshes in which they are, or of about their size.
CURVED = {
    "sphere": wc.shapes.Sphere(SIZES["sphere"]),
    "capsule": wc.shapes.Capsule(*SIZES["capsule"]),
    "cylinder": wc.shapes.Cylinder(*SIZES["cylinder"]),
    "cone": wc.shapes.Cone(*SIZES["cone"]),
    "ellipsoid": wc.shapes.Ellipsoid(SIZES["ellipsoid"]),
}
AROUND = {
    "hull": cloud(40, 20),
    "plate": cloud(60, 21, (1, 1, 0.1)),
    "needle": cloud(60, 22, (0.05, 0.08, 1)),
    "barrel": barrel(12, 6),
    "rounded": rounded(120, 23),
    "box": wc.meshes.box((0.3, 0.5, 0.2)),
    "small hull": cloud(14, 24, (0.12, 0.1, 0.15)),
}


def test_deep_curved_solid_has_the_largest_separation_of_all_planes(device):
    """At first without a previous step, then with a previous step in another pose."""
    envs, rounds = 24, 2
    scene = wc.Scene(gravity=(0, 0, 0))
    pairs = [(kind, name) for kind in CURVED for name in AROUND]
    contacts = []
    for i, (kind, name) in enumerate(pairs):
        body = scene.add_body(1.0, (1, 1, 1), name=f"body{i}", motion=Still())
        solids = scene.add_shape(body, CURVED[kind]), scene.add_surface(AROUND[name])
        contacts.append(scene.add_body_contact(*solids, rigid(), name=f"touch{i}"))
    model = scene.build(envs=envs, device=device, precision="float64")
    sim = wc.Simulation(model, dt=1e-12, integrator=wc.integrators.MoreauJean())
    [manifolds] = [found for found, _, _ in model.nonsmooth._manifold_sets.values()]
    references = {name: PolyhedronSeparation(mesh.vertices, mesh.faces) for name, mesh in AROUND.items()}
    rng = np.random.default_rng(1)
    for number in range(rounds):
        places = []
        for i, (_, name) in enumerate(pairs):
            # Any points inside the mesh, most of them far from its vertices.
            vertices = references[name].vertices
            positions = rng.dirichlet(np.full(len(vertices), 0.1), envs) @ vertices
            turns = Rotation.random(envs, random_state=rng)
            places.append((positions, turns.as_matrix()))
            model[f"body{i}.position"] = positions
            model[f"body{i}.orientation"] = turns.as_quat()
        sim.step(1)
        gaps, normals = manifolds.points.gap.numpy(), manifolds.points.normal.numpy()
        for i, (kind, name) in enumerate(pairs):
            slots = manifolds.contacts[contacts[i]][1]
            reference = references[name]
            size = min(LENGTHS[kind], np.ptp(reference.vertices, axis=0).max())
            for env, (position, rotation) in enumerate(zip(*places[i], strict=True)):
                case = f"{kind} in {name}, round {number}, environment {env}"
                own = gaps[env, slots]
                assert not np.isnan(own).all(), case
                deepest = np.nanargmin(own)
                found = reference.along(kind, position, rotation, normals[env, slots][deepest][None])[0]
                # Faces whose separations differ by up to 10⁻⁶ of the size have points, too.
                assert found > reference.of_faces(kind, position, rotation)[0] - 2e-6 * size, case
                # Points above a face may be higher than the lowest one.
                assert -1e-10 < own[deepest] - found < BIAS * size + 1e-10, case
