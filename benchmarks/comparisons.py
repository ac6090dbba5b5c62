"""Comparisons of engines: their scenes, their engines, and the defaults of a run. Needs NumPy only."""

from dataclasses import dataclass
from typing import Any

import benchmark_scenes
import body_contact_benchmark_scenes
import nonsmooth_benchmark_scenes
from engines import BODY_CONTACT_ENGINES, ENGINES, NONSMOOTH_ENGINES, Engine


@dataclass(frozen=True)
class Comparison:
    """A set of scenes that a set of engines runs.

    Attributes:
        scenes: Benchmark scenes by name.
        engines: Engines by name.
        run: Class of a run in the modules of the engines.
        steps: Number of steps of a run.
        default_scenes: Scenes that are run by default.
        envs_on_cpu: Numbers of environments on a CPU.
        envs_on_cuda: Numbers of environments on a GPU.
    """

    scenes: dict[str, Any]
    engines: dict[str, Engine]
    run: str
    steps: int
    default_scenes: list[str]
    envs_on_cpu: list[int]
    envs_on_cuda: list[int]


COMPARISONS = {
    "compliant": Comparison(
        benchmark_scenes.SCENES, ENGINES, "Run", benchmark_scenes.STEPS, list(benchmark_scenes.SCENES), [1024], [8192, 32768, 131072]
    ),
    "nonsmooth": Comparison(
        nonsmooth_benchmark_scenes.SCENES, NONSMOOTH_ENGINES, "NonsmoothRun", nonsmooth_benchmark_scenes.STEPS, ["table8", "stack8"],
        [4096], [4096, 131072],
    ),
    "bodies": Comparison(
        body_contact_benchmark_scenes.SCENES, BODY_CONTACT_ENGINES, "BodyContactRun", body_contact_benchmark_scenes.STEPS, ["W4", "W5"],
        [64], [1024, 4096, 16384],
    ),
}  # fmt: skip


def comparison_of(scene: str) -> Comparison:
    """Returns the comparison that contains a scene."""
    return next(comparison for comparison in COMPARISONS.values() if scene in comparison.scenes)
