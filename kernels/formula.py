"""What laws and frictions have in common: named parameters, and a device function of a few scalars.

A formula is a class with annotated parameters and a ``force`` written as a ``wp.func``. Its instances are frozen
and hold values for the host; the device sees one struct of coefficients per contact and environment. Most
formulas use their parameters as they are; one that needs something derived from them (a damping factor from a
restitution) names its ``device`` coefficients and computes them, vectorised, in ``coefficients``. One that
remembers declares its ``memory`` and how it advances; ``memory.py`` keeps it.
"""

import ast
import dataclasses
import functools
import inspect
import math
from collections.abc import Mapping
from typing import Any, ClassVar, dataclass_transform

import numpy as np
import warp as wp


def parameter(
    unit: str,
    meaning: str,
    *,
    default: Any = dataclasses.MISSING,
    above: float = -math.inf,
    at_least: float = -math.inf,
    at_most: float = math.inf,
) -> Any:
    """Declares a parameter of a formula.

    Args:
        unit: SI unit, ``"-"`` for a pure number.
        meaning: What it is, in a few words.
        default: Value if none is given; ``None`` for one that may be left out.
        above: Every value must be greater than this.
        at_least: Every value must be at least this.
        at_most: Every value must be at most this.
    """
    limits = {"unit": unit, "meaning": meaning, "above": above, "at_least": at_least, "at_most": at_most}
    return dataclasses.field(default=default, metadata=limits)


def table(unit: str, meaning: str) -> Any:
    """Declares a table of a formula: values over the distance, linear in between and held outside.

    Instances take it as pairs (distance [m], value), at least two, with increasing distances. The device function
    gets the row that the distance is in as its last argument, with ``start`` [m], ``value`` there, ``slope`` and
    ``integral``, the area below the table from its first distance to ``start``. A formula has one at most.

    Args:
        unit: SI unit of the values.
        meaning: What they are, in a few words.
    """
    limits = {"unit": unit, "meaning": meaning, "table": True}
    return dataclasses.field(metadata=limits)


def table_values(name: str, value: Any, unit: str) -> tuple[tuple[float, float], ...]:
    """Returns ``value`` as pairs of numbers, or raises ``ValueError``."""
    wanted = f"{name} must be pairs (distance [m], value [{unit}]), at least two, with increasing distances"
    try:
        pairs = np.asarray(value)
    except ValueError:  # rows of different length
        pairs = np.empty(0, object)
    if pairs.dtype.kind not in "iuf" or pairs.ndim != 2 or pairs.shape[1] != 2 or len(pairs) < 2:
        raise ValueError(f"{wanted}, got {value!r}")
    pairs = pairs.astype(np.float64)
    if not np.isfinite(pairs).all():
        raise ValueError(f"{wanted}, got {pairs[~np.isfinite(pairs).all(axis=1)][0].tolist()}")
    down = np.flatnonzero(np.diff(pairs[:, 0]) <= 0.0)
    if len(down):
        raise ValueError(f"{wanted}, got {pairs[down[0], 0]:g} before {pairs[down[0] + 1, 0]:g}")
    return tuple((float(x), float(y)) for x, y in pairs)


@dataclasses.dataclass(frozen=True)
class Memory:
    """A quantity that a formula remembers for every contact; zero when the contact begins."""

    unit: str
    meaning: str
    tangent: bool


def memory(unit: str, meaning: str, *, tangent: bool = False) -> Any:
    """Declares, as an attribute of a formula's class, something that it remembers.

    Args:
        unit: SI unit, ``"-"`` for a pure number.
        meaning: What it is, in a few words.
        tangent: Whether it is a vector in the tangent plane, which turns with the surface and its normal; if
            not, it is a number.
    """
    return Memory(unit, meaning, tangent)


def check_values(name: str, values: np.ndarray, limits: Mapping[str, Any]) -> None:
    """Raises ``ValueError`` naming the first of ``values`` that is not finite or outside ``limits``.

    Args:
        name: What to call it in the message.
        values: Any shape; the first axis is the environment if there is one.
        limits: ``unit``, ``above``, ``at_least``, ``at_most`` as given to ``parameter``.
    """
    above, at_least, at_most = limits["above"], limits["at_least"], limits["at_most"]
    good = np.isfinite(values) & (values > above) & (values >= at_least) & (values <= at_most)
    if limits.get("may_be_infinite"):
        good |= values == np.inf
    if np.all(good):
        return
    allowed = []
    if above > -math.inf:
        allowed.append(f"greater than {above:g}")
    if at_least > -math.inf:
        allowed.append(f"at least {at_least:g}")
    if at_most < math.inf:
        allowed.append(f"at most {at_most:g}")
    where = np.argwhere(~good)[0]
    entry = f"{name}[{', '.join(str(i) for i in where)}]" if len(where) else name
    unit = "" if limits["unit"] == "-" else f" {limits['unit']}"
    rule = " and ".join(allowed) or "finite"
    raise ValueError(f"{entry} must be {rule}, got {values[tuple(where)]:g}{unit}")


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(parameter, table))
class Formula:
    """Base of laws and frictions. Subclasses become frozen dataclasses with keyword-only parameters."""

    #: The formula as text, with the letters of the field.
    formula: ClassVar[str] = ""
    #: Where it comes from.
    reference: ClassVar[str] = ""
    #: Where it holds.
    validity: ClassVar[str] = ""
    #: "S": read in a public source, "D": derived and confirmed by integration, "R": recalled; "": not said.
    provenance: ClassVar[str] = ""
    #: Groups of parameters of which exactly one is given.
    exactly_one_of: ClassVar[tuple[str, ...]] = ()
    #: Names of the device coefficients; the parameters themselves if empty.
    device: ClassVar[tuple[str, ...]] = ()
    #: What it is part of, and what it is of that, as in the names of its parameters in a model; a friction of a
    #: contact may be others, too.
    element: ClassVar[str] = "contact"
    part: ClassVar[str] = "law"
    #: Whether it may have a table.
    may_have_table: ClassVar[bool] = False
    #: The device function.
    force: ClassVar[wp.Function]
    #: What it remembers, by name.
    memories: ClassVar[Mapping[str, Memory]] = {}
    #: With a memory, the device function that takes it to the present instant.
    advance: ClassVar[wp.Function]

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        annotated = {name for kind in cls.__mro__ for name in inspect.get_annotations(kind)}
        # From any base, a mixin too, as Python finds attributes.
        every = [name for kind in reversed(cls.__mro__) for name, v in vars(kind).items() if isinstance(v, Memory)]
        cls.memories = {name: getattr(cls, name) for name in dict.fromkeys(every)}
        for name in cls.memories:
            if name in annotated:
                raise TypeError(
                    f"{cls.__name__}.{name} is a parameter and a memory: a memory has a name of its own and no "
                    f"annotation, {name} = wc.memory(unit, meaning)"
                )
            if name == "elapsed":
                raise TypeError(
                    f"{cls.__name__}.elapsed: every memory has this already, the time since it advanced"
                )
        # A subclass without a docstring would get the signature for one; keep what the author wrote.
        dataclasses.dataclass(frozen=True, kw_only=True)(cls)
        for field in dataclasses.fields(cls):
            if "unit" not in field.metadata:
                raise TypeError(
                    f"{cls.__name__}.{field.name} must be declared with wc.parameter: "
                    f"{field.name}: float = wc.parameter(unit, meaning, default=…)"
                )
        tables = [field.name for field in dataclasses.fields(cls) if "table" in field.metadata]
        if len(tables) > int(cls.may_have_table):
            most = "one table at most" if cls.may_have_table else "no table"
            raise TypeError(f"{cls.__name__} can have {most}, got {', '.join(tables)}")
        for name in ("force", "advance"):
            if isinstance(vars(cls).get(name), wp.Function):
                cls._check_function(name)

    @classmethod
    def number_fields(cls) -> list[dataclasses.Field]:
        """Returns the fields that are numbers, each a parameter of a model."""
        return [field for field in dataclasses.fields(cls) if "table" not in field.metadata]

    @classmethod
    def table_field(cls) -> dataclasses.Field | None:
        """Returns the field that is a table, if there is one."""
        return next((field for field in dataclasses.fields(cls) if "table" in field.metadata), None)

    @classmethod
    def arguments(cls) -> str:
        """Returns what ``force`` takes, in words."""
        more = [", memory"] * bool(cls.memories) + [", row"] * (cls.table_field() is not None)
        return f"(coefficients, state{''.join(more)})"

    @classmethod
    def _check_function(cls, name: str) -> None:
        """Raises ``TypeError`` for what Warp would only say in its own words, much later."""
        function = getattr(cls, name)
        if name == "advance" and not cls.memories:
            raise TypeError(f"{cls.__name__}.advance has nothing to advance; declare what it remembers: wc.memory")
        wanted = cls.arguments().count(",") + 1
        if len(inspect.signature(function.func).parameters) != wanted:
            raise TypeError(f"{cls.__name__}.{name} must take {wanted} arguments, {cls.arguments()}")
        if not any(isinstance(node, ast.Return) and node.value for node in ast.walk(function.adj.tree)):
            what = "the memory: end it with return m" if name == "advance" else "the force"
            raise TypeError(f"{cls.__name__}.{name} returns nothing; it must return {what}")

    def __post_init__(self) -> None:
        cls = type(self)
        for name in ("force", "advance") if cls.memories else ("force",):
            if not isinstance(getattr(cls, name, None), wp.Function):
                raise TypeError(f"{cls.__name__}.{name} must be a wp.func of {cls.arguments()}")
        if (field := cls.table_field()) is not None:
            unit = field.metadata["unit"]
            values = table_values(f"{cls.__name__}.{field.name}", getattr(self, field.name), unit)
            object.__setattr__(self, field.name, values)
        given = self.parameters()
        if self.exactly_one_of:
            chosen = [name for name in self.exactly_one_of if name in given]
            if len(chosen) != 1:
                raise ValueError(
                    f"{type(self).__name__} takes exactly one of {' and '.join(self.exactly_one_of)}, "
                    f"got {' and '.join(chosen) or 'none'}"
                )
        for name, value in given.items():
            limits = self.limits(name)
            try:
                values = np.asarray(value)
            except ValueError:  # rows of different length
                values = np.empty(0, object)
            if values.dtype.kind not in "iuf":  # not text that reads like a number, nor True for 1
                raise ValueError(f"{type(self).__name__}.{name} must be a number, got {value!r}")
            if values.ndim != 0:
                raise ValueError(
                    f"{type(self).__name__}.{name} must be one number, got shape {values.shape}; values per "
                    f"environment are set on the model: model['<{self.element}>.{self.part}.{name}'] = values"
                )
            check_values(f"{type(self).__name__}.{name}", values, limits)

    def parameters(self, area: Any = None) -> dict[str, Any]:
        """Returns the parameters that have a value; an area that was left to the points is ``area``."""
        values = {field.name: getattr(self, field.name) for field in self.number_fields()}
        if self.takes_area:
            values["area"] = area
        return {name: value for name, value in values.items() if value is not None}

    @property
    def takes_area(self) -> bool:
        """Whether the points say what ``area`` is: a parameter in m² that may be left out, and was."""
        if self.exactly_one_of and "area" in self.exactly_one_of:
            return False  # another parameter stands in its place
        for field in dataclasses.fields(self):
            if field.name == "area" and field.metadata["unit"] == "m²" and field.default is None:
                return self.area is None
        return False

    @classmethod
    def limits(cls, name: str) -> Mapping[str, Any]:
        """Returns unit, meaning and allowed range of parameter ``name``."""
        return {field.name: field.metadata for field in dataclasses.fields(cls)}[name]

    @classmethod
    def device_names(cls) -> tuple[str, ...]:
        """Returns the names of the coefficients that ``force`` sees."""
        return cls.device or tuple(field.name for field in cls.number_fields())

    @classmethod
    def coefficients(cls, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Computes the device coefficients from the parameters, each of one broadcastable shape."""
        return values


def coefficient_struct(formula: type[Formula], real: type) -> Any:
    """Returns the struct of ``formula``'s device coefficients in precision ``real``."""
    # Warp has no empty structs.
    names = formula.device_names() or ("unused",)
    return named_struct(f"{formula.__name__}Coefficients", tuple((name, real) for name in names))


@functools.cache
def named_struct(name: str, fields: tuple[tuple[str, Any], ...]) -> Any:
    """Returns the struct of these fields (name, Warp type): one, whichever class asks for it.

    Warp compiles equal code once. Two classes of one name and equal code, the old and the new one of a file that
    was loaded again, then share a kernel, and must share the types of its arguments.
    """
    return wp.struct(type(name, (), {"__annotations__": dict(fields), "__module__": __name__}))
