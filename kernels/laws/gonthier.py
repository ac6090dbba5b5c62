"""Approximate damping factor of Gonthier, McPhee, Lange and Piedboeuf."""

import numpy as np
from warpcontact.kernels.laws.entry_speed import EntrySpeedLaw


class Gonthier(EntrySpeedLaw):
    """Hunt–Crossley damping with an approximation for all e. ``HuntCrossley`` has the exact root."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = (1−e²)/e"
    reference = "Gonthier et al., Multibody Syst. Dyn. 11 (2004) 209"
    provenance = "S"
    validity = "all e: returns e within 0.032"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        return (1.0 - restitution**2) / restitution
