"""Measures catenary solves per second, with and without a warm start.

    python benchmarks/catenary.py --out benchmarks/results/catenary-cpu.json

Each environment has one catenary from the world to a body. The kinds are those of a mooring: slack, partly
grounded, and taut. ``warm``: the end moves by 0.01 m per evaluation, and solutions are accepted, as in a
simulation. ``cold``: the stored solution is cleared before each evaluation. Only the stage of the catenaries is
timed, on one CPU core.
"""

import argparse
import os
import statistics
import time
from pathlib import Path

import numpy as np
import warp as wp
from result_file import default_path, write

import warpcontact as wc
from warpcontact.benchmark.facts import facts
from warpcontact.forces.execution_plan import ExecutionPlan, StepLength

LINE = {"length": 100.0, "mass_per_length": 20.0, "axial_stiffness": 1e7}
#: Ranges of the horizontal and vertical distance of the ends, and height of the floor [m].
KINDS = {
    "slack": ((50.0, 70.0), (20.0, 40.0), None),
    "on the floor": ((70.0, 80.0), (20.0, 40.0), 0.0),
    "taut": ((95.0, 98.0), (30.0, 35.0), None),
}
MOVE = 0.01  # m from one evaluation to the next


def model_of(kind: str, envs: int, device: str, precision: str) -> tuple[wc.Model, np.ndarray]:
    """Returns a model with catenaries of one kind, and the positions of their upper ends."""
    across, upwards, floor = KINDS[kind]
    scene = wc.Scene()
    body = scene.add_body(1.0, (1.0, 1.0, 1.0), name="body")
    ends = scene.add_point(None, (0.0, 0.0, 0.0)), scene.add_point(body, (0.0, 0.0, 0.0))
    scene.add_catenary(*ends, **LINE, floor=floor, name="line")
    model = scene.build(envs, device, precision)
    rng = np.random.default_rng(0)
    places = np.stack([rng.uniform(*across, envs), np.zeros(envs), rng.uniform(*upwards, envs)], axis=1)
    model["body.position"] = places
    return model, places


def seconds(model: wc.Model, places: np.ndarray, moves: int, *, warm: bool) -> tuple[float, float]:
    """Returns the time of a solve [s], and its mean number of evaluations."""
    device = model.device
    clock = time.process_time if device.is_cpu else time.perf_counter
    (lines,) = model.force_elements
    instant = StepLength(model.zero_step, model.zero_step, model.zero_step)
    plan = ExecutionPlan(model, model.envs, uses_cache=False, ordered_sum=True)
    solve = lines.force_launches(plan, model.arrays.state, instant.real, model.arrays.status)
    accept = lines.accept_launches(plan, instant, model.arrays.state)
    everywhere = wp.ones(model.envs, dtype=wp.bool, device=device)
    model.reset()
    for launch in solve + accept:
        launch.launch()
    taken, used = 0.0, []
    for move in range(1, moves + 1):
        model.state.body_position.assign(places[:, None] + np.array([MOVE * move, 0.0, 0.0]))
        if not warm:
            lines.reset_state(everywhere)
        wp.synchronize_device(device)
        start = clock()
        for launch in solve:
            launch.launch()
        wp.synchronize_device(device)
        taken += clock() - start
        for launch in accept:
            launch.launch()
        used.append(lines.results.iterations.numpy().mean())
    if lines.failures()["line"].any():
        raise RuntimeError("a catenary was not solved")
    return taken / (moves * model.envs), float(np.mean(used))


def main() -> None:
    """Prints a table and writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--envs", type=int, default=8192)
    parser.add_argument("--moves", type=int, default=50)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--precision", nargs="+", default=["float32", "float64"])
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    results = []
    for precision in options.precision:
        for kind in KINDS:
            model, places = model_of(kind, options.envs, options.device, precision)
            for warm in (True, False):
                rounds = [
                    seconds(model, places, options.moves, warm=warm) for _ in range(options.rounds + 1)
                ]  # the first loads
                each = [taken for taken, _ in rounds[1:]]
                figures = {
                    "precision": precision,
                    "line": kind,
                    "start": "warm" if warm else "cold",
                    "solves_per_s": round(1.0 / statistics.median(each)),
                    "lowest": round(1.0 / max(each)),
                    "highest": round(1.0 / min(each)),
                    "evaluations": rounds[-1][1],
                }
                results.append(figures)
                print(
                    f"{precision:8} {kind:14} {figures['start']:5} {figures['solves_per_s']:12,} solves/s, "
                    f"{figures['evaluations']:.1f} evaluations",
                    flush=True,
                )
    about = {**facts(options.device, os.cpu_count() or 1), "envs": options.envs, "cores_used": 1}
    write(options.out or default_path("catenary", options.device, about), {"about": about, "results": results})


if __name__ == "__main__":
    main()
