"""Instances of laws and friction models for comparisons, with values suited to the test, and their labels.

Instances are used unchanged. A class can come with some values, as ``functools.partial``; only the others are chosen.
"""

import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.friction.base import Friction
from warpcontact.kernels.laws.base import Law

# The unit prefix is chosen so that the largest number on an axis exceeds this.
LEAST = 0.5
PREFIXES = {1.0e6: "M", 1.0e3: "k", 1.0: "", 1.0e-3: "m", 1.0e-6: "µ", 1.0e-9: "n"}

# Elastic parameters, to which the elastic force is proportional.
MODULI = ("stiffness", "modulus", "k1")
# Units of damping parameters. With a damping of one ``damping_scale``, built from mass m, speed v and depth δ of the
# impact, damping and elastic force are equal at half depth and half speed. A parameter with such a unit and lower
# limit 0 is the damping.
DAMPING_UNITS = ("N·s/m", "N·s/m³", "s/m", "s")
# A damping ratio is recognized by its name, because it has no unit.
DAMPING_RATIO = "ratio"

# Default coefficients of friction classes [-]. All have the same coefficient in slip along x.
COEFFICIENTS = {"mu": 0.4, "mu_dynamic": 0.4, "mu_1": 0.4, "mu_static": 0.5, "mu_2": 0.2}
# Slip at which the force of a tangential spring equals the load [m].
STRETCH = 1.0e-4
# Slip speed at which a viscous force equals the load, and default of speed parameters [m/s].
DRAG_SPEED, SPEED = 0.2, 1.0e-2
# Area of the contact for laws per area [m²].
AREA = 1.0e-4


def notes(unit: str, meaning: str) -> dict[str, str]:
    """Returns the attributes of a variable."""
    return {"units": unit, "long_name": meaning}


def number(value: float, unit: str) -> str:
    """Returns a value with its unit as text."""
    return f"{value:.4g}" if unit in ("", "-") else f"{value:.4g} {unit}"


def settings(formula: Formula, without: str | None = None) -> str:
    """Returns the parameters of a law or friction model as text, except ``without``."""
    return ", ".join(
        f"{name} {number(value, formula.limits(name)['unit'])}"
        for name, value in formula.parameters().items()
        if name != without
    )


def titled(label: str, kind: str) -> str:
    """Returns a label, followed by the name of the class if it differs."""
    return label if label == kind else f"{label} ({kind})"


def prefixed(largest: float, unit: str) -> tuple[float, str]:
    """Returns a factor and a prefixed unit, in which ``largest`` is at least ``LEAST`` if possible."""
    factor = next((factor for factor in PREFIXES if largest >= LEAST * factor), 1.0)
    return 1.0 / factor, PREFIXES[factor] + unit


class MissingValues(ValueError):
    """Class with parameters for which no value can be chosen.

    Attributes:
        kind: Name of the class.
        parameters: Names of the parameters.
    """

    def __init__(self, kind: str, parameters: Sequence[str]) -> None:
        self.kind, self.parameters = kind, parameters
        needed = " and ".join(parameters)
        super().__init__(f"{kind} needs {needed}: pass an instance with its values instead of the class")


def named(kind: type[Formula], given: Any) -> dict[str, Any]:
    """Returns the entries to compare, by label.

    Args:
        kind: ``Law`` or ``Friction``.
        given: One instance, class or ``functools.partial`` of a class, several, or a mapping from labels to them.

    Raises:
        TypeError: If an entry is something else.
        ValueError: If there are no entries, one is for nonsmooth contact, or two have the same label.
    """
    word = kind.__name__.lower()
    if isinstance(given, Mapping):
        entries: Iterable[tuple[Any, Any]] = given.items()
    else:
        several = given if isinstance(given, Iterable) and not isinstance(given, str) else [given]
        entries = ((class_of(entry).__name__, entry) for entry in several)
    result: dict[str, Any] = {}
    for label, entry in entries:
        if not issubclass(class_of(entry), kind) or class_of(entry) is kind:
            raise TypeError(f"a {word} must be a class or an instance of wc.{kind.__name__}, got {entry!r}")
        if class_of(entry).rigid:
            raise ValueError(f"{class_of(entry).__name__} is for nonsmooth contact and has no force to compare")
        if label in result:
            raise ValueError(
                f"labels must be distinct, got two {word}s {label!r}: pass a dict, {{'first': …, 'second': …}}"
            )
        result[label] = entry
    if not result:
        raise ValueError(f"got no {word} to compare")
    return result


def class_of(entry: Any) -> Any:
    """Returns a class itself, or the class of an instance or of a ``functools.partial``."""
    if isinstance(entry, functools.partial):
        return entry.func if isinstance(entry.func, type) else type(entry)
    return entry if isinstance(entry, type) else type(entry)


def values_of(entry: Any) -> dict[str, Any] | None:
    """Returns the values given with a class, empty if there are none; ``None`` for an instance."""
    if isinstance(entry, functools.partial):
        return {name: value for name, value in entry.keywords.items() if value is not None}
    return {} if isinstance(entry, type) else None


def is_modulus_given(entry: Any) -> bool:
    """Returns whether the elastic parameter of a law is given instead of to be chosen."""
    given = values_of(entry)
    return given is None or not any(name in MODULI for name in _default_parameters(class_of(entry), given))


def law(entry: Any, modulus: float, depth: float) -> Law:
    """Returns an instance of a law for impacts of ``depth`` [m]; an instance is returned unchanged.

    Args:
        entry: Instance, class, or ``functools.partial`` of a class.
        modulus: Elastic parameter, unless it is given.
        depth: Penetration to which length parameters are adapted [m].

    Raises:
        ValueError: If a parameter has no default and no value can be chosen.
    """
    given = values_of(entry)
    if given is None:
        return _with_area(entry)
    kind = class_of(entry)
    sizes = {
        # Area of the end of a pin. The range of validity requires depth ≪ clearance.
        "area": AREA,
        "length": 0.05,
        "clearance": min(10.0 * depth, 1.0e-2),
        "depth": 0.1 * depth,
        "restitution": 0.5,
        **dict.fromkeys(MODULI, modulus),
    }
    values = {
        name: 0.0 if is_damping(kind, name) else sizes.get(name) for name in _default_parameters(kind, given)
    }
    return _with_area(_instantiate(kind, values | given))


def friction(entry: Any, load: float, patch_radius: float) -> Friction:
    """Returns an instance of a friction model; an instance is returned unchanged.

    Args:
        entry: Instance, class, or ``functools.partial`` of a class.
        load: Normal force [N].
        patch_radius: Radius of the contact patch [m].

    Raises:
        ValueError: If a parameter has no default and no value can be chosen.
    """
    given = values_of(entry)
    if given is None:
        return _with_area(entry)
    kind = class_of(entry)
    by_unit = {
        "N/m": load / STRETCH,
        "1/m": 1.0 / STRETCH,
        "Pa": load / STRETCH / (8.0 * patch_radius),  # circular patch: k = 8 G* a
        "s/m": 1.0 / DRAG_SPEED,
        "N·s/m": load / DRAG_SPEED,
        "m/s": SPEED,
    }
    chosen = _default_parameters(kind, given)
    values = {name: COEFFICIENTS.get(name, by_unit.get(kind.limits(name)["unit"])) for name in chosen}
    return _with_area(_instantiate(kind, values | given))


def coefficients_chosen(entries: Iterable[Any]) -> str:
    """Returns the default coefficients that were used for classes, as text."""
    chosen = {
        name
        for entry in entries
        if (given := values_of(entry)) is not None
        for name in _default_parameters(class_of(entry), given)
    }
    by_value: dict[float, list[str]] = {}
    for name, value in COEFFICIENTS.items():
        if name in chosen:
            by_value.setdefault(value, []).append(name)
    return ", ".join(f"{' = '.join(names)} = {value:g}" for value, names in by_value.items())


def _default_parameters(kind: type[Formula], given: Mapping[str, Any]) -> list[str]:
    """Returns the parameters that need a value, including one of each group of which exactly one is required."""
    names = [field.name for field in dataclasses.fields(kind) if field.default is dataclasses.MISSING]
    group = kind.exactly_one_of
    if group and not any(name in given for name in group):
        names.append(next((name for name in group if name in ("restitution", *MODULI)), group[-1]))
    return [name for name in names if name not in given]


def _instantiate(kind: Any, values: Mapping[str, float | None]) -> Any:
    unknown = [name for name, value in values.items() if value is None]
    if unknown:
        raise MissingValues(kind.__name__, unknown)
    return kind(**values)


def _with_area(made: Any) -> Any:
    """Returns ``made`` with area ``AREA`` if its area would be taken from the points."""
    return dataclasses.replace(made, area=AREA) if made.takes_area else made


def is_damping(kind: type[Formula], name: str) -> bool:
    """Returns whether parameter ``name`` is a damping: its unit is one of damping, and zero is allowed."""
    limits = kind.limits(name)
    return limits["at_least"] == 0.0 and (limits["unit"] in DAMPING_UNITS or name == DAMPING_RATIO)


def dissipation_parameter(made: Law) -> str | None:
    """Returns the parameter that sets the energy loss of an impact: the restitution, else a damping, if any."""
    given = made.parameters()
    if "restitution" in given:
        return "restitution"
    return next((name for name in given if is_damping(type(made), name)), None)


def damping_scale(made: Law, name: str, mass: float, speed: float, depth: float) -> float:
    """Returns the damping ``name`` at which damping and elastic force are of equal size, in its own unit."""
    dashpot = mass * speed / depth
    per_unit = {
        "N·s/m": dashpot,
        "N·s/m³": dashpot / made.parameters().get("area", 1.0),
        "s/m": 1.0 / speed,
        "s": depth / speed,
    }
    return per_unit.get(made.limits(name)["unit"], 1.0)
