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
from warpcontact.scene.scene_element import SceneElement, check_class
from warpcontact.storage.allocation_plan import SENSOR_PURPOSE

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
    Family("body contact", lambda scene: scene.body_contacts, _OnDemand("body_contact.body_contact_set")),
    Family("particle contact", lambda scene: scene.particle_contacts, _OnDemand("particle_contact.contact_set")),
)


#: Start of the names of modules that are executed from files of experiments. Such a file is named with its class, as
#: ``FILE.py:CLASS``; therefore files of several experiments can have classes of the same name.
FILE_MODULE = "_warpcontact_own_"

# Families outside of the package, by class of their elements.
_REGISTERED: dict[type[SceneElement], Family] = {}


def register(kind: type[SceneElement], declare: Declare) -> None:
    """Registers a family of force elements outside of the package.

    USD descriptions and experiment files name the class. Therefore a class can be registered again after its module
    was executed again, but not a class of the same name that is defined elsewhere. Elements of the earlier class, in
    existing scenes, can still be built.

    Args:
        kind: Class of its elements, see ``Scene.add_force_element``.
        declare: Declares their device data, ``PointPairSet.declare`` for example.

    Raises:
        TypeError: If ``kind`` is no class of elements, or ``declare`` is no function.
        ValueError: If another class of the same name is registered.
    """
    check_class("kind", kind)
    if not callable(declare):
        raise TypeError(f"declare must be a function of a BuildContext and the elements, got {declare!r}")
    other = element_kinds().get(kind.__name__)
    if other is not None and not _is_in_file(kind) and _origin(other) != _origin(kind):
        raise ValueError(
            f"{kind.__name__} must have another name: {_origin(kind)} cannot be registered, because {_origin(other)} is, "
            "and files name the class only"
        )
    _REGISTERED.pop(kind, None)  # the last registered class of a name is the one that is found
    _REGISTERED[kind] = Family(
        kind.prefix(), lambda scene: [one for one in scene.force_elements if type(one) is kind], declare, kind
    )


def _origin(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _is_in_file(kind: type) -> bool:
    return kind.__module__.startswith(FILE_MODULE)


def families() -> tuple[Family, ...]:
    """Returns all families: those of the package in launch order, and those that were registered."""
    return (*FAMILIES, *_REGISTERED.values())


def element_kinds() -> dict[str, type[SceneElement]]:
    """Returns the registered classes that can be named without a file, by name."""
    kinds = (family.kind for family in families())
    return {kind.__name__: kind for kind in kinds if kind is not None and not _is_in_file(kind)}


def is_registered(kind: type[SceneElement]) -> bool:
    """Returns whether elements of a class can be built."""
    return any(family.kind is kind for family in families())


def declare_force_elements(context: BuildContext) -> tuple[ForceElement, ...]:
    """Declares the force elements of a model, in launch order.

    Raises:
        TypeError: If the scene has elements of a class that is not registered, or a registered function does not
            return force elements.
        ValueError: If such a force element has no name, or that of a family of the package.
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
            declared = family.declare(context, elements)
            if family.kind is not None:
                _check_declared(family, declared)
            made += declared
    return tuple(made)


def _check_declared(family: Family, declared: Any) -> None:
    """Checks the force elements of a registered family."""
    if not isinstance(declared, list) or not all(isinstance(one, ForceElement) for one in declared):
        raise TypeError(f"declare of {family.name} must return a list of ForceElement, got {declared!r}")
    # Arrays that are declared for sensors are not in checkpoints.
    taken = [*(one.name for one in FAMILIES), SENSOR_PURPOSE]
    for one in declared:
        given = getattr(one, "family", None)
        if not isinstance(given, str) or given in taken:
            raise ValueError(
                f"{type(one).__name__}.family must be a name other than {', '.join(taken)}, got {given!r}"
            )
