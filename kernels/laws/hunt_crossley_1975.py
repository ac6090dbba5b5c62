"""Damping factor published by Hunt and Crossley."""

import numpy as np
from warpcontact.kernels.laws.entry_speed import EntrySpeedLaw


class HuntCrossley1975(EntrySpeedLaw):
    """Hunt–Crossley damping as published: d to first order in 1 − e."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e)/2"
    reference = "Hunt & Crossley, J. Appl. Mech. 42 (1975) 440"
    provenance = "S"
    validity = "e near 1: returns e within 0.033 for e ≥ 0.8; 0.50 for e = 0.05. HuntCrossley is exact"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 1.5 * (1.0 - restitution)
