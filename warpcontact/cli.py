"""The command line. Nothing slow is imported before it is needed: ``--help`` answers at once."""

import argparse
import os
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from warpcontact import __version__

FAILED = 1  # the answer is no: an unusable mesh
WRONG_USE = 2  # the command could not be carried out, as argparse has it
INTERRUPTED = 130  # the shell's number for Ctrl-C

# Options of the pictures of the one and of the other.
OF_LAWS = ("restitution", "mass", "speed", "depth")
OF_FRICTIONS = ("load",)


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

    _add_laws(commands)
    return parser


def _add_laws(commands: Any) -> None:
    laws = commands.add_parser(
        "laws",
        help="list the laws and frictions, or draw some",
        description="List the laws and frictions that come with it, or draw what they do in one impact or slip.",
    )
    laws.add_argument("name", metavar="NAME", nargs="?", help="show this one only")
    laws.add_argument("--plot", metavar="FILE", help="draw it into an .svg or .png file")
    laws.add_argument("--compare", metavar="NAME", nargs="+", help="draw these laws, or frictions, side by side")
    laws.add_argument(
        "--restitution", metavar="E", nargs="+", type=float, help="loops to draw of laws (default: 0.2 … 1)"
    )
    laws.add_argument("--mass", metavar="KG", type=float, help="mass of the sphere that hits (default: 1)")
    laws.add_argument("--speed", metavar="M/S", type=float, help="impact speed (default: 1)")
    laws.add_argument("--depth", metavar="M", type=float, help="depth without damping (default: 0.001)")
    laws.add_argument("--load", metavar="N", type=float, help="normal force on a friction (default: 10)")
    laws.set_defaults(command=_laws)


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
        experiment = Experiment.from_toml(arguments.file, on_stage=say)
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
    from warpcontact import listing

    options = {name: getattr(arguments, name) for name in (*OF_LAWS, *OF_FRICTIONS)}
    options = {name: value for name, value in options.items() if value is not None}
    try:
        _check_laws(arguments, options)
        names = list(dict.fromkeys(arguments.compare or ([arguments.name] if arguments.name else [])))
        chosen = [listing.find(name) for name in names]
        if arguments.plot:
            _plot(chosen, arguments.plot, options)
            print(f"picture: {arguments.plot}")
        elif chosen:
            print("\n".join(listing.entry(chosen[0])))
        else:
            print(listing.catalogue())
    except ValueError as error:
        return _fail(str(error))
    return 0


def _check_laws(arguments: argparse.Namespace, options: dict[str, Any]) -> None:
    """Raises ``ValueError`` if options of ``laws`` do not go together."""
    if arguments.compare is not None:
        if arguments.name:
            raise ValueError(f"give {arguments.name} to --compare, or leave --compare out")
        if len(set(arguments.compare)) < 2:
            raise ValueError(f"--compare needs at least two names, got {' '.join(arguments.compare)}")
        if not arguments.plot:
            raise ValueError("--compare draws a picture: say where by --plot FILE")
    elif arguments.plot and not arguments.name:
        raise ValueError("--plot needs the NAME of a law or friction, or --compare NAME NAME …")
    if options and not arguments.plot:
        raise ValueError(f"--{next(iter(options))} is of the picture: say where it goes by --plot FILE")


def _plot(chosen: Sequence[type[Any]], file: str, options: dict[str, Any]) -> None:
    """Draws laws or frictions.

    Raises:
        ValueError: If they are mixed, or an option or the file is not allowed.
    """
    from warpcontact import compare, frictions, laws

    ours = [formula.__name__ for formula in chosen if formula in laws.CATALOGUE]
    others = [formula.__name__ for formula in chosen if formula in frictions.CATALOGUE]
    if ours and others:
        raise ValueError(
            f"laws and frictions cannot be compared with each other: {', '.join(ours)} with {', '.join(others)}"
        )
    for name in options:
        if name in (OF_FRICTIONS if ours else OF_LAWS):
            kind = "frictions" if ours else "laws"
            raise ValueError(f"--{name} is an option of {kind}, and not of {', '.join(ours or others)}")
    compare.check_path(file)
    print("running impacts …" if ours else "running slips …", file=sys.stderr, flush=True)
    draw = compare.plot_laws if ours else compare.plot_frictions
    draw(chosen, file, **options)
