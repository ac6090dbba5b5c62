"""The option ``--trust`` of commands that read the scene of a run."""

import argparse


def add_option(parser: argparse.ArgumentParser) -> None:
    """Adds the option to a command."""
    parser.add_argument(
        "--trust",
        action="store_true",
        help="execute the Python files of a run folder that no run of this user has written there",
    )
