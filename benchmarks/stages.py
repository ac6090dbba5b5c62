"""Measures the time of each stage of a step, and lower bounds of the device.

    python benchmarks/stages.py --device cuda:0 --envs 65536 --scenes W1 W2p64 --out stages.json

Each stage is timed over ``STEPS`` steps of a run, at several times. The time includes a launch, about 3 µs on a
CPU and more on a GPU, so results with few environments are not significant. Lower bounds are one bare
closest-point query of Warp per point, which a step without cached distances needs, and a copy of the state on the
device.
"""

import argparse
import itertools
import statistics
import time
from pathlib import Path
from typing import Any

import warp as wp
from benchmark_scenes import SCENES
from result_file import write

import warpcontact as wc
from warpcontact.benchmark.facts import facts
from warpcontact.benchmark.limits import limits
from warpcontact.benchmark.simulation import simulation
from warpcontact.forces.execution_plan import ExecutionPlan, accept_stages
from warpcontact.stepping.slice_stepper import StepBuffers
from warpcontact.system.resources import available_threads

# Number of steps over which a stage is timed; even.
STEPS = 20


class Clock:
    """Clock of a device: events on a GPU."""

    def __init__(self, device: str) -> None:
        self._device = wp.get_device(device)

    def now(self) -> Any:
        """Returns the instant at which the device reaches this point."""
        if self._device.is_cpu:
            return time.perf_counter()
        return wp.get_stream(self._device).record_event(wp.Event(self._device, enable_timing=True))

    def between(self, start: Any, stop: Any) -> float:
        """Returns the time between two instants [ns]."""
        if self._device.is_cpu:
            return 1e9 * (stop - start)
        return 1e6 * wp.get_event_elapsed_time(start, stop)


def stages(sim: wc.Simulation, envs: int) -> dict[str, float]:
    """Takes steps and returns the time of each stage [ns per environment]."""
    model = sim.model
    device = str(model.device)
    gpu = model.device.is_cuda
    plan = ExecutionPlan(
        model,
        envs,
        sim.distance_cache,
        ordered_sum=sim.deterministic or not gpu,
        one_thread_per_contact=gpu,
        write_outputs=False,
        semi_implicit_euler=sim.integrator.is_fusible,
    )
    buffers = StepBuffers(model, sim.integrator, sim.dt)
    buffers.allocate(envs)
    own, other = model.arrays.state, buffers.other_state
    launch_sequences = [
        sim.integrator.step_stages(plan, sim.times.full, *states, None)
        + accept_stages(plan, sim.times.full, *states)
        for states in ((own, other), (other, own))
    ]
    names: list[str] = []
    for launch in launch_sequences[0]:
        name = launch.kernel.key.split("__")[-1]
        again = sum(known.split(" ")[0] == name for known in names)
        names.append(f"{name} {again + 1}" if again else name)
    clock = Clock(device)
    instants = []
    for step in range(STEPS + 2):
        for launch in launch_sequences[step % 2]:
            instants.append(clock.now())
            launch.launch()
    instants.append(clock.now())
    wp.synchronize_device(device)
    spans = [clock.between(*pair) for pair in itertools.pairwise(instants)][2 * len(names) :]
    return {name: sum(spans[i :: len(names)]) / STEPS / envs for i, name in enumerate(names)}


def measure(name: str, envs: int, device: str, at: list[int], repeats: int) -> dict[str, Any]:
    """Returns the rate of a benchmark scene, and the times of its stages after given numbers of steps."""
    scene = SCENES[name]
    sim = simulation(scene, envs, device)
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
        done = steps + STEPS + 2
        least = limits(sim.model, scene, threads=1)
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
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    parser.add_argument(
        "--at", type=int, nargs="+", default=[100, 400, 900], help="numbers of steps after which stages are timed"
    )
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    found: dict[str, Any] = {}
    for name in options.scenes:
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
