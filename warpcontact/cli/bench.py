"""The command ``bench``: measures the stepping speed of this machine, as a table and as a file."""

import argparse
import json
import re
from pathlib import Path
from typing import Any

from warpcontact.files.atomic_files import check_writable, open_for_writing


def add_to(commands: Any) -> None:
    """Adds the command and its options to the parsers of all commands."""
    bench = commands.add_parser(
        "bench",
        help="measure the stepping speed of this machine",
        description="Measure the stepping speed of this machine with a sphere, and boxes of 8 and 64 points, on a "
        "terrain of 20 000 triangles: about 20 s, more if kernels must be compiled first.",
    )
    bench.add_argument(
        "--device", default="auto", metavar="D", help="cpu, cuda:0, … (default: auto, a GPU if any)"
    )
    bench.add_argument(
        "--envs", type=int, metavar="N", help="number of environments (default: 1024 on a CPU, 65536 on a GPU)"
    )
    bench.add_argument(
        "--seconds", type=float, default=3.0, metavar="S", help="minimum stepping time per scene (default: 3)"
    )
    bench.add_argument("--precision", default="float32", metavar="P", help="float32 or float64 (default: float32)")
    bench.add_argument("--json", metavar="FILE", help="write the results into a JSON file as well")
    bench.set_defaults(work=run)


def run(arguments: argparse.Namespace) -> None:
    """Runs the benchmark and prints the table.

    Raises:
        ValueError: If an option is not allowed, or the file cannot be written, which is checked first.
        OSError: If writing fails.
    """
    if arguments.json:
        check_writable(Path(arguments.json))
    from warpcontact.benchmark import bench

    try:
        report = bench(arguments.device, arguments.envs, seconds=arguments.seconds, precision=arguments.precision)
    except ValueError as error:
        raise ValueError(re.sub("^(device|envs|seconds|precision) must", r"--\1 must", str(error))) from None
    print(report)
    if arguments.json:
        text = json.dumps(report.to_dict(), indent=1, ensure_ascii=False)
        with open_for_writing(Path(arguments.json)) as file:
            file.write(f"{text}\n".encode())
        print(f"figures: {arguments.json}")
