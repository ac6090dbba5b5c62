"""warpcontact: Kelvin–Voigt contact with tanh friction, with the triangles of the surface and between spheres."""

from typing import Any

import numpy as np
import warp as wp
from works import Work

from warpcontact.benchmark.simulation import simulation

WORKS = ("W1", "W2p8", "W2p64", "W3")
PACKAGES = ("warpcontact", "warp-lang", "numpy")
wp.config.log_level = wp.LOG_ERROR


class Run:
    """Run of a benchmark scene; see the package."""

    def __init__(self, work: Work, envs: int, device: str, threads: int, variant: str) -> None:
        self._sim = simulation(work, envs, device, threads=threads)

    def reset(self) -> None:
        self._sim.reset()

    def step(self, count: int) -> None:
        self._sim.step(count)

    def wait(self) -> None:
        wp.synchronize()

    def positions(self) -> np.ndarray:
        return self._sim.state.body_position.numpy()

    def notes(self) -> dict[str, Any]:
        return {"frozen": len(self._sim.model.health().frozen)}
