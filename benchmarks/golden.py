"""Checks that results did not change by one bit, by small scenes that are run in two checkouts.

    python benchmarks/golden.py hash [--scene NAME ...] [--json FILE]
    git worktree add ../other REV
    python benchmarks/golden.py compare ../other [--scene NAME ...]

``hash`` runs the golden scenes (``golden_scenes/``) with the package of this checkout and prints hashes of the
final state, the recording, the outcomes and the events of each. ``compare`` runs them with the packages of this
and of another checkout, on this machine and device, and lists the arrays that differ. Both checkouts run the
scenes of this script: the other one needs neither the script nor an installation. Public names may differ between
the checkouts, see ``golden_scenes/names.py``.

All sensors at the end of a scene are compared if both checkouts have them. Scenes run in one process per core.
Exit code of ``compare``: 0 without differences, 1 with differences, 2 if a scene failed in one of the checkouts.
"""

import argparse
import json
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from golden_scenes.catalog import SCENES, uncovered
from golden_scenes.difference import Arrays, Difference, differences, digests
from golden_scenes.names import Names
from golden_scenes.plan import run

HERE = Path(__file__).resolve().parents[1]
#: Exit codes of ``compare``.
SAME, DIFFERENT, FAILED = 0, 1, 2
#: Digits of a hash that are printed.
DIGITS = 16


class UsageError(Exception):
    """Argument of the command line that is not valid."""


@dataclass(frozen=True)
class Result:
    """A scene that ran, or failed, in a checkout.

    Attributes:
        scene: Name of the scene.
        seconds: Duration, including compilation [s].
        cpu_seconds: CPU time of the process that ran it [s].
        path: File of its arrays.
        error: Why it failed; empty if it did not.
    """

    scene: str
    seconds: float
    cpu_seconds: float
    path: Path
    error: str = ""

    def arrays(self) -> Arrays:
        """Returns the arrays of the scene."""
        with np.load(self.path, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}


@dataclass(frozen=True)
class Comparison:
    """The results of a scene in two checkouts.

    Attributes:
        scene: Name of the scene.
        errors: Why it failed, one line per checkout.
        differences: Arrays that differ, the largest difference first.
    """

    scene: str
    errors: Sequence[str] = ()
    differences: Sequence[Difference] = ()


def package_folders(checkout: Path) -> dict[str, str]:
    """Returns the folder of each package of a checkout, by the name of the package.

    Raises:
        UsageError: If ``checkout`` is no checkout of the package.
    """
    settings = checkout / "pyproject.toml"
    if not settings.is_file():
        raise UsageError(f"OTHER_CHECKOUT must be a checkout of warpcontact, got {checkout}: no pyproject.toml")
    found: dict[str, str] = tomllib.loads(settings.read_text(encoding="utf-8"))["tool"]["setuptools"][
        "package-dir"
    ]
    return found


def lay_out(checkout: Path, folder: Path) -> Path:
    """Copies the packages of a checkout into an import folder, as its ``pyproject.toml`` maps them.

    Args:
        checkout: Root of a checkout.
        folder: Folder to create.

    Returns:
        The import folder.

    Raises:
        UsageError: If ``checkout`` is no checkout of the package.
    """
    packages = package_folders(checkout)
    # A package before those that are inside of it.
    for package in sorted(packages):
        ignored = shutil.ignore_patterns("__pycache__")
        target = folder.joinpath(*package.split("."))
        shutil.copytree(checkout / packages[package], target, ignore=ignored, dirs_exist_ok=True)
    return folder


class Worker:
    """Process that runs scenes of one checkout, one after the other.

    Args:
        layout: Import folder of the checkout.
        device: Warp device.
        out: Folder for the arrays.
    """

    def __init__(self, layout: Path, device: str, out: Path) -> None:
        self._out = out
        self._log = tempfile.TemporaryFile(mode="w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        self._process = subprocess.Popen(
            _command("worker", str(layout), str(out), "--device", device),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env=_environment(layout),
            cwd=out,
        )

    def run(self, scene: str) -> Result:
        """Runs a scene and returns its result; a process that died is an error of the scene."""
        start = time.perf_counter()
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(f"{scene}\n")
            self._process.stdin.flush()
            answer = self._process.stdout.readline()
        except BrokenPipeError:
            answer = ""
        seconds = time.perf_counter() - start
        found = json.loads(answer) if answer else {"error": f"the process ended: {self._last_lines()}", "cpu": 0.0}
        return Result(scene, seconds, found["cpu"], self._out / f"{scene}.npz", found["error"])

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.poll() is None

    def _last_lines(self, count: int = 5) -> str:
        code = self._process.wait()
        self._log.seek(0)
        return f"exit code {code}; " + " | ".join(self._log.read().splitlines()[-count:])

    def close(self) -> None:
        """Ends the process."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()
        self._log.close()


def run_scenes(checkout: Path, scenes: Sequence[str], device: str, folder: Path, label: str) -> dict[str, Result]:
    """Runs scenes with the package of a checkout, in one process per core, and returns their results by name.

    Args:
        checkout: Root of the checkout.
        scenes: Names of the scenes.
        device: Warp device.
        folder: Folder to create for the import folder and the arrays.
        label: Name of the checkout in progress lines.
    """
    layout, out = lay_out(checkout, folder / "layout"), folder / "arrays"
    out.mkdir()
    waiting: queue.SimpleQueue[str] = queue.SimpleQueue()
    for scene in scenes:
        waiting.put(scene)
    results: dict[str, Result] = {}
    lock = threading.Lock()

    def work() -> None:
        worker = Worker(layout, device, out)
        try:
            while True:
                try:
                    scene = waiting.get_nowait()
                except queue.Empty:
                    return
                if not worker.alive:
                    worker.close()
                    worker = Worker(layout, device, out)
                result = worker.run(scene)
                with lock:
                    results[scene] = result
                    times = f"{result.seconds:6.1f} s, {result.cpu_seconds:5.1f} s CPU"
                    state = f"failed: {result.error}" if result.error else times
                    print(
                        f"{label} {len(results):2}/{len(scenes)} {scene:34} {state}", file=sys.stderr, flush=True
                    )
        finally:
            worker.close()

    threads = [threading.Thread(target=work) for _ in range(min(os.cpu_count() or 1, len(scenes)))]
    for thread in threads:
        thread.start()
    try:
        for thread in threads:
            thread.join()
    except KeyboardInterrupt:
        # The processes are interrupted as well: start no further scene.
        while not waiting.empty():
            waiting.get_nowait()
        raise
    return {scene: results[scene] for scene in scenes}


def compare_results(
    mine: dict[str, Result], other: dict[str, Result], labels: tuple[str, str] = ("this", "other")
) -> list[Comparison]:
    """Returns the scenes that differ or that failed in one of two checkouts; a scene without result failed."""
    found = []
    for scene in {**mine, **other}:
        errors = []
        for label, results in zip(labels, (mine, other), strict=True):
            error = results[scene].error if scene in results else "no result"
            errors += [f"{label}: {error}"] if error else []
        if errors:
            found.append(Comparison(scene, errors=errors))
        elif different := differences(mine[scene].arrays(), other[scene].arrays(), labels):
            found.append(Comparison(scene, differences=different))
    return found


def report(found: Sequence[Comparison], scenes: int) -> tuple[list[str], int]:
    """Returns the lines that describe a comparison of a number of scenes, and the exit code."""
    lines = []
    for one in found:
        lines += [f"{one.scene}: failed in {error}" for error in one.errors]
        if one.differences:
            lines.append(f"{one.scene}: {len(one.differences)} arrays differ, most {one.differences[0]}")
    failed = sum(bool(one.errors) for one in found)
    different = sum(bool(one.differences) for one in found)
    lines.append(f"{different} differences in {scenes - failed} scenes" + (f", {failed} failed" if failed else ""))
    return lines, FAILED if failed else DIFFERENT if different else SAME


def compare_command(options: argparse.Namespace) -> int:
    """Compares the scenes of two checkouts and returns the exit code."""
    scenes = chosen(options.scene)
    package_folders(options.other)
    with tempfile.TemporaryDirectory(prefix="golden-") as folder:
        mine = run_scenes(HERE, scenes, options.device, Path(folder, "this"), "this ")
        other = run_scenes(options.other, scenes, options.device, Path(folder, "other"), "other")
        lines, code = report(compare_results(mine, other), len(scenes))
        print("\n".join([*_uncovered(options, Path(folder, "this")), *lines]))
    return code


def hash_command(options: argparse.Namespace) -> int:
    """Prints the hashes of the scenes of this checkout and returns the exit code."""
    scenes = chosen(options.scene)
    with tempfile.TemporaryDirectory(prefix="golden-") as folder:
        results = run_scenes(HERE, scenes, options.device, Path(folder, "this"), "this")
        hashes = {scene: digests(result.arrays()) for scene, result in results.items() if not result.error}
        for scene, result in results.items():
            groups = " ".join(f"{group} {value[:DIGITS]}" for group, value in hashes.get(scene, {}).items())
            print(f"{scene:34} {groups or f'failed: {result.error}'}")
        print("\n".join(_uncovered(options, Path(folder, "this"))))
    if options.json:
        options.json.write_text(json.dumps(hashes, indent=2) + "\n", encoding="utf-8")
    return SAME if len(hashes) == len(scenes) else FAILED


def chosen(names: Sequence[str] | None) -> list[str]:
    """Returns the names of the scenes to run: all, or those given.

    Raises:
        UsageError: If there is no scene of a name.
    """
    for name in names or ():
        if name not in SCENES:
            raise UsageError(f"--scene must be one of {', '.join(SCENES)}, got {name!r}")
    return [name for name in SCENES if not names or name in names]


def _uncovered(options: argparse.Namespace, folder: Path) -> list[str]:
    """Returns lines that name the classes of the catalogs that no scene uses; none if scenes were chosen."""
    if options.scene:
        return []
    layout = folder / "layout"
    answer = subprocess.run(
        _command("coverage", str(layout)), env=_environment(layout), capture_output=True, text=True, check=False
    )
    if answer.returncode:
        return [f"coverage could not be determined: {answer.stderr.strip().splitlines()[-1]}"]
    missing: dict[str, list[str]] = json.loads(answer.stdout.splitlines()[-1])
    return [f"not covered by any scene, {catalog}: {', '.join(names)}" for catalog, names in missing.items()]


def _command(*arguments: str) -> list[str]:
    return [sys.executable, str(Path(__file__).resolve()), *arguments]


def _environment(layout: Path) -> dict[str, str]:
    others = os.environ.get("PYTHONPATH")
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(layout), *([others] if others else [])])}


def worker_command(options: argparse.Namespace) -> int:
    """Runs the scenes whose names are read from standard input; answers each with a line of JSON."""
    # Warp and the package may print: the answers go to a copy of standard output.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    names = package_names(options.layout)
    for line in sys.stdin:
        scene = line.strip()
        start = time.process_time()
        try:
            save_scene(names, scene, options.device, options.out)
            error = ""
        except Exception as problem:
            error = f"{type(problem).__name__}: {problem}"
        answers.write(json.dumps({"error": error, "cpu": time.process_time() - start}) + "\n")
        answers.flush()
    return SAME


def save_scene(names: Names, scene: str, device: str, out: Path) -> None:
    """Runs a scene and writes its arrays into ``<out>/<scene>.npz``."""
    with tempfile.TemporaryDirectory(prefix="golden-scene-") as folder:
        arrays = run(names, SCENES[scene](names), device, Path(folder))
    np.savez(out / f"{scene}.npz", **arrays)


def coverage_command(options: argparse.Namespace) -> int:
    """Prints the classes of each catalog that no scene uses, as JSON."""
    print(json.dumps(uncovered(package_names(options.layout))))
    return SAME


def package_names(layout: Path) -> Names:
    """Imports the package from an import folder, silences its warnings and returns its names.

    Raises:
        SystemExit: If the package was imported from elsewhere.
    """
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    warnings.simplefilter("ignore")
    import warpcontact

    found = Path(warpcontact.__file__).resolve()
    if not found.is_relative_to(layout.resolve()):
        sys.exit(f"warpcontact must be imported from {layout}, got {found}")
    return Names(warpcontact)


def main() -> int:
    """Runs a command and returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True, metavar="{hash,compare}")
    hashes = commands.add_parser("hash", help="print hashes of the results of this checkout")
    hashes.add_argument("--json", type=Path, metavar="FILE", help="file to which the full hashes are written")
    hashes.set_defaults(command=hash_command)
    compare = commands.add_parser("compare", help="compare the results of this checkout with those of another")
    compare.add_argument(
        "other",
        type=Path,
        metavar="OTHER_CHECKOUT",
        help="folder of the other checkout: git worktree add ../other REV",
    )
    compare.set_defaults(command=compare_command)
    for command in (hashes, compare):
        command.add_argument("--scene", nargs="+", metavar="NAME", help="scenes to run (default: all)")
        command.add_argument("--device", default="cpu", help="Warp device (default: cpu)")
    # Commands of the processes that this script starts.
    worker = commands.add_parser("worker")
    worker.add_argument("layout", type=Path)
    worker.add_argument("out", type=Path)
    worker.add_argument("--device", required=True)
    worker.set_defaults(command=worker_command)
    coverage = commands.add_parser("coverage")
    coverage.add_argument("layout", type=Path)
    coverage.set_defaults(command=coverage_command)
    options = parser.parse_args()
    try:
        code: int = options.command(options)
    except UsageError as error:
        print(f"golden.py: {error}", file=sys.stderr)
        return FAILED
    return code


if __name__ == "__main__":
    sys.exit(main())
