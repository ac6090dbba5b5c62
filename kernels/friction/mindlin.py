"""Coulomb friction with the tangential spring of two elastic spheres, by Mindlin."""

from typing import Any, Self

import warp as wp
from warpcontact.kernels.catalogue.device_model import history, number, parameter
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.friction.base import Friction
from warpcontact.kernels.friction.cundall_strack import spring_and_dashpot, spring_and_slider, stick_damping


class Mindlin(Friction):
    """Tangential spring of ``CundallStrack`` with the stiffness 8 G* a of a contact patch of radius a = √(R δ).

    While the patch grows the force is constant, because new area is unstretched: dF = 8 G* a dξ. While it shrinks
    the stretch is constant, and the force decreases with a. In both cases a change of load alone adds no energy.
    For contacts with a radius. μ_d above μ_s is allowed, and a sudden load overshoots, as in ``CundallStrack``;
    ``from_overshoot`` chooses the damping.
    """

    formula = "F = −8 G* a ξ − c_t v, a = √(R δ), 1/G* = (2 − ν₁)/G₁ + (2 − ν₂)/G₂; slides like CundallStrack"
    reference = "Mindlin, J. Appl. Mech. 16 (1949) 259; Yade; LAMMPS manual, mindlin_rescale/force"
    validity = (
        "only contacts with a radius R; no slip inside of the patch; explicit steps need dt < 2 √(m_t/(8 G* a))"
    )
    provenance = "S"
    needs_radius = True

    mu_static: float = parameter("-", "coefficient of static friction μ_s", at_least=0.0)
    mu_dynamic: float = parameter("-", "coefficient of dynamic friction μ_d", at_least=0.0)
    shear_modulus: float = parameter("Pa", "effective shear modulus G*", above=0.0)
    damping: float = parameter("N·s/m", "tangential damping c_t", default=0.0, at_least=0.0)

    spring = history("m", "stretch ξ of the spring", tangent=True)
    sliding = history("-", "1 while it slides")
    patch_radius = history("m", "radius a of the patch")

    @classmethod
    @explain_keywords
    def from_overshoot(
        cls,
        *,
        mu_static: float,
        mu_dynamic: float,
        shear_modulus: float,
        patch_radius: float,
        mass: float,
        overshoot: float = 0.05,
    ) -> Self:
        """Returns the model with the damping at which a step load overshoots by ``overshoot``.

        Args:
            mu_static: Coefficient of static friction μ_s.
            mu_dynamic: Coefficient of dynamic friction μ_d.
            shear_modulus: Effective shear modulus G* [Pa].
            patch_radius: Radius a = √(R δ) of the patch at rest [m].
            mass: Mass that the slip of this contact moves [kg], as for ``CundallStrack``.
            overshoot: The largest force over a step load, less 1 [-]; above 0 and at most 1.

        Raises:
            ValueError: If a value is out of range.
        """
        shear_modulus = number("shear_modulus", shear_modulus, above=0.0)
        patch_radius = number("patch_radius", patch_radius, above=0.0)
        damping = stick_damping(8.0 * shear_modulus * patch_radius, mass, overshoot)
        return cls(mu_static=mu_static, mu_dynamic=mu_dynamic, shear_modulus=shear_modulus, damping=damping)

    @wp.func
    def advance(p: Any, s: Any, m: Any):
        if s.patch_radius > m.patch_radius:
            m.spring = (m.patch_radius / s.patch_radius) * m.spring
        m.patch_radius = s.patch_radius
        stiffness = type(s.speed)(8.0) * p.shear_modulus * s.patch_radius
        return spring_and_slider(m, s, stiffness, p.damping, p.mu_static, p.mu_dynamic)

    @wp.func
    def force(p: Any, s: Any, m: Any):
        stiffness = type(s.speed)(8.0) * p.shear_modulus * s.patch_radius
        return -spring_and_dashpot(m, s, stiffness, p.damping, p.mu_dynamic)
