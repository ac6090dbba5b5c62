"""Impacts one after the other: the speeds at which contacts part.

On the host; ``kernels/unilateral/sequence.py`` has the same rule.
"""

import numpy as np
from numpy.typing import NDArray

from warpcontact.checks import Array
from warpcontact.kernels.unilateral.sequence import IMPACTS, TIE

# Approach speeds below this share of the largest are zero.
SMALL = 1.0e-12


def parting_speeds(W: Array, speed: Array, restitution: Array, bodies: NDArray[np.int_], method: str) -> Array:
    """Returns the normal velocities (contacts,) after impacts one after the other.

    It is 0 of a contact that no impact pressed.

    The pair of bodies that approaches fastest collides first: its contacts are solved together, without friction,
    by Newton's law with the velocities so far, and so on until no contact approaches. What still approaches after
    ``IMPACTS`` for each contact does not bounce.

    Args:
        W: Delassus matrix of the normals (contacts, contacts) [1/kg].
        speed: Normal velocities before, positive where bodies part (contacts,) [m/s].
        restitution: Newton's coefficients (contacts,).
        bodies: Numbers of the first and the second body (contacts, 2).
        method: Of ``wc.unilateral.solve_delassus``.
    """
    from warpcontact.unilateral.solving import solve_delassus

    pairs = np.sort(bodies, axis=1)
    yields = np.diag(W) > 0.0
    now, hit = speed.copy(), np.zeros(len(speed), dtype=bool)
    small = SMALL * max(-speed.min(), 0.0)
    for _ in range(IMPACTS * len(speed)):
        approach = np.where(yields, -now, 0.0)
        if approach.max() <= small:
            break
        fastest, most = 0, 0.0
        for contact, one in enumerate(approach.tolist()):
            if one > most * (1.0 + TIE):
                fastest, most = contact, one
        own = np.flatnonzero((pairs == pairs[fastest]).all(axis=1) & yields)
        asked = now[own] + restitution[own] * np.minimum(now[own], 0.0)
        impulse = np.asarray(solve_delassus(W[np.ix_(own, own)], asked, method=method).lam)
        now = now + W[:, own] @ impulse
        hit[own[impulse > 0.0]] = True
    return np.where(hit, np.maximum(now, 0.0), 0.0)
