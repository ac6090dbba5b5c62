"""A law and a friction as a user would write them, in a file outside the package."""

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
    """Multiplies with a float32 constant: compiles in float32 only."""

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return 2.0 * p.stiffness * c.delta


class Broken(wc.Law):
    """Not a number beyond a depth."""

    stiffness: float = wc.parameter("N/m", "stiffness k", above=0.0)
    depth: float = wc.parameter("m", "depth of the failure", above=0.0)

    @wp.func
    def force(p: Any, c: Any):
        return p.stiffness * c.delta * wp.sqrt(p.depth - c.delta) / wp.sqrt(p.depth)


class Adhesive(wc.Law):
    """A spring that pulls below a depth."""

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
