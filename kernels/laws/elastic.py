"""Laws without a dashpot: linear, power law, two stiffnesses, parallel cylinders."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law
from warpcontact.kernels.laws.formulas import power


class Hooke(Law):
    """Linear elastic contact without damping; also a penalty stiffness."""

    formula = "N = K δ"
    reference = "elementary"
    provenance = "R"
    validity = "any stiffness"
    power = 1.0

    stiffness: float = parameter("N/m", "stiffness K", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta


class PowerLaw(Law):
    """Elastic contact with a force proportional to a power of the penetration, without damping."""

    formula = "N = K δⁿ"
    reference = "elementary"
    provenance = "R"
    validity = "n = 1 flat punch or layer, 3/2 smooth point contact, 2 cone or foundation under a sphere"

    stiffness: float = parameter("N/mⁿ", "stiffness K", above=0.0)
    exponent: float = parameter("-", "exponent n", default=1.5, at_least=1.0, at_most=4.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * power(c.delta, p.exponent)


class TwoStiffness(Law):
    """Spring with a lower stiffness in unloading; no damping force, independent of speed.

    The hysteresis loop of a full impact returns e for any exponent, because the energies of loading and unloading
    have the ratio 1 to e². Some texts unload with e K, which returns √e.
    """

    formula = "N = K δⁿ for δ̇ ≥ 0,  e² K δⁿ for δ̇ < 0"
    reference = "two-stiffness model of multibody codes, with the ratio that returns e"
    provenance = "S, D"
    validity = "returns e exactly; the force jumps at the greatest depth, and chatters at rest"
    device = ("stiffness", "exponent", "unloading")

    stiffness: float = parameter("N/mⁿ", "loading stiffness K", above=0.0)
    exponent: float = parameter("-", "exponent n", default=1.0, at_least=1.0, at_most=4.0)
    restitution: float = parameter("-", "coefficient of restitution e", at_least=0.01, at_most=1.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            "stiffness": values["stiffness"],
            "exponent": values["exponent"],
            "unloading": values["restitution"] ** 2,
        }

    @wp.func
    def force(p: Any, c: Any):
        elastic = p.stiffness * power(c.delta, p.exponent)
        if c.delta_dot < type(c.delta)(0.0):
            return p.unloading * elastic
        return elastic


class JohnsonCylinder(Law):
    """Elastic contact of parallel cylinders along a length: a pin in a hole, or two cylinders side by side.

    The published formula gives δ of F. It is inverted with the real Lambert branch W₋₁, by Newton's method. Beyond
    δ = 4 e⁻² ΔR the formula has no solution, and the force is continued in proportion to δ.
    """

    formula = "δ = F/(π E* L) [ln(4 π E* L ΔR/F) − 1],  i.e. F = −π E* L δ/W₋₁(−e δ/(4 ΔR))"
    reference = "Johnson, Contact Mechanics (1985)"
    provenance = "S, D"
    validity = "δ < 0.541 ΔR; ΔR = R_hole − R_pin, or R₁ + R₂ outside"

    modulus: float = parameter("Pa", "effective modulus E*", above=0.0)
    length: float = parameter("m", "length L", above=0.0)
    clearance: float = parameter("m", "difference or sum of radii ΔR", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        one = type(c.delta)(1.0)
        # w eʷ = −x with x = e δ/(4 ΔR) < 1/e and w < −1, as w + ln(−w) = ln x. ln x = −1 is the turning point.
        log = one + wp.log(c.delta / (type(c.delta)(4.0) * p.clearance))
        w = -one
        if log < -one:
            # Near the turning point w ≈ −1 − √(2(−1 − ln x)), far from it w ≈ ln x − ln(−ln x). The smaller start
            # value is safe.
            w = wp.min(-one - wp.sqrt(type(c.delta)(2.0) * (-one - log)), log - wp.log(-log))
            for _i in range(6):
                w = w - (w + wp.log(-w) - log) / (one + one / w)
        return -type(c.delta)(wp.pi) * p.modulus * p.length * c.delta / w


class PereiraCylinder(Law):
    """Elastic contact of a pin in a hole, fitted to Johnson's law; explicit in the penetration.

    ``PereiraCylinderExternal`` is for cylinders side by side. The fit is in mm and N; units here are SI.
    """

    formula = "F = (a ΔR + b) L E*/ΔR δⁿ in mm, N, MPa;  a = 0.965, b = 0.0965, n = Y ΔR^−0.005"
    reference = "Pereira, Ramalho & Ambrósio, Nonlinear Dyn. 63 (2011) 681, with the exponent of n restored"
    provenance = "S, R"
    validity = "0.005 mm ≤ ΔR ≤ 10 mm"
    device = ("stiffness", "exponent")

    modulus: float = parameter("Pa", "effective modulus E*", above=0.0)
    length: float = parameter("m", "length L", above=0.0)
    clearance: float = parameter(
        "m", "difference of radii ΔR", at_least=5.0e-6 * (1 - 1e-9), at_most=1.0e-2 * (1 + 1e-9)
    )

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        gap = 1.0e3 * values["clearance"]  # mm
        narrow = 1.51 * np.log(1.0e3 * gap) ** -0.151
        exponent = np.where(gap < 0.34954, narrow, 0.0151 * gap + 1.151) * gap**-0.005
        return _si((0.965 * gap + 0.0965) / gap, exponent, values)

    @classmethod
    def elastic(cls, values: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
        made = cls.coefficients(values)
        return made["stiffness"], made["exponent"]

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * power(c.delta, p.exponent)


class PereiraCylinderExternal(PereiraCylinder):
    """Elastic contact of parallel cylinders side by side, fitted to Johnson's law; explicit in the penetration."""

    formula = "F = (a ΔR + b) L E*/ΔR δⁿ in mm, N, MPa;  a = 0.39, b = 0.85, n = 1.094"
    provenance = "S"
    validity = "cylinders outside of each other"

    clearance: float = parameter("m", "sum of radii ΔR", above=0.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        gap = 1.0e3 * values["clearance"]  # mm
        return _si((0.39 * gap + 0.85) / gap, np.full_like(gap, 1.094), values)


def _si(factor: np.ndarray, exponent: np.ndarray, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Returns stiffness [N/mⁿ] and exponent from the factor [1/mm] of L E* (L in mm, E* in MPa, δ in mm)."""
    in_mm = factor * (1.0e3 * values["length"]) * (1.0e-6 * values["modulus"])
    return {"stiffness": in_mm * 1.0e3**exponent, "exponent": exponent}
