"""Public names of earlier versions, and the errors for them."""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

C = TypeVar("C")

#: Present name by earlier name: attributes of the package, methods, keywords, tables and keys of experiment files,
#: and quantities of sensors and parameters.
RENAMED = {
    # Attributes of the package.
    "Template": "ContactMaterial",
    "frictions": "friction",
    "memory": "history",
    "SmoothContact": "ShapeContact",
    "Patch": "ParametricSurface",
    "Status": "ContactStatus",
    "LineStatus": "CatenaryStatus",
    "Cause": "FailureCause",
    "Stop": "StopCondition",
    "Events": "ContactEvents",
    "StageError": "UsdError",
    "StoreError": "RunDataError",
    "plot_frictions": "plot_friction_models",
    # Attributes and methods of objects.
    "add_smooth_contact": "add_shape_contact",
    "add_mutual_contact": "add_particle_contact",
    "smooth_contacts": "shape_contacts",
    "mutual_contacts": "particle_contacts",
    "remarks": "import_warnings",
    "reading": "sensor",
    "reading_names": "sensor_names",
    "touching": "contact_pairs",
    "line_shape": "catenary_shape",
    "line_stiffness": "catenary_stiffness",
    "advice": "check",
    "step_in_frames": "step_with_callback",
    "border_edge_count": "boundary_edge_count",
    "border_loop_count": "boundary_loop_count",
    # Keywords, and tables and keys of experiment files.
    "template": "material",
    "smooth_contact": "shape_contact",
    "mutual_contact": "particle_contact",
    "readings": "sensors",
    "rim": "boundary",
    "share": "force_scale",
    "partners": "max_neighbors",
    "own": "custom_types",
    "crossing_steps": "crossing_substeps",
    "graphs": "capture_graphs",
    # Quantities of sensors.
    "restrained": "restitution_limited",
    "friction_loss": "friction_dissipation",
    "impact_loss": "impact_dissipation",
}


def present_name(name: object, known: Iterable[str]) -> str | None:
    """Returns the present name of ``name`` if it was renamed and the present name is among ``known``.

    In a name with dots, such as a sensor, the last part is the renamed one.
    """
    owner, dot, last = str(name).rpartition(".")
    new = f"{owner}{dot}{RENAMED[last]}" if last in RENAMED else None
    return new if new in set(known) else None


def explain_renamed(kind: type[C]) -> type[C]:
    """Decorates a class: access to a renamed attribute raises an ``AttributeError`` with the present name."""

    def missing(self: Any, name: str) -> Any:
        if hasattr(type(self), name):  # a property that raised
            return object.__getattribute__(self, name)
        owner = type(self).__name__
        new = RENAMED.get(name)
        if new is None or not (new in vars(self) or hasattr(type(self), new)):
            raise AttributeError(f"{owner!r} object has no attribute {name!r}", name=name, obj=self)
        raise AttributeError(f"{owner}.{name} is now {owner}.{new}")

    kind.__getattr__ = missing  # type: ignore[attr-defined]
    return kind


def explain_renamed_in(module: str, names: Iterable[str]) -> Callable[[str], Any]:
    """Returns the ``__getattr__`` of a module for access to renamed public ``names``."""
    known = frozenset(names)

    def missing(name: str) -> Any:
        if (new := present_name(name, known)) is not None:
            raise AttributeError(f"{module}.{name} is now {module}.{new}")
        raise AttributeError(f"module {module!r} has no attribute {name!r}", name=name)

    return missing
