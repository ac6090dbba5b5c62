"""Elements of registered families of force elements, and the method of ``Scene`` that adds them.

A family that has no method of ``Scene`` of its own derives its elements from ``SceneElement``; the fields of the class
declare their arguments. ``Scene.add_force_element``, experiment files and USD descriptions read the fields, so that
they need no code for the family.
"""

import dataclasses
import re
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, dataclass_transform

from warpcontact.kernels.catalogue.device_model import parameter
from warpcontact.kernels.catalogue.keywords import refuse_unknown
from warpcontact.scene.element_declaration import REFERENCES, Argument, check_number, declare_arguments
from warpcontact.scene.elements import Body, Points
from warpcontact.validation import checks


def is_base(kind: type) -> bool:
    """Returns whether a class is a base of elements, of which there are no instances."""
    return kind.__module__ == __name__ and issubclass(kind, SceneElement)


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(parameter,))
@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class SceneElement:
    """Base of the elements of a registered family. Subclasses become frozen dataclasses with keyword arguments.

    Fields are of three kinds: a number (``float``) or vector (``tuple[float, ...]`` of shape (3,) or (4,)), declared
    by ``wc.parameter`` with unit, meaning and range; a ``bool``; or another element, annotated by its class:
    ``Points``, ``Body``, ``Surface`` or ``Shape``, with ``| None`` if it may be omitted, for the world. A class with
    other fields, or with fields named like a method, is refused with a ``TypeError``.
    """

    #: Sensors that an experiment records by default.
    recorded: ClassVar[tuple[str, ...]] = ()

    # Types of the arguments by name.
    _types: ClassVar[Mapping[str, Argument]] = {}

    name: str

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        cls._types = declare_arguments(cls, [base for base in cls.__mro__[1:] if is_base(base)])

    @classmethod
    def prefix(cls) -> str:
        """Returns the prefix of generated names: the name of the class in lower case, ``point_magnet``."""
        return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", cls.__name__).lower()

    @classmethod
    def arguments(cls) -> Iterator["dataclasses.Field[Any]"]:
        """Yields the fields without the name."""
        return (field for field in dataclasses.fields(cls) if field.name != "name")

    @classmethod
    def kind_of(cls, field: "dataclasses.Field[Any]") -> Any:
        """Returns the type of an argument, without ``None``."""
        return cls._types[field.name].kind

    @classmethod
    def references(cls) -> dict[str, Any]:
        """Returns the fields that refer to other elements, with the class of the element."""
        return {field.name: kind for field in cls.arguments() if (kind := cls.kind_of(field)) in REFERENCES}

    @classmethod
    def parameters(cls) -> dict[str, Mapping[str, Any]]:
        """Returns unit, meaning and allowed range of the numbers, by name."""
        return {field.name: field.metadata for field in cls.arguments() if "unit" in field.metadata}

    @classmethod
    def is_optional(cls, name: str) -> bool:
        """Returns whether an element may be omitted, which stands for the world."""
        return cls._types[name].optional

    @classmethod
    def checked(cls, name: str, values: Mapping[str, Any]) -> dict[str, Any]:
        """Returns numbers and booleans of an element, checked; other values are unchanged.

        Args:
            name: Name of the element, for messages.
            values: Arguments by name.

        Raises:
            TypeError: If an argument does not exist, or is missing.
            ValueError: If a number is out of range; the message names it.
        """
        fields = {field.name: field for field in cls.arguments()}
        refuse_unknown(cls.__name__, values, fields)
        found: dict[str, Any] = {}
        for key, field in fields.items():
            omitted = None if cls.is_optional(key) else field.default
            value = values.get(key, omitted)
            if value is dataclasses.MISSING:
                raise TypeError(f"{name}.{key} is missing")
            if "unit" in field.metadata:
                value = check_number(f"{name}.{key}", value, field)
            elif cls.kind_of(field) is bool:
                value = checks.switch(f"{name}.{key}", value)
            found[key] = value
        return found

    def check(self) -> None:
        """Checks combinations of arguments.

        Raises:
            ValueError: If they are not allowed; the message begins with the name of the element.
        """


class PointPair(SceneElement):
    """Base of elements between two points, ``point_a`` and ``point_b``, on different bodies or on one and the world."""

    point_a: Points
    point_b: Points

    @property
    def bodies(self) -> tuple[Body | None, Body | None]:
        """Bodies of the points; ``None``: the world."""
        return self.point_a.body, self.point_b.body

    def check(self) -> None:
        """Checks that both are single points, on different bodies.

        Raises:
            ValueError: If not.
        """
        check_ends(self.name, self.point_a, self.point_b)


def check_class(what: str, kind: Any) -> None:
    """Checks that a class is one of elements.

    Args:
        what: Name of the class in the message.
        kind: The class.

    Raises:
        TypeError: If it is not.
    """
    if not (isinstance(kind, type) and issubclass(kind, SceneElement)) or is_base(kind):
        raise TypeError(f"{what} must be a class derived from SceneElement or PointPair, got {kind!r}")


def check_ends(name: str, point_a: Points, point_b: Points) -> None:
    """Checks that both ends of an element are single points, on different bodies.

    Raises:
        ValueError: If not; the message begins with ``name``, the name of the element.
    """
    for key, point in (("point_a", point_a), ("point_b", point_b)):
        if not point.single:
            raise ValueError(
                f"{name}.{key} must be one point, from add_point, got the {len(point.positions)} points of "
                f"{point.name!r}"
            )
    if point_a.body is point_b.body:
        where = f"body {point_a.body.name!r}" if point_a.body else "the world"
        raise ValueError(
            f"{name}: point_a and point_b are both fixed to {where}; they must be on two bodies, or on one and the "
            "world"
        )


class ForceElements:
    """The elements of registered families of a ``Scene``."""

    force_elements: list[SceneElement]
    _elements: dict[str, Any]

    def add_force_element(self, kind: type[SceneElement], *, name: str | None = None, **arguments: Any) -> Any:
        """Adds an element of a registered family of force elements.

        Args:
            kind: Class of the element, see "Adding a force element" in ``docs/architecture.md``.
            name: Name in parameters and sensors. Default: generated.
            **arguments: The arguments that the class declares.

        Returns:
            The element, an instance of ``kind``.

        Raises:
            TypeError: If an argument does not exist, or is missing.
            ValueError: If a value is out of range; the message names it.
        """
        check_class("kind", kind)
        name = checks.new_name(kind.prefix(), name, self._elements)
        values = kind.checked(name, arguments)
        for key, of in kind.references().items():
            target = values[key]
            if target is None and kind.is_optional(key):
                continue
            if not isinstance(target, of) or self._elements.get(target.name) is not target:
                raise ValueError(f"{name}.{key} must be {of.__name__} of this scene, got {checks.element(target)}")
        element = kind(name=name, **values)
        element.check()
        self.force_elements.append(element)
        self._elements[name] = element
        return element
