"""Fits growth of a cost: exponents of power laws, and increase per decade."""

import numpy as np
from numpy.typing import ArrayLike


def exponent(values: ArrayLike, costs: ArrayLike) -> float:
    """Returns k of the power law cost ∝ valueᵏ, the slope of a straight line in log-log; 1: linear growth.

    Args:
        values: At least two different positive numbers.
        costs: The cost at each, positive.
    """
    return float(np.polyfit(np.log(_of(values, costs)), np.log(np.asarray(costs, dtype=float)), 1)[0])


def upper_exponent(values: ArrayLike, costs: ArrayLike) -> float:
    """Returns the exponent over the upper half of ``values`` in log, where constant costs have less effect."""
    x, y = _of(values, costs), np.asarray(costs, dtype=float)
    upper = x >= np.sqrt(x.min() * x.max()) * (1.0 - 1e-9)
    if len(set(x[upper])) < 2:
        upper = x >= np.partition(x, -2)[-2]
    return exponent(x[upper], y[upper])


def per_decade(values: ArrayLike, costs: ArrayLike) -> tuple[float, float]:
    """Returns the increase of the cost per decade of the value, and the quality of the fit.

    Returns:
        The slope b of the line cost = a + b·log₁₀(value), and its R²; 1 if the cost is constant.
    """
    x, y = np.log10(_of(values, costs)), np.asarray(costs, dtype=float)
    line = np.polyfit(x, y, 1)
    around = np.sum((y - y.mean()) ** 2)
    left = np.sum((y - np.polyval(line, x)) ** 2)
    return float(line[0]), float(1.0 - left / around) if around > 0.0 else 1.0


def _of(values: ArrayLike, costs: ArrayLike) -> np.ndarray:
    """Validates and returns ``values`` as an array."""
    x, y = np.asarray(values, dtype=float), np.asarray(costs, dtype=float)
    if x.shape != y.shape or len(set(x)) < 2 or not (x > 0).all() or not (y > 0).all():
        raise ValueError(f"a fit needs two or more positive values and their costs, got {values!r} and {costs!r}")
    return x
