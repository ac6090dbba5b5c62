"""A file of valid and invalid custom laws and friction models, as used by an experiment file; tests copy it."""

from typing import Any

import numpy as np
import warp as wp

import warpcontact as wc


class Cubic(wc.Law):
    """N = k δ³."""

    stiffness: float = wc.parameter("N/m³", "stiffness k", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta * c.delta * c.delta


class Pad(wc.Law):
    """N = k δ (1 + χ δ̇), with k given or computed from the penetration at 1 N."""

    device = ("stiffness", "chi")
    exactly_one_of = ("stiffness", "depth")

    stiffness: float | None = wc.parameter("N/m", "stiffness k", default=None, above=0.0)
    depth: float | None = wc.parameter("m", "depth under 1 N", default=None, above=0.0)
    damping: float = wc.parameter("s/m", "damping χ", default=np.float64(0.5), at_least=0.0)

    @staticmethod
    def coefficients(values):
        stiffness = values["stiffness"] if "stiffness" in values else 1.0 / values["depth"]
        return {"stiffness": stiffness, "chi": values["damping"]}

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta * (type(c.delta)(1.0) + p.chi * c.delta_dot)


class Lubricated(wc.Friction):
    """F = −β N v."""

    drag: float = wc.parameter("s/m", "drag β", at_least=0.0)

    @wp.func
    def force(p: Any, s: Any):
        return (-p.drag * s.normal_force) * s.velocity


class Fading(wc.Law):
    """Host code that fails for large values."""

    device = ("stiffness",)

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    @staticmethod
    def coefficients(values):
        if np.any(values["stiffness"] > 1e6):
            raise LookupError("no table")
        return {"stiffness": values["stiffness"]}

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta


class Careless(wc.Law):
    """Compiles in float32 only."""

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return 2.0 * p.stiffness * c.delta


class Misspelt(wc.Law):
    """Compiles in no precision."""

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stifness * c.delta


class Unnamed(wc.Law):
    """Lacks a name among its coefficients."""

    device = ("stiffness", "chi")

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta * p.chi


class Picky(wc.Law):
    """Checks its parameters in custom code."""

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    def __post_init__(self):
        super().__post_init__()
        if self.stiffness > 10.0:
            raise LookupError("too stiff")

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta


class Reserved(wc.Law):
    """A parameter whose name is a key of the table already."""

    type: float = wc.parameter("-", "kind", default=1.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.type * c.delta


class Powerless(wc.Law):
    """Has no force."""

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)


def helper():
    return Cubic


class StickSpring(wc.Friction):
    """F = −k ξ, at most μ N."""

    mu: float = wc.parameter("-", "coefficient of friction μ", at_least=0.0)
    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    stretch = wc.history("m", "stretch ξ", tangent=True)

    @wp.func
    def advance(p: Any, s: Any, m: Any):
        m.stretch = m.stretch + m.elapsed * s.velocity
        reach = p.mu * s.normal_force / p.stiffness
        if wp.length(m.stretch) > reach:
            m.stretch = reach * wp.normalize(m.stretch)
        return m

    @wp.func
    def force(p: Any, s: Any, m: Any):
        return -p.stiffness * m.stretch
