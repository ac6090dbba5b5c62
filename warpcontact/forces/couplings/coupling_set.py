"""Couplings of equal code side by side on a device: what the step, resets and sensors need of them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import IntEnum
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.types import WORLD
from warpcontact.model.sensors import Sensor, shape_in
from warpcontact.scene.status import CouplingStatus
from warpcontact.storage.parameters import Field, pack
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan
    from warpcontact.storage.allocation_plan import AllocationPlan
    from warpcontact.storage.parameters import Parameters

# Values that are not taken as they are given.
_CONVERTED = {
    "enabled": checks.switches,
    "tension_only": checks.switches,
    "orientation": checks.unit_quaternions,
}
_ENDS = (("a", 0), ("b", 1))


class CouplingSet(ABC):
    """Couplings that are computed by the same code, made of their elements.

    Args:
        couplings: The couplings, of one key.
        first: Number of the first among all; the ends of number i are 2 i and 2 i + 1.
        layout: Where to declare arrays.
        parameters: Where to add parameters.
        types: Structs of the precision.
    """

    #: What the sensors of all kinds tell, and of this kind alone: quantity → (array, unit, meaning).
    quantities: ClassVar[Mapping[str, tuple[str, str, str]]]
    #: What the numbers of the quantity ``status`` stand for.
    codes: ClassVar[type[IntEnum]] = CouplingStatus

    def __init__(
        self,
        couplings: Sequence[Any],
        first: int,
        layout: "AllocationPlan",
        parameters: "Parameters",
        types: SimpleNamespace,
    ) -> None:
        self.couplings = couplings
        self.first = first
        self.types = types
        self._make(layout, parameters)

    @staticmethod
    def key(coupling: Any) -> Any:
        """Returns what couplings of this kind must agree in to be computed by the same code."""
        return None

    @property
    def count(self) -> int:
        """Number of its couplings."""
        return len(self.couplings)

    def end_points(self) -> list[int]:
        """Returns the points of its ends, two for each coupling."""
        return [point.start for one in self.couplings for point in (one.point_a, one.point_b)]

    def end_bodies(self) -> list[int]:
        """Returns what its ends are fixed to likewise, bodies by number or ``WORLD``."""
        return [WORLD if body is None else body.index for one in self.couplings for body in one.bodies]

    def _add_settings(
        self,
        parameters: "Parameters",
        owner: Any,
        struct: Any,
        ranges: Mapping[str, Mapping[str, Any]],
        computed: Callable[[dict[str, Array]], dict[str, Array]] = lambda values: values,
    ) -> dict[str, Field]:
        """Adds what couplings of this kind have as attributes, and the array ``owner.settings`` of ``struct``.

        Args:
            parameters: Where to add them.
            owner: What the array is an attribute of.
            struct: What it is made of.
            ranges: What is allowed, by attribute.
            computed: Returns the columns of the array from their values.

        Returns:
            Their fields, by attribute.
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
                    convert=_CONVERTED.get(key),
                )
        return fields

    @abstractmethod
    def _make(self, layout: "AllocationPlan", parameters: "Parameters") -> None:
        """Declares its arrays and adds its parameters."""

    @property
    @abstractmethod
    def results(self) -> Any:
        """The struct of arrays [env, coupling of the set] that its sensors are in."""

    @abstractmethod
    def force_stages(self, plan: "ExecutionPlan", state: Any, status: wp.array) -> list[wp.Launch]:
        """Returns the launches that compute the forces at its ends in ``state``; they change no history.

        ``status`` [env] says which environments are active.
        """

    def accept_stages(self, plan: "ExecutionPlan") -> list[wp.Launch]:
        """Returns the launches that remember what an accepted step led to."""
        return []

    def reset_state(self, chosen: wp.array, envs: int) -> None:  # noqa: B027  nothing, if nothing is remembered
        """Empties what the environments of the mask ``chosen`` [env] remember."""

    def compile(self, device: wp.Device) -> None:  # noqa: B027  only a user's formula can be wrong
        """Compiles its kernels, so that a mistake in a user's formula shows at once.

        Raises:
            TypeError: If one does not compile.
        """

    def sensors(self) -> Iterator[Sensor]:
        """Iterates over what can be measured."""
        for item, coupling in enumerate(self.couplings):
            for end, place in _ENDS:
                meaning = f"force on what end {end} is fixed to, world"
                array = _column_of_ends(2 * (self.first + item) + place)
                name = f"{coupling.name}.force_{end}"
                yield Sensor(name, "N", meaning, array, needs=("contacts",), shape=(3,))
            for quantity, (attribute, unit, meaning) in self.quantities.items():
                array = self._column(attribute, item)
                name, codes = f"{coupling.name}.{quantity}", self.codes if quantity == "status" else None
                shape = shape_in(self.results, attribute)
                yield Sensor(name, unit, meaning, array, needs=("contacts",), codes=codes, shape=shape)

    def _column(self, attribute: str, item: int) -> Callable[[SimpleNamespace], wp.array]:
        return lambda _: getattr(self.results, attribute)[:, item]


def _column_of_ends(number: int) -> Callable[[SimpleNamespace], wp.array]:
    return lambda arrays: arrays.coupling_wrenches.force[:, number]
