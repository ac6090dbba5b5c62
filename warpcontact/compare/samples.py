"""Laws and frictions to look at: instances are taken as they are, classes get values that suit the experiment."""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from warpcontact.kernels.formula import Formula
from warpcontact.kernels.frictions.base import Friction
from warpcontact.kernels.laws.base import Law

FormulaType = TypeVar("FormulaType", bound=Formula)

# Parameters in proportion to which the elastic force grows.
MODULI = ("stiffness", "modulus", "k1")
# Damping of unit size makes damping and elastic force alike at half depth and half speed: it is this, in terms
# of mass m, speed v and depth δ of the impact. A parameter with such a unit that may be zero is the damping.
DAMPING_UNITS = ("N·s/m", "N·s/m³", "s/m", "s")
# A ratio has no unit to be known by.
DAMPING_RATIO = "ratio"

# What classes of friction are shown with [-].
COEFFICIENTS = {"mu": 0.4, "mu_static": 0.5, "mu_dynamic": 0.3, "mu_1": 0.5, "mu_2": 0.25}
# Slip after which a tangential spring, of whatever unit, would pull as much as the load [m].
STRETCH = 1.0e-4
# Slip speed at which a drag would be as large as the load, and speed of a parameter without a default [m/s].
DRAG_SPEED, SPEED = 0.2, 1.0e-2


def named(kind: type[FormulaType], given: Any) -> dict[str, FormulaType | type[FormulaType]]:
    """Returns what is to be compared by its label.

    Args:
        kind: ``Law`` or ``Friction``.
        given: One instance or class, several, or a mapping from labels to them.

    Raises:
        TypeError: If one is something else.
        ValueError: If there is none, or two have one label.
    """
    word = kind.__name__.lower()
    if isinstance(given, Mapping):
        entries: Iterable[tuple[Any, Any]] = given.items()
    else:
        several = given if isinstance(given, Iterable) and not isinstance(given, str) else [given]
        entries = ((_class_of(entry).__name__, entry) for entry in several)
    result: dict[str, Any] = {}
    for label, entry in entries:
        if not issubclass(_class_of(entry), kind) or _class_of(entry) is kind:
            raise TypeError(f"a {word} must be a class or an instance of wc.{kind.__name__}, got {entry!r}")
        if label in result:
            raise ValueError(f"two {word}s are called {label!r}: give them as a dict, {{'first': …, 'second': …}}")
        result[label] = entry
    if not result:
        raise ValueError(f"there is no {word} to compare")
    return result


def _class_of(entry: Any) -> type:
    return entry if isinstance(entry, type) else type(entry)


def law(kind: type[Law], modulus: float, depth: float) -> Law:
    """Returns an instance of ``kind`` with elastic parameter ``modulus``, for impacts of ``depth`` [m].

    Raises:
        ValueError: If it has parameters without a default whose meaning cannot be guessed.
    """
    sizes = {
        # A sphere may stand for a piece of a pad or for the end of a pin; validity asks for depth ≪ clearance.
        "area": 1.0e-4,
        "length": 0.05,
        "clearance": min(10.0 * depth, 1.0e-2),
        "depth": 0.1 * depth,
        "restitution": 0.5,
        **dict.fromkeys(MODULI, modulus),
    }
    chosen = _required(kind)
    for name in kind.exactly_one_of:
        if name == "restitution" or (name == kind.exactly_one_of[-1] and "restitution" not in kind.exactly_one_of):
            chosen.append(name)
    values = {name: 0.0 if is_damping(kind, name) else sizes.get(name) for name in chosen}
    return _made(kind, values)


def friction(kind: type[Friction], load: float, patch_radius: float) -> Friction:
    """Returns an instance of ``kind`` for a normal force ``load`` [N] on a patch of ``patch_radius`` [m].

    Raises:
        ValueError: If it has parameters without a default whose meaning cannot be guessed.
    """
    by_unit = {
        "N/m": load / STRETCH,
        "1/m": 1.0 / STRETCH,
        "Pa": load / STRETCH / (8.0 * patch_radius),  # of a round patch, k = 8 G* a
        "s/m": 1.0 / DRAG_SPEED,
        "N·s/m": load / DRAG_SPEED,
        "m/s": SPEED,
    }
    values = {name: COEFFICIENTS.get(name, by_unit.get(kind.limits(name)["unit"])) for name in _required(kind)}
    return _made(kind, values)


def _required(kind: type[Formula]) -> list[str]:
    return [field.name for field in dataclasses.fields(kind) if field.default is dataclasses.MISSING]


def _made(kind: type[FormulaType], values: Mapping[str, float | None]) -> FormulaType:
    unknown = [name for name, value in values.items() if value is None]
    if unknown:
        raise ValueError(
            f"{kind.__name__} needs {' and '.join(unknown)}: give an instance with its values, not the class"
        )
    return kind(**values)


def is_damping(kind: type[Formula], name: str) -> bool:
    """Returns whether parameter ``name`` is a damping: by its unit, and zero is allowed."""
    limits = kind.limits(name)
    return limits["at_least"] == 0.0 and (limits["unit"] in DAMPING_UNITS or name == DAMPING_RATIO)


def loss_parameter(made: Law) -> str | None:
    """Returns the parameter that decides how much an impact loses: the restitution, else a damping, if any."""
    given = made.parameters()
    if "restitution" in given:
        return "restitution"
    return next((name for name in given if is_damping(type(made), name)), None)


def damping_scale(made: Law, name: str, mass: float, speed: float, depth: float) -> float:
    """Returns the damping ``name`` that makes damping and elastic force alike, in its own unit."""
    dashpot = mass * speed / depth
    per_unit = {
        "N·s/m": dashpot,
        "N·s/m³": dashpot / made.parameters().get("area", 1.0),
        "s/m": 1.0 / speed,
        "s": depth / speed,
    }
    return per_unit.get(made.limits(name)["unit"], 1.0)
