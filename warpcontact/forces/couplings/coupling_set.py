"""Base class of the device data of couplings that are computed by the same kernel."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.force_element import BuildContext, ForceElement, ForceTarget
from warpcontact.forces.sensor import Sensor, shape_in
from warpcontact.kernels.types import WORLD
from warpcontact.scene.status import CouplingStatus
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.storage.parameters import Field, pack
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.storage.allocation_plan import AllocationPlan
    from warpcontact.storage.parameters import Parameters

# Conversions of parameters that are not stored as given.
_CONVERTED = {
    "enabled": checks.switches,
    "tension_only": checks.switches,
    "orientation": checks.unit_quaternions,
}
_ENDS = (("a", 0), ("b", 1))


class CouplingSet(ForceElement, ABC):
    """Device data of couplings that are computed by the same kernel.

    Args:
        couplings: The couplings; all have the same ``key``.
        context: The model to which arrays, ends and parameters are added.

    Attributes:
        couplings: The couplings.
        first: Number of the pair of ends of the first one; coupling i has the ends 2 (first + i) and 2 (first + i) + 1.
        end_bodies: Body indices of the ends, or ``WORLD``, two per coupling.
        types: Warp structs of the precision.
    """

    family = "couplings"
    target = ForceTarget.ENDS
    #: Sensors of this kind, in addition to the end forces: quantity → (array, unit, meaning).
    quantities: ClassVar[Mapping[str, tuple[str, str, str]]]
    #: Enumeration of the values of ``status``.
    codes: ClassVar[type[IntEnum]] = CouplingStatus

    def __init__(self, couplings: Sequence[Any], context: BuildContext) -> None:
        super().__init__()
        self.couplings = couplings
        bodies = [[WORLD if body is None else body.index for body in one.bodies] for one in couplings]
        points = [[one.point_a.start, one.point_b.start] for one in couplings]
        self.first = context.ends.add(bodies, points)
        self.end_bodies = [body for pair in bodies for body in pair]
        self.types = context.types
        self._make(context.layout, context.parameters)

    @staticmethod
    def key(coupling: Any) -> Any:
        """Returns the key of the kernel: couplings of this kind with equal keys use the same kernel."""
        return None

    @property
    def count(self) -> int:
        """Number of couplings."""
        return len(self.couplings)

    def _add_settings(
        self,
        parameters: "Parameters",
        owner: Any,
        struct: Any,
        ranges: Mapping[str, Mapping[str, Any]],
        computed: Callable[[dict[str, Array]], dict[str, Array]] = lambda values: values,
        converted: Mapping[str, Callable[[str, Array], Array]] = _CONVERTED,
    ) -> dict[str, Field]:
        """Adds attributes of the couplings as parameters, and the device field ``owner.settings``.

        Args:
            parameters: Parameters to which they are added.
            owner: Object that gets the array.
            struct: Warp struct of the array elements.
            ranges: Allowed values, by attribute.
            computed: Returns the columns of the array for the values of the attributes.
            converted: Conversions of attributes that are not stored as given.

        Returns:
            The fields, by attribute.
        """
        fields = {key: Field(np.array([getattr(one, key) for one in self.couplings])) for key in ranges}

        def content() -> NDArray[Any]:
            return pack(struct, computed({key: field.values for key, field in fields.items()}))

        device_field = parameters.device_field(owner, "settings", struct, content)
        for item, one in enumerate(self.couplings):
            for key, allowed in ranges.items():
                parameters.add(
                    f"{one.name}.{key}",
                    fields[key],
                    slice(item, item + 1),
                    allowed,
                    [device_field],
                    tail=fields[key].values.shape[2:],
                    convert=converted.get(key),
                )
        return fields

    @abstractmethod
    def _make(self, layout: "AllocationPlan", parameters: "Parameters") -> None:
        """Declares its arrays and adds its parameters."""

    @property
    @abstractmethod
    def results(self) -> Any:
        """Struct of the arrays of sensors [env, coupling of the set]."""

    def sensors(self) -> Iterator[Sensor]:
        """Yields the sensors of the couplings."""
        for item, coupling in enumerate(self.couplings):
            for end, place in _ENDS:
                meaning = f"force on the body of end {end}, world"
                array = _column_of_ends(2 * (self.first + item) + place)
                name = f"{coupling.name}.force_{end}"
                yield Sensor(name, "N", meaning, array, needs=("contacts",), shape=(3,))
            for quantity, (attribute, unit, meaning) in self.quantities.items():
                array = self._column(attribute, item)
                name, codes = f"{coupling.name}.{quantity}", self.codes if quantity == "status" else None
                shape = shape_in(self.results, attribute)
                yield Sensor(name, unit, meaning, array, needs=("contacts",), codes=codes, shape=shape)

    def _column(self, attribute: str, item: int) -> Callable[[ModelArrays], wp.array]:
        return lambda _: getattr(self.results, attribute)[:, item]


def _column_of_ends(number: int) -> Callable[[ModelArrays], wp.array]:
    return lambda arrays: arrays.end_wrenches.force[:, number]
