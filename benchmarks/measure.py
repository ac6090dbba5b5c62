"""Measures environment-steps per second of one engine on one benchmark scene; prints a line of JSON.

    python benchmarks/measure.py newton-xpbd --scene W1 --envs 1024 --device cpu

Only the engine and NumPy are needed. A run takes all steps from the initial state; compiling and building are
timed separately. With ``--turns`` each measurement starts when a line arrives on standard input, so that engines
can alternate. A line is printed when the engine is ready and after each measurement, and the result at the end of
the input.

A measurement lasts about a second for every engine, in as many runs as needed: after the run of another engine
caches are cold and cores may be busy, which would affect short runs most.
"""

import argparse
import importlib
import json
import os
import platform
import sys
import time
from importlib import metadata
from typing import Any

BEGIN = time.perf_counter()


def main() -> None:
    """Measures an engine and prints the result."""
    # Redirect standard output, so that output of engines and kernels does not mix with the report.
    report = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    options = _arguments()

    from comparisons import comparison_of

    comparison = comparison_of(options.scene)
    engine = comparison.engines[options.engine]
    scene = comparison.scenes[options.scene]
    module = importlib.import_module(f"engines.{engine.file}")
    imported = time.perf_counter()
    run = getattr(module, comparison.run)(scene, options.envs, options.device, options.threads, engine.variant)
    run.step(WARM_UP)
    run.wait()
    ready = time.perf_counter()
    result: dict[str, Any] = {
        "engine": options.engine,
        "scene": scene.name,
        "envs": options.envs,
        "steps": options.steps,
        "device": options.device,
        "start_s": {"import": round(imported - BEGIN, 2), "build": round(ready - imported, 2)},
        "versions": {"python": platform.python_version()} | {name: _version(name) for name in module.PACKAGES},
    }
    if options.turns:
        print(json.dumps({"ready": result["start_s"]}), file=report)
    rates, cores = [], []
    for _ in sys.stdin if options.turns else range(options.repeats):
        rate, busy = _measure(run, options.envs, options.steps, options.at_least)
        rates.append(rate)
        cores.append(busy)
        if options.turns:
            print(json.dumps({"env_steps_per_s": rate}), file=report)
    result["env_steps_per_s"] = rates
    result["cores_busy"] = cores
    result["sanity"] = {name: float(f"{value:.4g}") for name, value in run.sanity(options.steps).items()}
    result["notes"] = run.notes()
    print(json.dumps(result), file=report)


WARM_UP = 20


def _measure(run: Any, envs: int, steps: int, at_least: float) -> tuple[float, float]:
    """Returns environment-steps per second from the initial state, and the mean number of busy cores."""
    runs, passed, used = 0, 0.0, 0.0
    while not runs or passed < at_least:
        run.reset()
        run.wait()
        start, used_before = time.perf_counter(), time.process_time()
        run.step(steps)
        run.wait()
        passed += time.perf_counter() - start
        used += time.process_time() - used_before
        runs += 1
    return round(runs * envs * steps / passed), round(used / passed, 2)


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:  # importable, but not installed
        return str(getattr(sys.modules.get(package.replace("-", "_")), "__version__", "unknown"))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("engine", help="name of an engine, see engines/__init__.py")
    parser.add_argument("--scene", default="W1", help="name of a scene, see comparisons.py")
    parser.add_argument("--envs", type=int, default=1024)
    parser.add_argument(
        "--steps", type=int, default=1000, help="number of steps, a multiple of 10 (length of graphs)"
    )
    parser.add_argument("--repeats", type=int, default=3, help="number of measurements")
    parser.add_argument(
        "--at-least", type=float, default=1.0, help="minimum duration of a measurement, in seconds"
    )
    parser.add_argument("--device", default="cpu")
    parser.add_argument(
        "--threads", type=int, default=os.cpu_count(), help="threads of engines with a thread option"
    )
    parser.add_argument("--turns", action="store_true", help="start a measurement for each line of standard input")
    options = parser.parse_args()
    if options.steps < 10 or options.steps % 10:
        parser.error(f"--steps must be a multiple of 10, got {options.steps}")
    return options


if __name__ == "__main__":
    main()
