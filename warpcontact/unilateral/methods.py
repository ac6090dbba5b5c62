"""Solution methods by name, checks of their options, and their execution for problems in W and q."""

import math
from typing import Any

import numpy as np

from warpcontact.system.devices import find_device
from warpcontact.unilateral.delassus import Delassus
from warpcontact.unilateral.enumeration import check_size, enumerate_states
from warpcontact.unilateral.iterations import iterate
from warpcontact.unilateral.newton import newton
from warpcontact.validation.checks import Array, choice

#: Default maximum number of iterations.
ITERATIONS = {"enumeration": 0, "energy": 50_000, "projection": 600, "prox": 100_000, "gauss_seidel": 20_000}
# Iterations are counted in 32 bits.
_MAX_ITERATIONS = 2**31 - 1
#: Methods with a parameter, and its name.
PARAMETERS = {"projection": "c", "prox": "r"}


def run(
    system: Delassus,
    method: str,
    tolerance: float,
    iterations: int | None,
    initial: Array | None,
    parameter: float | None,
    device: str,
) -> tuple[Array, Array]:
    """Returns l, shape (problems, contacts, dim), and the number of iterations, (problems,)."""
    check_options(method, tolerance, iterations, parameter)
    if device != "cpu":
        device = str(find_device(device))
    if system.dim > 1 and not system.mu.any():
        normals = None if initial is None else initial[..., :1]
        lam, iteration_counts = run(system.normals(), method, tolerance, iterations, normals, parameter, device)
        return np.concatenate([lam, np.zeros(system.q[..., 1:].shape)], axis=-1), iteration_counts
    if method == "enumeration":
        if initial is not None:
            raise ValueError("initial must not be given with method 'enumeration'")
        check_size(system.contacts, system.dim)
    lam = np.zeros(system.q.shape) if initial is None else np.array(initial)
    if not system.contacts or not system.count:
        return lam, np.zeros(system.count, dtype=int)
    if method == "enumeration":
        return enumerate_states(system, tolerance)
    max_iterations = ITERATIONS[method] if iterations is None else iterations
    # The residual here rounds differently from that of the methods.
    if method == "projection":
        return newton(system, lam, 0.5 * tolerance, max_iterations, parameter, device)
    return iterate(method, system, lam, 0.5 * tolerance, max_iterations, parameter, device)


def check_options(method: Any, tolerance: Any, iterations: Any, parameter: Any) -> None:
    """Raises ``ValueError`` if an option of a solution method is not valid."""
    choice("method", method, tuple(ITERATIONS))
    if not _is_number(tolerance) or not 0.0 < tolerance < 1.0:
        raise ValueError(f"tolerance must be a number between 0 and 1, got {tolerance!r}")
    if iterations is not None:
        if method == "enumeration":
            raise ValueError(f"iterations must not be given with method 'enumeration', got {iterations!r}")
        is_integer = isinstance(iterations, int | np.integer) and not isinstance(iterations, bool)
        if not is_integer or not 1 <= iterations <= _MAX_ITERATIONS:
            raise ValueError(
                f"iterations must be a whole number, at least 1 and at most {_MAX_ITERATIONS}, got {iterations!r}"
            )
    if parameter is not None:
        if method not in PARAMETERS:
            raise ValueError(f"parameter must not be given with method {method!r}, got {parameter!r}")
        if not _is_number(parameter) or not 0.0 < parameter < math.inf:
            raise ValueError(f"parameter {PARAMETERS[method]} must be a positive number, got {parameter!r}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)
