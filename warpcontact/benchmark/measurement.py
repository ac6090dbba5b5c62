"""Measures the stepping speed of this machine in half a minute: ``wc.bench``."""

import os
import statistics
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import warp as wp

from warpcontact.benchmark.facts import facts, versions
from warpcontact.benchmark.limits import limits
from warpcontact.benchmark.report import BenchReport, WorkFigures
from warpcontact.benchmark.scenes import DT, SCENES, STEPS, BenchmarkScene
from warpcontact.benchmark.simulation import run_seconds, seconds_of_runs, simulation
from warpcontact.kernels.catalogue.keywords import explain_keywords
from warpcontact.stepping.simulation import Simulation
from warpcontact.system.devices import find_device
from warpcontact.validation import checks
from warpcontact.validation.safe_text import terminal
from warpcontact.validation.warning_levels import ContactWarning

#: Default numbers of environments: enough to use all cores, or a whole GPU.
ENVS_ON_CPU, ENVS_ON_CUDA = 1024, 65536
# Time for which a single environment of each scene is stepped [s].
ALONE_SECONDS = 0.3


@dataclass
class _Entry:
    """A scene that is being measured; times in s."""

    title: str
    scene: BenchmarkScene
    sim: Simulation
    first_step: float
    times: list[float] = field(default_factory=list)
    busy: float = 0.0


@explain_keywords
def bench(
    device: str = "auto",
    envs: int | None = None,
    *,
    seconds: float = 3.0,
    precision: str = "float32",
    progress: bool | None = None,
) -> BenchReport:
    """Measures the stepping speed of this machine with a sphere, and boxes of 8 and 64 points, on a terrain.

    A run is 1000 steps of 1 ms from rest, 0.4 m above 20 000 triangles, through contact. Runs of the scenes alternate.

    Args:
        device: ``"cpu"``, ``"cuda:0"``, …; ``"auto"``: a GPU if available.
        envs: Number of environments; ``None``: 1024 on a CPU, 65536 on a GPU.
        seconds: Minimum stepping time of each scene [s]; there is at least one run.
        precision: ``"float32"`` or ``"float64"``.
        progress: Whether to show a progress bar; ``None``: in a terminal.

    Returns:
        The results; as text, a table.

    Raises:
        ValueError: If an argument is out of range, or the device does not exist.
    """
    from tqdm import tqdm

    checks.numbers("seconds", seconds, (), checks.limits("s", above=0.0))
    checks.choice("precision", precision, ("float32", "float64"))
    where = find_device(device)
    name = str(where)
    envs = default_envs(where) if envs is None else envs
    modules = _cached_modules()
    with (
        _without_step_warnings(),
        tqdm(
            total=round(len(SCENES) * (seconds + ALONE_SECONDS), 1),
            unit="s",
            bar_format="{desc} {percentage:3.0f}%|{bar}| {elapsed}",
            disable=None if progress is None else not progress,
            file=terminal(),
        ) as bar,
    ):
        entries = []
        for title, scene in SCENES.items():
            bar.set_description(f"{title}: building, compiling")
            entries.append(_begin(title, scene, envs, name, precision))
        compiled = len(_cached_modules() - modules)
        for entry in _round_robin(entries, seconds):
            bar.set_description(entry.title)
            _run(entry)
            bar.update(min(entry.times[-1], max(0.0, seconds - sum(entry.times[:-1]))))
        figures = []
        for entry in entries:
            bar.set_description(f"{entry.title}: one alone, limits")
            figures.append(_finish(entry, name, precision))
            bar.update(ALONE_SECONDS)
    return BenchReport(
        facts=facts(name, entries[0].sim.threads),
        versions=versions(),
        envs=envs,
        precision=precision,
        steps=STEPS,
        dt=DT,
        compiled_modules=compiled,
        works=tuple(figures),
    )


def default_envs(device: wp.Device) -> int:
    """Returns the default number of environments of ``bench``."""
    return ENVS_ON_CUDA if device.is_cuda else ENVS_ON_CPU


@contextmanager
def _without_step_warnings() -> Iterator[None]:
    """Suppresses warnings about long time steps, which are prescribed by the benchmark."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ContactWarning)
        yield


def _cached_modules() -> set[str]:
    """Returns the names of the compiled modules in Warp's cache."""
    folder = Path(wp.config.kernel_cache_dir)
    return set(os.listdir(folder)) if folder.is_dir() else set()


def _begin(title: str, scene: BenchmarkScene, envs: int, device: str, precision: str) -> _Entry:
    """Builds a scene, takes its first step, and then a run that is not counted."""
    start = time.perf_counter()
    sim = simulation(scene, envs, device, precision)
    sim.step(1)
    wp.synchronize_device(device)
    elapsed = time.perf_counter() - start
    run_seconds(sim, STEPS)
    return _Entry(title, scene, sim, elapsed)


def _round_robin(entries: list[_Entry], seconds: float) -> Iterator[_Entry]:
    """Yields each entry in turn until all have been stepped for ``seconds``."""
    while waiting := [entry for entry in entries if sum(entry.times) < seconds]:
        yield from waiting


def _run(entry: _Entry) -> None:
    used = time.process_time()
    entry.times.append(run_seconds(entry.sim, STEPS))
    entry.busy += time.process_time() - used


def _finish(entry: _Entry, device: str, precision: str) -> WorkFigures:
    """Completes the measurement of a scene: the bounds at its current state, and a single environment."""
    sim = entry.sim
    envs = sim.model.envs
    least = limits(sim.model.parts[0], entry.scene, sim.threads)
    alone = simulation(entry.scene, 1, device, precision)
    run_seconds(alone, STEPS)
    alone_s = seconds_of_runs(alone, STEPS, ALONE_SECONDS)
    rates = [envs * STEPS / elapsed for elapsed in entry.times]
    return WorkFigures(
        work=entry.title,
        triangles=len(entry.scene.surface.faces),
        first_step_s=entry.first_step,
        env_steps_per_s=statistics.median(rates),
        lowest=min(rates),
        highest=max(rates),
        runs=len(rates),
        cores_busy=entry.busy / sum(entry.times),
        frozen=len(sim.model.health().frozen),
        steps_per_s_alone=STEPS / alone_s,
        queries_per_s=1.0 / least.query,
        copies_per_s=1.0 / least.copy,
    )
