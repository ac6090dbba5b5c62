"""Laws with Hunt–Crossley damping: N = K δⁿ (1 + d δ̇/v₀), v₀ the entry speed.

``HuntCrossley`` returns the prescribed restitution e exactly. The others differ in the published relation between
the damping factor d and e; ``restitution_of_damping_factor`` gives their actual restitution.
``PantWijeyewickrema`` damps on approach only.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law
from warpcontact.kernels.laws.formulas import power, root_between

# For 1 − e below this the series of d is more accurate than the root of its equation.
SERIES_RANGE = 2.0e-3


def restitution_of_damping_factor(d: np.ndarray) -> np.ndarray:
    """Returns the restitution e of N = f(δ)(1 + d δ̇/v₀) in a free impact, from d ≥ 0, for any elastic function f.

    e = [1 + W₀(−(1+d) exp(−(1+d)))]/d.
    """
    from scipy.special import lambertw  # slow to import, rarely needed

    d = np.asarray(d, dtype=np.float64)
    safe = np.maximum(d, 1.0e-8)  # below, e = 1 − 2d/3 is exact to the digits that W provides
    with np.errstate(divide="ignore"):
        exact = (1.0 + np.real(lambertw(-(1.0 + safe) * np.exp(-(1.0 + safe))))) / safe
    return np.where(d < 1.0e-4, 1.0 - 2.0 * d / 3.0 + d**2 * 4.0 / 9.0, exact)


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
    1.5 c in Simbody and ``hunt_crossley_dissipation`` in Drake; restitution then decreases with speed.

    Example:
        >>> wc.laws.HuntCrossley(stiffness=1e5, restitution=0.7).exponent
        1.5
        >>> wc.laws.HuntCrossley(stiffness=-1e5, restitution=0.7)
        Traceback (most recent call last):
            ...
        ValueError: HuntCrossley.stiffness must be greater than 0, got -100000 N/mⁿ
    """

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d(1+e) = ln[(1+d)/(1−de)];  or N = K δⁿ (1 + χ δ̇)"
    reference = (
        "Hunt & Crossley, J. Appl. Mech. 42 (1975) 440; exact d: Gonthier et al., Multibody Syst. Dyn. 11 (2004) "
        "209, Zhang & Sharf, J. Appl. Mech. 76 (2009) 051002"
    )
    provenance = "D"
    validity = "any δ-dependence; restitution independent of mass, stiffness and speed"
    exactly_one_of = ("restitution", "damping")
    device = ("stiffness", "exponent", "d", "chi", "speed_floor")

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
        d = damping_factor_of_restitution(values["restitution"]) if "restitution" in values else zero
        return {
            "stiffness": values["stiffness"],
            "exponent": values["exponent"],
            "d": d,
            "chi": values.get("damping", zero),
            "speed_floor": values["speed_floor"],
        }

    @wp.func
    def force(p: Any, c: Any):
        entry_speed = wp.max(c.entry_speed, p.speed_floor)
        chi = p.d / entry_speed + p.chi
        return p.stiffness * power(c.delta, p.exponent) * (type(c.delta)(1.0) + chi * c.delta_dot)


class EntrySpeedLaw(Law):
    """Base of laws N = K δⁿ (1 + d δ̇/v₀) whose damping factor d is a function of e.

    A subclass defines it as the static method ``damping_factor`` and has no device function of its own.
    """

    device = ("stiffness", "exponent", "d", "speed_floor")

    stiffness: float = parameter("N/mⁿ", "stiffness K", above=0.0)
    exponent: float = parameter("-", "exponent n", default=1.5, at_least=1.0, at_most=4.0)
    restitution: float = parameter("-", "coefficient of restitution e", at_least=0.01, at_most=1.0)
    speed_floor: float = parameter("m/s", "least entry speed v₀", default=0.01, above=0.0)

    #: Returns the damping factor d of the restitution e.
    damping_factor: ClassVar[Callable[[np.ndarray], np.ndarray]]

    @classmethod
    def coefficients(cls, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            "stiffness": values["stiffness"],
            "exponent": values["exponent"],
            "d": cls.damping_factor(values["restitution"]),
            "speed_floor": values["speed_floor"],
        }

    @wp.func
    def force(p: Any, c: Any):
        chi = p.d / wp.max(c.entry_speed, p.speed_floor)
        return p.stiffness * power(c.delta, p.exponent) * (type(c.delta)(1.0) + chi * c.delta_dot)


class HuntCrossley1975(EntrySpeedLaw):
    """Hunt–Crossley damping as published: d to first order in 1 − e."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e)/2"
    reference = "Hunt & Crossley, J. Appl. Mech. 42 (1975) 440"
    provenance = "S"
    validity = "e near 1: returns e within 0.033 for e ≥ 0.8; 0.50 for e = 0.05. HuntCrossley is exact"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 1.5 * (1.0 - restitution)


class HerbertMcWhannell(EntrySpeedLaw):
    """Hunt–Crossley damping with a factor of second order in 1 − e."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 6(1−e)/[(2e−1)² + 3]"
    reference = "Herbert & McWhannell, J. Eng. Ind. 99 (1977) 513"
    provenance = "S"
    validity = "e near 1: returns e within 0.007 for e ≥ 0.8; 0.49 for e = 0.05"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 6.0 * (1.0 - restitution) / ((2.0 * restitution - 1.0) ** 2 + 3.0)


class LeeWang(EntrySpeedLaw):
    """Hunt–Crossley damping with half of the exact factor near e = 1."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e)/4"
    reference = "Lee & Wang, J. Mech. Transm. Autom. Des. 105 (1983) 534"
    provenance = "S"
    validity = "returns much more than e: 0.80 for 0.5; kept for comparison"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 0.75 * (1.0 - restitution)


class LankaraniNikravesh(EntrySpeedLaw):
    """Hertz contact with damping, the most cited law of multibody dynamics."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e²)/4"
    reference = "Lankarani & Nikravesh, J. Mech. Des. 112 (1990) 369"
    provenance = "S"
    validity = "e near 1: returns e within 0.047 for e ≥ 0.8; 0.73 for e = 0.5"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 0.75 * (1.0 - restitution**2)


class Gonthier(EntrySpeedLaw):
    """Hunt–Crossley damping with an approximation for all e. ``HuntCrossley`` has the exact root."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = (1−e²)/e"
    reference = "Gonthier et al., Multibody Syst. Dyn. 11 (2004) 209"
    provenance = "S"
    validity = "all e: returns e within 0.032"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return (1.0 - restitution**2) / restitution


class ZhiyingQishao(EntrySpeedLaw):
    """Lankarani–Nikravesh damping, increased for low e."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = (3/4)(1−e²) exp[2(1−e)]"
    reference = "Zhiying & Qishao, J. Dyn. Control 4 (2006) 294"
    provenance = "S"
    validity = "e ≥ 0.8: returns e within 0.013; 0.20 for e = 0.05"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 0.75 * (1.0 - restitution**2) * np.exp(2.0 * (1.0 - restitution))


class Flores(EntrySpeedLaw):
    """Hunt–Crossley damping for low and high restitution."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 8(1−e)/(5e)"
    reference = "Flores et al., Multibody Syst. Dyn. 25 (2011) 357; the same as Ye, Li & Zhu, EESD 38 (2009) 1135"
    provenance = "S"
    validity = "all e: returns e within 0.046"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 1.6 * (1.0 - restitution) / restitution


class HuGuo(EntrySpeedLaw):
    """Hunt–Crossley damping with the correct limits for e → 0 and e → 1."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e)/(2e)"
    reference = "Hu & Guo, Multibody Syst. Dyn. 35 (2015) 131"
    provenance = "R"
    validity = "all e: returns e within 0.035. Formula recalled, confirmed by its limits"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 1.5 * (1.0 - restitution) / restitution


class CarvalhoMartins(EntrySpeedLaw):
    """Hunt–Crossley damping close to exact; for e ≤ 1/3 with the factor of Gonthier."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e)(11−e)/[2(1+9e)];  (1−e²)/e for e ≤ 1/3"
    reference = "Carvalho & Martins, Mech. Mach. Theory 139 (2019) 174; switch as in Exudyn"
    provenance = "S"
    validity = "all e: returns e within 0.0053"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        e = restitution
        high = 3.0 * (1.0 - e) * (11.0 - e) / (2.0 * (1.0 + 9.0 * e))
        return np.where(e > 1.0 / 3.0, high, (1.0 - e**2) / e)


class PantWijeyewickrema(EntrySpeedLaw):
    """Spring with Hunt–Crossley damping that acts on approach only, for pounding of structures."""

    formula = "N = K δⁿ (1 + d max(δ̇, 0)/v₀),  d = 3(1−e²)/(2e²)"
    reference = "Pant & Wijeyewickrema, EESD 41 (2012) 1701; approach only is recalled"
    provenance = "S, R"
    validity = "returns e within 0.029"

    exponent: float = parameter("-", "exponent n", default=1.0, at_least=1.0, at_most=4.0)

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 1.5 * (1.0 - restitution**2) / restitution**2

    @wp.func
    def force(p: Any, c: Any):
        approach = wp.max(c.delta_dot, type(c.delta)(0.0))
        chi = p.d / wp.max(c.entry_speed, p.speed_floor)
        return p.stiffness * power(c.delta, p.exponent) * (type(c.delta)(1.0) + chi * approach)
