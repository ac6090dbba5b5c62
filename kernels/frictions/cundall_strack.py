"""Coulomb friction with a tangential spring that holds a load at rest."""

from typing import Any

import warp as wp
from warpcontact.kernels.formula import memory, parameter
from warpcontact.kernels.frictions.base import Friction


@wp.func
def spring_and_slider(m: Any, s: Any, stiffness: Any, damping: Any, mu_static: Any, mu_dynamic: Any):
    """Stretches ``m.spring`` by the slip, and lets it slide where it would pull more than friction holds.

    Sliding begins at μ_s N and lasts while the spring would pull more than μ_d N. Judged by μ_s alone, as often
    published, a steady slide would stick again after every step and pull anything between the two. The spring is
    returned to its own cone: to leave in it what the dashpot takes, as often published, stretches it backwards in
    a fast slide, and it gives back what nobody put in. A μ_d above μ_s counts for both: nothing slides below it.
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
    """Pull of the spring, and of the dashpot as much as friction holds while sliding."""
    pull = stiffness * m.spring
    drag = damping * s.velocity
    limit = mu_dynamic * s.normal_force
    if m.sliding > type(s.speed)(0.0) and wp.length(pull + drag) > limit:
        # The largest share of the dashpot with |pull + share drag| = limit.
        across = wp.dot(pull, drag)
        left = wp.max(limit * limit - wp.length_sq(pull), type(s.speed)(0.0))
        share = (wp.sqrt(across * across + wp.length_sq(drag) * left) - across) / wp.length_sq(drag)
        drag = wp.clamp(share, type(s.speed)(0.0), type(s.speed)(1.0)) * drag
    return pull + drag


class CundallStrack(Friction):
    """A spring and a dashpot in series with a slider: sticks below μ_s N, and holds a body on a slope.

    The spring's stretch ξ begins at zero with the contact, follows the slip, and turns with the surface and its
    normal. Half a period of a solid sphere in the tangent equals that along the normal if k_t = (2/7) k_n. A μ_d
    above μ_s is allowed: it then sticks below μ_d N, as with μ_s = μ_d.
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

    spring = memory("m", "stretch ξ of the spring", tangent=True)
    sliding = memory("-", "1 while it slides")

    @wp.func
    def advance(p: Any, s: Any, m: Any):
        return spring_and_slider(m, s, p.stiffness, p.damping, p.mu_static, p.mu_dynamic)

    @wp.func
    def force(p: Any, s: Any, m: Any):
        return -spring_and_dashpot(m, s, p.stiffness, p.damping, p.mu_dynamic)
