"""Sequential impacts: separation speeds of contacts, on the host.

``kernels/nonsmooth/sequence.py`` implements the same rule.
"""

import numpy as np
from numpy.typing import NDArray

from warpcontact.kernels.nonsmooth.sequence import MAX_IMPACTS_PER_CONTACT, TIE
from warpcontact.validation.checks import Array

# Approach speeds below this fraction of the largest are zero.
SMALL = 1.0e-12


def parting_speeds(W: Array, speed: Array, restitution: Array, bodies: NDArray[np.int_], method: str) -> Array:
    """Returns the normal velocities (contacts,) after sequential impacts; 0 for contacts that were not hit.

    The pair of bodies with the largest approach speed collides first. Its contacts are solved together, without
    friction, by Newton's law with the current velocities. This repeats until no contact approaches. Contacts that
    still approach after ``MAX_IMPACTS_PER_CONTACT`` impacts per contact do not bounce.

    Args:
        W: Delassus matrix of the normals (contacts, contacts) [1/kg].
        speed: Normal velocities before, positive in separation (contacts,) [m/s].
        restitution: Newton's coefficients (contacts,).
        bodies: Indices of the first and the second body (contacts, 2).
        method: Method of ``wc.unilateral.solve_delassus``.
    """
    from warpcontact.unilateral.solving import solve_delassus

    pairs = np.sort(bodies, axis=1)
    can_move = np.diag(W) > 0.0
    speeds, was_hit = speed.copy(), np.zeros(len(speed), dtype=bool)
    small = SMALL * max(-speed.min(), 0.0)
    for _ in range(MAX_IMPACTS_PER_CONTACT * len(speed)):
        approach = np.where(can_move, -speeds, 0.0)
        if approach.max() <= small:
            break
        fastest, fastest_speed = 0, 0.0
        for contact, approach_speed in enumerate(approach.tolist()):
            if approach_speed > fastest_speed * (1.0 + TIE):
                fastest, fastest_speed = contact, approach_speed
        chosen = np.flatnonzero((pairs == pairs[fastest]).all(axis=1) & can_move)
        target = speeds[chosen] + restitution[chosen] * np.minimum(speeds[chosen], 0.0)
        impulse = np.asarray(solve_delassus(W[np.ix_(chosen, chosen)], target, method=method).lam)
        speeds = speeds + W[:, chosen] @ impulse
        was_hit[chosen[impulse > 0.0]] = True
    return np.where(was_hit, np.maximum(speeds, 0.0), 0.0)
