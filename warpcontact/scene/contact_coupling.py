"""Contact couplings: repulsive pressure between two surfaces within a range.

``add_contact_coupling`` creates them from point contacts at quadrature points of the faces. The coefficients are given
directly or computed from an expected impact. The report has the minimum distance of the surfaces and the largest area
in range.
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpcontact.kernels import laws
from warpcontact.kernels.catalogue.keywords import explain_keywords_of, keywords_of, refuse_unknown
from warpcontact.kernels.friction import Friction, Frictionless
from warpcontact.meshes.sample import ORDERS, face_points
from warpcontact.scene.elements import AREA, MASS, RANGE, Contact, ContactMaterial, Surface
from warpcontact.scene.surface_contact import SIDES
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

if TYPE_CHECKING:
    import xarray as xr

    from warpcontact.model.environments import Environments
    from warpcontact.scene.scene_data import SceneData

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


# Maximum number of environments that are listed.
NAMED = 8
# Error of the stopping distance with steps of τ/20, relative to the distance traveled in the range.
PART_OF_STEPS = 1.0e-3


@dataclass(frozen=True)
class CouplingReport:
    """Minimum distance and effective area of a coupling in each environment since reset; can be printed.

    Attributes:
        name: Name of the coupling.
        effective_area: Largest area in range, (env,) [m²].
        minimum_distance: Smallest distance of a face in range, (env,) [m]; negative: penetration of the other
            surface; NaN: no face was in range.
        effective_range: Distance at which the force begins, (env,) [m].
        impact: The impact from which the range was computed; ``None``: not specified.
        first_env: Number of the first environment.
    """

    name: str
    effective_area: Array
    minimum_distance: Array
    effective_range: Array
    impact: "ExpectedImpact | None"
    first_env: int

    @property
    def in_range(self) -> NDArray[np.bool_]:
        """Whether any face was in range, (env,)."""
        return ~np.isnan(self.minimum_distance)

    @property
    def touched(self) -> NDArray[np.bool_]:
        """Whether the surfaces touched, (env,)."""
        return self.minimum_distance <= 0.0

    @property
    def passed(self) -> NDArray[np.bool_]:
        """Whether the distance fell below ``closest`` of the expected impact, (env,); false if there is no impact.

        A tolerance of 0.1 % of the distance traveled allows for the error of the time step.
        """
        if self.impact is None:
            return np.zeros(len(self.minimum_distance), dtype=bool)
        closest = self.impact.closest
        return self.minimum_distance < closest - PART_OF_STEPS * (self.effective_range - closest)

    def __str__(self) -> str:
        reached = self.in_range
        lines = [f"{self.name}: {_count(reached)} came into range"]
        if reached.any():
            low, high = self.minimum_distance[reached].min(), self.minimum_distance[reached].max()
            lines.append(f"smallest distance: {_span(low, high)} m")
            low, high = self.effective_area[reached].min(), self.effective_area[reached].max()
            estimate = "" if self.impact is None else f", estimated {self.impact.area:.4g} m²"
            lines.append(f"largest area in range: {_span(low, high)} m²{estimate}")
        if self.impact is not None:
            lines.append(f"passed the closest distance of {self.impact.closest:.4g} m: {self._named(self.passed)}")
        lines.append(f"the surfaces met: {self._named(self.touched)}")
        return "\n".join(lines)

    def _named(self, mask: NDArray[np.bool_]) -> str:
        numbers = self.first_env + np.flatnonzero(mask)
        if not len(numbers):
            return "in no environment"
        more = f" and {len(numbers) - NAMED} more" if len(numbers) > NAMED else ""
        word = "environment" if len(numbers) == 1 else "environments"
        return f"in {word} {', '.join(map(str, numbers[:NAMED]))}{more}"


#: Sensors of a coupling that are stored as outcomes of a run.
OUTCOMES = ("effective_area", "minimum_distance")


def report_of(coupling: "ContactCoupling", outcome: "xr.Dataset", parameters: "xr.Dataset") -> CouplingReport:
    """Returns the report of a coupling from the outcomes and parameters (env, …) of a run."""
    envs = outcome.sizes["env"]
    name = f"{coupling.name}.effective_range"
    ranges = parameters[name].values if name in parameters else np.full(envs, coupling.range.effective_range)
    return CouplingReport(
        name=coupling.name,
        effective_area=outcome[f"{coupling.name}.effective_area"].values.astype(np.float64),
        minimum_distance=outcome[f"{coupling.name}.minimum_distance"].values.astype(np.float64),
        effective_range=ranges,
        impact=coupling.range.impact,
        first_env=int(outcome["env"].values[0]) if envs else 0,
    )


def _count(mask: NDArray[np.bool_]) -> str:
    return f"{int(mask.sum())} of {len(mask)} environments"


def _span(low: float, high: float) -> str:
    return f"{low:.4g}" if f"{low:.4g}" == f"{high:.4g}" else f"{low:.4g} to {high:.4g}"


FACINGS = ("projected", "all")


@dataclass(frozen=True, eq=False)
class ContactCoupling:
    """Repulsion between two surfaces. Created by ``Scene.add_contact_coupling``.

    Attributes:
        name: Name of the coupling.
        surface_a: Surface whose faces have quadrature points.
        surface_b: The other surface.
        range: Coefficients of the pressure.
        facing: ``"projected"`` or ``"all"``.
        sides: ``"first"`` or ``"average"``.
        contacts: Its contacts: points of ``surface_a`` with ``surface_b``, and for ``"average"`` also the reverse.
    """

    name: str
    surface_a: Surface
    surface_b: Surface
    range: ContactRange
    facing: str
    sides: str
    contacts: tuple[Contact, ...]

    @staticmethod
    def from_impact(**impact: Any) -> ContactRange:
        """Returns coefficients that stop an expected impact; see ``ContactRange.from_impact``."""
        refuse_unknown("ContactCoupling.from_impact", impact, keywords_of(ContactRange.from_impact))
        return ContactRange.from_impact(**impact)

    def report(self, model: "Environments") -> CouplingReport:
        """Returns minimum distance and effective area of each environment since its reset."""
        return CouplingReport(
            name=self.name,
            effective_area=model.sensor(f"{self.name}.effective_area").astype(np.float64),
            minimum_distance=model.sensor(f"{self.name}.minimum_distance").astype(np.float64),
            effective_range=model[f"{self.name}.effective_range"],
            impact=self.range.impact,
            first_env=model.first_env,
        )


def add_contact_coupling(
    scene: "SceneData",
    surface_a: Surface,
    surface_b: Surface,
    contact_range: ContactRange,
    friction: Friction | None,
    *,
    facing: str,
    sides: str,
    quadrature: int,
    damping_ramp: float,
    name: str | None,
    color: ArrayLike | None,
    **options: Any,
) -> ContactCoupling:
    """Implements ``Scene.add_contact_coupling``; ``options`` are those of ``add_contact``.

    If it raises an error, the scene is unchanged.
    """
    name = scene.new_name("coupling", name)
    checks.choice(f"{name}.facing", facing, FACINGS)
    checks.choice(f"{name}.sides", sides, SIDES)
    number = check_quadrature(f"{name}.quadrature", quadrature)
    scene.check_surface(f"{name}.surface_a", surface_a)
    scene.check_surface(f"{name}.surface_b", surface_b)
    if surface_a.body is None:
        raise ValueError(
            f"{name}.surface_a must be on a body, got {surface_a.name!r} on the world; use it as surface_b"
        )
    if surface_a.body is surface_b.body:
        raise ValueError(f"{name}: both surfaces are fixed to body {surface_a.body.name!r}; one must move")
    if not isinstance(contact_range, ContactRange):
        raise TypeError(f"{name}.range must be a wc.ContactRange, got {contact_range!r}")
    material = _material(name, contact_range, friction, damping_ramp)
    pairs = [(surface_a, surface_b, f"{name}_first")]
    if sides == "average":
        pairs.append((surface_b, surface_a, f"{name}_second"))
    with scene.unchanged_on_error():
        contacts = []
        for own, other, label in pairs:
            points = scene.add_points(own, _points_of(name, own, number), name=f"{label}_points")
            contact = scene.add_contact(
                points,
                other,
                material,
                radius=contact_range.effective_range,
                force_scale=1.0 / len(pairs),
                name=label,
                color=checks.color(f"{name}.color", color),
                **{key: _named(name, key, value) for key, value in options.items()},
            )
            contacts.append(replace(contact, facing=facing))
            scene.exchange(contact, contacts[-1])
        coupling = ContactCoupling(name, surface_a, surface_b, contact_range, facing, sides, tuple(contacts))
        scene.include(coupling)
    return coupling


def check_quadrature(label: str, number: Any) -> int:
    """Returns ``number`` if there is a quadrature rule with this number of points; else raises ``ValueError``."""
    if isinstance(number, bool) or not isinstance(number, int) or number not in ORDERS:
        rules = ", ".join(map(str, ORDERS))
        raise ValueError(f"{label} must be a number of points per face, one of {rules}, got {number!r}")
    return number


_WORDS = {"search": ("whole", "active"), "boundary": ("off", "outer")}


def _named(name: str, key: str, value: Any) -> Any:
    """Returns an option; checks it here, so that messages name the coupling and not its contacts."""
    if key in ("enabled", "visible"):
        return checks.switch(f"{name}.{key}", value)
    return checks.choice(f"{name}.{key}", value, _WORDS[key]) if key in _WORDS else value


def _material(name: str, contact_range: ContactRange, friction: Friction | None, ramp: float) -> ContactMaterial:
    depth = float(checks.numbers(f"{name}.damping_ramp", ramp, (), laws.ContactRange.limits("ramp")))
    if friction is None:
        friction = Frictionless()
    if not isinstance(friction, Friction):
        raise TypeError(f"{name}.friction must be an instance of wc.Friction, got {friction!r}")
    if friction.needs_radius:
        raise ValueError(f"{name}.friction, {type(friction).__name__}, needs a radius, and faces have none")
    law = laws.ContactRange(k1=contact_range.k1, k2=contact_range.k2, ramp=depth)
    return ContactMaterial(law=law, friction=friction)


def _points_of(name: str, surface: Surface, number: int) -> Any:
    if len(surface.meshes) > 1:
        raise ValueError(
            f"{name}: {surface.name!r} must have one mesh, got {len(surface.meshes)}; use it as surface_b with "
            "sides='first'"
        )
    if not surface.active_faces.any():
        raise ValueError(f"{name}: {surface.name!r} has no active face")
    return face_points(surface.mesh, number, surface.active_faces)
