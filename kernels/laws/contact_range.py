"""Repulsion within a range of the surface."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.laws.base import Law, stepped_dashpot


class ContactRange(Law):
    """Spring and dashpot per area on the surface offset by a range, so that bodies repel before they touch.

    The range d₀ is the ``radius`` of the contact, so δ = d₀ − d for a point at the distance d. A body of weight W
    hovers at d₀ − W/(Σ a k₁). An omitted area is that of each point, from ``wc.sample_surface`` or ``areas`` of
    ``add_points``.
    """

    formula = "N = a max(0, k₁ (d₀ − d) − k₂ ḋ min(1, (d₀ − d)/r)),  d₀ = radius of the contact"
    reference = "Simcenter STAR-CCM+ manual, contact coupling"
    provenance = "R"
    validity = "for d < d₀; without a ramp r the damping jumps at d₀"
    needs_mass = True

    k1: float = parameter("N/m³", "elastic coefficient k₁", above=0.0)
    k2: float = parameter("N·s/m³", "damping coefficient k₂", default=0.0, at_least=0.0)
    ramp: float = parameter("m", "depth r over which damping sets in; 0: at once", default=0.0, at_least=0.0)
    area: float | None = parameter("m²", "area a of the point, its own if left out", default=None, above=0.0)

    @classmethod
    def elastic(cls, values: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
        return values["k1"] * values["area"], np.asarray(1.0)

    @wp.func
    def force(p: Any, c: Any):
        dashpot = stepped_dashpot(p.area * p.k2, c.inverse_mass, c.dt)
        if c.delta < p.ramp:
            dashpot *= c.delta / p.ramp
        return p.area * p.k1 * c.delta + dashpot * c.delta_dot
