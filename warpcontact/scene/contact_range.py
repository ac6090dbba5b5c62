"""Coefficients of a contact coupling, given directly or computed from an expected impact."""

import math
from dataclasses import dataclass

from warpcontact.kernels import laws
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.scene.elements import AREA, MASS, RANGE
from warpcontact.validation import checks
from warpcontact.validation.checks import limits

SPEED = limits("m/s", above=0.0)
CLOSEST = limits("m", at_least=0.0)
DAMPING_RATIO = limits("-", at_least=0.0)


@dataclass(frozen=True, kw_only=True)
class ExpectedImpact:
    """The expected impact from which a range was computed.

    Attributes:
        mass: Mass of the body [kg].
        other_mass: Mass of the other body [kg]; ``None``: fixed.
        area: Estimated contact area [m²].
        speed: Normal speed at the beginning of the range [m/s].
        closest: Distance at which the bodies stop without damping [m].
        damping_ratio: Damping relative to critical damping.
    """

    mass: float
    other_mass: float | None
    area: float
    speed: float
    closest: float
    damping_ratio: float


@explain_keywords_of
@dataclass(frozen=True, kw_only=True)
class ContactRange:
    """Repulsion per area within a range of the other surface: p = max(0, k₁ (d₀ − d) − k₂ ḋ).

    Args:
        k1: Elastic coefficient [N/m³], positive.
        k2: Damping coefficient [N·s/m³].
        effective_range: Distance d₀ at which repulsion begins [m], positive.
        impact: The impact from which the coefficients were computed, see ``from_impact``; ``None``: not specified.

    Raises:
        ValueError: If a value is out of range; the message names it.
    """

    k1: float
    k2: float = 0.0
    effective_range: float
    impact: ExpectedImpact | None = None

    def __post_init__(self) -> None:
        allowed = {
            "k1": laws.ContactRange.limits("k1"),
            "k2": laws.ContactRange.limits("k2"),
            "effective_range": RANGE,
        }
        for key, values in allowed.items():
            number = float(checks.numbers(f"ContactRange.{key}", getattr(self, key), (), values))
            object.__setattr__(self, key, number)
        if self.impact is not None and not isinstance(self.impact, ExpectedImpact):
            raise TypeError(f"ContactRange.impact must come from ContactRange.from_impact, got {self.impact!r}")

    @classmethod
    def from_impact(
        cls,
        *,
        mass: float,
        other_mass: float | None = None,
        area: float,
        speed: float,
        effective_range: float,
        closest: float,
        damping_ratio: float = 0.0,
    ) -> "ContactRange":
        """Returns coefficients that stop an impact at a given distance.

        From the energy ½ m v² = ½ A k₁ (d₀ − d_min)² and k₂ = 2ς √(m k₁/A), with the reduced mass m. With damping,
        the bodies stop at a larger distance.

        Args:
            mass: Mass of the body [kg].
            other_mass: Mass of the other body [kg]; ``None``: fixed.
            area: Estimated contact area A [m²].
            speed: Expected normal speed v at the distance d₀ [m/s].
            effective_range: Distance d₀ at which the force begins [m].
            closest: Distance d_min at which the bodies stop [m], at least 0 and below d₀.
            damping_ratio: Damping ς relative to critical damping; intended for weak damping.

        Raises:
            ValueError: If a value is out of range; the message names it.
        """
        label = "ContactRange.from_impact"

        def number(key: str, value: float, allowed: object) -> float:
            return float(checks.numbers(f"{label}: {key}", value, (), allowed))  # type: ignore[arg-type]

        mass = number("mass", mass, MASS)
        other = None if other_mass is None else number("other_mass", other_mass, MASS)
        area = number("area", area, AREA)
        speed = number("speed", speed, SPEED)
        distance = number("effective_range", effective_range, RANGE)
        closest = number("closest", closest, CLOSEST)
        ratio = number("damping_ratio", damping_ratio, DAMPING_RATIO)
        if closest >= distance:
            raise ValueError(
                f"{label}: closest must be less than effective_range = {distance:g} m, got {closest:g} m"
            )
        reduced = reduced_mass(mass, other)
        k1 = reduced / area * (speed / (distance - closest)) ** 2
        k2 = 2.0 * ratio * math.sqrt(reduced * k1 / area)
        impact = ExpectedImpact(
            mass=mass, other_mass=other, area=area, speed=speed, closest=closest, damping_ratio=ratio
        )
        return cls(k1=k1, k2=k2, effective_range=distance, impact=impact)

    def time_scale(self, mass: float, area: float, other_mass: float | None = None) -> float:
        """Returns the time τ = (π/2) √(m/(A k₁)) from the beginning of the range to standstill, without damping [s].

        With dt ≤ τ/20, the stopping distance is accurate to 0.1 % of the distance traveled in the range.

        Args:
            mass: Mass of the body [kg].
            area: Contact area [m²].
            other_mass: Mass of the other body [kg]; ``None``: fixed.
        """
        mass = float(checks.numbers("mass", mass, (), MASS))
        other = None if other_mass is None else float(checks.numbers("other_mass", other_mass, (), MASS))
        area = float(checks.numbers("area", area, (), AREA))
        return 0.5 * math.pi * math.sqrt(reduced_mass(mass, other) / (area * self.k1))


def reduced_mass(mass: float, other: float | None) -> float:
    """Returns the reduced mass of two bodies [kg]; ``other`` is ``None``: the other one is fixed."""
    return mass if other is None else mass * other / (mass + other)
