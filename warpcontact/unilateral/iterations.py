"""Iterative methods on the device: "prox", "gauss_seidel" and "energy"."""

import functools
from collections.abc import Callable

import numpy as np

from warpcontact.unilateral.delassus import Delassus
from warpcontact.validation.checks import Array

#: Maximum number of matrix entries of all problems in one launch; limits memory.
_ENTRIES = 50_000_000
# Forces relative to the scale of the problem above which the iteration has diverged.
_FARTHEST = 1e100


def iterate(
    method: str,
    problem: Delassus,
    lam: Array,
    tolerance: float,
    iterations: int,
    parameter: float | None,
    device: str,
) -> tuple[Array, Array]:
    """Returns l and the number of iterations of each problem; l is 0 if the iteration diverged."""
    found, iteration_counts = np.empty_like(lam), np.zeros(problem.count, dtype=int)
    rows = max(problem.contacts * problem.dim, 1)
    size = max(_ENTRIES // rows**2, 1)
    for start in range(0, problem.count, size):
        part = np.arange(start, min(start + size, problem.count))
        found[part], iteration_counts[part] = _launch(
            method, problem.part(part), lam[part], tolerance, iterations, parameter, device
        )
    # The iteration diverges if W is not positive semidefinite.
    found[~(np.abs(found).max(axis=(1, 2), initial=0.0) < _FARTHEST * problem.scale)] = 0.0
    return found, iteration_counts


def _launch(
    method: str,
    problem: Delassus,
    lam: Array,
    tolerance: float,
    iterations: int,
    parameter: float | None,
    device: str,
) -> tuple[Array, Array]:
    import warp as wp

    from warpcontact.kernels.nonsmooth import dense

    count, contacts, dim = problem.q.shape
    device_field = functools.partial(wp.array, dtype=wp.float64, device=device)
    p = dense.Dense()
    p.W, p.mu, p.rho = device_field(problem.W), device_field(problem.mu), device_field(problem.rho)
    p.q, p.unit = device_field(problem.q.reshape(count, -1)), device_field(problem.unit)
    p.lam = device_field(lam.reshape(count, -1))
    p.w, p.extrapolated = wp.empty_like(p.q), wp.empty_like(p.q)
    p.step, p.shift = (wp.empty((count, contacts), dtype=wp.float64, device=device) for _ in range(2))
    p.residual = wp.empty(count, dtype=wp.float64, device=device)
    p.iterations = wp.empty(count, dtype=wp.int32, device=device)
    kernels: dict[str, Callable[[int], wp.Kernel]] = {
        "prox": dense.prox,
        "gauss_seidel": dense.gauss_seidel,
        "energy": dense.energy,
    }
    if parameter is not None:
        p.step.fill_(parameter)
    elif method != "gauss_seidel":
        wp.launch(dense.steps(dim), count, inputs=[p], device=device)
    wp.launch(kernels[method](dim), count, inputs=[p, tolerance, iterations], device=device)
    return p.lam.numpy().reshape(lam.shape), p.iterations.numpy().astype(int)
