"""What was found while a stage was read, and checked values of its attributes."""

from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.usd.importing.errors import shortened
from warpcontact.usd.importing.schemas import value_of


@dataclass
class Findings:
    """What there is to say of a stage, each with the path of its prim.

    Attributes:
        wrong: What makes no sense: no scene can be made.
        unsupported: What there is no counterpart for.
        remarks: What to know of how the rest was read.
    """

    wrong: list[str] = field(default_factory=list)
    unsupported: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    def add_invalid(self, prim: Any, reason: object) -> None:
        """Notes that a prim makes no sense."""
        self.wrong.append(f"{path_of(prim)}: {reason}")

    def add_unsupported(self, prim: Any, reason: object) -> None:
        """Notes that there is no counterpart for a prim."""
        self.unsupported.append(f"{path_of(prim)}: {reason}")

    def remark(self, prim: Any, text: object) -> None:
        """Notes how a prim was read."""
        self.remarks.append(f"{path_of(prim)}: {text}")


class InvalidValue(ValueError):
    """A value of a prim that makes no sense, in words; the prim is known."""


class Unsupported(ValueError):
    """Something of a prim that there is no counterpart for, in words; the prim is known."""


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
    """Returns the value of an attribute.

    Args:
        attribute: The attribute.
        time: When.
        least: The value must be at least this.
        above: It must be greater than this.
        most: It must be at most this.
        fallback: What a value is that is nowhere given.

    Raises:
        InvalidValue: If it is not finite or out of range.
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
    """Returns the numbers of an attribute, zero if it has no value.

    Raises:
        InvalidValue: If one of them is not finite.
    """
    values = np.array(value_of(attribute, time, np.zeros(size)), dtype=np.float64)
    if values.shape != (size,) or not np.isfinite(values).all():
        raise InvalidValue(f"{attribute.GetName()} must be {size} finite numbers, got {values.tolist()}")
    return values
