"""How far a run is: a bar for who watches, small files for who asks from elsewhere."""

import contextlib
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from warpcontact.experiment.folder import PROGRESS
from warpcontact.experiment.store import Shard

# Between two looks [s].
INTERVAL = 1.0


class Bar:
    """A bar over the steps of all environments of a run, with how many of these are finished, and frozen.

    Args:
        envs: Number of environments.
        steps: Steps of each.
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
            desc=f"{envs} environments{several}",
            delay=1.0,
            disable=None if show is None else not show,
        )
        self._envs = envs
        self._steps = steps
        self._done: dict[int, int] = {}
        self._finished = 0
        self._frozen = 0

    def begin(self, finished: int, frozen: int) -> None:
        """Tells of what was finished before."""
        self._finished, self._frozen = finished, frozen
        self._bar.initial = finished * self._steps
        self._bar.n = self._bar.initial
        self._tell()

    def update(self, shard: Shard, steps: int) -> None:
        """Tells how many steps of a shard are done."""
        before = self._done.get(shard.number, 0)
        self._done[shard.number] = steps
        self._bar.update(shard.envs * (steps - before))

    def finish(self, shard: Shard, frozen: int) -> None:
        """Tells that a shard is finished, with so many frozen environments."""
        self.update(shard, self._steps)
        self._finished += shard.envs
        self._frozen += frozen
        self._tell()

    def _tell(self) -> None:
        told = {"finished": f"{self._finished}/{self._envs}"}
        if self._frozen:
            told["frozen"] = str(self._frozen)
        self._bar.set_postfix(told, refresh=False)

    def __enter__(self) -> "Bar":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()


class Beacon:
    """Tells in a file of the run's folder how far a shard is, once in a while."""

    def __init__(self, folder: Path, shard: Shard) -> None:
        self._path = folder / PROGRESS / f"{shard.name}.json"
        self._last = 0.0

    def tell(self, steps: int) -> None:
        """Tells how many steps are done."""
        now = time.monotonic()
        if now - self._last < INTERVAL:
            return
        self._last = now
        # It is nobody's loss if it cannot be told.
        with contextlib.suppress(OSError):
            partial = self._path.with_suffix(".partial")
            partial.write_text(json.dumps({"steps": steps, "time": time.time(), "process": os.getpid()}))
            partial.replace(self._path)

    def remove(self) -> None:
        """Removes the file."""
        self._path.unlink(missing_ok=True)


def told(folder: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Iterates over the shards that tell of themselves, by number."""
    for path in sorted((folder / PROGRESS).glob("shard_*.json")):
        with contextlib.suppress(OSError, ValueError, KeyError):
            yield int(path.stem.rpartition("_")[2]), json.loads(path.read_bytes())
