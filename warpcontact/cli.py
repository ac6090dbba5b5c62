"""The command line. Nothing slow is imported before it is needed: ``--help`` answers at once."""

import argparse
import os
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from warpcontact import __version__

FAILED = 1  # the answer is no: an unusable mesh
WRONG_USE = 2  # the command could not be carried out, as argparse has it
INTERRUPTED = 130  # the shell's number for Ctrl-C

WIDTH = 100


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: Its words; ``None``: those of the process.

    Returns:
        The exit code: 0, or 1 for an unusable mesh, 2 for an error, 130 if interrupted.
    """
    arguments = _parser().parse_args(argv)
    try:
        code = arguments.command(arguments)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        print("\nwarpcontact: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # Whoever read the output, such as head, has seen enough; at exit Python flushes what is left.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except MemoryError as error:
        return _fail(str(error) or "out of memory")
    except OSError as error:
        return _fail(str(error))
    except RuntimeError as error:
        if "allocate" not in str(error):  # as Warp says that there is no memory left
            raise
        return _fail(f"out of memory: {error}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="warpcontact",
        description="Contact dynamics on oriented triangle meshes, thousands of environments at once.",
    )
    parser.add_argument("--version", action="version", version=f"warpcontact {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="run an experiment file", description="Run an experiment file.")
    run.add_argument("file", metavar="FILE", help="the experiment, a TOML file")
    run.add_argument(
        "--out", metavar="DIR", help="folder for the results (default: results/<name of the experiment>)"
    )
    run.add_argument("--envs", type=int, metavar="N", help="number of environments instead of that in the file")
    run.add_argument("--duration", type=float, metavar="S", help="simulated seconds instead of those in the file")
    run.add_argument("--device", default="auto", metavar="D", help="cpu, cuda:0, … (default: auto, a GPU if any)")
    run.add_argument("--overwrite", action="store_true", help="replace an earlier run in the folder")
    run.set_defaults(command=_run)

    inspect = commands.add_parser(
        "inspect", help="report on a mesh file", description="Report on a mesh file. Exit code 1: unusable."
    )
    inspect.add_argument("mesh", metavar="MESH", help="an .stl, .obj, .ply, .off or .glb file")
    inspect.add_argument(
        "--scale", type=float, default=1.0, metavar="X", help="m per unit of the file (default: 1)"
    )
    inspect.set_defaults(command=_inspect)

    laws = commands.add_parser(
        "laws", help="list the laws and frictions", description="List the laws and frictions that come with it."
    )
    laws.set_defaults(command=_laws)
    return parser


def _fail(message: str) -> int:
    print(f"warpcontact: {message}", file=sys.stderr)
    return WRONG_USE


def _run(arguments: argparse.Namespace) -> int:
    import warnings

    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    from warpcontact.experiment import Experiment, ExperimentError
    from warpcontact.experiment.result import INTERRUPTED as INTERRUPTED_RUN
    from warpcontact.experiment.result import read_summary

    def say(stage: str) -> None:
        print(f"{stage} …", file=sys.stderr, flush=True)

    def warn(text: str) -> None:
        print(f"warning: {text}", file=sys.stderr, flush=True)

    folder: Path | None = None
    try:
        say(f"reading {arguments.file}")
        experiment = Experiment.from_toml(arguments.file)
        for option in ("envs", "duration"):
            value = getattr(arguments, option)
            with _blaming(f"--{option} {value}", experiment.source):
                experiment = experiment.changed(**{option: value})
        name = re.sub(r"[^\w.-]+", "_", experiment.settings.name).strip("._") or "experiment"
        folder = Path(arguments.out or f"results/{name}")
        with warnings.catch_warnings(), _blaming(f"--device {arguments.device}", experiment.source):
            # The summary says it.
            warnings.filterwarnings("ignore", message=".* non-finite and are frozen", category=RuntimeWarning)
            result = experiment.run(
                folder, device=arguments.device, overwrite=arguments.overwrite, on_stage=say, on_warning=warn
            )
    except ExperimentError as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        if folder is None or (read_summary(folder) or {}).get("state") != INTERRUPTED_RUN:
            raise
        print(f"\nwarpcontact: interrupted; nothing was kept in {folder}", file=sys.stderr)
        return INTERRUPTED
    print(result)
    return 0


@contextmanager
def _blaming(option: str, source: str) -> Iterator[None]:
    """Names ``option`` in place of the file: what is wrong was right before it."""
    from warpcontact.experiment import ExperimentError

    try:
        yield
    except ExperimentError as error:
        if error.source != source:
            raise
        raise ExperimentError(option, error.problems) from None


def _inspect(arguments: argparse.Namespace) -> int:
    from warpcontact.meshes import MeshError, examine_file

    try:
        report = examine_file(arguments.mesh, scale=arguments.scale)
    except (MeshError, ValueError) as error:
        return _fail(str(error))
    if not report.vertex_count and not report.face_count:  # nothing could be read
        for problem in report.errors:
            print(f"warpcontact: {arguments.mesh}: {problem}", file=sys.stderr)
        return FAILED
    print(report.to_text())
    return 0 if report.usable else FAILED


def _laws(arguments: argparse.Namespace) -> int:
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    from warpcontact.kernels import frictions, laws

    print("N: normal force, δ: penetration, δ̇: its rate, > 0 on approach, v₀: entry speed, m: effective mass,")
    print("F: friction force, v: slip velocity, s = |v|. Units are SI.")
    for title, catalogue in (("LAWS", laws.CATALOGUE), ("FRICTIONS", frictions.CATALOGUE)):
        print(f"\n{title}")
        for formula in catalogue:
            print("\n" + "\n".join(_entry(formula)))
    return 0


def _entry(formula: Any) -> Iterable[str]:
    """Returns the lines on one law or friction."""
    import dataclasses
    import textwrap

    def wrapped(begin: str, text: str) -> list[str]:
        return textwrap.wrap(text, WIDTH, initial_indent=begin, subsequent_indent=" " * len(begin))

    lines = [f"  {formula.__name__}", *wrapped("    formula ", formula.formula)]
    for field in dataclasses.fields(formula):
        limits = formula.limits(field.name)
        optional = field.default is dataclasses.MISSING or field.default is None
        given = "" if optional else f"default {field.default:g}"
        columns = f"    {field.name:<17} {limits['unit']:<8}{_range(limits):<14}{given:<14}"
        lines += wrapped(columns, limits["meaning"])
    one_of = f"exactly one of {' and '.join(formula.exactly_one_of)}" if formula.exactly_one_of else ""
    for label, text in (("give", one_of), ("valid", formula.validity), ("source", formula.reference)):
        lines += wrapped(f"    {label:<8}", text) if text else []
    return lines


def _range(limits: Any) -> str:
    """Returns an allowed range in few characters."""
    infinity = float("inf")
    low = f"> {limits['above']:g}" if limits["above"] > -infinity else ""
    low = f"≥ {limits['at_least']:g}" if limits["at_least"] > -infinity else low
    if limits["at_most"] == infinity:
        return low or "any"
    if limits["at_least"] > -infinity:
        return f"{limits['at_least']:g} … {limits['at_most']:g}"
    return f"{low}, ≤ {limits['at_most']:g}" if low else f"≤ {limits['at_most']:g}"
