"""Base of laws, friction models, motions and shapes: named parameters and device functions of scalars.

A model is a class with annotated parameters and device functions, written as ``wp.func``, such as the ``force`` of
a law. Its instances are frozen and hold the values on the host. The device gets one struct of coefficients per
contact or body and environment. By default the coefficients are the parameters. A model with derived coefficients,
such as a damping factor from a restitution, lists them in ``device`` and computes them, vectorized, in
``coefficients``. A model with history declares its variables by ``history`` and advances them in ``advance``; see
``history_variables.py``.
"""

import ast
import dataclasses
import functools
import inspect
import linecache
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, dataclass_transform

import numpy as np
import warp as wp
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.kernels.types import Struct, structs


@explain_keywords
def parameter(
    unit: str,
    meaning: str,
    *,
    default: Any = dataclasses.MISSING,
    above: float = -math.inf,
    at_least: float = -math.inf,
    at_most: float = math.inf,
    shape: tuple[int, ...] = (),
    direction: bool = False,
) -> Any:
    """Declares a parameter of a model.

    Args:
        unit: SI unit, ``"-"`` for a dimensionless number.
        meaning: Short description.
        default: Default value; ``None`` for an optional parameter.
        above: Exclusive lower bound.
        at_least: Lower bound.
        at_most: Upper bound.
        shape: Shape of a value, () for a number and (3,) for a vector. ``ROWS`` stands for any number of rows:
            such a table is the same in all environments.
        direction: Whether it is a vector of which only the direction counts, and which must not be zero.
    """
    limits = {"unit": unit, "meaning": meaning, "above": above, "at_least": at_least, "at_most": at_most}
    metadata = {**limits, "shape": shape, "direction": direction}
    return dataclasses.field(default=default, metadata=metadata)


#: Any number of rows, in the shape of a parameter.
ROWS = -1


@explain_keywords
def table(unit: str, meaning: str, *, at_least: float = -math.inf) -> Any:
    """Declares a table of a spring or damper: values over the distance, piecewise linear, constant outside.

    Instances take pairs (distance [m], value), at least two, with increasing nonnegative distances. The device
    function gets the row for the distance as its last argument, with ``start`` [m], the ``value`` there, ``slope``
    and ``integral``, the integral of the table from its first distance to ``start``. A model has at most one
    table.

    Args:
        unit: SI unit of the values.
        meaning: Short description of the values.
        at_least: Lower bound of the values.
    """
    field = parameter(unit, meaning, shape=(ROWS, 2))
    return dataclasses.field(metadata={**field.metadata, "table": {"unit": unit, "at_least": at_least}})


def check_table(name: str, values: np.ndarray, allowed: Mapping[str, Any]) -> None:
    """Raises ``ValueError`` unless distances of a table (n, 2) increase from 0 or more and values are allowed."""
    if len(values) < 2:
        raise ValueError(f"{name} must have two rows at least, got {len(values)}")
    down = np.flatnonzero(np.diff(values[:, 0]) <= 0.0)
    if len(down):
        before, after = values[down[0] : down[0] + 2, 0]
        raise ValueError(f"{name} must have increasing distances, got {before:g} before {after:g}")
    if values[0, 0] < 0.0:
        raise ValueError(
            f"{name} must have distances of at least 0 m, got {values[0, 0]:g} m; they are those of the points, "
            "not extensions"
        )
    low = np.flatnonzero(values[:, 1] < allowed["at_least"])
    if len(low):
        x, y = values[low[0]]
        unit = f"{allowed['at_least']:g} {allowed['unit']}"
        raise ValueError(f"{name} must have values of at least {unit}, got {y:g} at {x:g} m")


@dataclasses.dataclass(frozen=True)
class Memory:
    """History variable of a model, per contact; zero at the start of a contact."""

    unit: str
    meaning: str
    tangent: bool


@explain_keywords
def history(unit: str, meaning: str, *, tangent: bool = False) -> Any:
    """Declares a history variable, as an attribute of the class of a model.

    Args:
        unit: SI unit, ``"-"`` for a dimensionless number.
        meaning: Short description.
        tangent: Whether it is a tangent vector, which rotates with the surface and is transported with the normal;
            otherwise it is a number.
    """
    return Memory(unit, meaning, tangent)


def as_numbers(value: Any) -> np.ndarray | None:
    """Returns ``value`` as an array of real numbers, or ``None`` if it contains anything else.

    Numbers as text, booleans, objects and rows of different length are not accepted.
    """
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        return None
    return array if array.dtype.kind in "iuf" and not _has_boolean(value) else None


def _has_boolean(value: Any) -> bool:
    """Returns whether a list contains booleans, which NumPy would convert to numbers."""
    if isinstance(value, list | tuple):
        return any(map(_has_boolean, value))
    return isinstance(value, bool | np.bool_) or (isinstance(value, np.ndarray) and value.dtype == bool)


def number(
    name: str,
    value: Any,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    at_most: float = math.inf,
    may_be_infinite: bool = False,
) -> float:
    """Returns ``value`` as a float.

    Raises:
        ValueError: If it is not one number within the limits.
    """
    array = as_numbers(value)
    if array is None or array.shape != ():
        raise ValueError(f"{name} must be a number, got {value!r}")
    limits = {"unit": "-", "above": above, "at_least": at_least, "at_most": at_most}
    check_values(name, array, {**limits, "may_be_infinite": may_be_infinite})
    return float(array)


def check_values(name: str, values: np.ndarray, limits: Mapping[str, Any]) -> None:
    """Raises ``ValueError`` with the first of ``values`` that is not finite or outside ``limits``.

    Args:
        name: Name of the entry in the message.
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


def unit_vectors(name: str, values: np.ndarray) -> np.ndarray:
    """Returns vectors (…, 3) scaled to length 1.

    Raises:
        ValueError: If one of them is zero.
    """
    # Divide by the largest component first, so that squares neither overflow nor vanish.
    largest = np.abs(values).max(axis=-1, keepdims=True)
    invalid = np.argwhere(largest[..., 0] == 0.0)
    if len(invalid):
        where = list(map(int, invalid[0]))
        raise ValueError(f"{name}{where or ''} must be a direction, got {values[tuple(invalid[0])].tolist()}")
    scaled = values / largest
    return scaled / np.linalg.norm(scaled, axis=-1, keepdims=True)


def describe_shape(shape: tuple[int, ...]) -> str:
    """Returns a description of a parameter value of ``shape``."""
    if shape == ():
        return "one number"
    words = f"{shape[-1]} numbers" if shape[-1] != ROWS else "numbers"
    return words if len(shape) == 1 and shape[0] != ROWS else f"a list of {words}{' each' * (len(shape) > 1)}"


def has_shape(values: np.ndarray, shape: tuple[int, ...]) -> bool:
    """Returns whether ``values`` have the ``shape`` of a parameter."""
    return values.ndim == len(shape) and all(
        size == own or (size == ROWS and own > 0) for size, own in zip(shape, values.shape, strict=True)
    )


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(parameter, table))
class Formula:
    """Base of laws, friction models, motions and shapes. Subclasses become frozen dataclasses.

    Parameters are keyword-only unless ``positional`` is true.
    """

    #: Formula as text, in the usual symbols.
    formula: ClassVar[str] = ""
    #: Literature.
    reference: ClassVar[str] = ""
    #: Range of validity.
    validity: ClassVar[str] = ""
    #: "S": read in a public source, "D": derived and confirmed by integration, "R": recalled; "": unspecified.
    provenance: ClassVar[str] = ""
    #: Whether it is for nonsmooth contact, whose solver computes impulses, and has no force function.
    rigid: ClassVar[bool] = False
    #: Group of parameters of which exactly one is given.
    exactly_one_of: ClassVar[tuple[str, ...]] = ()
    #: Names of the device coefficients; the parameters themselves if empty.
    device: ClassVar[tuple[str, ...]] = ()
    #: Element and part of the element in parameter paths. A friction model may be several parts.
    whole: ClassVar[str] = "contact"
    part: ClassVar[str] = "law"
    #: Whether parameters may be given by position.
    positional: ClassVar[bool] = False
    #: Whether it may have a ``table``.
    may_have_table: ClassVar[bool] = False
    #: Whether parameters may be vectors, or tables with ``ROWS``.
    may_have_vectors: ClassVar[bool] = False
    may_have_rows: ClassVar[bool] = False
    #: Allowed shapes of vectors.
    vector_shapes: ClassVar[tuple[tuple[int, ...], ...]] = ((3,),)
    #: Names of the device functions, and a description of what each returns.
    functions: ClassVar[Mapping[str, str]] = {"force": "the force"}
    #: Device function of laws and friction models.
    force: ClassVar[wp.Function]
    #: History variables by name.
    memories: ClassVar[Mapping[str, Memory]] = {}
    #: Device function that advances the history variables to the present instant.
    advance: ClassVar[wp.Function]

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        annotated = {name for kind in cls.__mro__ for name in inspect.get_annotations(kind)}
        # From any base, including mixins, in the order of attribute lookup.
        every = [name for kind in reversed(cls.__mro__) for name, v in vars(kind).items() if isinstance(v, Memory)]
        cls.memories = {name: getattr(cls, name) for name in dict.fromkeys(every)}
        for name in cls.memories:
            if name in annotated:
                raise TypeError(
                    f"{cls.__name__}.{name} must not be a parameter and a history variable: declare it without "
                    f"annotation, {name} = wc.history(unit, meaning)"
                )
            if name == "elapsed":
                raise TypeError(
                    f"{cls.__name__}.elapsed must have another name: it is the time since the last advance"
                )
        # A dataclass without a docstring would get its signature as one.
        dataclasses.dataclass(frozen=True, kw_only=not cls.positional)(cls)
        cls.__init__ = explain_keywords(cls.__init__)  # type: ignore[method-assign]
        for field in dataclasses.fields(cls):
            if "unit" not in field.metadata:
                raise TypeError(
                    f"{cls.__name__}.{field.name} must be declared with wc.parameter: "
                    f"{field.name}: float = wc.parameter(unit, meaning, default=…)"
                )
            cls._check_shape(field.name, field.metadata)
        tables = [field.name for field in dataclasses.fields(cls) if "table" in field.metadata]
        if len(tables) > int(cls.may_have_table):
            most = "one table at most" if cls.may_have_table else "no table"
            raise TypeError(f"{cls.__name__} can have {most}, got {', '.join(tables)}")
        for name in (*cls.functions, "advance"):
            if isinstance(vars(cls).get(name), wp.Function):
                cls._check_function(name)

    @classmethod
    def _check_shape(cls, name: str, metadata: Mapping[str, Any]) -> None:
        """Raises ``TypeError`` if a device function could not be given a parameter of its shape."""
        shape = metadata["shape"]
        has_row = "table" in metadata or cls.may_have_rows
        if shape == () or (shape in cls.vector_shapes and cls.may_have_vectors) or (ROWS in shape and has_row):
            return
        allowed = " or ".join(map(str, ((), *cls.vector_shapes))) if cls.may_have_vectors else "()"
        what = cls.part or cls.whole
        raise TypeError(f"{cls.__name__}.{name}: a parameter of a {what} must have shape {allowed}, got {shape}")

    @classmethod
    def table_field(cls) -> dataclasses.Field | None:
        """Returns the field that is a ``table``, or ``None``."""
        return next((field for field in dataclasses.fields(cls) if "table" in field.metadata), None)

    @classmethod
    def arguments(cls) -> tuple[str, ...]:
        """Returns the names of the arguments of its device functions."""
        more = ["history"] * bool(cls.memories) + ["row"] * (cls.table_field() is not None)
        return ("coefficients", "state", *more)

    @classmethod
    def missing_function(cls) -> str:
        """Returns the name of a missing device function, or an empty string."""
        needed = [*cls.functions, *(["advance"] if cls.memories else [])]
        return next((name for name in needed if not isinstance(getattr(cls, name, None), wp.Function)), "")

    @classmethod
    def _check_function(cls, name: str, wanted: tuple[str, ...] | None = None) -> None:
        """Raises ``TypeError`` for errors in a device function that Warp would report later and less clearly.

        Args:
            name: Name of the device function.
            wanted: Names of its arguments; ``None``: those of ``arguments``.
        """
        function = getattr(cls, name)
        if name == "advance" and not cls.memories:
            raise TypeError(
                f"{cls.__name__}.advance has nothing to advance; declare history variables by wc.history"
            )
        wanted = cls.arguments() if wanted is None else wanted
        if len(inspect.signature(function.func).parameters) != len(wanted):
            raise TypeError(f"{cls.__name__}.{name} must take {len(wanted)} arguments, ({', '.join(wanted)})")
        if not any(isinstance(node, ast.Return) and node.value for node in ast.walk(function.adj.tree)):
            what = (
                "the history variables: end it with return m"
                if name == "advance"
                else cls.functions.get(name, "a number")
            )
            raise TypeError(f"{cls.__name__}.{name} returns nothing; it must return {what}")
        if not _always_returns(function.adj.tree.body[0].body):
            # Otherwise Warp would return zeros there.
            raise TypeError(f"{cls.__name__}.{name} must return on every path; it can end without a return")

    def __post_init__(self) -> None:
        cls = type(self)
        if name := cls.missing_function():
            raise TypeError(f"{cls.__name__}.{name} must be a wp.func of ({', '.join(cls.arguments())})")
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        may_be_none = {field.name for field in dataclasses.fields(self) if field.default is None}
        given = {name: value for name, value in values.items() if value is not None or name not in may_be_none}
        choice = ""
        if self.exactly_one_of:
            chosen = [name for name in self.exactly_one_of if name in given]
            if len(chosen) != 1:
                choice = (
                    f"{type(self).__name__} takes exactly one of {' and '.join(self.exactly_one_of)}, "
                    f"got {' and '.join(chosen) or 'none'}"
                )
        try:
            self._check_values(given)
        except ValueError as error:
            if not choice:
                raise
            raise ValueError(f"{choice}; {error}") from None
        if choice:
            raise ValueError(choice)

    def _check_values(self, given: Mapping[str, Any]) -> None:
        """Raises ``ValueError`` if the value of a parameter is not allowed."""
        cls = type(self)
        for name, value in given.items():
            limits = self.limits(name)
            shape = limits["shape"]
            what = "a number" if shape == () else describe_shape(shape)
            values = as_numbers(value)
            if values is None:
                raise ValueError(f"{cls.__name__}.{name} must be {what}, got {value!r}")
            if not has_shape(values, shape):
                path = ".".join(filter(None, (f"<{self.whole}>", self.part, name)))
                hint = (
                    ""
                    if ROWS in shape
                    else f"; values per environment are set on the model: model['{path}'] = values"
                )
                raise ValueError(
                    f"{cls.__name__}.{name} must be {describe_shape(shape)}, got shape {values.shape}{hint}"
                )
            check_values(f"{cls.__name__}.{name}", values, limits)
            if limits["direction"]:
                unit_vectors(f"{cls.__name__}.{name}", values.astype(np.float64))
            if "table" in limits:
                check_table(f"{cls.__name__}.{name}", values, limits["table"])

    def parameters(self, area: Any = None) -> dict[str, Any]:
        """Returns the parameters that have a value, without tables, which are the same in all environments.

        ``area``: Value of an omitted area, which is given by the points.
        """
        values = {name: getattr(self, name) for name in self.varying()}
        if self.takes_area:
            values["area"] = area
        return {name: value for name, value in values.items() if value is not None}

    @classmethod
    def varying(cls) -> tuple[str, ...]:
        """Returns the names of the parameters that may differ between environments: all but tables."""
        return tuple(field.name for field in dataclasses.fields(cls) if ROWS not in field.metadata["shape"])

    @property
    def takes_area(self) -> bool:
        """Whether the points define ``area``: an optional parameter in m² that was omitted."""
        if self.exactly_one_of and "area" in self.exactly_one_of:
            return False  # the alternative parameter is given
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
        """Returns the names of the device coefficients."""
        return cls.device or cls.varying()

    @classmethod
    def derives(cls) -> bool:
        """Returns whether device coefficients are derived from the parameters."""
        return inspect.getattr_static(cls, "coefficients") is not vars(Formula)["coefficients"]

    @classmethod
    def coefficients(cls, values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Returns the device coefficients computed from the parameters, each of one broadcastable shape."""
        return values


def _always_returns(body: Sequence[ast.stmt]) -> bool:
    """Returns whether a function body returns on every path."""
    last = body[-1]
    if isinstance(last, ast.If):
        return bool(last.orelse) and _always_returns(last.body) and _always_returns(last.orelse)
    return isinstance(last, ast.Return)


def coefficient_struct(formula: type[Formula], real: type) -> Struct:
    """Returns the struct of the device coefficients of ``formula`` in precision ``real``."""
    # Warp has no empty structs.
    names = formula.device_names() or ("unused",)
    shapes = {field.name: field.metadata["shape"] for field in dataclasses.fields(formula)}
    types = {(): real, (2,): wp.types.vector(2, real), (3,): structs(real).vec3}
    fields = tuple((name, types.get(shapes.get(name, ()), real)) for name in names)
    return named_struct(f"{formula.__name__}Coefficients", fields)


@functools.cache
def coefficients_in_precision(formula: type[Formula], real: type, precise: type) -> wp.Function:
    """Returns the device function that converts device coefficients of ``formula`` from one precision to another."""
    Source, Target = coefficient_struct(formula, real), coefficient_struct(formula, precise)
    lines = ["def converted(p: Source):", "    q = Target()"]
    for name, kind in Target.vars.items():
        length = getattr(kind.type, "_shape_", (0,))[0]
        lines += [f"    q.{name}[{i}] = precise(p.{name}[{i}])" for i in range(length)]
        if not length:
            lines.append(f"    q.{name} = precise(p.{name})")
    lines.append("    return q")
    file = f"<coefficients of {Target.key} in {precise.__name__} from {real.__name__}>"
    # Registered with linecache, where inspect, and so Warp, finds the source of code without a file.
    linecache.cache[file] = (0, None, [f"{line}\n" for line in lines], file)
    scope = {"Source": Source, "Target": Target, "precise": precise}
    exec(compile("\n".join(lines), file, "exec"), scope)
    return wp.func(scope["converted"])


@functools.cache
def named_struct(name: str, fields: tuple[tuple[str, Any], ...]) -> Struct:
    """Returns the struct of these fields (name, Warp type), the same object for equal arguments.

    Warp compiles equal code once. Two classes with equal names and code, such as those of a reloaded file, share a
    kernel and therefore must share the types of its arguments.
    """
    return wp.struct(type(name, (), {"__annotations__": dict(fields), "__module__": __name__}))
