"""Device data of shapes, grouped by kind."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.catalogue.device_model import coefficient_struct
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.kernels.shapes.records import ShapePose, shapes_struct
from warpcontact.scene.shapes import Shape
from warpcontact.storage.parameters import Field, pack
from warpcontact.validation import checks
from warpcontact.validation.checks import Array, limits

if TYPE_CHECKING:
    from warpcontact.storage.parameters import Parameters


class ShapeSet:
    """All shapes of one kind, in consecutive order on the device.

    Args:
        shapes: The shapes, of one class.
        parameters: Parameters to which their sizes and poses are added.

    Attributes:
        kind: Class of the shapes.
        arrays: Struct of arrays [env, shape]: ``coefficients`` and ``pose``, in float64.
    """

    def __init__(self, shapes: Sequence[Shape], parameters: "Parameters") -> None:
        self.kind: type[Form] = shapes[0].kind
        self.arrays = shapes_struct(self.kind)()
        starts = np.cumsum([0] + [shape.count for shape in shapes]).tolist()
        self._items = {
            shape: slice(first, first + shape.count) for shape, first in zip(shapes, starts, strict=False)
        }
        self.count: int = starts[-1]
        self._add_poses(parameters)
        self._add_sizes(parameters)

    def numbers(self, shape: Shape) -> NDArray[np.int32]:
        """Returns the indices of the items of ``shape`` in the arrays, (n,)."""
        items = self._items[shape]
        return np.arange(items.start, items.stop, dtype=np.int32)

    def _add_poses(self, parameters: "Parameters") -> None:
        position = Field(np.concatenate([shape.positions for shape in self._items]))
        orientation = Field(np.concatenate([shape.orientations for shape in self._items]))

        def content() -> NDArray[Any]:
            return pack(ShapePose, {"position": position.values, "orientation": orientation.values})

        device_field = parameters.device_field(self.arrays, "pose", ShapePose, content)
        for shape, items in self._items.items():
            single = shape.single
            parameters.add(
                f"{shape.name}.position", position, items, limits("m"), [device_field], tail=(3,), single=single
            )
            parameters.add(
                f"{shape.name}.orientation",
                orientation,
                items,
                checks.FINITE,
                [device_field],
                tail=(4,),
                single=single,
                convert=checks.unit_quaternions,
            )

    def _add_sizes(self, parameters: "Parameters") -> None:
        kind, count = self.kind, self.count
        struct = coefficient_struct(kind, wp.float64)
        names = next(iter(self._items)).sizes
        fields = {key: Field(np.concatenate([shape.sizes[key] for shape in self._items])) for key in names}

        def content() -> NDArray[Any]:
            if not kind.device_names():
                return pack(struct, {"unused": np.zeros((1, count))})
            envs = max(len(field.values) for field in fields.values())
            values = {key: _of_all(field.values, envs) for key, field in fields.items()}
            computed = kind.coefficients(values)
            return pack(struct, {key: computed[key] for key in kind.device_names()})

        device_field = parameters.device_field(self.arrays, "coefficients", struct, content)
        for shape, items in self._items.items():
            for key, field in fields.items():
                allowed = kind.limits(key)
                tail = field.values.shape[2:]
                name = f"{shape.name}.{key}"
                parameters.add(name, field, items, allowed, [device_field], tail=tail, single=shape.single)


def _of_all(values: Array, envs: int) -> Array:
    return np.broadcast_to(values, (envs, *values.shape[1:]))


def make_shape_sets(shapes: Sequence[Shape], parameters: "Parameters") -> dict[type[Form], ShapeSet]:
    """Adds the parameters of all shapes of a scene; returns them by kind."""
    sorted_: dict[type[Form], list[Shape]] = {}
    for shape in shapes:
        sorted_.setdefault(shape.kind, []).append(shape)
    return {kind: ShapeSet(own, parameters) for kind, own in sorted_.items()}
