"""Who steps which slices of the environments: on the CPU the thread that is free, on GPUs their graphs."""

import contextlib
import functools
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import warp as wp

from warpcontact.slices import Frames, Slice

# Between two looks at whether somebody wants to interrupt [s]; the threads wait for each other then.
_CHUNK = 0.1
# Steps between two such looks at least, in whole graphs: on the CPU, and where a GPU has graphs.
_FEWEST = 8
_FEWEST_QUEUED = 32
# Environment-steps below which starting threads takes longer than what they would save.
ALONE = 4096


def available_threads() -> int:
    """Returns how many threads this process may run at once."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Crew:
    """Steps slices of one simulation, which share nothing that they write.

    Args:
        slices: All slices.
        threads: How many threads step those on the CPU.
    """

    def __init__(self, slices: list[Slice], threads: int) -> None:
        self._slices = slices
        on_cpu = [piece for piece in slices if piece.device.is_cpu]
        # GPUs are given their graphs in turn, which takes no time. What Python launches, and waits for, has a
        # thread for each GPU, so that none waits for another.
        self._queued = [piece for piece in slices if piece.device.is_cuda and piece.captured]
        launched: dict[str, list[Slice]] = {}
        for piece in slices:
            if piece.device.is_cuda and not piece.captured:
                launched.setdefault(str(piece.device), []).append(piece)
        # Kernels in Warp's debug mode share a pointer to the storage of tiles, which they look at when they end.
        threads = 1 if wp.config.mode == "debug" else threads
        # The other slices, and how many threads share them.
        self._teams = [(own, 1) for own in launched.values()] + [(on_cpu, min(threads, len(on_cpu)))]
        self._threads = sum(members for _, members in self._teams)
        self._pool: ThreadPoolExecutor | None = None
        self._envs = sum(piece.envs for piece in slices)
        self._fewest = _FEWEST_QUEUED if self._queued else _FEWEST
        self._chunk = self._fewest

    def step(self, count: int, frames: Frames | None = None) -> Iterator[int]:
        """Takes ``count`` steps in all slices, some at a time; yields how many were taken so far.

        Every slice has taken as many at each yield, also after an interruption. ``frames`` are looked at by the
        way, while what a slice has written is still near its thread.
        """
        done = 0
        while done < count:
            some = min(count - done, self._chunk)
            ways = [some]
            if frames is not None:
                # Whole frames, if there is one: what is left of another would take launches of its own.
                over = (done + some) % frames.every
                some -= over if over < some and done + some < count else 0
                ways = frames.cut(done, some)
            for piece in self._slices:
                looked = False
                if frames is not None:
                    piece.ready_look(frames.needs)
                    looked = piece.ready_after_look(frames.needs)
                piece.capture(ways[0])
                for way in set(ways[1:]):
                    piece.capture(way, looked)
            start = time.perf_counter()
            with _uninterrupted():
                self._step_all(some, functools.partial(_step, done=done, ways=ways, frames=frames))
                took = time.perf_counter() - start
                done += some
                yield done
            if took < 0.5 * _CHUNK and 2 * some > self._chunk:
                self._chunk *= 2
            elif took > 2.0 * _CHUNK and self._chunk > self._fewest:
                self._chunk //= 2

    def _step_all(self, count: int, work: Callable[[Slice], None]) -> None:
        _step_each(iter(self._queued), work)
        if self._threads < 2 or count * self._envs < ALONE:
            for slices, _ in self._teams:
                _step_each(iter(slices), work)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="warpcontact")
        futures = []
        for slices, members in self._teams:
            waiting = iter(slices)
            futures += [self._pool.submit(_step_each, waiting, work) for _ in range(members)]
        wait(futures)
        for future in futures:
            future.result()


def _step_each(waiting: Iterator[Slice], work: Callable[[Slice], None]) -> None:
    """Does the work on each slice that nobody else has taken."""
    for piece in waiting:
        work(piece)


def _step(piece: Slice, *, done: int, ways: list[int], frames: Frames | None) -> None:
    """Takes steps in a slice, ``done`` being those before, and looks at it wherever a frame is due."""
    looked = False
    for way in ways:
        piece.step(way, looked)
        done += way
        looked = False
        if frames is not None and done % frames.every == 0:
            looked = piece.look(frames, done // frames.every - 1)


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
