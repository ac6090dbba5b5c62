"""Family of laws whose damping refers to the entry speed: N = K δⁿ (1 + d(e) δ̇/v₀).

They differ only in the published relation between the damping factor d and the restitution e. ``HuntCrossley``
returns e exactly; for the others ``restitution_of_damping_factor`` gives the actual restitution.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law, power


class EntrySpeedLaw(Law):
    """Base of the family. A subclass defines ``damping_factor``."""

    device = ("stiffness", "exponent", "factor", "speed_floor")

    stiffness: float = parameter("N/mⁿ", "stiffness K", above=0.0)
    exponent: float = parameter("-", "exponent n", default=1.5, at_least=1.0, at_most=4.0)
    restitution: float = parameter("-", "coefficient of restitution e", at_least=0.01, at_most=1.0)
    speed_floor: float = parameter("m/s", "least entry speed v₀", default=0.01, above=0.0)

    #: Returns d of e.
    damping_factor: ClassVar[Callable[[np.ndarray], np.ndarray]]

    @classmethod
    def coefficients(cls, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            "stiffness": values["stiffness"],
            "exponent": values["exponent"],
            "factor": cls.damping_factor(values["restitution"]),
            "speed_floor": values["speed_floor"],
        }

    @wp.func
    def force(p: Any, c: Any):
        damping = p.factor / wp.max(c.entry_speed, p.speed_floor)
        return p.stiffness * power(c.delta, p.exponent) * (type(c.delta)(1.0) + damping * c.delta_dot)
