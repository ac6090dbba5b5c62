"""The commands ``status`` and ``export``: what is in the folder of a run."""

import argparse
import sys
from pathlib import Path
from typing import Any

from warpcontact.cli.trust_option import add_option

# How many environments an animation has that nobody asked for otherwise.
ANIMATED = 16


def add_to(commands: Any) -> None:
    """Adds the commands and their options to the parsers of all commands."""
    status = commands.add_parser(
        "status",
        help="how far a run is",
        description="Tell how far the run in a folder is, running or not. Exit code 1: with --verify, its results "
        "are not as they were committed.",
    )
    status.add_argument("folder", metavar="DIR", help="folder of the run")
    status.add_argument(
        "--verify", action="store_true", help="read all results and compare them with what was committed"
    )
    export = commands.add_parser(
        "export",
        help="results of a run as a table or an animation",
        description="Write parameters and outcomes of a run as a table with one row for each finished "
        "environment, or what was recorded as a USD stage.",
    )
    export.add_argument("folder", metavar="DIR", help="folder of the run")
    kind = export.add_mutually_exclusive_group(required=True)
    kind.add_argument("--csv", metavar="FILE", help="a table of comma-separated values; - for standard output")
    kind.add_argument("--parquet", metavar="FILE", help="a Parquet file; needs pyarrow")
    kind.add_argument("--usd", metavar="FILE", help="an animation, a .usd, .usda, .usdc or .usdz file")
    export.add_argument(
        "--envs",
        metavar="N",
        nargs="+",
        type=int,
        help=f"environments of the animation with full physics, by their numbers (default: the first {ANIMATED}); "
        "all others are shown as instances",
    )
    export.add_argument(
        "--clips",
        metavar="N",
        type=int,
        help="animation of a long run: one file for so many records, in a folder beside FILE; after an "
        "interruption the same command goes on",
    )
    export.add_argument(
        "--color-by", metavar="NAME", help="outcome, parameter or sensor that colours the animation"
    )
    export.add_argument(
        "--spacing",
        metavar=("X", "Y"),
        nargs=2,
        type=float,
        help="distances between the environments of the animation on a grid [m] (default: all in place)",
    )
    add_option(export)


def status(arguments: argparse.Namespace) -> int:
    """Prints how far a run is; returns 1 if its results are not as they were committed.

    Raises:
        ValueError: If the folder holds no whole run.
    """
    from warpcontact.experiment.records import RunDataError
    from warpcontact.experiment.run import open_run
    from warpcontact.experiment.status import run_status
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
    print("verified: all that was committed is there, and as it was written")
    if any(commit.empty is None for commit in Ledger(found.folder).commits().values()):
        print("not verified: chunks lost with their entries; records of an earlier version do not show them")
    return 0


def export(arguments: argparse.Namespace) -> None:
    """Writes what was asked for.

    Raises:
        ValueError: If the folder holds no whole run, or not what was asked for, or the file cannot be written.
        OSError: If writing fails.
    """
    from warpcontact.experiment.run import open_run
    from warpcontact.files.atomic_files import check_writable

    for option in ("envs", "clips", "color_by", "spacing"):
        if getattr(arguments, option) is not None and not arguments.usd:
            raise ValueError(f"--{option.replace('_', '-')} is of --usd; a table has all environments")
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
        from warpcontact.usd.coloring import named_number

        recording, scene = run.recording, run.scene
        run.check_series()
        numbers, frames = arguments.envs, run.frames
        if numbers is None:
            numbers = recording["env"].values[frames > 0][:ANIMATED].tolist()
        last = run.records_of(numbers)
        if last < recording.sizes["time"] or not run.finished:
            # The others are shown if they have come as far.
            recording = recording.isel(time=slice(0, last), env=frames >= last)
            end = recording["time"].values[-1]
            print(
                f"caution: {run.folder} is not finished: the animation goes to {end:g} s, and has "
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
            spacing=arguments.spacing or (0.0, 0.0),
        )
    print(file)
