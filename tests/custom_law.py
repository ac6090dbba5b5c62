"""Custom laws and friction models as in a user's file outside of the package."""

from typing import Any

import warp as wp

import warpcontact as wc


class Cubic(wc.Law):
    """N = k δ³."""

    stiffness: float = wc.parameter("N/m³", "stiffness k", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta * c.delta * c.delta


class Careless(wc.Law):
    """Multiplies by a float32 constant: compiles in float32 only."""

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return 2.0 * p.stiffness * c.delta


class Broken(wc.Law):
    """NaN above a penetration."""

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)
    depth: float = wc.parameter("m", "depth of the failure", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta * wp.sqrt(p.depth - c.delta) / wp.sqrt(p.depth)


class Adhesive(wc.Law):
    """A spring with adhesion below a penetration."""

    pulls = True

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)
    depth: float = wc.parameter("m", "depth of no force", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * (c.delta - p.depth)


class Viscous(wc.Friction):
    """F = −b v."""

    damping: float = wc.parameter("N·s/m", "damping b", at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        return -p.damping * s.velocity


class Plastic(wc.Law):
    """Loads along k₁ δ, unloads and reloads along k₂ (δ − δ₀) from the maximum: permanent deformation δ₀."""

    loading: float = wc.parameter("N/m", "stiffness k₁ of loading", above=0.0)
    unloading: float = wc.parameter("N/m", "stiffness k₂ ≥ k₁ of unloading", above=0.0)

    deepest = wc.history("m", "deepest penetration so far")

    @wp.func
    def advance(p: Any, c: Any, m: Any):
        m.deepest = wp.max(m.deepest, c.delta)
        return m

    @wp.func
    def force(p: Any, c: Any, m: Any):
        return p.loading * m.deepest - p.unloading * (m.deepest - c.delta)


class TwoBristles(wc.Friction):
    """Two parallel stick springs, with a clock; slides as in Coulomb friction when both slide."""

    mu: float = wc.parameter("-", "coefficient of friction μ of each", at_least=0.0)
    stiffness: float = wc.parameter("N/m", "stiffness k of the first, half that of the second", above=0.0)

    first = wc.history("m", "stretch of the first", tangent=True)
    age = wc.history("s", "time since touch")
    second = wc.history("m", "stretch of the second", tangent=True)

    @wp.func
    def advance(p: Any, s: Any, m: Any):
        half = type(s.speed)(0.5)
        m.age = m.age + m.elapsed
        m.first = clamp_length(m.first + m.elapsed * s.velocity, p.mu * s.normal_force / p.stiffness)
        m.second = clamp_length(m.second + m.elapsed * s.velocity, p.mu * s.normal_force / (half * p.stiffness))
        return m

    @wp.func
    def force(p: Any, s: Any, m: Any):
        return -p.stiffness * (m.first + type(s.speed)(0.5) * m.second)


@wp.func
def clamp_length(v: Any, length: Any):
    if wp.length(v) > length:
        return (length / wp.length(v)) * v
    return v


class Clock(wc.Law):
    """A spring that stores the time since first contact."""

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    age = wc.history("s", "time since touch")

    @wp.func
    def advance(p: Any, c: Any, m: Any):
        m.age = m.age + m.elapsed
        return m

    @wp.func
    def force(p: Any, c: Any, m: Any):
        return p.stiffness * c.delta


class Tiring(wc.Law):
    """A dashpot that decays with the time since first contact."""

    damping: float = wc.parameter("N·s/m", "damping c", at_least=0.0)
    time: float = wc.parameter("s", "time in which it has weakened to c/e", above=0.0)

    age = wc.history("s", "time since touch")
    depth = wc.history("m", "deepest penetration so far")

    @wp.func
    def advance(p: Any, c: Any, m: Any):
        m.age = m.age + m.elapsed
        m.depth = wp.max(m.depth, c.delta)
        return m

    @wp.func
    def force(p: Any, c: Any, m: Any):
        # Acts on increasing penetration only. If the history contained the current penetration, the first force
        # would be zero.
        if c.delta < m.depth:
            return type(c.delta)(0.0)
        return p.damping * c.delta_dot * wp.exp(-m.age / p.time)


class Sprung(wc.Friction):
    """F = −k ξ, without a limit."""

    spring = wc.history("m", "stretch ξ", tangent=True)

    @wp.func
    def advance(p: Any, s: Any, m: Any):
        m.spring = m.spring + m.elapsed * s.velocity
        return m

    @wp.func
    def force(p: Any, s: Any, m: Any):
        return type(s.speed)(-1.0e4) * m.spring
