"""Stiffness of elliptic Hertz contacts on the device, from complete elliptic integrals.

An ellipse of axis ratio k ≥ 1, m = 1 − 1/k², has the integrals K and E of parameter m, and

    D = (K − E)/m,  B = K − D,  S = (D − B)/(m K).

The arithmetic-geometric mean gives all of them without differences of nearly equal numbers.
"""

from typing import Any

import warp as wp

#: Largest ratio of the principal curvatures; larger ratios are replaced by this one.
LONGEST = 1.0e6


@wp.func
def integrals(axis_ratio: Any):
    """Returns K, E, B, D and S of an ellipse; see the module docstring."""
    one = type(axis_ratio)(1.0)
    half = type(axis_ratio)(0.5)
    b = one / axis_ratio
    m = (one - b) * (one + b)
    # c_n²/m², with c_n the half difference of the n-th pair; c₀² = m.
    a = half * (one + b)
    b = wp.sqrt(b)
    weight = one + one
    term = one / (type(axis_ratio)(16.0) * a * a)
    S = weight * term
    for _i in range(6):  # sufficient in float64 for start values as different as 1 and 1e-5
        mean = half * (a + b)
        b = wp.sqrt(a * b)
        a = mean
        weight = weight + weight
        term = term * term * m * m / (type(axis_ratio)(16.0) * a * a)
        S = S + weight * term
    K = half * type(axis_ratio)(wp.pi) / a
    D = half * K * (one + m * S)
    B = half * K * (one - m * S)
    return K, K - m * D, B, D, S


@wp.func
def axis_ratio_of(quotient: Any):
    """Returns the axis ratio k of the contact ellipse for a ratio ``quotient`` ≥ 1 of principal curvatures.

    Solves B k²/D = quotient by Newton's method in ln k, in which the equation is nearly linear: its slope lies
    between 3/2 and 2.
    """
    one = type(quotient)(1.0)
    target = wp.log(quotient)
    log_ratio = type(quotient)(0.6) * target
    for _i in range(5):
        k = wp.exp(log_ratio)
        K, _E, B, D, S = integrals(k)
        slope = one + K * S * (one / (k * k * B) + one / D)
        log_ratio = log_ratio - (log_ratio + log_ratio + wp.log(B / D) - target) / slope
        log_ratio = wp.max(log_ratio, type(quotient)(0.0))
    return wp.exp(log_ratio)


@wp.func
def stiffness_per_modulus(curvature_1: Any, curvature_2: Any):
    """Returns K/E* of N = K δ^1.5 [√m] from the relative principal curvatures, curvature_1 ≤ curvature_2 [1/m].

    NaN unless curvature_2 is positive and finite. curvature_1 is limited to curvature_2/LONGEST, as for a line
    contact or a saddle.
    """
    zero = type(curvature_1)(0.0)
    one = type(curvature_1)(1.0)
    least = curvature_2 / type(curvature_1)(LONGEST)
    low = wp.where(curvature_1 < least, least, curvature_1)
    k = axis_ratio_of(wp.max(curvature_2 / low, one))
    K, E, _B, _D, _S = integrals(k)
    # δ = K(m) [9/(2 E(m) R) (F/(2 π k E*))²]^(1/3), 1/R the sum of the curvatures.
    size = type(curvature_1)(2.0) * E / (type(curvature_1)(9.0) * (low + curvature_2))
    stiffness = type(curvature_1)(2.0) * type(curvature_1)(wp.pi) * k * wp.sqrt(size) / (K * wp.sqrt(K))
    # A comparison with NaN is false.
    if curvature_2 > zero and one / curvature_2 > zero:
        return stiffness
    return type(curvature_1)(wp.NAN)
