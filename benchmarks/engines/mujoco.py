"""MuJoCo: environments distributed over its thread pool."""

from typing import Any

import mujoco
import mujoco.rollout
import numpy as np
from works import Work

from engines import mjcf

WORKS = ("W1", "W2p8", "W2p64", "W3")
PACKAGES = ("mujoco", "numpy")

STEPS_AT_ONCE = 100  # rollouts store every state: long ones are limited by memory bandwidth


class Run:
    """Run of a benchmark scene; see the package."""

    def __init__(self, work: Work, envs: int, device: str, threads: int, variant: str) -> None:
        self._model = mjcf.model(work)
        self._bodies = work.bodies
        self._data = [mujoco.MjData(self._model) for _ in range(threads)]
        self._pool = mujoco.rollout.Rollout(nthread=threads)
        size = mujoco.mj_stateSize(self._model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self._start = np.zeros((envs, size))
        self._start[:, 1 : 1 + self._model.nq] = mjcf.start(work, envs)
        self._states = np.zeros((envs, STEPS_AT_ONCE, size))
        self.reset()

    def reset(self) -> None:
        self._state = self._start.copy()

    def step(self, count: int) -> None:
        while count:
            steps = min(count, STEPS_AT_ONCE)
            out = self._states if steps == STEPS_AT_ONCE else np.zeros_like(self._states[:, :steps])
            self._pool.rollout(self._model, self._data, self._state, nstep=steps, state=out)
            self._state = out[:, -1].copy()
            count -= steps

    def wait(self) -> None:
        pass

    def positions(self) -> np.ndarray:
        return self._state[:, 1 : 1 + self._model.nq].reshape(len(self._state), self._bodies, 7)[..., :3]

    def notes(self) -> dict[str, Any]:
        return {}
