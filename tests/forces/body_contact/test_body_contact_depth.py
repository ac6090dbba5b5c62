"""Depth of the overlap: that of boxes against linear programs, and continuous on paths of other solids."""

import numpy as np
import pytest
import trimesh
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

import warpcontact as wc

SIDES = np.array([[1.0, 0.6, 0.3], [0.8, 0.5, 0.7]])  # of both boxes [m]
AXES = [(axis, sign) for axis in range(3) for sign in (-1.0, 1.0)]


def planes_of(half_extents, position, rotation):
    """Returns the planes n·x = d of a box as rows (n, d), n outward."""
    normals = np.array([sign * rotation[:, axis] for axis, sign in AXES])
    extents = np.array([half_extents[axis] for axis, _ in AXES])
    return np.c_[normals, normals @ position + extents]


def largest_depth(first, second):
    """Returns the largest distance of a point on a face of a box from the nearest plane of the other one around it [m].

    Args:
        first: Planes of the first box (6, 4).
        second: Planes of the second box.
    """
    found = [0.0]
    for own, other in ((first, second), (second, first)):
        for plane in own:
            # Largest z with a point x of the face: n·x + z ≤ d for the planes of the other box, n·x ≤ d for those of the own one.
            rows = np.r_[np.c_[other[:, :3], np.ones(6)], np.c_[own[:, :3], np.zeros(6)]]
            limits = np.r_[other[:, 3], own[:, 3] + 1e-12]
            solution = linprog(
                [0, 0, 0, -1],
                A_ub=rows,
                b_ub=limits,
                A_eq=[[*plane[:3], 0]],
                b_eq=[plane[3]],
                bounds=[(None, None)] * 3 + [(0, None)],
            )
            if solution.status == 0:
                found.append(-solution.fun)
    return max(found)


def test_depth_of_boxes_is_the_largest_distance_of_a_point_from_the_surface(device):
    """In any orientation, and with nearly parallel faces that overlap in part."""
    envs = 40
    scene = wc.Scene(gravity=(0, 0, 0))
    body = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="upper")
    solids = [
        scene.add_shape(one, wc.shapes.RoundedBox(sides / 2))
        for one, sides in zip((body, None), SIDES, strict=True)
    ]
    law = wc.laws.ElasticFoundation(stiffness=1.0)
    scene.add_body_contact(*solids, wc.ContactMaterial(law=law), name="press")
    model = scene.build(envs=envs, device=device, precision="float64")
    rng = np.random.default_rng(0)
    turns = Rotation.random(envs, random_state=1)
    tilts = Rotation.from_rotvec(0.05 * rng.normal(size=(envs, 3)))
    turns = Rotation.concatenate([turns[: envs // 2], tilts[envs // 2 :]])
    positions = rng.normal(size=(envs, 3)) * 0.35
    # Nearly parallel faces touch with an offset.
    positions[envs // 2 :, 2] = 0.5 * SIDES[:, 2].sum() - rng.uniform(0.0, 0.1, envs - envs // 2)
    model["upper.position"], model["upper.orientation"] = positions, turns.as_quat()
    below = planes_of(SIDES[1] / 2, np.zeros(3), np.eye(3))
    expected = [
        largest_depth(planes_of(SIDES[0] / 2, position, turn), below)
        for position, turn in zip(positions, turns.as_matrix(), strict=True)
    ]
    assert np.count_nonzero(expected) > 0.8 * envs
    # The tolerance of the linear programs.
    np.testing.assert_allclose(model.sensor("press.depth"), expected, atol=1e-7)


#: Pairs of a convex part that is wholly inside a solid of many planes on some of the path, with the seeds of paths.
DEEP_PAIRS = {
    "plate in ball": (trimesh.creation.box((0.5, 0.5, 0.1)), trimesh.creation.icosphere(1, 0.5), 0),
    "box in cylinder": (
        trimesh.creation.box((0.3, 0.3, 0.3)),
        trimesh.creation.cylinder(0.5, 0.5, sections=12),
        0,
    ),
    "box in cone": (trimesh.creation.box((0.3, 0.3, 0.3)), trimesh.creation.cone(0.5, 0.6, sections=10), 1),
}


@pytest.mark.parametrize("parts", DEEP_PAIRS.values(), ids=DEEP_PAIRS)
def test_depth_does_not_jump_where_a_face_enters_a_solid_entirely(parts, device):
    """The largest change in a step becomes as much smaller as the step."""
    *meshes, seed = parts
    steps, divisions = 400, 3
    scene = wc.Scene(gravity=(0, 0, 0))
    rng = np.random.default_rng(seed)
    turns = Rotation.random(2, random_state=rng)
    bodies = [scene.add_body(mass=1.0, inertia=(1, 1, 1), name=name) for name in ("part", "solid")]
    solids = [
        scene.add_surface(wc.Mesh(mesh.vertices, mesh.faces), body)
        for mesh, body in zip(meshes, bodies, strict=True)
    ]
    material = wc.ContactMaterial(law=wc.laws.ElasticFoundation(stiffness=1.0))
    scene.add_body_contact(*solids, material, name="press")
    model = scene.build(envs=steps + 1, device=device, precision="float64")
    model["solid.orientation"] = turns[1].as_quat()
    shift, turn = 0.4 * rng.normal(size=3), rng.uniform(-0.1, 0.1, 3)
    x, found = np.linspace(0.0, 1.0, steps + 1), []
    for _ in range(divisions):
        model["part.position"] = x[:, None] * shift
        model["part.orientation"] = (Rotation.from_rotvec(x[:, None] * turn) * turns[0]).as_quat()
        changes = np.abs(np.diff(model.sensor("press.depth")))
        largest = changes.argmax()
        found.append(changes[largest])
        x = np.linspace(x[largest], x[largest + 1], steps + 1)
    # Samples of slender parts fade while their area grows to 1/100 of the squared perimeter: slopes can be a hundred times steeper there.
    assert 0.0 < found[-1] < 200.0 * found[0] / steps ** (divisions - 1)
