"""Springs with a linear dashpot: N = K δⁿ + c δ̇, n = 1 or 1.5.

The damping ratio of a linear spring follows from the restitution of an impact, without or with tension before
release.
"""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law
from warpcontact.kernels.laws.formulas import root_between, stepped_dashpot


def restitution_of_damping_ratio(ratio: np.ndarray) -> np.ndarray:
    """Returns the restitution of a spring and dashpot without tension, from its damping ratio ξ ≥ 0.

    e = exp[−2ξ arccos ξ/√(1−ξ²)] for ξ < 1, e⁻² at 1, exp[−2ξ arccosh ξ/√(ξ²−1)] above. The contact ends at zero
    force, not at zero penetration (Schwager & Pöschel, Granular Matter 9 (2007) 465).
    """
    ratio = np.asarray(ratio, dtype=np.float64)
    root = np.sqrt(np.abs(1.0 - ratio**2))
    # arctan2(root, ξ) = arccos ξ and log(ξ + root) = arccosh ξ, without loss of digits at ξ = 1.
    angle = np.where(ratio < 1.0, np.arctan2(root, ratio), np.log(ratio + root))
    quotient = np.divide(angle, root, out=np.ones_like(root), where=root > 0.0)
    return np.exp(-2.0 * ratio * quotient)


def damping_ratio_of_restitution(restitution: np.ndarray) -> np.ndarray:
    """Returns the damping ratio ξ of a clamped spring and dashpot with restitution 0 < e ≤ 1, to rounding."""
    restitution = np.asarray(restitution, dtype=np.float64)
    # For large ξ, e → 1/(4 ξ²); twice that root encloses the solution for every e.
    upper = 1.0 + 1.0 / np.sqrt(restitution)
    return root_between(
        "damping ratio", lambda ratio: restitution_of_damping_ratio(ratio) - restitution, 0.0, upper
    )


class KelvinVoigt(Law):
    """Linear spring and dashpot in parallel; the force is clipped at zero, so there is no tension.

    With ``restitution`` the dashpot is c = 2ξ√(K m), where m is the effective mass of the contact and ξ the
    damping ratio whose clamped impact has exactly that restitution. With ``damping`` it is the constant c. The
    force jumps to c δ̇ at first touch. For a step the dashpot is slightly reduced, so that the damping ratio of
    the discrete motion is ξ to second order in dt.
    """

    formula = "N = max(0, K δ + c δ̇),  c = 2 ξ(e) √(K m)"
    reference = "Schwager & Pöschel, Granular Matter 9 (2007) 465"
    provenance = "S, D"
    validity = "one impact point per body: the effective mass is that of the point alone"
    power = 1.0
    exactly_one_of = ("restitution", "damping")
    device = ("stiffness", "damping", "ratio")
    needs_mass = True

    stiffness: float = parameter("N/m", "stiffness K", above=0.0)
    restitution: float | None = parameter(
        "-", "coefficient of restitution e", default=None, at_least=0.01, at_most=1.0
    )
    damping: float | None = parameter("N·s/m", "damping c", default=None, at_least=0.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        zero = np.zeros_like(values["stiffness"])
        ratio = damping_ratio_of_restitution(values["restitution"]) if "restitution" in values else zero
        return {"stiffness": values["stiffness"], "damping": values.get("damping", zero), "ratio": ratio}

    @classmethod
    def dashpot(cls, values: dict[str, np.ndarray], mass: np.ndarray) -> np.ndarray:
        own = cls.coefficients(values)
        return own["damping"] + 2.0 * own["ratio"] * np.sqrt(own["stiffness"] * mass)

    @wp.func
    def force(p: Any, c: Any):
        dashpot = p.damping + type(c.delta)(2.0) * p.ratio * wp.sqrt(p.stiffness * c.mass)
        return p.stiffness * c.delta + stepped_dashpot(dashpot, c.inverse_mass, c.dt) * c.delta_dot


def damping_ratio_of_oscillator(restitution: np.ndarray) -> np.ndarray:
    """Returns ξ = −ln e/√(π² + ln² e), for which an oscillator keeps e of its speed per half period."""
    log = np.log(restitution)
    return -log / np.sqrt(np.pi**2 + log**2)


class Anagnostopoulos(Law):
    """Linear spring and dashpot in parallel; the contact ends at zero penetration, with tension before.

    ``KelvinVoigt`` has no tension.
    """

    formula = "N = K δ + 2 ξ √(K m) δ̇,  ξ = −ln e/√(π² + ln² e)"
    reference = "Anagnostopoulos, EESD 16 (1988) 443; 33 (2004) 897"
    provenance = "S"
    validity = "returns e exactly, with attraction before release"
    power = 1.0
    device = ("stiffness", "ratio")
    needs_mass = True
    pulls = True

    stiffness: float = parameter("N/m", "stiffness K", above=0.0)
    restitution: float = parameter("-", "coefficient of restitution e", at_least=0.01, at_most=1.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            "stiffness": values["stiffness"],
            "ratio": damping_ratio_of_oscillator(values["restitution"]),
        }

    @classmethod
    def dashpot(cls, values: dict[str, np.ndarray], mass: np.ndarray) -> np.ndarray:
        own = cls.coefficients(values)
        return 2.0 * own["ratio"] * np.sqrt(own["stiffness"] * mass)

    @wp.func
    def force(p: Any, c: Any):
        dashpot = type(c.delta)(2.0) * p.ratio * wp.sqrt(p.stiffness * c.mass)
        return p.stiffness * c.delta + stepped_dashpot(dashpot, c.inverse_mass, c.dt) * c.delta_dot


class HertzDashpot(Law):
    """Hertz spring with a linear dashpot. Restitution increases with speed, contrary to experiments."""

    formula = "N = max(0, K δ^1.5 + c δ̇)"
    reference = "attributed to Ristow, J. Phys. I France 2 (1992) 649; form of Modelica's ElastoGap"
    provenance = "S"
    validity = "calibrated at one speed; the force jumps at touch"
    power = 1.5
    needs_mass = True

    stiffness: float = parameter("N/m^1.5", "stiffness K", above=0.0)
    damping: float = parameter("N·s/m", "damping c", at_least=0.0)

    @classmethod
    def dashpot(cls, values: dict[str, np.ndarray], mass: np.ndarray) -> np.ndarray:
        return values["damping"]

    @wp.func
    def force(p: Any, c: Any):
        dashpot = stepped_dashpot(p.damping, c.inverse_mass, c.dt)
        return p.stiffness * c.delta * wp.sqrt(c.delta) + dashpot * c.delta_dot
