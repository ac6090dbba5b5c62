"""Base class of registered families of force elements between two points, see ``scene/scene_element.py``."""

from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import warp as wp

from warpcontact.forces.couplings.coupling_set import CouplingSet
from warpcontact.forces.force_element import BuildContext, ForceElement
from warpcontact.kernels.catalogue.device_model import named_struct
from warpcontact.scene.elements import ENABLED
from warpcontact.scene.scene_element import PointPair, SceneElement
from warpcontact.storage.allocation_plan import per_env
from warpcontact.validation import checks

if TYPE_CHECKING:
    from warpcontact.storage.allocation_plan import AllocationPlan
    from warpcontact.storage.parameters import Parameters


class PointPairSet(CouplingSet):
    """Device data of all elements of a class derived from ``PointPair``.

    Numbers and booleans that the class declares become parameters; ``settings`` has their values.

    Attributes:
        settings: Struct of the parameters [env, element], see ``settings_struct``.
        results: Arrays of sensors and history, [env, element].
    """

    #: Class of the elements.
    kind: ClassVar[type[PointPair]]
    #: Warp struct of ``results``.
    struct: ClassVar[Any]
    #: Names of the arrays that force launches write. The others are history, which checkpoints store.
    transient: ClassVar[Collection[str]]

    def _make(self, layout: "AllocationPlan", parameters: "Parameters") -> None:
        self.settings: Any = None
        switches = dict.fromkeys(_switches(self.kind), ENABLED)
        ranges = {**self.kind.parameters(), **switches}
        if ranges:
            struct = settings_struct(self.kind, self.types.real)
            converted = dict.fromkeys(switches, checks.switches)
            self._add_settings(parameters, self, struct, ranges, converted=converted)
        self._results = layout.struct(self.family, self.struct, per_env(self.count), transient=self.transient)

    @property
    def results(self) -> Any:
        """Results of the last evaluation, and history."""
        return self._results

    @classmethod
    def declare(cls, context: BuildContext, elements: Sequence[PointPair]) -> list[ForceElement]:
        """Declares all elements of the class; to be passed to ``registry.register``."""
        return [cls(elements, context)]


def settings_struct(kind: type[SceneElement], real: type) -> Any:
    """Returns the struct of the parameters of an element: numbers and vectors of ``real``, booleans as int32."""
    types = {(): real, (3,): wp.types.vector(3, real), (4,): wp.types.vector(4, real)}
    numbers = [(name, types[limits["shape"]]) for name, limits in kind.parameters().items()]
    return named_struct(f"{kind.__name__}Settings", (*numbers, *((name, wp.int32) for name in _switches(kind))))


def _switches(kind: type[SceneElement]) -> list[str]:
    return [field.name for field in kind.arguments() if kind.kind_of(field) is bool]
