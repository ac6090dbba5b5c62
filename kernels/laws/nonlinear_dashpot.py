"""Springs with a dashpot that depends on the penetration: N = K δⁿ + c(δ) δ̇."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import number, parameter
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.laws.base import Law
from warpcontact.kernels.laws.formulas import power, root_between
from warpcontact.kernels.laws.linear_dashpot import damping_ratio_of_restitution


class Tsuji(Law):
    """Power-law spring and a dashpot of power (n−1)/2: restitution without a history of the entry speed.

    In the variable δ^((n+1)/2) the impact is that of a linear oscillator of damping ratio ξ, so the clamped impact
    returns e exactly with the ξ of ``KelvinVoigt``. Tsuji's α is √5 ξ for n = 3/2.
    """

    formula = "N = max(0, K δⁿ + ξ √(2(n+1) m K) δ^((n−1)/2) δ̇)"
    reference = (
        "Tsuji, Tanaka & Ishida, Powder Technol. 71 (1992) 239; Antypov & Elliott, EPL 94 (2011) 50004; clamped: "
        "Schwager & Pöschel, Granular Matter 9 (2007) 465"
    )
    provenance = "S, D"
    validity = "one impact point per body: the effective mass is that of the point alone"
    exactly_one_of = ("restitution", "ratio")
    device = ("stiffness", "exponent", "ratio")
    needs_mass = True

    stiffness: float = parameter("N/mⁿ", "stiffness K", above=0.0)
    exponent: float = parameter("-", "exponent n", default=1.5, at_least=1.0, at_most=4.0)
    restitution: float | None = parameter(
        "-", "coefficient of restitution e", default=None, at_least=0.01, at_most=1.0
    )
    ratio: float | None = parameter("-", "damping ratio ξ", default=None, at_least=0.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        ratio = damping_ratio_of_restitution(values["restitution"]) if "restitution" in values else values["ratio"]
        return {"stiffness": values["stiffness"], "exponent": values["exponent"], "ratio": ratio}

    @wp.func
    def force(p: Any, c: Any):
        one = type(c.delta)(1.0)
        scale = wp.sqrt(type(c.delta)(2.0) * (p.exponent + one) * c.mass * p.stiffness)
        # δ^((n−1)/2) = √(δⁿ/δ)
        elastic = power(c.delta, p.exponent)
        dashpot = p.ratio * scale * wp.sqrt(elastic / c.delta)
        return p.stiffness * elastic + dashpot * c.delta_dot


# Padé approximant of Müller & Pöschel: e as a quotient of polynomials of v* = β^(1/2) v₀^(1/10), lowest order
# first.
PADE_NUMERATOR = (1.0, 1.07232, 0.574198, 0.141552)
PADE_DENOMINATOR = (1.0, 1.07232, 1.72765, 1.37842, 1.19449, 0.467273, 0.235585)


def restitution_of_viscosity(reduced: np.ndarray) -> np.ndarray:
    """Returns the restitution of a clamped impact from A* = A (K/m)^(2/5) v₀^(1/5) to 7e-4, for e ≥ 0.05."""
    # β v₀^(1/5) = (3/2) A (K/m)^(2/5) v₀^(1/5)
    v = np.sqrt(1.5 * np.asarray(reduced, dtype=np.float64))
    return np.polynomial.polynomial.polyval(v, PADE_NUMERATOR) / np.polynomial.polynomial.polyval(
        v, PADE_DENOMINATOR
    )


class KuwabaraKono(Law):
    """Hertz contact of viscoelastic bodies: restitution decreases with speed as measured, 1 − e ∝ v₀^(1/5).

    A is a material property; ``from_restitution`` determines it from one measured impact. In some texts the factor
    3/2 is part of A.
    """

    formula = "N = max(0, K (δ^1.5 + (3/2) A √δ δ̇))"
    reference = (
        "Kuwabara & Kono, Jpn. J. Appl. Phys. 26 (1987) 1230; Brilliantov et al., Phys. Rev. E 53 (1996) 5382; "
        "e of A: Müller & Pöschel, Phys. Rev. E 84 (2011) 021302"
    )
    provenance = "S"
    validity = "as Hertz, with viscous loss small in the bulk"
    power = 1.5

    stiffness: float = parameter("N/m^1.5", "stiffness K", above=0.0)
    viscosity: float = parameter("s", "dissipative constant A", at_least=0.0)

    @classmethod
    @explain_keywords
    def from_restitution(
        cls, *, stiffness: float, restitution: float, speed: float, mass: float
    ) -> "KuwabaraKono":
        """Returns the law that has ``restitution`` at ``speed`` [m/s] for the effective ``mass`` [kg]."""
        restitution = number("restitution", restitution, at_least=0.05, at_most=1.0)
        speed, mass = number("speed", speed, above=0.0), number("mass", mass, above=0.0)
        stiffness = number("stiffness", stiffness, above=0.0)
        reduced = root_between(
            "viscosity", lambda reduced: restitution_of_viscosity(reduced) - restitution, 0.0, 10.0
        )
        viscosity = float(reduced) / ((stiffness / mass) ** 0.4 * speed**0.2)
        return cls(stiffness=stiffness, viscosity=viscosity)

    @wp.func
    def force(p: Any, c: Any):
        root = wp.sqrt(c.delta)
        return p.stiffness * root * (c.delta + type(c.delta)(1.5) * p.viscosity * c.delta_dot)


class Jankowski(Law):
    """Hertz spring with a dashpot that acts on approach only, for pounding of structures."""

    formula = "N = K δ^1.5 + 2 ξ √(m K √δ) max(δ̇, 0),  ξ = (9√5/2)(1−e²)/{e[e(9π−16)+16]}"
    reference = "Jankowski, EESD 34 (2005) 595; 35 (2006) 517"
    provenance = "S"
    validity = "returns e within 0.0086; one impact point per body"
    power = 1.5
    device = ("stiffness", "ratio")
    needs_mass = True

    stiffness: float = parameter("N/m^1.5", "stiffness K", above=0.0)
    restitution: float = parameter("-", "coefficient of restitution e", at_least=0.01, at_most=1.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        e = values["restitution"]
        ratio = 4.5 * np.sqrt(5.0) * (1.0 - e**2) / (e * (e * (9.0 * np.pi - 16.0) + 16.0))
        return {"stiffness": values["stiffness"], "ratio": ratio}

    @wp.func
    def force(p: Any, c: Any):
        root = wp.sqrt(c.delta)
        dashpot = type(c.delta)(2.0) * p.ratio * wp.sqrt(c.mass * p.stiffness * root)
        return p.stiffness * c.delta * root + dashpot * wp.max(c.delta_dot, type(c.delta)(0.0))


class Impact(Law):
    """IMPACT function of multibody codes: damping increases from zero at touch to its full value at a depth."""

    formula = "N = max(0, K δⁿ + c S(δ/δ_c) δ̇),  S(x) = x²(3 − 2x), 1 for x ≥ 1"
    reference = "IMPACT of MSC Adams and Altair MotionSolve (manuals)"
    provenance = "S"
    validity = "no relation to a restitution: calibrate; continuous at touch"

    stiffness: float = parameter("N/mⁿ", "stiffness K", above=0.0)
    exponent: float = parameter("-", "exponent n", default=1.5, at_least=1.0, at_most=4.0)
    damping: float = parameter("N·s/m", "full damping c", at_least=0.0)
    depth: float = parameter("m", "depth δ_c of full damping", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        x = wp.min(c.delta / p.depth, type(c.delta)(1.0))
        switch = x * x * (type(c.delta)(3.0) - type(c.delta)(2.0) * x)
        return p.stiffness * power(c.delta, p.exponent) + p.damping * switch * c.delta_dot
