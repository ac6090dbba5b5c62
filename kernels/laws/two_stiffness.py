"""Spring that is softer in unloading than in loading."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law, power


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
