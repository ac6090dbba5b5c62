"""Cost of an environment-step on a GPU as a ratio to a bare closest-point query of the same points.

    python benchmarks/gpu_ratios.py             # measures and prints
    python benchmarks/gpu_ratios.py --check     # exit code 1 if a ratio is more than 5 % above the stored one
    python benchmarks/gpu_ratios.py --write     # stores the ratios in the file of the device in results/

A run is 1000 steps from the start of a scene, so all runs pass through the same states. The queries are those of
``kernels/narrowphase/bare_query.py`` for all points at the end of a run. In each round every scene is measured
once: queries, a run, the same queries. The ratio divides the run by the mean of both, so a change of the clock
rate cancels. The median of the rounds counts. No other work may run on the GPU meanwhile.
"""

import argparse
import statistics
import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import warp as wp
from benchmark_scenes import SCENES, STEPS
from result_file import RATIOS, default_path, stored, write
from warpcontact.kernels.narrowphase.bare_query import kernel as bare_query

import warpcontact as wc
from warpcontact.benchmark.facts import facts, versions
from warpcontact.benchmark.limits import query_points
from warpcontact.benchmark.simulation import run_seconds, seconds_of_runs, simulation
from warpcontact.system.compilation import compile_as_launched
from warpcontact.system.resources import available_threads

#: Environments of each scene: with as many, the comparison of engines has its best figures on an H200.
ENVS = 262_144
#: Relative increase of a ratio above which the check fails; as large a decrease is reported.
TOLERANCE = 0.05
#: Shortest time of the runs, and of the queries before and after them, in a round [s].
RUN_SECONDS, QUERY_SECONDS = 0.25, 0.08
#: Entries of stored figures without which ratios cannot be compared.
CONDITIONS = ("envs", "steps")


def main() -> int:
    """Prints a table and returns the exit code."""
    options = arguments()
    wp.config.log_level = wp.LOG_ERROR
    warnings.simplefilter("ignore", wc.ContactWarning)  # the step length is that of the comparison with peers
    about = facts(options.device, available_threads())
    path = options.file or default_path("", options.device, about)
    measured = {
        "facts": about,
        "versions": versions(),
        "envs": options.envs,
        "steps": options.steps,
        "rounds": options.rounds,
        "ratios": measure(options),
    }
    print(f"{about['device']}, driver {about.get('driver', 'unknown')}, {about['date']}")
    known = stored(path).get(RATIOS)
    code = 0
    if options.check:
        lines, code = check(measured, known)
    else:
        lines = [row(name, own) for name, own in measured["ratios"].items()]
    print("\n".join(lines))
    if options.write:
        write(path, stored(path) | {RATIOS: measured})
        print(f"written to {path}")
    return code


@dataclass
class Scene:
    """A benchmark scene on the device, and the times of its rounds.

    Attributes:
        name: Name of the scene.
        sim: Its simulation.
        queries: Bare queries of all its points.
        steps: Steps of a run.
        run_s: Time of a run in each round [s].
        query_s: Time of the queries of all points in each round [s].
    """

    name: str
    sim: wc.Simulation
    queries: "Queries"
    steps: int
    run_s: list[float] = field(default_factory=list)
    query_s: list[float] = field(default_factory=list)

    def measure(self) -> None:
        """Appends the times of one round."""
        before = self.queries.seconds()
        self.run_s.append(seconds_of_runs(self.sim, self.steps, RUN_SECONDS))
        self.query_s.append(0.5 * (before + self.queries.seconds()))

    def figures(self) -> dict[str, float]:
        """Returns the median of the ratios, their range, and the times that they are made of."""
        steps = [run / self.steps for run in self.run_s]
        ratios = [step / query for step, query in zip(steps, self.query_s, strict=True)]
        envs = self.sim.model.envs
        return {
            "ratio": statistics.median(ratios),
            "lowest": min(ratios),
            "highest": max(ratios),
            "ns_per_env_step": 1e9 * statistics.median(steps) / envs,
            "ns_bare_query": 1e9 * statistics.median(self.query_s) / envs,
        }


class Queries:
    """One bare closest-point query for each point of a model at its current state.

    Args:
        sim: The simulation.
        name: Name of its benchmark scene.
    """

    def __init__(self, sim: wc.Simulation, name: str) -> None:
        self._device = sim.model.devices[0]
        kernel = bare_query()
        compile_as_launched(kernel, self._device)
        surface = SCENES[name].surface
        self._mesh = wp.Mesh(
            points=wp.array(surface.vertices, dtype=wp.vec3f, device=self._device),
            indices=wp.array(surface.faces.ravel(), dtype=wp.int32, device=self._device),
            bvh_constructor="sah",
        )
        places = query_points(sim.model.parts[0], SCENES[name]).reshape(-1, 3)
        self._points = wp.array(places, dtype=wp.vec3f, device=self._device)
        self._found = wp.zeros(len(places), dtype=wp.int32, device=self._device)
        inputs = [self._mesh.id, self._points, self._found]
        self._launch = wp.launch(kernel, len(places), inputs, device=self._device, record_cmd=True)

    def seconds(self) -> float:
        """Returns the time of all queries [s], the mean of at least ``QUERY_SECONDS``."""
        count, took = 1, self._seconds_of(1)
        while took < QUERY_SECONDS:
            count = max(2 * count, int(1.2 * count * QUERY_SECONDS / took))
            took = self._seconds_of(count)
        return took / count

    def _seconds_of(self, count: int) -> float:
        wp.synchronize_device(self._device)
        start = time.perf_counter()
        for _ in range(count):
            self._launch.launch()
        wp.synchronize_device(self._device)
        return time.perf_counter() - start


def measure(options: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Returns the figures of the scenes by name, and prints the progress."""
    scenes = []
    for name in options.scenes:
        start = time.perf_counter()
        sim = simulation(SCENES[name], options.envs, options.device)
        sim.warned_at_start = True  # the warnings of the first step need kernels of their own
        run_seconds(sim, options.steps)
        scenes.append(Scene(name, sim, Queries(sim, name), options.steps))
        print(f"{name}: built, compiled and run once in {time.perf_counter() - start:.1f} s", flush=True)
    for number in range(options.rounds + 1):
        start = time.perf_counter()
        for scene in scenes:
            scene.measure()
        print(f"round {number} of {options.rounds}: {time.perf_counter() - start:.1f} s", flush=True)
    found = {}
    for scene in scenes:
        if frozen := len(scene.sim.model.health().frozen):
            raise RuntimeError(f"{scene.name}: {frozen} environments failed, so their steps take no time")
        # Round 0 raises the clock rate of the GPU.
        del scene.run_s[0], scene.query_s[0]
        found[scene.name] = scene.figures()
    return found


def check(measured: dict[str, Any], known: dict[str, Any] | None) -> tuple[list[str], int]:
    """Compares ratios with stored ones.

    Args:
        measured: Figures of this run: ``facts``, ``versions``, ``envs``, ``steps`` and ``ratios`` by scene.
        known: Stored figures of the same form. ``None``: there are none.

    Returns:
        The lines of a table with remarks, and the exit code: 1 if a ratio is more than ``TOLERANCE`` above the
        stored one.
    """
    ratios = measured["ratios"]
    device = measured["facts"]["device"]
    lines = [row(name, own, (known or {}).get("ratios", {}).get(name)) for name, own in ratios.items()]
    if known is None or known["facts"]["device"] != device:
        return [*lines, f"There are no stored ratios for {device}; store these with --write."], 0
    for condition in CONDITIONS:
        if known[condition] != measured[condition]:
            now = f"{measured[condition]}, stored for {known[condition]}"
            return [*lines, f"The ratios cannot be compared: they are for {condition} = {now}."], 1
    failed = False
    for name, own in ratios.items():
        if name not in known["ratios"]:
            lines.append(f"{name} has no stored ratio; store it with --write.")
            continue
        change = own["ratio"] / known["ratios"][name]["ratio"] - 1.0
        if change > TOLERANCE:
            failed = True
            lines.append(f"{name} is {change:.1%} slower than stored; at most {TOLERANCE:.0%} is allowed.")
        elif change < -TOLERANCE:
            lines.append(f"{name} is {-change:.1%} faster than stored: update the file with --write.")
    if failed:
        lines += differences(measured, known)
    return lines, int(failed)


def differences(measured: dict[str, Any], known: dict[str, Any]) -> list[str]:
    """Returns a line for each version and driver that differs from the stored one."""
    now, then = ({"driver": figures["facts"].get("driver")} | figures["versions"] for figures in (measured, known))
    return [
        f"{name}: {now.get(name)} now, {then.get(name)} when stored"
        for name in sorted(now.keys() | then.keys())
        if now.get(name) != then.get(name)
    ]


def row(name: str, own: dict[str, float], known: dict[str, float] | None = None) -> str:
    """Returns a line of the table: the ratio, its range and times, and the stored ratio if there is one."""
    text = (
        f"{name:6} {own['ratio']:8.4f} of a bare query ({own['lowest']:.4f} … {own['highest']:.4f}); "
        f"step {own['ns_per_env_step']:.4g} ns, query {own['ns_bare_query']:.4g} ns per environment"
    )
    if known:
        text += f"; stored {known['ratio']:.4f}, change {own['ratio'] / known['ratio'] - 1.0:+.1%}"
    return text


def arguments() -> argparse.Namespace:
    """Returns the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES), help="benchmark scenes")
    parser.add_argument("--envs", type=int, default=ENVS, help=f"environments of each scene, default {ENVS}")
    parser.add_argument("--steps", type=int, default=STEPS, help="steps of a run")
    parser.add_argument("--rounds", type=int, default=9, help="rounds that count, after one that does not")
    parser.add_argument("--check", action="store_true", help="compare with the stored ratios")
    parser.add_argument("--write", action="store_true", help="store the ratios")
    parser.add_argument("--file", type=Path, help="file of stored ratios; default: that of the device in results/")
    options = parser.parse_args()
    if options.check and options.write:
        parser.error("--check and --write exclude each other")
    for name in ("envs", "steps", "rounds"):
        if getattr(options, name) < 1:
            parser.error(f"--{name} must be at least 1, got {getattr(options, name)}")
    return options


if __name__ == "__main__":
    raise SystemExit(main())
