"""Damping factor of Carvalho and Martins, with that of Gonthier for low e."""

import numpy as np
from warpcontact.kernels.laws.entry_speed import EntrySpeedLaw


class CarvalhoMartins(EntrySpeedLaw):
    """Hunt–Crossley damping close to exact; for e ≤ 1/3 with the factor of Gonthier."""

    formula = "N = K δⁿ (1 + d δ̇/v₀),  d = 3(1−e)(11−e)/[2(1+9e)];  (1−e²)/e for e ≤ 1/3"
    reference = "Carvalho & Martins, Mech. Mach. Theory 139 (2019) 174; switch as in Exudyn"
    provenance = "S"
    validity = "all e: returns e within 0.0053"

    @staticmethod
    def damping_factor(restitution: np.ndarray) -> np.ndarray:
        e = restitution
        high = 3.0 * (1.0 - e) * (11.0 - e) / (2.0 * (1.0 + 9.0 * e))
        return np.where(e > 1.0 / 3.0, high, (1.0 - e**2) / e)
