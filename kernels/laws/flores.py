"""Damping factor of Flores, Machado, Silva and Martins, earlier of Ye, Li and Zhu."""

import numpy as np
from warpcontact.kernels.laws.entry_speed import EntrySpeedLaw


class Flores(EntrySpeedLaw):
    """Hunt–Crossley damping for low and high restitution."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 8(1−e)/(5e)"
    reference = "Flores et al., Multibody Syst. Dyn. 25 (2011) 357; the same as Ye, Li & Zhu, EESD 38 (2009) 1135"
    provenance = "S"
    validity = "all e: returns e within 0.046"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 1.6 * (1.0 - restitution) / restitution
