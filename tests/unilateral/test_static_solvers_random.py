"""Random static problems: each is solved or reported as not converged."""

import numpy as np
import pytest
from contact_problems import problems, violation

import warpcontact as wc

SIZES = {1: 300, 2: 300, 4: 300, 8: 200, 16: 100, 32: 40, 64: 16}
# Allowed shares of unsolved problems; with strong coupling, gauss_seidel cycles in some.
UNSOLVED = {"projection": 0.01, "prox": 0.02, "energy": 0.1, "gauss_seidel": 0.1}


def check(method, count, contacts, dim, freedoms, device, seed=1, shared=1):
    """Solves random problems and returns the share of unsolved ones."""
    W, q, mu = problems(seed, count, contacts, dim, freedoms, shared=shared)
    solution = wc.unilateral.solve_delassus(
        W[0] if shared == count else W, q[..., 0] if dim == 1 else q, mu, method, tolerance=1e-8, device=device
    )
    lam = solution.lam.reshape(q.shape)
    np.testing.assert_array_equal(solution.converged, solution.residual <= 1e-8)
    # One measure is in forces, the other in velocities; the mobility of contacts varies by a factor of a hundred.
    assert violation(W, q, mu, lam)[solution.converged].max(initial=0.0) < 1e-6
    return 1.0 - solution.converged.mean()


@pytest.mark.parametrize("contacts", SIZES)
@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("freedoms", [1.5, 0.75], ids=["regular", "hyperstatic"])
def test_projection_method_solves_almost_all_random_problems(freedoms, dim, contacts, device):
    assert check("projection", SIZES[contacts], contacts, dim, freedoms, device) <= UNSOLVED["projection"]


@pytest.mark.parametrize("contacts", [1, 2, 4, 8, 16])
@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.parametrize("method", ["energy", "prox", "gauss_seidel"])
def test_other_methods_solve_most_random_problems(method, dim, contacts, device):
    assert check(method, 60, contacts, dim, 1.5, device) <= UNSOLVED[method]


@pytest.mark.slow
@pytest.mark.parametrize("contacts", SIZES)
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_projection_method_solves_many_random_problems_of_each_size(dim, contacts, times, device):
    """2000, or 10 000 with --thorough."""
    missed = []
    # Groups of 250 large problems share W, because making as many matrices would take longer than solving.
    count, shared = (250, 250) if contacts >= 32 else (1000, 1)
    for seed in range(2000 * times // count):
        missed.append(check("projection", count, contacts, dim, 1.0, device, seed, shared))
    print(f"{contacts} contacts of {dim} rows: {np.sum(missed) * count:.0f} of {2000 * times} not solved")
    assert np.mean(missed) < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("contacts", [32, 64])
@pytest.mark.parametrize("method", ["energy", "prox", "gauss_seidel"])
def test_other_methods_solve_most_large_random_problems(method, contacts, device):
    assert check(method, 40, contacts, 3, 1.5, device) <= UNSOLVED[method]


@pytest.mark.parametrize("contacts", [1, 2, 4, 8])
@pytest.mark.parametrize("dim", [1, 2, 3])
def test_all_methods_agree_if_the_solution_is_unique(dim, contacts, device):
    W, q, mu = problems(5, 40, contacts, dim, 3.0)
    # Below this friction the solution is unique.
    block = np.einsum("biaia->bi", W.reshape(-1, contacts, dim, contacts, dim)) / dim
    metric = np.repeat(1.0 / np.sqrt(block), dim, axis=1)
    condition = np.linalg.cond(metric[:, :, None] * W * metric[:, None, :])
    mu = 0.5 * mu * 0.99 / np.sqrt(condition)[:, None]
    if dim == 1:
        q, mu = q[..., 0], 0.0
    methods = ["projection", "energy", "prox", "gauss_seidel"]
    if dim < 3 and contacts <= 4:
        methods.append("enumeration")
    found = [wc.unilateral.solve_delassus(W, q, mu, method, tolerance=1e-12, device=device) for method in methods]
    size = np.abs(found[0].lam).max()
    for solution in found:
        assert solution.converged.all()
        # The residual over the smallest eigenvalue, a factor of at most 1e3 here.
        np.testing.assert_allclose(solution.lam, found[0].lam, atol=1e-9 * size)


@pytest.mark.parametrize("method", ["projection", "gauss_seidel"])
def test_problem_alone_has_the_solution_it_has_in_a_batch(method, device):
    W, q, mu = problems(6, 200, 4, 2, 0.75)
    many = wc.unilateral.solve_delassus(W, q, mu, method, device=device)
    # The problems with the most iterations, where Newton's method restarted, and some others.
    for k in [*np.argsort(many.iterations)[-5:], *range(5)]:
        one = wc.unilateral.solve_delassus(W[k], q[k], mu[k], method, device=device)
        np.testing.assert_allclose(one.lam, many.lam[k], atol=1e-12 * np.abs(one.lam).max(initial=1.0))
        assert one.iterations == many.iterations[k]
