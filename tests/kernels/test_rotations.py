"""Rotations on the host and in kernels."""

import numpy as np
import pytest
import warp as wp
from scenes import square
from warpcontact.kernels import rotations

import warpcontact as wc
from warpcontact.algebra.vectors import shortest_rotations, transform_points


@pytest.mark.parametrize("start", np.eye(3), ids=("x", "y", "z"))
def test_shortest_rotations_reach_every_direction_without_twist(start):
    directions = np.random.default_rng(0).normal(size=(5, 10, 3))
    directions[0, :3] = start, -start, -start + 1e-7 * np.roll(start, 1)
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    found = shortest_rotations(start, directions)
    reached = transform_points(np.broadcast_to(start, (5, 10, 1, 3)), np.zeros((5, 10, 3)), found)[..., 0, :]
    # Near the opposite direction, 1 + dot is 1e-14 with two digits; its root is the rounding error.
    np.testing.assert_allclose(reached, directions, atol=1e-6)
    np.testing.assert_allclose(reached.reshape(-1, 3)[3:], directions.reshape(-1, 3)[3:], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1.0, rtol=1e-12)
    np.testing.assert_allclose(found[..., :3] @ start, 0.0, atol=1e-12)
    # The angle is the smaller one between both directions.
    cosines = directions @ start
    np.testing.assert_allclose(2.0 * found[..., 3] ** 2 - 1.0, cosines, atol=1e-12)
    assert (found[..., 3] >= 0.0).all()


def test_shortest_rotation_is_unique_for_opposite_directions():
    np.testing.assert_array_equal(shortest_rotations((1.0, 0.0, 0.0), np.array([-1.0, 0.0, 0.0])), [0, 1, 0, 0])
    np.testing.assert_array_equal(shortest_rotations((1.0, 0.0, 0.0), np.array([1.0, 0.0, 0.0])), [0, 0, 0, 1])


@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_rotation_matrix_matches_quaternion_of_any_length(real, device):
    """To rounding, so that points placed with one are found with the other."""
    kind = wp.dtype_from_numpy(real)
    quat, vec3 = (wp.quatf, wp.vec3f) if real is np.float32 else (wp.quatd, wp.vec3d)
    matrix = rotations.functions(kind).matrix

    @wp.kernel(module="unique", enable_backward=False)
    def rotate(q: wp.array(dtype=quat), v: wp.array(dtype=vec3), by: wp.array2d(dtype=vec3)):
        i = wp.tid()
        by[0, i] = wp.quat_rotate(q[i], v[i])
        by[1, i] = matrix(q[i]) * v[i]

    rng = np.random.default_rng(6)
    q, v = rng.normal(size=(1000, 4)), rng.normal(size=(1000, 3))
    q *= rng.uniform(0.5, 1.5, (1000, 1)) / np.linalg.norm(q, axis=1, keepdims=True)
    by = wp.zeros((2, 1000), dtype=vec3, device=device)
    wp.launch(
        rotate, 1000, [wp.array(q, quat, device=device), wp.array(v, vec3, device=device), by], device=device
    )
    # Terms of up to 2 |q|² |v| ≈ 20 are rounded a few times.
    left, right = by.numpy()
    np.testing.assert_allclose(left, right, rtol=0, atol=100.0 * np.finfo(real).eps)


@pytest.mark.parametrize("cached", [True, False], ids=["cached", "uncached"])
@pytest.mark.parametrize("excess", [1e-4, -1e-3])
def test_contact_of_body_with_unnormalized_quaternion_is_at_its_position(excess, cached, device):
    """A point 0.5 m off a body that is rotated by 180° about z reaches x = 0 at 1 m/s, after 0.1 m."""
    scene = wc.Scene(gravity=(0, 0, 0))
    wall = scene.add_surface(square(half=5.0), orientation=(0, np.sqrt(0.5), 0, np.sqrt(0.5)), name="wall")
    body = scene.add_body(
        mass=1.0, inertia=(1, 1, 1), position=(0.6, 0, 0.3), linear_velocity=(-1, 0, 0), name="body"
    )
    points = scene.add_point(body, (0.5, 0, 0), name="point")
    scene.add_contact(points, wall, wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e3)), name="touch")
    model = scene.build(device=device)
    sim = wc.Simulation(model, dt=1e-4, distance_cache=cached)
    model.state.body_orientation.assign(np.array([[[0.0, 0.0, 1.0 + excess, 0.0]]], np.float32))
    sim.step(998)
    assert model.sensor("touch.normal_force")[0] == 0.0
    sim.step(6)
    # The accumulated rounding of the position is below the displacement of one step, 0.1 mm.
    assert model.sensor("touch.normal_force")[0] > 0.0
