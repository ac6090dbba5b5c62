"""How frames get on the CPU from where readings are measured to where they are kept: by launches."""

import functools
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.captures import beside_captures
from warpcontact.kernels import recording
from warpcontact.schedule import Span

if TYPE_CHECKING:
    from warpcontact.model import Model
    from warpcontact.readings import Reading


class Copies:
    """What is taken of the frames of a part on the CPU: from where readings are measured to their results.

    Args:
        part: The part, which lives as long: its arrays may be views of its memory.
    """

    def __init__(self, part: "Model") -> None:
        self._part = part
        self._ways: list[tuple[Reading, wp.array, NDArray[Any]]] = []

    def add(self, reading: "Reading", result: NDArray[Any]) -> None:
        """Adds a reading of the part; ``result`` receives all its frames (frame, env, …)."""
        self._ways.append((reading, reading.array(self._part.arrays), result))

    @functools.cached_property
    def rows(self) -> NDArray[Any]:
        """What launches are told of the readings, once all are added: a ``kernels.recording.Row`` for each."""
        return np.array([_row(*way) for way in self._ways], recording.Row.numpy_dtype())

    def take(self, number: int) -> None:
        """Takes a frame of all environments, without a launch."""
        for reading, source, result in self._ways:
            result[number] = reading.finish(source.numpy(), axis=1)


def _row(reading: "Reading", source: wp.array, result: NDArray[Any]) -> tuple[int, ...]:
    size = wp.types.type_size_in_bytes(source.dtype)
    # Each item is in one piece, be it a number, a vector or a matrix; what has no items is one.
    items, apart = (source.shape[1], source.strides[1]) if source.ndim == 2 else (1, size)
    if apart == size and not reading.total:
        items, size = 1, items * size
    words = size // (8 if reading.total else 4)
    place = (source.ptr, source.strides[0], apart, result.ctypes.data, result.strides[0])
    return (*place, items, words, int(reading.total))


class Taking:
    """The launch that takes frames of some environments; which, and of what, it reads when it runs.

    Args:
        span: The environments, on the CPU.

    Attributes:
        launches: It.
    """

    @beside_captures()
    def __init__(self, span: Span) -> None:
        place = wp.zeros(2, dtype=wp.int32, device="cpu")
        # There is room for all readings.
        rows = wp.zeros(len(span.model.readings), dtype=recording.Row, device="cpu")
        self.launches = span.prepare(recording.take(), 1, [place, rows])
        # Views, which keep what the launch reads.
        self._place, self._rows = place.numpy(), rows.numpy()

    def read(self, copies: Copies | None) -> None:
        """Takes frames of other readings from now on, or of none."""
        count = 0
        if copies is not None:
            count = len(copies.rows)
            self._rows[:count] = copies.rows
        self._place[1] = count

    def go_to(self, number: int) -> None:
        """Takes frame ``number`` next, and then those after it."""
        self._place[0] = number
