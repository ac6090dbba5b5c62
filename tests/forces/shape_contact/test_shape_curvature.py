"""Curvatures of shapes and pairs: differences of the distance, closed forms, and Hertz stiffness."""

import numpy as np
import pytest
import warp as wp
from nonconvex_pairs import Quadric, packed, shape_contacts, signed_distance
from warpcontact.kernels import shapes
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.laws.hertz import elliptic_stiffness, stiffness_per_modulus
from warpcontact.kernels.shapes.base import Curvature, ShapeContactPoint
from warpcontact.kernels.shapes.curvature import PairCurvature, curvature, pair_curvature
from warpcontact.kernels.shapes.pair_dispatch import pair_function
from warpcontact.kernels.shapes.revolution import Torus

S = shapes
INF = np.inf


def curvatures(shape, points, normals, device, u=None):
    """Returns the curvatures at points (n, 3) of a surface with normals (n, 3), in its frame."""
    of_shape = curvature(type(shape))
    P = coefficient_struct(type(shape), wp.float64)

    @wp.kernel(module="unique", enable_backward=False)
    def each(
        p: P, at: wp.array(dtype=wp.vec3d), n: wp.array(dtype=wp.vec3d), u: wp.array(dtype=wp.vec2d),
        out: wp.array(dtype=Curvature),
    ):  # fmt: skip
        i = wp.tid()
        out[i] = of_shape(p, at[i], n[i], u[i][0], u[i][1])

    u = np.zeros((len(points), 2)) if u is None else u
    given = [wp.array(v, dtype=wp.vec3d, device=device) for v in (points, normals)]
    out = wp.zeros(len(points), dtype=Curvature, device=device)
    wp.launch(
        each, len(points), [packed(shape), *given, wp.array(u, dtype=wp.vec2d, device=device), out], device=device
    )
    return out.numpy()


def gradient(shape, points, h=1e-6):
    """Returns the gradient direction of the distance."""
    steps = h * np.eye(3)
    slope = [signed_distance(shape, points + e) - signed_distance(shape, points - e) for e in steps]
    n = np.stack(slope, -1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def surface_points(shape, count=40):
    """Points of a surface and their normals, from random points near it."""
    random = np.random.default_rng(11)
    points = random.normal(size=(count, 3))
    points *= 0.6 / np.linalg.norm(points, axis=1, keepdims=True)
    for _ in range(40):
        points = points - signed_distance(shape, points)[:, None] * gradient(shape, points)
    return points, gradient(shape, points)


SMOOTH = [S.Sphere(0.3), S.Ellipsoid((0.5, 0.3, 0.2)), S.Capsule(0.15, 0.3), Torus(0.5, 0.12)]


@pytest.mark.parametrize("shape", SMOOTH, ids=lambda shape: type(shape).__name__)
def test_curvature_matches_second_difference_of_distance(shape, device):
    points, n = surface_points(shape)
    found = curvatures(shape, points, n, device)
    h = 1e-4
    for k, t in ((found["k_1"], found["direction"]), (found["k_2"], np.cross(n, found["direction"]))):
        np.testing.assert_allclose((t * n).sum(1), 0.0, atol=1e-6)
        both = signed_distance(shape, points + h * t) + signed_distance(shape, points - h * t)
        # Rounding of distances, 1e-16, and normals to 1e-9, over h²; and h² of the fourth derivative, below 1e5.
        np.testing.assert_allclose(both / h**2, k, atol=2e-5 * (1 + np.abs(k).max()))
    assert (found["k_1"] <= found["k_2"]).all()


def test_curvatures_of_faces_edges_and_tips_are_correct(device):
    up, out, slanted = np.array([0, 0, 1.0]), np.array([1.0, 0, 0]), np.array([0.6, 0, 0.8])

    def pair(shape, point, n):
        found = curvatures(shape, np.array([point]), np.array([n]), device)[0]
        return (float(found["k_1"]), float(found["k_2"])), np.abs(found["direction"])

    cylinder, cone, box = S.Cylinder(0.2, 0.3), S.Cone(0.3, 0.4), S.RoundedBox((0.3, 0.2, 0.25), 0.05)
    assert pair(S.Plane(), (1, 2, 0), up)[0] == (0, 0)
    assert pair(cylinder, (0.1, 0, 0.3), up)[0] == (0, 0)
    k, along = pair(cylinder, (0.2, 0, 0.1), out)
    np.testing.assert_allclose(k, (0, 5), atol=1e-15)
    np.testing.assert_allclose(along, up, atol=1e-15)
    # At a circular edge, the curvature is that of its circle in the plane of the normal (Meusnier).
    k, along = pair(cylinder, (0.2, 0, 0.3), slanted)
    np.testing.assert_allclose(k, (0.6 / 0.2, INF))
    np.testing.assert_allclose(along, (0, 1, 0), atol=1e-15)
    # Halfway up a cone of slope 3:4, the normal section has the radius ρ/cos.
    k, along = pair(cone, (0.15, 0, 0.2), (0.8, 0, 0.6))
    np.testing.assert_allclose(k, (0, 0.8 / 0.15), atol=1e-15)
    np.testing.assert_allclose(along, (0.6, 0, 0.8), atol=1e-12)
    assert pair(cone, (0, 0, 0.4), up)[0] == (INF, INF)
    assert pair(cone, (0.1, 0, 0), -up)[0] == (0, 0)
    assert pair(box, (0, 0, 0.25), up)[0] == (0, 0)
    k, along = pair(box, (0.25 + 0.03, 0, 0.2 + 0.04), slanted)
    np.testing.assert_allclose(k, (0, 20), atol=1e-13)
    np.testing.assert_allclose(along, (0, 1, 0))
    corner = np.ones(3) / np.sqrt(3)
    np.testing.assert_allclose(pair(box, (0.28, 0.18, 0.23), corner)[0], (20, 20))
    assert pair(S.RoundedBox((0.3, 0.2, 0.25)), (0.3, 0, 0.25), slanted)[0] == (0, INF)


def test_superellipsoid_curvature_matches_its_equation(device):
    shape = S.Superellipsoid((0.5, 0.4, 0.3), (0.7, 1.3))
    e_1, e_2 = shape.exponents
    random = np.random.default_rng(12)
    points = random.uniform(0.2, 1.0, (20, 3)) * shape.semi_axes

    def inside(p):
        x, y, z = (np.abs(p) / shape.semi_axes).T
        return (x ** (2 / e_2) + y ** (2 / e_2)) ** (e_2 / e_1) + z ** (2 / e_1)

    # The equation is homogeneous of degree 2/e₁ in the size.
    points = points / inside(points)[:, None] ** (e_1 / 2)

    def normal(p, h=1e-6):
        slope = np.stack([inside(p + h * e) - inside(p - h * e) for e in np.eye(3)], -1)
        return slope / np.linalg.norm(slope, axis=1, keepdims=True)

    n = normal(points)
    found = curvatures(shape, points, n, device)
    h = 1e-4
    for k, t in ((found["k_1"], found["direction"]), (found["k_2"], np.cross(n, found["direction"]))):
        turned = normal(points + h * t) - normal(points - h * t)
        np.testing.assert_allclose((turned * t).sum(1) / (2 * h), k, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("exponents", "at_pole", "at_side", "between"),
    [
        # Sections with the exponent 2/e: flat for e < 1, a vertex for e > 1.
        ((1.0, 1.0), (1.2, 1.875), (1.6, 40 / 9), None),
        ((1.0, 0.6), (1.2, 1.875), (0.0, 40 / 9), None),
        ((0.7, 0.6), (0.0, 0.0), (0.0, 0.0), 0.0),
        ((0.7, 1.3), (0.0, 0.0), (0.0, INF), INF),
        ((1.3, 0.6), (INF, INF), (0.0, INF), 0.0),
    ],
)
def test_superellipsoid_curvature_is_continuous_at_symmetry_planes(exponents, at_pole, at_side, between, device):
    a, b, c = 0.5, 0.4, 0.3
    shape = S.Superellipsoid((a, b, c), exponents)

    def one(point, normal):
        found = curvatures(shape, np.array([point], float), np.array([normal], float), device)
        k = np.array([found["k_1"][0], found["k_2"][0]])
        # On an edge, the curvature is large instead of infinite because of rounding.
        return np.where(k > 1e12, INF, k)

    np.testing.assert_allclose(one((0, 0, c), (0, 0, 1)), at_pole, rtol=1e-12)
    np.testing.assert_allclose(one((0, b, 0), (0, 1, 0)), at_side, rtol=1e-12)
    # In the plane x = 0, one principal curvature is that of the section y, z; the other is across it.
    e = exponents[0]
    y = 0.6
    z = (1.0 - y ** (2 / e)) ** (e / 2)
    slope = np.array([y ** (2 / e - 1) / b, z ** (2 / e - 1) / c])
    bend = (2 / e - 1) * np.array([y ** (2 / e - 2) / b**2, z ** (2 / e - 2) / c**2])
    size = np.linalg.norm(slope)
    section = (bend[0] * slope[1] ** 2 + bend[1] * slope[0] ** 2) / size**3
    found = one((0, y * b, z * c), (0, *(slope / size)))
    other = between if between is not None else min(found)
    np.testing.assert_allclose(found, sorted((section, other)), rtol=1e-9)


def test_parametric_surface_curvature_is_correct_for_hollows_and_saddles(device):
    sheet = Quadric(k_x=0.8, k_y=-0.5)
    u = np.array([[0.0, 0.0], [0.5, 0.3]])
    x, y = u.T
    points = np.column_stack([u, 0.5 * (0.8 * x * x - 0.5 * y * y)])
    slope = np.column_stack([-0.8 * x, 0.5 * y, np.ones(2)])
    size = np.linalg.norm(slope, axis=1)
    found = curvatures(sheet, points, slope / size[:, None], device, u)
    # Seen from the concave side the curvature is negative. For z = f(x, y): Gaussian and mean curvature.
    f_x, f_y = 0.8 * x, -0.5 * y
    gauss = 0.8 * -0.5 / size**4
    mean = -((1 + f_y**2) * 0.8 + (1 + f_x**2) * -0.5) / (2 * size**3)
    np.testing.assert_allclose(found["k_1"] * found["k_2"], gauss, rtol=1e-12)
    np.testing.assert_allclose(found["k_1"] + found["k_2"], 2 * mean, rtol=1e-12)
    np.testing.assert_allclose(np.abs(found["direction"][0]), (1, 0, 0), atol=1e-12)


def pair_curvatures(a, b, x, q, device):
    """Returns the contacts of a pair, their curvatures, and K/E* of Hertz contact."""
    of_pair, of_curves = pair_function(type(a), type(b)), pair_curvature(type(a), type(b))
    P_a, P_b = (coefficient_struct(type(s), wp.float64) for s in (a, b))
    contact = shape_contacts(a, b, x, q, device, of_pair)

    @wp.kernel(module="unique", enable_backward=False)
    def each(
        p_a: P_a, p_b: P_b, x: wp.array(dtype=wp.vec3d), q: wp.array(dtype=wp.quatd),
        contact: wp.array(dtype=ShapeContactPoint), out: wp.array(dtype=PairCurvature),
        stiffness: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        i = wp.tid()
        found = of_curves(p_a, p_b, x[i], q[i], contact[i])
        out[i] = found
        stiffness[i] = stiffness_per_modulus(found.relative.k_1, found.relative.k_2)

    out = wp.zeros(len(x), dtype=PairCurvature, device=device)
    stiffness = wp.zeros(len(x), dtype=wp.float64, device=device)
    held = [wp.array(x, dtype=wp.vec3d, device=device), wp.array(q, dtype=wp.quatd, device=device)]
    held.append(wp.array(contact, dtype=ShapeContactPoint, device=device))
    wp.launch(each, len(x), inputs=[packed(a), packed(b), *held, out, stiffness], device=device)
    return contact, out.numpy(), stiffness.numpy()


def test_crossed_cylinder_stiffness_matches_closed_form(device):
    """At an angle φ: A + B = ½ (1/R₁ + 1/R₂), B − A = ½ √(1/R₁² + 1/R₂² + 2 cos 2φ/(R₁ R₂)) (Johnson 4.1)."""
    a, b = S.Cylinder(0.2, 1.0), S.Cylinder(0.5, 1.0)
    angle = np.radians([90.0, 60.0, 30.0, 10.0])
    # Both are horizontal, a across the middle of b: the axis of a is rotated into the horizontal plane of b's
    # frame.
    x = np.tile([0.69, 0.0, 0.0], (4, 1))
    q = np.column_stack([np.sin(angle / 2), 0 * angle, 0 * angle, np.cos(angle / 2)])
    contact, found, stiffness = pair_curvatures(a, b, x, q, device)
    np.testing.assert_allclose(contact["gap"], -0.01, atol=1e-12)
    total, apart = 5.0 + 2.0, np.sqrt(25.0 + 4.0 + 20.0 * np.cos(2 * angle))
    k_1, k_2 = 0.5 * (total - apart), 0.5 * (total + apart)
    np.testing.assert_allclose(found["relative"]["k_1"], k_1, rtol=1e-9)
    np.testing.assert_allclose(found["relative"]["k_2"], k_2, rtol=1e-9)
    exact = [elliptic_stiffness(1.0, 0.0, 1 / p, 1 / s) for p, s in zip(k_1, k_2, strict=True)]
    np.testing.assert_allclose(stiffness, exact, rtol=1e-9)


def test_ellipsoid_tip_stiffness_matches_closed_form(device):
    """Contact of the tips along x: radii b²/a and c²/a of each, rotated against each other by φ."""
    a, b = S.Ellipsoid((0.3, 0.4, 0.2)), S.Ellipsoid((0.5, 0.3, 0.25))
    angle = np.radians([0.0, 25.0, 90.0])
    q = np.column_stack([np.sin(angle / 2), 0 * angle, 0 * angle, np.cos(angle / 2)])
    _, found, stiffness = pair_curvatures(a, b, np.tile([0.79, 0.0, 0.0], (3, 1)), q, device)
    of_a, of_b = (0.3 / np.array([0.16, 0.04]), 0.5 / np.array([0.09, 0.0625]))
    exact = []
    for turn, k in zip(angle, found["relative"], strict=True):
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        low, high = np.linalg.eigvalsh(R @ np.diag(of_a) @ R.T + np.diag(of_b))
        np.testing.assert_allclose((k["k_1"], k["k_2"]), (low, high), rtol=1e-9)
        exact.append(elliptic_stiffness(1.0, 0.0, 1 / low, 1 / high))
    np.testing.assert_allclose(stiffness, exact, rtol=1e-9)
