"""How many steps are taken at a time, so that somebody gets to look at progress and at Ctrl-C."""

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from warpcontact.validation.safe_text import terminal

if TYPE_CHECKING:
    from tqdm import tqdm

# What is taken at a time is to take so long [s], or up to twice or half that.
TARGET_SECONDS = 0.1


@dataclass
class ChunkSizer:
    """A number of steps that follows the time that they take.

    Args:
        steps: How many are taken at first, and at least: whole graphs.
        max_steps: How many at most, where they are queued and no time tells; ``None``: as many as the time allows.
    """

    steps: int
    max_steps: int | None = None

    def __post_init__(self) -> None:
        self._min_steps = self.steps

    def next(self, count: int) -> int:
        """Returns how many of ``count`` steps to take now: what is little more than that all at once."""
        return count if 2 * count < 3 * self.steps else min(count, self.steps)

    def record(self, count: int, seconds: float) -> None:
        """Counts that ``count`` steps took so long [s]."""
        if (
            seconds < 0.5 * TARGET_SECONDS
            and 2 * count > self.steps
            and (self.max_steps is None or self.steps < self.max_steps)
        ):
            self.steps *= 2
        elif seconds > 2.0 * TARGET_SECONDS and self.steps > self._min_steps:
            self.steps //= 2


def progress_bar(progress: Any, steps: int, what: str) -> "contextlib.AbstractContextManager[tqdm]":
    """Returns the bar that ``steps`` steps move on: that of ``tqdm`` that is given, to stay open, or its own.

    Args:
        progress: Whether to show one, on runs of over a second; ``None``: in a terminal. Or the bar.
        steps: How many steps come.
        what: What is stepped.
    """
    from tqdm import tqdm

    if isinstance(progress, tqdm):
        return contextlib.nullcontext(progress)
    disable = None if progress is None else not progress
    return tqdm(total=steps, unit="step", desc=what, delay=1.0, disable=disable, file=terminal())
