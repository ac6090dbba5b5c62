"""Progress and warnings of a run: progress bar, progress files for other processes, status from the run folder."""

import contextlib
import json
import os
import re
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any

from warpcontact.experiment import folder as files_of
from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.folder import PROGRESS, is_locked
from warpcontact.experiment.store import Commit, Ledger, Shard, Shards
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import RunPath
from warpcontact.meshes.report import MeshReport
from warpcontact.storage.memory_estimate import env_count_text
from warpcontact.validation.number_format import duration_text
from warpcontact.validation.safe_text import escape_lines, terminal
from warpcontact.validation.warning_levels import RunWarning, WarningLevel, labeled

# Smallest time between updates [s].
INTERVAL = 1.0
# Largest size of a progress file that is read [bytes].
MAX_PROGRESS_FILE = 2**16

_FILE = re.compile(r"shard_(\d{6,})\.json")

# Progress files older than this are ignored [s].
PROGRESS_TIMEOUT = 60.0


class WarningLog:
    """Collects warnings, without duplicates.

    Args:
        on_warning: Called with each warning; ``None``: Python warnings are also shown as usual.

    Attributes:
        lines: The warnings, each prefixed with its level: ``caution: …``.
    """

    def __init__(self, on_warning: Callable[[str], None] | None) -> None:
        self.lines: list[str] = []
        self.on_warning = on_warning

    def add(self, warning: Warning) -> None:
        """Adds a warning, unless it was added before."""
        line = labeled(warning)
        if line not in self.lines:
            self.lines.append(line)
            if self.on_warning is not None:
                self.on_warning(line)

    def add_mesh(self, file: str, report: MeshReport) -> None:
        """Adds the warnings of a mesh file, and the changes of a repair."""
        for step in report.repairs:
            if step.count:
                self.add(RunWarning(f"mesh file {file!r}: {step.text}", WarningLevel.NOTE))
        for text in report.warnings:
            self.add(RunWarning(f"mesh file {file!r}: {text}"))

    @contextmanager
    def collect_warnings(self) -> Iterator[None]:
        """Adds Python warnings that are given within the block; filters are unchanged."""
        with warnings.catch_warnings():
            show = warnings.showwarning

            def add_warning(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
                is_collected = issubclass(category, UserWarning | RuntimeWarning)
                if is_collected:
                    self.add(message)
                if not is_collected or self.on_warning is None:
                    show(message, category, *where, **more)

            warnings.showwarning = add_warning
            yield


class ProgressBar:
    """A progress bar over the steps of all environments of a run, with the numbers of finished and frozen ones.

    Args:
        envs: Number of environments.
        steps: Steps of each environment.
        shards: Number of shards.
        show: Whether to show it; ``None``: on runs of over a second, in a terminal.
    """

    def __init__(self, envs: int, steps: int, shards: int, show: bool | None) -> None:
        from tqdm import tqdm

        several = f" in {shards} shards" if shards > 1 else ""
        self._bar = tqdm(
            total=envs * steps,
            unit="step",
            unit_scale=True,
            desc=f"{env_count_text(envs)}{several}",
            delay=1.0,
            disable=None if show is None else not show,
            file=terminal(),
        )
        self._envs = envs
        self._steps = steps
        self._done: dict[int, int] = {}
        self._finished = 0
        self._frozen: dict[int, int] = {}

    def begin(self, shards: Iterable[Shard], commits: Mapping[int, Commit]) -> None:
        """Adds the committed steps of earlier attempts."""
        done = 0
        for shard in shards:
            commit = commits.get(shard.number)
            if commit is not None:
                self._done[shard.number] = commit.steps
                self._frozen[shard.number] = commit.frozen
                self._finished += shard.envs * commit.finished
                done += shard.envs * commit.steps
        self._bar.initial = self._bar.n = done
        self._update_postfix()

    def update(self, shard: Shard, steps: int, frozen: int = 0) -> None:
        """Updates the number of steps of a shard, and of its frozen environments."""
        before = self._done.get(shard.number, 0)
        self._done[shard.number], self._frozen[shard.number] = steps, frozen
        self._update_postfix()
        self._bar.update(shard.envs * (steps - before))

    def finish(self, shard: Shard, frozen: int) -> None:
        """Updates a shard that is finished, with the number of its frozen environments."""
        self._finished += shard.envs
        self.update(shard, self._steps, frozen)

    def _update_postfix(self) -> None:
        content = {"finished": f"{self._finished}/{self._envs}"}
        if frozen := sum(self._frozen.values()):
            content["frozen"] = str(frozen)
        self._bar.set_postfix(content, refresh=False)

    def __enter__(self) -> "ProgressBar":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()


class ProgressFile:
    """Writes the progress of a shard to a file in the run folder, at most once per ``INTERVAL``."""

    def __init__(self, folder: Path, shard: Shard) -> None:
        self._path = RunPath(folder) / PROGRESS / f"{shard.name}.json"
        self._last = 0.0

    def write(self, steps: int) -> bool:
        """Writes the number of steps if ``INTERVAL`` has passed; returns whether it has."""
        now = time.monotonic()
        if now - self._last < INTERVAL:
            return False
        self._last = now
        # Errors are ignored: progress is not essential.
        with contextlib.suppress(OSError), self._path.replacement_file(wait=False) as file:
            content = {"steps": steps, "time": time.time(), "process": os.getpid()}
            file.write(json.dumps(content).encode())
        return True

    def remove(self) -> None:
        """Removes the file."""
        self._path.remove()


def read_progress(folder: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Iterates over the shards that report progress, by number.

    Raises:
        UnsafeFileError: If a progress file is a link, a pipe or a device, or is too large.
    """
    progress = RunPath(folder) / PROGRESS
    for name in progress.names():
        number = _FILE.fullmatch(name)
        if number is None:
            continue
        try:
            content = json.loads((progress / name).read(MAX_PROGRESS_FILE))
            found = {"steps": int(content["steps"]), "time": float(content["time"])}
        except UnsafeFileError:
            raise
        except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
            continue
        yield int(number[1]), found


@dataclass(frozen=True)
class RunStatus:
    """Progress of a run; ``print`` shows it.

    Attributes:
        folder: Folder of the run.
        summary: Content of ``run.json``.
        state: ``"running"``, ``"finished"``, ``"interrupted"``, ``"failed"``, or ``"stopped"`` (killed).
        shards: Number of shards.
        finished_shards: Number of finished shards.
        finished_envs: Number of finished environments.
        env_steps: Number of committed environment steps.
        running_steps: The same, including the progress of running shards.
        frozen: Number of frozen environments as of the commits.
        wall_time: Committed wall time of stepping, summed over all shards [s].
    """

    folder: Path
    summary: dict[str, Any]
    state: str
    shards: int
    finished_shards: int
    finished_envs: int
    env_steps: int
    running_steps: int
    frozen: int
    wall_time: float

    @property
    def total(self) -> int:
        """Number of environment steps of the whole run."""
        return int(self.summary["envs"]) * int(self.summary["steps"])

    @property
    def rate(self) -> float:
        """Environment steps per second of stepping; 0 if nothing is committed yet."""
        return self.env_steps / self.wall_time if self.wall_time > 0.0 else 0.0

    def __str__(self) -> str:
        s = self.summary
        lines = [
            f"{s['name']}: {self.state}, {self.running_steps / self.total:.1%} of {s['envs']} environments × "
            f"{s['steps']} steps",
            f"finished: {self.finished_envs} of {s['envs']} environments, {self.finished_shards} of {self.shards} "
            f"shard{'s' if self.shards > 1 else ''}",
            f"committed: {self.env_steps / self.total:.1%}",
        ]
        if self.frozen:
            lines.append(f"frozen: {self.frozen} environments")
        if self.rate:
            left = (self.total - self.running_steps) / self.rate
            more = f", {duration_text(left)} of stepping left" if left > 0.0 else ""
            lines.append(f"{self.rate:.3g} environment steps per second of a shard{more}")
        lines += [f"{shard} failed: {message}" for shard, message in s.get("failed", {}).items()]
        if self.state in ("interrupted", "failed", "stopped"):
            lines.append(f"to resume: warpcontact run --resume --out {self.folder}")
        return escape_lines(lines)


def run_status(path: str | PathLike[str]) -> RunStatus:
    """Returns the progress of the run in a folder.

    Raises:
        ExperimentError: If the folder holds no run, or its schema is not supported by this version.
        RunDataError: If a record in it is damaged.
    """
    folder = Path(path)
    summary = files_of.read_summary(folder)
    if summary is None:
        raise ExperimentError(str(folder), ["holds no run"])
    files_of.check_schema(folder, summary)
    shards = Shards(summary["envs"], summary["shard"])
    commits = {number: one for number, one in Ledger(folder).commits().items() if number < len(shards)}
    steps = {number: commit.steps for number, commit in commits.items()}
    running = dict(steps)
    now = time.time()
    for number, content in read_progress(folder):
        if number < len(shards) and now - float(content["time"]) < PROGRESS_TIMEOUT:
            running[number] = max(running.get(number, 0), int(content["steps"]))
    finished = [shards[number] for number, commit in commits.items() if commit.finished]
    state = summary["state"]
    if state == files_of.UNFINISHED:
        state = "running" if is_locked(folder) else "stopped"
    return RunStatus(
        folder=folder,
        summary=summary,
        state=state,
        shards=len(shards),
        finished_shards=len(finished),
        finished_envs=sum(shard.envs for shard in finished),
        env_steps=sum(shards[number].envs * count for number, count in steps.items()),
        running_steps=sum(shards[number].envs * count for number, count in running.items()),
        frozen=sum(commit.frozen for commit in commits.values()),
        wall_time=sum(commit.wall_time for commit in commits.values()),
    )
