"""Cases of the scaling measurement: variation of environments, points, triangles, threads.

Everything else is constant along a series: the terrain is the same surface on a finer grid, bodies start at the
same positions, and points are added to the same box.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

import warpcontact as wc
from warpcontact.benchmark.scenes import HALF, Array, BenchmarkScene, box_points, terrain
from warpcontact.benchmark.simulation import simulation

SERIES = ("environments", "points", "triangles", "threads")
SCENES = {"W1": None, "W2p8": box_points(8), "W2p64": box_points(64)}

# Factor 4 from case to case. The total number of contacts is limited by memory.
MOST_ENVS_ON_CPU, MOST_ENVS_ON_CUDA, MOST_CONTACTS = 4**7, 4**10, 2**24
POINTS = (1, 8, 16, 32, 64, 128, 256, 512)
# Cells along a side: 968 … 999 698 triangles, with a factor of 3 from case to case.
CELLS = (22, 39, 71, 122, 224, 387, 707)
TRIANGLE_SCENES = ("W1", "W2p8")
# Environments per thread at the largest size: step times of the scenes are about equal.
ENVS_OF_A_THREAD = {"W1": 4096, "W2p8": 2048, "W2p64": 512}


@dataclass(frozen=True)
class Case:
    """One point of a series.

    Attributes:
        series: Name of the series.
        line: Benchmark scene, or another constant along a line of the plot.
        value: Value of the varied quantity.
        scene: Benchmark scene.
        envs: Number of environments.
        threads: Number of CPU threads.
    """

    series: str
    line: str
    value: int
    scene: BenchmarkScene
    envs: int
    threads: int

    def simulation(self, device: str) -> wc.Simulation:
        """Returns the simulation in its initial state."""
        return simulation(self.scene, self.envs, device, threads=self.threads)


@dataclass(frozen=True)
class Sizes:
    """Sizes of the cases.

    Attributes:
        device: ``"cpu"``, ``"cuda:0"``, …
        most_envs: Maximum number of environments, in all series.
        most_points: Maximum number of points of a body.
        most_triangles: Maximum number of triangles.
        threads: Maximum number of threads.
    """

    device: str
    most_envs: int
    most_points: int
    most_triangles: int
    threads: int

    def envs(self, on_cpu: int, on_cuda: int) -> int:
        """Returns the number of environments of a series that does not vary it."""
        return min(self.most_envs, on_cuda if self.device.startswith("cuda") else on_cpu)


def cases(series: str, sizes: Sizes) -> list[Case]:
    """Returns the cases of a series."""
    return list(_OF[series](sizes))


def _environments(sizes: Sizes) -> Iterator[Case]:
    for line, points in SCENES.items():
        scene = BenchmarkScene(line, terrain(), points)
        envs = 1
        while envs <= sizes.most_envs and envs * (1 if points is None else len(points)) <= MOST_CONTACTS:
            yield Case("environments", line, envs, scene, envs, sizes.threads)
            envs *= 4


def _points(sizes: Sizes) -> Iterator[Case]:
    envs = sizes.envs(512, 8192)
    for count in POINTS:
        if count <= sizes.most_points:
            scene = BenchmarkScene(f"{count} points", terrain(), None if count == 1 else spread_points(count))
            yield Case("points", "sphere, then box", count, scene, envs, sizes.threads)


def spread_points(count: int) -> Array:
    """Returns the 8 corners of the box and ``count`` − 8 points spread evenly over its surface, ``(count, 3)``."""
    corners = box_points(8)
    if count == len(corners):
        return corners
    samples = wc.sample_surface(wc.meshes.box((2 * HALF,) * 3), count - len(corners))
    return np.concatenate((corners, samples.positions))


def _triangles(sizes: Sizes) -> Iterator[Case]:
    envs = sizes.envs(256, 16384)
    for cells in CELLS:
        if 2 * cells**2 <= sizes.most_triangles:
            surface = terrain(cells=cells)
            for line in TRIANGLE_SCENES:
                scene = BenchmarkScene(line, surface, SCENES[line])
                yield Case("triangles", line, 2 * cells**2, scene, envs, sizes.threads)


def _threads(sizes: Sizes) -> Iterator[Case]:
    if sizes.device != "cpu":
        return
    counts = [1]
    while 2 * counts[-1] <= sizes.threads:
        counts.append(2 * counts[-1])
    for line, points in SCENES.items():
        scene = BenchmarkScene(line, terrain(), points)
        envs = sizes.envs(ENVS_OF_A_THREAD[line] * sizes.threads, 0)
        for count in dict.fromkeys((*counts, sizes.threads)):
            yield Case("threads", line, count, scene, envs, count)


_OF: dict[str, Callable[[Sizes], Iterator[Case]]] = {
    "environments": _environments,
    "points": _points,
    "triangles": _triangles,
    "threads": _threads,
}
