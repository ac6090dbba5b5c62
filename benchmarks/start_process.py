"""Measures one start-up time in a new interpreter and prints it as a line of JSON; see ``start.py``.

python benchmarks/start_process.py first_step --device cpu
"""

import argparse
import contextlib
import json
import statistics
import sys
import time
from pathlib import Path
from typing import Any

BEGIN = time.perf_counter()
EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "terrain_drop.toml"
#: Number of timings of one environment, and minimum duration of each [s].
TURNS, SECONDS = 5, 0.2
#: Steps per call while kernels are compiled in the background.
CALL_STEPS = 8
#: Names that the example of the README uses up to its first step.
TO_SIMULATE = ("Scene", "Simulation", "ContactMaterial", "friction", "laws", "load_mesh", "meshes")


def imports(options: argparse.Namespace) -> dict[str, float]:
    """Returns import times [s]: package, with the names that a simulation needs, and with all names."""
    import warpcontact

    imported = time.perf_counter()
    for name in TO_SIMULATE:
        getattr(warpcontact, name)
    found = {"package": imported - BEGIN, "to_simulate": time.perf_counter() - BEGIN}
    # Some names need optional packages that may not be installed.
    with contextlib.suppress(ModuleNotFoundError):
        for name in warpcontact.__all__:
            getattr(warpcontact, name)
        found["every_name"] = time.perf_counter() - BEGIN
    return found


def warp_alone(options: argparse.Namespace) -> dict[str, float]:
    """Returns the time at which Warp is imported and initialized, on the system-wide monotonic clock [s].

    This is a lower bound for every start.
    """
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    wp.init()
    return {"ended": time.monotonic()}


def first_step(options: argparse.Namespace) -> dict[str, float]:
    """Returns the times from interpreter start to the first step of the terrain example [s], by part.

    ``ended`` is the end on the system-wide monotonic clock [s]. ``release`` is the time from the first step until steps
    use release builds of kernels, and ``longest`` that of the longest ``CALL_STEPS`` steps until then and at first use.
    """
    import warpcontact as wc

    load, Simulation = wc.Experiment.from_toml, wc.Simulation
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    imported = time.perf_counter()
    experiment = load(EXAMPLE)
    read = time.perf_counter()
    model = experiment.model(options.envs, options.device)
    sim = Simulation(model, experiment.settings.dt)
    wp.synchronize_device(options.device)
    built = time.perf_counter()
    sim.step()
    wp.synchronize_device(options.device)
    done, ended = time.perf_counter(), time.monotonic()
    modules = list(Path(wp.config.kernel_cache_dir).glob("wp_*"))
    sim.step(CALL_STEPS)
    calls = []
    while True:
        start = time.perf_counter()
        is_final = all(part.kernels == part.present_kernels for part in sim.explain().parts)
        sim.step(CALL_STEPS)
        wp.synchronize_device(options.device)
        calls.append(time.perf_counter() - start)
        if is_final:
            break
    return {
        "import": imported - BEGIN,
        "read": read - imported,
        "build": built - read,
        "step": done - built,
        "ended": ended,
        "modules": len(modules),
        "release": time.perf_counter() - done,
        "longest": max(calls),
    }


def alone(options: argparse.Namespace) -> dict[str, float]:
    """Returns the steps per second of a single environment, for each benchmark scene and the terrain example."""
    import warnings

    import warp as wp

    import warpcontact as wc
    from warpcontact.benchmark.scenes import SCENES, STEPS
    from warpcontact.benchmark.simulation import run_seconds, seconds_of_runs, simulation

    wp.config.log_level = wp.LOG_ERROR
    warnings.simplefilter("ignore", wc.ContactWarning)
    experiment = wc.Experiment.from_toml(EXAMPLE)
    settings = experiment.settings
    sims = {scene.name: (simulation(scene, 1, options.device), STEPS) for scene in SCENES.values()}
    sims["terrain example"] = (
        wc.Simulation(experiment.model(1, options.device), settings.dt),
        round(settings.duration / settings.dt),
    )
    for sim, steps in sims.values():
        run_seconds(sim, steps)
    rates: dict[str, list[float]] = {name: [] for name in sims}
    for _ in range(TURNS):
        for name, (sim, steps) in sims.items():
            rates[name].append(steps / seconds_of_runs(sim, steps, options.at_least))
    return {name: statistics.median(found) for name, found in rates.items()}


MEASUREMENTS = {"imports": imports, "warp_alone": warp_alone, "first_step": first_step, "alone": alone}


def main() -> None:
    """Prints the result of a measurement."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=MEASUREMENTS)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--envs", type=int, help="environments of the terrain example (default: as in its file)")
    parser.add_argument("--at-least", type=float, default=SECONDS, help="minimum duration of a timing, in seconds")
    options = parser.parse_args()
    answer: dict[str, Any] = MEASUREMENTS[options.what](options)
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
