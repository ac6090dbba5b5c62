"""The command ``build-kernels``: compiles kernels into the cache before they are needed."""

import argparse
import sys
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpcontact.cli.common import add_trust_option, device_of, print_stage

if TYPE_CHECKING:
    from warpcontact.experiment import Experiment


def add_to(commands: Any) -> None:
    """Adds the command and its options to the parsers of all commands."""
    parser = commands.add_parser(
        "build-kernels",
        help="compile the kernels of experiments into the cache",
        description="Compile all kernels that running these experiments would launch, in parallel, into the "
        "kernel cache of Warp. Without an experiment: the kernels of warpcontact bench. Prints the folder of the "
        "cache and its key. The environment variable WARP_CACHE_PATH sets another folder.",
    )
    parser.add_argument("files", metavar="EXPERIMENT", nargs="*", help="experiment files, TOML")
    parser.add_argument(
        "--device",
        default="auto",
        metavar="D",
        help="cpu, cuda:0, …; cuda: all GPUs; or several, such as cuda:0,cuda:2 (default: auto, one GPU if any)",
    )
    parser.add_argument(
        "--envs",
        type=int,
        metavar="N",
        help="number of environments instead of that in the file; on a GPU some kernels depend on it",
    )
    parser.add_argument("--threads", type=int, metavar="N", help="compiler threads (default: one per core)")
    parser.add_argument(
        "--key",
        action="store_true",
        help="print only the key, and compile nothing: it changes with the source code, the experiments, the "
        "versions, the compiler options and the machine",
    )
    add_trust_option(parser)
    parser.set_defaults(work=run)


def run(arguments: argparse.Namespace) -> None:
    """Compiles the kernels and prints the folder of the cache and its key, or prints only the key.

    Raises:
        ValueError: If an option or an experiment is not valid.
        OSError: If a file cannot be read, or the cache cannot be written.
    """
    for option in ("envs", "threads"):
        value = getattr(arguments, option)
        if value is not None and value < 1:
            raise ValueError(f"--{option} must be at least 1, got {value}")
    files = [Path(file) for file in arguments.files]
    for file in files:
        if not file.is_file():
            wrong = "is not a regular file" if file.exists() else "there is no such file"
            raise ValueError(f"{file}: {wrong}")
    folder = writable_cache()
    from warpcontact.model.quarantine import QuarantineError
    from warpcontact.system.cache_key import cache_key
    from warpcontact.system.devices import find_devices
    from warpcontact.system.kernel_builds import release_builds_only

    device = device_of(arguments)
    try:
        find_devices(device)
    except ValueError as error:
        raise ValueError(f"--device {arguments.device}: {error}") from None
    key = cache_key(device, files)
    if arguments.key:
        print(key)
        return
    with warnings.catch_warnings(), release_builds_only():
        warnings.simplefilter("ignore")  # A run reports them.
        try:
            if files:
                _build_experiments(files, arguments, device)
            else:
                _build_bench(arguments, device)
        except QuarantineError as error:
            raise ValueError(str(error)) from None
    print(f"cache: {folder}")
    print(f"key: {key}")


def writable_cache() -> Path:
    """Returns the folder of Warp's kernel cache, after checking that files can be created in it.

    Raises:
        OSError: If files cannot be created; the message names the folder and the remedy.
    """
    import warp as wp

    from warpcontact.system.initialization import explaining, initialize

    initialize()
    folder = Path(wp.config.kernel_cache_dir)
    with explaining():
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    return folder


def _build_experiments(files: Sequence[Path], arguments: argparse.Namespace, device: str | Sequence[str]) -> None:
    from warpcontact.cli.kernel_build import ExperimentKernels, load_kernels

    found = [ExperimentKernels(_experiment(file, arguments), device) for file in files]
    print_stage("compiling")
    load_kernels([kernel for one in found for kernel in one.on_cpu], arguments.threads, _print_progress)
    for file, one in zip(files, found, strict=True):
        print_stage(f"{file}: first steps")
        one.load_others()


def _experiment(file: Path, arguments: argparse.Namespace) -> "Experiment":
    from warpcontact.experiment import Experiment, ExperimentError

    print_stage(f"reading {file}")
    experiment = Experiment.from_toml(file, on_stage=print_stage, trust=arguments.trust)
    try:
        return experiment.changed(envs=arguments.envs)
    except ExperimentError as error:
        raise ExperimentError(f"--envs {arguments.envs}", error.problems) from None


def _build_bench(arguments: argparse.Namespace, device: str | Sequence[str]) -> None:
    from warpcontact.cli.kernel_build import build_bench

    if not isinstance(device, str):
        raise ValueError(f"--device {arguments.device}: must be a single device without an experiment")
    print_stage("compiling the kernels of warpcontact bench")
    build_bench(device, arguments.envs, arguments.threads, _print_progress)


def _print_progress(done: int, total: int) -> None:
    print(f"  {done} of {total} kernels", file=sys.stderr, flush=True)
