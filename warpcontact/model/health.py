"""Health of environments: the frozen ones with causes and times, and the stopped ones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from warpcontact.kernels.types import ENV_FROZEN, ENV_STOPPED
from warpcontact.scene.status import FailureCause

_WORDS = {
    FailureCause.NON_FINITE: "turned non-finite",
    FailureCause.TOO_FAST: "became faster than scene.max_speed",
    FailureCause.TOO_FAR: "went beyond scene.max_distance",
}


@dataclass(frozen=True)
class Health:
    """Health of all environments.

    Attributes:
        envs: Number of environments.
        frozen: Numbers of the environments that failed. They keep their last valid state and are skipped by steps
            until ``reset``.
        causes: ``FailureCause`` of each frozen environment.
        times: Clock of each frozen environment, the time of its last valid state [s].
        stopped: Numbers of the environments that a stop condition ended.
        conditions: Number of stopped environments by name of the stop condition, if available.
    """

    envs: int
    frozen: NDArray[np.int_]
    causes: Sequence[FailureCause]
    times: NDArray[np.float64]
    stopped: NDArray[np.int_]
    conditions: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        status: NDArray[np.int_],
        cause: NDArray[np.int_],
        time: NDArray[np.float64],
        numbers: NDArray[np.int_] | None = None,
        conditions: Mapping[str, int] | None = None,
    ) -> "Health":
        """Returns the health for the status, causes and clocks of all environments (envs,).

        ``numbers`` are the numbers of the environments (default: from 0), ``conditions`` as in the attribute.
        """
        numbers = np.arange(len(status)) if numbers is None else numbers
        frozen = np.flatnonzero(status == ENV_FROZEN)
        return cls(
            envs=len(status),
            frozen=numbers[frozen],
            causes=tuple(FailureCause(int(one)) for one in cause[frozen]),
            times=time[frozen],
            stopped=numbers[status == ENV_STOPPED],
            conditions=conditions or {},
        )

    @property
    def good(self) -> bool:
        """Whether no environment failed."""
        return len(self.frozen) == 0

    def __str__(self) -> str:
        active = self.envs - len(self.frozen) - len(self.stopped)
        by = ", ".join(f"{name} {count}" for name, count in self.conditions.items())
        stopped = f"; {len(self.stopped)} are stopped{f' ({by})' if by else ''}" if len(self.stopped) else ""
        if self.good:
            every = "all" if not stopped else f"{active} of"
            return f"{every} {self.envs} environments are active{stopped}"
        causes = np.array(self.causes)
        texts = [
            f"{np.count_nonzero(causes == cause)} of {self.envs} environments {words} and are frozen at their last "
            f"valid state: {_listed(self.frozen[causes == cause])}"
            for cause, words in _WORDS.items()
            if (causes == cause).any()
        ]
        return "; ".join(texts) + stopped


def _listed(numbers: NDArray[np.int_]) -> str:
    return ", ".join(map(str, numbers[:8])) + (", …" if len(numbers) > 8 else "")
