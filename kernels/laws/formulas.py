"""Functions that several laws use: powers, dashpots in steps, roots, and undamped impacts.

Penetration, duration and force of an undamped impact on N = K δⁿ help to choose the stiffness and the time step.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray
from warpcontact.kernels.catalogue.device_model import as_numbers, number
from warpcontact.kernels.catalogue.keywords import explain_keywords

Values = NDArray[np.float64]

# Sufficient for bisection of any float64 interval.
MAX_ITERATIONS = 2100
# Relative tolerance of a root, and the magnitude that counts as zero.
PRECISION = 4.0 * float(np.finfo(np.float64).eps)
SMALLEST = float(np.finfo(np.float64).smallest_normal)


@wp.func
def power(x: float, exponent: float):
    """Returns x^exponent for x ≥ 0; exponents 1 and 1.5 are computed without ``pow``."""
    if exponent == 1.0:
        return x
    if exponent == 1.5:
        return x * wp.sqrt(x)
    return wp.pow(x, exponent)


@wp.func
def power(x: wp.float64, exponent: wp.float64):  # noqa: F811  an overload
    """Returns x^exponent in float64."""
    if exponent == wp.float64(1.0):
        return x
    if exponent == wp.float64(1.5):
        return x * wp.sqrt(x)
    return wp.pow(x, exponent)


@wp.func
def stepped_dashpot(damping: Any, inverse_mass: Any, dt: Any):
    """Returns the dashpot constant that in steps of ``dt`` damps like ``damping`` in continuous time."""
    # The velocity of a step lags its position by half a step, v = v(t) + ½ dt N/m. Solved for N, the step acts
    # with K and c both divided by 1 − c dt/(2m), that is, with the damping ratio ξ/√(1 − c dt/(2m)). The dashpot
    # c' = c (√(1 + y²) − y), y = c dt/(4m), has the damping ratio ξ and thus the restitution. See ``KelvinVoigt``.
    y = type(dt)(0.25) * damping * dt * inverse_mass
    return damping * (wp.sqrt(type(dt)(1.0) + y * y) - y)


@explain_keywords
def greatest_penetration(
    stiffness: ArrayLike, exponent: ArrayLike, mass: ArrayLike, speed: ArrayLike
) -> NDArray[np.float64]:
    """Returns the largest penetration [m] of an impact: ½ m v² = K δⁿ⁺¹/(n+1). Damping reduces it.

    Args:
        stiffness: K [N/mⁿ].
        exponent: n [-].
        mass: Effective mass m, m₁m₂/(m₁+m₂) of two bodies [kg].
        speed: Approach speed v [m/s].

    Raises:
        ValueError: If an argument is not a number.
    """
    given = {"stiffness": stiffness, "exponent": exponent, "mass": mass, "speed": speed}
    for name, value in given.items():
        if as_numbers(value) is None:
            raise ValueError(f"{name} must be numbers, got {value!r}")
    n = np.asarray(exponent, dtype=np.float64)
    return np.asarray(
        ((n + 1) * np.asarray(mass) * np.square(speed) / (2 * np.asarray(stiffness))) ** (1 / (n + 1))
    )


@explain_keywords
def contact_time(
    stiffness: ArrayLike, exponent: ArrayLike, mass: ArrayLike, speed: ArrayLike
) -> NDArray[np.float64]:
    """Returns the duration [s] of an impact: π √(m/K) for n = 1. Arguments: ``greatest_penetration``."""
    depth = greatest_penetration(stiffness, exponent, mass, speed)
    # Γ of each distinct exponent with math.gamma: importing SciPy takes longer than building a model.
    exponents, which = np.unique(np.asarray(exponent, dtype=np.float64), return_inverse=True)
    parts = [1.0 / (n + 1.0) if n > -1.0 else math.nan for n in exponents.tolist()]
    factors = [2.0 * math.sqrt(math.pi) * math.gamma(1.0 + part) / math.gamma(0.5 + part) for part in parts]
    factor = np.array(factors)[which].reshape(np.shape(exponent))
    return np.asarray(factor * depth / np.asarray(speed))


@explain_keywords
def greatest_force(
    stiffness: ArrayLike, exponent: ArrayLike, mass: ArrayLike, speed: ArrayLike
) -> NDArray[np.float64]:
    """Returns the largest force [N] of an impact. For the arguments see ``greatest_penetration``."""
    depth = greatest_penetration(stiffness, exponent, mass, speed)
    return np.asarray(np.asarray(stiffness) * depth ** np.asarray(exponent))


@explain_keywords
def recommended_dt(
    stiffness: ArrayLike, exponent: ArrayLike, mass: ArrayLike, speed: ArrayLike, steps: float = 20.0
) -> NDArray[np.float64]:
    """Returns a time step [s] with ``steps`` per contact time; 20 steps keep the restitution to 1e-3.

    Use the smallest mass, the largest stiffness and the highest speed that will occur. For the other arguments see
    ``greatest_penetration``.

    Example:
        >>> float(wc.laws.recommended_dt(stiffness=1e5, exponent=1.0, mass=0.1, speed=1.0).round(6))
        0.000157
    """
    return np.asarray(contact_time(stiffness, exponent, mass, speed) / number("steps", steps, above=0.0))


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
        invalid = ~(np.sign(f1) * np.sign(f2) <= 0.0)
        a, b, at_a, at_b = (of[invalid][0] for of in np.broadcast_arrays(x1, x2, f1, f2))
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
