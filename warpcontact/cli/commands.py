"""Entry point of the command line. Modules are imported on demand, so that ``--help`` responds quickly."""

import argparse
import os
import re
import shlex
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from warpcontact import __version__
from warpcontact.cli import bench, build_kernels, laws, render, run_folders, view
from warpcontact.cli.common import add_trust_option, device_of, print_stage
from warpcontact.system.process import terminate_as_interrupt
from warpcontact.validation.safe_text import escape_output

if TYPE_CHECKING:
    from warpcontact.experiment import Experiment

FAILED = 1  # negative result, for example an unusable mesh or a plan that does not fit
WRONG_USE = 2  # the command could not be executed; also the exit code of argparse
SHARDS_FAILED = 3  # some shards of a run failed; the others are finished
INTERRUPTED = 130  # exit code of shells for Ctrl-C


@escape_output()
def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command.

    Args:
        argv: Command-line arguments; ``None``: those of the process.

    Returns:
        The exit code: 0, or 1 for an unusable mesh or a plan that does not fit, 2 for an error, 3 if shards of a
        run failed, 130 if interrupted.
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
        # The reader of the output, such as head, has closed it. At exit Python flushes the remaining output.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except MemoryError as error:
        return _fail(str(error) or "out of memory")
    except OSError as error:
        return _fail(_sentence(error))
    except Exception as error:
        # Warp's error if memory cannot be allocated.
        if isinstance(error, RuntimeError) and "allocate" in str(error):
            return _fail(f"out of memory: {error}")
        # Print it while control characters are escaped; Python would print it after the streams are restored.
        print(traceback.format_exc(), end="", file=sys.stderr)
        return FAILED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="warpcontact",
        description="Contact dynamics on oriented triangle meshes, thousands of environments at once.",
    )
    parser.add_argument("--version", action="version", version=f"warpcontact {__version__}")
    parser.set_defaults(command=_work)
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="run an experiment file", description="Run an experiment file.")
    going = run.add_mutually_exclusive_group()
    going.add_argument("--overwrite", action="store_true", help="replace an earlier run in the folder")
    going.add_argument("--resume", action="store_true", help="resume the run in the folder (FILE not needed)")
    run.add_argument(
        "--ray",
        nargs="?",
        const=True,
        default=False,
        metavar="ADDRESS",
        help="run shards as Ray tasks: on this machine, or on the cluster with this address",
    )
    run.add_argument(
        "--checkpoint",
        type=float,
        default=60.0,
        metavar="S",
        help="seconds between checkpoints of a shard (default: 60)",
    )
    run.add_argument("--threads", type=int, metavar="N", help="threads on the CPU (default: one per core)")
    run.set_defaults(command=_run, usage=run)

    plan = commands.add_parser(
        "plan",
        help="memory, disk space, time and shards of a run",
        description="Estimate memory, disk space and time of running an experiment file, and its shards. Exit code "
        "1: it does not fit.",
    )
    plan.add_argument("--no-probe", dest="probe", action="store_false", help="do not measure; omit the time")
    plan.set_defaults(command=_plan)
    for command in (run, plan):
        command.add_argument(
            "file", metavar="FILE", nargs="?" if command is run else None, help="the experiment, a TOML file"
        )
        command.add_argument(
            "--out",
            metavar="DIR",
            help="folder for the results (default: results/<name of the experiment>)"
            + (", whose free disk space is shown; nothing is written" if command is plan else ""),
        )
        command.add_argument(
            "--envs", type=int, metavar="N", help="number of environments instead of that in the file"
        )
        command.add_argument(
            "--duration", type=float, metavar="S", help="simulated seconds instead of those in the file"
        )
        command.add_argument(
            "--set",
            action="append",
            default=[],
            metavar="PATH=VALUE",
            help="a value instead of that in the file, such as body.ball.mass=2.0; may be given several times",
        )
        command.add_argument(
            "--device",
            default="auto",
            metavar="D",
            help="cpu, cuda:0, …; cuda: all GPUs; or several, such as cuda:0,cuda:2 (default: auto, one GPU if "
            "any)",
        )
        command.add_argument(
            "--shard",
            type=int,
            metavar="N",
            help="maximum number of environments per shard, which are committed together (default: as many as fit)",
        )
        add_trust_option(command)

    inspect = commands.add_parser(
        "inspect", help="report on a mesh file", description="Report on a mesh file. Exit code 1: unusable."
    )
    inspect.add_argument(
        "mesh", metavar="MESH", help="an .stl, .obj, .ply, .off, .glb, .usd, .usda, .usdc or .usdz file"
    )
    inspect.add_argument(
        "--scale", type=float, default=1.0, metavar="X", help="factor on all lengths (default: 1)"
    )
    inspect.add_argument(
        "--unit", metavar="U", help="unit of the file, such as mm, cm, in (default: its own, or m)"
    )
    inspect.add_argument("--prim", metavar="PATH", help="prim of a USD file (default: all meshes)")
    inspect.add_argument(
        "--repair", metavar="STEPS", help="report on the repaired mesh: all, or steps such as merge,orient"
    )
    inspect.add_argument(
        "--tolerance",
        type=float,
        default=1e-6,
        metavar="X",
        help="tolerance of merge, relative to the size (default: 1e-6)",
    )
    inspect.add_argument(
        "--trusted", action="store_true", help="read the file without limits on time, memory and other files"
    )
    inspect.add_argument("--plot", metavar="FILE", help="draw the mesh and its defects into an .svg or .png file")
    active = inspect.add_mutually_exclusive_group()
    active.add_argument(
        "--active",
        metavar="GROUP",
        nargs="+",
        help="groups of active faces: report their area, and draw the others pale",
    )
    active.add_argument(
        "--active-faces",
        metavar="N",
        nargs="+",
        type=int,
        help="numbers of active faces, from 0, instead of groups",
    )
    inspect.set_defaults(command=_inspect)

    for module in (laws, bench, build_kernels, render, run_folders, view):
        module.add_to(commands)
    return parser


def _fail(message: str) -> int:
    print(f"warpcontact: {message}", file=sys.stderr)
    return WRONG_USE


def _sentence(error: OSError) -> str:
    from warpcontact.system.initialization import explained

    return str(explained(error))


@dataclass
class _RunContext:
    """State of the command ``run``, for the message if it is interrupted.

    Attributes:
        resumed: Folder of the run that is resumed; ``None``: a new run.
        folder: Folder of the results, once it is known.
        before: Content of ``run.json`` of an earlier run in the folder.
    """

    resumed: Path | None
    folder: Path | None = None
    before: dict[str, Any] | None = None

    def __str__(self) -> str:
        """Returns the text after ``interrupted``."""
        if self.folder is None:
            return " before anything was " + (f"done{_resume(self.resumed)}" if self.resumed else "saved")
        from warpcontact.experiment.folder import DATA, FINISHED, read_summary
        from warpcontact.files.run_folder import RunPath

        summary = read_summary(self.folder)
        if self.resumed is None and summary == self.before:
            return f" before anything was saved{f'; {self.folder} is unchanged' if summary else ''}"
        if summary is None or not (RunPath(self.folder) / DATA).is_folder():
            return " before anything was saved"
        done = "the results are complete" if summary.get("state") == FINISHED else "completed steps are saved"
        return f"; {done}{_resume(self.folder)}"


def _run(arguments: argparse.Namespace) -> int:
    if arguments.file is None and not (arguments.resume and arguments.out):
        arguments.usage.error("the following arguments are required: FILE (unless --resume --out DIR)")
    context = _RunContext(Path(arguments.out) if arguments.resume and arguments.out else None)
    with terminate_as_interrupt():
        try:
            return _run_experiment(arguments, context)
        except KeyboardInterrupt:
            print(f"\nwarpcontact: interrupted{context}", file=sys.stderr)
            return INTERRUPTED


def _run_experiment(arguments: argparse.Namespace, context: _RunContext) -> int:
    import warnings

    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    from warpcontact.experiment import ExperimentError, RunDataError
    from warpcontact.experiment.folder import DATA, EXPERIMENT, check_usable, has_commits, read_summary
    from warpcontact.files.run_folder import RunPath
    from warpcontact.model.quarantine import QuarantineError

    def warn(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    try:
        if arguments.file is None:
            check_usable(Path(arguments.out), overwrite=False, resume=True)
            arguments.file = Path(arguments.out) / EXPERIMENT
        folder = _results(arguments)
        context.resumed = folder if arguments.resume else None
        # Before the validation of the experiment, which may compile kernels.
        check_usable(folder, overwrite=arguments.overwrite, resume=arguments.resume)
        experiment = _experiment(arguments)
        context.before, context.folder = read_summary(folder), folder
        with warnings.catch_warnings(), _name_option(arguments, experiment):
            # The printed result has the number of frozen environments.
            warnings.filterwarnings("ignore", message=".* and are frozen", category=RuntimeWarning)
            result = experiment.run(
                folder,
                device=device_of(arguments),
                overwrite=arguments.overwrite,
                resume=arguments.resume,
                ray=arguments.ray,
                shard=arguments.shard,
                threads=arguments.threads,
                checkpoint=arguments.checkpoint,
                on_stage=print_stage,
                on_warning=warn,
            )
    except (ExperimentError, RunDataError, QuarantineError) as error:
        return _fail(str(error))
    except OSError as error:
        code = _fail(_sentence(error))
        for note in getattr(error, "__notes__", ()):
            _fail(note)
        if context.folder is not None and (RunPath(context.folder) / DATA).is_real_folder():
            saved = "committed results are saved" if has_commits(context.folder) else "nothing is saved yet"
            _fail(f"{saved}{_resume(context.folder)}")
        return code
    print(result)
    return SHARDS_FAILED if result.summary.get("failed") else 0


def _resume(folder: Path) -> str:
    return f" in {folder}; to resume:\n    warpcontact run --resume --out {shlex.quote(str(folder))}"


def _plan(arguments: argparse.Namespace) -> int:
    import warnings

    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    from warpcontact.experiment import ExperimentError
    from warpcontact.model.quarantine import QuarantineError
    from warpcontact.storage.memory_estimate import MemoryShortage

    try:
        experiment = _experiment(arguments)
        with _name_option(arguments, experiment):
            plan = experiment.plan(device=device_of(arguments), shard=arguments.shard, out=_results(arguments))
    except ExperimentError as error:
        return _fail(str(error))
    except MemoryShortage as error:
        print(error)
        return FAILED
    print(plan, flush=True)
    if plan.shard and arguments.probe:
        print_stage("measuring")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a run gives them
            try:
                print(experiment.probe(device=device_of(arguments), shard=plan.shard))
            except QuarantineError as error:
                return _fail(str(error))
    return 0 if plan.shard else FAILED


def _experiment(arguments: argparse.Namespace) -> "Experiment":
    """Reads the experiment of a command and applies its options."""
    from warpcontact.experiment import Experiment

    print_stage(f"reading {arguments.file}")
    experiment = Experiment.from_toml(
        arguments.file, changes=arguments.set, on_stage=print_stage, trust=arguments.trust
    )
    for option in ("envs", "duration"):
        value = getattr(arguments, option)
        with _name_source(f"--{option} {value}", experiment.source):
            experiment = experiment.changed(**{option: value})
    return experiment


def _results(arguments: argparse.Namespace) -> Path:
    """Returns the folder for the results of an experiment, without validating it."""
    from warpcontact.experiment.experiment import read_content

    if arguments.out:
        return Path(arguments.out)
    name = str(read_content(Path(arguments.file), arguments.set)["name"])
    return Path("results", re.sub(r"[^\w.-]+", "_", name).strip("._") or "experiment")


def _name_option(arguments: argparse.Namespace, experiment: "Experiment") -> AbstractContextManager[None]:
    """Names the invalid option in errors of a run: ``--shard``, ``--threads``, ``--checkpoint``, else ``--device``."""
    given = vars(arguments)
    wrong = {
        "shard": given["shard"] is not None and given["shard"] < 1,
        "threads": (given.get("threads") or 1) < 1 or given.get("threads") == 0,
        "checkpoint": not given.get("checkpoint", 0.0) >= 0.0,
    }
    option = next((f"--{name} {given[name]}" for name, is_wrong in wrong.items() if is_wrong), None)
    option = option or f"--device {arguments.device}"
    return _name_source(option, experiment.source)


@contextmanager
def _name_source(option: str, source: str) -> Iterator[None]:
    """Names ``option`` in errors instead of the file, which is valid without the option."""
    from warpcontact.experiment import ExperimentError

    try:
        yield
    except ExperimentError as error:
        if error.source != source:
            raise
        raise ExperimentError(option, error.problems) from None


def _inspect(arguments: argparse.Namespace) -> int:
    from warpcontact.files.picture_file import check_path
    from warpcontact.meshes import MeshError, examine_file, plot_file

    options = {name: getattr(arguments, name) for name in ("scale", "unit", "prim", "tolerance", "trusted")}
    options["repair"] = arguments.repair.split(",") if arguments.repair else False
    options["active_faces"] = arguments.active or arguments.active_faces
    try:
        if arguments.plot:
            check_path(arguments.plot)
        report = examine_file(arguments.mesh, **options)
    except (MeshError, ValueError) as error:
        option = "--active" if arguments.active else "--active-faces"
        return _fail(re.sub("^active_faces", option, str(error)))
    if not report.vertex_count and not report.face_count:  # nothing could be read
        for problem in report.errors:
            print(f"warpcontact: {arguments.mesh}: {problem}", file=sys.stderr)
        return FAILED
    print(report.to_text())
    if arguments.plot:
        try:
            plot_file(arguments.mesh, arguments.plot, **options)
            print(f"picture: {arguments.plot}")
        except ValueError as error:
            code = _fail(str(error))
            return code if report.usable else FAILED
    return 0 if report.usable else FAILED


def _work(arguments: argparse.Namespace) -> int:
    """Calls the function ``work`` of a command of another module."""
    import warp as wp

    # Keep standard output free of messages about kernels and devices.
    wp.config.log_level = wp.LOG_ERROR
    try:
        return arguments.work(arguments) or 0
    except ValueError as error:
        return _fail(str(error))
