"""How many steps are taken at a time, so that somebody gets to look at progress and at Ctrl-C."""

from dataclasses import dataclass

# What is taken at a time is to take so long [s], or up to twice or half that.
SECONDS = 0.1


@dataclass
class Pace:
    """A number of steps that follows the time that they take.

    Args:
        steps: How many are taken at first, and at least: whole graphs.
        most: How many at most, where they are queued and no time tells; ``None``: as many as the time allows.
    """

    steps: int
    most: int | None = None

    def __post_init__(self) -> None:
        self._least = self.steps

    def took(self, count: int, seconds: float) -> None:
        """Counts that ``count`` steps took so long [s]."""
        if seconds < 0.5 * SECONDS and 2 * count > self.steps and (self.most is None or self.steps < self.most):
            self.steps *= 2
        elif seconds > 2.0 * SECONDS and self.steps > self._least:
            self.steps //= 2
