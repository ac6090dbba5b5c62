"""The command ``view``: shows a run, or an experiment that is stepped live, in a browser on this machine."""

import argparse
import re
import sys
import warnings
from typing import Any

from warpcontact.cli.common import add_trust_option, device_of


def add_to(commands: Any) -> None:
    """Adds the command and its options to the parsers of all commands."""
    view = commands.add_parser(
        "view",
        help="view a run, or step an experiment live",
        description="Open a page in the browser of this machine: a replay of the run in a folder, finished or "
        "running, or an experiment that is stepped live, with adjustable parameters. Press Ctrl-C to stop.",
    )
    view.add_argument("target", metavar="DIR|FILE", help="folder of a run, or an experiment, a TOML file")
    view.add_argument(
        "--port",
        type=int,
        default=8080,
        metavar="N",
        help="port of the page on 127.0.0.1, or the first port to try; 0: any (default: 8080)",
    )
    view.add_argument("--no-open", dest="open", action="store_false", help="print the address; open no browser")
    view.add_argument(
        "--speed", type=float, default=1.0, metavar="X", help="ratio of simulated time to real time (default: 1)"
    )
    view.add_argument(
        "--envs", type=int, metavar="N", help="environments of an experiment (default: as in the file, at most 16)"
    )
    view.add_argument("--device", default="auto", metavar="D", help="device of an experiment (default: auto)")
    add_trust_option(view)
    view.set_defaults(work=run)


def run(arguments: argparse.Namespace) -> None:
    """Serves the page until Ctrl-C.

    Raises:
        ValueError: If viser is not installed, the target does not exist or is invalid, or an option is not allowed.
        OSError: If a file cannot be read.
    """
    from warpcontact.visualize.viewer import view

    print(f"reading {arguments.target} …", file=sys.stderr, flush=True)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the page shows them
            viewer = view(
                arguments.target,
                port=arguments.port,
                block=False,
                open_browser=False,
                speed=arguments.speed,
                envs=arguments.envs,
                device=device_of(arguments),
                trust=arguments.trust,
            )
    except ImportError as error:
        raise ValueError(str(error)) from None
    except ValueError as error:
        raise ValueError(re.sub("^(port|speed|envs|device) (must|is|applies)", r"--\1 \2", str(error))) from None
    print(f"{viewer.url}   (press Ctrl-C to stop)", flush=True)
    if arguments.open:
        viewer.open()
    viewer.wait()
