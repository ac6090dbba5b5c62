"""Damping factor of Hu and Guo."""

import numpy as np
from warpcontact.kernels.laws.entry_speed import EntrySpeedLaw


class HuGuo(EntrySpeedLaw):
    """Hunt–Crossley damping with the correct limits for e → 0 and e → 1."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e)/(2e)"
    reference = "Hu & Guo, Multibody Syst. Dyn. 35 (2015) 131"
    provenance = "R"
    validity = "all e: returns e within 0.035. Formula recalled, confirmed by its limits"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 1.5 * (1.0 - restitution) / restitution
