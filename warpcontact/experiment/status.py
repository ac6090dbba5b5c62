"""Determines the progress of a run from its folder."""

import time
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from warpcontact.experiment import folder as files_of
from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.lock import is_locked
from warpcontact.experiment.progress import read_progress
from warpcontact.experiment.store import Ledger, Shards
from warpcontact.experiment.time_estimate import duration_text
from warpcontact.validation.safe_text import escape_lines

# Progress files older than this are ignored [s].
PROGRESS_TIMEOUT = 60.0


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
