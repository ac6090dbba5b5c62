"""Damping factor of Zhiying and Qishao."""

import numpy as np
from warpcontact.kernels.laws.entry_speed import EntrySpeedLaw


class ZhiyingQishao(EntrySpeedLaw):
    """Lankarani–Nikravesh damping, increased for low e."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = (3/4)(1−e²) exp[2(1−e)]"
    reference = "Zhiying & Qishao, J. Dyn. Control 4 (2006) 294"
    provenance = "S"
    validity = "e ≥ 0.8: returns e within 0.013; 0.20 for e = 0.05"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 0.75 * (1.0 - restitution**2) * np.exp(2.0 * (1.0 - restitution))
