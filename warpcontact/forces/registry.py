"""Registry of the families of force elements, in the order in which they are declared and launched.

A new family is a folder and one line in ``FAMILIES``. The order is part of the results: the ends of a family are
summed after those of the families before it. Families outside of the package are added by ``register``; they follow
in the order in which a scene first has their elements.
"""

import importlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from warpcontact.forces.force_element import BuildContext, ForceElement
from warpcontact.kernels.types import FREE
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.scene_element import SceneElement

#: Declares the force elements of the elements of a scene, in launch order.
Declare = Callable[[BuildContext, Sequence[Any]], list[ForceElement]]


@dataclass(frozen=True)
class Family:
    """A family of force elements.

    Attributes:
        name: Name of the family, ``ForceElement.family``.
        elements: Returns the elements of the family in a scene.
        declare: Declares their device data; called only if there are elements.
        kind: Class of its elements in ``Scene.add_force_element``; ``None``: ``Scene`` has methods for them.
    """

    name: str
    elements: Callable[[SceneData], Sequence[Any]]
    declare: Declare
    kind: type[SceneElement] | None = None

    @property
    def home(self) -> str:
        """Module that declares the device data."""
        if isinstance(self.declare, _OnDemand):
            return f"warpcontact.forces.{self.declare.module}"
        return self.declare.__module__


@dataclass(frozen=True)
class _OnDemand:
    """The function ``declare`` of a module, imported at the first call, because Warp parses imported kernels.

    Attributes:
        module: The module, below ``warpcontact.forces``.
    """

    module: str

    def __call__(self, context: BuildContext, elements: Sequence[Any]) -> list[ForceElement]:
        declare: Declare = importlib.import_module(f"warpcontact.forces.{self.module}").declare
        return declare(context, elements)


#: All families. Launches of the same target run in this order.
FAMILIES: tuple[Family, ...] = (
    Family(
        "joints",
        lambda scene: [body for body in scene.bodies if body.motion.kind != FREE],
        _OnDemand("joints.joint_set"),
    ),
    Family("mesh contact", lambda scene: scene.contacts, _OnDemand("mesh_contact.mesh_contact")),
    Family(
        "contact coupling",
        lambda scene: scene.contact_couplings,
        _OnDemand("contact_coupling.contact_coupling_set"),
    ),
    Family("couplings", lambda scene: scene.couplings, _OnDemand("couplings.sets")),
    Family("shape contact", lambda scene: scene.shape_contacts, _OnDemand("shape_contact.contact_sets")),
    Family("particle contact", lambda scene: scene.particle_contacts, _OnDemand("particle_contact.contact_set")),
)


# Families outside of the package, by class of their elements.
_REGISTERED: dict[type[SceneElement], Family] = {}


def register(kind: type[SceneElement], declare: Declare) -> None:
    """Registers a family of force elements outside of the package.

    Args:
        kind: Class of its elements, see ``Scene.add_force_element``.
        declare: Declares their device data.
    """
    _REGISTERED[kind] = Family(
        kind.prefix(), lambda scene: [one for one in scene.force_elements if type(one) is kind], declare, kind
    )


def families() -> tuple[Family, ...]:
    """Returns all families: those of the package in launch order, and those that were registered."""
    return (*FAMILIES, *_REGISTERED.values())


def element_kinds() -> dict[str, type[SceneElement]]:
    """Returns the classes of elements that ``Scene.add_force_element`` adds, by name; the last registered one."""
    kinds = (family.kind for family in families())
    return {kind.__name__: kind for kind in kinds if kind is not None}


def is_registered(kind: type[SceneElement]) -> bool:
    """Returns whether elements of a class can be built."""
    return any(family.kind is kind for family in families())


def declare_force_elements(context: BuildContext) -> tuple[ForceElement, ...]:
    """Declares the force elements of a model, in launch order.

    Raises:
        TypeError: If the scene has elements of a class that is not registered.
    """
    families = list(FAMILIES)
    for kind in dict.fromkeys(type(element) for element in context.scene.force_elements):
        if not is_registered(kind):
            raise TypeError(f"{kind.__name__} is not a registered family of force elements; see registry.register")
        if kind in _REGISTERED:
            families.append(_REGISTERED[kind])
    made: list[ForceElement] = []
    for family in families:
        elements = family.elements(context.scene)
        if elements:
            made += family.declare(context, elements)
    return tuple(made)
