"""Static problems with singular stiffness, and problems without a solution."""

import numpy as np
import pytest
from scipy import sparse

import warpcontact as wc
from warpcontact.unilateral import Problem, Termination, solve

METHODS = ["projection", "gauss_seidel", "energy", "prox", "enumeration"]
# Conversions of lengths and forces: from m and N to mm and kN, to nm and MN, to Mm and nN.
UNITS = [(1.0, 1.0), (1e3, 1e-3), (1e9, 1e-6), (1e-6, 1e9)]


def table(legs):
    """Rows of a free body (z, two rotations) on supports at (x, y): the gap is d + z + y θ_x − x θ_y."""
    return np.array([[-1.0, -y, x] for x, y in legs])


CORNERS = [(-0.5, -0.5), (-0.5, 0.5), (0.5, -0.5), (0.5, 0.5)]


# Closed forms


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("length", "force"), UNITS)
def test_free_mass_pressed_against_a_wall_rests_there(method, length, force):
    solution = solve(0.0, 1.0 * force, 1.0, 0.1 * length, method=method)
    assert solution.termination == Termination.CONVERGED
    np.testing.assert_allclose(solution.u, 0.1 * length, rtol=1e-15)
    np.testing.assert_allclose(solution.lam, force, rtol=1e-15)
    assert solution.active.all()


@pytest.mark.parametrize("k", [1e-4, 1e-8, 1e-12, 1e-16, 1e-30])
def test_soft_spring_does_not_blur_the_gap(k):
    # Without contact, the displacement would be up to 1e30 m.
    for method in METHODS:
        solution = solve(k, 1.0, 1.0, 0.1, method=method)
        assert solution.converged
        assert abs(solution.gap[0]) <= 1e-10 * 0.1
        np.testing.assert_allclose(solution.lam, 1.0 - 0.1 * k, rtol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_free_beam_on_two_supports_follows_the_lever_rule(method):
    # A load of 10 N at a quarter of the span; supports 10 and 20 mm below the beam.
    solution = solve(np.zeros((2, 2)), [-10.0, 5.0], [[-1.0, 1.0], [-1.0, -1.0]], [0.01, 0.02], method=method)
    assert solution.termination == Termination.CONVERGED
    np.testing.assert_allclose(solution.lam, [7.5, 2.5], rtol=1e-12)
    np.testing.assert_allclose(solution.u, [-0.015, -0.005], rtol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_redundant_supports_share_a_load_and_displacements_are_unique(method):
    problem = Problem(np.zeros((3, 3)), [-100.0, 1.0, 2.0], table(CORNERS), 0.01 * np.ones(4))
    solution = problem.solve(method)
    assert solution.termination == Termination.CONVERGED
    np.testing.assert_allclose(solution.u, [-0.01, 0.0, 0.0], atol=1e-14)
    assert (solution.lam >= 0.0).all()
    # The resultant and its moments.
    np.testing.assert_allclose(table(CORNERS).T @ solution.lam, problem.f, rtol=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("stiffness", [0.0, 1.0])
def test_uneven_supports_carry_load_on_three_of_four_legs(method, stiffness):
    # One leg is shorter by 0.1 mm, or by rounding.
    for short in (1e-4, 1e-17):
        K = stiffness * np.diag([10.0, 1.0, 1.0])
        solution = solve(K, [-100.0, 0.0, -4.0], table(CORNERS), [0.0, 0.0, short, 0.0], method=method)
        if method in ("projection", "enumeration"):
            assert solution.converged
        if solution.converged:
            np.testing.assert_allclose(solution.gap[[0, 1, 3]], 0.0, atol=1e-9 * short)
            np.testing.assert_allclose(solution.gap[2], short, rtol=1e-6)
            np.testing.assert_allclose(solution.lam, [50.0, 4.0, 0.0, 46.0], atol=1e-2)


@pytest.mark.parametrize("method", METHODS)
def test_block_between_springs_and_a_support_carries_the_rest(method):
    # Springs of 1000 N/m at both ends of a beam of 2 m, free to turn, and a support 5 mm below its middle.
    K = 1000.0 * np.array([[2.0, 0.0], [0.0, 2.0]])
    solution = solve(K, [-30.0, 4.0], [[-1.0, 0.0]], [0.005], method=method)
    np.testing.assert_allclose(solution.u, [-0.005, 0.002], rtol=1e-9)
    np.testing.assert_allclose(solution.lam, [20.0], rtol=1e-9)


def test_buckled_column_leans_on_a_stop():
    # A rigid column with a rotational spring k = 50 N·m, under P L = 80 N·m: K = k − P L < 0. Moment: 2 N·m.
    problem = Problem(50.0 - 80.0, 2.0, [[1.0], [-1.0]], [0.1, 0.1])
    found = sorted((one.u[0], *one.lam) for one in problem.all_solutions())
    np.testing.assert_allclose(found, [(-0.1, 0.0, 1.0), (-2.0 / 30.0, 0.0, 0.0), (0.1, 5.0, 0.0)], atol=1e-14)
    for method in METHODS:
        solution = problem.solve(method)
        near = [np.allclose([solution.u[0], *solution.lam], one, atol=1e-9) for one in found]
        assert solution.converged == any(near)
    assert problem.solve().converged


# Uniqueness and existence


def test_unopposed_load_is_unbounded_along_its_direction():
    for method in METHODS:
        solution = solve(np.zeros((3, 3)), [-100.0, 100.0, 2.0], table(CORNERS), 0.01 * np.ones(4), method=method)
        assert solution.termination == Termination.UNBOUNDED
        assert not solution.converged
        # It tips: the load does work, and no gap closes.
        assert solution.direction @ [-100.0, 100.0, 2.0] > 0.0
        assert (table(CORNERS) @ solution.direction <= 1e-12).all()
        assert np.abs(solution.direction).max() == 1.0


def test_unconstrained_displacement_is_reported_as_not_unique():
    # A block pressed onto the ground, free to slide along it without friction.
    for method in METHODS:
        solution = solve(np.diag([0.0, 0.0]), [0.0, -10.0], [[0.0, -1.0]], [0.02], method=method)
        assert solution.termination == Termination.NOT_UNIQUE
        assert solution.converged
        np.testing.assert_allclose(np.abs(solution.direction), [1.0, 0.0], atol=1e-12)
        np.testing.assert_allclose([solution.u[1], solution.lam[0]], [-0.02, 10.0], rtol=1e-12)
    # Friction holds it.
    rows = [[[0.0, -1.0], [-1.0, 0.0]]]
    assert solve(np.zeros((2, 2)), [1.0, -10.0], rows, [0.0], mu=0.2).termination == Termination.CONVERGED
    pushed = solve(np.zeros((2, 2)), [3.0, -10.0], rows, [0.0], mu=0.2)
    assert pushed.termination == Termination.UNBOUNDED
    np.testing.assert_allclose(pushed.direction[0], 1.0)


def test_grazing_contacts_restrain_without_force():
    # Two walls without gaps on both sides hold a free mass; one does not.
    both = solve(0.0, 0.0, [[1.0], [-1.0]], [0.0, 0.0])
    assert both.termination == Termination.CONVERGED
    one = solve(0.0, 0.0, [[1.0]], [0.0])
    assert one.termination == Termination.NOT_UNIQUE
    np.testing.assert_allclose(one.direction, [-1.0])


def test_conflicting_walls_are_infeasible():
    for method in METHODS:
        for K in (0.0, 1000.0, -1000.0):
            solution = solve(K, 0.0, [[1.0], [-1.0]], [-0.1, -0.1], method=method)
            assert solution.termination == Termination.INFEASIBLE


def test_unstable_spring_has_no_solution():
    assert solve(-1000.0, -20.0, 1.0, 0.01).termination == Termination.NO_SOLUTION
    assert solve(-1000.0, -20.0, 1.0, 0.01, method="enumeration").termination == Termination.NO_SOLUTION
    assert solve(-1000.0, -20.0, 1.0, 0.01, method="gauss_seidel").termination == Termination.NOT_CONVERGED


def test_diagnosis_of_redundant_supports_finds_unique_displacements_and_sums():
    diagnosis = Problem(np.zeros((3, 3)), [-100.0, 1.0, 2.0], table(CORNERS), 0.01 * np.ones(4)).diagnose()
    assert diagnosis.stiffness == "singular"
    assert (diagnosis.exists, diagnosis.unique_u, diagnosis.unique_lam) == (True, True, False)
    assert diagnosis.unique_sum([1, 1, 1, 1])
    assert not diagnosis.unique_sum([1, 0, 0, 0])
    slides = Problem(np.zeros((2, 2)), [0.0, -10.0], [[0.0, -1.0]], [0.02]).diagnose()
    assert (slides.exists, slides.unique_u) == (True, False)
    tips = Problem(np.zeros((3, 3)), [-100.0, 100.0, 2.0], table(CORNERS), 0.01 * np.ones(4)).diagnose()
    assert tips.exists is False


# Friction, sparse matrices, batches


@pytest.mark.parametrize("method", METHODS[:4])
def test_free_block_in_space_is_held_by_friction(method):
    # Three translations on a floor with μ = 0.5, pushed with 3 and 4 N under 20 N.
    rows = -np.eye(3)[[2, 0, 1]][None]
    solution = solve(np.zeros((3, 3)), [3.0, 4.0, -20.0], rows, [0.001], mu=0.5, method=method)
    assert solution.termination == Termination.CONVERGED
    np.testing.assert_allclose(solution.lam, [[20.0, -3.0, -4.0]], atol=1e-12)
    np.testing.assert_allclose(solution.u, [0.0, 0.0, -0.001], atol=1e-15)
    assert solution.status[0] == wc.ContactMode.STICK


@pytest.mark.parametrize("method", ["projection", "enumeration"])
def test_free_block_jammed_between_walls_is_held_by_friction(method):
    # 1 N along two walls with μ = 0.2, any normal force of at least 2.5 N. The block was at rest at 0.1 m at the
    # second wall, and friction of the first wall opposes its displacement there.
    rows = [[[-1.0, 0.0], [0.0, 1.0]], [[1.0, 0.0], [0.0, 1.0]]]
    problem = Problem(np.zeros((2, 2)), [0.0, 1.0], rows, [0.0, 0.0], 0.2, [[0.0], [0.1]])
    solution = problem.solve(method)
    assert solution.converged
    normal, across = solution.lam.T
    assert normal[0] >= 2.5 - 1e-9
    np.testing.assert_allclose([normal[0] - normal[1], across.sum()], [0.0, 1.0], atol=1e-12)
    assert solution.slip[1] >= -1e-12
    assert problem.all_solutions()


def free_chain(n, stiffness=1e5):
    """Stiffness of n masses in a row with springs between them, and rows of walls at both ends."""
    ends = np.r_[1.0, 2.0 * np.ones(n - 2), 1.0]
    K = stiffness * sparse.diags_array([-np.ones(n - 1), ends, -np.ones(n - 1)], offsets=[-1, 0, 1])
    G = np.zeros((2, n))
    G[[0, 1], [0, -1]] = 1.0
    return K.tocsc(), G


@pytest.mark.parametrize("method", METHODS[:4])
@pytest.mark.parametrize("n", [40, 200])
def test_free_chain_between_two_walls_is_solved(method, n):
    # Springs in series distribute a load between walls like a lever. At each end are two walls at the same
    # position.
    K, G = free_chain(n)
    at = 5
    f = 10.0 * np.eye(n)[at]
    expected = np.array([n - 1 - at, at]) * 10.0 / (n - 1)
    for matrix in (K, K.toarray()):
        solution = solve(matrix, f, np.vstack([G, G]), 0.1 * np.ones(4), method=method)
        assert solution.termination == Termination.CONVERGED
        np.testing.assert_allclose(solution.lam.reshape(2, 2).sum(axis=0), expected, rtol=1e-9)
        np.testing.assert_allclose(solution.gap, 0.0, atol=1e-14)


def test_long_free_chain_pulled_off_its_walls_is_unbounded():
    K, G = free_chain(1200)
    solution = solve(K, -10.0 * np.eye(1200)[5], G, [0.1, 0.1])
    assert solution.termination == Termination.UNBOUNDED
    np.testing.assert_allclose(solution.direction, -1.0, rtol=1e-9)


def test_batch_of_singular_problems_equals_single_problems():
    K, f = np.array([0.0, 1000.0, 0.0, -1000.0])[:, None, None], np.array([1.0, 300.0, -1.0, -20.0])[:, None]
    many = solve(K, f, [[1.0]], [0.1])
    # The last one is open, at u = 0.02.
    wanted = [Termination.CONVERGED, Termination.CONVERGED, Termination.UNBOUNDED, Termination.CONVERGED]
    assert many.termination.tolist() == wanted
    np.testing.assert_allclose(many.u[:2], 0.1)
    np.testing.assert_allclose(many.direction[:, 0], [0.0, 0.0, -1.0, 0.0])
    for k in range(4):
        one = solve(K[k], f[k], [[1.0]], [0.1])
        assert one.termination == many.termination[k]
        np.testing.assert_array_equal(one.u, many.u[k])
        np.testing.assert_array_equal(one.lam, many.lam[k])


def test_iteration_limit_applies_to_singular_stiffness():
    problem = Problem(np.zeros((3, 3)), [-100.0, 1.0, 2.0], table(CORNERS), 0.01 * np.ones(4))
    cut = problem.solve("prox", iterations=2)
    assert cut.termination == Termination.NOT_CONVERGED
    assert cut.iterations <= 2
    assert problem.solve("prox", iterations=1000).converged
