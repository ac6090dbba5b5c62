"""How frames get on the CPU from where readings are measured to where they are kept: by launches."""

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
    """What launches take of the frames of a part on the CPU: from where readings are measured to their results.

    Args:
        part: The part.

    """

    def __init__(self, part: "Model") -> None:
        self._part = part
        # A ``kernels.recording.Row`` for each reading.
        self._rows: list[tuple[int, ...]] = []
        # Whose memory that is.
        self._owners: list[tuple[wp.array, NDArray[Any]]] = []
        self._taking: Taking | None = None

    def add(self, reading: "Reading", result: NDArray[Any]) -> None:
        """Adds a reading of the part; ``result`` receives all its frames (frame, env, …)."""
        source = reading.array(self._part.arrays)
        size = wp.types.type_size_in_bytes(source.dtype)
        # Each item is in one piece, be it a number, a vector or a matrix; what has no items is one.
        items, apart = (source.shape[1], source.strides[1]) if source.ndim == 2 else (1, size)
        if apart == size and not reading.total:
            items, size = 1, items * size
        words = size // (8 if reading.total else 4)
        place = (source.ptr, source.strides[0], apart, result.ctypes.data, result.strides[0])
        self._rows.append((*place, items, words, int(reading.total)))
        self._owners.append((source, result))

    def __len__(self) -> int:
        """Returns the number of readings."""
        return len(self._rows)

    def rows(self) -> NDArray[Any]:
        """Returns what a launch is told of the readings, a ``kernels.recording.Row`` for each."""
        return np.array(self._rows, recording.Row.numpy_dtype())

    @beside_captures()
    def take(self, number: int) -> None:
        """Takes all environments of a frame."""
        if self._taking is None:
            self._taking = Taking(Span(self._part, self._part.envs, False, True), len(self))
            self._taking.read(self)
        self._taking.go_to(number)
        for launch in self._taking.launches:
            launch.launch()


class Taking:
    """The launch that takes frames of some environments; which, and of what, it reads when it runs.

    Args:
        span: The environments, on the CPU.
        room: Of how many readings at most.

    Attributes:
        launches: It.
        room: Of how many readings at most.
    """

    @beside_captures()
    def __init__(self, span: Span, room: int) -> None:
        place = wp.zeros(2, dtype=wp.int32, device="cpu")
        rows = wp.zeros(room, dtype=recording.Row, device="cpu")
        self.launches = span.prepare(recording.take(), 1, [place, rows])
        self.room = room
        # Views, which keep what the launch reads.
        self._place, self._rows = place.numpy(), rows.numpy()

    def read(self, copies: Copies | None) -> None:
        """Takes frames of other readings from now on, or of none."""
        count = 0
        if copies is not None:
            count = len(copies)
            self._rows[:count] = copies.rows()
        self._place[1] = count

    def go_to(self, number: int) -> None:
        """Takes frame ``number`` next, and then those after it."""
        self._place[0] = number
