"""Hertz contact with radii and ellipse from the local curvatures."""

import dataclasses
from typing import Any

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.catalogue.keywords import keywords_of, refuse_unknown
from warpcontact.kernels.laws.base import Law
from warpcontact.kernels.laws.elliptic import stiffness_per_modulus
from warpcontact.kernels.laws.hertz import hertz_stiffness
from warpcontact.kernels.laws.hunt_crossley import damping_factor_of_restitution


class HertzElastic(Law):
    """Elastic contact with a stiffness from the local curvatures instead of a given radius.

    Between shapes and between particles, the curvatures are the principal relative ones at the contact, and the
    contact patch is an ellipse. For a sphere on a mesh it is that of the sphere, because the facets are flat; a
    contact of points without radius raises an error. The ratio of the curvatures is limited to 1e6, which affects
    line contacts and close conformity. Edges and tips are rounded by ``edge_radius``. If that is zero, and for a
    flat face on a flat face, there is no Hertz contact: the force is NaN, and the environment is frozen.

    Damping is that of ``HuntCrossley``: restitution e at the entry speed v₀, at least ``speed_floor``, and a
    constant damping χ. Without either the contact is elastic.
    """

    formula = "N = K(κ₁, κ₂) δ^1.5 (1 + d δ̇/v₀ + χ δ̇),  K of complete elliptic integrals"
    reference = "Hertz, J. reine angew. Math. 92 (1882) 156; Johnson, Contact Mechanics (1985); d: HuntCrossley"
    provenance = "S, D"
    validity = "semi-axes of the patch ≲ 0.1 of the radii, elastic, impact far slower than sound"
    device = ("modulus", "factor", "chi", "speed_floor", "edge_radius")
    power = 1.5
    needs_curvature = True

    modulus: float = parameter("Pa", "effective modulus E*", above=0.0)
    restitution: float = parameter("-", "coefficient of restitution e", default=1.0, at_least=0.01, at_most=1.0)
    damping: float = parameter("s/m", "damping χ", default=0.0, at_least=0.0)
    speed_floor: float = parameter("m/s", "least entry speed v₀", default=0.01, above=0.0)
    edge_radius: float = parameter("m", "radius of edges and tips", default=0.0, at_least=0.0)

    @classmethod
    def from_materials(
        cls, E: float, nu: float, E2: float | None = None, nu2: float = 0.0, **others: float
    ) -> "HertzElastic":
        """Returns the law for two materials: 1/E* = (1 − ν²)/E + (1 − ν₂²)/E₂.

        Args:
            E: Young's modulus of the first body [Pa].
            nu: Its Poisson's ratio [-].
            E2: Young's modulus of the second body [Pa]; ``None``: rigid.
            nu2: Its Poisson's ratio [-].
            others: Further parameters, such as ``restitution``.

        Raises:
            ValueError: If a value is out of range.
        """
        losses = [field.name for field in dataclasses.fields(cls) if field.name != "modulus"]
        refuse_unknown(f"{cls.__name__}.from_materials", others, [*keywords_of(cls.from_materials), *losses])
        # For a sphere of radius 1 m: K = (4/3) E*.
        return cls(modulus=0.75 * hertz_stiffness(E, nu, 1.0, E2, nu2), **others)

    @staticmethod
    def coefficients(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            "modulus": values["modulus"],
            "factor": damping_factor_of_restitution(values["restitution"]),
            "chi": values["damping"],
            "speed_floor": values["speed_floor"],
            "edge_radius": values["edge_radius"],
        }

    @wp.func
    def force(p: Any, c: Any):
        one = type(c.delta)(1.0)
        sharpest = one / p.edge_radius  # infinite for sharp edges
        stiffness = p.modulus * stiffness_per_modulus(
            wp.min(c.curvature_1, sharpest), wp.min(c.curvature_2, sharpest)
        )
        damping = p.factor / wp.max(c.entry_speed, p.speed_floor) + p.chi
        return stiffness * c.delta * wp.sqrt(c.delta) * (one + damping * c.delta_dot)
