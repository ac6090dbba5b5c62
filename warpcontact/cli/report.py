"""The command ``report``: writes an HTML report of a run."""

import argparse
from typing import Any

from warpcontact.cli.trust_option import add_option


def add_to(commands: Any) -> None:
    """Adds the command and its options to the parsers of all commands."""
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
    add_option(parser)


def run(arguments: argparse.Namespace) -> None:
    """Writes the report.

    Raises:
        ValueError: If the folder holds no valid run, or an option is not allowed.
        OSError: If the file cannot be written.
    """
    from warpcontact.visualize.report import report

    print(report(arguments.folder, arguments.file, envs=arguments.envs, trust=arguments.trust))
