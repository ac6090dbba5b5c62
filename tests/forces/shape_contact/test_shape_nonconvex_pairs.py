"""Tori and parametric surfaces against dense sampling in NumPy, with random poses from deep overlap to large gaps."""

from typing import Any

import numpy as np
import pytest
import warp as wp
from case_marks import slow_except
from nonconvex_pairs import (
    Quadric,
    inverse_rotation,
    packed,
    random_rotations,
    rotated,
    shape_contacts,
    signed_distance,
)
from scipy.spatial import cKDTree
from warpcontact.kernels import shapes
from warpcontact.kernels.catalogue.device_model import coefficient_struct, parameter
from warpcontact.kernels.shapes import pair_dispatch
from warpcontact.kernels.shapes import signed_distance as nearest
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface, parametric_jet
from warpcontact.kernels.shapes.revolution import Torus
from warpcontact.kernels.types import MET, NOT_CONVERGED, OUTSIDE

import warpcontact as wc

S = shapes
RING = Torus(major_radius=0.5, minor_radius=0.12)
SOLIDS = [
    S.Sphere(0.3), S.Plane(), S.Ellipsoid((0.5, 0.3, 0.2)), S.Capsule(0.15, 0.3), S.Cylinder(0.25, 0.3),
    S.RoundedBox((0.3, 0.25, 0.2), 0.05), S.Cone(0.3, 0.6), Torus(0.4, 0.1),
]  # fmt: skip
# Bodies in which the core circle of a torus can be equally near to two exits.
PIERCED = (S.Ellipsoid, S.Cylinder, S.RoundedBox, S.Cone)
names = {"ids": lambda shape: type(shape).__name__}


def check_facing(contact, a, b, x, q, tolerance=1e-9):
    """Points lie on the surfaces, on a line along the normal, and the gap apart."""
    n, gap = contact["normal"], contact["gap"]
    np.testing.assert_allclose(contact["point_a"] - contact["point_b"], gap[:, None] * n, atol=tolerance)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, atol=1e-12)
    for shape, points, outward in (
        (a, rotated(inverse_rotation(q), contact["point_a"] - x), rotated(inverse_rotation(q), -n)),
        (b, contact["point_b"], n),
    ):
        np.testing.assert_allclose(signed_distance(shape, points), 0.0, atol=tolerance)
        # The distance grows at rate 1 along the outward normal, also at an edge.
        outside = signed_distance(shape, points + 1e-6 * outward)
        np.testing.assert_allclose(outside, 1e-6, atol=1e-11)


def ring_case(other, count, seed, angles=600):
    random = np.random.default_rng(seed)
    q, x = random_rotations(random, count), random.normal(size=(count, 3))
    # The tube is 0.24 thick: gaps from −60 % of that to large, and some that are deeper.
    x *= random.uniform(0.0, 1.8, (count, 1)) / np.linalg.norm(x, axis=1, keepdims=True)
    angle = np.linspace(0, 2 * np.pi, angles, endpoint=False)
    circle = RING.major_radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    least = np.concatenate(
        [
            signed_distance(other, x[k : k + 500, None] + rotated(q[k : k + 500, None], circle)).min(1)
            for k in range(0, count, 500)
        ]
    )
    return x, q, least - RING.minor_radius


def check_ring(other, count, seed, device, angles=600):
    x, q, least = ring_case(other, count, seed, angles)
    contact = shape_contacts(RING, other, x, q, device)
    gap = contact["gap"]
    thick = 2 * RING.minor_radius
    wanted = (least > -0.6 * thick) & (least < 2.0 * thick)
    assert wanted.sum() > 0.15 * count
    # No sample is lower than the result, except for rounding. The result is a point of the circle, so it exceeds
    # the smallest sample by at most the sampling error: half a step of R at the kink of a cone's tip.
    good = contact["status"] == MET
    assert (gap[good] <= least[good] + 1e-11).all()
    smooth = good & (least > RING.minor_radius * -0.9)
    step = RING.major_radius * np.pi / angles
    assert (gap[smooth] >= least[smooth] - step).all()
    check_facing(contact[good], RING, other, x[good], q[good])
    # All are solved unless the core circle is in the body.
    return (~good & (contact["gap"] > -RING.minor_radius)).sum()


@pytest.mark.parametrize(
    "other",
    slow_except(SOLIDS, lambda shape: type(shape) in (S.Cylinder, S.Ellipsoid)),
    **names,
)
def test_torus_contact_is_at_the_deepest_point_of_its_core_circle(other, device):
    assert check_ring(other, 1000, 4, device) == 0


@pytest.mark.parametrize(
    "other",
    slow_except([shape for shape in SOLIDS if type(shape) in PIERCED], lambda shape: type(shape) is S.Cylinder),
    **names,
)
def test_torus_is_not_converged_if_two_exits_of_its_core_circle_are_equally_near(other, device):
    x, q, least = ring_case(other, 2000, 11)
    contact = shape_contacts(RING, other, x, q, device)
    flagged = contact["status"] == NOT_CONVERGED
    assert 0.02 < flagged.mean() < 0.2
    # The core circle is in the body, and its deepest point has no exit across the tube.
    assert (contact["gap"][flagged] < -RING.minor_radius).all()
    assert (contact["residual"][flagged] > 1e-6).all()
    good = ~flagged
    check_facing(contact[good], RING, other, x[good], q[good])
    np.testing.assert_allclose(contact["gap"][good], least[good], atol=RING.major_radius * np.pi / 600)


def test_contact_of_a_torus_in_deep_overlap_is_reported_and_exerts_no_force(device):
    """The core circle passes along the diagonal of a box: the two sides of the edge are equally near."""
    scene = wc.Scene(gravity=(0.0, 0.0, 0.0))
    material = wc.ContactMaterial(law=wc.laws.KelvinVoigt(stiffness=1e5, damping=10.0))
    ring = scene.add_body(1.0, (0.1, 0.1, 0.2), position=(-0.5, 0.0, 0.0), name="ring")
    tube = scene.add_shape(ring, RING, name="tube")
    half = np.pi / 8
    box = scene.add_shape(
        None, S.RoundedBox((0.3, 0.3, 0.3), 0.0), orientation=(0.0, 0.0, np.sin(half), np.cos(half)), name="box"
    )
    scene.add_shape_contact(tube, box, material, name="pierced")
    model = scene.build(device=device)
    with pytest.warns(wc.RunWarning, match="'tube' and 'box' did not converge"):
        wc.Simulation(model, dt=1e-4).run(1e-3, [], progress=False)
    assert model.sensor("pierced.status")[0] == wc.ContactStatus.NOT_CONVERGED
    assert model.sensor("pierced.failures")[0] == 10
    np.testing.assert_array_equal(model.sensor("ring.position")[0], (-0.5, 0.0, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize("other", SOLIDS, **names)
def test_torus_contact_is_correct_for_many_random_pairs(other, times, device):
    """20 000, or 100 000 with --thorough."""
    assert check_ring(other, 20_000 * times, 5, device, angles=150) == 0


def sizes(kind, random):
    """A body with sizes from 0.1 to 2 times the radius of the ring."""
    size = lambda: RING.major_radius * np.exp(random.uniform(np.log(0.1), np.log(2.0)))  # noqa: E731
    if kind in (S.Ellipsoid, S.RoundedBox):
        half = (size(), size(), size())
        return S.Ellipsoid(half) if kind is S.Ellipsoid else S.RoundedBox(half, 0.3 * random.random() * min(half))
    return kind(size(), size())


@pytest.mark.slow
@pytest.mark.parametrize("kind", PIERCED, ids=lambda kind: kind.__name__)
def test_torus_contact_is_correct_for_bodies_of_any_size(kind, times, device):
    """Also plates and rods wider than the ring, from separated to almost centered in it."""
    random = np.random.default_rng(12)
    missed = 0
    for seed in range(4 * times):
        other = sizes(kind, random)
        x, q, least = ring_case(other, 5000, seed, angles=20)
        contact = shape_contacts(RING, other, x, q, device)
        good = contact["status"] == MET
        missed += (~good & (contact["gap"] > -RING.minor_radius)).sum()
        # The gap is at most that of every sample of the circle.
        assert (contact["gap"][good] <= least[good] + 1e-9).all()
        check_facing(contact[good], RING, other, x[good], q[good])
    assert missed == 0


@pytest.mark.parametrize("axes", [(0.5, 0.3, 0.2), (0.54, 0.09, 0.06), (0.2, 0.5, 0.5), (0.5, 0.2, 0.2)])
def test_distance_from_ellipsoid_center_is_continuous(axes, device):
    """Distances change by no more than the displacement, also if a component is below rounding."""
    random = np.random.default_rng(13)
    body = S.Ellipsoid(axes)
    far = random.uniform(-1.0, 1.0, (20_000, 3)) * axes
    near = 10.0 ** random.uniform(-20.0, -9.0, far.shape)
    off = random.random(far.shape) < 0.5
    x = np.where(off, near, far)
    of_place, P = nearest.signed_distance(S.Ellipsoid), coefficient_struct(S.Ellipsoid, wp.float64)

    @wp.kernel(module="unique", enable_backward=False)
    def each(p: P, x: wp.array(dtype=wp.vec3d), gap: wp.array(dtype=wp.float64)):
        i = wp.tid()
        gap[i] = of_place(p, x[i]).gap

    gap = wp.zeros(len(x), dtype=wp.float64, device=device)
    wp.launch(each, len(x), inputs=[packed(body), wp.array(x, dtype=wp.vec3d, device=device), gap], device=device)
    # Next to the center, the reference is bisection.
    np.testing.assert_allclose(gap.numpy(), signed_distance(body, np.where(off, 1e-9, far)), atol=4e-9)


@pytest.mark.parametrize("passing", [1e-2, 1e-5, 1e-8, 1e-10, 1e-12, 1e-15, 0.0])
def test_tori_with_nearly_crossing_core_circles_contact_there(passing, device):
    """The gap is the distance of the circles minus both tube radii, for any crossing angle."""
    random = np.random.default_rng(3)
    count, other = 2000, Torus(0.4, 0.1)
    q = random_rotations(random, count)
    a, b = random.uniform(0, 2 * np.pi, (2, count))
    circle = lambda angle: np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)  # noqa: E731
    along = np.cross(rotated(q, circle(a + np.pi / 2)), circle(b + np.pi / 2))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    x = other.major_radius * circle(b) + passing * along - RING.major_radius * rotated(q, circle(a))
    contact = shape_contacts(RING, other, x, q, device)
    assert (contact["status"] == MET).all()
    least = passing - RING.minor_radius - other.minor_radius
    # Some circles also cross elsewhere, with a smaller gap.
    assert (contact["gap"] <= least + 1e-14).all()
    there = np.abs(contact["gap"] - least) < 1e-14
    assert there.mean() > 0.9
    # The normal is across both circles, towards the ring; at an exact crossing both signs are valid. Some cross
    # twice, or at a small angle at which rounding rotates the normal.
    to_side = np.einsum("pk,pk->p", contact["normal"], along)[there]
    to_side = to_side if passing > 1e-14 else np.abs(to_side)
    assert (to_side > 1 - 1e-9).mean() > 0.99


@pytest.mark.parametrize(("x", "turned"), [((0.3, 0.0, 0.0), 0.0), ((0.9, 0.0, 0.0), 90.0)])
def test_tori_with_crossing_core_circles_separate_across_both(x, turned, device):
    """Tori flat on each other separate across their plane. Upright tori in contact from outside meet end to end."""
    half = np.radians(turned) / 2
    q = np.array([[np.sin(half), 0.0, 0.0, np.cos(half)]])
    contact = shape_contacts(RING, Torus(0.4, 0.1), np.array([x]), q, device)[0]
    assert contact["status"] == MET
    np.testing.assert_allclose(contact["gap"], -0.22, atol=1e-14)
    across = [0.0, 0.0, 1.0] if turned == 0.0 else [1.0, 0.0, 0.0]
    np.testing.assert_allclose(np.abs(contact["normal"]), across, atol=1e-7)


def test_torus_contact_is_symmetric_in_the_pair(device):
    x, q, _ = ring_case(SOLIDS[2], 100, 6)
    one = shape_contacts(RING, SOLIDS[2], x, q, device)
    other = shape_contacts(SOLIDS[2], RING, rotated(inverse_rotation(q), -x), inverse_rotation(q), device)
    np.testing.assert_array_equal(other["status"], one["status"])
    good = one["status"] == MET
    assert good.mean() > 0.9
    x, q, one, other = x[good], q[good], one[good], other[good]
    np.testing.assert_allclose(other["gap"], one["gap"], atol=1e-12)
    np.testing.assert_allclose(rotated(q, other["point_a"]) + x, one["point_b"], atol=1e-9)
    np.testing.assert_allclose(rotated(q, other["normal"]), -one["normal"], atol=1e-9)


def test_sphere_inside_torus_hole_has_correct_gap(device):
    """The sphere fits and touches the inner side all around: the gap is R − r − its radius, not that of the hull."""
    contact = shape_contacts(S.Sphere(0.3), RING, np.array([[0.0, 0.0, 0.0]]), np.array([[0, 0, 0, 1.0]]), device)[
        0
    ]
    np.testing.assert_allclose(contact["gap"], 0.5 - 0.12 - 0.3, atol=1e-15)


def test_linked_tori_contact_at_their_core_circles(device):
    """Two circles of radius 0.5, linked like a chain: each through the center of the other, 0.5 apart."""
    q = np.array([[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]])
    contact = shape_contacts(RING, RING, np.array([[0.5, 0.0, 0.0]]), q, device)[0]
    np.testing.assert_allclose(contact["gap"], 0.5 - 2 * 0.12, atol=1e-12)


# Parametric surfaces

SHEETS = {
    "bowl": Quadric(k_x=1.2, k_y=0.8), "dome": Quadric(k_x=-0.8, k_y=-0.5), "saddle": Quadric(k_x=0.7, k_y=-0.6),
}  # fmt: skip
BODIES = [
    S.Ellipsoid((0.35, 0.25, 0.2)),
    S.RoundedBox((0.2, 0.15, 0.25), 0.05),
    S.Cylinder(0.2, 0.2),
    Torus(0.25, 0.08),
]


def height(sheet, x, y):
    return 0.5 * (sheet.k_x * x * x + sheet.k_y * y * y)


def sheet_case(sheet, count, seed):
    random = np.random.default_rng(seed)
    at = random.uniform(-0.5, 0.5, (count, 2))
    closest_point = np.column_stack([at, height(sheet, *at.T)])
    n = np.column_stack([-sheet.k_x * at[:, 0], -sheet.k_y * at[:, 1], np.ones(count)])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    # Centers from 0.1 below the surface to 0.6 above: from −60 % of 0.5 and deeper to well separated.
    return closest_point + random.uniform(-0.1, 0.6, (count, 1)) * n, random_rotations(random, count)


def cloud(body, random, count=1500):
    """Points all over the surface of a body, including its edges."""
    d = random.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    angle, part = random.uniform(0, 2 * np.pi, count), random.random(count)
    round_ = np.stack([np.cos(angle), np.sin(angle)], -1)
    if isinstance(body, S.Ellipsoid):
        return d * body.semi_axes
    if isinstance(body, S.RoundedBox):
        inner = np.where(random.random(d.shape) < 0.4, random.random(d.shape), 1.0)
        return np.sign(d) * (np.array(body.half_extents) - body.radius) * inner + body.radius * d
    if isinstance(body, S.Cylinder):
        mantle = part < 0.5
        out = np.where(part < 0.75, 1.0, np.sqrt(random.random(count)))[:, None]
        up = np.where(mantle, random.uniform(-1, 1, count), np.sign(d[:, 2]))
        return np.column_stack([body.radius * out * round_, body.half_length * up])
    out = body.major_radius + body.minor_radius * np.cos(2 * np.pi * part)
    return np.column_stack([out[:, None] * round_, body.minor_radius * np.sin(2 * np.pi * part)])


@pytest.mark.parametrize("body", BODIES, **names)
def test_parametric_surface_contact_is_at_the_deepest_point(body, device):
    """The deepest point below the surface, or the nearest: from points on the body and a grid on the surface."""
    random = np.random.default_rng(7)
    grid = np.linspace(-1, 1, 121)
    u, v = (values.ravel() for values in np.meshgrid(grid, grid))
    on_body = cloud(body, random)
    for sheet in SHEETS.values():
        x, q = sheet_case(sheet, 30, 8)
        contact = shape_contacts(body, sheet, x, q, device)
        assert (contact["status"] == MET).all()
        tree = cKDTree(np.column_stack([u, v, height(sheet, u, v)]))
        points = x[:, None] + rotated(q[:, None], on_body)
        distance, _ = tree.query(points)
        below = points[..., 2] < height(sheet, points[..., 0], points[..., 1])
        # A point that is lower by less than the grid error is not certain to be below.
        signed = np.where(below, -distance, distance)
        # The points are 0.02 apart and the radii are 0.1: error 0.02²/0.1, and below 0.02 at edges.
        np.testing.assert_allclose(contact["gap"], signed.min(1), atol=0.01)
        facing = contact["point_a"] - contact["point_b"] - contact["gap"][:, None] * contact["normal"]
        np.testing.assert_allclose(facing, 0.0, atol=1e-8)
        local = rotated(inverse_rotation(q), contact["point_a"] - x)
        np.testing.assert_allclose(signed_distance(body, local), 0.0, atol=1e-9)
        on = contact["point_b"]
        np.testing.assert_allclose(on[:, 2], height(sheet, on[:, 0], on[:, 1]), atol=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("body", [*BODIES, S.Sphere(0.25), S.Capsule(0.1, 0.2), S.Cone(0.2, 0.4)], **names)
def test_parametric_surface_contact_converges_for_many_random_bodies(body, times, device):
    """20 000, or 100 000 with --thorough: all converge with opposite normals.

    For hundreds or thousands of them, sampling finds no deeper or nearer point.
    """
    line = np.linspace(-1.0, 1.0, 41)
    u, v = (values.ravel() for values in np.meshgrid(line, line))
    # The reference for an ellipsoid is bisection, which is slow.
    sampled = (40 if isinstance(body, S.Ellipsoid) else 600) * times
    for sheet in SHEETS.values():
        x, q = sheet_case(sheet, 6667 * times, 9)
        contact = shape_contacts(body, sheet, x, q, device)
        assert (contact["status"] == NOT_CONVERGED).sum() <= 1
        good = contact["status"] == MET
        off = contact["point_a"] - contact["point_b"] - contact["gap"][:, None] * contact["normal"]
        np.testing.assert_allclose(off[good], 0.0, atol=1e-8)
        places = np.column_stack([u, v, height(sheet, u, v)])
        for some in np.array_split(np.flatnonzero(good)[:sampled], 10):
            seen = signed_distance(
                body, rotated(inverse_rotation(q[some])[:, None], places - x[some][:, None])
            ).min(1)
            assert (contact["gap"][some] <= seen + 1e-9).all()


def test_sphere_in_paraboloid_bowl_matches_closed_form(device):
    """Also deeper than the center, where the nearest exit is no longer on the same side."""
    sheet = Quadric(k_x=0.9, k_y=0.9)
    z = np.array([0.5, 0.2, 0.05, -0.05, -0.15])
    x = np.column_stack([0 * z, 0 * z, z])
    contact = shape_contacts(S.Sphere(0.2), sheet, x, np.tile([0, 0, 0, 1.0], (5, 1)), device)
    np.testing.assert_allclose(contact["gap"], z - 0.2, atol=1e-12)
    np.testing.assert_allclose(contact["normal"], np.tile([0, 0, 1.0], (5, 1)), atol=1e-7)


def test_parametric_surface_is_open_at_its_boundary(device):
    sheet = Quadric(k_x=0.0, k_y=0.0)
    # Above the middle, just inside and just outside of the edge, entirely behind.
    x = np.array([[0.0, 0.0, 0.1], [0.99, 0.0, 0.1], [1.01, 0.0, 0.1], [0.0, 0.0, -0.21], [0.0, 0.0, -0.19]])
    contact = shape_contacts(S.Sphere(0.2), sheet, x, np.tile([0, 0, 0, 1.0], (5, 1)), device)
    assert contact["status"].tolist() == [MET, MET, OUTSIDE, OUTSIDE, MET]
    np.testing.assert_allclose(contact["gap"][[0, 1, 4]], (-0.1, -0.1, -0.39), atol=1e-14)


class Tube(ParametricSurface):
    """A cylinder around the z axis, periodic, without analytic derivatives."""

    radius: float = parameter("m", "radius", above=0.0)

    u_range = (0.0, 2 * np.pi)
    v_range = (-1.0, 1.0)
    u_periodic = True

    @wp.func
    def position(p: Any, u: Any, v: Any):
        return wp.vec3d(p.radius * wp.cos(u), p.radius * wp.sin(u), v)


Bar, jet_of_bar = coefficient_struct(Tube, wp.float64), parametric_jet(Tube)


def test_closed_parametric_surface_has_no_seam_with_numerical_derivatives(device):
    angle = np.linspace(-0.3, 0.3, 21)
    x = np.column_stack([1.1 * np.cos(angle), 1.1 * np.sin(angle), 0.3 * angle])
    contact = shape_contacts(S.Sphere(0.2), Tube(radius=1.0), x, np.tile([0, 0, 0, 1.0], (21, 1)), device)
    assert (contact["status"] == MET).all()
    np.testing.assert_allclose(contact["gap"], -0.1, atol=1e-12)
    np.testing.assert_allclose(contact["normal"][:, :2], x[:, :2] / 1.1, atol=1e-9)


@wp.kernel(enable_backward=False)
def differences(radius: wp.float64, angle: wp.array(dtype=wp.float64), jets: wp.array2d(dtype=wp.vec3d)):
    i = wp.tid()
    p = Bar()
    p.radius = radius
    jet = jet_of_bar(p, angle[i], wp.float64(0.3))
    jets[i, 0] = jet.u
    jets[i, 1] = jet.v
    jets[i, 2] = jet.uu
    jets[i, 3] = jet.uv
    jets[i, 4] = jet.vv


def test_numerical_derivatives_match_analytic_derivatives(device):
    """To truncation and rounding at steps of 0.03 and 0.01: 1e-16/0.01² for second derivatives."""
    u = np.linspace(0.1, 6.0, 40)
    jets = wp.zeros((40, 5), dtype=wp.vec3d, device=device)
    wp.launch(differences, 40, inputs=[3.0, wp.array(u, dtype=wp.float64, device=device), jets], device=device)
    round_ = np.stack([np.cos(u), np.sin(u), 0.0 * u], axis=-1)
    forward = np.stack([-np.sin(u), np.cos(u), 0.0 * u], axis=-1)
    straight = np.broadcast_to([0.0, 0.0, 1.0], (40, 3))
    nothing = np.zeros((40, 3))
    wanted = np.stack([3.0 * forward, straight, -3.0 * round_, nothing, nothing], axis=1)
    np.testing.assert_allclose(jets.numpy()[:, :2], wanted[:, :2], atol=1e-12)
    np.testing.assert_allclose(jets.numpy()[:, 2:], wanted[:, 2:], atol=1e-10)


def test_invalid_parametric_surface_class_is_refused():
    with pytest.raises(TypeError, match=r"Upside\.u_range must be two increasing numbers, got \(1, 0\)"):
        type("Upside", (ParametricSurface,), {"u_range": (1, 0), "v_range": (0, 1)})
    with pytest.raises(TypeError, match=r"Coarse\.scan must be two whole numbers of at least 4, got \(2, 9\)"):
        type("Coarse", (ParametricSurface,), {"scan": (2, 9)})
    with pytest.raises(TypeError, match=r"Endless\.u_range must be given: u_range = \(first, last\)"):
        type("Endless", (ParametricSurface,), {"position": Tube.position, "v_range": (0, 1)})()
    with pytest.raises(TypeError, match=r"Nowhere\.position must be a wp\.func of \(p, u, v\)"):
        type("Nowhere", (ParametricSurface,), {"u_range": (0, 1), "v_range": (0, 1)})()
    with pytest.raises(TypeError, match=r"Steep\.derivatives must be a wp\.func of \(p, u, v\)"):
        type("Steep", (ParametricSurface,), {"derivatives": 1})
    with pytest.raises(TypeError, match=r"two parametric surfaces, Tube and Quadric, cannot be in contact"):
        pair_dispatch.nonconvex_pair_function(Tube, Quadric)
    with pytest.raises(ValueError, match=r"Torus\.minor_radius must be less than the major radius, got 0\.5 m"):
        Torus(0.5, 0.5)
