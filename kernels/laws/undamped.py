"""Undamped impact on N = K δⁿ: penetration, duration and force, for the choice of time step and stiffness."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from warpcontact.kernels.catalogue.device_model import as_numbers, number
from warpcontact.kernels.catalogue.keywords import explain_keywords


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
