"""Which environments turned non-finite and were frozen."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpcontact.kernels.types import ENV_ACTIVE


@dataclass(frozen=True)
class Health:
    """State of health of all environments.

    Attributes:
        envs: Number of environments.
        frozen: Numbers of the environments whose state turned non-finite. They are held at the last state
            before and cost no more time; ``reset`` revives them.
    """

    envs: int
    frozen: NDArray[np.int_]

    @classmethod
    def of_status(cls, status: NDArray[np.int_], numbers: NDArray[np.int_] | None = None) -> "Health":
        """Reads the status array of a model; ``numbers`` are those of its environments, if not from 0."""
        frozen = np.flatnonzero(status != ENV_ACTIVE)
        return cls(envs=len(status), frozen=frozen if numbers is None else numbers[frozen])

    @property
    def good(self) -> bool:
        """Whether every environment is active."""
        return len(self.frozen) == 0

    def __str__(self) -> str:
        if self.good:
            return f"all {self.envs} environments are active"
        first = ", ".join(map(str, self.frozen[:8]))
        more = ", …" if len(self.frozen) > 8 else ""
        return (
            f"{len(self.frozen)} of {self.envs} environments turned non-finite and are frozen at the last "
            f"state before: {first}{more}"
        )
