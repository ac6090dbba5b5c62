"""Measures start-up: import, first step with and without compiled kernels, and one environment.

    python benchmarks/start.py
    python benchmarks/start.py --device cuda:0

Everything is timed in new interpreters, in rounds. *Cold* is a first step with an empty kernel cache, *warm* the
next one with the same cache. Both use the terrain example and are timed from the start of the process to the end
of the step; the duration of the whole process is reported, too. The start of Python, NumPy and Warp without this
package is measured for comparison with other machines. An uncounted warm-up reads the files of Python and Warp, so
that no measurement waits for a disk.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from progress import Bar
from result_file import default_path, write

from warpcontact.benchmark.facts import facts, versions
from warpcontact.system.resources import available_threads

PROCESS = Path(__file__).with_name("start_process.py")
#: Targets: upper limits of import and first step [s], lower limit of one environment [steps/s].
PROMISES = {"import": 0.5, "cold": 5.0, "warm": 1.0, "alone": 1e5}


def main() -> None:
    """Prints a table and writes the figures."""
    options = arguments()
    about = facts(options.device, available_threads())
    out = options.out or default_path("start", options.device, about)
    rounds: dict[str, list[dict[str, Any]]] = {"imports": [], "warp": [], "cold": [], "warm": [], "alone": []}
    with Bar(total=5 * options.rounds + 1, unit="process", disable=None) as bar:
        bar.set_description("warm-up")
        ask("imports", options, {})
        bar.update()
        for _ in range(options.rounds):
            with tempfile.TemporaryDirectory() as folder:
                # The driver has a cache of compiled kernels as well.
                caches = {"WARP_CACHE_PATH": f"{folder}/warp", "CUDA_CACHE_PATH": f"{folder}/cuda"}
                for name, what, variables in (
                    ("imports", "imports", {}),
                    ("warp", "warp_alone", {}),
                    ("cold", "first_step", caches),
                    ("warm", "first_step", caches),
                    ("alone", "alone", {}),
                ):
                    bar.set_description(name)
                    rounds[name].append(ask(what, options, variables))
                    bar.update()
    report = {
        "facts": about,
        "versions": versions(),
        "rounds": options.rounds,
        "import_s": summary(rounds["imports"]),
        "warp_s": summary(rounds["warp"]),
        "first_step_s": {
            name: summary(rounds[name]) | {"modules": rounds[name][0]["modules"]} for name in ("cold", "warm")
        },
        "steps_per_s_alone": summary(rounds["alone"]),
        "promises": PROMISES,
    }
    write(out, report)
    print(f"{about['device']}, {about['cores']} cores, {about['date']}")
    print("\n".join(lines(report)))
    print(f"written to {out}")


def ask(what: str, options: argparse.Namespace, variables: dict[str, str]) -> dict[str, Any]:
    """Returns the result of a new interpreter; if it reports ``ended``, also time to it and process time [s]."""
    words = [what, "--device", options.device, "--at-least", str(options.at_least)]
    if options.envs:
        words += ["--envs", str(options.envs)]
    start = time.monotonic()
    done = subprocess.run(
        [sys.executable, PROCESS, *words],
        # Python bytecode is cached, as for users, independent of the settings of this process.
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "", **variables},
        capture_output=True,
        text=True,
        check=False,
    )
    took = time.monotonic() - start
    if done.returncode:
        sys.exit(f"{what} failed:\n{done.stderr}")
    answer = json.loads(done.stdout)
    if "ended" in answer:
        answer |= {"done": answer.pop("ended") - start, "process": took}
    return answer


def summary(answers: list[dict[str, Any]]) -> dict[str, Any]:
    """Returns median and range over the rounds, for every entry."""
    found = {}
    for name in answers[0]:
        values = [answer[name] for answer in answers]
        found[name] = {"median": statistics.median(values), "lowest": min(values), "highest": max(values)}
    return found


def lines(report: dict[str, Any]) -> list[str]:
    """Returns the figures as lines of text, with the targets."""

    def line(name: str, figures: dict[str, float], unit: str, promised: str = "") -> str:
        spread = f"{figures['lowest']:.3g} … {figures['highest']:.3g}"
        return f"{name:42} {figures['median']:9.3g} {unit:8} {spread:>20}   {promised}".rstrip()

    imported, alone = report["import_s"], report["steps_per_s_alone"]
    text = [
        line("import warpcontact", imported["package"], "s", f"target: under {PROMISES['import']:g} s"),
        line("  with the names of a simulation", imported["to_simulate"], "s"),
    ]
    if "every_name" in imported:
        text.append(line("  with all names", imported["every_name"], "s"))
    text.append(line("Python, NumPy and Warp only: started", report["warp_s"]["done"], "s"))
    for name, part in report["first_step_s"].items():
        promised = f"target: under {PROMISES[name]:g} s"
        text.append(line(f"terrain example, {name}: first step done", part["done"], "s", promised))
        text += [
            line(f"  {what}", part[key], "s")
            for key, what in (
                ("import", "import"),
                ("read", "read and check the file"),
                ("build", "build"),
                ("step", "first step" if name == "warm" else f"first step, {part['modules']} modules compiled"),
                ("release", "from there to release builds of kernels"),
                ("longest", "longest 8 steps until then"),
                ("process", "whole process"),
            )
        ]
    for name, figures in alone.items():
        text.append(line(f"one environment: {name}", figures, "steps/s", f"target: {PROMISES['alone']:g} steps/s"))
    return text


def arguments() -> argparse.Namespace:
    """Returns the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--envs", type=int, help="environments of the terrain example (default: as in its file)")
    parser.add_argument(
        "--at-least", type=float, default=0.2, help="minimum duration of a measurement, in seconds"
    )
    parser.add_argument("--out", type=Path, help="file of figures (default: benchmarks/results/start-DEVICE.json)")
    options = parser.parse_args()
    if options.rounds < 1:
        parser.error(f"--rounds must be at least 1, got {options.rounds}")
    return options


if __name__ == "__main__":
    main()
