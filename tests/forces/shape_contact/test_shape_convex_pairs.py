"""Contact kinematics of convex shapes against the oracle, closed forms, brute force, and in special alignments."""

import itertools
import json

import numpy as np
import pytest
from convex_pairs import (
    brute_force,
    check,
    chosen,
    heights,
    random_pairs,
    random_rotations,
    random_shapes,
    solved,
    to_a,
    widths,
)
from scipy.spatial.transform import Rotation
from warpcontact.kernels.shapes.base import WarmStart
from warpcontact.kernels.shapes.pair_dispatch import pair_function
from warpcontact.kernels.types import MET

import warpcontact as wc
from warpcontact import shapes as sh

SHAPES = [shape for shape in sh.CATALOGUE if shape.convex and shape is not sh.Plane]
COMBINATIONS = list(itertools.combinations_with_replacement(SHAPES, 2))
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
# Half a turn about x, a quarter about x.
UPSIDE_DOWN = (1.0, 0.0, 0.0, 0.0)
LYING = (np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5))


def names(pair):
    return "-".join(shape.__name__ for shape in pair)


# Oracle

AXES_I, AXES_J = {"semi_axes": (1.0, 0.6, 0.4)}, {"semi_axes": (0.8, 0.5, 0.3)}


@pytest.fixture(scope="module")
def oracle(shared):
    cases = json.loads((shared / "spec" / "oracle_kinematics.json").read_text())
    return {name: case for name, case in cases.items() if "A_i" in case}


def placed(case):
    """Position and rotation of ellipsoid j in the frame of i."""
    A_i, A_j = np.array(case["A_i"]), np.array(case["A_j"])
    return A_i.T @ case["c_j"], Rotation.from_matrix(A_i.T @ A_j).as_quat()


@pytest.mark.parametrize("name", ["separated", "penetrating", "deep"])
def test_ellipsoid_pair_matches_reference(oracle, name, device):
    case = oracle[name]
    A_i = np.array(case["A_i"])
    found = solved(sh.Ellipsoid, sh.Ellipsoid, AXES_J, AXES_I, *placed(case), device=device)[0]
    assert found["status"] == MET
    assert found["gap"] == pytest.approx(case["gap"], abs=1e-12)
    np.testing.assert_allclose(A_i @ found["normal"], case["n_i"], atol=1e-12)
    np.testing.assert_allclose(A_i @ found["point_b"], case["P_i"], atol=1e-12)
    np.testing.assert_allclose(A_i @ found["point_a"], case["P_j"], atol=1e-12)
    assert found["residual"] < 1e-14


@pytest.mark.parametrize("name", ["separated", "penetrating", "deep"])
def test_ellipsoid_pair_finds_the_correct_root_from_any_warm_start(oracle, name, device):
    case = oracle[name]
    roots = np.array(case["roots"])
    assert len(roots) == 4
    right = roots[roots[:, 2] < 0.0, 0].max()
    seeds = np.zeros(1000, dtype=WarmStart.numpy_dtype())
    seeds["normal"] = np.random.default_rng(0).normal(size=(1000, 3))
    seeds["normal"] /= np.linalg.norm(seeds["normal"], axis=1, keepdims=True)
    seeds["valid"] = 1
    x, q = placed(case)
    found = solved(
        sh.Ellipsoid, sh.Ellipsoid, AXES_J, AXES_I, np.broadcast_to(x, (1000, 3)), q, seeds, device=device
    )
    np.testing.assert_allclose(found["gap"], case["gap"], atol=1e-13)
    # The list of roots has nine digits.
    np.testing.assert_allclose(found["gap"], right, atol=1e-9)


@pytest.mark.parametrize("name", ["separated", "penetrating", "deep"])
def test_ellipsoid_gap_rate_matches_reference(oracle, name, device):
    case = oracle[name]
    v, A_i = case["velocity"], np.array(case["A_i"])
    found = solved(sh.Ellipsoid, sh.Ellipsoid, AXES_J, AXES_I, *placed(case), device=device)[0]
    P_i, P_j, n = (A_i @ found[key] for key in ("point_b", "point_a", "normal"))
    rate = n @ (v["v_j"] + np.cross(v["w_j"], P_j - case["c_j"]) - v["v_i"] - np.cross(v["w_i"], P_i))
    assert rate == pytest.approx(v["gap_rate"], abs=1e-12)


# Closed forms


def test_sphere_pair_gap_is_exact(device):
    x = np.random.default_rng(1).normal(size=(100, 3))
    found = solved(sh.Sphere, sh.Sphere, {"radius": 0.3}, {"radius": 0.5}, x, UPRIGHT, device=device)
    distance = np.linalg.norm(x, axis=1)
    np.testing.assert_allclose(found["gap"], distance - 0.8, atol=1e-15)
    np.testing.assert_allclose(found["normal"], x / distance[:, None], atol=1e-15)
    assert (found["iterations"] == 0).all()


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.__name__)
def test_shape_contacts_plane_at_its_lowest_point(shape, device):
    rng = np.random.default_rng(2)
    values, q, x = random_shapes(shape, 200, rng), random_rotations(200, rng), rng.normal(size=(200, 3))
    found = solved(shape, sh.Plane, values, {}, x, q, device=device)
    down = to_a(Rotation.from_quat(q).as_matrix(), np.broadcast_to([0.0, 0.0, -1.0], (200, 1, 3)))
    np.testing.assert_allclose(found["gap"], x[:, 2] - heights(shape, values, down)[:, 0], atol=1e-14)
    np.testing.assert_allclose(found["point_a"][:, 2], found["gap"], atol=1e-14)
    np.testing.assert_array_equal(found["point_b"][:, 2], 0.0)
    # The exchanged pair, in the frame of the other shape.
    back = Rotation.from_quat(q).inv()
    other = solved(sh.Plane, shape, {}, values, -back.apply(x), back.as_quat(), device=device)
    np.testing.assert_allclose(other["gap"], found["gap"], atol=1e-14)
    np.testing.assert_allclose(other["point_b"], back.apply(found["point_a"] - x), atol=1e-14)
    np.testing.assert_allclose(other["normal"], -back.apply([0.0, 0.0, 1.0]), atol=1e-14)


def test_plane_plane_pair_is_refused():
    with pytest.raises(TypeError, match="two planes"):
        pair_function(sh.Plane, sh.Plane)


# Brute force


# Each shape with itself and with a box; all pairs with --thorough.
@pytest.mark.parametrize(
    "pair",
    [
        pytest.param(pair, marks=() if pair[0] is pair[1] or sh.RoundedBox in pair else pytest.mark.slow)
        for pair in COMBINATIONS
    ],
    ids=names,
)
def test_gap_is_the_maximum_over_all_directions(pair, device):
    shapes = random_pairs(*pair, 1000, seed=3)
    check(*pair, shapes, solved(*pair, *shapes, device=device), count=1000)


INACTIVE = [
    # Pairs among 20 000: a better direction close to the normal of a disk (two cases), and a search of many steps.
    (sh.Cylinder, sh.RoundedBox, 100, 7052),
    (sh.Cone, sh.Cone, 104, 4475),
    (sh.Superellipsoid, sh.Cone, 104, 12053),
]


@pytest.mark.parametrize(("A", "B", "seed", "which"), INACTIVE)
def test_global_separation_direction_is_found_if_hidden(A, B, seed, which, device):
    a, b, x, q = random_pairs(A, B, 20_000, seed=seed)
    pair = (A, B, *(chosen(values, [which]) for values in (a, b)), x[[which]], q[[which]])
    found = solved(*pair, device=device)[0]
    assert found["status"] == MET
    assert found["gap"] == pytest.approx(brute_force(*pair, rounds=60)[0], abs=1e-9)


def test_cone_tips_in_overlap_converge_quickly(device):
    """While only tips overlap, g is equally curved in both directions, except for rounding."""
    a, b, x, q = random_pairs(sh.Cone, sh.Cone, 20_000, seed=100)
    pair = (sh.Cone, sh.Cone, *(chosen(values, [14490]) for values in (a, b)), x[[14490]], q[[14490]])
    assert solved(*pair, device=device)[0]["iterations"] < 30


SOME = [
    (sh.Ellipsoid, sh.Ellipsoid),
    (sh.Superellipsoid, sh.Superellipsoid),
    (sh.Cylinder, sh.Cylinder),
    (sh.Cone, sh.RoundedBox),
    (sh.RoundedBox, sh.RoundedBox),
    (sh.Capsule, sh.Capsule),
]


@pytest.mark.parametrize("pair", SOME, ids=names)
def test_gap_does_not_depend_on_the_warm_start(pair, device):
    shapes = random_pairs(*pair, 1000, seed=4)
    cold = solved(*pair, *shapes, device=device)
    seeds = cold["warm_start"].copy()
    seeds["normal"] = np.random.default_rng(5).normal(size=(1000, 3))
    seeds["normal"] /= np.linalg.norm(seeds["normal"], axis=1, keepdims=True)
    found = solved(*pair, *shapes, seeds, device=device)
    assert (found["status"] == MET).all()
    np.testing.assert_allclose(found["gap"], cold["gap"], atol=1e-9)


@pytest.mark.parametrize("pair", SOME, ids=names)
def test_warm_start_at_the_solution_needs_few_iterations(pair, device):
    shapes = random_pairs(*pair, 1000, seed=4)
    cold = solved(*pair, *shapes, device=device)
    warm = solved(*pair, *shapes, cold["warm_start"], device=device)
    np.testing.assert_allclose(warm["gap"], cold["gap"], atol=1e-11)
    apart = cold["gap"] > 0.0
    steep = sh.Superellipsoid in pair
    assert np.mean(warm["iterations"][apart]) < (10.0 if steep else 1.5)


@pytest.mark.parametrize("pair", SOME, ids=names)
def test_gap_rate_matches_point_velocities(pair, device):
    a, b, x, q = random_pairs(*pair, 300, seed=6, exponents=(0.5, 1.5))
    rng = np.random.default_rng(7)
    v, w = rng.normal(size=(2, 300, 3))
    h = 1e-6
    here = solved(*pair, a, b, x, q, device=device)
    turn = Rotation.from_rotvec(h * w)
    before = solved(*pair, a, b, x - h * v, (turn.inv() * Rotation.from_quat(q)).as_quat(), device=device)
    after = solved(*pair, a, b, x + h * v, (turn * Rotation.from_quat(q)).as_quat(), device=device)
    rate = np.sum(here["normal"] * (v + np.cross(w, here["point_a"] - x)), axis=1)
    measured = (after["gap"] - before["gap"]) / (2.0 * h)
    # If another pair of features becomes nearest within the step, the gap has a kink.
    same = np.linalg.norm(after["normal"] - before["normal"], axis=1) < 1e-4
    assert same.mean() > 0.95
    np.testing.assert_allclose(measured[same], rate[same], atol=2e-4)
    # Rounding 1e-15/h and curvature; a step across an edge is off by its angle.
    assert np.median(np.abs(measured - rate)) < 1e-8


# Exchange and scale


@pytest.mark.parametrize("pair", SOME, ids=names)
def test_shape_pair_is_symmetric(pair, device):
    A, B = pair
    a, b, x, q = random_pairs(A, B, 300, seed=8)
    found = solved(A, B, a, b, x, q, device=device)
    back = Rotation.from_quat(q).inv()
    other = solved(B, A, b, a, -back.apply(x), back.as_quat(), device=device)
    np.testing.assert_allclose(other["gap"], found["gap"], atol=1e-11)
    normal = -Rotation.from_quat(q).apply(other["normal"])
    # Two directions of equal separation are equally valid.
    along = widths(A, B, a, b, x, Rotation.from_quat(q).as_matrix(), normal[:, None])[:, 0]
    np.testing.assert_allclose(along, found["gap"], atol=1e-11)


LENGTHS = ("radius", "half_length", "height", "semi_axes", "half_extents")


@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.parametrize("pair", SOME, ids=names)
def test_shape_pair_gap_is_invariant_to_scale(pair, scale, device):
    a, b, x, q = random_pairs(*pair, 300, seed=9)
    found = solved(*pair, a, b, x, q, device=device)
    large = [{name: v * scale if name in LENGTHS else v for name, v in values.items()} for values in (a, b)]
    other = solved(*pair, *large, scale * x, q, device=device)
    assert (other["status"] == MET).all()
    np.testing.assert_allclose(other["gap"] / scale, found["gap"], atol=1e-11)


def test_gap_is_accurate_for_size_ratio_of_a_million(device):
    """With sizes that differ by a million, the gap is accurate to rounding of the larger one."""
    rng = np.random.default_rng(10)
    small = {"semi_axes": 1e-6 * rng.uniform(0.5, 1.0, (300, 3))}
    large = {"semi_axes": rng.uniform(0.5, 1.0, (300, 3))}
    n = rng.normal(size=(300, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    q = random_rotations(300, rng)
    contact_point = large["semi_axes"] ** 2 * n / heights(sh.Ellipsoid, large, n[:, None])
    reach = heights(sh.Ellipsoid, small, to_a(Rotation.from_quat(q).as_matrix(), -n[:, None]))
    own = Rotation.from_quat(q)
    grain = own.apply(small["semi_axes"] ** 2 * own.inv().apply(-n)) / reach
    found = solved(sh.Ellipsoid, sh.Ellipsoid, small, large, contact_point + 2e-7 * n - grain, q, device=device)
    assert (found["status"] == MET).all()
    np.testing.assert_allclose(found["gap"], 2e-7, atol=1e-14)


# Alignments

CYLINDER = {"radius": 0.5, "half_length": 1.0}
BOX = {"half_extents": (0.5, 0.6, 0.7), "radius": 0.0}
SLAB = {"half_extents": (5.0, 5.0, 0.5), "radius": 0.1}
CONE = {"radius": 0.5, "height": 1.0}
THIN = {"semi_axes": (1.0, 0.6, 0.4)}
DIAGONAL = np.sqrt(0.5)
ALIGNED = [
    # a, b, their parameters, position and rotation of a, gap, normal or None if it is not unique.
    (sh.Cylinder, sh.Cylinder, CYLINDER, CYLINDER, (0, 0, 1.9), UPRIGHT, -0.1, (0, 0, 1)),
    (sh.Cylinder, sh.Cylinder, CYLINDER, CYLINDER, (0.3, 0.1, 2.0), UPRIGHT, 0.0, (0, 0, 1)),
    (sh.Cylinder, sh.Cylinder, CYLINDER, CYLINDER, (0.9, 0, 0.5), UPRIGHT, -0.1, (1, 0, 0)),
    (sh.Cylinder, sh.Cylinder, CYLINDER, CYLINDER, (0, 0, 0), UPRIGHT, -1.0, None),
    (sh.Cylinder, sh.Cylinder, CYLINDER, CYLINDER, (0, 0, 1.1), LYING, 0.1 - 0.5, (0, 0, 1)),
    (sh.RoundedBox, sh.RoundedBox, BOX, BOX, (0.1, 0.2, 1.35), UPRIGHT, -0.05, (0, 0, 1)),
    (sh.RoundedBox, sh.RoundedBox, BOX, BOX, (0, 0, 0), UPRIGHT, -1.0, None),
    (sh.RoundedBox, sh.RoundedBox, BOX, BOX, (1.1, 1.3, 0), UPRIGHT, 0.1 / DIAGONAL, (DIAGONAL, DIAGONAL, 0)),
    (sh.RoundedBox, sh.RoundedBox, BOX, BOX, (1.1, 1.3, 1.5), UPRIGHT, 0.1 * np.sqrt(3), (3**-0.5,) * 3),
    (sh.Cylinder, sh.RoundedBox, CYLINDER, SLAB, (3, 1, 1.45), UPRIGHT, -0.05, (0, 0, 1)),
    (sh.Capsule, sh.RoundedBox, CYLINDER, SLAB, (3, 1, 0.95), LYING, -0.05, (0, 0, 1)),
    (sh.Cone, sh.RoundedBox, CONE, SLAB, (1, 2, 1.45), UPSIDE_DOWN, -0.05, (0, 0, 1)),
    (sh.Cone, sh.RoundedBox, CONE, SLAB, (1, 2, 0.45), UPRIGHT, -0.05, (0, 0, 1)),
    (sh.Cone, sh.Cone, CONE, CONE, (0, 0, 0.95), UPRIGHT, -0.05, (0, 0, 1)),
    (sh.Cone, sh.Cone, CONE, CONE, (0, 0, 0), UPRIGHT, -2 * 0.5 / np.sqrt(1.25), None),
    (sh.Cone, sh.Cone, CONE, CONE, (0, 0, 1.9), UPSIDE_DOWN, -0.1 / np.sqrt(5.0), None),
    (sh.Cone, sh.Plane, CONE, {}, (0, 0, 0.95), UPSIDE_DOWN, -0.05, (0, 0, 1)),
    (sh.Ellipsoid, sh.Ellipsoid, THIN, THIN, (0, 0, 0), UPRIGHT, -0.8, None),
    (sh.Ellipsoid, sh.Ellipsoid, THIN, THIN, (0, 0, 1e-9), UPRIGHT, 1e-9 - 0.8, (0, 0, 1)),
    (sh.Sphere, sh.Ellipsoid, {"radius": 0.2}, THIN, (0, 0, 0), UPRIGHT, -0.6, None),
    (sh.Sphere, sh.Sphere, {"radius": 0.2}, {"radius": 0.3}, (0, 0, 0), UPRIGHT, -0.5, None),
    (sh.Capsule, sh.Capsule, CYLINDER, CYLINDER, (1.1, 0, 0.5), UPRIGHT, 0.1, (1, 0, 0)),
    (sh.Capsule, sh.Capsule, CYLINDER, CYLINDER, (0, 0, 3.1), UPRIGHT, 0.1, (0, 0, 1)),
    (sh.Capsule, sh.Capsule, CYLINDER, CYLINDER, (0, 0, 0), LYING, -1.0, None),
    (sh.Capsule, sh.Capsule, CYLINDER, CYLINDER, (0, 0, 0.2), UPRIGHT, -1.0, None),
]


@pytest.mark.parametrize(("A", "B", "a", "b", "x", "q", "gap", "normal"), ALIGNED)
def test_aligned_shapes_match_closed_form(A, B, a, b, x, q, gap, normal, device):
    found = solved(A, B, a, b, x, q, device=device)[0]
    assert found["status"] == MET
    assert found["gap"] == pytest.approx(gap, abs=1e-13)
    if normal is not None:
        np.testing.assert_allclose(found["normal"], normal, atol=1e-13)
    np.testing.assert_allclose(found["point_a"] - found["point_b"], found["gap"] * found["normal"], atol=1e-13)


def test_parallel_faces_contact_within_both_faces(device):
    """Displaced bodies touch at a point common to both faces, aligned ones at the center."""
    x = np.array([[0.0, 0.0, 1.35], [0.4, 0.0, 1.35], [0.9, -1.1, 1.35]])
    found = solved(sh.RoundedBox, sh.RoundedBox, BOX, BOX, x, UPRIGHT, device=device)
    np.testing.assert_allclose(found["point_b"][:, :2], 0.5 * x[:, :2], atol=1e-13)
    x = np.array([[0.0, 0.0, 1.45], [3.0, 1.0, 1.45], [5.2, 0.0, 1.45], [5.2, 5.1, 1.45]])
    found = solved(sh.Cylinder, sh.RoundedBox, CYLINDER, SLAB, x, UPRIGHT, device=device)
    np.testing.assert_allclose(found["gap"], -0.05, atol=1e-13)
    np.testing.assert_allclose(found["point_b"][0, :2], 0.0, atol=1e-13)
    assert (np.abs(found["point_b"][:, :2]) <= 4.9 + 1e-13).all()
    assert (np.linalg.norm((found["point_a"] - x)[:, :2], axis=1) <= 0.5 + 1e-13).all()


@pytest.mark.parametrize("angle", [1e-15, 1e-12, 1e-9, 1e-6, 1e-3])
@pytest.mark.parametrize("pair", [(sh.Cylinder, CYLINDER), (sh.RoundedBox, BOX)], ids=["cylinder", "box"])
def test_nearly_parallel_faces_contact_at_an_edge(pair, angle, device):
    """With a small tilt, the contact is at the lowest vertex or point of the circular edge."""
    shape, values = pair
    q = Rotation.from_rotvec([0.0, angle, 0.0]).as_quat()
    height = values["half_length"] if shape is sh.Cylinder else values["half_extents"][2]
    reach = values["radius"] if shape is sh.Cylinder else values["half_extents"][0]
    x = np.array([[0.3, 0.2, 0.5 + height + 0.01]])
    found = solved(shape, sh.RoundedBox, values, SLAB, x, q, device=device)[0]
    assert found["status"] == MET
    expected = 0.01 + height * (1.0 - np.cos(angle)) - reach * np.sin(angle)
    assert found["gap"] == pytest.approx(expected, abs=1e-13)


# Parameters


def test_shapes_accept_parameters_by_position_or_name():
    assert sh.Sphere(0.1) == sh.Sphere(radius=0.1)
    assert sh.Ellipsoid((1.0, 0.6, 0.4)).semi_axes == (1.0, 0.6, 0.4)
    assert sh.RoundedBox((1.0, 1.0, 1.0)).radius == 0.0
    assert sh.Superellipsoid((1.0, 1.0, 1.0)).exponents == (1.0, 1.0)
    assert wc.shapes is sh


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: sh.Sphere(0.0), r"Sphere.radius must be greater than 0, got 0 m"),
        (lambda: sh.Ellipsoid((1.0, -1.0, 1.0)), r"Ellipsoid.semi_axes\[1\] must be greater than 0, got -1 m"),
        (lambda: sh.Ellipsoid((1.0, 1.0)), r"3 numbers, got shape \(2,\).*model\['<shape>.semi_axes'\] = values"),
        (lambda: sh.Ellipsoid("abc"), r"Ellipsoid.semi_axes must be 3 numbers, got 'abc'"),
        (lambda: sh.Superellipsoid((1, 1, 1), (0.05, 1)), r"exponents\[0\] must be at least 0.1 and at most 1.9"),
        (
            lambda: sh.RoundedBox((1, 2, 0.3), 0.3),
            r"RoundedBox.radius must be less than every half extent, got 0.3 m",
        ),
        (lambda: sh.Cone(1.0, np.inf), r"Cone.height must be greater than 0, got inf m"),
    ],
)
def test_invalid_shape_parameters_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
