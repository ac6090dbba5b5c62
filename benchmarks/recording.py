"""Measures the cost of frames relative to the steps between them.

    python benchmarks/recording.py --envs 1024 65536 --scenes W1 W2p8

Alternating runs of 1000 steps with a frame every ten steps, and without. On a CPU the figures are processor times
of all threads, which other programs affect less. Frames are copied to the host and not processed.

On a CPU the cost of storing them follows: experiments of ``--folder-envs`` environments of W1 with four outcomes
write results into a folder, with a series of 101 frames and without, alternating. These figures include all of
``Experiment.run`` except for pictures of the results, in processor time and in wall time.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import warp as wp
from benchmark_scenes import DT, SCENES
from result_file import default_path, write
from study import OUTCOMES, study

import warpcontact as wc
from warpcontact.benchmark.facts import facts
from warpcontact.benchmark.simulation import simulation
from warpcontact.experiment import execute
from warpcontact.stepping.recorder import Recorder
from warpcontact.system.resources import available_threads

STEPS, EVERY = 1000, 10
KINDS = {
    "poses": (),
    "energies": ("scene.kinetic_energy",),
    "forces": ("touch.normal_force", "touch.friction_force", "scene.kinetic_energy"),
    "distances": ("touch.gap", "touch.normal_force", "scene.kinetic_energy"),
}


def seconds(sim: wc.Simulation, run: Callable[[], None]) -> float:
    """Returns the processor time of a run from the initial state [s]; on a GPU, the wall time."""
    clock = time.process_time if sim.model.devices[0].is_cpu else time.perf_counter
    sim.reset()
    wp.synchronize()
    start = clock()
    run()
    wp.synchronize()
    return clock() - start


def record(sim: wc.Simulation, recorder: Recorder) -> None:
    """Takes all steps and records the frames again."""
    recorder.rewind()
    for _ in sim.advance(recorder, STEPS, EVERY, start=sim.time):
        pass


def measure(name: str, envs: int, device: str, repeats: int) -> dict[str, Any]:
    """Returns the time of steps [ns per environment and step], and the additional cost of each kind of frames."""
    sim = simulation(SCENES[name], envs, device)
    steps = lambda: sim.step(STEPS)  # noqa: E731
    seconds(sim, steps)
    figures: dict[str, Any] = {}
    alone: list[float] = []
    for kind, names in KINDS.items():
        recorder = Recorder(sim.model, names, STEPS // EVERY + 1, poses=True)
        recorder.start()
        frames = lambda own=recorder: record(sim, own)  # noqa: E731
        seconds(sim, frames)
        pairs = [(seconds(sim, steps), seconds(sim, frames)) for _ in range(repeats)]
        alone += [first for first, _ in pairs]
        extra = statistics.median(both - first for first, both in pairs)
        figures[kind] = {
            "share_of_steps": statistics.median(both / first - 1.0 for first, both in pairs),
            "ns_per_env_and_frame": 1e9 * extra / (envs * (STEPS // EVERY)),
        }
    return {"step_ns_per_env": 1e9 * statistics.median(alone) / (envs * STEPS), "frames": figures}


def spent(experiment: wc.Experiment, folder: Path) -> tuple[float, float]:
    """Returns processor time and wall time of a run into the new ``folder`` [s]."""
    with mock.patch.object(execute, "_show"):
        clocks = time.process_time(), time.perf_counter()
        experiment.run(folder, device="cpu", progress=False)
        return time.process_time() - clocks[0], time.perf_counter() - clocks[1]


def measure_folder(envs: int, repeats: int, parent: Path | None) -> dict[str, Any]:
    """Returns the cost of series in runs into folders in ``parent``, relative to runs without series."""
    plain = study(envs, OUTCOMES)
    recorded = plain | {"record": {"every": EVERY * DT, "series": True}, "output": {"usd_envs": 0}}
    without, with_series = wc.Experiment(plain), wc.Experiment(recorded)
    pairs = []
    # All folders are deleted at the end: deleting between runs would slow down the next writer.
    with tempfile.TemporaryDirectory(dir=parent) as folder:
        for number in range(-1, repeats):
            order = (without, with_series)[:: 1 if number % 2 else -1]
            both = {one: spent(one, Path(folder, f"{number}-{one is with_series}")) for one in order}
            if number >= 0:
                pairs.append((both[without], both[with_series]))
    figures = {}
    for kind, key in enumerate(("processor", "time")):
        first, second = zip(*((a[kind], b[kind]) for a, b in pairs), strict=True)
        shares = sorted(b / a - 1.0 for a, b in zip(first, second, strict=True))
        figures[key] = {
            "seconds_without_series": statistics.median(first),
            "seconds_with_series": statistics.median(second),
            "share": statistics.median(shares),
            "quartiles_of_share": np.percentile(shares, (25, 75)).tolist(),
        }
    return {"pairs": repeats, **figures}


def main() -> None:
    """Prints a table and optionally writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--envs", type=int, nargs="+", default=[1024])
    parser.add_argument("--scenes", nargs="+", choices=("W1", "W2p8", "W2p64"), default=["W1", "W2p8"])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--folder-envs", type=int, nargs="*", default=[16384])
    parser.add_argument("--folder-repeats", type=int, default=15)
    parser.add_argument("--folder", type=Path, help="parent of the run folders, on the disk to measure")
    parser.add_argument("--write", action="store_true", help="write the figures to benchmarks/results")
    parser.add_argument("--out", type=Path, help="write the figures to this file")
    options = parser.parse_args()
    about = facts(options.device, available_threads())
    found: dict[str, Any] = {}
    for name in options.scenes:
        for envs in options.envs:
            result = measure(name, envs, options.device, options.repeats)
            found.setdefault(name, {})[str(envs)] = result
            print(f"{name}, {envs} environments: step {result['step_ns_per_env']:.3g} ns per environment")
            for kind, costs in result["frames"].items():
                share, single = costs["share_of_steps"], costs["ns_per_env_and_frame"]
                print(f"  frames of {kind}: {100 * share:.3g} % of the steps, {single:.3g} ns each", flush=True)
    folders: dict[str, Any] = {}
    for envs in options.folder_envs if options.device == "cpu" else []:
        result = measure_folder(envs, options.folder_repeats, options.folder)
        folders[str(envs)] = result
        shares = (f"{100 * result[key]['share']:.3g} % of the {key}" for key in ("processor", "time"))
        print(f"W1, {envs} environments into a folder: series take {' and '.join(shares)} of a run", flush=True)
    if options.write or options.out:
        path = options.out or default_path("recording", options.device, about)
        write(path, {"facts": about, "recording": found, "folder": folders})


if __name__ == "__main__":
    main()
