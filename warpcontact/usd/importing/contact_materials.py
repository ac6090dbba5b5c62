"""Law and friction of the contacts of a stage, from the materials of both sides; ``docs/usd.md`` has the rules."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from math import pi, sqrt
from typing import Any

from warpcontact.kernels.friction import CundallStrack, Friction, Frictionless
from warpcontact.kernels.laws import KelvinVoigt
from warpcontact.scene.elements import Body, ContactMaterial

#: Friction where no physics material gives any.
FRICTION = 0.5
#: Least restitution of the law: at 0 its dashpot would be infinite.
LEAST_RESTITUTION = 0.01
# A spring along the tangent that is this part of the one along the normal has half a period of the same length
# for a solid sphere; its dashpot has half of the critical damping.
_ASIDE = 2.0 / 7.0


@dataclass(frozen=True)
class PhysicsMaterial:
    """Physics material of a collider; ``None``: not given.

    Attributes:
        static: Coefficient of static friction [-].
        dynamic: Coefficient of dynamic friction [-].
        restitution: Coefficient of restitution [-].
        stiffness: Stiffness of the contact [N/m].
        damping: Damping of the contact [N·s/m].
        rolling: Rolling friction: couple over normal force [m].
        torsion: Torsional friction: couple over normal force [m].
    """

    static: float = FRICTION
    dynamic: float = FRICTION
    restitution: float = 0.0
    stiffness: float | None = None
    damping: float | None = None
    rolling: float | None = None
    torsion: float | None = None

    @classmethod
    def of(cls, record: dict[str, Any] | None) -> "PhysicsMaterial":
        """Returns a material as ``read_material`` describes it; ``None``: no material.

        A coefficient of friction that is not given is the other one: friction at rest is at least that of sliding.
        """
        if record is None:
            return cls()
        static, dynamic = record["static"], record["dynamic"]
        if dynamic is None:
            dynamic = FRICTION if static is None else static
        return cls(
            static=dynamic if static is None else static,
            dynamic=dynamic,
            restitution=record["restitution"] or 0.0,
            **{key: record[key] for key in ("stiffness", "damping", "rolling", "torsion")},
        )

    def with_other(self, second: "PhysicsMaterial") -> "PhysicsMaterial":
        """Returns the means of two materials; of a value that only one of them gives, that value."""
        return PhysicsMaterial(
            static=0.5 * (self.static + second.static),
            dynamic=0.5 * (self.dynamic + second.dynamic),
            restitution=0.5 * (self.restitution + second.restitution),
            stiffness=_mean(self.stiffness, second.stiffness),
            damping=_mean(self.damping, second.damping),
            rolling=_mean(self.rolling, second.rolling),
            torsion=_mean(self.torsion, second.torsion),
        )


@dataclass(frozen=True)
class Side:
    """One side of a contact.

    Attributes:
        material: Its material.
        body: Its body; ``None``: it does not move.
    """

    material: PhysicsMaterial
    body: Body | None

    @property
    def mass(self) -> float:
        """Mass that an impact accelerates [kg]."""
        return float("inf") if self.body is None else float(self.body.mass)

    @property
    def inertia(self) -> float:
        """Mean principal moment of inertia [kg·m²]."""
        return float("inf") if self.body is None else float(self.body.inertia.trace()) / 3.0


class ContactMaterials:
    """Combines the materials of both sides into law and friction, one object for all contacts that are alike.

    Args:
        given: Law and friction of all contacts; ``None``: from materials.
        contact_time: Duration of an impact, from which stiffness follows if no material gives it [s].
    """

    def __init__(self, given: ContactMaterial | None, contact_time: float) -> None:
        self.given = given
        self.contact_time = contact_time
        self.made: dict[tuple[float | None, ...], tuple[ContactMaterial, dict[str, Any]]] = {}
        self._elastic = 0  # contacts that take the damping of a material and not its restitution
        self._rolling: list[str] = []  # contacts without the rolling friction of a material

    def combine(
        self, label: str, first: Side, second: Side, radius: float | None
    ) -> tuple[ContactMaterial, dict[str, Any]]:
        """Returns law and friction of a contact, and its options.

        Args:
            label: The contact in remarks.
            first: One side.
            second: The other one.
            radius: Radius of rolling [m]; ``None``: none, or it depends on where both touch.
        """
        if self.given is not None:
            return self.given, {}
        mixed = first.material.with_other(second.material)
        if mixed.damping is not None and mixed.restitution > 0.0:
            self._elastic += 1
        if mixed.rolling and radius is None:
            self._rolling.append(label)
        mass = 1.0 / (1.0 / first.mass + 1.0 / second.mass)
        inertia = 1.0 / (1.0 / first.inertia + 1.0 / second.inertia)
        key = (mass, *astuple(mixed), *((inertia, radius) if mixed.rolling or mixed.torsion else ()))
        if key not in self.made:
            self.made[key] = self._contact_material(mixed, mass, inertia, radius), _options(mixed)
        return self.made[key]

    def remarks(self) -> Sequence[str]:
        """Returns remarks on values of materials that contacts do not use."""
        found = []
        if self._elastic:
            found.append(
                f"{self._elastic} contacts take newton:contactDamping and not physics:restitution; MoreauJean "
                "takes a restitution of 0 there"
            )
        if self._rolling:
            found.append(
                f"newton:rollingFriction is not used in {len(self._rolling)} contacts, such as "
                f"{self._rolling[0]}: there is no radius of rolling, or it depends on where both sides touch"
            )
        return found

    def _contact_material(
        self, mixed: PhysicsMaterial, mass: float, inertia: float, radius: float | None
    ) -> ContactMaterial:
        stiffness = mass * (pi / self.contact_time) ** 2 if mixed.stiffness is None else mixed.stiffness
        aside = _ASIDE * stiffness
        friction = CundallStrack(
            mu_static=mixed.static,
            mu_dynamic=mixed.dynamic,
            stiffness=aside,
            damping=sqrt(_ASIDE * mass * aside),
        )
        loss = (
            {"restitution": max(mixed.restitution, LEAST_RESTITUTION)}
            if mixed.damping is None
            else {"damping": mixed.damping}
        )
        rate = stiffness / mass
        return ContactMaterial(
            law=KelvinVoigt(stiffness=stiffness, **loss),
            friction=friction if mixed.static or mixed.dynamic else Frictionless(),
            rolling=_resistance(mixed.rolling / radius, inertia / radius**2, rate)
            if mixed.rolling and radius is not None
            else Frictionless(),
            # An arm of the coefficient of Newton with a coefficient of 1: the couple is at most torsion × N.
            torsion=_resistance(1.0, inertia / mixed.torsion**2, rate) if mixed.torsion else Frictionless(),
        )


def _resistance(mu: float, mass: float, rate: float) -> Friction:
    """Returns resistance to rotation that holds at rest.

    Args:
        mu: Its coefficient [-].
        mass: Inertia over the arm squared [kg].
        rate: Stiffness over mass of the contact along its normal [1/s²]: its spring has the same period.
    """
    return CundallStrack(mu_static=mu, mu_dynamic=mu, stiffness=mass * rate, damping=mass * sqrt(rate))


def _options(mixed: PhysicsMaterial) -> dict[str, Any]:
    return {"torsion_radius": mixed.torsion} if mixed.torsion else {}


def _mean(first: float | None, second: float | None) -> float | None:
    if first is None or second is None:
        return second if first is None else first
    return 0.5 * (first + second)
