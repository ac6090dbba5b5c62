"""Damping factor of Lankarani and Nikravesh."""

import numpy as np
from warpcontact.kernels.laws.entry_speed import EntrySpeedLaw


class LankaraniNikravesh(EntrySpeedLaw):
    """Hertz contact with damping, the most cited law of multibody dynamics."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e²)/4"
    reference = "Lankarani & Nikravesh, J. Mech. Des. 112 (1990) 369"
    provenance = "S"
    validity = "e near 1: returns e within 0.047 for e ≥ 0.8; 0.73 for e = 0.5"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return 0.75 * (1.0 - restitution**2)
