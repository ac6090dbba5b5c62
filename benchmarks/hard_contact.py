"""Compares nonsmooth contact with MuJoCo in alternating runs: boxes on feet that slide and come to rest.

    python benchmarks/hard_contact.py                                   # on the CPU, all cores
    python benchmarks/hard_contact.py --device cuda:0 --envs 4096 32768 --no-peer
    python benchmarks/hard_contact.py --works table4 table8 table16 stack8 --plot hard.png

A run is 500 steps from the initial state. The same residual is computed for both engines: that of Signorini's
condition and Coulomb's cone for the velocities after a step. MuJoCo contacts are soft by design, which increases
it.
"""

import argparse
import json
import os
import statistics
import subprocess
import time
from pathlib import Path
from typing import Any

from environments import CACHE, interpreter
from hard.ours import Run
from hard.works import DT, WORKS
from progress import Bar
from result_file import default_path, write

from warpcontact.benchmark.facts import facts, versions

STEPS = 500
PEER = Path(__file__).parent / "hard" / "peer.py"
CONES = ("elliptic", "pyramidal")
SOLVERS = ("auto", "gauss_seidel", "accelerated")


class Peer:
    """MuJoCo in a separate process, which runs on request."""

    def __init__(self, python: Path, work: str, envs: int, threads: int, cone: str) -> None:
        options = ["--work", work, "--envs", envs, "--threads", threads, "--steps", STEPS, "--cone", cone]
        command = [str(part) for part in (python, PEER, *options)]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.version = self._answer()["version"]

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout
        return json.loads(self._process.stdout.readline())

    def seconds(self) -> float:
        """Runs once from the initial state; returns the duration [s]."""
        assert self._process.stdin
        self._process.stdin.write("run\n")
        self._process.stdin.flush()
        return self._answer()["seconds"]

    def quality(self) -> dict[str, float]:
        """Ends the process; returns the quality figures of a run."""
        assert self._process.stdin
        self._process.stdin.close()
        found = self._answer()
        self._process.wait()
        return found


def measure(work: str, envs: int, options: argparse.Namespace, bar: Bar) -> list[dict[str, Any]]:
    """Returns the figures of all engines on a benchmark scene, from alternating runs."""
    peers = {}
    if options.peer:
        python = interpreter("mujoco", options.cache)
        peers = {f"mujoco {cone}": Peer(python, work, envs, options.threads, cone) for cone in CONES}
    own = {
        f"warpcontact {solver}": Run(WORKS[work], envs, options.device, options.threads, solver)
        for solver in options.solvers
    }
    times: dict[str, list[float]] = {name: [] for name in (*own, *peers)}
    for _ in range(options.rounds):
        for name, seconds in times.items():
            bar.set_description(f"{work} {envs} {name}")
            if name in peers:
                seconds.append(peers[name].seconds())
            else:
                own[name].reset()
                if not seconds:
                    own[name].step(STEPS)  # compiles the kernels
                    own[name].reset()
                begin = time.perf_counter()
                own[name].step(STEPS)
                seconds.append(time.perf_counter() - begin)
            bar.update()
    entries = []
    for name, taken in times.items():
        quality = peers[name].quality() if name in peers else own[name].quality(STEPS)
        entries.append(
            {
                "engine": name,
                "work": work,
                "contacts": WORKS[work].contacts,
                "envs": envs,
                "env_steps_per_s": [envs * STEPS / one for one in taken],
                **quality,
            }
        )
    return entries


def rate(entry: dict[str, Any]) -> float:
    """Returns the median of environment-steps per second."""
    return statistics.median(entry["env_steps_per_s"])


def table(entries: list[dict[str, Any]]) -> list[str]:
    """Returns the lines of a table with ratios to the fastest peer."""
    lines = [f"{'work':9}{'envs':>8}  {'engine':26}{'env-steps/s':>12}{'ratio':>8}{'residual':>11}{'depth':>10}"]
    for entry in entries:
        same = (entry["work"], entry["envs"])
        peers = [rate(e) for e in entries if (e["work"], e["envs"]) == same and e["engine"].startswith("mujoco")]
        ratio = f"{rate(entry) / max(peers):8.2f}" if peers else f"{'':8}"
        lines.append(
            f"{entry['work']:9}{entry['envs']:8}  {entry['engine']:26}{rate(entry):12.3g}{ratio}"
            f"{entry['residual_median']:11.1e}{1e3 * entry['penetration_m']:8.3f} mm"
        )
    return lines


def draw(entries: list[dict[str, Any]], picture: Path) -> None:
    """Draws the time of a step over the number of contacts."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from warpcontact.files.picture_file import check_path, save

    check_path(picture)
    figure = Figure(figsize=(10.0, 4.4), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    kinds = {"table": "One box on many feet", "stack": "Stacked boxes, four feet each"}
    for axes, (kind, title) in zip(figure.subplots(1, 2), kinds.items(), strict=True):
        chosen = [entry for entry in entries if entry["work"].startswith(kind)]
        for number, engine in enumerate(dict.fromkeys(entry["engine"] for entry in chosen)):
            own = sorted((e["contacts"], 1e6 / rate(e)) for e in chosen if e["engine"] == engine)
            axes.loglog(*zip(*own, strict=True), "osv^D"[number % 5] + "-", label=engine)
        axes.set_title(title)
        axes.set_xlabel("contacts of an environment")
        axes.set_ylabel("time per environment and step [µs], all threads")
        counts = sorted({entry["contacts"] for entry in chosen})
        axes.set_xticks(counts, [str(count) for count in counts])
        axes.set_xticks([], minor=True)
        axes.grid(True, which="both", alpha=0.3)
        axes.legend()
    save(figure, picture)


def main() -> None:
    """Prints a table and writes the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu", help="cpu or cuda:0")
    parser.add_argument("--works", nargs="+", choices=WORKS, default=["table8", "stack8"])
    parser.add_argument("--envs", type=int, nargs="+", default=[4096])
    parser.add_argument("--solvers", nargs="+", choices=SOLVERS, default=list(SOLVERS))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=os.cpu_count())
    parser.add_argument(
        "--peer", action=argparse.BooleanOptionalAction, default=True, help="measure MuJoCo as well"
    )
    parser.add_argument("--cache", type=Path, default=CACHE, help="folder of the virtual environments of peers")
    parser.add_argument("--plot", type=Path, help="plot of step time over number of contacts")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    about = facts(options.device, options.threads)
    entries: list[dict[str, Any]] = []
    engines = len(options.solvers) + (len(CONES) if options.peer else 0)
    runs = len(options.works) * len(options.envs) * options.rounds * engines
    with Bar(total=runs, unit="run", disable=None) as bar:
        for work in options.works:
            for envs in options.envs:
                entries += measure(work, envs, options, bar)
    print(f"{about['device']}, {about['cores']} cores, {about['date']}")
    print("\n".join(table(entries)))
    out = options.out or default_path("hard-contact", options.device, about)
    report = {"facts": about, "versions": versions(), "dt": DT, "steps": STEPS, "measured": entries}
    write(out, report)
    print(f"written to {out}")
    if options.plot:
        draw(entries, options.plot)


if __name__ == "__main__":
    main()
