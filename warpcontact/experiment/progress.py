"""Reports the progress of a run: as a progress bar in the terminal, and as files for other processes."""

import contextlib
import json
import os
import re
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

from warpcontact.experiment.folder import PROGRESS
from warpcontact.experiment.store import Commit, Shard
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import RunPath
from warpcontact.storage.memory_estimate import env_count_text
from warpcontact.validation.safe_text import terminal

# Smallest time between updates [s].
INTERVAL = 1.0
# Largest size of a progress file that is read [bytes].
MOST = 2**16

_FILE = re.compile(r"shard_(\d{6,})\.json")


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
        with contextlib.suppress(OSError), self._path.replacing(wait=False) as file:
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
            content = json.loads((progress / name).read(MOST))
            found = {"steps": int(content["steps"]), "time": float(content["time"])}
        except UnsafeFileError:
            raise
        except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
            continue
        yield int(number[1]), found
