"""Contact couplings: repulsive pressure between two surfaces within a range.

``add_contact_coupling`` creates them from point contacts at quadrature points of the faces.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from warpcontact.kernels import laws
from warpcontact.kernels.catalogue.keywords import keywords_of, refuse_unknown
from warpcontact.kernels.friction import Friction, Frictionless
from warpcontact.meshes.sample import ORDERS, face_points
from warpcontact.scene.contact_range import ContactRange
from warpcontact.scene.elements import Contact, ContactMaterial, Surface
from warpcontact.scene.surface_contact import SIDES
from warpcontact.validation import checks

if TYPE_CHECKING:
    from warpcontact.model.environments import Environments
    from warpcontact.scene.contact_coupling_report import CouplingReport
    from warpcontact.scene.scene_data import SceneData

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

    def report(self, model: "Environments") -> "CouplingReport":
        """Returns minimum distance and effective area of each environment since its reset."""
        from warpcontact.scene.contact_coupling_report import report

        return report(self, model)


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
    for label, surface in (("surface_a", surface_a), ("surface_b", surface_b)):
        if not isinstance(surface, Surface) or surface not in scene.surfaces:
            raise ValueError(
                f"{name}.{label} must come from add_surface of this scene, got {checks.element(surface)}"
            )
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
    before = scene.snapshot()
    try:
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
    except Exception:
        scene.restore(before)
        raise
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
