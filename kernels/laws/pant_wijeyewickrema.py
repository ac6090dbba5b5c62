"""Hunt–Crossley damping on approach only."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law, power


class PantWijeyewickrema(Law):
    """Spring with Hunt–Crossley damping that acts on approach only, for pounding of structures."""

    formula = "N = K δⁿ (1 + d max(δ̇, 0)/v₀),  d = 3(1−e²)/(2e²)"
    reference = "Pant & Wijeyewickrema, EESD 41 (2012) 1701; approach only is recalled"
    provenance = "S, R"
    validity = "returns e within 0.029"
    device = ("stiffness", "exponent", "factor", "speed_floor")

    stiffness: float = parameter("N/mⁿ", "stiffness K", above=0.0)
    exponent: float = parameter("-", "exponent n", default=1.0, at_least=1.0, at_most=4.0)
    restitution: float = parameter("-", "coefficient of restitution e", at_least=0.01, at_most=1.0)
    speed_floor: float = parameter("m/s", "least entry speed v₀", default=0.01, above=0.0)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        e = values["restitution"]
        others = {name: values[name] for name in ("stiffness", "exponent", "speed_floor")}
        return others | {"factor": 1.5 * (1.0 - e**2) / e**2}

    @wp.func
    def force(p: Any, c: Any):
        approach = wp.max(c.delta_dot, type(c.delta)(0.0))
        damping = p.factor / wp.max(c.entry_speed, p.speed_floor)
        return p.stiffness * power(c.delta, p.exponent) * (type(c.delta)(1.0) + damping * approach)
