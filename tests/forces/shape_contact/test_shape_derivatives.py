"""Derivatives of shape contacts against central differences of the contacts."""

import numpy as np
import pytest
import warp as wp
from nonconvex_pairs import Quadric, inverse_rotation, packed, random_rotations, rotated, shape_contacts
from warpcontact.kernels import shapes
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes import derivatives
from warpcontact.kernels.shapes.base import ShapeContactPoint
from warpcontact.kernels.shapes.curvature import pair_curvature
from warpcontact.kernels.shapes.derivatives import Gradients
from warpcontact.kernels.shapes.pair_dispatch import pair_function
from warpcontact.kernels.shapes.revolution import Torus

S = shapes
COUNT = 12
STEP = 1e-5
PAIRS = [
    (S.Ellipsoid((0.5, 0.3, 0.2)), S.Ellipsoid((0.6, 0.4, 0.3))),
    (S.Sphere(0.3), Torus(0.5, 0.15)),
    (S.Ellipsoid((0.3, 0.2, 0.15)), Quadric(k_x=0.9, k_y=-0.5)),
]


def gradients_of(a, b, x, q, contact, device):
    """Returns the derivatives in the frame of b, with rotations about the origins of the shapes."""
    bent = pair_curvature(type(a), type(b))
    P_a, P_b = (coefficient_struct(type(s), wp.float64) for s in (a, b))

    @wp.kernel(module="unique", enable_backward=False)
    def each(
        p_a: P_a, p_b: P_b, x: wp.array(dtype=wp.vec3d), q: wp.array(dtype=wp.quatd),
        contact: wp.array(dtype=ShapeContactPoint), out: wp.array(dtype=Gradients),
    ):  # fmt: skip
        i = wp.tid()
        m = contact[i]
        k = bent(p_a, p_b, x[i], q[i], m)
        out[i] = derivatives.gradients(m.normal, m.gap, m.point_a, m.point_b, k.a, k.b, x[i], wp.vec3d())

    out = wp.zeros(len(x), dtype=Gradients, device=device)
    given = [wp.array(x, dtype=wp.vec3d, device=device), wp.array(q, dtype=wp.quatd, device=device)]
    held = wp.array(contact, dtype=ShapeContactPoint, device=device)
    wp.launch(each, len(x), inputs=[packed(a), packed(b), *given, held, out], device=device)
    return out.numpy()


def poses(a, b, random):
    """Returns poses near contact, separated and overlapping."""
    q = random_rotations(random, COUNT)
    if isinstance(b, Quadric):
        x = np.column_stack([random.uniform(-0.3, 0.3, (COUNT, 2)), random.uniform(0.1, 0.5, COUNT)])
    else:
        x = random.normal(size=(COUNT, 3))
        x *= random.uniform(0.75, 1.0, (COUNT, 1)) / np.linalg.norm(x, axis=1, keepdims=True)
    return x, q


def turn(axis, angle):
    half = np.zeros(4)
    half[axis], half[3] = np.sin(0.5 * angle), np.cos(0.5 * angle)
    return half


def product(p, q):
    """Quaternion of the rotation q followed by p."""
    return np.concatenate(
        [
            p[3] * q[..., :3] + q[..., 3:] * p[:3] + np.cross(p[:3], q[..., :3]),
            (p[3] * q[..., 3] - q[..., :3] @ p[:3])[:, None],
        ],
        axis=1,
    )


@pytest.mark.parametrize(("a", "b"), PAIRS, ids=lambda shape: type(shape).__name__)
def test_shape_pose_derivatives_match_central_differences(a, b, device):
    random = np.random.default_rng(2)
    x, q = poses(a, b, random)
    of_pair = pair_function(type(a), type(b)) if a.convex and b.convex else None
    # Results are in the frame of b, so they are transformed if b moves: 1 original pose and 24 perturbed ones.
    moved_x, moved_q, b_place, b_turn = [x], [q], [np.zeros(3)], [np.array([0, 0, 0, 1.0])]
    for motion in range(12):
        for sign in (1, -1):
            axis, step = motion % 3, sign * STEP
            at, by = np.zeros(3), np.array([0, 0, 0, 1.0])
            now_x, now_q = x, q
            if motion < 3:
                now_x = x + step * np.eye(3)[axis]
            elif motion < 6:
                now_q = product(turn(axis, step), q)
            elif motion < 9:
                at = step * np.eye(3)[axis]
                now_x = x - at
            else:
                by = turn(axis, step)
                now_x, now_q = rotated(inverse_rotation(by), x), product(inverse_rotation(by), q)
            moved_x.append(now_x), moved_q.append(now_q), b_place.append(at), b_turn.append(by)
    contact = shape_contacts(a, b, np.concatenate(moved_x), np.concatenate(moved_q), device, of_pair)
    assert (contact["status"] == 0).all()
    contact = contact.reshape(25, COUNT)
    exact = gradients_of(a, b, x, q, contact[0], device)
    assert (exact["determined"] == 1).all()
    b_place, b_turn = np.array(b_place)[:, None], np.array(b_turn)[:, None]
    seen = {name: b_place + rotated(b_turn, contact[name]) for name in ("point_a", "point_b")}
    seen["normal"] = rotated(b_turn, contact["normal"])

    def differences(values):
        pairs = values[1:].reshape(12, 2, *values.shape[1:])
        return (pairs[:, 0] - pairs[:, 1]) / (2 * STEP)

    # Errors of differences: of the gap 1e-15 over 2e-5; of the points, which are accurate to about 1e-12; and
    # 1e-10 of the third derivative, which is up to 1/(curvature)² on sharp ends.
    np.testing.assert_allclose(exact["gap"], differences(contact["gap"]).T, atol=1e-8)
    for name, values in seen.items():
        expected = np.moveaxis(differences(values), 0, -1)
        np.testing.assert_allclose(exact[name], expected, atol=2e-6 * np.abs(expected).max(), err_msg=name)


SIZED = [
    S.Sphere(0.3), S.Ellipsoid((0.5, 0.3, 0.2)), S.Capsule(0.1, 0.3), S.Cylinder(0.2, 0.3), S.Cone(0.3, 0.5),
    S.RoundedBox((0.3, 0.2, 0.25), 0.05), Torus(0.5, 0.1),
]  # fmt: skip


@pytest.mark.parametrize("shape", SIZED, ids=lambda shape: type(shape).__name__)
def test_shape_size_derivatives_match_central_differences(shape, device):
    """Contact of a small sphere with the shape; derivatives with respect to the sizes of the shape."""
    random = np.random.default_rng(3)
    x, q = random.normal(size=(COUNT, 3)), random_rotations(random, COUNT)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    ball = S.Sphere(0.1)
    names, outward = derivatives.size_gradient(type(shape))
    P = coefficient_struct(type(shape), wp.float64)
    count = sum(np.size(getattr(shape, name)) for name in names)

    @wp.kernel(module="unique", enable_backward=False)
    def each(p: P, contact: wp.array(dtype=ShapeContactPoint), out: wp.array2d(dtype=wp.float64)):
        i = wp.tid()
        grown = outward(p, contact[i].point_b, contact[i].normal)
        for k in range(wp.static(count)):
            out[i, k] = -grown[k]

    of_pair = pair_function(S.Sphere, type(shape)) if shape.convex else None
    contact = shape_contacts(ball, shape, x, q, device, of_pair)
    out = wp.zeros((COUNT, count), dtype=wp.float64, device=device)
    held = wp.array(contact, dtype=ShapeContactPoint, device=device)
    wp.launch(each, COUNT, inputs=[packed(shape), held, out], device=device)
    expected = []
    for name in names:
        value = np.asarray(getattr(shape, name), dtype=float)
        for k in range(value.size):
            gaps = []
            for sign in (1, -1):
                changed = value.copy().reshape(-1)
                changed[k] += sign * STEP
                other = dict(shape.parameters(), **{name: tuple(changed) if value.ndim else float(changed[0])})
                gaps.append(shape_contacts(ball, type(shape)(**other), x, q, device, of_pair)["gap"])
            expected.append((gaps[0] - gaps[1]) / (2 * STEP))
    np.testing.assert_allclose(out.numpy(), np.transpose(expected), atol=1e-8)


def test_face_on_face_contact_has_undetermined_points(device):
    box, plane = S.RoundedBox((0.3, 0.2, 0.25), 0.05), S.Plane()
    x, q = np.array([[0.0, 0.0, 0.24]]), np.array([[0.0, 0.0, 0.0, 1.0]])
    contact = shape_contacts(box, plane, x, q, device, pair_function(S.RoundedBox, S.Plane))
    found = gradients_of(box, plane, x, q, contact, device)[0]
    np.testing.assert_allclose(found["gap"][:3], (0, 0, 1))
    assert found["determined"] == 0
    assert np.isnan(found["point_a"]).all()
