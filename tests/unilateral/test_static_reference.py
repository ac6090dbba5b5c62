"""Static unilateral contact against hand values, with every applicable method."""

import json

import numpy as np
import pytest

import warpcontact as wc

METHODS = ["enumeration", "energy", "projection", "prox", "gauss_seidel"]
FRICTIONAL_3D = METHODS[1:]
# So small that the residual of slow methods, amplified by the flexibility of a chain, is below 1e-12 of the
# forces.
TIGHT = 1e-14
EXACT = {"rtol": 1e-12, "atol": 1e-12}


@pytest.fixture(scope="module")
def oracle(shared):
    return json.loads((shared / "spec" / "oracle_signorini.json").read_text())


def chain(size, stiffness=1000.0):
    """Masses in a row, with springs between them and from the first to the ground."""
    K = stiffness * (2.0 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1))
    K[-1, -1] = stiffness
    return K


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", ["open", "closed", "grazing", "pull"])
def test_one_mass_at_a_wall_matches_reference(oracle, case, method):
    c = oracle["one_dof"][case]
    solution = wc.unilateral.solve(c["k"], c["f"], 1.0, c["d"], method=method, tolerance=TIGHT)
    np.testing.assert_allclose([solution.u[0], solution.lam[0]], c["closed"], **EXACT)
    assert solution.converged
    assert solution.active[0] == (c["closed"][1] > 0.0)


@pytest.mark.parametrize("case", ["open", "closed", "grazing", "pull"])
@pytest.mark.parametrize("c", [1.0, 1e3, 1e6])
def test_newton_converges_in_two_steps_for_any_parameter(oracle, case, c):
    given = oracle["one_dof"][case]
    solution = wc.unilateral.solve(given["k"], given["f"], 1.0, given["d"], parameter=c)
    np.testing.assert_allclose([solution.u[0], solution.lam[0]], given["closed"], **EXACT)
    assert solution.iterations <= 2


def test_negative_spring_has_zero_one_or_two_solutions(oracle):
    for load, expected in oracle["negative_k"].items():
        problem = wc.unilateral.Problem(-1000.0, float(load), 1.0, 0.01)
        found = sorted([one.u[0], one.lam[0]] for one in problem.all_solutions())
        np.testing.assert_allclose(found, np.reshape(expected, (len(expected), 2)) if expected else [], **EXACT)
        diagnosis = problem.diagnose()
        assert diagnosis.exists == (len(expected) > 0)
        assert diagnosis.stiffness == "indefinite"
        # Each method returns one of the solutions or reports no convergence.
        for method in METHODS:
            solution = problem.solve(method, iterations=None if method == "enumeration" else 100)
            near = [np.allclose([solution.u[0], solution.lam[0]], one, atol=1e-9) for one in expected]
            assert solution.converged == any(near)


@pytest.mark.parametrize("method", METHODS)
def test_chain_with_one_stop_matches_reference(oracle, method):
    c = oracle["chain_single"]
    G = np.zeros((1, 5))
    G[0, 4] = 1.0
    solution = wc.unilateral.solve(chain(5), c["f"], G, [c["d"]], method=method, tolerance=TIGHT)
    np.testing.assert_allclose(solution.lam, c["lam"], **EXACT)
    np.testing.assert_allclose(solution.u, c["u"], **EXACT)
    assert 1000.0 * solution.u[0] == pytest.approx(c["reaction_at_ground"], abs=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_chain_with_a_stop_at_each_mass_matches_reference(oracle, method):
    c = oracle["chain_stops"]
    # The residual is relative to 162 N/m × 0.1 m; the flexibility of the chain amplifies its effect on forces.
    solution = wc.unilateral.solve(chain(5), c["f"], np.eye(5), c["d"], method=method, tolerance=1e-15,
                                   iterations=None if method == "enumeration" else 3000)  # fmt: skip
    np.testing.assert_allclose(solution.lam, c["lam"], atol=1e-12)
    np.testing.assert_allclose(solution.u, c["u"], atol=1e-12)
    np.testing.assert_allclose(solution.gap, c["gap"], atol=1e-12)
    np.testing.assert_array_equal(solution.active, np.array(c["active"], dtype=bool))
    assert solution.residual < 1e-14


def test_chain_has_one_admissible_state_found_in_two_steps(oracle):
    c = oracle["chain_stops"]
    problem = wc.unilateral.Problem(chain(5), c["f"], np.eye(5), c["d"])
    assert len(problem.all_solutions()) == 1
    assert problem.solve("projection").iterations == 2


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", ["open", "stick", "slip"])
def test_planar_static_friction_matches_reference(oracle, case, method):
    k_n, k_t, f_n, f_t, d, mu, previous = oracle["static_friction_2d"][case]["args"]
    *numbers, state = oracle["static_friction_2d"][case]["result"]
    problem = wc.unilateral.Problem(np.diag([k_n, k_t]), [f_n, f_t], np.eye(2)[None], [d], mu, previous)
    solution = problem.solve(method, tolerance=TIGHT)
    np.testing.assert_allclose([*solution.u, *solution.lam[0]], numbers, **EXACT)
    assert wc.ContactMode(solution.status[0]).name == state.upper()
    np.testing.assert_allclose(solution.slip[0], solution.u[1:] - previous, **EXACT)


@pytest.mark.parametrize("method", FRICTIONAL_3D)
@pytest.mark.parametrize("case", ["open", "stick", "slip"])
def test_spatial_contact_matches_reference(oracle, case, method):
    c = oracle["contact3d"]
    solution = wc.unilateral.solve_delassus(c["W"], [c[case]["b"]], c[case]["mu"], method, tolerance=TIGHT)
    np.testing.assert_allclose(solution.lam[0], c[case]["l"], **EXACT)
    np.testing.assert_allclose(solution.w[0], c[case]["w"], **EXACT)
    assert solution.converged
    assert wc.ContactMode(solution.status[0]).name == case.upper()


def block(force, height, mass=10.0, width=1.0, tall=2.0, g=9.81):
    """A block on two corners, pushed sideways: H of (v_x, v_y, ω), M⁻¹ and the applied forces."""
    H = np.array([[0, 1, -width / 2], [1, 0, tall / 2], [0, 1, width / 2], [1, 0, tall / 2]], dtype=float)
    inverse = np.diag([1 / mass, 1 / mass, 12.0 / (mass * (width**2 + tall**2))])
    return H, inverse, np.array([force, -mass * g, -force * (height - tall / 2)])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", ["stick", "slip", "tip"])
def test_rigid_block_matches_reference_in_rest_slip_and_tipping(oracle, case, method):
    c = oracle["block"][case]
    H, inverse, applied = block(c["F"], c["z"])
    q = (H @ inverse @ applied).reshape(2, 2)
    solution = wc.unilateral.solve_delassus(H @ inverse @ H.T, q, c["mu"], method, tolerance=1e-13)
    assert solution.converged
    # The oracle was iterated until changes were 1e-12 of 100 N.
    close = {"atol": 3e-10}
    normal, friction = solution.lam[:, 0], solution.lam[:, 1]
    np.testing.assert_allclose(normal, [c["N_left"], c["N_right"]], **close)
    # The distribution of friction in stick is not unique, but its sum is.
    np.testing.assert_allclose(friction.sum(), c["T_sum"], **close)
    np.testing.assert_allclose(inverse @ (applied + H.T @ solution.lam.reshape(-1)), c["acc"], **close)
    if case == "slip":
        np.testing.assert_allclose(friction, [c["T_left"], c["T_right"]], **close)


@pytest.mark.parametrize("offset", [-1e-6, 1e-6])
def test_block_slips_and_tips_beyond_its_thresholds(offset):
    weight = 98.1
    H, inverse, applied = block(0.5 * weight * (1.0 + offset), 0.5)
    sliding = wc.unilateral.solve_delassus(H @ inverse @ H.T, (H @ inverse @ applied).reshape(2, 2), 0.5)
    assert (sliding.status == wc.ContactMode.SLIP).all() == (offset > 0.0)
    H, inverse, applied = block(weight / (2.0 * 1.8) * (1.0 + offset), 1.8)
    tipping = wc.unilateral.solve_delassus(H @ inverse @ H.T, (H @ inverse @ applied).reshape(2, 2), 0.9)
    assert (tipping.gap[0] > 1e-9) == (offset > 0.0)
