"""Measures growth of the step time with environments, points, triangles and threads.

    python benchmarks/scaling.py                                    # on the CPU, all cores
    python benchmarks/scaling.py --device cuda:0 --most-envs 262144
    python benchmarks/scaling.py --series threads --out threads.json

A run starts at rest and includes contact, as in ``benchmark_scenes.py``. All cases of a series are prepared first and then
run alternately, so that other load affects all of them. Lower bounds are measured as well: a bare closest-point
query of every point and a copy of the state, and for threads the same number of single-threaded processes. The
plot needs Matplotlib; ``scaling_picture.py`` can draw it later.
"""

import argparse
import statistics
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import warp as wp
from fits import exponent, per_decade, upper_exponent
from progress import Bar
from result_file import default_path, write
from scaling_cases import MOST_ENVS_ON_CPU, MOST_ENVS_ON_CUDA, SERIES, Case, Sizes, cases
from scaling_processes import Processes

import warpcontact as wc
from warpcontact.benchmark.facts import facts, versions
from warpcontact.benchmark.limits import Limits, limits
from warpcontact.benchmark.scenes import STEPS
from warpcontact.benchmark.simulation import run_seconds, seconds_of_runs
from warpcontact.system.resources import available_threads


def main() -> None:
    """Prints the fits, and writes figures and plot."""
    options = arguments()
    wp.config.log_level = wp.LOG_ERROR
    warnings.simplefilter("ignore", wc.ContactWarning)  # the step length is that of the comparison with peers
    about = facts(options.device, options.threads)
    out = options.out or default_path("scaling", options.device, about)
    sizes = Sizes(options.device, options.most_envs, options.most_points, options.most_triangles, options.threads)
    wanted = {name: cases(name, sizes) for name in options.series}
    measured: list[dict[str, Any]] = []
    with Bar(total=(options.rounds + 1) * sum(map(len, wanted.values())), unit="run", disable=None) as bar:
        for some in wanted.values():
            measured += measure(some, options, bar)
            report = {
                "facts": about,
                "versions": versions(),
                "steps": options.steps,
                "rounds": options.rounds,
                "fits": fits(measured),
                "measured": measured,
            }
            write(out, report)
    print(f"{about['device']}, {about['cores']} cores, {about['date']}")
    print("\n".join(lines(fits(measured))))
    print(f"written to {out}")
    picture = options.plot or out.with_suffix(".svg")
    try:
        from scaling_picture import draw
    except ModuleNotFoundError as error:
        print(
            f"no picture: {error.name} is not installed; elsewhere run python benchmarks/scaling_picture.py {out}"
        )
    else:
        draw(out, picture)
        print(f"picture: {picture}")


@dataclass
class Ready:
    """Case that is ready to run.

    Attributes:
        case: The case.
        sim: Its simulation.
        least: Lower bounds of a step.
        apart: The case in processes, if these are measured.
        times: Time of a run in each round [s].
        process_times: The same for the processes [s].
    """

    case: Case
    sim: wc.Simulation
    least: Limits
    apart: Processes | None
    times: list[float] = field(default_factory=list)
    process_times: list[float] = field(default_factory=list)

    def figures(self, steps: int) -> dict[str, Any]:
        """Returns the figures of runs of ``steps`` steps."""
        case = self.case

        def each(times: list[float], envs: int) -> list[float]:
            return [1e9 * took / steps / envs for took in times]

        costs = each(self.times, case.envs)
        found = {
            "series": case.series,
            "line": case.line,
            "value": case.value,
            "envs": case.envs,
            "points": self.sim.model.contact_count,
            "triangles": len(case.scene.surface.faces),
            "threads": case.threads,
            "ns_per_env_step": statistics.median(costs),
            "lowest": min(costs),
            "highest": max(costs),
            "ns_bare_query": 1e9 * self.least.query,
            "ns_copy_of_state": 1e9 * self.least.copy,
            "frozen": len(self.sim.model.health().frozen),
        }
        if self.apart:
            found["ns_in_processes"] = statistics.median(each(self.process_times, self.apart.envs))
        return found


def measure(some: list[Case], options: argparse.Namespace, bar: Any) -> list[dict[str, Any]]:
    """Returns the figures of the cases of one series, which run alternately."""
    ready = []
    for case in some:
        bar.set_description(f"{case.series}: {case.line}, {case.value}")
        sim = case.simulation(options.device)
        run_seconds(sim, options.steps)  # compiles, and captures the graphs that later runs replay
        several = case.series == "threads" and 1 < case.threads == options.threads
        apart = Processes(case, options.steps) if several else None
        ready.append(Ready(case, sim, limits(sim.model, case.scene, case.threads), apart))
        bar.update()
    for _ in range(options.rounds):
        for one in ready:
            bar.set_description(f"{one.case.series}: {one.case.line}, {one.case.value}")
            one.times.append(seconds_of_runs(one.sim, options.steps, options.at_least))
            if one.apart:
                one.process_times.append(one.apart.seconds_of_runs(options.at_least))
            bar.update()
    for one in ready:
        if one.apart:
            one.apart.close()
    return [one.figures(options.steps) for one in ready]


def fits(measured: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Returns the growth of the step time along every line of every series with at least two values.

    ``exponent`` k is that of cost ∝ valueᵏ, with the time of a step of all environments as cost.
    ``upper_exponent`` is that of the upper half of the values. For triangles there are also the increase of an
    environment-step per decade [ns] and the R² of a logarithm. For threads there is the speedup over one thread,
    and that of as many processes.
    """
    found = []
    for series, line in dict.fromkeys((entry["series"], entry["line"]) for entry in measured):
        own = [entry for entry in measured if (entry["series"], entry["line"]) == (series, line)]
        if len(own) < 2:
            continue
        values = [entry["value"] for entry in own]
        each = [entry["ns_per_env_step"] for entry in own]
        fit: dict[str, Any] = {"series": series, "line": line}
        if series == "threads":
            one = dict(zip(values, each, strict=True))[1]
            fit["times_one_thread"] = {str(value): one / cost for value, cost in zip(values, each, strict=True)}
            apart = [entry["ns_in_processes"] for entry in own if "ns_in_processes" in entry]
            if apart:
                fit["times_one_thread_in_processes"] = one / apart[-1]
        else:
            costs = [cost * entry["envs"] for cost, entry in zip(each, own, strict=True)]
            fit["exponent"] = exponent(values, costs)
            fit["upper_exponent"] = upper_exponent(values, costs)
        if series == "triangles":
            fit["ns_per_decade"], fit["explained_by_logarithm"] = per_decade(values, each)
            queries = [entry["ns_bare_query"] for entry in own]
            fit["ns_per_decade_of_bare_query"] = per_decade(values, queries)[0]
        found.append(fit)
    return found


def lines(found: list[dict[str, Any]]) -> list[str]:
    """Returns the fits as lines of text."""
    text = []
    for fit in found:
        head = f"{fit['series']:13} {fit['line']:17}"
        if "times_one_thread" in fit:
            rates = ", ".join(f"{value}: {ratio:.2f}" for value, ratio in fit["times_one_thread"].items())
            if "times_one_thread_in_processes" in fit:
                rates += f"; same number of processes: {fit['times_one_thread_in_processes']:.2f}"
            text.append(f"{head} speedup over one thread: {rates}")
            continue
        tail = f"cost ∝ n^{fit['exponent']:.2f}, in the upper half n^{fit['upper_exponent']:.2f}"
        if "ns_per_decade" in fit:
            tail += f"; {fit['ns_per_decade']:+.3g} ns per decade, R² {fit['explained_by_logarithm']:.2f}"
            tail += f"; bare query {fit['ns_per_decade_of_bare_query']:+.3g} ns per decade"
        text.append(f"{head} {tail}")
    return text


def arguments() -> argparse.Namespace:
    """Returns the command line with defaults for the device."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--series", nargs="+", choices=SERIES, default=list(SERIES))
    parser.add_argument("--most-envs", type=int, help=f"default: {MOST_ENVS_ON_CPU}, on a GPU {MOST_ENVS_ON_CUDA}")
    parser.add_argument("--most-points", type=int, default=512)
    parser.add_argument("--most-triangles", type=int, default=10**6)
    parser.add_argument("--threads", type=int, default=available_threads(), help="maximum number of CPU threads")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument(
        "--at-least", type=float, default=0.2, help="minimum duration of a measurement, in seconds"
    )
    parser.add_argument(
        "--out", type=Path, help="file of figures (default: benchmarks/results/scaling-DEVICE.json)"
    )
    parser.add_argument("--plot", type=Path, help="plot, .svg or .png (default: next to the figures)")
    options = parser.parse_args()
    if options.most_envs is None:
        options.most_envs = MOST_ENVS_ON_CUDA if options.device.startswith("cuda") else MOST_ENVS_ON_CPU
    for name in ("most_envs", "most_points", "most_triangles", "threads", "steps", "rounds"):
        if getattr(options, name) < 1:
            parser.error(f"--{name.replace('_', '-')} must be at least 1, got {getattr(options, name)}")
    return options


if __name__ == "__main__":
    main()
