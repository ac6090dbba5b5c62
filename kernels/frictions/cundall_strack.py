"""Coulomb friction with a tangential spring that holds a load at rest."""

from typing import Any

import warp as wp
from warpcontact.kernels.formula import memory, parameter
from warpcontact.kernels.frictions.base import Friction


@wp.func
def spring_and_slider(m: Any, s: Any, stiffness: Any, damping: Any, mu_static: Any, mu_dynamic: Any):
    """Stretches ``m.spring`` by the slip, and lets it slide where it would pull more than friction holds.

    Sliding begins at μ_s N and lasts while the spring would pull more than μ_d N. Judged by μ_s alone, as often
    published, a steady slide would stick again after every step and pull anything between the two.
    """
    zero = type(s.speed)(0.0)
    m.spring = m.spring + m.elapsed * s.velocity
    pull = stiffness * m.spring + damping * s.velocity
    size = wp.length(pull)
    limit = mu_static * s.normal_force
    if m.sliding > zero:
        limit = mu_dynamic * s.normal_force
    m.sliding = zero
    if size > limit:
        m.sliding = type(s.speed)(1.0)
        m.spring = ((mu_dynamic * s.normal_force / size) * pull - damping * s.velocity) / stiffness
    return m


class CundallStrack(Friction):
    """A spring and a dashpot in series with a slider: sticks below μ_s N, and holds a body on a slope.

    The spring's stretch ξ begins at zero with the contact, follows the slip, and turns with the surface and its
    normal. Half a period of a solid sphere in the tangent equals that along the normal if k_t = (2/7) k_n.
    """

    formula = "F = −k_t ξ − c_t v, dξ/dt = v; sliding |F| = μ_d N, from μ_s N until it would fall below μ_d N"
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
        return -p.stiffness * m.spring - p.damping * s.velocity
