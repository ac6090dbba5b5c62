"""What a static contact problem is solved by."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from warpcontact.checks import Array
from warpcontact.status import ContactMode
from warpcontact.unilateral.delassus import Delassus, length

if TYPE_CHECKING:
    from warpcontact.unilateral.problem import Problem


@dataclass(frozen=True, eq=False)
class Solution:
    """Displacements, contact forces and how far they are from a solution.

    Of many problems every array has one more axis, the first. Units are those of the problem.

    Attributes:
        u: Displacements, shape (n,); ``None`` of a problem given by its Delassus matrix.
        lam: Contact forces λ, shape (contacts,), or (contacts, dim) if contacts have tangents, the normal first.
        w: w = W λ + q, of the shape of ``lam``: the gap, and the velocity or displacement that friction opposes.
        gap: Normal part of ``w``, shape (contacts,).
        slip: Tangential part, (contacts, dim − 1), or ``None``. Of a problem in u the displacement since the
            contact was at rest, G_t u − previous, which λ_t has the direction of; of one in W and q it is w_t, and
            λ_t opposes it.
        residual: How far λ and w are from the law of contact, without unit; see ``docs/unilateral.md``.
        iterations: Steps, sweeps or states that the method took.
        converged: Whether ``residual`` is within the tolerance.
        status: ``ContactMode`` of each contact, (contacts,). A closed one without friction slips.
        active: Whether each contact is closed, that is, presses.
        method: How it was solved.
        problem: What was solved, or ``None`` if it was given by its Delassus matrix.
    """

    u: Array | None
    lam: Array
    w: Array
    gap: Array
    slip: Array | None
    residual: Any
    iterations: Any
    converged: Any
    status: NDArray[np.int64]
    method: str
    problem: Problem | None = field(default=None, repr=False)

    @property
    def active(self) -> NDArray[np.bool_]:
        """Whether each contact presses."""
        return self.status != ContactMode.OPEN


def modes(system: Delassus, lam: Array, w: Array, residual: Array, tolerance: float) -> NDArray[np.int64]:
    """Returns the ``ContactMode`` of each contact; what the residual leaves open, or is rounding, is none."""
    small = np.maximum(np.maximum(residual, tolerance)[:, None] * system.unit, system.rho * system.rounding)
    status = np.full(lam.shape[:2], int(ContactMode.STICK))
    slides = system.rho * length(w[..., 1:]) > 2.0 * small
    status[slides | (system.mu == 0.0)] = ContactMode.SLIP
    status[lam[..., 0] <= small] = ContactMode.OPEN
    return status
