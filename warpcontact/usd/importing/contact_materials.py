"""Contact materials of imported contacts, from the physics materials of both sides; rules in ``docs/usd.md``."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from math import pi, sqrt
from typing import Any

from warpcontact.kernels.friction import CundallStrack, Friction, Frictionless
from warpcontact.kernels.laws import KelvinVoigt
from warpcontact.scene.elements import Body, ContactMaterial
from warpcontact.scene.material_table import MaterialTable
from warpcontact.usd.importing.findings import InvalidValue

#: Default coefficient of friction of colliders without one.
FRICTION = 0.5
#: Smallest restitution of the law; at 0 the damping would be infinite.
LEAST_RESTITUTION = 0.01
#: Depth relative to the size of a body above which a contact with a stiffness from the duration of an impact is deep.
DEEP = 0.01
# Ratio of tangential to normal stiffness. For a solid sphere, the half periods of both springs are then equal. The
# tangential dashpot has half the critical damping.
_TANGENTIAL_RATIO = 2.0 / 7.0


@dataclass(frozen=True)
class PhysicsMaterial:
    """Physics material of a collider; ``None``: not given.

    Attributes:
        static: Coefficient of static friction [-].
        dynamic: Coefficient of dynamic friction [-].
        restitution: Coefficient of restitution [-].
        stiffness: Stiffness of the contact [N/m].
        damping: Damping of the contact [N·s/m].
        rolling: Rolling friction: ratio of torque to normal force [m].
        torsion: Torsional friction: ratio of torque to normal force [m].
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
        """Returns a material from the result of ``read_material``; ``None``: the default material.

        A missing coefficient of friction is set to the other one.
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
        """Returns the mean of two materials; a value given by only one of them is used as it is."""
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
        material: Physics material of the collider.
        body: Body that forces move; ``None``: fixed or kinematic.
        name: Name of the physics material; ``None``: there is none.
    """

    material: PhysicsMaterial
    body: Body | None
    name: str | None = None

    @property
    def mass(self) -> float:
        """Mass of the body [kg]; infinite without a body."""
        return float("inf") if self.body is None else float(self.body.mass)

    @property
    def inertia(self) -> float:
        """Mean principal moment of inertia [kg·m²]; infinite without a body."""
        return float("inf") if self.body is None else float(self.body.inertia.trace()) / 3.0


class ContactMaterials:
    """Combines the physics materials of both sides into contact materials, shared by equal contacts.

    Args:
        given: Contact material of all contacts, or a table of them; ``None``: from the physics materials.
        contact_time: Duration of an impact [s], which gives the stiffness if no material does.
        gravity: Magnitude of gravity [m/s²].
    """

    def __init__(self, given: ContactMaterial | MaterialTable | None, contact_time: float, gravity: float) -> None:
        self.given = given
        self.contact_time = contact_time
        self.gravity = gravity
        self._deep = 0  # number of contacts that are deep under the weight of a body
        self._deepest = (DEEP, "")  # largest depth relative to the size of a body, and the remark on it
        self.made: dict[tuple[float | None, ...], tuple[ContactMaterial, dict[str, Any]]] = {}
        self._elastic = 0  # number of contacts that use the damping of a material and ignore its restitution
        self._rolling: list[str] = []  # contacts that ignore the rolling friction of a material
        self._torsion: list[str] = []  # contacts that ignore its torsional friction

    def are_apart(self, first: Side, second: Side) -> bool:
        """Returns whether the table of contact materials excepts contact of two colliders."""
        return isinstance(self.given, MaterialTable) and self.given_for(first, second) is None

    def given_for(self, first: Side, second: Side) -> ContactMaterial | None:
        """Returns the given contact material of two colliders; ``None``: it follows from the physics materials.

        Raises:
            InvalidValue: If the table has no entry for them.
        """
        if not isinstance(self.given, MaterialTable):
            return self.given
        try:
            return self.given.find(first.name, second.name)
        except KeyError:
            names = " and ".join(
                "no physics material" if one is None else repr(one) for one in (first.name, second.name)
            )
            raise InvalidValue(
                f"the table of materials has no entry for colliders with {names}, and no default entry, with the key None"
            ) from None

    def combine(
        self, label: str, first: Side, second: Side, radius: float | None, *, over_area: bool = False
    ) -> tuple[ContactMaterial, dict[str, Any]]:
        """Returns the contact material of a contact, and further keyword arguments of the contact.

        Args:
            label: Name of the contact in remarks.
            first: One side.
            second: Other side.
            radius: Rolling radius [m]; ``None``: there is none, or it depends on the contact point.
            over_area: Whether friction acts over the area of contact, which includes torsional friction.
        """
        given = self.given_for(first, second)
        if given is not None:
            return given, {}
        mixed = first.material.with_other(second.material)
        if mixed.damping is not None and mixed.restitution > 0.0:
            self._elastic += 1
        if mixed.rolling and radius is None:
            self._rolling.append(label)
        if mixed.torsion and over_area:
            self._torsion.append(label)
            mixed = replace(mixed, torsion=None)
        mass = 1.0 / (1.0 / first.mass + 1.0 / second.mass)
        inertia = 1.0 / (1.0 / first.inertia + 1.0 / second.inertia)
        if mixed.stiffness is None:
            self._note_depth(label, first, second, mass)
        key = (mass, *astuple(mixed), *((inertia, radius) if mixed.rolling or mixed.torsion else ()))
        if key not in self.made:
            self.made[key] = self._contact_material(mixed, mass, inertia, radius), _options(mixed)
        return self.made[key]

    def remarks(self) -> Sequence[str]:
        """Returns remarks on deep contacts, and on values of physics materials that no contact uses."""
        found = []
        if self._deep:
            found.append(f"{self._deep} contacts are deep if they are compliant. The deepest: {self._deepest[1]}")
        if self._elastic:
            found.append(
                f"{self._elastic} contacts use newton:contactDamping and ignore physics:restitution; MoreauJean "
                "uses a restitution of 0 there"
            )
        if self._rolling:
            found.append(
                f"newton:rollingFriction is ignored in {len(self._rolling)} contacts, such as "
                f"{self._rolling[0]}: there is no rolling radius, or it depends on the contact point"
            )
        if self._torsion:
            found.append(
                f"newton:torsionalFriction is ignored in {len(self._torsion)} body contacts, such as "
                f"{self._torsion[0]}: friction over the area of contact resists spin"
            )
        return found

    def _note_depth(self, label: str, first: Side, second: Side, mass: float) -> None:
        """Notes a contact that is deeper than ``DEEP`` times the size of a body under the weight of the heavier body [kg]."""
        bodies = [side.body for side in (first, second) if side.body is not None]
        heaviest = max(float(body.mass) for body in bodies)
        depth = heaviest * self.gravity / mass * (self.contact_time / pi) ** 2
        # Side of the cube with the mean moment of inertia.
        size = min(sqrt(2.0 * float(body.inertia.trace()) / float(body.mass)) for body in bodies)
        if depth <= DEEP * size:
            return
        self._deep += 1
        if depth > self._deepest[0] * size:
            limit = self.contact_time * sqrt(DEEP * size / depth)
            text = (
                f"{label} is {depth:.2g} m deep under the weight of {heaviest:.3g} kg, {100.0 * depth / size:.2g} % of the size "
                f"of a body, with the stiffness from contact_time = {self.contact_time:g} s. Use contact_time ≤ {limit:.2g} s, "
                "stiffer materials or MoreauJean"
            )
            self._deepest = depth / size, text

    def _contact_material(
        self, mixed: PhysicsMaterial, mass: float, inertia: float, radius: float | None
    ) -> ContactMaterial:
        stiffness = mass * (pi / self.contact_time) ** 2 if mixed.stiffness is None else mixed.stiffness
        tangential_stiffness = _TANGENTIAL_RATIO * stiffness
        friction = CundallStrack(
            mu_static=mixed.static,
            mu_dynamic=mixed.dynamic,
            stiffness=tangential_stiffness,
            damping=sqrt(_TANGENTIAL_RATIO * mass * tangential_stiffness),
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
            # Newton's coefficient is used as torsion radius, with a coefficient of 1: torque ≤ torsion × N.
            torsion=_resistance(1.0, inertia / mixed.torsion**2, rate) if mixed.torsion else Frictionless(),
        )


def _resistance(mu: float, mass: float, rate: float) -> Friction:
    """Returns a friction model with stick for rolling or torsion.

    Args:
        mu: Coefficient [-].
        mass: Inertia divided by the squared arm [kg].
        rate: Normal stiffness over mass of the contact [1/s²]; the tangential spring has the same period.
    """
    return CundallStrack(mu_static=mu, mu_dynamic=mu, stiffness=mass * rate, damping=mass * sqrt(rate))


def _options(mixed: PhysicsMaterial) -> dict[str, Any]:
    return {"torsion_radius": mixed.torsion} if mixed.torsion else {}


def _mean(first: float | None, second: float | None) -> float | None:
    if first is None or second is None:
        return second if first is None else first
    return 0.5 * (first + second)
