"""The outcomes of the library."""

import math
from typing import Any

import warp as wp
from warpcontact.kernels.outcomes.base import OfContact, Outcome


def per_second(unit: str) -> str:
    """Returns the unit of a time integral of a quantity with ``unit``."""
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
    """Largest minus smallest value."""

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
    """Final minus initial value."""

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
    """Time of the first occurrence of the largest value."""

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
    """Total duration of the steps that began with the condition satisfied."""

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
    """Number of times that the condition became satisfied, including at the start."""

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
    """Coefficient of restitution of the first contact, −δ̇_end/δ̇_start; NaN: it has not ended or did not happen.

    Also NaN if the contact did not begin with an approach, for example for a point at rest at the start.

    The speeds are those of the first and the last state in contact, at most one step inside. The error due to the
    contact force is of second order in the step, that due to gravity of first order.
    """

    quantities = (("penetration", None), ("approach_speed", None))
    memory = (0.0, math.nan, math.nan)  # 0 before, 1 in, 2 after the first contact; first and last δ̇
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
        """Raises ``ValueError`` for a nonsmooth contact, whose impacts have no duration."""
        if self.contact in nonsmooth:
            raise ValueError(
                f"Restitution must be of a compliant contact, got the nonsmooth contact {self.contact!r}, whose "
                f"impacts have no duration. Its coefficient of restitution is {self.contact}.law.restitution"
            )

    def unit(self, of: str) -> str:
        """Returns its unit."""
        return "-"


class Work(OfContact):
    """Work of a contact, ∫ (N δ̇ + |F_t| v_slip) dt; over complete contacts, the dissipated energy.

    Without rolling and torsional friction. Velocities are averages over a step, forces the mean of both states, so
    the error is of second order in the step.
    """

    quantities = (
        ("normal_force", None),
        ("approach_speed", None),
        ("friction_force", "norm"),
        ("slip_speed", None),
    )
    memory = (0.0, 0.0, 0.0, 0.0)  # work; both forces and the step of the last state
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
        """Raises ``ValueError`` for a nonsmooth contact, which has sensors of its dissipation."""
        if self.contact in nonsmooth:
            raise ValueError(
                f"Work must be of a compliant contact, got the nonsmooth contact {self.contact!r}. The energy that "
                "nonsmooth contacts dissipate is Final('scene.impact_dissipation') and Final('scene.friction_dissipation')"
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
