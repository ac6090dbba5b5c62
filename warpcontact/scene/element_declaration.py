"""Checks of the classes from which ``Scene.add_force_element`` makes elements, see ``scene_element.py``.

The fields of a class are read by the scene, parameters, experiment files, USD descriptions and kernels. Therefore a
class whose fields one of them could not read is refused when it is created, with an error that names the field.
"""

import dataclasses
import inspect
import re
import sys
from collections.abc import Collection, Hashable, Sequence
from types import NoneType, UnionType
from typing import Any, NamedTuple, Union, get_args, get_origin, get_type_hints

from warpcontact.kernels.catalogue.device_model import unit_vectors
from warpcontact.scene.elements import Body, Points, Surface
from warpcontact.scene.shapes import Shape
from warpcontact.validation import checks

#: Elements to which a field can refer.
REFERENCES: tuple[type, ...] = (Body, Surface, Points, Shape)
#: Allowed shapes of numbers and vectors.
SHAPES: tuple[tuple[int, ...], ...] = ((), (3,), (4,))

_NAMES = ", ".join(kind.__name__ for kind in REFERENCES)
_ALLOWED = (
    f"allowed are float with wc.parameter(unit, meaning), bool, {_NAMES}, and one of these elements with | None"
)
# Keys of files and of USD descriptions.
_RESERVED = ("type", "kind")
# Parameters become members of a struct in generated C++ code.
_KEYWORDS = """
    alignas alignof and_eq asm auto bitand bitor bool case catch char compl const const_cast constexpr decltype
    default delete do double dynamic_cast enum explicit export extern false float friend goto inline int long
    mutable namespace new noexcept not_eq nullptr operator or_eq private protected public register reinterpret_cast
    short signed sizeof static static_assert static_cast struct switch template this thread_local throw true typedef
    typeid typename union unsigned using virtual void volatile wchar_t xor xor_eq
"""


class Argument(NamedTuple):
    """Type of an argument of an element.

    Attributes:
        kind: One of ``REFERENCES``, ``bool``, ``float``, or the tuple of a vector.
        optional: Whether it may be ``None``.
    """

    kind: Any
    optional: bool


def declare_arguments(cls: type, bases: Sequence[type]) -> dict[str, Argument]:
    """Makes a class a frozen dataclass, whose fields are the arguments of its elements.

    Args:
        cls: The class.
        bases: The base classes of the library from which it is derived.

    Returns:
        The types of the arguments by name, in order of declaration.

    Raises:
        TypeError: If a field or attribute is not allowed; the message names it and the allowed ones.
        ValueError: If a default is out of range.
    """
    _check_attributes(cls)
    try:
        dataclasses.dataclass(frozen=True, eq=False, kw_only=True)(cls)
    except ValueError as error:
        # A mutable default. Others have been refused before.
        raise TypeError(f"{cls.__name__}: {str(error).partition(':')[0]}; {_ALLOWED}") from None
    fields = {field.name: field for field in dataclasses.fields(cls)}
    _check_overrides(cls, bases, fields)
    _check_constructor(cls, fields)
    found = {}
    for name, field in fields.items():
        _check_name(cls, name, bases)
        if name in inspect.get_annotations(cls):
            _check_redeclared(cls, field, bases)
        if name != "name":
            found[name] = _argument(cls, field)
            _check_default(cls, field, found[name])
    return found


def check_number(name: str, value: Any, field: "dataclasses.Field[Any]") -> Any:
    """Returns the value of a number or vector as an array of its shape.

    Raises:
        ValueError: If it is not allowed; the message begins with ``name``.
    """
    values = checks.numbers(name, value, field.metadata["shape"], field.metadata)
    if field.metadata["direction"]:
        unit_vectors(name, values)
    return values


def _check_attributes(cls: type) -> None:
    """Checks the attributes of a class that is not yet a dataclass."""
    if not cls.__name__.isascii():
        raise TypeError(
            f"the name of class {cls.__name__} must have ASCII letters only: elements are named after it"
        )
    if "__init__" in vars(cls):
        raise TypeError(
            f"{cls.__name__} must not define __init__: it is a dataclass, whose constructor takes the fields. Arguments "
            "are checked in the method check"
        )
    annotated = inspect.get_annotations(cls)
    for name, value in vars(cls).items():
        if not isinstance(value, dataclasses.Field):
            continue
        if name not in annotated:
            raise TypeError(f"{cls.__name__}.{name} must have an annotation: {name}: float = wc.parameter(…)")
        if not isinstance(value.default, Hashable):
            raise TypeError(
                f"default of {cls.__name__}.{name} must be immutable, a number or a tuple of numbers, got "
                f"{value.default!r}"
            )


def _check_overrides(cls: type, bases: Sequence[type], fields: Collection[str]) -> None:
    """Checks that attributes of the base classes are overridden by attributes of the same kind."""
    for base in cls.__mro__[1:]:
        if not hasattr(base, "__dataclass_fields__") and any(
            isinstance(one, dataclasses.Field) for one in vars(base).values()
        ):
            raise TypeError(
                f"{base.__name__}, a base class of {cls.__name__}, must be derived from SceneElement: it has parameters"
            )
        for name in _own_fields(base):
            if name not in fields:
                raise TypeError(
                    f"{cls.__name__}.{name} must not be a ClassVar: it is an argument of {base.__name__}"
                )
    for base in bases:
        for name, original in vars(base).items():
            given = inspect.getattr_static(cls, name)
            if name.startswith("_") or name in fields or type(given) is type(original):
                continue
            names = {"function": "method", "classmethod": "class method"}
            kind = names.get(type(original).__name__, type(original).__name__)
            raise TypeError(
                f"{cls.__name__}.{name} must be a {kind}, as that of {base.__name__}, or have another name, got "
                f"{given!r}"
            )


def _own_fields(base: type) -> set[str]:
    """Returns the fields that a class itself declares."""
    if "__dataclass_fields__" not in vars(base):
        return set()
    return {field.name for field in dataclasses.fields(base)} & inspect.get_annotations(base).keys()


def _check_constructor(cls: type, fields: Collection[str]) -> None:
    """Checks that the arguments of the constructor are the fields."""
    given = list(inspect.signature(cls).parameters)
    for name in given:
        if name not in fields:
            raise TypeError(f"{cls.__name__}.{name} must not be an InitVar; {_ALLOWED}")
    for name in fields:
        if name not in given:
            raise TypeError(f"{cls.__name__}.{name} must not have init=False: fields are arguments of the element")


def _check_name(cls: type, name: str, bases: Sequence[type]) -> None:
    """Checks the name of a field."""
    entry = f"{cls.__name__}.{name}"
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise TypeError(f"{entry} must have another name: ASCII letters, digits and _, starting with a letter")
    if name in _RESERVED:
        raise TypeError(f"{entry} must have another name; reserved in files: {', '.join(_RESERVED)}")
    if name in _KEYWORDS.split():
        raise TypeError(
            f"{entry} must have another name: {name} is a keyword of C++, into which kernels are translated"
        )
    for base in cls.__mro__:
        if name not in vars(base) or name in _own_fields(base):
            continue
        if name in inspect.get_annotations(cls):
            taken = {key for one in bases for key in vars(one).keys() - _own_fields(one) if key[0] != "_"}
            raise TypeError(
                f"{entry} must have another name: {base.__name__} has an attribute or method {name}. Other "
                f"names that fields must not have: {', '.join(sorted(taken - {name}))}"
            )
        raise TypeError(
            f"{base.__name__}.{name} must have another name, or be a field with an annotation: {name} is an argument "
            f"of {cls.__name__}"
        )


def _check_redeclared(cls: type, field: "dataclasses.Field[Any]", bases: Sequence[type]) -> None:
    """Checks that a field of a base class of the library keeps its type."""
    name = field.name
    base = next((base for base in bases if name in _own_fields(base)), None)
    if base is None:
        return
    type_of_base = _hint(base, name)
    if _hint(cls, name) != type_of_base or field.default is not dataclasses.MISSING:
        raise TypeError(
            f"{cls.__name__}.{name} must be declared as in {base.__name__}, {name}: {type_of_base.__name__}, or not "
            "at all"
        )


def _hint(cls: type, name: str) -> Any:
    """Returns the annotation of a field, resolved in the module of the class that declares it."""
    owner = next(base for base in cls.__mro__ if name in _own_fields(base))
    annotation = inspect.get_annotations(owner)[name]
    module = sys.modules.get(owner.__module__)
    holder = type(owner.__name__, (), {"__annotations__": {name: annotation}})
    try:
        return get_type_hints(holder, vars(module) if module else {}, dict(vars(owner)))[name]
    except Exception as error:
        raise TypeError(
            f"{cls.__name__}.{name}: the annotation {annotation!r} cannot be resolved: {error}. Define or import its "
            f"names at the top level of module {owner.__module__}; {_ALLOWED}"
        ) from error


def _argument(cls: type, field: "dataclasses.Field[Any]") -> Argument:
    """Returns the type of a field."""
    entry, hint = f"{cls.__name__}.{field.name}", _hint(cls, field.name)
    if isinstance(hint, dataclasses.Field):
        raise TypeError(f"{entry} must be declared as {field.name}: float = wc.parameter(…)")
    if "unit" in field.metadata:
        shape = field.metadata["shape"]
        if shape not in SHAPES:
            raise TypeError(f"{entry} must have one of the shapes {', '.join(map(str, SHAPES))}, got {shape!r}")
        if field.metadata["direction"] and shape != (3,):
            raise TypeError(f"{entry} must have the shape (3,), as a direction, got {shape}")
        allowed = [tuple[(float,) * shape[0]], tuple[float, ...]] if shape else [float]  # type: ignore[misc]
        if hint not in allowed:
            listed = " or ".join(map(_text, allowed))
            raise TypeError(
                f"{entry} must be annotated with {listed}, as a wc.parameter of shape {shape}, got {_text(hint)}"
            )
        return Argument(hint, False)
    if hint is bool:
        return Argument(bool, False)
    options = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    kinds = [one for one in options if one is not NoneType]
    if len(kinds) == 1 and kinds[0] in REFERENCES:
        return Argument(kinds[0], len(options) > 1)
    if hint in (float, int):
        raise TypeError(
            f"{entry} must be declared with wc.parameter: {field.name}: float = wc.parameter(unit, meaning)"
        )
    raise TypeError(f"{entry} must not have the annotation {_text(hint)}; {_ALLOWED}")


def _text(hint: Any) -> str:
    """Returns an annotation as text."""
    return hint.__name__ if isinstance(hint, type) and not get_args(hint) else str(hint)


def _check_default(cls: type, field: "dataclasses.Field[Any]", argument: Argument) -> None:
    """Checks the default of a field."""
    entry, default = f"{cls.__name__}.{field.name}", field.default
    if field.default_factory is not dataclasses.MISSING:
        raise TypeError(f"{entry} must not have a default_factory; a default is a value")
    if default is dataclasses.MISSING:
        return
    if "unit" in field.metadata:
        if default is None:
            raise TypeError(f"{entry} must have a number as default, or none at all, got default=None")
        check_number(f"default of {entry}", default, field)
    elif argument.kind is bool:
        if not isinstance(default, bool):
            raise TypeError(f"default of {entry} must be True or False, got {default!r}")
    elif default is not None or not argument.optional:
        allowed = "None" if argument.optional else f"omitted, or the annotation {argument.kind.__name__} | None"
        raise TypeError(f"default of {entry} must be {allowed}, got {checks.element(default)}")
