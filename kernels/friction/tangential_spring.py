"""Coulomb friction with a tangential spring that holds a load at rest."""

import math
from typing import Any, Self

import warp as wp
from warpcontact.kernels.catalogue.device_model import history, number, parameter
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.friction.base import Friction
from warpcontact.kernels.laws.linear_dashpot import damping_ratio_of_restitution


def stick_damping(stiffness: float, mass: float, overshoot: float) -> float:
    """Returns the tangential damping c_t [N·s/m] at which a step load overshoots by a given fraction.

    A load F applied suddenly to a sticking mass m is balanced by the force k_t ξ + c_t dξ/dt, which reaches F (1 +
    o) before it settles at F. With the damping ratio ζ = c_t/(2 √(k_t m)) and φ = arccos ζ,

        o = exp(−2 φ cot φ):   1 for ζ = 0, e⁻² for ζ = 1, about 1/(4 ζ²) for large ζ.

    This is the restitution of a spring and dashpot without tension; ``KelvinVoigt`` uses the same function.

    Args:
        stiffness: k_t [N/m].
        mass: Mass m that the slip of the contact moves [kg].
        overshoot: o, above 0 and at most 1 [-].

    Raises:
        ValueError: If a value is out of range.
    """
    stiffness, mass = number("stiffness", stiffness, above=0.0), number("mass", mass, above=0.0)
    overshoot = number("overshoot", overshoot, above=0.0, at_most=1.0)
    return 2.0 * float(damping_ratio_of_restitution(overshoot)) * math.sqrt(stiffness * mass)


@wp.func
def spring_and_slider(m: Any, s: Any, stiffness: Any, damping: Any, mu_static: Any, mu_dynamic: Any):
    """Advances ``m.spring`` by the slip and returns it to the friction cone when it slides.

    Sliding starts at μ_s N and lasts while the spring force would exceed μ_d N. With μ_s alone as criterion, as
    often published, a steady slide would stick again after every step, with any force between the two limits. The
    spring alone is returned to its cone. If it also compensated the dashpot, as often published, it would be
    stretched backwards in fast sliding and release energy that was never stored. If μ_d is above μ_s, μ_d is the
    limit for both.
    """
    zero = type(s.speed)(0.0)
    m.spring = m.spring + m.elapsed * s.velocity
    limit = wp.max(mu_static, mu_dynamic) * s.normal_force
    if m.sliding > zero:
        limit = mu_dynamic * s.normal_force
    m.sliding = zero
    if wp.length(stiffness * m.spring + damping * s.velocity) > limit:
        m.sliding = type(s.speed)(1.0)
        size = stiffness * wp.length(m.spring)
        if size > mu_dynamic * s.normal_force:
            m.spring = (mu_dynamic * s.normal_force / size) * m.spring
    return m


@wp.func
def spring_and_dashpot(m: Any, s: Any, stiffness: Any, damping: Any, mu_dynamic: Any):
    """Returns the force of the spring, and of the dashpot as far as the friction limit allows."""
    pull = stiffness * m.spring
    drag = damping * s.velocity
    limit = mu_dynamic * s.normal_force
    if m.sliding > type(s.speed)(0.0) and wp.length(pull + drag) > limit:
        # The largest fraction of the dashpot force with |pull + share drag| = limit.
        across = wp.dot(pull, drag)
        left = wp.max(limit * limit - wp.length_sq(pull), type(s.speed)(0.0))
        share = (wp.sqrt(across * across + wp.length_sq(drag) * left) - across) / wp.length_sq(drag)
        drag = wp.clamp(share, type(s.speed)(0.0), type(s.speed)(1.0)) * drag
    return pull + drag


class CundallStrack(Friction):
    """Spring and dashpot in series with a slider: sticks below μ_s N and holds a body on a slope.

    The stretch ξ of the spring is zero at the start of contact, follows the slip, and rotates with the surface and
    its normal. Half a period of a solid sphere in the tangent plane equals that along the normal if k_t = (2/7)
    k_n. μ_d above μ_s is allowed: the contact then sticks below μ_d N, as with μ_s = μ_d.

    The spring oscillates under a load F that is applied suddenly, such as the weight of a block placed on a slope.
    Its force reaches F (1 + o) and must stay below μ_s N, or the block slides; with μ_d N < F it then never sticks
    again. Without damping o is 1, with critical damping c_t = 2 √(k_t m) it is e⁻² = 0.135. ``from_overshoot``
    chooses the damping: a load up to μ_s N/(1 + o) is held.
    """

    formula = (
        "F = −k_t ξ − c_t v;  sticks with dξ/dt = v until |F| exceeds μ_s N,  "
        "then slides with |F| = μ_d N until the spring, if it stuck, would pull less"
    )
    reference = "Cundall & Strack, Géotechnique 29 (1979) 47; LAMMPS manual, pair granular"
    validity = "true stiction; explicit steps need dt < 2 √(m_t/k_t)"
    provenance = "S"

    mu_static: float = parameter("-", "coefficient of static friction μ_s", at_least=0.0)
    mu_dynamic: float = parameter("-", "coefficient of dynamic friction μ_d", at_least=0.0)
    stiffness: float = parameter("N/m", "tangential stiffness k_t", above=0.0)
    damping: float = parameter("N·s/m", "tangential damping c_t", default=0.0, at_least=0.0)

    spring = history("m", "stretch ξ of the spring", tangent=True)
    sliding = history("-", "1 while it slides")

    @classmethod
    @explain_keywords
    def from_overshoot(
        cls, *, mu_static: float, mu_dynamic: float, stiffness: float, mass: float, overshoot: float = 0.05
    ) -> Self:
        """Returns the model with the damping at which a step load overshoots by ``overshoot``.

        Explicit steps need dt < 2 m/c_t; c_t grows as 1/√o.

        Args:
            mu_static: Coefficient of static friction μ_s.
            mu_dynamic: Coefficient of dynamic friction μ_d.
            stiffness: Tangential stiffness k_t of the contact [N/m].
            mass: Mass m that the slip of this contact moves [kg]: that of the body over the number of contacts
                that hold it, (2/7) of that for a solid sphere that can roll.
            overshoot: o, the largest force over a step load, less 1 [-]; above 0 and at most 1.

        Raises:
            ValueError: If a value is out of range.

        Example:
            >>> block = wc.friction.CundallStrack.from_overshoot(
            ...     mu_static=0.5, mu_dynamic=0.4, stiffness=1e6, mass=1.0, overshoot=0.01
            ... )
            >>> round(block.damping / 2e3, 2)  # the damping ratio
            4.81
        """
        damping = stick_damping(stiffness, mass, overshoot)
        return cls(mu_static=mu_static, mu_dynamic=mu_dynamic, stiffness=stiffness, damping=damping)

    @wp.func
    def advance(p: Any, s: Any, m: Any):
        return spring_and_slider(m, s, p.stiffness, p.damping, p.mu_static, p.mu_dynamic)

    @wp.func
    def force(p: Any, s: Any, m: Any):
        return -spring_and_dashpot(m, s, p.stiffness, p.damping, p.mu_dynamic)


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
