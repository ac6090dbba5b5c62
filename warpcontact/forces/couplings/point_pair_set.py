"""Base class of registered families of force elements between two points, see ``scene/scene_element.py``."""

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn

import warp as wp

from warpcontact.forces.couplings.coupling_set import CouplingSet
from warpcontact.forces.force_element import BuildContext, ForceElement
from warpcontact.kernels.catalogue.device_model import named_struct, unit_vectors
from warpcontact.scene.elements import ENABLED
from warpcontact.scene.scene_element import PointPair, SceneElement
from warpcontact.storage.allocation_plan import per_env
from warpcontact.validation import checks

if TYPE_CHECKING:
    from warpcontact.storage.allocation_plan import AllocationPlan
    from warpcontact.storage.parameters import Parameters

# Sensors that all elements have.
_END_SENSORS = ("force_a", "force_b")


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
        directions = [name for name, limits in self.kind.parameters().items() if limits["direction"]]
        ranges = {**self.kind.parameters(), **switches}
        if ranges:
            struct = settings_struct(self.kind, self.types.real)
            converted = {**dict.fromkeys(switches, checks.switches), **dict.fromkeys(directions, unit_vectors)}
            fields = self._add_settings(parameters, self, struct, ranges, converted=converted)
            for name in directions:
                fields[name].values[:] = unit_vectors(name, fields[name].values)
        self._results = layout.struct(self.family, self.struct, per_env(self.count), transient=self.transient)

    @property
    def results(self) -> Any:
        """Results of the last evaluation, and history."""
        return self._results

    @classmethod
    def declare(cls, context: BuildContext, elements: Sequence[PointPair]) -> list[ForceElement]:
        """Declares all elements of the class; to be passed to ``registry.register``.

        Raises:
            TypeError: If an attribute of the class, such as ``struct``, is missing or not allowed.
        """
        _check_class(cls, elements)
        return [cls(elements, context)]


def _check_class(cls: type[PointPairSet], elements: Sequence[PointPair]) -> None:
    """Checks that the attributes of a class are given and consistent.

    Raises:
        TypeError: If not; the message names the attribute.
    """

    def refuse(name: str, allowed: str) -> NoReturn:
        given = repr(getattr(cls, name)) if hasattr(cls, name) else "none"
        raise TypeError(f"{cls.__name__}.{name} must be {allowed}, got {given}")

    kind, struct = getattr(cls, "kind", None), getattr(cls, "struct", None)
    for one in {type(element) for element in elements}:
        if not (isinstance(kind, type) and issubclass(one, kind) and _settings(one) == _settings(kind)):
            refuse("kind", f"the registered class, {one.__name__}, or a base of it with the same parameters")
    arrays = getattr(struct, "vars", {})
    if not arrays or any(getattr(array.type, "ndim", 0) != 2 for array in arrays.values()):
        refuse("struct", "a wp.struct of arrays [env, element], wp.array2d")
    listed = f"names of arrays of struct: {', '.join(arrays)}"
    transient = getattr(cls, "transient", None)
    if isinstance(transient, str) or not isinstance(transient, Collection) or set(transient) - set(arrays):
        refuse("transient", f"a tuple of {listed}")
    quantities = getattr(cls, "quantities", None)
    if not isinstance(quantities, Mapping):
        refuse("quantities", "a dictionary from a name to (array, unit, meaning)")
    for name, quantity in quantities.items():
        if not isinstance(quantity, tuple) or len(quantity) != 3 or quantity[0] not in arrays:
            refuse("quantities", f"a dictionary from a name to (array, unit, meaning), with {listed}")
        if name in _END_SENSORS:
            refuse("quantities", f"without {' and '.join(_END_SENSORS)}, sensors that all elements have")
    sensors = (*quantities, *_END_SENSORS)
    for one in {type(element) for element in elements}:
        if unknown := [name for name in one.recorded if name not in sensors]:
            raise TypeError(f"{one.__name__}.recorded must be sensors: {', '.join(sensors)}, got {unknown[0]!r}")


def _settings(kind: type[SceneElement]) -> tuple[Mapping[str, Any], list[str]]:
    return kind.parameters(), _switches(kind)


def settings_struct(kind: type[SceneElement], real: type) -> Any:
    """Returns the struct of the parameters of an element: numbers and vectors of ``real``, booleans as int32."""
    types = {(): real, (3,): wp.types.vector(3, real), (4,): wp.types.vector(4, real)}
    numbers = [(name, types[limits["shape"]]) for name, limits in kind.parameters().items()]
    return named_struct(f"{kind.__name__}Settings", (*numbers, *((name, wp.int32) for name in _switches(kind))))


def _switches(kind: type[SceneElement]) -> list[str]:
    return [field.name for field in kind.arguments() if kind.kind_of(field) is bool]
