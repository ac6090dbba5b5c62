"""Selection of the environments that the report shows individually, with reasons."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from warpcontact.model.health import Health
from warpcontact.visualize.report.outcomes import OutcomeSpread

# Numbers of environments selected by default: the first ones, frozen ones, and outcomes with their extremes.
FIRST = 16
FROZEN = 8
EXTREMES_OF = 6


@dataclass
class Choice:
    """Selected environments, in order of importance if there is no space for all.

    Attributes:
        reasons: Reasons for each environment, by its number.
        requested: Whether the user listed them.
    """

    reasons: dict[int, list[str]] = field(default_factory=dict)
    requested: bool = False

    @property
    def envs(self) -> list[int]:
        """Numbers of the environments, in order of importance."""
        return list(self.reasons)

    def add(self, env: int, reason: str = "") -> None:
        """Adds an environment, or another reason for it."""
        reasons = self.reasons.setdefault(int(env), [])
        if reason:
            reasons.append(reason)

    def label(self, env: int) -> str:
        """Returns the label of an environment: its number and up to three reasons."""
        return ", ".join([str(env), *self.reasons.get(env, [])[:3]])


def choose(
    requested: Iterable[int] | None, numbers: NDArray[np.int64], health: Health, spreads: Sequence[OutcomeSpread]
) -> Choice:
    """Selects the environments that are shown individually.

    Args:
        requested: Environments listed by the user; ``None``: the first ones, some frozen ones, and those with the
            smallest and largest outcomes.
        numbers: Numbers of the available environments.
        health: Frozen environments.
        spreads: Spreads of the outcomes.

    Raises:
        ValueError: If a listed environment is not available, or the list is empty.
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
                raise ValueError(f"envs must be environment numbers, got {env!r}")
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
