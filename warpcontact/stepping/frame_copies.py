"""Copies of recorded frames on a CPU, from sensor arrays to results, by kernel launches.

The kernel is ``kernels/outcomes/recording.py``; see ``frame_buffers.py`` for results and GPUs.
"""

import functools
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.execution_plan import ExecutionPlan
from warpcontact.kernels.outcomes import recording
from warpcontact.system.capture_lock import shared_capture_lock

if TYPE_CHECKING:
    from warpcontact.forces.sensor import Sensor
    from warpcontact.model.model import DeviceModel


class FrameCopies:
    """Sources and results of the recorded sensors of a part on the CPU.

    Args:
        part: The part. A reference is kept, because sensor arrays may be views of its memory.
    """

    def __init__(self, part: "DeviceModel") -> None:
        self._part = part
        self._sources: list[tuple[Sensor, wp.array, NDArray[Any]]] = []

    def add(self, sensor: "Sensor", result: NDArray[Any]) -> None:
        """Adds a sensor of the part; ``result`` receives its frames (frame, env, …)."""
        self._sources.append((sensor, sensor.array(self._part.arrays), result))

    @functools.cached_property
    def rows(self) -> NDArray[Any]:
        """One ``kernels.outcomes.recording.Row`` per sensor; read it after all sensors were added."""
        return np.array([_row(*source_row) for source_row in self._sources], recording.Row.numpy_dtype())

    def take(self, number: int) -> None:
        """Copies frame ``number`` of all environments, without a launch."""
        for sensor, source, result in self._sources:
            result[number] = sensor.finish(source.numpy(), axis=1)


def _row(sensor: "Sensor", source: wp.array, result: NDArray[Any]) -> tuple[int, ...]:
    size = wp.types.type_size_in_bytes(source.dtype)
    # An item (scalar, vector or matrix) is contiguous. Contiguous items are copied as one.
    items, item_stride = (source.shape[1], source.strides[1]) if source.ndim == 2 else (1, size)
    if item_stride == size and not sensor.total:
        items, size = 1, items * size
    word_count = size // (8 if sensor.total else 4)
    frame_range = (source.ptr, source.strides[0], item_stride, result.ctypes.data, result.strides[0])
    return (*frame_range, items, word_count, int(sensor.total))


class FrameRecording:
    """Launch that copies the frames of a slice. It reads the frame number and the sensors when it runs.

    Args:
        plan: Execution plan of the environments, on the CPU.

    Attributes:
        launches: The launch, as a list.
    """

    @shared_capture_lock()
    def __init__(self, plan: ExecutionPlan) -> None:
        frame_range = wp.zeros(2, dtype=wp.int32, device="cpu")
        # Allocated for all sensors of the model.
        rows = wp.zeros(len(plan.model.sensors), dtype=recording.Row, device="cpu")
        self.launches = plan.prepare(recording.record_frame(), 1, counters=frame_range, rows=rows)
        # NumPy views, which keep the memory that the launch reads alive.
        self._frame_range, self._rows = frame_range.numpy(), rows.numpy()

    def set_copies(self, copies: FrameCopies | None) -> None:
        """Selects the sensors of subsequent frames; ``None``: none."""
        count = 0
        if copies is not None:
            count = len(copies.rows)
            self._rows[:count] = copies.rows
        self._frame_range[1] = count

    def set_frame(self, number: int) -> None:
        """Sets the number of the next frame; the launch increments it."""
        self._frame_range[0] = number
