"""Laws of pressure on the area of a point: elastic foundation, and repulsion within a range of the surface."""

from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import number, parameter
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.laws.base import Law
from warpcontact.kernels.laws.formulas import stepped_dashpot


class ElasticFoundation(Law):
    """Bed of independent springs, one per point, each with the area of its point.

    An omitted area is that of each point, from ``wc.sample_surface`` or ``areas`` of ``add_points``. The pressure
    does not depend on the density of the points. For an elastic layer of thickness h on a rigid base
    k = (1−ν)E/((1+ν)(1−2ν)h).
    """

    formula = "N = max(0, k a δ (1 + χ δ̇))"
    reference = "elastic foundation model of Simbody (ElasticFoundationForce)"
    provenance = "S"
    validity = "layers much thinner than the contact is wide"
    bilinear = True

    stiffness: float = parameter("Pa/m", "foundation modulus k", above=0.0)
    area: float | None = parameter("m²", "area a of the point, its own if left out", default=None, above=0.0)
    damping: float = parameter("s/m", "damping χ", default=0.0, at_least=0.0)

    @classmethod
    @explain_keywords
    def from_layer(
        cls, *, E: float, nu: float, thickness: float, area: float | None = None, damping: float = 0.0
    ) -> "ElasticFoundation":
        """Returns the law of an elastic layer: Young's modulus [Pa], Poisson's ratio < 0.5, thickness [m]."""
        E, nu, thickness = number("E", E), number("nu", nu), number("thickness", thickness)
        if not (E > 0.0 and -1.0 < nu < 0.5 and thickness > 0.0):
            raise ValueError(
                f"E and thickness must be positive and nu between -1 and 0.5, got {E:g}, {thickness:g} and {nu:g}"
            )
        modulus = (1.0 - nu) * E / ((1.0 + nu) * (1.0 - 2.0 * nu) * thickness)
        return cls(stiffness=modulus, area=area, damping=damping)

    @classmethod
    def elastic(cls, values: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
        return values["stiffness"] * values["area"], np.asarray(1.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * p.area * c.delta * (type(c.delta)(1.0) + p.damping * c.delta_dot)


class PressureField(Law):
    """Elastic foundations on both bodies, whose pressures are in balance: p = k₁ h₁ = k₂ h₂ with h₁ + h₂ = δ.

    It has the force of an ``ElasticFoundation`` with k = k₁ k₂/(k₁ + k₂). In body contact, forces act where the
    pressures balance, at h₂ = δ k₁/(k₁ + k₂) below the surface of the second body. For an elastic layer of thickness h and
    modulus E on a rigid core k = E/h. A much larger modulus stands for a rigid body.
    """

    formula = "N = max(0, a δ (1 + χ δ̇) k₁ k₂/(k₁ + k₂))"
    reference = "pressure field model of Elandt et al., IROS 2019, with linear pressures"
    provenance = "D"
    validity = "compliant layers much thinner than the contact is wide"
    bilinear = True

    modulus: float = parameter("Pa/m", "modulus k₁ of the first body", above=0.0)
    other_modulus: float = parameter("Pa/m", "modulus k₂ of the second body", above=0.0)
    area: float | None = parameter("m²", "area a of the point, its own if left out", default=None, above=0.0)
    damping: float = parameter("s/m", "damping χ", default=0.0, at_least=0.0)

    @classmethod
    def elastic(cls, values: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray] | None:
        compliance = 1.0 / values["modulus"] + 1.0 / values["other_modulus"]
        return values["area"] / compliance, np.asarray(1.0)

    @wp.func
    def force(p: Any, c: Any):
        one = type(c.delta)(1.0)
        stiffness = one / (one / p.modulus + one / p.other_modulus)
        return stiffness * p.area * c.delta * (one + p.damping * c.delta_dot)

    @wp.func
    def second_fraction(p: Any):
        return p.modulus / (p.modulus + p.other_modulus)


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
