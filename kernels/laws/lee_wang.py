"""Damping factor of Lee and Wang."""

import numpy as np
from warpcontact.kernels.laws.entry_speed import EntrySpeedLaw


class LeeWang(EntrySpeedLaw):
    """Hunt–Crossley damping with half of the exact factor near e = 1."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e)/4"
    reference = "Lee & Wang, J. Mech. Transm. Autom. Des. 105 (1983) 534"
    provenance = "S"
    validity = "returns much more than e: 0.80 for 0.5; kept for comparison"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 0.75 * (1.0 - restitution)
