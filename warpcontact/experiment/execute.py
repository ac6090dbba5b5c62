"""Runs an experiment from its start or its last commit to the end.

``start`` creates the folder and the empty store, ``run_remaining`` runs the unfinished shards and retries those that
fail, and writes ``run.json``, the picture and the animation when all are finished. The shards run in this process
(``run_in_process``) or in worker processes of a cluster (``run_shard``, see ``cluster.py``).
"""

import contextlib
import datetime
import errno
import platform
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warpcontact._version import __version__
from warpcontact.building.scene import Scene
from warpcontact.experiment import folder as files_of
from warpcontact.experiment import store, user_code
from warpcontact.experiment.design import Design
from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.experiment_copy import ExperimentCopy, differences, fingerprint, to_toml
from warpcontact.experiment.folder import write_lock
from warpcontact.experiment.plan import DRAWN_AT_ONCE, Plan, find_disk
from warpcontact.experiment.progress import ProgressBar, WarningLog
from warpcontact.experiment.records import RunExtent
from warpcontact.experiment.run import Run, open_run
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.shards import ATTEMPTS, SeriesSchedule, ShardRunner
from warpcontact.experiment.store import Commit, Ledger, RunDataError, Shard, Shards
from warpcontact.files.run_folder import RunPath
from warpcontact.model.environments import Environments
from warpcontact.model.quarantine import QuarantineError
from warpcontact.storage.memory_estimate import env_count_text
from warpcontact.validation.number_format import format_bytes
from warpcontact.validation.warning_levels import RunWarning, WarningLevel, labeled

# The disk or the quota of the user is full.
_DISK_FULL = (errno.ENOSPC, errno.EDQUOT)


@dataclass(frozen=True)
class RunJob:
    """An experiment and the settings of its run.

    Attributes:
        settings: The experiment, with all defaults.
        scene: The scene.
        design: The varied parameters.
        plan: Number and size of the shards.
        copy: The experiment as it is saved in the folder.
        folder: Folder of the results.
        progress: Whether to show a progress bar; ``None``: on runs of over a second, in a terminal.
        on_stage: Called when a stage that may take long begins.
        warning_log: Receives warnings.
        checkpoint_interval: Time between checkpoints [s].
        threads: Number of CPU threads that step environments; ``None``: one per core.
    """

    settings: Settings
    scene: Scene
    design: Design
    plan: Plan
    copy: ExperimentCopy
    folder: Path
    progress: bool | None
    on_stage: Callable[[str], None]
    warning_log: WarningLog
    checkpoint_interval: float
    threads: int | None = None

    @property
    def frames(self) -> SeriesSchedule:
        """Schedule of the recorded frames."""
        return SeriesSchedule.of(self.settings, self.plan.block)

    @property
    def shards(self) -> Shards:
        """All shards."""
        return Shards(self.plan.envs, self.plan.shard)

    @property
    def laws(self) -> tuple[str, ...]:
        """SHA-256 of the law files of the experiment. Files of the folder with this content are trusted."""
        return tuple(user_code.digest_of(content) for content in self.copy.files.values())

    def runner(self, model: Environments) -> ShardRunner:
        """Returns a runner of shards on ``model``."""
        return ShardRunner(
            model, self.settings, self.design, self.frames, self.folder, self.checkpoint_interval, self.threads
        )


#: Runs shards, given the unfinished ones, the commits by shard number and the progress bar. Returns the error messages
#: of shards whose last attempt failed, by shard name.
ShardRunFunction = Callable[[Iterable[Shard], Mapping[int, Commit], ProgressBar], dict[str, str]]


def start(runner: ShardRunner, job: RunJob, exit_stack: contextlib.ExitStack) -> None:
    """Creates the folder of a new run with an empty store, and locks it until ``exit_stack`` closes.

    Raises:
        ValueError: If a value does not fit into the precision of the device; nothing is removed then.
        ExperimentError: If the name of a variable is too long; nothing is removed then.
    """
    # Load all shards, so that values that do not fit are found now. The first shard is loaded last.
    for shard in reversed(job.shards):
        runner.load_shard(shard)
    store.check_names(runner.data_layouts(), str(job.folder))
    with _name_folder_in_errors(job):
        RunPath(job.folder).make()
        exit_stack.enter_context(write_lock(job.folder))
        _make_folder(runner, job)


def _make_folder(runner: ShardRunner, job: RunJob) -> None:
    folder, settings = job.folder, job.settings
    files_of.clear(folder)
    files_of.write_summary(folder, _first_summary(runner.model, job))
    comment = f"The experiment as warpcontact {__version__} ran it, with all defaults."
    text = to_toml(job.copy.settings, comment).encode()
    user_code.record_trusted(job.copy.files.values())
    for name, content in {files_of.EXPERIMENT: text, **job.copy.files}.items():
        with (RunPath(folder) / name).replacement_file() as file:
            file.write(content)
    files_of.make_subfolders(folder)
    frames = job.frames
    attributes = {
        "source": f"warpcontact {__version__}",
        "precision": settings.precision,
        "dt": settings.dt,
        "integrator": settings.integrator.type,
        "name": settings.name,
        "seed": settings.seed,
    }
    if settings.integrator.iterations is not None:
        attributes["iterations"] = settings.integrator.iterations
    if settings.integrator.compliant:
        attributes["compliant"] = list(settings.integrator.compliant)
    times = frames.times(settings.dt)
    store.create(folder, runner.data_layouts(), settings.envs, times, frames.block, attributes)


def check_resumable(summary: Mapping[str, Any], job: RunJob) -> None:
    """Raises ``ExperimentError`` unless ``job`` is the experiment of the run with ``summary``."""
    if summary.get("fingerprint") == fingerprint(job.copy):
        return
    changed = differences(RunPath(job.folder) / files_of.EXPERIMENT, job.copy.settings)
    raise ExperimentError(
        str(job.folder),
        [
            "holds the run of another experiment: "
            + ("; ".join(changed) if changed else "files that it names have changed since")
        ],
    )


def all_finished(folder: Path, summary: Mapping[str, Any]) -> bool:
    """Whether all shards of the run of ``summary`` are finished; its picture and animation may be missing.

    Raises:
        RunDataError: If the record of a shard is damaged.
    """
    commits = Ledger(folder).commits()
    return all(_is_finished(commits, shard) for shard in Shards(summary["envs"], summary["shard"]))


def run_remaining(job: RunJob, run_shards: ShardRunFunction) -> Run:
    """Runs all unfinished shards, and finishes the run if none failed.

    Raises:
        KeyboardInterrupt: If the run is interrupted; the steps taken so far are committed.
        OSError: For example if the disk is full; the last commits remain valid.
    """
    with _name_folder_in_errors(job):
        return _run_remaining(job, run_shards)


def _run_remaining(job: RunJob, run_shards: ShardRunFunction) -> Run:
    folder = job.folder
    files_of.make_subfolders(folder)
    ledger = Ledger(folder)
    ledger.check(RunExtent(job.plan.envs, job.plan.shard, job.frames.steps), checkpoints=False)
    commits = ledger.commits()
    # Remove progress files of processes that were killed.
    progress = RunPath(folder) / files_of.PROGRESS
    for name in progress.names():
        (progress / name).remove()
    summary = (files_of.read_summary(folder) or {}) | {
        "state": files_of.UNFINISHED,
        "host": platform.node(),
    }
    for key in ("failed", "error"):
        summary.pop(key, None)
    before = summary.get("warnings", [])

    def warned() -> list[str]:
        """Returns the warnings of this attempt and of earlier ones."""
        return list(dict.fromkeys([*before, *job.warning_log.lines]))

    files_of.write_summary(folder, summary)
    shards = job.shards
    for shard in shards:
        ledger.recover(shard, commits.get(shard.number, Commit(shard.number)))
    remaining = [shard for shard in shards if not _is_finished(commits, shard)]
    _warn_about_disk(job, remaining, commits)
    try:
        with ProgressBar(job.plan.envs, job.frames.steps, len(shards), job.progress) as bar:
            bar.begin(shards, commits)
            failed = run_shards(remaining, commits, bar)
    except BaseException as error:
        stopped = isinstance(error, KeyboardInterrupt)
        ended = {"state": files_of.INTERRUPTED} if stopped else {"state": files_of.FAILED, "error": str(error)}
        # If the disk is full, run.json is unchanged; the commits are sufficient to resume.
        with contextlib.suppress(OSError):
            files_of.write_summary(folder, summary | ended | {"warnings": warned()})
        raise
    if failed:
        summary |= {"state": files_of.FAILED, "failed": failed, "warnings": warned()}
        files_of.write_summary(folder, summary)
        return open_run(folder, trust=job.laws)
    return _finish_run(job, summary, warned)


@contextlib.contextmanager
def _name_folder_in_errors(job: RunJob) -> Iterator[None]:
    """Adds the folder to errors that name no file, and the required disk space to those of a full disk."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            error.filename = str(job.folder)
        if error.errno in _DISK_FULL:
            error.add_note(_disk_requirement(job))
        raise


def _disk_requirement(job: RunJob) -> str:
    """Returns the disk space that a shard of ``job`` requires, as text."""
    plan, disk = job.plan, find_disk(job.folder)
    note = "" if files_of.has_commits(job.folder) else "nothing is committed yet; "
    size = f"{format_bytes(plan.on_disk(plan.shard))} of results before compression"
    free = "" if disk is None else f"; {disk}"
    return f"{note}a shard of {env_count_text(plan.shard)} takes up to {size}, plus its checkpoints{free}"


def _warn_about_disk(job: RunJob, remaining: Iterable[Shard], commits: Mapping[int, Commit]) -> None:
    """Warns if the disk has less free space than the remaining results may take."""
    disk, steps = find_disk(job.folder), job.frames.steps
    done = {shard.number: commits[shard.number].steps for shard in remaining if shard.number in commits}
    size = sum(job.plan.on_disk(shard.envs) * (1 - done.get(shard.number, 0) / steps) for shard in remaining)
    if disk is not None and disk.free < size:
        text = (
            f"the {'remaining ' if commits else ''}results take up to {format_bytes(size)} before compression, "
            f"and {disk}: the disk may be full before the run ends"
        )
        warnings.warn(RunWarning(text), stacklevel=4)


def run_in_process(runner: ShardRunner, job: RunJob) -> ShardRunFunction:
    """Returns a function that runs shards in this process, one after another."""

    def run(remaining: Iterable[Shard], commits: Mapping[int, Commit], bar: ProgressBar) -> dict[str, str]:
        failed = {}
        job.on_stage(f"compiling for {', '.join(map(str, runner.model.devices))}")
        runner.warm_up()
        plan = job.plan
        job.on_stage(
            "running" + (f" {plan.shards} shards of {plan.shard} environments" if plan.shards > 1 else "")
        )
        for shard in remaining:
            message = run_with_retries(
                runner, shard, commits.get(shard.number), bar, single_shard=len(job.shards) == 1
            )
            if message is not None:
                failed[shard.name] = message
        return failed

    return run


def run_with_retries(
    runner: ShardRunner, shard: Shard, commit: Commit | None, bar: ProgressBar, *, single_shard: bool
) -> str | None:
    """Runs a shard, with several attempts; returns the error message of the last one, or ``None``.

    Args:
        runner: Runner of shards.
        shard: The shard.
        commit: Its last commit; ``None``: it has none.
        bar: Progress bar.
        single_shard: Whether the run has only this shard. Its first error is then raised.
    """
    for number in range(ATTEMPTS):
        try:
            ended = runner.run(shard, commit, lambda done, frozen: bar.update(shard, done, frozen))
            bar.finish(shard, ended.frozen)
            return None
        except (KeyboardInterrupt, RunDataError, QuarantineError):
            raise
        except OSError:
            raise  # a full disk fails for all shards
        except Exception as error:
            if single_shard:
                raise
            if number == ATTEMPTS - 1:
                return f"{type(error).__name__}: {error}"
            warnings.warn(RunWarning(f"{shard.name} is retried: {error}", WarningLevel.NOTE), stacklevel=2)
            commit = runner.ledger.commits().get(shard.number)
            runner.ledger.recover(shard, commit or Commit(shard.number))
    return None


#: The shard runner of this worker process, reused for several shards of a run.
_RUNNERS: dict[tuple[str, str, str, int, float], ShardRunner] = {}


def run_shard(
    number: int, folder: str, device: str, threads: int, checkpoint_interval: float, laws: tuple[str, ...]
) -> tuple[int, list[str]]:
    """Runs a shard of the run in a folder; the function of a Ray task.

    Returns:
        Number of frozen environments, and warnings with their levels as prefix.
    """
    wp.config.log_level = wp.LOG_ERROR
    path = Path(folder)
    summary = files_of.read_summary(path) or {}
    key = (folder, str(summary.get("started")), device, threads, checkpoint_interval)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if key not in _RUNNERS:
            _RUNNERS.clear()
            _RUNNERS[key] = _worker_runner(path, summary, device, threads, checkpoint_interval, laws)
        runner = _RUNNERS[key]
        shard = Shards(summary["envs"], summary["shard"])[number]
        commit = runner.ledger.commits().get(number)
        runner.ledger.recover(shard, commit or Commit(number))
        commit = runner.run(shard, commit)
    kinds = UserWarning | RuntimeWarning
    return commit.frozen, [labeled(one.message) for one in caught if issubclass(one.category, kinds)]


def _worker_runner(
    folder: Path,
    summary: Mapping[str, Any],
    device: str,
    threads: int,
    checkpoint_interval: float,
    laws: tuple[str, ...],
) -> ShardRunner:
    experiment = open_run(folder, trust=laws).experiment
    settings = experiment.settings
    model = experiment.draft(device).build(summary["shard"])
    frames = SeriesSchedule.of(settings, summary["block"])
    return ShardRunner(model, settings, experiment.design, frames, folder, checkpoint_interval, threads)


def _is_finished(commits: Mapping[int, Commit], shard: Shard) -> bool:
    return shard.number in commits and commits[shard.number].finished


def _first_summary(model: Environments, job: RunJob) -> dict[str, Any]:
    settings, frames = job.settings, job.frames
    laws = {name: user_code.digest_of(content) for name, content in job.copy.files.items()}
    return {
        "state": files_of.UNFINISHED,
        "name": settings.name,
        "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": {
            "warpcontact": __version__,
            "warp": wp.config.version,
            "numpy": np.__version__,
            "python": platform.python_version(),
        },
        "machine": platform.platform(),
        "host": platform.node(),
        "device": ", ".join(str(one) if one.is_cpu else f"{one} ({one.name})" for one in model.devices),
        "precision": settings.precision,
        "seed": settings.seed,
        "envs": settings.envs,
        "shard": job.plan.shard,
        "shards": len(job.shards),
        "block": frames.block,
        "dt": settings.dt,
        "duration": float(f"{frames.steps * settings.dt:.12g}"),
        "steps": frames.steps,
        "integrator": settings.integrator.type,
        "fingerprint": fingerprint(job.copy),
        files_of.LAW_FILES: laws,
    }


def _finish_run(job: RunJob, summary: dict[str, Any], warned: Callable[[], list[str]]) -> Run:
    """Writes that the run is finished, then its picture and animation."""
    folder = job.folder
    commits = Ledger(folder).commits()
    wall_time = sum(commit.wall_time for commit in commits.values())
    run = Run(folder, summary, job.scene, job.laws)
    health = run.health
    if not health.good:
        warnings.warn(RunWarning(str(health), WarningLevel.ERROR), stacklevel=4)
    summary = summary | {
        "state": files_of.FINISHED,
        "wall_time": wall_time,
        "env_steps_per_second": summary["envs"] * summary["steps"] / max(wall_time, 1.0e-9),
        "frozen_environments": health.frozen.tolist(),
        "contact_couplings": {report.name: str(report).split("\n") for report in run.reports},
        "warnings": warned(),
    }
    files_of.write_summary(folder, summary)
    files_of.remove_work_subfolders(folder)
    job.on_stage("writing")
    run = Run(folder, summary, job.scene, job.laws)
    try:
        _write_views(run, job)
    except Exception as error:
        # The results are complete without them.
        warnings.warn(RunWarning(f"no picture or animation of the results: {error}"), stacklevel=4)
    if warned() != summary["warnings"]:
        summary["warnings"] = warned()
        files_of.write_summary(folder, summary)
    return run


def _write_views(run: Run, job: RunJob) -> None:
    """Writes the picture and, with series, the animation."""
    import zarr

    from warpcontact.experiment.picture import write_outcome_picture, write_picture

    settings, files = job.settings, RunPath(run.folder)
    if not settings.record.series:
        write_outcome_picture(files / files_of.PICTURE, run.outcome, settings.name)
        return
    recording = run.recording
    usd_envs = min(settings.output.usd_envs, settings.envs)
    # Zarr reads 64 chunks at a time by default; chunks of all environments would then be in memory together.
    with zarr.config.set({"async.concurrency": DRAWN_AT_ONCE}):
        if usd_envs:
            from warpcontact.usd import export_usd

            # Only the first environments: an export of all could take longer than the run.
            animation = (files / files_of.ANIMATION).path
            # Pressures take most of the space, and kernels are compiled for them.
            export_usd(recording, animation, envs=range(usd_envs), ensemble=False, pressure=False, progress=False)
        write_picture(files / files_of.PICTURE, recording, settings.name, list(job.design.names), run.health)
