"""Registry of the families of force elements, in the order in which they are declared and launched.

A new family is a folder and one line in ``FAMILIES``. The order is part of the results: the ends of a family are
summed after those of the families before it.
"""

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from warpcontact.forces.force_element import BuildContext, ForceElement
from warpcontact.kernels.types import FREE
from warpcontact.scene.scene_data import SceneData

#: Declares the force elements of the elements of a scene, in launch order.
Declare = Callable[[BuildContext, Sequence[Any]], list[ForceElement]]


@dataclass(frozen=True)
class Family:
    """A family of force elements.

    Attributes:
        name: Name of the family, ``ForceElement.family``.
        elements: Returns the elements of the family in a scene.
        declare: Declares their device data; called only if there are elements.
    """

    name: str
    elements: Callable[[SceneData], Sequence[Any]]
    declare: Declare


def _on_demand(module: str) -> Declare:
    """Returns ``declare`` of a module below ``forces``, imported at the first call: Warp parses imported kernels."""

    def declare(context: BuildContext, elements: Sequence[Any]) -> list[ForceElement]:
        found: Declare = importlib.import_module(f"warpcontact.forces.{module}").declare
        return found(context, elements)

    return declare


#: All families. Launches of the same target run in this order.
FAMILIES: tuple[Family, ...] = (
    Family(
        "joints",
        lambda scene: [body for body in scene.bodies if body.motion.kind != FREE],
        _on_demand("joints.joint_set"),
    ),
    Family("mesh contact", lambda scene: scene.contacts, _on_demand("mesh_contact.mesh_contact")),
    Family(
        "contact coupling",
        lambda scene: scene.contact_couplings,
        _on_demand("contact_coupling.contact_coupling_set"),
    ),
    Family("couplings", lambda scene: scene.couplings, _on_demand("couplings.sets")),
    Family("shape contact", lambda scene: scene.shape_contacts, _on_demand("shape_contact.contact_sets")),
    Family("particle contact", lambda scene: scene.particle_contacts, _on_demand("particle_contact.contact_set")),
)


def declare_force_elements(context: BuildContext) -> tuple[ForceElement, ...]:
    """Declares the force elements of a model, in launch order."""
    made: list[ForceElement] = []
    for family in FAMILIES:
        elements = family.elements(context.scene)
        if elements:
            made += family.declare(context, elements)
    return tuple(made)
