"""Access to the public API of a package whose names may be older or newer than this script.

``NAMES`` maps each name that the golden scenes use to its spellings, newest first. ``Names`` uses the first
spelling that the package has, so that the same scenes run before and after a renaming. Names that are not in the
table are used as they are. ``Names`` also records which classes of the catalogs the scenes use.
"""

import inspect
from collections import defaultdict
from collections.abc import Callable, Iterable
from types import ModuleType
from typing import Any

#: Spellings of each name of the public API, newest first.
NAMES: dict[str, tuple[str, ...]] = {
    # Attributes of the package.
    "ContactMaterial": ("ContactMaterial", "Template"),
    "friction": ("friction", "frictions"),
    "history": ("history", "memory"),
    "StopCondition": ("StopCondition", "Stop"),
    "ContactEvents": ("ContactEvents", "Events"),
    "ParametricSurface": ("ParametricSurface", "Patch"),
    # Joints, in the module that has them.
    "Revolute": ("Revolute", "Hinge"),
    "Prismatic": ("Prismatic", "Slider"),
    "Spherical": ("Spherical", "Ball"),
    # Methods of scenes and models.
    "add_shape_contact": ("add_shape_contact", "add_smooth_contact"),
    "add_particle_contact": ("add_particle_contact", "add_mutual_contact"),
    "sensor": ("sensor", "reading"),
    "sensor_names": ("sensor_names", "reading_names"),
    "contact_pairs": ("contact_pairs", "touching"),
    "catenary_shape": ("catenary_shape", "line_shape"),
    "catenary_stiffness": ("catenary_stiffness", "line_stiffness"),
    # Keywords, and parameters of the same name.
    "boundary": ("boundary", "rim"),
    "crossing_substeps": ("crossing_substeps", "crossing_steps"),
    "force_scale": ("force_scale", "share"),
    "max_neighbors": ("max_neighbors", "partners"),
    "own": ("custom_types", "own"),
    # Sensors.
    "scene.friction_dissipation": ("scene.friction_dissipation", "scene.friction_loss"),
    "scene.impact_dissipation": ("scene.impact_dissipation", "scene.impact_loss"),
    "scene.restitution_limited": ("scene.restitution_limited", "scene.restrained"),
}

#: Modules that have the classes of a catalog, in search order.
MODULES: dict[str, tuple[str, ...]] = {
    "law": ("laws",),
    "friction": ("friction", "frictions"),
    "joint": ("motions", "joints"),
    "shape": ("shapes",),
    "spring": ("springs",),
    "outcome": ("outcomes",),
    "integrator": ("integrators",),
}


def spellings(name: str) -> tuple[str, ...]:
    """Returns the spellings of a name, newest first.

    For a path such as ``touch.force_scale`` these are the spellings of the whole path, or else of its last part.
    """
    if name in NAMES:
        return NAMES[name]
    element, dot, quantity = name.rpartition(".")
    if dot and quantity in NAMES:
        return tuple(f"{element}.{spelling}" for spelling in NAMES[quantity])
    return (name,)


def first_of(candidates: Iterable[str], available: Callable[[str], bool], owner: str) -> str:
    """Returns the first candidate that is available.

    Raises:
        AttributeError: If none is; the message lists them.
    """
    tried = tuple(candidates)
    for name in tried:
        if available(name):
            return name
    raise AttributeError(f"{owner} has none of {', '.join(tried)}")


def canonical(name: str) -> str:
    """Returns the name under which results are compared: the newest spelling of a sensor or parameter."""
    for newest, old in NAMES.items():
        if name in old:
            return newest
        element, dot, quantity = name.rpartition(".")
        if dot and quantity in old and "." not in newest:
            return f"{element}.{newest}"
    return name


class Names:
    """The public API of one package under the names of this script.

    Attributes of the package are attributes of this object: ``names.Scene``, ``names.ContactMaterial``.

    Args:
        package: The imported package, ``warpcontact``.

    Attributes:
        used: Names of the classes made by ``make``, by catalog.
    """

    def __init__(self, package: ModuleType) -> None:
        self.package = package
        self.used: dict[str, set[str]] = defaultdict(set)

    def __getattr__(self, name: str) -> Any:
        return self.attribute(self.package, name)

    def attribute(self, owner: Any, name: str) -> Any:
        """Returns an attribute of ``owner`` by the first spelling that it has."""
        found = first_of(spellings(name), lambda spelling: hasattr(owner, spelling), _described(owner))
        return getattr(owner, found)

    def make(self, catalog: str, kind: str, /, *args: Any, **values: Any) -> Any:
        """Returns an instance of a class of a catalog.

        Args:
            catalog: Key of ``MODULES``.
            kind: Name of the class.
            *args: Positional arguments of the class.
            **values: Its parameters.
        """
        modules = [getattr(self.package, one) for one in MODULES[catalog] if hasattr(self.package, one)]
        for module in modules:
            for spelling in spellings(kind):
                if hasattr(module, spelling):
                    self.used[catalog].add(spelling)
                    return getattr(module, spelling)(*args, **values)
        raise AttributeError(f"{' and '.join(MODULES[catalog])} have no {kind}")

    def call(self, function: Callable[..., Any], /, *args: Any, **keywords: Any) -> Any:
        """Calls ``function`` with the spelling of each keyword that its signature has."""
        known = inspect.signature(function).parameters
        spelled = {
            first_of(spellings(keyword), known.__contains__, f"{_described(function)}()"): value
            for keyword, value in keywords.items()
        }
        return function(*args, **spelled)

    def method(self, owner: Any, name: str, /, *args: Any, **keywords: Any) -> Any:
        """Calls a method of ``owner`` by its first spelling, with the spelling of each keyword that it has."""
        return self.call(self.attribute(owner, name), *args, **keywords)

    def path(self, name: str, available: Iterable[str]) -> str:
        """Returns the spelling of a sensor or parameter that is among those available."""
        names = set(available)
        return first_of(spellings(name), names.__contains__, "the model")

    def sensor_paths(self, model: Any, names: Iterable[str]) -> list[str]:
        """Returns the spellings of sensors that ``model`` has."""
        available = self.attribute(model, "sensor_names")
        return [self.path(name, available) for name in names]

    def sensor(self, model: Any, name: str) -> Any:
        """Returns the current values of a sensor, (envs, …)."""
        (path,) = self.sensor_paths(model, [name])
        return self.attribute(model, "sensor")(path)

    def catalog(self, catalog: str) -> tuple[str, ...]:
        """Returns the names of all classes of a catalog of the package, without duplicates."""
        modules = [getattr(self.package, name) for name in MODULES[catalog] if hasattr(self.package, name)]
        found: dict[str, None] = {}
        for module in modules:
            for table in ("NAMES", "OUTCOMES", "INTEGRATORS", "SPRING_NAMES", "DAMPER_NAMES"):
                found |= dict.fromkeys(getattr(module, table, ()))
        return tuple(found)

    def uncovered(self) -> dict[str, list[str]]:
        """Returns the classes of each catalog that were not made by ``make``; complete catalogs are left out."""
        missing = {
            catalog: [name for name in self.catalog(catalog) if name not in self.used[catalog]]
            for catalog in MODULES
        }
        return {catalog: names for catalog, names in missing.items() if names}


def _described(owner: Any) -> str:
    return getattr(owner, "__name__", type(owner).__name__)
