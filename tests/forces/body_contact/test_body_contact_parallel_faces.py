"""Depth and force of meshes that are not convex, with faces that are parallel up to small angles."""

import numpy as np
import pytest
from part_meshes import l_section
from scipy.spatial.transform import Rotation

import warpcontact as wc

SIDE = 0.03  # m
STIFFNESS = 1e8  # Pa/m


@pytest.mark.parametrize("tilt", [1e-3, 1e-4, 1e-6, 1e-8])
def test_overlap_of_nearly_parallel_faces_is_not_deeper_than_their_distance(tilt, device):
    """A column at an edge of the other solid is not mistaken for one that starts inside it."""
    rng = np.random.default_rng(5)
    envs = 200
    depth = 2e-3 * SIDE
    mesh, _ = l_section(SIDE, SIDE / 3, 0.7 * SIDE)
    scene = wc.Scene(gravity=(0, 0, 0))
    upper = scene.add_body(mass=1.0, inertia=(1, 1, 1), name="upper")
    lower = scene.add_surface(mesh, name="lower")
    law = wc.laws.ElasticFoundation(stiffness=STIFFNESS)
    scene.add_body_contact(scene.add_surface(mesh, upper), lower, wc.ContactMaterial(law=law), name="touch")
    model = scene.build(envs=envs, device=device, precision="float64")
    axis = rng.normal(size=(envs, 3)) * [1, 1, 0]
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    # Turned by multiples of 90°, and displaced along the common plane by a third of the part.
    turn = Rotation.from_rotvec(tilt * axis) * Rotation.from_rotvec(
        [[0, 0, k * np.pi / 2] for k in rng.integers(0, 4, envs)]
    )
    model["upper.orientation"] = turn.as_quat()
    model["upper.position"] = np.c_[rng.uniform(-SIDE / 3, SIDE / 3, (envs, 2)), np.full(envs, 0.7 * SIDE - depth)]
    deepest = depth + tilt * SIDE
    assert model.sensor("touch.depth").max() < 1.01 * deepest
    # At most that of the whole section at the largest depth.
    assert model.sensor("touch.force")[:, 2].max() < STIFFNESS * deepest * SIDE**2 * 5 / 9
