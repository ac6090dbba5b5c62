"""Serializes a scene: each element as the call of ``Scene`` that adds it, with classes by name.

An element stores its checked arguments. The calls are listed in the order in which elements were added; repeating them
creates a bitwise identical scene. Used by ``description.py``.
"""

import functools
import inspect
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from warpcontact.kernels import friction, joints, laws, shapes
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.couplings import springs
from warpcontact.kernels.couplings.springs import Damper, Spring
from warpcontact.kernels.friction import Friction
from warpcontact.kernels.joints import Free, Motion
from warpcontact.kernels.laws import Law
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.scene.body_contact import BodyContact
from warpcontact.scene.contact_coupling import ContactCoupling
from warpcontact.scene.couplings import Bushing, Catenary, SpringDamper
from warpcontact.scene.elements import Body, Contact, Points, Surface
from warpcontact.scene.material_table import MaterialTable
from warpcontact.scene.particles import ParticleContact
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.scene_element import SceneElement
from warpcontact.scene.shapes import Shape, ShapeContact
from warpcontact.validation.checks import Array

#: Classes of the library, by base class.
LIBRARY: Mapping[type[Formula], tuple[type[Any], ...]] = {
    Law: (*laws.CATALOGUE, *laws.RIGID),
    Friction: (*friction.CATALOGUE, *friction.RIGID),
    Spring: springs.SPRINGS,
    Damper: springs.DAMPERS,
    Motion: joints.CATALOGUE,
    Form: shapes.CATALOGUE,
}
_ALL = frozenset(kind for kinds in LIBRARY.values() for kind in kinds)

#: Method of ``Scene`` that adds an element, by its kind.
ADDERS = {
    "body": "add_body",
    "bodies": "add_bodies",
    "surface": "add_surface",
    "point": "add_point",
    "points": "add_points",
    "contact": "add_contact",
    "contact_coupling": "add_contact_coupling",
    "spring_damper": "add_spring_damper",
    "bushing": "add_bushing",
    "catenary": "add_catenary",
    "shape": "add_shape",
    "shape_contact": "add_shape_contact",
    "particle_contact": "add_particle_contact",
    "body_contact": "add_body_contact",
}
#: Kind of the elements that ``Scene.add_force_element`` adds; the argument ``type`` is the name of their class.
FORCE_ELEMENT = "force_element"
#: Arguments that are booleans but stored as 0 or 1.
SWITCHES = ("enabled", "tension_only")
# Arguments that are contained in another one: the meshes of a surface are stored as flipped.
_DERIVED_ARGUMENTS = {"surface": ("flip",)}
# Values that stand for an argument: normals of sampled points, and the table of contact materials, see ``_table_values``.
_ADDED_ARGUMENTS = {"points": ("normals",), "body_contact": ("pair_names", "pair_materials")}


def is_custom(kind: type[Formula]) -> bool:
    """Returns whether a class does not belong to the library."""
    return kind not in _ALL


class Catalogue:
    """Classes by name.

    Args:
        custom_types: Custom classes of the caller.

    Raises:
        TypeError: If one of them is not derived from a base class in ``LIBRARY``, or from ``SceneElement``.
        ValueError: If two of them have the same name.
    """

    def __init__(self, custom_types: Iterable[type[Formula] | type[SceneElement]] = ()) -> None:
        self._custom_types: dict[str, Any] = {}
        for kind in custom_types:
            if not isinstance(kind, type) or not issubclass(kind, (*LIBRARY, SceneElement)):
                raise TypeError(
                    "custom_types must be classes derived from wc.Law, wc.Friction, wc.Spring, wc.Damper, wc.Motion, "
                    f"wc.ParametricSurface or SceneElement, got {kind!r}"
                )
            if self._custom_types.setdefault(kind.__name__, kind) is not kind:
                raise ValueError(f"custom_types must have distinct names, got two classes named {kind.__name__!r}")

    @property
    def force_elements(self) -> dict[str, type[SceneElement]]:
        """Custom classes of force elements, by name."""
        return {name: kind for name, kind in self._custom_types.items() if issubclass(kind, SceneElement)}

    def find(self, base: type[Formula], name: str, custom_types: bool) -> type[Formula]:
        """Returns the class with a name.

        Args:
            base: Required base class.
            name: Name of the class.
            custom_types: Whether to search the custom classes instead of the library.

        Raises:
            LookupError: If there is no such class; the message lists those that exist.
        """
        if custom_types:
            kind: Any = self._custom_types.get(name)
            if kind is None or not issubclass(kind, base):
                raise LookupError(
                    f"{name!r} is a {base.__name__.lower()} not in the library; pass the class: custom_types=[{name}]"
                )
            return kind
        table = {kind.__name__: kind for kind in LIBRARY[base]}
        if name not in table:
            raise LookupError(f"there is no {base.__name__.lower()} {name[:80]!r}; there are: {', '.join(table)}")
        return table[name]


@dataclass(frozen=True)
class ElementCall:
    """Element as the call that adds it.

    Attributes:
        kind: One of ``ADDERS``, or ``FORCE_ELEMENT``.
        name: Name of the element.
        arguments: Arguments by name, without those equal to their default. Numbers are Python numbers or arrays.
        rows: Names of the arguments with one entry per item of a set.
    """

    kind: str
    name: str
    arguments: dict[str, Any]
    rows: frozenset[str]


@dataclass(frozen=True)
class ShapeParameters:
    """Parameters of one or several shapes of one class.

    Attributes:
        kind: Class of the shapes.
        sizes: Parameters by name, one entry per shape, (n, …).
    """

    kind: type
    sizes: dict[str, Array]


@functools.cache
def argument_names(kind: str) -> tuple[str, ...]:
    """Returns the argument names of elements of a kind, and the names of further values that stand for an argument."""
    names = tuple(inspect.signature(getattr(SceneData, ADDERS[kind])).parameters)[1:]
    names_without_derived = tuple(
        name for name in names if name != "name" and name not in _DERIVED_ARGUMENTS.get(kind, ())
    )
    return (*names_without_derived, *_ADDED_ARGUMENTS.get(kind, ()))


@functools.cache
def required_names(kind: str) -> tuple[str, ...]:
    """Returns the names of the required arguments of elements of a kind."""
    parameters = inspect.signature(getattr(SceneData, ADDERS[kind])).parameters.values()
    return tuple(one.name for one in parameters if one.default is inspect.Parameter.empty)[1:]


def element_calls(scene: SceneData) -> list[ElementCall]:
    """Returns all elements in the order in which they were added; parts of a contact coupling are omitted."""
    parts = set[str]()
    for coupling in scene.contact_couplings:
        for contact in coupling.contacts:
            parts |= {contact.name, contact.points.name}
    return [_element_call(element) for element in scene.elements() if element.name not in parts]


def _element_call(element: Any) -> ElementCall:
    if isinstance(element, SceneElement):
        values = {field.name: getattr(element, field.name) for field in element.arguments()}
        given = {name: _plain(name, value) for name, value in values.items() if value is not None}
        return ElementCall(FORCE_ELEMENT, element.name, {"type": type(element).__name__, **given}, frozenset())
    kind, overrides, rows = _call_arguments(element)
    arguments = {}
    for name in argument_names(kind):
        value = overrides[name] if name in overrides else getattr(element, name)
        if value is not None:
            plain = _plain(name, value)
            if not _is_default(plain, _defaults(kind).get(name)):
                arguments[name] = plain
    return ElementCall(kind, element.name, arguments, frozenset(rows) & arguments.keys())


@functools.cache
def _defaults(kind: str) -> dict[str, Any]:
    parameters = inspect.signature(getattr(SceneData, ADDERS[kind])).parameters.values()
    return {one.name: one.default for one in parameters if one.default is not inspect.Parameter.empty}


def _is_default(value: Any, default: Any) -> bool:
    """Returns whether a value is bitwise identical to the default of its argument."""
    if isinstance(value, np.ndarray):
        return isinstance(default, tuple) and value.tobytes() == np.array(default, dtype=np.float64).tobytes()
    return (
        isinstance(value, bool | int | float | str)
        and type(value) is type(default)
        and repr(value) == repr(default)
    )


def _plain(name: str, value: Any) -> Any:
    if name in SWITCHES:
        return bool(value)
    return value.item() if isinstance(value, np.ndarray) and value.ndim == 0 else value


def _call_arguments(element: Any) -> tuple[str, dict[str, Any], tuple[str, ...]]:
    """Returns kind, the arguments that differ from the attributes of the same name, and names of those in rows."""
    match element:
        case Body(single=True):
            return "body", {"motion": _motion(element)}, ()
        case Body():
            attributes = {
                "positions": element.position,
                "orientations": element.orientation,
                "linear_velocities": element.linear_velocity,
                "angular_velocities": element.angular_velocity,
                "external_forces": element.external_force,
                "external_torques": element.external_torque,
            }
            return "bodies", attributes | {"motion": _motion(element)}, (*attributes, "mass", "inertia")
        case Surface():
            has_meshes = len(element.meshes) > 1
            masks = [None if mask.all() else mask for mask in element.active]
            active_status = all(mask is None for mask in masks)
            active = None if active_status else list(element.active) if has_meshes else element.active[0]
            return "surface", {"mesh": element.meshes, "active_faces": active}, ()
        case Points():
            carrier = element.body if element.surface is None else element.surface
            if element.single:
                return "point", {"body": carrier, "position": element.positions[0]}, ()
            return "points", {"body": carrier}, ("positions", "areas", "normals")
        case Contact():
            return "contact", _max_depth(element), ("radius",) if element.radius.ndim else ()
        case ContactCoupling():
            return "contact_coupling", _coupling_arguments(element), ()
        case SpringDamper():
            plain = {
                "stiffness": element.spring.stiffness if element.plain_spring else None,
                "damping": element.damper.damping if element.plain_damper else None,
            }
            formulas = {
                "spring": None if element.plain_spring else element.spring,
                "damper": None if element.plain_damper else element.damper,
            }
            return "spring_damper", plain | formulas, ()
        case Bushing():
            return "bushing", {}, ()
        case Catenary():
            return "catenary", {}, ()
        case Shape():
            form = ShapeParameters(element.kind, element.sizes)
            if element.single:
                overrides = {"position": element.positions[0], "orientation": element.orientations[0]}
                return "shape", overrides | {"form": form}, ()
            overrides = {"position": element.positions, "orientation": element.orientations}
            return "shape", overrides | {"form": form}, ("position", "orientation")
        case ShapeContact():
            return "shape_contact", _max_depth(element), ()
        case ParticleContact():
            # Pairs by index, because a relationship lists each target once.
            pairs = [[element.shapes.index(shape) for shape in pair] for pair in element.excluded]
            excluded = np.array(pairs, dtype=np.int32) if pairs else None
            return "particle_contact", {"exclude": excluded, **_max_depth(element)}, ("exclude",)
        case BodyContact():
            solids = list(dict.fromkeys((*element.first, *element.second)))
            pairs = [[solids.index(one) for one in pair] for pair in element.exclude]
            excluded = np.array(pairs, dtype=np.int32) if pairs else None
            values = {"exclude": excluded, **_max_depth(element), **_table_values(element.table)}
            return "body_contact", values, ("exclude", "pair_materials")
    raise TypeError(f"{element.name!r} is a {type(element).__name__} and cannot be serialized")


def _table_values(table: MaterialTable | None) -> dict[str, Any]:
    """Returns a table of contact materials as arguments.

    ``material`` has its contact materials, ``pair_names`` two names of physics materials for each entry, and
    ``pair_materials`` the index of its contact material; −1: no contact. Empty names stand for the default entry.
    """
    if table is None:
        return {"pair_names": None, "pair_materials": None}
    materials = table.materials
    entries = list(table.entries.items())
    if table.has_default:
        entries.append((("", ""), table.default))
    numbers = {id(material): number for number, material in enumerate(materials)}
    return {
        "material": tuple(materials),
        "pair_names": [name for pair, _ in entries for name in pair],
        "pair_materials": np.array([numbers.get(id(one), -1) for _, one in entries], dtype=np.int32),
    }


def _motion(body: Body) -> Motion | None:
    return None if type(body.motion) is Free else body.motion


def _max_depth(contact: Contact | ShapeContact | ParticleContact | BodyContact) -> dict[str, Any]:
    """Returns the argument ``max_depth``; ``None``: no limit."""
    return {"max_depth": contact.max_depth if np.isfinite(contact.max_depth) else None}


def _coupling_arguments(coupling: ContactCoupling) -> dict[str, Any]:
    first = coupling.contacts[0]
    law: Any = first.material.law
    # Number of points per active face.
    quadrature = first.points.count // int(np.count_nonzero(coupling.surface_a.active_faces))
    return {
        "friction": first.material.friction,
        "quadrature": quadrature,
        "damping_ramp": law.ramp,
        "search": first.search,
        "boundary": first.boundary,
        "enabled": first.enabled,
        "color": first.color,
        "visible": first.visible,
    }
