"""All engines at one work and one number of environments, in turn."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from worker import Failure, Worker


class SideBySide:
    """Starts the engines, lets them run in rounds, and collects their results.

    Args:
        work: Name of the work.
        envs: Number of environments.
        pythons: Engines and their interpreters.
        arguments: Further arguments of ``measure.py``.
        cold: Folder for compiled kernels; ``None``: the usual one, where they may be already.
        patience: Seconds to wait for an engine.
        progress: Called with the name of an engine before each run and with "" after.

    Attributes:
        entries: What there is of each engine: its result, or ``why`` there is none.
    """

    def __init__(
        self,
        work: str,
        envs: int,
        pythons: dict[str, Path],
        arguments: list[str],
        cold: Path | None,
        patience: float,
        progress: Callable[[str], None],
    ) -> None:
        self.entries: dict[str, dict[str, Any]] = {}
        self._work = work
        self._envs = envs
        self._pythons = pythons
        self._arguments = ["--work", work, "--envs", str(envs), *arguments]
        self._cold = cold
        self._patience = patience
        self._progress = progress
        self._workers: dict[str, Worker] = {}

    def start(self, *, together: bool) -> None:
        """Makes the engines ready, one after the other or all at the same time."""
        for name in self._pythons:
            self._begin(name)
            if not together:
                self._wait(name)
        for name in list(self._workers) if together else ():
            self._wait(name)

    def _begin(self, name: str) -> None:
        environment = {"WARP_CACHE_PATH": str(self._cold / name)} if self._cold else {}
        self._workers[name] = Worker(self._pythons[name], [name, *self._arguments], environment, self._patience)

    def _wait(self, name: str) -> None:
        with self._turn(name):
            if not self._workers[name].ready():
                self._leave(name, "not available")

    def round(self) -> dict[str, float]:
        """Gives every engine a turn; returns their environment-steps per second."""
        rates = {}
        for name in list(self._workers):
            with self._turn(name):
                rates[name] = self._workers[name].run()
        return rates

    def finish(self) -> None:
        """Collects the results."""
        for name, worker in list(self._workers.items()):
            with self._turn(name):
                self.entries[name] = worker.result()
                self.entries[name]["start_s"]["process"] = worker.start_s

    def end(self) -> None:
        """Ends what is left of the processes."""
        for worker in self._workers.values():
            worker.end()

    @contextmanager
    def _turn(self, name: str) -> Iterator[None]:
        """The turn of an engine; if it fails, it is out, and its entry says why."""
        self._progress(name)
        try:
            yield
        except Failure as failure:
            self._leave(name, f"failed: {failure}")
        self._progress("")

    def _leave(self, name: str, why: str) -> None:
        self._workers.pop(name).end()
        self.entries[name] = {"work": self._work, "engine": name, "envs": self._envs, "why": why}
