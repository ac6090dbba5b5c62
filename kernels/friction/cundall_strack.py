"""Coulomb friction with a tangential spring that holds a load at rest."""

import math
from typing import Any, Self

import warp as wp
from warpcontact.kernels.catalogue.device_model import history, number, parameter
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.friction.base import Friction
from warpcontact.kernels.laws.clamped_dashpot import damping_ratio_of_restitution


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
