"""Findings collected while reading a stage, and validated values of attributes."""

from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.usd.importing.errors import shortened
from warpcontact.usd.importing.schemas import value_of


@dataclass
class Findings:
    """Problems and remarks of a stage, each with the path of its prim.

    Attributes:
        wrong: Invalid values, which prevent the import.
        unsupported: Items without a counterpart.
        remarks: Notes on how other items were read.
    """

    wrong: list[str] = field(default_factory=list)
    unsupported: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def add_invalid(self, prim: Any, reason: object) -> None:
        """Records an invalid prim."""
        self.wrong.append(f"{path_of(prim)}: {reason}")

    def add_unsupported(self, prim: Any, reason: object) -> None:
        """Records a prim without a counterpart."""
        self.unsupported.append(f"{path_of(prim)}: {reason}")

    def remark(self, prim: Any, text: object) -> None:
        """Records a note on how a prim was read."""
        self.remarks.append(f"{path_of(prim)}: {text}")


class InvalidValue(ValueError):
    """Invalid value of a prim; the caller adds the path of the prim."""


class Unsupported(ValueError):
    """Item of a prim without a counterpart; the caller adds the path of the prim."""


def path_of(prim: Any) -> str:
    """Returns the path of a prim, shortened for messages."""
    return shortened(prim.GetPath())


def number(
    attribute: Any,
    time: Any,
    *,
    least: float = -inf,
    above: float = -inf,
    most: float = inf,
    fallback: float = 0.0,
) -> float:
    """Returns the number in an attribute.

    Args:
        attribute: Attribute to read.
        time: Time code.
        least: Smallest allowed value.
        above: Exclusive lower bound.
        most: Largest allowed value.
        fallback: Value if the attribute has none.

    Raises:
        InvalidValue: If the value is not finite or out of range.
    """
    value = float(value_of(attribute, time, fallback))
    if not (-inf < value < inf and least <= value <= most and value > above):
        rules = [
            *([f"greater than {above:g}"] if above > -inf else []),
            *([f"at least {least:g}"] if least > -inf else []),
            *([f"at most {most:g}"] if most < inf else []),
        ]
        raise InvalidValue(f"{attribute.GetName()} must be {' and '.join(rules) or 'finite'}, got {value:g}")
    return value


def vector(attribute: Any, time: Any, size: int = 3) -> npt.NDArray[np.float64]:
    """Returns the vector in an attribute; zeros if it has no value.

    Raises:
        InvalidValue: If the size is wrong or a component is not finite.
    """
    values = np.array(value_of(attribute, time, np.zeros(size)), dtype=np.float64)
    if values.shape != (size,) or not np.isfinite(values).all():
        raise InvalidValue(f"{attribute.GetName()} must be {size} finite numbers, got {values.tolist()}")
    return values
