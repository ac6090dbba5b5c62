"""How a contact coupling repels: its coefficients, and those that stop an expected impact in time."""

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
    """The impact that a range was made for.

    Attributes:
        mass: Of the body [kg].
        other_mass: Of the body that it meets [kg]; ``None``: it meets what is fixed.
        area: Of the contact, as it was estimated [m²].
        speed: Normal speed at which the range is entered [m/s].
        closest: Distance at which the bodies were to stop, without damping [m].
        damping_ratio: Damping as a part of the critical one.
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
        effective_range: Distance d₀ at which it begins [m], positive.
        impact: The impact that it was made for, see ``from_impact``; ``None``: not said.

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
        """Returns the range that stops an impact at a given distance.

        From the energy ½ m v² = ½ A k₁ (d₀ − d_min)² and k₂ = 2ς √(m k₁/A), with the reduced mass m. With damping
        the bodies stop earlier, and short of that distance.

        Args:
            mass: Of the body [kg].
            other_mass: Of the body that it meets [kg]; ``None``: it meets what is fixed.
            area: Estimated area of the contact A [m²].
            speed: Expected normal speed v at the distance d₀ [m/s].
            effective_range: Distance d₀ at which the force begins [m].
            closest: Distance d_min at which the bodies are to stop [m], at least 0 and below d₀.
            damping_ratio: Damping ς as a part of the critical one; weak damping is meant.

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
        """Returns the time τ = (π/2) √(m/(A k₁)) from entering the range to standing still, without damping [s].

        A step dt ≤ τ/20 stops the bodies at the right distance within a thousandth of the way.

        Args:
            mass: Of the body [kg].
            area: Of the contact [m²].
            other_mass: Of the body that it meets [kg]; ``None``: it meets what is fixed.
        """
        mass = float(checks.numbers("mass", mass, (), MASS))
        other = None if other_mass is None else float(checks.numbers("other_mass", other_mass, (), MASS))
        area = float(checks.numbers("area", area, (), AREA))
        return 0.5 * math.pi * math.sqrt(reduced_mass(mass, other) / (area * self.k1))


def reduced_mass(mass: float, other: float | None) -> float:
    """Returns the mass that an impact of two bodies feels [kg]; ``None``: the other one is fixed."""
    return mass if other is None else mass * other / (mass + other)
