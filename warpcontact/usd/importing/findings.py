"""Error of a stage that cannot be imported, findings while it is read, and validated values of its attributes.

Schemas are read without the plug-ins that define them.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np
import numpy.typing as npt

from warpcontact.validation import safe_text

# Largest number of problems listed in the message, and characters of each.
_LISTED = 50
_LENGTH = 600

#: Schemas included by those of Newton. USD adds them only if the plug-in of ``newton-usd-schemas`` is loaded.
INCLUDED = {
    "NewtonArticulationRootAPI": ("PhysicsArticulationRootAPI",),
    "NewtonMassAPI": ("PhysicsMassAPI",),
    "NewtonCollisionAPI": ("PhysicsCollisionAPI",),
    "NewtonMeshCollisionAPI": ("NewtonCollisionAPI", "PhysicsCollisionAPI", "PhysicsMeshCollisionAPI"),
    "NewtonSDFCollisionAPI": ("NewtonCollisionAPI", "PhysicsCollisionAPI"),
    "NewtonMaterialAPI": ("PhysicsMaterialAPI",),
}


class UsdError(ValueError):
    """USD stage that cannot be imported as a scene.

    Attributes:
        problems: All problems, each with the path of its prim.
    """

    def __init__(self, subject: str, problems: Iterable[str]) -> None:
        self.problems = tuple(problems)
        shown = [shortened(problem, _LENGTH) for problem in self.problems[:_LISTED]]
        if len(self.problems) > _LISTED:
            shown.append(f"and {len(self.problems) - _LISTED} more, in the attribute problems of this error")
        if len(self.problems) == 1:
            super().__init__(safe_text.escape_controls(f"{subject}: {shown[0]}"))
        else:
            listed = "".join(f"\n  - {o}" for o in shown)
            super().__init__(safe_text.escape_controls(f"{subject} has {len(self.problems)} problems:{listed}"))


def shortened(text: object, most: int = 120) -> str:
    """Returns a text as one line of at most ``most`` characters; shortens the middle, because paths end in names."""
    return safe_text.truncate(safe_text.single_line(text), most, middle=True)


def applied(prim: Any) -> list[str]:
    """Returns the names of the applied schemas of a prim in order, without instance names and repetitions."""
    names: dict[str, None] = {}
    for full in prim.GetPrimTypeInfo().GetAppliedAPISchemas():
        name = str(full).partition(":")[0]
        names |= dict.fromkeys((name, *INCLUDED.get(name, ())))
    return list(names)


def has(prim: Any, schema: str) -> bool:
    """Returns whether a schema is applied to a prim, directly or included by another one."""
    return schema in applied(prim)


def value_of(attribute: Any, time: Any, fallback: Any = None) -> Any:
    """Returns the value of an attribute; ``fallback`` if it does not exist, has no value, or is blocked."""
    value = attribute.Get(time) if attribute else None
    return fallback if value is None else value


def is_on(attribute: Any, time: Any) -> bool:
    """Returns a boolean attribute of UsdPhysics that is true by default."""
    return bool(value_of(attribute, time, True))


def is_authored(attribute: Any) -> bool:
    """Returns whether an attribute has an authored value, other than the fallback of its schema."""
    return bool(attribute) and attribute.HasAuthoredValue()


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
