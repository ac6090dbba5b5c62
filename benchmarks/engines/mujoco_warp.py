"""MuJoCo Warp with the models of MuJoCo; on a GPU steps are replayed from a graph, as in its own speed test."""

from typing import Any

import mujoco_warp as mjw
import warp as wp
from benchmark_scenes import BenchmarkScene, sanity

from engines import mjcf

PACKAGES = ("mujoco-warp", "mujoco", "warp-lang", "numpy")

#: Candidate pairs per environment (mean over all environments), and maximum contacts of one environment.
PAIRS = {"W1": 4, "W2p8": 10, "W2p64": 72, "W3": 48}
CONTACTS = {"W1": 8, "W2p8": 12, "W2p64": 24, "W3": 64}
STEPS_IN_GRAPH = 10


class Run:
    """Run of a benchmark scene; see the package."""

    def __init__(self, scene: BenchmarkScene, envs: int, device: str, threads: int, variant: str) -> None:
        wp.config.log_level = wp.LOG_ERROR
        self._scene = scene
        self._shape = (envs, scene.bodies)
        host = mjcf.model(scene)
        wp.set_device(device)
        self._model = mjw.put_model(host)
        self._data = mjw.make_data(host, nworld=envs, nconmax=PAIRS[scene.name], njmax=3 * CONTACTS[scene.name])
        self._start = wp.array(mjcf.start(scene, envs), dtype=float)
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

    def sanity(self, steps: int) -> dict[str, float]:
        return sanity(self._scene, self._data.qpos.numpy().reshape(*self._shape, 7)[..., :3])

    def notes(self) -> dict[str, Any]:
        return {
            "overflow": bool(self._data.overflow.numpy().any()),
            "contacts": round(int(self._data.nacon.numpy()[0]) / self._shape[0], 2),
            "rows": int(self._data.nefc.numpy().max()),
        }
