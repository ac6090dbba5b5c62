"""Coulomb friction as a set-valued law."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.friction.base import Friction


class Coulomb(Friction):
    """Friction cone without regularization: a sticking contact does not creep. For nonsmooth contact.

    As rolling or torsion of a material it bounds the torque in the same way.
    """

    formula = "|F| ≤ μ N; where it slips, F = −μ N v/s"
    reference = "Coulomb"
    provenance = "S"
    validity = "nonsmooth contact; it has no force of its own"
    rigid = True

    mu: float = parameter("-", "coefficient of friction μ", at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        return type(s.speed)(0.0) * s.velocity
