"""The commands ``status``, ``export`` and ``report``: progress and results of a run."""

import argparse
import sys
from pathlib import Path
from typing import Any

from warpcontact.cli.common import add_trust_option

# Default number of environments in an animation.
ANIMATED = 16


def add_to(commands: Any) -> None:
    """Adds the commands and their options to the parsers of all commands."""
    status = commands.add_parser(
        "status",
        help="progress of a run",
        description="Print the progress of the run in a folder. Exit code 1: with --verify, its results differ "
        "from the committed ones.",
    )
    status.add_argument("folder", metavar="DIR", help="folder of the run")
    status.add_argument(
        "--verify", action="store_true", help="read all results and compare them with the committed checksums"
    )
    status.set_defaults(work=print_status)
    export = commands.add_parser(
        "export",
        help="results of a run as a table or an animation",
        description="Write parameters and outcomes of a run as a table with one row per finished environment, or the "
        "recording as a USD stage.",
    )
    export.add_argument("folder", metavar="DIR", help="folder of the run")
    kind = export.add_mutually_exclusive_group(required=True)
    kind.add_argument("--csv", metavar="FILE", help="a table of comma-separated values; - for standard output")
    kind.add_argument("--parquet", metavar="FILE", help="a Parquet file; requires pyarrow")
    kind.add_argument("--usd", metavar="FILE", help="an animation, a .usd, .usda, .usdc or .usdz file")
    export.add_argument(
        "--envs",
        metavar="N",
        nargs="+",
        type=int,
        help=f"numbers of the environments of the animation with full physics (default: the first {ANIMATED}); all "
        "others are shown as instances",
    )
    export.add_argument(
        "--clips",
        metavar="N",
        type=int,
        help="number of frames per clip file of a long animation, in a folder next to FILE; if interrupted, repeat "
        "the command to continue",
    )
    export.add_argument(
        "--color-by", metavar="NAME", help="outcome, parameter or sensor that colors the animation"
    )
    export.add_argument(
        "--pressure",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="areas of body contacts, colored by pressure, in the animation (default: yes)",
    )
    export.add_argument(
        "--spacing",
        metavar=("X", "Y"),
        nargs=2,
        type=float,
        help="distances between the environments of the animation on a grid [m] (default: 0)",
    )
    add_trust_option(export)
    export.set_defaults(work=export_results)
    _add_report(commands)


def print_status(arguments: argparse.Namespace) -> int:
    """Prints the progress of a run; returns 1 if results differ from the committed ones.

    Raises:
        ValueError: If the folder holds no valid run.
    """
    from warpcontact.experiment.progress import run_status
    from warpcontact.experiment.records import RunDataError
    from warpcontact.experiment.run import open_run
    from warpcontact.experiment.store import Ledger

    found = run_status(arguments.folder)
    print(found)
    if not arguments.verify:
        return 0
    try:
        open_run(arguments.folder, verify=True)
    except RunDataError as error:
        print(f"warpcontact: {error}", file=sys.stderr)
        return 1
    print("verified: all committed files exist and are unchanged")
    if any(commit.empty is None for commit in Ledger(found.folder).commits().values()):
        print("not verified: chunks lost with their entries, which records of an earlier version do not show")
    return 0


def export_results(arguments: argparse.Namespace) -> None:
    """Writes a table or an animation of a run.

    Raises:
        ValueError: If the folder holds no valid run or no such data, or the file cannot be written.
        OSError: If writing fails.
    """
    from warpcontact.experiment.run import open_run
    from warpcontact.files.atomic_files import check_writable

    for option in ("envs", "clips", "color_by", "pressure", "spacing"):
        if getattr(arguments, option) is not None and not arguments.usd:
            raise ValueError(f"--{option.replace('_', '-')} requires --usd; a table has all environments")
    file = arguments.csv or arguments.parquet or arguments.usd
    if arguments.csv != "-":
        check_writable(Path(file))
    run = open_run(arguments.folder, trust=arguments.trust)
    if not arguments.usd and not run.outcome.sizes["env"]:
        print(
            f"caution: no environment of {run.folder} is finished yet: the table has no rows; "
            f"to resume: warpcontact run --resume --out {run.folder}",
            file=sys.stderr,
        )
    if arguments.csv == "-":
        run.write_csv(sys.stdout, "\n")
        return
    if arguments.csv:
        run.to_csv(arguments.csv)
    elif arguments.parquet:
        try:
            run.to_parquet(arguments.parquet)
        except ImportError as error:
            raise ValueError(f"--parquet: {error}") from None
    else:
        from warpcontact.usd import export_usd
        from warpcontact.usd.ensemble import named_number

        recording, scene = run.recording, run.scene
        run.check_series()
        numbers, frames = arguments.envs, run.frames
        if numbers is None:
            numbers = recording["env"].values[frames > 0][:ANIMATED].tolist()
        last = run.records_of(numbers)
        if last < recording.sizes["time"] or not run.finished:
            # Other environments are shown if they have at least as many frames.
            recording = recording.isel(time=slice(0, last), env=frames >= last)
            end = recording["time"].values[-1]
            print(
                f"caution: {run.folder} is not finished: the animation ends at {end:g} s, and has "
                f"{recording.sizes['env']} of {run.summary['envs']} environments",
                file=sys.stderr,
            )
        name, color_by = arguments.color_by, None
        if name is not None:
            color_by = run.outcome[name] if name in run.outcome else named_number(recording, name, run.outcome)
        export_usd(
            recording,
            arguments.usd,
            envs=numbers,
            scene=scene,
            clip_frames=arguments.clips,
            color_by=color_by,
            pressure=arguments.pressure is not False,
            spacing=arguments.spacing or (0.0, 0.0),
        )
    print(file)


def _add_report(commands: Any) -> None:
    """Adds the command ``report`` and its options to the parsers of all commands."""
    parser = commands.add_parser(
        "report",
        help="HTML report of a run: outcomes, curves, a table, a replay in 3D",
        description="Write a report of a run as one self-contained HTML file.",
    )
    parser.add_argument("folder", metavar="DIR", help="folder of the run, finished or not")
    parser.add_argument(
        "-o", "--out", dest="file", metavar="FILE", help="the .html file (default: report.html in the folder)"
    )
    parser.add_argument(
        "--envs",
        metavar="N",
        nargs="+",
        type=int,
        help="environments that are shown individually (default: the first 16, some failed ones, and those with the "
        "smallest and largest outcomes, as far as they fit)",
    )
    add_trust_option(parser)
    parser.set_defaults(work=write_report)


def write_report(arguments: argparse.Namespace) -> None:
    """Writes the report.

    Raises:
        ValueError: If the folder holds no valid run, or an option is not allowed.
        OSError: If the file cannot be written.
    """
    from warpcontact.visualize.report import report

    print(report(arguments.folder, arguments.file, envs=arguments.envs, trust=arguments.trust))
