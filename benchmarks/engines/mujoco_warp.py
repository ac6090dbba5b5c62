"""MuJoCo Warp with the models of MuJoCo; on a GPU steps are replayed from a graph, as in its own speed test."""

from typing import Any

import body_contact_benchmark_scenes
import mujoco_warp as mjw
import numpy as np
import warp as wp
from benchmark_scenes import BenchmarkScene, sanity
from body_contact_benchmark_scenes import AT_REST, Bin, Rolling

from engines import mjcf

PACKAGES = ("mujoco-warp", "mujoco", "warp-lang", "numpy")

#: Candidate pairs per environment (mean over all environments), and maximum contacts of one environment.
PAIRS = {"W1": 4, "W2p8": 10, "W2p64": 72, "W3": 48, "W4": 160, "W5": 16}
CONTACTS = {"W1": 8, "W2p8": 12, "W2p64": 24, "W3": 64, "W4": 160, "W5": 32}
STEPS_IN_GRAPH = 10


class Stepped:
    """Common part of all runs: steps of a model from initial positions.

    Args:
        host: The model.
        positions: Initial ``qpos``, ``(envs, nq)``.
        pairs: Candidate pairs per environment.
        contacts: Maximum contacts of one environment.
        device: Device.
    """

    def __init__(self, host: Any, positions: np.ndarray, pairs: int, contacts: int, device: str) -> None:
        wp.config.log_level = wp.LOG_ERROR
        wp.set_device(device)
        envs = len(positions)
        self._model = mjw.put_model(host)
        self._data = mjw.make_data(host, nworld=envs, nconmax=pairs, njmax=3 * contacts)
        self._start = wp.array(positions, dtype=float)
        self.reset()
        mjw.step(self._model, self._data)  # compiles all kernels
        self._graph = None
        if wp.get_device(device).is_cuda:
            with wp.ScopedCapture() as capture:
                self._take(STEPS_IN_GRAPH)
            self._graph = capture.graph
        self.reset()

    def _take(self, count: int) -> None:
        for _ in range(count):
            mjw.step(self._model, self._data)

    def reset(self) -> None:
        wp.copy(self._data.qpos, self._start)
        for values in (self._data.qvel, self._data.qacc_warmstart, self._data.time):
            values.zero_()

    def step(self, count: int) -> None:
        if self._graph is None:
            self._take(count)
        else:
            for _ in range(count // STEPS_IN_GRAPH):
                wp.capture_launch(self._graph)

    def wait(self) -> None:
        wp.synchronize()

    def notes(self) -> dict[str, Any]:
        return {
            "overflow": bool(self._data.overflow.numpy().any()),
            "contacts": round(int(self._data.nacon.numpy()[0]) / len(self._start), 2),
            "rows": int(self._data.nefc.numpy().max()),
        }


class Run(Stepped):
    """Run of a benchmark scene; see the package."""

    def __init__(self, scene: BenchmarkScene, envs: int, device: str, threads: int, variant: str) -> None:
        self._scene = scene
        super().__init__(
            mjcf.model(scene), mjcf.start(scene, envs), PAIRS[scene.name], CONTACTS[scene.name], device
        )

    def sanity(self, steps: int) -> dict[str, float]:
        poses = self._data.qpos.numpy().reshape(len(self._start), self._scene.bodies, 7)
        return sanity(self._scene, poses[..., :3])


class BodyContactRun(Stepped):
    """Run of a benchmark scene of body contact; see the package."""

    def __init__(self, scene: Bin | Rolling, envs: int, device: str, threads: int, variant: str) -> None:
        self._scene = scene
        positions = mjcf.scalar_first(scene.start(envs)).reshape(envs, -1)
        host = mjcf.body_contact_model(scene)
        super().__init__(host, positions, PAIRS[scene.name], CONTACTS[scene.name], device)

    def sanity(self, steps: int) -> dict[str, float]:
        self.reset()
        self.step(steps)
        before = self._poses()
        self.step(AT_REST)
        after = self._poses()
        velocities = self._data.qvel.numpy().reshape(*after.shape[:2], 6)
        return body_contact_benchmark_scenes.sanity(
            self._scene, before, after, mjcf.world_velocities(velocities, after)
        )

    def _poses(self) -> np.ndarray:
        return mjcf.scalar_last(self._data.qpos.numpy().reshape(len(self._start), -1, 7))
