"""Roots of elementwise functions of one variable, vectorized."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

Values = NDArray[np.float64]

# Sufficient for bisection of any float64 interval.
MAX_ITERATIONS = 2100
# Relative tolerance of a root, and the magnitude that counts as zero.
PRECISION = 4.0 * float(np.finfo(np.float64).eps)
SMALLEST = float(np.finfo(np.float64).smallest_normal)


def root_between(what: str, function: Callable[[Values], Values], lower: ArrayLike, upper: ArrayLike) -> Values:
    """Returns the roots of a continuous elementwise function, to rounding, by Chandrupatla's method.

    A step uses inverse quadratic interpolation where it is safe, otherwise bisection (Adv. Eng. Softw. 28 (1997)
    145). ``scipy.optimize.elementwise`` does the same, but its import takes as long as building a model.

    Args:
        what: Name of the root, for the message.
        function: Function of an array of the broadcast shape of the ends.
        lower: Ends of the intervals.
        upper: Other ends, where the function has the opposite sign or is zero.

    Raises:
        RuntimeError: If the signs are equal, or the function is not finite.
    """
    x1, x2 = (np.array(ends, dtype=np.float64) for ends in np.broadcast_arrays(lower, upper))
    f1, f2 = function(x1), function(x2)
    if not np.all(np.sign(f1) * np.sign(f2) <= 0.0):
        bad = ~(np.sign(f1) * np.sign(f2) <= 0.0)
        a, b, at_a, at_b = (of[bad][0] for of in np.broadcast_arrays(x1, x2, f1, f2))
        raise RuntimeError(
            f"no {what} found between {a:g} and {b:g}: the values there are {at_a:g} and {at_b:g}, and must have "
            "different signs"
        )
    x3, f3 = x2, f2
    roots = np.full(x1.shape, np.nan)
    # Converged entries are iterated further; their results are ignored.
    with np.errstate(all="ignore"):
        for _ in range(MAX_ITERATIONS):
            closer = np.abs(f1) < np.abs(f2)
            x, f = np.where(closer, x1, x2), np.where(closer, f1, f2)
            width, tolerance = np.abs(x2 - x1), np.abs(x) * PRECISION + 4.0 * SMALLEST
            found = (np.abs(f) <= SMALLEST) | (width < tolerance)
            roots = np.where(np.isnan(roots) & found, x, roots)
            if not np.isnan(roots).any():
                return roots
            across, along = (x1 - x2) / (x3 - x2), (f1 - f2) / (f3 - f2)
            safe = (1.0 - np.sqrt(1.0 - across) < along) & (along < np.sqrt(across))
            parabola = f1 / (f1 - f2) * f3 / (f3 - f2)
            parabola -= (x3 - x1) / (x2 - x1) * f1 / (f3 - f1) * f2 / (f2 - f3)
            part = 0.5 * tolerance / width
            x = x1 + np.clip(np.where(safe, parabola, 0.5), part, 1.0 - part) * (x2 - x1)
            f = function(x)
            same = np.sign(f) == np.sign(f1)
            x3, f3 = np.where(same, x1, x2), np.where(same, f1, f2)
            x2, f2 = np.where(same, x2, x1), np.where(same, f2, f1)
            x1, f1 = x, f
    raise RuntimeError(f"no {what} found: a value between is not finite")
