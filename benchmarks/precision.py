"""Measures the cost of float64, latched contact and swept contact: ratios of step times in alternating runs.

    python benchmarks/precision.py --out benchmarks/results/precision-cpu.json

The scenes are those of ``benchmark_scenes.py``. Each round runs the reference and then the variant. The ratio is taken per
round, and the report has its median and range over the rounds, so that other load on the machine cancels.
"""

import argparse
import json
import os
import statistics
import time
from pathlib import Path

import warp as wp
from benchmark_scenes import SCENES

import warpcontact as wc
from warpcontact.benchmark.facts import facts
from warpcontact.benchmark.simulation import simulation

#: Comparisons: name, options of the reference, options of the variant.
COMPARISONS = {
    "float64 against float32": ({}, {"precision": "float64"}),
    "latched against literal": ({}, {"entry": "latched"}),
    "swept against not": ({}, {"swept": True}),
    "swept in 16 parts against not": ({}, {"swept": True, "crossing_substeps": 16}),
}


def seconds(sim: wc.Simulation, device: str, steps: int) -> float:
    """Returns the time of ``steps`` steps from the initial state [s]; on a CPU the processor time."""
    clock = time.process_time if device == "cpu" else time.perf_counter
    sim.reset()
    wp.synchronize_device(device)
    start = clock()
    sim.step(steps)
    wp.synchronize_device(device)
    return clock() - start


def compare(
    scene: str, envs: int, device: str, steps: int, rounds: int, pair: tuple[dict, dict]
) -> dict[str, float]:
    """Returns the ratio of step times of the variant to the reference, and the rate of the reference."""
    sims = [simulation(SCENES[scene], envs, device, **options) for options in pair]
    for sim in sims:
        sim.step(2)
    times = [[seconds(sim, device, steps) for sim in sims] for _ in range(rounds)]
    ratios = [other / reference for reference, other in times]
    return {
        "ratio": round(statistics.median(ratios), 3),
        "lowest": round(min(ratios), 3),
        "highest": round(max(ratios), 3),
        "reference_env_steps_per_s": round(envs * steps / statistics.median(first for first, _ in times)),
    }


def main() -> None:
    """Prints a table and writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--envs", type=int, default=128)
    parser.add_argument("--scenes", nargs="+", default=["W1", "W2p8"])
    parser.add_argument("--steps", type=int, default=600)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    results: dict[str, dict[str, dict[str, float]]] = {}
    for name, pair in COMPARISONS.items():
        for scene in options.scenes:
            figures = compare(scene, options.envs, options.device, options.steps, options.rounds, pair)
            results.setdefault(name, {})[scene] = figures
            print(f"{name:32} {scene:6} {figures['ratio']:6.2f} times the time", flush=True)
    if options.out:
        about = {
            **facts(options.device, os.cpu_count() or 1),
            "warp": wp.__version__,
            "warpcontact": wc.__version__,
            "environments": options.envs,
        }
        report = {"facts": about, "steps": options.steps, "rounds": options.rounds, "time_ratio": results}
        options.out.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
