"""Compares this engine with others on the same benchmark scenes, in alternating runs.

    python benchmarks/compare.py                                        # on the CPU, all cores
    python benchmarks/compare.py --device cuda:0 --envs 8192 32768 131072
    python benchmarks/compare.py --engines warpcontact --scenes W1 --envs 1 64 1024
    python benchmarks/compare.py nonsmooth                              # with MuJoCo

A virtual environment is created for each peer on first use. ``--here`` runs all engines in the current
interpreter, ``--python newton=PATH`` runs one in another. In each round every engine runs once, so that other load
on the machine affects all of them. The result of an engine is that at its best number of environments.
"""

import argparse
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from comparisons import COMPARISONS
from environments import CACHE, interpreter
from progress import Bar
from result_file import RATIOS, default_path, stored, write
from side_by_side import SideBySide
from table import lines, summarise

from warpcontact.benchmark.facts import facts


def main() -> None:
    """Prints a table and writes the figures."""
    options = arguments()
    about = facts(options.device, options.threads)
    out = options.out or default_path(options.kind, options.device, about)
    pythons = {name: python_of(name, options) for name in options.engines}
    entries: list[dict[str, Any]] = []
    runs = len(options.engines) * (options.rounds + 2)
    with Bar(total=len(options.scenes) * len(options.envs) * runs, unit="run", disable=None) as bar:
        for scene in options.scenes:
            able = dict(pythons)
            for envs in options.envs:
                done = bar.n
                found = compare(scene, envs, able, options, bar)
                bar.update(done + runs - bar.n)  # also for skipped engines
                for entry in found:
                    if not quick(entry, options):
                        able.pop(entry["engine"])
                entries += found
                write(out, report(about, options, entries) | stored(out, RATIOS))
    print(f"{about['device']}, {about['cores']} cores, {about['date']}")
    print("\n".join(lines(summarise(entries))))
    print(f"written to {out}")


def compare(
    scene: str, envs: int, pythons: dict[str, Path], options: argparse.Namespace, bar: Bar
) -> list[dict[str, Any]]:
    """Returns the results of the engines on a benchmark scene."""

    def progress(name: str) -> None:
        if name:
            bar.set_description(f"{scene} {envs} {name}")
        else:
            bar.update()

    arguments = ["--steps", options.steps, "--device", options.device, "--threads", options.threads]
    arguments += ["--at-least", options.at_least]
    with tempfile.TemporaryDirectory() as folder:
        cold = Path(folder) if options.cold else None
        race = SideBySide(
            scene, envs, pythons, [str(part) for part in arguments], cold, options.patience, progress
        )
        try:
            race.start(together=options.together)
            for _ in range(options.rounds):
                rates = race.round()
                if any(envs * options.steps / rate > options.longest for rate in rates.values()):
                    break  # runs are so long that more rounds do not change the result
            race.finish()
        finally:
            race.end()
    return list(race.entries.values())


def quick(entry: dict[str, Any], options: argparse.Namespace) -> bool:
    """Returns whether an engine is fast enough to run it with more environments."""
    rates = entry.get("env_steps_per_s")
    return bool(rates) and entry["envs"] * options.steps / max(rates) < options.longest


def python_of(name: str, options: argparse.Namespace) -> Path:
    """Returns the interpreter of an engine."""
    file = COMPARISONS[options.comparison].engines[name].file
    for key in (name, file):
        if key in options.python:
            return Path(options.python[key])
    return Path(sys.executable) if options.here else interpreter(file, options.cache)


def report(about: dict[str, Any], options: argparse.Namespace, entries: list[dict[str, Any]]) -> dict[str, Any]:
    """Returns the report of the results so far, as it is written."""
    versions = {entry["engine"]: entry["versions"] for entry in entries if "versions" in entry}
    common_keys = ("versions", "steps", "device")  # equal in all entries
    measured = [{key: value for key, value in entry.items() if key not in common_keys} for entry in entries]
    return {
        "facts": about,
        "steps": options.steps,
        "rounds": options.rounds,
        "at_least_s": options.at_least,
        "cold_start": options.cold,
        "versions": versions,
        "best": summarise(entries),
        "measured": measured,
    }


def arguments() -> argparse.Namespace:
    """Returns the command line with defaults for the device."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("comparison", nargs="?", choices=COMPARISONS, default="compliant", help="kind of contact")
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--engines", nargs="+", metavar="ENGINE")
    parser.add_argument("--scenes", nargs="+", metavar="SCENE")
    parser.add_argument("--envs", type=int, nargs="+", help="numbers of environments, ascending")
    parser.add_argument("--steps", type=int)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument(
        "--at-least", type=float, default=1.0, help="minimum duration of a measurement, in seconds"
    )
    parser.add_argument(
        "--threads", type=int, default=os.cpu_count(), help="threads of engines with a thread option"
    )
    parser.add_argument("--here", action="store_true", help="use the current interpreter for all engines")
    parser.add_argument("--python", nargs="+", default=[], metavar="ENGINE=PATH", help="interpreter of an engine")
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder of the virtual environments of peers")
    parser.add_argument("--cold", action="store_true", help="start with an empty kernel cache")
    parser.add_argument("--together", action="store_true", help="start all engines simultaneously")
    parser.add_argument("--patience", type=float, default=900.0, help="timeout for an engine, in seconds")
    parser.add_argument(
        "--longest", type=float, default=30.0, help="run time above which an engine is not run again, in seconds"
    )
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    options.python = dict(text.partition("=")[::2] for text in options.python)
    comparison = COMPARISONS[options.comparison]
    engines = comparison.engines
    options.kind = "" if options.comparison == "compliant" else options.comparison
    for option, chosen, names in (
        ("--engines", options.engines, engines),
        ("--scenes", options.scenes, comparison.scenes),
    ):
        if unknown := [name for name in chosen or () if name not in names]:
            parser.error(f"{option} must be of {', '.join(names)}, got {unknown[0]}")
    known = {*engines, *(engine.file for engine in engines.values())}
    for name, path in options.python.items():
        if name not in known or not shutil.which(path):
            names = ", ".join(sorted(known))
            parser.error(f"--python must be ENGINE=PATH with an engine of {names}, got {name}={path}")
    cuda = options.device.startswith("cuda")
    if options.engines is None:
        options.engines = [name for name, engine in engines.items() if (engine.cuda if cuda else engine.cpu)]
    options.scenes = options.scenes or comparison.default_scenes
    options.steps = options.steps or comparison.steps
    options.envs = options.envs or (comparison.envs_on_cuda if cuda else comparison.envs_on_cpu)
    return options


if __name__ == "__main__":
    main()
