"""Options and messages that several commands share."""

import argparse
import sys


def add_trust_option(parser: argparse.ArgumentParser) -> None:
    """Adds the option ``--trust`` to a command that reads the scene of a run."""
    parser.add_argument(
        "--trust",
        action="store_true",
        help="execute the Python files of a run folder that no run of this user has written there",
    )


def device_of(arguments: argparse.Namespace) -> str | list[str]:
    """Returns the value of the option ``--device``: one device, or a list of devices."""
    name: str = arguments.device
    return name.split(",") if "," in name else name


def print_stage(stage: str) -> None:
    """Prints the stage of a command that begins to standard error."""
    print(f"{stage} …", file=sys.stderr, flush=True)
