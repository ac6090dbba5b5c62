"""Restitution of a linear spring and dashpot without tension from its damping ratio, and the inverse."""

import numpy as np
from warpcontact.kernels.catalogue.roots import root_between


def restitution_of_damping_ratio(ratio: np.ndarray) -> np.ndarray:
    """Returns the restitution of a spring and dashpot without tension, from its damping ratio ξ ≥ 0.

    e = exp[−2ξ arccos ξ/√(1−ξ²)] for ξ < 1, e⁻² at 1, exp[−2ξ arccosh ξ/√(ξ²−1)] above. The contact ends at zero
    force, not at zero penetration (Schwager & Pöschel, Granular Matter 9 (2007) 465).
    """
    ratio = np.asarray(ratio, dtype=np.float64)
    root = np.sqrt(np.abs(1.0 - ratio**2))
    # arctan2(root, ξ) = arccos ξ and log(ξ + root) = arccosh ξ, without loss of digits at ξ = 1.
    angle = np.where(ratio < 1.0, np.arctan2(root, ratio), np.log(ratio + root))
    quotient = np.divide(angle, root, out=np.ones_like(root), where=root > 0.0)
    return np.exp(-2.0 * ratio * quotient)


def damping_ratio_of_restitution(restitution: np.ndarray) -> np.ndarray:
    """Returns the damping ratio ξ of a clamped spring and dashpot with restitution 0 < e ≤ 1, to rounding."""
    restitution = np.asarray(restitution, dtype=np.float64)
    # For large ξ, e → 1/(4 ξ²); twice that root encloses the solution for every e.
    upper = 1.0 + 1.0 / np.sqrt(restitution)
    return root_between(
        "damping ratio", lambda ratio: restitution_of_damping_ratio(ratio) - restitution, 0.0, upper
    )
