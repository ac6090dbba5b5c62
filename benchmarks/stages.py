"""Where the time of a step goes, and how far it is from what the device can do.

    python benchmarks/stages.py --device cuda:0 --envs 65536 --works W1 W2p64 --out stages.json

Each stage is repeated alone on the state that a run has at several times, so the figures tell what a stage costs
there. Beside them: one closest-point query of Warp for every point and no more (the query that a step without
memory of distances cannot do without), and a copy of the state on the device.
"""

import argparse
import json
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from engines.warpcontact import WORKS as KNOWN
from engines.warpcontact import simulation
from facts import facts
from works import WORKS

import warpcontact as wc
from warpcontact.arrays import allocate
from warpcontact.crew import available_threads
from warpcontact.schedule import Span, accept_stages, step_stages

LAUNCHES = 20


@wp.kernel(enable_backward=False)
def bare_query(mesh: wp.uint64, points: wp.array(dtype=wp.vec3f), found: wp.array(dtype=wp.int32)):
    """Nearest face of every point, and nothing else."""
    i = wp.tid()
    query = wp.mesh_query_point_no_sign(mesh, points[i], 1.0e6)
    found[i] = query.face


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


def limits(sim: wc.Simulation, work: Any, envs: int) -> dict[str, float]:
    """Returns the cost of a bare query of all points, and of a copy of the state [ns per environment]."""
    model = sim.model
    device = str(model.device)
    points = np.zeros((1, 3)) if work.points is None else work.points
    positions = (model.reading("body.position")[:, None] + points).reshape(-1, 3)
    given = wp.array(positions, dtype=wp.vec3f, device=device)
    found = wp.zeros(len(given), dtype=wp.int32, device=device)
    surface = work.surface
    mesh = wp.Mesh(
        points=wp.array(surface.vertices, dtype=wp.vec3f, device=device),
        indices=wp.array(surface.faces.ravel(), dtype=wp.int32, device=device),
        bvh_constructor="sah",
    )
    query = wp.launch(bare_query, dim=len(given), inputs=[mesh.id, given, found], device=device, record_cmd=True)
    state = wp.zeros((envs, 13), dtype=wp.float32, device=device)
    other = wp.zeros_like(state)
    times = []
    for _ in range(20):
        wp.synchronize_device(device)
        start = time.perf_counter()
        wp.copy(other, state)
        wp.synchronize_device(device)
        times.append(time.perf_counter() - start)
    return {"bare query": nanoseconds([query], envs, device), "copy of state": 1e9 * min(times) / envs}


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
        costs[str(steps)] = stages(sim, envs) | limits(sim, work, envs)
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
            result = json.loads(json.dumps(result), parse_float=lambda text: float(f"{float(text):.4g}"))
            found.setdefault(name, {})[str(envs)] = result
            print(f"{name}, {envs} environments: {result['env_steps_per_s']:.3g} env-steps/s")
            for steps, costs in result["ns_per_env_after_steps"].items():
                row = ", ".join(f"{stage} {cost:.3g}" for stage, cost in costs.items())
                print(f"  after {steps} steps, ns per environment: {row}", flush=True)
            if options.out:
                report = {"facts": facts(options.device, available_threads()), "stages": found}
                options.out.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
