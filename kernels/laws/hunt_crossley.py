"""Hunt–Crossley damping with exact prescribed restitution."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.catalogue.roots import root_between
from warpcontact.kernels.laws.base import Law, power

# For 1 − e below this the series of d is more accurate than the root of its equation.
SERIES_RANGE = 2.0e-3


def restitution_of_damping_factor(factor: np.ndarray) -> np.ndarray:
    """Returns the restitution e of N = f(δ)(1 + d δ̇/v₀) in a free impact, from d ≥ 0, for any elastic function f.

    e = [1 + W₀(−(1+d) exp(−(1+d)))]/d.
    """
    from scipy.special import lambertw  # slow to import, rarely needed

    factor = np.asarray(factor, dtype=np.float64)
    safe = np.maximum(factor, 1.0e-8)  # below, e = 1 − 2d/3 is exact to the digits that W provides
    with np.errstate(divide="ignore"):
        exact = (1.0 + np.real(lambertw(-(1.0 + safe) * np.exp(-(1.0 + safe))))) / safe
    return np.where(factor < 1.0e-4, 1.0 - 2.0 * factor / 3.0 + factor**2 * 4.0 / 9.0, exact)


def damping_factor_of_restitution(restitution: np.ndarray) -> np.ndarray:
    """Returns the damping factor d for restitution 0 < e ≤ 1 in a free impact: d (1 + e) = ln[(1 + d)/(1 − d e)].

    Solved for u = ln(1 − d e), which is free of cancellation for small e. Near e = 1 the equation degenerates to 0
    = 0, and a series in q = 1 − e is used; the two agree to 1e-9 at the transition.
    """
    e = np.asarray(restitution, dtype=np.float64)
    q = 1.0 - e
    series = q * (1.5 + q * (1.5 + q * (1.35 + q * 1.2)))

    # The other root is u = 0. Half the series is a start value with excess > 0; far below, excess → u.
    far_from_one = np.minimum(e, 1.0 - SERIES_RANGE)
    upper = np.log1p(-0.75 * (1.0 - far_from_one) * far_from_one)
    lower = -2.0 - 1.0 / far_from_one

    def excess(u: np.ndarray) -> np.ndarray:
        d = -np.expm1(u) / far_from_one
        return u - np.log1p(d) + d * (1.0 + far_from_one)

    return np.where(q < SERIES_RANGE, series, -np.expm1(root_between("damping factor", excess, lower, upper)) / e)


class HuntCrossley(Law):
    """Power-law spring with damping that vanishes at the start and end of contact; no tension in a free impact.

    With ``restitution`` the factor d is the exact root of d(1+e) = ln[(1+d)/(1−de)], and v₀ is the entry speed of
    this contact, at least ``speed_floor``. Below that speed an impact dissipates less than prescribed, and the
    damping of a body placed at rest stays bounded. With ``damping`` the factor 1 + χ δ̇ has the constant χ [s/m],
    as in Simbody (1.5 c) and Drake (d); restitution then decreases with speed.

    Example:
        >>> wc.laws.HuntCrossley(stiffness=1e5, restitution=0.7).exponent
        1.5
        >>> wc.laws.HuntCrossley(stiffness=-1e5, restitution=0.7)
        Traceback (most recent call last):
            ...
        ValueError: HuntCrossley.stiffness must be greater than 0, got -100000 N/mⁿ
    """

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d(1+e) = ln[(1+d)/(1−de)]"
    reference = (
        "Hunt & Crossley, J. Appl. Mech. 42 (1975) 440; exact d: Gonthier et al., Multibody Syst. Dyn. 11 (2004) "
        "209, Zhang & Sharf, J. Appl. Mech. 76 (2009) 051002"
    )
    provenance = "D"
    validity = "any δ-dependence; restitution independent of mass, stiffness and speed"
    exactly_one_of = ("restitution", "damping")
    device = ("stiffness", "exponent", "factor", "chi", "speed_floor")

    stiffness: float = parameter("N/mⁿ", "stiffness K", above=0.0)
    exponent: float = parameter("-", "exponent n", default=1.5, at_least=1.0, at_most=4.0)
    restitution: float | None = parameter(
        "-", "coefficient of restitution e", default=None, at_least=0.01, at_most=1.0
    )
    damping: float | None = parameter("s/m", "damping χ", default=None, at_least=0.0)
    speed_floor: float = parameter("m/s", "least entry speed v₀", default=0.01, above=0.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        zero = np.zeros_like(values["stiffness"])
        factor = damping_factor_of_restitution(values["restitution"]) if "restitution" in values else zero
        return {
            "stiffness": values["stiffness"],
            "exponent": values["exponent"],
            "factor": factor,
            "chi": values.get("damping", zero),
            "speed_floor": values["speed_floor"],
        }

    @wp.func
    def force(p: Any, c: Any):
        entry_speed = wp.max(c.entry_speed, p.speed_floor)
        damping = p.factor / entry_speed + p.chi
        return p.stiffness * power(c.delta, p.exponent) * (type(c.delta)(1.0) + damping * c.delta_dot)
