"""Compiles kernels in advance: those of experiments, and those of ``warpcontact bench``.

A model is built as for a run. Its kernels for the CPU are compiled concurrently. Then the first steps load the
kernels that no list contains, such as those that reset environments, and all kernels of a GPU.
"""

import contextlib
import itertools
import tempfile
import threading
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import warp as wp

from warpcontact.model.model_traits import CONTACT_NEEDS
from warpcontact.system.compilation import load_all
from warpcontact.system.resources import available_threads

if TYPE_CHECKING:
    from warpcontact.experiment import Experiment

#: Called after each kernel with the number of loaded kernels and the number of all kernels.
Progress = Callable[[int, int], None]


class ExperimentKernels:
    """The kernels that a run of an experiment launches.

    Args:
        experiment: The experiment.
        device: Device or devices, as for ``Experiment.run``.

    Attributes:
        on_cpu: The kernels for the CPU, the largest first.

    Raises:
        ExperimentError: If a device does not exist.
        MemoryError: If not even one environment fits into memory.
    """

    def __init__(self, experiment: "Experiment", device: str | Sequence[str]) -> None:
        from warpcontact.experiment.experiment import CHECKPOINT
        from warpcontact.experiment.shards import SeriesSchedule, ShardRunner
        from warpcontact.experiment.store import Shards

        plan = experiment.plan(device=device)
        plan.require()
        frames = SeriesSchedule.of(experiment.settings, plan.block)
        model = experiment.draft(device).build(plan.shard)
        self._runner = ShardRunner(model, experiment.settings, experiment.design, frames, Path(), CHECKPOINT)
        self._shards = Shards(plan.envs, plan.shard)
        self.on_cpu: list[wp.Kernel] = []
        # The values of a shard decide whether contacts at the start are evaluated.
        for shard in reversed(self._shards):
            self._runner.load_shard(shard)
            self.on_cpu += self._runner.kernels()

    def load_others(self) -> None:
        """Compiles the kernels that are not listed: takes the first steps and exports their frames.

        The animation is written into a temporary folder in the cache.
        """
        from warpcontact.usd import export_usd

        recording = self._runner.run_sample_steps(self._shards[0])
        if not self._runner.settings.record.series:
            return
        # Cables and shapes are evaluated by kernels for export. Errors are ignored, as at the end of a run.
        with tempfile.TemporaryDirectory(dir=wp.config.kernel_cache_dir) as folder, contextlib.suppress(Exception):
            export_usd(
                recording,
                Path(folder, "animation.usdc"),
                envs=range(1),
                ensemble=False,
                pressure=False,
                progress=False,
            )


def build_bench(device: str, envs: int | None, threads: int | None, progress: Progress) -> None:
    """Compiles the kernels that ``warpcontact bench`` launches, except those that are in the cache.

    Args:
        device: The device.
        envs: Number of environments. ``None``: as for ``bench``.
        threads: Maximum number of threads that compile. ``None``: one per core.
        progress: Called after each kernel of the CPU.

    Raises:
        ValueError: If the device does not exist.
    """
    from warpcontact.benchmark.limits import POSITION, load_query
    from warpcontact.benchmark.measurement import default_envs
    from warpcontact.benchmark.scenes import SCENES
    from warpcontact.benchmark.simulation import simulation
    from warpcontact.system.devices import find_device

    where = find_device(device)
    # ``bench`` also measures a single environment, for which a GPU uses other kernels.
    sizes = (1, default_envs(where) if envs is None else envs)[where.is_cpu :]
    sims = [simulation(scene, size, str(where)) for scene in SCENES.values() for size in sizes]
    kernels: list[wp.Kernel] = []
    for sim in sims:
        needs = [frozenset(sim.model.find_sensor(POSITION).needs)]
        kernels += sim.step_kernels([*needs, CONTACT_NEEDS] if sim.evaluates_start else needs)
    load_kernels(kernels, threads, progress)
    for sim in sims:
        sim.step()
        sim.reset()
        sim.model.sensor(POSITION)
    load_query(where)


def load_kernels(kernels: Iterable[wp.Kernel], threads: int | None, progress: Progress) -> None:
    """Compiles kernels for the CPU concurrently.

    Args:
        kernels: The kernels, the largest first. Duplicates are compiled once.
        threads: Maximum number of threads. ``None``: one per core.
        progress: Called after each kernel.
    """
    kernels = list(dict.fromkeys(kernels))
    numbers, lock = itertools.count(1), threading.Lock()

    def count(_: wp.Kernel) -> None:
        with lock:
            progress(next(numbers), len(kernels))

    load_all(
        kernels, wp.get_device("cpu"), available_threads() if threads is None else threads, count, release=True
    )
