"""A sensor: a named quantity of a model that can be evaluated, recorded and reduced to outcomes."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.storage.model_arrays import ModelArrays

#: Name and labels of the last axis of pairs of limits (2), vectors (3) and quaternions (4).
AXES = {2: ("limit", ["first", "second"]), 3: ("axis", ["x", "y", "z"]), 4: ("component", ["x", "y", "z", "w"])}

# At each status a sensor has the value of the table "Status and sensors" in docs/contact.md: ``gap`` is the signed
# distance, also at WRONG_SIDE, where it is negative without contact.
CONTACT_SENSORS = {
    "gap": ("gap", "m", "signed distance, negative in overlap, with or without contact"),
    "penetration": ("penetration", "m", "penetration, 0 without contact"),
    "normal_force": ("normal_force", "N", "normal force"),
    "friction_force": ("friction_force", "N", "friction force on the point's body, world"),
    "torque": ("torque", "N·m", "torque of rolling and torsional friction on the point's body, world"),
    "normal": ("normal", "-", "unit normal out of the surface, world"),
    "slip_speed": ("slip_speed", "m/s", "tangential speed at K, 0 without contact"),
    "approach_speed": ("approach_speed", "m/s", "rate of penetration at K, 0 without contact"),
    "status": ("status", "-", "state of the contact"),
}


@dataclass(frozen=True)
class Sensor:
    """A named quantity that can be evaluated or recorded.

    Attributes:
        name: ``<element>.<quantity>``.
        unit: SI unit.
        meaning: Description with frame.
        array: Returns its device array, (envs,) or (envs, item), from the arrays of a model.
        needs: Quantities to compute first: ``"contacts"``, or also the ``"wrenches"`` on bodies; body
            ``"positions"``, ``"energies"`` and ``"momenta"``; contact ``"points"``; ``"all_distances"`` also of contacts
            that are far; ``"reactions"`` and ``"coordinates"`` of joints; forces of ``"contact_couplings"``;
            ``"shape_points"``, ``"shape_curvatures"`` and ``"shape_gradients"`` of shape contacts; measures of
            ``"particles"``.
        items: Number of items of a set, 0 if there is no item axis.
        items_of: Kind of its items, such as ``"point"``, if they are not those of its element; names their dimension.
        total: Whether the value is the sum over the item axis.
        codes: Enumeration of its integer values, if any.
        shape: Shape of a value: () for a number, (3,) for a vector.
    """

    name: str
    unit: str
    meaning: str
    array: Callable[[ModelArrays], wp.array]
    needs: tuple[str, ...] = ()
    items: int = 0
    total: bool = False
    codes: type[IntEnum] | None = None
    shape: tuple[int, ...] = ()
    items_of: str = ""

    @property
    def flags(self) -> dict[str, Any]:
        """CF attributes of its codes; empty if the values are no codes."""
        if self.codes is None:
            return {}
        return {
            "flag_values": [int(code) for code in self.codes],
            "flag_meanings": " ".join(code.name for code in self.codes),
        }

    def finish(self, values: NDArray[Any], axis: int = 1) -> NDArray[Any]:
        """Returns the reported values for the ``values`` of the array; ``axis`` is the item axis."""
        if not self.total:
            return values
        # Sum in order of items, and without −0, as kernels do.
        return np.add.accumulate(values, axis=axis).take(-1, axis=axis) + 0.0


def shape_in(struct: Any, attribute: str) -> tuple[int, ...]:
    """Returns the shape of the values of an array of a Warp struct, or of an instance of one."""
    variables = struct.vars if hasattr(struct, "vars") else struct._cls.vars
    return tuple(getattr(variables[attribute].type.dtype, "_shape_", ()))
