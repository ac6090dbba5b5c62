"""Measures several GPUs of one host against the first one: the same environments on all or on one.

    python benchmarks/several_gpus.py --scenes W1 W2p64 --envs 262144 1048576

Both run alternately. The report also states whether their final states are equal.
"""

import argparse
import statistics
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from benchmark_scenes import SCENES, STEPS
from progress import Bar
from result_file import default_path, write

import warpcontact as wc
from warpcontact.benchmark.facts import facts, versions
from warpcontact.benchmark.simulation import run_seconds, simulation
from warpcontact.system.resources import available_threads

ONE, ALL = "cuda:0", "cuda"


def main() -> None:
    """Prints ratios and writes the figures."""
    options = arguments()
    wp.config.log_level = wp.LOG_ERROR
    warnings.simplefilter("ignore", wc.ContactWarning)  # the step length is that of the comparison with peers
    about = facts(ONE, available_threads()) | {"gpus": wp.get_cuda_device_count()}
    out = options.out or default_path("several-gpus", ONE, about)
    measured: list[dict[str, Any]] = []
    runs = 2 * (options.rounds + 1) * len(options.scenes) * len(options.envs)
    with Bar(total=runs, unit="run", disable=None) as bar:
        for scene in options.scenes:
            for envs in options.envs:
                bar.set_description(f"{scene} {envs}")
                measured.append(measure(scene, envs, options.rounds, bar))
    write(out, {"facts": about, "versions": versions(), "steps": STEPS, "measured": measured})
    for row in measured:
        same = "same states" if row["same"] else "DIFFERENT STATES"
        print(f"{row['scene']:6} {row['envs']:8}  {row['of_one_gpu']:.2f} × one GPU, {same}")
    print(f"written to {out}")


def measure(scene: str, envs: int, rounds: int, bar: Any) -> dict[str, Any]:
    """Returns environment-steps per second on one GPU and on all, medians over the rounds."""
    sims = {device: simulation(SCENES[scene], envs, device) for device in (ONE, ALL)}
    times: dict[str, list[float]] = {device: [] for device in sims}
    for number in range(rounds + 1):
        for device, sim in sims.items():
            seconds = run_seconds(sim, STEPS)
            if number:  # the first run captures the graphs
                times[device].append(seconds)
            bar.update()
    one, every = (envs * STEPS / statistics.median(times[device]) for device in (ONE, ALL))
    states = [sim.model["body.position"] for sim in sims.values()]
    return {
        "scene": scene,
        "envs": envs,
        "one_gpu_env_steps_per_s": one,
        "all_gpus_env_steps_per_s": every,
        "of_one_gpu": every / one,
        "same": bool(np.array_equal(*states)),
    }


def arguments() -> argparse.Namespace:
    """Returns the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=["W1", "W2p8", "W2p64"])
    parser.add_argument("--envs", type=int, nargs="+", default=[262144, 1048576])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    if wp.get_cuda_device_count() < 2:
        parser.error(f"at least two GPUs are needed, got {wp.get_cuda_device_count()}")
    return options


if __name__ == "__main__":
    main()
