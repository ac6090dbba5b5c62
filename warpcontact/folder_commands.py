"""The commands ``status`` and ``export``: what is in the folder of a run."""

import argparse
from typing import Any

# How many environments an animation has that nobody asked for otherwise.
ANIMATED = 16


def add_to(commands: Any) -> None:
    """Adds the commands and their options to the parsers of all commands."""
    status = commands.add_parser(
        "status", help="how far a run is", description="Tell how far the run in a folder is, running or not."
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
    kind.add_argument("--csv", metavar="FILE", help="a table of comma-separated values")
    kind.add_argument("--parquet", metavar="FILE", help="a Parquet file; needs pyarrow")
    kind.add_argument("--usd", metavar="FILE", help="an animation, a .usda, .usdc or .usdz file")
    export.add_argument(
        "--envs",
        metavar="N",
        nargs="+",
        type=int,
        help=f"numbers of the environments of the animation (default: the first {ANIMATED})",
    )


def status(arguments: argparse.Namespace) -> None:
    """Prints how far a run is.

    Raises:
        ValueError: If the folder holds no whole run.
    """
    from warpcontact.experiment.run import open_run
    from warpcontact.experiment.status import status_of

    found = status_of(arguments.folder)
    print(found)
    if arguments.verify:
        open_run(arguments.folder, verify=True)
        print("verified: all that was committed is there, and as it was written")


def export(arguments: argparse.Namespace) -> None:
    """Writes what was asked for.

    Raises:
        ValueError: If the folder holds no whole run, or not what was asked for.
        OSError: If the file cannot be written.
    """
    from warpcontact.experiment.run import open_run

    run = open_run(arguments.folder)
    if arguments.envs is not None and not arguments.usd:
        raise ValueError("--envs is of --usd; a table has all environments")
    if arguments.csv:
        run.to_csv(arguments.csv)
    elif arguments.parquet:
        try:
            run.to_parquet(arguments.parquet)
        except ImportError as error:
            raise ValueError(f"--parquet: {error}") from None
    else:
        from warpcontact.usd import export_usd

        recording = run.recording
        numbers = recording["env"].values[:ANIMATED].tolist() if arguments.envs is None else arguments.envs
        export_usd(recording, arguments.usd, envs=numbers)
    print(arguments.csv or arguments.parquet or arguments.usd)
