"""Which environments are shown one by one, and why."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from warpcontact.model.health import Health
from warpcontact.visualize.report.outcomes import OutcomeSpread

# Of those that nobody asked for.
FIRST = 16
FROZEN = 8
EXTREMES_OF = 6


@dataclass
class Choice:
    """Environments, those first that matter most if there is no room for all.

    Attributes:
        reasons: Why each was chosen, by its number.
        requested: Whether somebody named them.
    """

    reasons: dict[int, list[str]] = field(default_factory=dict)
    requested: bool = False

    @property
    def envs(self) -> list[int]:
        """Their numbers, in the order of what matters."""
        return list(self.reasons)

    def add(self, env: int, reason: str = "") -> None:
        """Adds an environment, or a reason for it."""
        reasons = self.reasons.setdefault(int(env), [])
        if reason:
            reasons.append(reason)

    def label(self, env: int) -> str:
        """Returns what an environment is called: its number and why it was chosen."""
        return ", ".join([str(env), *self.reasons.get(env, [])[:3]])


def choose(
    requested: Iterable[int] | None, numbers: NDArray[np.int64], health: Health, spreads: Sequence[OutcomeSpread]
) -> Choice:
    """Returns which environments are shown one by one.

    Args:
        requested: Those that the user named; ``None``: the first, some that are frozen, and those in which
            outcomes are smallest and largest.
        numbers: Those that there are.
        health: Which are frozen.
        spreads: The outcomes.

    Raises:
        ValueError: If one that was named is not there, or none was.
    """
    reasons = Choice()
    for env in health.frozen[:FROZEN]:
        reasons.add(env, "failed")
    for spread in spreads[:EXTREMES_OF]:
        if spread.lowest is not None and spread.highest is not None and spread.lowest != spread.highest:
            reasons.add(spread.lowest, f"smallest {spread.column.name}")
            reasons.add(spread.highest, f"largest {spread.column.name}")
    choice = Choice(requested=requested is not None)
    available = set(numbers.tolist())
    if requested is None:
        candidates = [*numbers[:1].tolist(), *reasons.envs, *numbers[:FIRST].tolist()]
    else:
        candidates = list(requested)
        for env in candidates:
            if isinstance(env, bool) or not isinstance(env, int | np.integer):
                raise ValueError(f"envs must be numbers of environments, got {env!r}")
            if int(env) not in available:
                available_text = f"{numbers.min()} to {numbers.max()}" if len(numbers) else "none"
                raise ValueError(f"environment {env} has no results to report; there are: {available_text}")
        if not candidates:
            raise ValueError("envs must name at least one environment, got none")
    for env in candidates:
        if int(env) in available:
            choice.add(env)
    for env in choice.envs:
        for reason in reasons.reasons.get(env, []):
            choice.add(env, reason)
    return choice
