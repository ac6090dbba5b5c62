"""Where the time of a step goes, and how far it is from what the device can do.

    python benchmarks/stages.py --device cuda:0 --envs 65536 --works W1 W2p64 --out stages.json

Each stage is repeated alone on the state that a run has at several times, so the figures tell what a stage costs
there. Beside them: one closest-point query of Warp for every point and no more (the query that a step without
memory of distances cannot do without), and a copy of the state on the device.
"""

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import warp as wp
from engines.warpcontact import WORKS as KNOWN
from result_file import write
from works import WORKS

import warpcontact as wc
from warpcontact.arrays import allocate
from warpcontact.benchmark.facts import facts
from warpcontact.benchmark.limits import limits
from warpcontact.benchmark.simulation import simulation
from warpcontact.crew import available_threads
from warpcontact.schedule import Span, accept_stages, step_stages

LAUNCHES = 20


def nanoseconds(launches: list[wp.Launch], envs: int, device: str) -> float:
    """Returns what the launches cost per environment [ns]: the least of several times, captured."""
    with wp.ScopedCapture(device=device) as capture:
        for _ in range(LAUNCHES):
            for launch in launches:
                launch.launch()
    times = []
    for _ in range(15):
        wp.synchronize_device(device)
        start = time.perf_counter()
        wp.capture_launch(capture.graph)
        wp.synchronize_device(device)
        times.append(time.perf_counter() - start)
    return 1e9 * min(times) / LAUNCHES / envs


def stages(sim: wc.Simulation, envs: int) -> dict[str, float]:
    """Returns the cost of every stage at the present state [ns per environment]."""
    model = sim.model
    device = str(model.device)
    span = Span(model, 0, envs, cached=sim.distance_cache, ordered=sim.deterministic or device == "cpu")
    own, other = model.arrays.state, allocate(model.types.State, (envs, model.body_count), model.device)
    launches = step_stages(span, sim.integrator, sim.times.whole, own, other, None)
    launches += accept_stages(span, sim.times.whole, own, other)
    by_name: dict[str, list[wp.Launch]] = {}
    for launch in launches:
        by_name.setdefault(launch.kernel.key.split("__")[-1], []).append(launch)
    travel = by_name.get("add_travel", [])
    costs = {}
    for name, own in by_name.items():
        # On a GPU the travel begins the list of searches, and has to go before them.
        ahead = travel if name == "closest_point" else []
        costs[name] = nanoseconds(ahead + own, envs, device) - (nanoseconds(ahead, envs, device) if ahead else 0.0)
    return costs


def measure(name: str, envs: int, device: str, at: list[int], repeats: int) -> dict[str, Any]:
    """Returns the rate of a work, and the cost of its stages after some numbers of steps."""
    work = WORKS[name]
    sim = simulation(work, envs, device)
    sim.step(100)
    rates = []
    for _ in range(repeats):
        sim.reset()
        wp.synchronize_device(device)
        start = time.perf_counter()
        sim.step(1000)
        wp.synchronize_device(device)
        rates.append(1000 * envs / (time.perf_counter() - start))
    sim.reset()
    done, costs = 0, {}
    for steps in at:
        sim.step(steps - done)
        done = steps
        least = limits(sim.model, work, threads=1)
        costs[str(steps)] = stages(sim, envs) | {
            "bare query": 1e9 * least.query,
            "copy of state": 1e9 * least.copy,
        }
    return {"env_steps_per_s": statistics.median(rates), "ns_per_env_after_steps": costs}


def main() -> None:
    """Prints a table and writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--envs", type=int, nargs="+", default=[128])
    parser.add_argument("--works", nargs="+", choices=KNOWN, default=list(KNOWN))
    parser.add_argument(
        "--at", type=int, nargs="+", default=[100, 400, 900], help="steps before a look at the stages"
    )
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    found: dict[str, Any] = {}
    for name in options.works:
        for envs in options.envs:
            result = measure(name, envs, options.device, options.at, options.repeats)
            found.setdefault(name, {})[str(envs)] = result
            print(f"{name}, {envs} environments: {result['env_steps_per_s']:.3g} env-steps/s")
            for steps, costs in result["ns_per_env_after_steps"].items():
                row = ", ".join(f"{stage} {cost:.3g}" for stage, cost in costs.items())
                print(f"  after {steps} steps, ns per environment: {row}", flush=True)
            if options.out:
                report = {"facts": facts(options.device, available_threads()), "stages": found}
                write(options.out, report)


if __name__ == "__main__":
    main()
