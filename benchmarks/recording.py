"""What frames cost beside the steps between them.

    python benchmarks/recording.py --envs 1024 65536 --works W1 W2p8

Runs of 1000 steps with a frame every ten of them, and without, in turn; the figures are of processor time, which
other programs disturb less, and of all threads. Frames are copied on the host and no more is done with them.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import warp as wp
from result_file import default_path, write
from works import WORKS

import warpcontact as wc
from warpcontact.benchmark.facts import facts
from warpcontact.benchmark.simulation import simulation
from warpcontact.crew import available_threads
from warpcontact.recorder import Recorder

STEPS, EVERY = 1000, 10
KINDS = {
    "poses": (),
    "energies": ("scene.kinetic_energy",),
    "forces": ("touch.normal_force", "touch.friction_force", "scene.kinetic_energy"),
    "distances": ("touch.gap", "touch.normal_force", "scene.kinetic_energy"),
}


def seconds(sim: wc.Simulation, run: Callable[[], None]) -> float:
    """Returns what a run from the start takes of the processor [s]; of a GPU, the time until it is done."""
    clock = time.process_time if sim.model.devices[0].is_cpu else time.perf_counter
    sim.reset()
    wp.synchronize()
    start = clock()
    run()
    wp.synchronize()
    return clock() - start


def record(sim: wc.Simulation, recorder: Recorder) -> None:
    """Takes all steps, and the frames anew."""
    recorder.rewind()
    for _ in sim.advance(recorder, STEPS, EVERY, start=sim.time):
        pass


def measure(name: str, envs: int, device: str, repeats: int) -> dict[str, Any]:
    """Returns steps alone [ns per environment and step], and what each kind of frames costs beside them."""
    sim = simulation(WORKS[name], envs, device)
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


def main() -> None:
    """Prints a table and, if asked to, writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--envs", type=int, nargs="+", default=[1024])
    parser.add_argument("--works", nargs="+", choices=("W1", "W2p8", "W2p64"), default=["W1", "W2p8"])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--write", action="store_true", help="keep the figures in benchmarks/results")
    parser.add_argument("--out", type=Path, help="or in this file")
    options = parser.parse_args()
    about = facts(options.device, available_threads())
    found: dict[str, Any] = {}
    for name in options.works:
        for envs in options.envs:
            result = measure(name, envs, options.device, options.repeats)
            found.setdefault(name, {})[str(envs)] = result
            print(f"{name}, {envs} environments: a step {result['step_ns_per_env']:.3g} ns per environment")
            for kind, costs in result["frames"].items():
                share, single = costs["share_of_steps"], costs["ns_per_env_and_frame"]
                print(f"  frames of {kind}: {100 * share:.3g} % of the steps, {single:.3g} ns each", flush=True)
    if options.write or options.out:
        write(
            options.out or default_path("recording", options.device, about), {"facts": about, "recording": found}
        )


if __name__ == "__main__":
    main()
