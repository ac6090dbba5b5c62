"""Static contact problems: input, batches, files, and diagnosis."""

import io
import re
import zipfile

import numpy as np
import pytest
from scipy import sparse

import warpcontact as wc
from warpcontact.unilateral import Problem, solve, solve_delassus

METHODS = ["energy", "projection", "prox", "gauss_seidel"]


def chain(size=4, stiffness=1000.0):
    K = stiffness * (2.0 * np.eye(size) - np.eye(size, k=1) - np.eye(size, k=-1))
    K[-1, -1] = stiffness
    return K


def frictional(seed=0, count=None, n=9, contacts=3, dim=3):
    """Arguments of a problem whose gaps are open at u = 0."""
    random = np.random.default_rng(seed)
    shape = () if count is None else (count,)
    A = random.normal(size=(n, n))
    return {
        "K": A @ A.T + np.eye(n),
        "f": 5.0 * random.normal(size=(*shape, n)),
        "G": random.normal(size=(contacts, dim, n)),
        "d": 0.1 + random.random((*shape, contacts)),
        "mu": random.uniform(0.1, 0.5, contacts),
        "previous": 0.1 * random.normal(size=(contacts, dim - 1)),
    }


# Conditions on a solution


@pytest.mark.parametrize("method", METHODS)
def test_solution_satisfies_equilibrium_gaps_and_friction(method):
    given = frictional()
    solution = solve(**given, method=method, tolerance=1e-12)
    K, G = given["K"], given["G"].reshape(-1, 9)
    np.testing.assert_allclose(K @ solution.u + G.T @ solution.lam.reshape(-1), given["f"], atol=1e-12)
    moved = (G @ solution.u).reshape(3, 3)
    np.testing.assert_allclose(solution.gap, given["d"] - moved[:, 0], atol=1e-14)
    np.testing.assert_allclose(solution.slip, moved[:, 1:] - given["previous"], atol=1e-14)
    np.testing.assert_allclose(solution.w, np.column_stack([solution.gap, -solution.slip]), atol=1e-14)
    assert solution.converged
    for i in range(3):
        limit, across = given["mu"][i] * solution.lam[i, 0], np.linalg.norm(solution.lam[i, 1:])
        if solution.status[i] == wc.ContactMode.OPEN:
            assert solution.gap[i] > 0.0
        elif solution.status[i] == wc.ContactMode.STICK:
            assert np.abs(solution.slip[i]).max() < 1e-10
            assert across < limit
        else:
            assert across == pytest.approx(limit, rel=1e-9)
            # Friction has the direction of the slip.
            assert solution.slip[i] @ solution.lam[i, 1:] == pytest.approx(
                np.linalg.norm(solution.slip[i]) * across, rel=1e-9
            )
    assert solution.active.tolist() == (solution.lam[:, 0] > 0.0).tolist()


def test_solve_with_iteration_limit_is_not_converged():
    for method in METHODS:
        solution = solve(**frictional(2), method=method, iterations=1, tolerance=1e-12)
        assert not solution.converged
        assert solution.residual > 1e-12


@pytest.mark.parametrize("mu", [1e6, 1e12, 1e100])
def test_gap_closes_for_any_friction_coefficient(mu):
    problem = Problem(np.diag([1000.0, 500.0]), [25.0, 6.0], np.eye(2)[None], [0.01], mu)
    for method in ("projection", "gauss_seidel", "enumeration"):
        solution = problem.solve(method)
        np.testing.assert_allclose(solution.lam, [[15.0, 6.0]], rtol=1e-12)
        assert solution.converged
    for method in ("prox", "energy"):
        # The cone is too wide for these methods, which they report.
        assert not problem.solve(method, iterations=1000).converged


def test_soft_contact_next_to_stiff_one_is_judged_by_its_own_force():
    # 5e11 N at the stiff contact, 4 N at the soft one.
    problem = Problem(np.diag([1e12, 1.0]), [1e12, 5.0], np.eye(2), [0.5, 1.0])
    for method in ("enumeration", *METHODS):
        solution = problem.solve(method)
        assert solution.converged
        np.testing.assert_allclose(solution.lam, [5e11, 4.0], rtol=1e-9)
        np.testing.assert_allclose(solution.gap, 0.0, atol=1e-9)


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_grazing_contacts_have_no_force_from_rounding(seed, dim):
    # The load just closes all gaps: q is the rounding of a difference.
    random = np.random.default_rng(seed)
    A, u, G = random.normal(size=(6, 6)), random.normal(size=6), random.normal(size=(3, dim, 6))
    K = A @ A.T + np.eye(6)
    previous = (G[:, 1:] @ u).reshape(3, dim - 1)
    normals = G[:, 0]
    problem = Problem(K, K @ u, normals if dim == 1 else G, normals @ u, 0.8 * (dim > 1), previous)
    for method in ("enumeration", *METHODS):
        solution = problem.solve(method)
        assert solution.converged
        assert not solution.active.any()
        np.testing.assert_allclose(solution.u, u, atol=1e-13)
    assert len(problem.all_solutions()) == 1
    # Same for springs with negative stiffness.
    assert len(Problem(-3.0, -3.0 * 0.1, 1.0, 0.1).all_solutions()) == 1
    assert Problem(-3.0, -0.3, 1.0, 0.1).diagnose().unique_lam


def test_warm_start_at_the_solution_needs_no_iterations():
    given = frictional(4)
    first = solve(**given, tolerance=1e-9)
    for method in METHODS:
        again = solve(**given, method=method, initial=first.lam, tolerance=1e-8)
        assert again.iterations == 0
        np.testing.assert_allclose(again.lam, first.lam, atol=1e-9)


def test_tangents_without_friction_do_not_change_the_solution():
    given = frictional(5) | {"mu": 0.0, "previous": 0.0}
    with_tangents = solve(**given, dim=3)
    without = solve(given["K"], given["f"], given["G"][:, 0], given["d"])
    np.testing.assert_allclose(with_tangents.lam[:, 0], without.lam, atol=1e-13)
    np.testing.assert_array_equal(with_tangents.lam[:, 1:], 0.0)
    assert without.slip is None


# Batches


@pytest.mark.parametrize("method", METHODS)
def test_batch_of_problems_equals_single_problems(method):
    given = frictional(6, count=5)
    many = solve(**given, method=method)
    assert many.u.shape == (5, 9)
    assert many.lam.shape == (5, 3, 3)
    for k in range(5):
        one = solve(**given | {"f": given["f"][k], "d": given["d"][k]}, method=method)
        np.testing.assert_allclose(one.u, many.u[k], atol=1e-12)
        assert one.residual == pytest.approx(many.residual[k], abs=1e-12)


def test_any_argument_can_vary_by_problem():
    given = frictional(7)
    expected = solve(**given, tolerance=1e-12)
    for name in given:
        many = solve(**given | {name: np.stack([given[name]] * 3)}, tolerance=1e-12)
        assert many.converged.shape == (3,)
        np.testing.assert_allclose(many.lam, np.stack([expected.lam] * 3), atol=1e-12)


def test_sparse_stiffness_matches_dense_stiffness_for_many_loads():
    random = np.random.default_rng(8)
    K, loads = chain(300), 10.0 * random.normal(size=(20, 300))
    G = np.eye(300)[::40]
    d = 0.02 * np.ones(len(G))
    dense, thin = solve(K, loads, G, d), solve(sparse.csr_array(K), loads, sparse.coo_array(G), d)
    assert dense.converged.all()
    assert thin.converged.all()
    np.testing.assert_allclose(thin.lam, dense.lam, atol=1e-10 * np.abs(dense.lam).max())
    np.testing.assert_allclose(thin.u, dense.u, atol=1e-10 * np.abs(dense.u).max())


def test_three_axis_gap_matrix_is_read_by_dim():
    G = np.random.default_rng(9).normal(size=(2, 2, 4))
    f = np.ones(4)
    assert Problem(chain(), f, G, [0.1, 0.1]).count == 2
    assert Problem(chain(), f, G, [0.1, 0.1], dim=2).count is None
    assert Problem(chain(), f, G, [0.1, 0.1], mu=0.3).dim == 2
    assert Problem(chain(), f, G, [[0.1, 0.1]], mu=0.3).count == 1


def test_immovable_contact_is_open_or_unsolvable():
    G = np.eye(4)[:2] * [[1.0], [0.0]]
    for method in METHODS:
        assert solve(chain(), 100.0 * np.ones(4), G, [0.1, 0.1], method=method).converged
        assert not solve(chain(), 100.0 * np.ones(4), G, [0.1, -0.1], method=method, iterations=300).converged


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dim", [1, 3])
def test_immovable_contacts_have_no_solution(method, dim):
    q = np.array([[-1.0, 0.2, 0.0], [1.0, 0.0, 0.0]])[:, :dim]
    W, mu = np.zeros((2 * dim, 2 * dim)), 0.3 * (dim > 1)
    solution = solve_delassus(W, q if dim > 1 else q[:, 0], mu, method, iterations=50)
    assert not solution.converged
    assert solution.iterations <= 50
    assert np.isfinite(solution.lam).all()


def test_problem_without_contacts_is_solved():
    solution = solve(chain(), np.ones(4), np.zeros((0, 4)), np.zeros(0))
    np.testing.assert_allclose(solution.u, np.linalg.solve(chain(), np.ones(4)))
    assert solution.converged
    assert solution.lam.shape == (0,)
    for method in METHODS:
        empty = solve_delassus(np.zeros((0, 0)), np.zeros((0, 3)), 0.5, method)
        assert empty.converged
        assert empty.lam.shape == (0, 3)


# Invalid input

BAD = [
    ({"K": [[1.0, 2.0, 0.0]]}, "K must be of shape (n, n)"),
    ({"K": np.triu(chain())}, "K must be symmetric, got -1000 at [0, 1] and 0 at [1, 0]"),
    ({"K": np.stack([chain(), np.tril(chain())])}, "K[1] must be symmetric, got 0 at [0, 1] and -1000 at [1, 0]"),
    ({"K": sparse.csr_array(np.triu(chain()))}, "K must be symmetric, got -1000 at [0, 1] and 0 at [1, 0]"),
    ({"K": sparse.csr_array(chain() * np.diag([1.0, 1.0, np.inf, 1.0]))}, "K[2, 2] must be finite, got inf"),
    ({"K": sparse.csc_array((3, 4))}, "K must be square"),
    ({"K": chain() * np.nan}, "K[0, 0] must be finite, got nan"),
    ({"f": np.ones(3)}, "f must be of shape (n,) or (problems, n) with n = 4, got shape (3,)"),
    ({"f": ["a"] * 4}, "f must be numbers, got"),
    ({"f": [1.0, np.inf, 0.0, 0.0]}, "f[1] must be finite, got inf"),
    ({"d": np.ones(3)}, "G must be of shape (m, n)"),
    ({"G": np.eye(4)[:2, :3]}, "with m = 2 (from d) and n = 4 (from K), got shape (2, 3)"),
    ({"G": sparse.eye_array(4).tocsc()[:2], "mu": 0.3}, "(friction acts along tangents), got shape (2, 4)"),
    ({"dim": 2}, "with m = 2 (from d) and n = 4 (from K) and dim = 2, got shape (2, 4)"),
    ({"dim": True}, "dim must be 1, 2 or 3, or 0 to infer it from G, got True"),
    ({"K": np.zeros((0, 0))}, "K must have at least one displacement, got shape (0, 0)"),
    ({"K": sparse.csc_array(1j * chain())}, "K must be numbers, got a sparse matrix of complex128"),
    ({"f": np.ones((0, 4))}, "f must have at least one problem, got 0"),
    ({"mu": 0.3}, "G must be of shape (m, dim, n) with dim 2 or 3 if mu is not 0"),
    ({"mu": -0.1}, "mu must be finite and at least 0, got -0.1"),
    ({"mu": [0.0, 0.0, 0.0]}, "mu must be a number, or of shape (m,) or (problems, m) with m = 2"),
    ({"f": np.ones((2, 4)), "d": np.ones((3, 2))}, "must have the same number of problems, got f 2, d 3"),
    ({"method": "newton"}, "method must be one of 'enumeration', 'energy', 'projection', 'prox', 'gauss_seidel'"),
    ({"tolerance": 0.0}, "tolerance must be a number between 0 and 1, got 0.0"),
    ({"iterations": 0}, "iterations must be a whole number, at least 1 and at most 2147483647, got 0"),
    ({"iterations": 2**31, "method": "prox"}, "at least 1 and at most 2147483647, got 2147483648"),
    ({"device": "abacus"}, "device must be 'auto' or one of"),
    ({"iterations": 5, "method": "enumeration"}, "iterations must not be given with method 'enumeration'"),
    ({"initial": [0.0, 0.0], "method": "enumeration"}, "initial must not be given with method 'enumeration'"),
    ({"parameter": 1.0, "method": "energy"}, "parameter must not be given with method 'energy'"),
    ({"parameter": -1.0}, "parameter c must be a positive number, got -1.0"),
    ({"initial": [1.0]}, "initial must be of shape (m,) or (problems, m) with m = 2, got shape (1,)"),
]


@pytest.mark.parametrize(("change", "message"), BAD, ids=[re.sub(r"\W+", "_", text)[:40] for _, text in BAD])
def test_invalid_problem_arguments_are_refused(change, message):
    given = {"K": chain(), "f": np.ones(4), "G": np.eye(4)[:2], "d": [0.1, 0.2]}
    with pytest.raises(ValueError, match=re.escape(message)):
        solve(**given | change)


def test_enumeration_raises_for_unsupported_problems():
    with pytest.raises(ValueError, match="at most 16 contacts, got 17"):
        solve(chain(17), np.ones(17), np.eye(17), np.ones(17), method="enumeration")
    with pytest.raises(ValueError, match="infinitely many slip directions"):
        solve(**frictional(), method="enumeration")
    with pytest.raises(ValueError, match="a single problem only, got 5 problems"):
        Problem(**frictional(count=5)).all_solutions()


@pytest.mark.parametrize(
    ("W", "q", "mu", "message"),
    [
        (np.eye(3), np.ones(2), 0.0, "3 numbers per problem (rows of W), got shape (2,)"),
        (np.eye(3), np.ones(3), 0.5, "with friction (m, dim) with dim 2 or 3"),
        (np.triu(np.ones((2, 2))), np.ones(2), 0.0, "W must be symmetric"),
        (np.eye(2), [np.nan, 0.0], 0.0, "q[0] must be finite, got nan"),
    ],
)
def test_invalid_delassus_arguments_are_refused(W, q, mu, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        solve_delassus(W, q, mu)


# Files


@pytest.mark.parametrize("case", ["dense", "sparse", "many", "ambiguous", "frictionless"])
def test_problem_file_round_trips(case, tmp_path):
    given = frictional(10, count=4 if case == "many" else None, contacts=2, dim=2)
    if case == "sparse":
        given["K"] = sparse.csc_array(given["K"])
    if case == "ambiguous":
        given |= {"mu": 0.0, "dim": 2}
    if case == "frictionless":
        given |= {"mu": 0.0, "previous": 0.0, "G": given["G"][:, 0]}
    problem = Problem(**given)
    path = problem.save(tmp_path / "problem.npz")
    again = Problem.load(path)
    assert again.count == problem.count
    assert again.dim == (1 if case == "frictionless" else 2)
    np.testing.assert_array_equal(again.solve().lam, problem.solve().lam)
    for name in ("f", "G", "d", "mu", "previous"):
        np.testing.assert_array_equal(getattr(again, name), getattr(problem, name))


def test_invalid_problem_files_are_refused(tmp_path):
    problem = Problem(chain(), np.ones(4), np.eye(4)[:2], [0.1, 0.2])
    with pytest.raises(ValueError, match=r"path must end in \.npz"):
        problem.save(tmp_path / "problem.txt")
    with pytest.raises(FileNotFoundError, match="does not exist"):
        Problem.load(tmp_path / "missing.npz")
    good = problem.save(tmp_path / "good.npz")
    bad = tmp_path / "bad.npz"
    text, array = b"not an archive", io.BytesIO()
    np.save(array, np.ones(3))
    for content in (good.read_bytes()[:200], text, b"", array.getvalue()):
        bad.write_bytes(content)
        with pytest.raises(ValueError, match=r"bad\.npz cannot be read as a problem: it is not a NumPy archive"):
            Problem.load(bad)
    with np.load(good) as archive:
        entries = dict(archive)
    for change, message in [
        ({"kind": "else"}, "is not a problem file"),
        ({"schema": 2}, "schema must be 1, got 2: it was written by another version"),
        ({"schema": "1"}, "schema must be a whole number, got '1'"),
        ({"schema": None}, "lacks schema"),
        ({"f": None}, "lacks f"),
        ({"dim": 5}, "dim must be 1, 2 or 3, got 5"),
        ({"dim": 1.5}, "dim must be a whole number, got 1.5"),
        ({"dim": [1, 2]}, "dim must be a whole number, got an array of shape (2,)"),
        ({"K": np.triu(chain())}, "K must be symmetric"),
        ({"f": np.ones(3)}, "f must be of shape (n,)"),
        ({"f": [[np.nan]]}, "f[0, 0] must be finite, got nan"),
        ({"d": ["a", "b"]}, "d must be numbers, got text"),
        ({"G": np.ones((2, 4), dtype=bool)}, "G must be numbers, got truth values"),
        ({"mu": np.zeros(2, dtype="M8[s]")}, "mu must be numbers, got dates"),
    ]:
        with pytest.raises(ValueError, match=f"bad.npz.*{re.escape(message)}"):
            Problem.load(saved(bad, entries | change))
    np.savez(bad, **entries | {"f": np.array([{}], dtype=object)}, allow_pickle=True)
    with pytest.raises(ValueError, match="entry 'f' is damaged, or is not an array of numbers"):
        Problem.load(bad)


def saved(path, entries):
    """Writes the entries of an archive that are not ``None``."""
    np.savez(path, **{name: value for name, value in entries.items() if value is not None})
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K_data": np.ones(3)}, "K_indptr must go from 0 to 3 (size of K_data), got 0 to 10"),
        ({"K_data": ["a"] * 10}, "K_data must be numbers, got text"),
        ({"K_data": np.ones((5, 2))}, "K_data must be a list of numbers, got float64 of shape (5, 2)"),
        ({"K_indices": np.arange(10)}, "K_indices[4] must be at least 0 and less than 4, got 4"),
        ({"K_indices": -np.ones(10, int)}, "K_indices[0] must be at least 0 and less than 4, got -1"),
        ({"K_indices": np.arange(3)}, "K_indices must have 10 values (size of K_data), got 3"),
        ({"K_indices": np.ones(10)}, "K_indices must be a list of whole numbers, got float64 of shape (10,)"),
        ({"K_indptr": [0, 10]}, "K_indptr must have 5 values (from K_shape), got 2"),
        ({"K_indptr": [0, 5, 2, 7, 10]}, "K_indptr[2] must be at least 5 (previous value), got 2"),
        ({"K_shape": [4, 3]}, "K_shape must be (n, n) with n at least 1, got [4, 3]"),
        ({"K_shape": [4.0, 4.0]}, "K_shape must be a list of whole numbers, got float64 of shape (2,)"),
        ({"K_shape": None}, "lacks K_shape"),
    ],
)
def test_sparse_matrices_in_problem_files_are_validated(change, message, tmp_path):
    K = sparse.csc_array(chain())
    good = Problem(K, np.ones(4), np.eye(4)[:2], [0.1, 0.2]).save(tmp_path / "good.npz")
    with np.load(good) as archive:
        entries = dict(archive)
    assert len(entries["K_data"]) == 10
    with pytest.raises(ValueError, match=re.escape(f"bad.npz: {message}".replace(": lacks", " lacks"))):
        Problem.load(saved(tmp_path / "bad.npz", entries | change))


def test_changed_byte_in_a_problem_file_is_detected(tmp_path):
    path = Problem(chain(), np.ones(4), np.eye(4)[:2], [0.1, 0.2]).save(tmp_path / "problem.npz")
    with zipfile.ZipFile(path) as archive:
        start = archive.getinfo("f.npy").header_offset
    data = bytearray(path.read_bytes())
    data[start + 60] ^= 0xFF
    path.write_bytes(bytes(data))
    with pytest.raises(ValueError, match=r"problem\.npz cannot be read as a problem: entry 'f' is damaged"):
        Problem.load(path)


# Diagnosis


def test_regular_problem_without_friction_has_one_solution():
    diagnosis = Problem(chain(), np.ones(4), np.eye(4)[:2], [0.1, 0.2]).diagnose()
    assert (diagnosis.exists, diagnosis.unique_u, diagnosis.unique_lam) == (True, True, True)
    assert diagnosis.stiffness == "positive definite"
    assert diagnosis.rank == 2
    assert "λ is unique." in str(diagnosis)


def test_coincident_walls_have_a_unique_total_force_only():
    problem = Problem(chain(), 50.0 * np.ones(4), np.eye(4)[[3, 3]], [0.1, 0.1])
    diagnosis = problem.diagnose()
    assert diagnosis.rank == 1
    assert diagnosis.unique_u
    assert diagnosis.unique_lam is not True
    assert diagnosis.unique_sum([1, 1])
    assert not diagnosis.unique_sum([1, 0])
    sums = [problem.solve(method).lam.sum() for method in METHODS]
    np.testing.assert_allclose(sums, sums[0], rtol=1e-8)
    with pytest.raises(ValueError, match="weights must be 2 numbers"):
        diagnosis.unique_sum([1.0])


def test_conflicting_walls_have_no_solution():
    # u ≤ −0.1 and u ≥ 0.1.
    problem = Problem(1000.0 * np.eye(1), [0.0], [[1.0], [-1.0]], [-0.1, -0.1])
    diagnosis = problem.diagnose()
    assert diagnosis.exists is False
    assert "There is no solution." in str(diagnosis)
    for method in METHODS:
        assert not problem.solve(method, iterations=500).converged


def test_friction_of_two_feet_has_a_unique_sum_only():
    # The mass matrix instead of K, accelerations instead of displacements: G = −H.
    H = np.array([[0, 1, -0.5], [1, 0, 1.0], [0, 1, 0.5], [1, 0, 1.0]])
    K = np.diag([10.0, 10.0, 10.0 * 5.0 / 12.0])
    problem = Problem(K, [20.0, -98.1, 0.0], -H.reshape(2, 2, 3), np.zeros(2), mu=0.5)
    diagnosis = problem.diagnose()
    assert diagnosis.rank == 3
    assert diagnosis.mu_bound == 0.0
    assert diagnosis.unique_sum([0, 1, 0, 1])
    assert diagnosis.unique_sum([1, 0, 0, 0])
    assert not diagnosis.unique_sum([0, 1, 0, 0])
    assert diagnosis.exists
    np.testing.assert_allclose(problem.solve().lam.sum(axis=0), [98.1, -20.0], atol=1e-8)


def test_friction_below_the_bound_has_one_solution():
    random = np.random.default_rng(11)
    for _ in range(20):
        given = frictional(random.integers(1 << 30), contacts=3, dim=2)
        bound = Problem(**given).diagnose().mu_bound
        problem = Problem(**given | {"mu": 0.99 * bound})
        diagnosis = problem.diagnose()
        assert (diagnosis.exists, diagnosis.unique_u, diagnosis.unique_lam) == (True, True, True)
        assert len(problem.all_solutions()) == 1


def test_large_friction_can_have_several_solutions():
    # W = [[1, 0.9], [0.9, 1]] and q = (0.2, 1): open, λ = 0; sticking, λ = −W⁻¹ q; or slipping with λ_t = −2 λ_n.
    # When slipping, friction adds more pressure than separation removes: 0.2 + (1 − 1.8) λ_n = 0.
    K = np.linalg.inv([[1.0, 0.9], [0.9, 1.0]])
    problem = Problem(K, [0.0, 0.0], np.eye(2)[None], [0.2], mu=2.0, previous=1.0)
    solutions = sorted(problem.all_solutions(), key=lambda one: one.lam[0, 0])
    np.testing.assert_allclose(solutions[0].lam, [[0.0, 0.0]])
    np.testing.assert_allclose(solutions[1].lam, [[0.25, -0.5]])
    np.testing.assert_allclose(solutions[2].lam, -(K @ [0.2, 1.0])[None])
    assert [one.status[0] for one in solutions] == [wc.ContactMode.OPEN, wc.ContactMode.SLIP, wc.ContactMode.STICK]
    diagnosis = problem.diagnose()
    assert diagnosis.mu_bound < 2.0
    assert (diagnosis.exists, diagnosis.unique_u, diagnosis.unique_lam) == (True, False, False)
    assert "3 different solutions were found." in str(diagnosis)
    for method in ("enumeration", *METHODS):
        solution = problem.solve(method)
        assert solution.converged
        assert any(np.allclose(solution.lam, one.lam, atol=1e-8) for one in solutions)


@pytest.mark.parametrize("k", [0.0, -1000.0])
def test_non_positive_stiffness_is_diagnosed_by_enumeration(k):
    problem = Problem(k, 5.0, 1.0, 0.01)
    diagnosis = problem.diagnose()
    assert diagnosis.exists
    assert diagnosis.stiffness == ("singular" if k == 0.0 else "indefinite")
    best = problem.solve("enumeration")
    assert best.converged
    np.testing.assert_allclose(k * best.u + best.lam, 5.0, atol=1e-12)
    assert not Problem(0.0, -5.0, 1.0, 0.01).diagnose().exists
    assert not Problem(0.0, -5.0, 1.0, 0.01).solve("enumeration").converged


def test_unopposed_load_has_no_solution():
    # The contact does not act on u, or there is none.
    for G, d in ((0.0, 1.0), (np.zeros((0, 1)), [])):
        solution = Problem(0.0, 5.0, G, d).solve("enumeration")
        assert solution.termination == wc.unilateral.Termination.UNBOUNDED
        # None of the load is balanced.
        assert solution.residual == pytest.approx(1.0)
        assert Problem(0.0, 5.0, G, d).all_solutions() == []


def test_contact_with_tangents_without_friction_is_frictionless():
    solution = solve_delassus(np.eye(3), [[-1.0, 2.0, 0.0]])
    np.testing.assert_allclose(solution.lam, [[1.0, 0.0, 0.0]])
    assert solution.status.tolist() == [wc.ContactMode.SLIP]
