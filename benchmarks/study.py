"""Measures a study of a million environments with one command: memory against its plan, time, and disk space.

    python benchmarks/study.py --envs 1000000 --device cpu

W1, a sphere on a terrain, 1000 steps, with outcomes and without series. Each run is a separate process.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import warp as wp
from benchmark_scenes import DAMPING, DT, FRICTION, SCENES, STEPS, STIFFNESS
from result_file import default_path, write

import warpcontact as wc
from warpcontact.benchmark.facts import facts, versions
from warpcontact.system.resources import available_threads

OUTCOMES = {
    "peak": {"type": "Max", "of": "touch.normal_force"},
    "impulse": {"type": "Integral", "of": "touch.normal_force"},
    "first": {"type": "FirstTime", "of": "touch.normal_force", "above": 0.0},
    "end": {"type": "Final", "of": "ball.position"},
}


def study(envs: int, outcomes: dict[str, Any]) -> dict[str, Any]:
    """Returns the experiment."""
    scene = SCENES["W1"]
    terrain = {"shape": "sinusoidal_terrain", "size": [10, 10], "cells": [100, 100]}
    law = {"type": "KelvinVoigt", "stiffness": STIFFNESS, "damping": DAMPING}
    return {
        "name": "study",
        "envs": envs,
        "duration": STEPS * DT,
        "dt": DT,
        "surface": [{"name": "ground", "mesh": terrain | {"amplitude": 0.2, "wavelength": 2.5}}],
        "body": [{"name": "ball", "mass": scene.mass, "inertia": [scene.inertia] * 3, "position": [0, 0, 1]}],
        "point": [{"name": "centre", "body": "ball", "position": [0, 0, 0]}],
        "material": [{"name": "rubber", "law": law, "friction": {"type": "Tanh", "mu": FRICTION}}],
        "contact": [
            {
                "name": "touch",
                "points": "centre",
                "surface": "ground",
                "material": "rubber",
                "radius": scene.radius,
            }
        ],
        "variation": {"ball.position": {"uniform": [[-4, -4, 0.7], [4, 4, 0.7]]}},
        "outcome": outcomes,
        "record": {"series": False},
    }


def main() -> None:
    """Prints a table and writes the figures; in a child process, runs one study."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--envs", type=int, default=1_000_000)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--study", help=argparse.SUPPRESS)
    parser.add_argument("--folder", help=argparse.SUPPRESS)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    outcomes_of = {"without outcomes": {}, "four outcomes": OUTCOMES}
    if options.study:
        experiment = wc.Experiment(study(options.envs, outcomes_of[options.study]))
        experiment.run(options.folder, device=options.device)
        # Read in the child: the peak memory that the parent gets for a child includes its own.
        peak = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
        Path(options.folder).with_name("peak").write_text(peak[1] if peak else "")
        return
    results = {}
    for name, outcomes in outcomes_of.items():
        folder = tempfile.mkdtemp()
        plan = wc.Experiment(study(options.envs, outcomes)).plan(device=options.device)
        words = ["--device", options.device, "--envs", str(options.envs), "--study", name]
        start = time.perf_counter()
        subprocess.run([sys.executable, __file__, *words, "--folder", f"{folder}/run"], check=True)
        took = time.perf_counter() - start
        summary = json.loads(Path(folder, "run", "run.json").read_text())
        results[name] = {
            "seconds": took,
            "stepping_seconds": summary["wall_time"],
            "env_steps_per_s": summary["env_steps_per_second"],
            "peak_host_bytes": 1024 * int(Path(folder, "peak").read_text()),
            "planned_host_bytes": plan.peak,
            "planned_of_study_bytes": plan.footprint.host_bytes,
            "planned_device_bytes": plan.footprint.device_bytes,
            "disk_bytes": sum(path.stat().st_size for path in Path(folder).rglob("*") if path.is_file()),
        }
        shutil.rmtree(folder)
        own = results[name]
        peak, planned = (own[f"{key}_host_bytes"] / 2**30 for key in ("peak", "planned"))
        print(
            f"{name:18} {took:7.1f} s, {own['env_steps_per_s']:.3g} environment-steps per second, "
            f"peak host memory {peak:.2f} GiB, planned {planned:.2f} GiB",
            flush=True,
        )
    threads = available_threads() if options.device == "cpu" else 1
    about = {**facts(options.device, threads), **versions(), "envs": options.envs, "steps": STEPS}
    write(options.out or default_path("study", options.device, about), {"about": about, "results": results})


if __name__ == "__main__":
    main()
