"""Contact of parallel cylinders by Pereira, Ramalho and Ambrósio."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law, power


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
