"""Runs all engines on one benchmark scene with one number of environments, alternately."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from worker import Failure, Worker


class SideBySide:
    """Starts the engines, runs them in rounds, and collects their results.

    Args:
        scene: Name of the benchmark scene.
        envs: Number of environments.
        pythons: Engines and their interpreters.
        arguments: Further arguments of ``measure.py``.
        cold: Folder for compiled kernels; ``None``: the default cache, which may contain them.
        patience: Timeout for a response of an engine [s].
        progress: Called with the name of an engine before each run and with "" after it.

    Attributes:
        entries: Result of each engine, or the reason ``why`` it has none.
    """

    def __init__(
        self,
        scene: str,
        envs: int,
        pythons: dict[str, Path],
        arguments: list[str],
        cold: Path | None,
        patience: float,
        progress: Callable[[str], None],
    ) -> None:
        self.entries: dict[str, dict[str, Any]] = {}
        self._scene = scene
        self._envs = envs
        self._pythons = pythons
        self._arguments = ["--scene", scene, "--envs", str(envs), *arguments]
        self._cold = cold
        self._patience = patience
        self._progress = progress
        self._workers: dict[str, Worker] = {}

    def start(self, *, together: bool) -> None:
        """Starts the engines, one after another or simultaneously."""
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
            self._workers[name].wait_until_ready()

    def round(self) -> dict[str, float]:
        """Runs every engine once; returns their environment-steps per second."""
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
        """Ends the remaining processes."""
        for worker in self._workers.values():
            worker.end()

    @contextmanager
    def _turn(self, name: str) -> Iterator[None]:
        """Context of a run of an engine; an engine that fails is removed, and its entry has the reason."""
        self._progress(name)
        try:
            yield
        except Failure as failure:
            self._leave(name, f"failed: {failure}")
        self._progress("")

    def _leave(self, name: str, why: str) -> None:
        self._workers.pop(name).end()
        self.entries[name] = {"scene": self._scene, "engine": name, "envs": self._envs, "why": why}
