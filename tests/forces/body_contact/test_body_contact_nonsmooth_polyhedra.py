"""Nonsmooth body contact of curved solids with convex meshes: gaps and normals against dense sampling of directions."""

import itertools
from typing import Any

import numpy as np
import warp as wp
from convex_separation import LENGTHS, SIZES, excess
from nonsmooth_scenes import rigid
from polyhedron_separation import PolyhedronSeparation
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

import warpcontact as wc

FORMS = {
    "sphere": wc.shapes.Sphere(SIZES["sphere"]),
    "capsule": wc.shapes.Capsule(*SIZES["capsule"]),
    "cylinder": wc.shapes.Cylinder(*SIZES["cylinder"]),
    "cone": wc.shapes.Cone(*SIZES["cone"]),
    "ellipsoid": wc.shapes.Ellipsoid(SIZES["ellipsoid"]),
}
#: Gaps of the poses, of which the last one is out of reach, and the margin [m].
GAPS, MARGIN = np.array([-5e-3, -2e-3, -2e-4, -1e-5, -1e-7, 1e-5, 2e-4, 8e-4, 5e-3]), 1e-3
#: Distances relative to the size by which faces are preferred to edges, and points of a face may be higher than the lowest one.
BIAS = 1e-3


class Return(wc.Motion):
    """A shake by a few millimetres and degrees for 5 ms, and rest in the initial pose."""

    @wp.func
    def displacement(p: Any, t: Any):
        """Returns the displacement at the time ``t``."""
        size = wp.where(t < wp.float64(0.0055), wp.float64(3e-3) * wp.sin(wp.float64(900.0) * t), wp.float64(0.0))
        return size * wp.vec3d(wp.float64(1.0), wp.float64(-0.7), wp.float64(0.4))

    @wp.func
    def rotation(p: Any, t: Any):
        """Returns the rotation vector at the time ``t``."""
        size = wp.where(t < wp.float64(0.0055), wp.float64(0.05) * wp.sin(wp.float64(700.0) * t), wp.float64(0.0))
        return size * wp.vec3d(wp.float64(0.3), wp.float64(1.0), wp.float64(-0.8))


def hull(points):
    """Returns vertices and faces of the convex hull of points, as a mesh."""
    found = ConvexHull(points)
    faces = found.simplices.copy()
    outward = np.einsum(
        "ij,ij->i",
        np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]),
        found.equations[:, :3],
    )
    faces[outward < 0.0] = faces[outward < 0.0, ::-1]
    used, faces = np.unique(faces, return_inverse=True)
    return wc.Mesh(points[used], faces.reshape(-1, 3))


def convex_meshes():
    """Convex meshes: of many small faces, with an acute edge, with four vertices, and with planes of many triangles."""
    points = np.random.default_rng(1).normal(size=(40, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    angles = 2 * np.pi * np.arange(12) / 12
    drum = [[0.1 * np.cos(a), 0.1 * np.sin(a), z] for z in (-0.08, 0.08) for a in angles]
    wedge = [[x, y, -0.1] for x in (-0.06, 0.06) for y in (-0.1, 0.1)] + [[0, -0.1, 0.15], [0, 0.1, 0.15]]
    tip = [[0, 0, 0.15], [0.15, 0, -0.1], [-0.1, 0.12, -0.1], [-0.1, -0.12, -0.1]]
    return {
        "hull": hull(points * [0.12, 0.1, 0.15]),
        "wedge": hull(np.array(wedge)),
        "tetrahedron": hull(np.array(tip)),
        "drum": hull(np.array(drum)),
    }


def test_gaps_of_curved_solids_on_convex_meshes_are_their_separations(device):
    """Random poses with gaps and overlaps, at rest after a motion in which other faces and edges were the nearest."""
    meshes = convex_meshes()
    references = {name: PolyhedronSeparation(mesh.vertices, mesh.faces) for name, mesh in meshes.items()}
    pairs = list(itertools.product(FORMS, meshes))
    scene = wc.Scene()
    for i, (kind, name) in enumerate(pairs):
        body = scene.add_body(1.0, (0.01,) * 3, name=f"body{i}", motion=Return())
        solid = scene.add_shape(body, FORMS[kind])
        scene.add_body_contact(
            solid, scene.add_surface(meshes[name]), rigid(mu=0.5), name=f"touch{i}", margin=MARGIN
        )
    model = scene.build(envs=len(GAPS), device=device, precision="float64")
    places = []
    for i, (kind, name) in enumerate(pairs):
        turns = Rotation.random(len(GAPS), random_state=i).as_matrix()
        positions = np.random.default_rng(i).normal(size=(len(GAPS), 3))
        for env, turn in enumerate(turns):
            # From far away towards the mesh, along the normal.
            position = 0.6 * positions[env] / np.linalg.norm(positions[env])
            for _ in range(2):
                gap, normal = references[name].largest(kind, position, turn)
                position = position + (GAPS[env] - gap) * normal
            positions[env] = position
        places.append((positions, turns))
        model[f"body{i}.position"] = positions
        model[f"body{i}.orientation"] = Rotation.from_matrix(turns).as_quat()
    wc.Simulation(model, dt=1e-3, integrator=wc.integrators.MoreauJean()).step(9)
    edges = 0
    for i, ((kind, name), (positions, turns)) in enumerate(zip(pairs, places, strict=True)):
        reference = references[name]
        gaps, points = model.sensor(f"touch{i}.point_gap"), model.sensor(f"touch{i}.point")
        normals = model.sensor(f"touch{i}.normal")
        bias = BIAS * min(LENGTHS[kind], np.ptp(meshes[name].vertices, axis=0).max())
        for env, (position, turn) in enumerate(zip(positions, turns, strict=True)):
            case = f"{kind} {name} {env}"
            largest, normal = reference.largest(kind, position, turn)
            if largest > MARGIN:
                # Points of a face may be within its margin although an edge separates both by more.
                assert not (gaps[env] < 0.0).any(), case
                continue
            assert not np.isnan(gaps[env]).all(), case
            deepest = np.nanargmin(gaps[env])
            gap, point = gaps[env, deepest], points[env, deepest]
            # No direction has a larger separation; the samples find it to 1e-6 m where an arc crosses a circle of normals.
            assert largest - bias - 1e-10 < gap < largest + bias + 1e-10, case
            if largest > reference.of_faces(kind, position, turn)[0] + bias:
                edges += 1
                assert -1e-10 < gap - largest < 1e-6, case
                if gap < 0.0:
                    along = reference.along(kind, position, turn, normals[env][None])[0]
                    np.testing.assert_allclose(along, gap, atol=1e-10, err_msg=case)
                    # The curved solid touches the point, which is in the middle of the overlap.
                    on_curved = turn.T @ (point + 0.5 * gap * normals[env] - position)
                    assert abs(excess(kind, on_curved)) < 1e-7, case
    # Most poses at random are edges or vertices on a curved surface.
    assert edges > len(pairs) * len(GAPS) / 4
