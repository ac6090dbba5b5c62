"""Number of steps per chunk, adapted to the time they take, so that progress and Ctrl-C are handled regularly."""

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from warpcontact.validation.safe_text import terminal

if TYPE_CHECKING:
    from tqdm import tqdm

# Target duration of a chunk [s]; half to twice this value is accepted.
TARGET_SECONDS = 0.1


@dataclass
class ChunkSizer:
    """Number of steps per chunk, adapted to their measured duration.

    Args:
        steps: Initial and minimum number of steps, a multiple of a graph.
        max_steps: Maximum number of steps, for devices that queue launches, whose duration is not measured. ``None``:
            no maximum.
    """

    steps: int
    max_steps: int | None = None

    def __post_init__(self) -> None:
        self._min_steps = self.steps

    def next(self, count: int) -> int:
        """Returns the steps of the next chunk; all ``count`` remaining steps if fewer than 1.5 chunks remain."""
        return count if 2 * count < 3 * self.steps else min(count, self.steps)

    def record(self, count: int, seconds: float) -> None:
        """Adapts the number of steps: ``count`` steps took ``seconds``."""
        if (
            seconds < 0.5 * TARGET_SECONDS
            and 2 * count > self.steps
            and (self.max_steps is None or self.steps < self.max_steps)
        ):
            self.steps *= 2
        elif seconds > 2.0 * TARGET_SECONDS and self.steps > self._min_steps:
            self.steps //= 2


def progress_bar(progress: Any, steps: int, what: str) -> "contextlib.AbstractContextManager[tqdm]":
    """Returns a context with a ``tqdm`` bar of ``steps`` steps; a given bar is used and not closed.

    Args:
        progress: Whether to show a bar in runs longer than 1 s. ``None``: only in a terminal. Or a ``tqdm`` bar.
        steps: Total number of steps.
        what: Description of the bar.
    """
    from tqdm import tqdm

    if isinstance(progress, tqdm):
        return contextlib.nullcontext(progress)
    disable = None if progress is None else not progress
    return tqdm(total=steps, unit="step", desc=what, delay=1.0, disable=disable, file=terminal())
