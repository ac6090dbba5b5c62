"""Damping factor of Herbert and McWhannell."""

import numpy as np
from warpcontact.kernels.laws.entry_speed import EntrySpeedLaw


class HerbertMcWhannell(EntrySpeedLaw):
    """Hunt–Crossley damping with a factor of second order in 1 − e."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 6(1−e)/[(2e−1)² + 3]"
    reference = "Herbert & McWhannell, J. Eng. Ind. 99 (1977) 513"
    provenance = "S"
    validity = "e near 1: returns e within 0.007 for e ≥ 0.8; 0.49 for e = 0.05"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 6.0 * (1.0 - restitution) / ((2.0 * restitution - 1.0) ** 2 + 3.0)
