"""Threads that step slices of the environments, each slice by whoever is free."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import warp as wp

from warpcontact.slices import Slice

# Between two looks at whether somebody wants to interrupt [s]; the threads wait for each other then.
_CHUNK = 0.1
# Environment-steps below which starting threads takes longer than what they would save.
ALONE = 4096


def available_threads() -> int:
    """Returns how many threads this process may run at once."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Crew:
    """Steps slices of one simulation, which share nothing that they write.

    Args:
        slices: All slices.
        threads: How many threads step them.
    """

    def __init__(self, slices: list[Slice], threads: int) -> None:
        self._slices = slices
        # Kernels in Warp's debug mode share a pointer to the storage of tiles, which they look at when they end.
        self._threads = 1 if wp.config.mode == "debug" else min(threads, len(slices))
        self._pool: ThreadPoolExecutor | None = None
        self._envs = sum(part.envs for part in slices)
        self._chunk = 32

    def step(self, count: int) -> Iterator[int]:
        """Takes ``count`` steps in all slices, some at a time; yields how many were taken so far.

        Every slice has taken as many at each yield, also after an interruption.
        """
        done = 0
        while done < count:
            some = min(count - done, self._chunk)
            for part in self._slices:
                part.capture(some)
            start = time.perf_counter()
            with _uninterrupted():
                self._step_all(some)
                took = time.perf_counter() - start
                done += some
                yield done
            if took < 0.5 * _CHUNK and some == self._chunk:
                self._chunk *= 2
            elif took > 2.0 * _CHUNK and self._chunk > 32:
                self._chunk //= 2

    def _step_all(self, count: int) -> None:
        if self._threads < 2 or count * self._envs < ALONE:
            for part in self._slices:
                part.step(count)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="warpcontact")
        waiting = iter(self._slices)

        def work() -> None:
            for part in waiting:
                part.step(count)

        futures = [self._pool.submit(work) for _ in range(self._threads)]
        wait(futures)
        for future in futures:
            future.result()


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Lets Ctrl-C wait until all environments have come equally far. It reaches the main thread only."""
    usual = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(usual):
        yield
        return
    asked: list[tuple[int, Any]] = []
    signal.signal(signal.SIGINT, lambda number, frame: asked.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
        if asked:
            usual(*asked[0])
