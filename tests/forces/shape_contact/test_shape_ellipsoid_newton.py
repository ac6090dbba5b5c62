"""Newton's method on two parametrized surfaces against hand values of two tilted ellipsoids."""

import json

import numpy as np
import pytest
import warp as wp
from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes.ellipsoid import Ellipsoid
from warpcontact.kernels.shapes.parametric import Root, solver
from warpcontact.kernels.types import ROOT_FACING, ROOT_NONE, ROOT_PARALLEL

AXES_B, AXES_A = (1.0, 0.6, 0.4), (0.8, 0.5, 0.3)
CASES = ("separated", "penetrating", "deep")


@pytest.fixture(scope="module")
def oracle(shared):
    return json.loads((shared / "spec" / "oracle_kinematics.json").read_text())


@pytest.fixture(scope="module")
def solve(device):
    """Runs Newton's method from starts (n, 4) in the frame of b."""
    of_pair = solver(Ellipsoid, Ellipsoid)
    P = coefficient_struct(Ellipsoid, wp.float64)

    @wp.kernel(module="unique", enable_backward=False)
    def each(
        p_a: P, p_b: P, x: wp.vec3d, q: wp.quatd, starts: wp.array(dtype=wp.vec4d), most: int,
        roots: wp.array(dtype=Root),
    ):  # fmt: skip
        i = wp.tid()
        roots[i] = of_pair(p_a, p_b, x, q, starts[i], 2, 2, most)

    def run(case, starts, most=50):
        p_a, p_b = P(), P()
        p_a.semi_axes, p_b.semi_axes = wp.vec3d(*AXES_A), wp.vec3d(*AXES_B)
        A_b, A_a = np.array(case["A_i"]), np.array(case["A_j"])
        x = A_b.T @ np.array(case["c_j"])
        q = wp.quat_from_matrix(wp.mat33d(*(A_b.T @ A_a).flatten()))
        starts = np.atleast_2d(starts)
        roots = wp.zeros(len(starts), dtype=Root, device=device)
        given = wp.array(starts, dtype=wp.vec4d, device=device)
        wp.launch(each, len(starts), inputs=[p_a, p_b, wp.vec3d(*x), q, given, most, roots], device=device)
        return roots.numpy()

    return run


def equations(case, u):
    """|F| of SPEC 2.1 in NumPy, in world axes."""

    def surface(axes, A, centre, th, ph):
        D = np.diag(axes)
        ct, st, cp, sp = np.cos(th), np.sin(th), np.cos(ph), np.sin(ph)
        place = centre + A @ D @ [cp * ct, cp * st, sp]
        return place, A @ D @ [-cp * st, cp * ct, 0], A @ D @ [-sp * ct, -sp * st, cp]

    x, t_1, t_2 = surface(AXES_B, np.array(case["A_i"]), np.zeros(3), u[0], u[1])
    y, s_1, s_2 = surface(AXES_A, np.array(case["A_j"]), np.array(case["c_j"]), u[2], u[3])
    N = np.cross(s_1, s_2)
    return np.linalg.norm([(y - x) @ t_1, (y - x) @ t_2, N @ t_1, N @ t_2])


@pytest.mark.parametrize("name", CASES)
def test_ellipsoid_newton_matches_reference(name, oracle, solve):
    case = oracle[name]
    root = solve(case, case["q0"])[0]
    assert root["kind"] == ROOT_FACING
    A = np.array(case["A_i"])
    np.testing.assert_allclose(root["gap"], case["gap"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(A @ root["normal"], case["n_i"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(A @ root["point_b"], case["P_i"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(A @ root["point_a"], case["P_j"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(root["normal_cosine"], -1.0, rtol=0, atol=1e-14)
    if root["pole_a"] == 2 and root["pole_b"] == 2:
        np.testing.assert_allclose(root["u"], case["q"], rtol=0, atol=1e-12)


def test_ellipsoid_newton_matches_published_residuals_and_converges_quadratically(oracle, solve):
    case = oracle["separated"]
    history = [equations(case, solve(case, case["q0"], most)[0]["u"]) for most in range(5)]
    # The second last residual, 1e-10, is accurate to one part in 1e6; the last one is rounding.
    np.testing.assert_allclose(history[:3], case["newton_residuals"][:3], rtol=1e-9)
    np.testing.assert_allclose(history[3], case["newton_residuals"][3], rtol=1e-5)
    assert history[4] < 1e-15
    orders = np.diff(np.log(history[:4]))
    assert orders[2] / orders[1] > 1.8  # 2 in the limit


@pytest.mark.parametrize("name", CASES)
def test_ellipsoid_newton_finds_and_classifies_all_four_roots(name, oracle, solve):
    case = oracle[name]
    random = np.random.default_rng(1)
    longitude, sine = random.uniform(-np.pi, np.pi, (2, 400)), random.uniform(-1, 1, (2, 400))
    starts = np.stack([longitude[0], np.arcsin(sine[0]), longitude[1], np.arcsin(sine[1])], axis=1)
    roots = solve(case, starts)
    found = roots[roots["kind"] != ROOT_NONE]
    assert len(found) > 200
    true = found[np.isin(found["kind"], (ROOT_FACING, ROOT_PARALLEL))]
    distinct = sorted({(round(float(r["gap"]), 7), int(r["kind"])) for r in true})
    kinds = {-1.0: ROOT_FACING, 1.0: ROOT_PARALLEL}
    expected = sorted((round(gap, 7), kinds[facing]) for gap, _, facing in case["roots"])
    assert distinct == expected
    # The contact is the root with the largest gap among those with opposite normals.
    facing = true[true["kind"] == ROOT_FACING]
    np.testing.assert_allclose(facing["gap"].max(), case["gap"], rtol=0, atol=1e-12)
