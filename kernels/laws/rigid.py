"""Rigid contact."""

from typing import Any

import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law


class Rigid(Law):
    """Contact without compliance, for nonsmooth contact; it has no force function."""

    formula = "g ≥ 0, N ≥ 0, g N = 0; u_n⁺ = −e u_n⁻"
    reference = "Signorini's condition and Newton's impact law"
    provenance = "S"
    validity = "bodies whose deformation does not matter"
    rigid = True

    restitution: float = parameter("-", "Newton's restitution e", default=0.0, at_least=0.0, at_most=1.0)

    @wp.func
    def force(p: Any, c: Any):
        return type(c.delta)(0.0)
