"""How frames get on the CPU from where sensors are measured to where they are kept: by launches."""

import functools
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.execution_plan import ExecutionPlan
from warpcontact.kernels.outcomes import recording
from warpcontact.system.capture_lock import shared_capture_lock

if TYPE_CHECKING:
    from warpcontact.model.model import Model
    from warpcontact.model.sensors import Sensor


class FrameCopies:
    """What is taken of the frames of a part on the CPU: from where sensors are measured to their results.

    Args:
        part: The part, which lives as long: its arrays may be views of its memory.
    """

    def __init__(self, part: "Model") -> None:
        self._part = part
        self._sources: list[tuple[Sensor, wp.array, NDArray[Any]]] = []

    def add(self, sensor: "Sensor", result: NDArray[Any]) -> None:
        """Adds a sensor of the part; ``result`` receives all its frames (frame, env, …)."""
        self._sources.append((sensor, sensor.array(self._part.arrays), result))

    @functools.cached_property
    def rows(self) -> NDArray[Any]:
        """What launches are told of the sensors, once all are added: a ``kernels.recording.Row`` for each."""
        return np.array([_row(*source_row) for source_row in self._sources], recording.Row.numpy_dtype())

    def take(self, number: int) -> None:
        """Takes a frame of all environments, without a launch."""
        for sensor, source, result in self._sources:
            result[number] = sensor.finish(source.numpy(), axis=1)


def _row(sensor: "Sensor", source: wp.array, result: NDArray[Any]) -> tuple[int, ...]:
    size = wp.types.type_size_in_bytes(source.dtype)
    # Each item is in one piece, be it a number, a vector or a matrix; what has no items is one.
    items, item_stride = (source.shape[1], source.strides[1]) if source.ndim == 2 else (1, size)
    if item_stride == size and not sensor.total:
        items, size = 1, items * size
    word_count = size // (8 if sensor.total else 4)
    frame_range = (source.ptr, source.strides[0], item_stride, result.ctypes.data, result.strides[0])
    return (*frame_range, items, word_count, int(sensor.total))


class FrameRecording:
    """The launch that takes frames of some environments; which, and of what, it reads when it runs.

    Args:
        plan: The environments, on the CPU.

    Attributes:
        launches: It.
    """

    @shared_capture_lock()
    def __init__(self, plan: ExecutionPlan) -> None:
        frame_range = wp.zeros(2, dtype=wp.int32, device="cpu")
        # There is room for all sensors.
        rows = wp.zeros(len(plan.model.sensors), dtype=recording.Row, device="cpu")
        self.launches = plan.prepare(recording.record_frame(), 1, [frame_range, rows])
        # Views, which keep what the launch reads.
        self._frame_range, self._rows = frame_range.numpy(), rows.numpy()

    def set_copies(self, copies: FrameCopies | None) -> None:
        """Takes frames of other sensors from now on, or of none."""
        count = 0
        if copies is not None:
            count = len(copies.rows)
            self._rows[:count] = copies.rows
        self._frame_range[1] = count

    def set_frame(self, number: int) -> None:
        """Takes frame ``number`` next, and then those after it."""
        self._frame_range[0] = number
