"""Depth of the overlap of two boxes against linear programs: the largest distance of a point of a face inside the other box."""

import numpy as np
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
