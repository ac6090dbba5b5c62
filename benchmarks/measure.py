"""One engine at one work, in a process of its own: environment-steps per second, printed as one line of JSON.

    python benchmarks/measure.py newton-xpbd --work W1 --envs 1024 --device cpu

It needs the engine and NumPy. A run goes from the start of the work through all steps; compiling and building are
measured apart. With ``--turns`` one begins when a line arrives on the standard input, so that engines can take
turns: there is a line when the engine is ready, one after each turn, and the result when the input ends.

A turn lasts about a second for every engine, in as many runs as it takes: after those of others caches are cold
and cores not yet free, which would weigh most on the shortest run.
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
    """Prints the result."""
    # What engines and kernels print must not get between the lines of the report.
    report = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    options = _arguments()

    from engines import ENGINES
    from works import WORKS, sanity

    engine = ENGINES[options.engine]
    work = WORKS[options.work]
    module = importlib.import_module(f"engines.{engine.file}")
    if work.name not in module.WORKS:
        print(json.dumps({"not_available": f"{options.engine} does not do {work.name}"}), file=report)
        return
    imported = time.perf_counter()
    run = module.Run(work, options.envs, options.device, options.threads, engine.variant)
    run.step(WARM_UP)
    run.wait()
    ready = time.perf_counter()
    result: dict[str, Any] = {
        "engine": options.engine,
        "work": work.name,
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
    result["sanity"] = {name: round(value, 4) for name, value in sanity(work, run.positions()).items()}
    result["notes"] = run.notes()
    print(json.dumps(result), file=report)


WARM_UP = 20


def _measure(run: Any, envs: int, steps: int, at_least: float) -> tuple[float, float]:
    """Returns environment-steps per second from the start, and how many cores were busy with them."""
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
    except metadata.PackageNotFoundError:  # on the path, but not installed
        return str(getattr(sys.modules.get(package.replace("-", "_")), "__version__", "unknown"))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("engine", help="a name in engines/__init__.py")
    parser.add_argument("--work", default="W1", help="W1, W2p8, W2p64 or W3")
    parser.add_argument("--envs", type=int, default=1024)
    parser.add_argument("--steps", type=int, default=1000, help="a multiple of 10, which graphs hold")
    parser.add_argument("--repeats", type=int, default=3, help="turns")
    parser.add_argument(
        "--at-least", type=float, default=1.0, help="seconds of a turn, in as many runs as it takes"
    )
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="for engines that are told")
    parser.add_argument("--turns", action="store_true", help="wait for a line on the standard input before a turn")
    options = parser.parse_args()
    if options.steps < 10 or options.steps % 10:
        parser.error(f"--steps must be a multiple of 10, got {options.steps}")
    return options


if __name__ == "__main__":
    main()
