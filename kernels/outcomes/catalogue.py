"""The outcomes of the library."""

import math
from typing import Any

import warp as wp
from warpcontact.kernels.outcomes.base import OfContact, Outcome


def per_second(unit: str) -> str:
    """Returns the unit of an integral over time of what has ``unit``."""
    if unit == "-":
        return "s"
    return unit.removesuffix("/s") if unit.endswith("/s") else f"{unit}·s"


class Max(Outcome):
    """Largest value."""

    memory = (-math.inf,)
    meaning = "largest"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        if x > m[0]:
            m[0] = x
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0]


class Min(Outcome):
    """Smallest value."""

    memory = (math.inf,)
    meaning = "smallest"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        if x < m[0]:
            m[0] = x
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0]


class Range(Outcome):
    """Largest less smallest value."""

    memory = (-math.inf, math.inf)
    meaning = "range of"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        if x > m[0]:
            m[0] = x
        if x < m[1]:
            m[1] = x
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0] - m[1]


class Integral(Outcome):
    """∫ x dt."""

    memory = (0.0,)
    meaning = "integral over time of"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        m[0] += x * dt
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0]

    def unit(self, of: str) -> str:
        """Returns its unit."""
        return per_second(of)


class Mean(Outcome):
    """∫ x dt over the time; NaN before the first step."""

    memory = (0.0, 0.0)
    meaning = "mean over time of"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        m[0] += x * dt
        m[1] += dt
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0] / m[1]


class Rms(Outcome):
    """Root of the mean over time of the squares; NaN before the first step."""

    memory = (0.0, 0.0)
    meaning = "root mean square of"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        m[0] += x * x * dt
        m[1] += dt
        return m

    @wp.func
    def result(m: Any, time: Any):
        return wp.sqrt(m[0] / m[1])


class Initial(Outcome):
    """Value at the start."""

    memory = (math.nan, 0.0)
    meaning = "initial"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        if m[1] == wp.float64(0.0):
            m[0] = x
            m[1] = wp.float64(1.0)
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0]


class Final(Outcome):
    """Value at the end."""

    memory = (math.nan,)
    at_end = True
    meaning = "final"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        m[0] = x
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0]


class Change(Outcome):
    """Final less initial value."""

    memory = (math.nan, 0.0, math.nan)
    meaning = "change of"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        if m[1] == wp.float64(0.0):
            m[0] = x
            m[1] = wp.float64(1.0)
        m[2] = x
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[2] - m[0]


class TimeOfMax(Outcome):
    """Time of the first of the largest values."""

    memory = (-math.inf, math.nan)
    meaning = "time of the largest"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        if x > m[0]:
            m[0] = x
            m[1] = time
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[1]

    def unit(self, of: str) -> str:
        """Returns its unit."""
        return "s"


class FirstTime(Outcome):
    """Time of the first state at which the condition holds; NaN: none."""

    memory = (math.nan,)
    conditional = True
    meaning = "first time of"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        if wp.isnan(m[0]) and x > wp.float64(0.0):
            m[0] = time
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0]

    def unit(self, of: str) -> str:
        """Returns its unit."""
        return "s"


class Duration(Outcome):
    """Time for which the condition held: of the steps that began so."""

    memory = (0.0,)
    conditional = True
    meaning = "time of"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        if x > wp.float64(0.0):
            m[0] += dt
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0]

    def unit(self, of: str) -> str:
        """Returns its unit."""
        return "s"


class Count(Outcome):
    """How many times the condition came to hold, the start included."""

    memory = (0.0, 0.0)
    conditional = True
    meaning = "number of times of"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        holds = wp.where(x > wp.float64(0.0), wp.float64(1.0), wp.float64(0.0))
        if holds > m[1]:
            m[0] += wp.float64(1.0)
        m[1] = holds
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0]

    def unit(self, of: str) -> str:
        """Returns its unit."""
        return "-"


class Restitution(OfContact):
    """Speed at the end of the first contact over that at its begin, −δ̇_end/δ̇_begin; NaN: no such contact ended.

    It is also NaN where that contact did not begin with an approach, as of a point that rests at the start.

    The speeds are those of the first and of the last state in contact, at most a step inside: what the force did
    to them there is of second order in the step, what gravity did of first order.
    """

    quantities = (("penetration", None), ("approach_speed", None))
    memory = (0.0, math.nan, math.nan)  # 0 before, 1 in and 2 after the first contact; δ̇ at its begin, the last
    meaning = "restitution of the first contact of"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        if x[0] > wp.float64(0.0):
            if m[0] == wp.float64(0.0):
                m[0] = wp.float64(1.0)
                m[1] = x[1]
            if m[0] == wp.float64(1.0):
                m[2] = x[1]
        elif m[0] == wp.float64(1.0):
            m[0] = wp.float64(2.0)
        return m

    @wp.func
    def result(m: Any, time: Any):
        if m[0] == wp.float64(2.0) and m[1] > wp.float64(0.0):
            return -m[2] / m[1]
        return wp.float64(wp.nan)

    def check(self, nonsmooth: frozenset[str]) -> None:
        """Refuses nonsmooth contacts, which are no time in contact."""
        if self.contact in nonsmooth:
            raise ValueError(
                f"Restitution: {self.contact!r} is a nonsmooth contact, which ends within a step; that of its impacts "
                f"is {self.contact}.law.restitution"
            )

    def unit(self, of: str) -> str:
        """Returns its unit."""
        return "-"


class Work(OfContact):
    """∫ (N δ̇ + |F_t| v_slip) dt, what a contact took: over whole contacts, what it dissipated.

    Rolling and torsion are left out. Velocities are those from state to state, forces the mean of both: of second
    order in the step.
    """

    quantities = (
        ("normal_force", None),
        ("approach_speed", None),
        ("friction_force", "norm"),
        ("slip_speed", None),
    )
    memory = (0.0, 0.0, 0.0, 0.0)  # the work; both forces and the step before
    meaning = "work taken by"

    @wp.func
    def update(m: Any, x: Any, time: Any, dt: Any):
        half = wp.float64(0.5) * m[3]
        m[0] += half * ((m[1] + x[0]) * x[1] + (m[2] + x[2]) * x[3])
        m[1] = x[0]
        m[2] = x[2]
        m[3] = dt
        return m

    @wp.func
    def result(m: Any, time: Any):
        return m[0]

    def check(self, nonsmooth: frozenset[str]) -> None:
        """Refuses nonsmooth contacts, which keep an account of their own."""
        if self.contact in nonsmooth:
            raise ValueError(
                f"Work: {self.contact!r} is a nonsmooth contact; what those took is Final('scene.impact_dissipation') and "
                "Final('scene.friction_dissipation')"
            )

    def unit(self, of: str) -> str:
        """Returns its unit."""
        return "J"


#: Every outcome by its name.
OUTCOMES: dict[str, type[Outcome]] = {
    one.__name__: one
    for one in (
        Max,
        Min,
        Range,
        Mean,
        Rms,
        Integral,
        Initial,
        Final,
        Change,
        TimeOfMax,
        FirstTime,
        Duration,
        Count,
        Restitution,
        Work,
    )
}
