"""Worker pool: CPU threads take slices of environments as they become free; each GPU replays its graphs.

``WorkerPool.step`` divides steps into chunks. Within a chunk each slice is stepped independently; all workers wait
for each other at its end (barrier), where progress and interrupts are handled. Used by ``Simulation``.
"""

import contextlib
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any

import warp as wp

from warpcontact.stepping.chunk_sizer import ChunkSizer
from warpcontact.stepping.slice_stepper import FrameSchedule, StepChunk, Stepper

# Minimum number of steps between barriers, where interrupts are checked: one graph, on a CPU and on a GPU.
_MIN_STEPS = 8
_MIN_STEPS_GPU = 32
# Maximum size of the last work item, as a fraction of a worker's work up to the barrier (at least a graph or a
# frame interval). Other workers may be idle during it.
_LAST_ITEM_FRACTION = 1 / 64
# Slices per thread that are split into several work items for load balancing. All others are stepped by one worker
# up to the barrier, so they are loaded into its cache once. 4 compensate for a thread at a quarter of the speed.
_DYNAMIC_SLICES = 4
# Maximum number of environment-steps of a thread between barriers: a fraction of a second if all environments are
# active. Frozen environments take no time until they are reset, so the measured time alone is no bound.
_MAX_ENV_STEPS = 2**21
# Duration of steps on one thread [s] below which starting threads takes longer than it saves.
SERIAL_SECONDS = 4e-4
# Duration of a step of an environment that is assumed before the first chunk has been measured [s].
_ASSUMED_SECONDS = 1e-7


@dataclass(frozen=True)
class DeviceShare:
    """The environments of one part of the model.

    Attributes:
        slices: Ranges of environments; they share no memory that is written.
        steppers: One stepper for each thread.
    """

    slices: Sequence[slice]
    steppers: Sequence[Stepper]

    @property
    def device(self) -> wp.Device:
        """Device of the environments."""
        return self.steppers[0].device


@dataclass(frozen=True)
class _WorkItem:
    """Consecutive steps of one slice.

    Attributes:
        frame: Number of the next frame.
        chunks: The steps, split at frames.
    """

    frame: int
    chunks: tuple[StepChunk, ...]

    def batches(self, stepper: Stepper, frames: FrameSchedule | None) -> list[tuple[StepChunk, ...]]:
        """Returns the chunks per call of ``stepper.step``: one at a time if frames are delivered after each."""
        whole_items = frames is None or stepper.records(frames)
        return [self.chunks] if whole_items else [(chunk,) for chunk in self.chunks]


# A slice to be stepped, with its remaining work items.
_QueueEntry = tuple[DeviceShare, slice, Sequence[_WorkItem]]


class WorkerPool:
    """Steps the environments of one simulation.

    Args:
        shares: Environments of each part of the model. Those on a CPU have one stepper per thread.
        renewed_shares: Called between chunks; returns the same slices with other steppers, or ``None``.
    """

    def __init__(
        self,
        shares: Sequence[DeviceShare],
        renewed_shares: Callable[[], Sequence[DeviceShare] | None] = lambda: None,
    ) -> None:
        self._renewed_shares = renewed_shares
        self._pool: ThreadPoolExecutor | None = None
        self._set_shares(shares)
        slices = sum(len(share.slices) for share in shares if share.device.is_cpu)
        threads = self._cpu_threads
        # With few slices per worker, split the chunk; the last work item is short, so workers finish together.
        self._last_item_fraction = _LAST_ITEM_FRACTION * slices / threads if 1 < threads < slices else 1.0
        self._threads = sum(threads for _, threads in self._thread_groups)
        self._envs = sum(own.stop - own.start for share in shares for own in share.slices)
        self._step_seconds = _ASSUMED_SECONDS * self._envs  # of a step of all environments on one thread
        max_steps = max(_MIN_STEPS, _MAX_ENV_STEPS * threads // self._envs) if threads else None
        self._chunk_sizer = ChunkSizer(_MIN_STEPS_GPU) if self._gpu_slices else ChunkSizer(_MIN_STEPS, max_steps)

    def _set_shares(self, shares: Sequence[DeviceShare]) -> None:
        """Sets the slices and steppers of each thread."""
        self._steppers = [stepper for share in shares for stepper in share.steppers]
        # Graph launches on GPUs are asynchronous, so one thread serves all GPUs. Without graphs, Python launches
        # kernels and waits for them; each GPU then has its own thread.
        self._gpu_slices = _device_slices(
            share for share in shares if share.device.is_cuda and share.steppers[0].captured
        )
        host_launched: dict[str, list[DeviceShare]] = {}
        for share in shares:
            if share.device.is_cuda and not share.steppers[0].captured:
                host_launched.setdefault(str(share.device), []).append(share)
        on_cpu = [share for share in shares if share.device.is_cpu]
        # In Warp's debug mode, kernels share a pointer to the tile storage and check it when they end.
        threads = 1 if wp.config.mode == "debug" else max((len(share.steppers) for share in on_cpu), default=0)
        # Slices that are stepped by threads, and the number of threads of each group.
        self._cpu_threads = threads
        self._thread_groups = [(_device_slices(own), 1) for own in host_launched.values()]
        self._thread_groups.append((_device_slices(on_cpu), threads))

    def step(self, count: int, frames: FrameSchedule | None = None) -> Iterator[int]:
        """Takes ``count`` steps in all slices, chunk by chunk; yields the number of steps taken so far.

        At each yield all slices have taken the same number of steps, also after an interrupt. ``frames`` are
        evaluated between steps, while the data of a slice is still in the cache.
        """
        done = 0
        after_evaluation = frames is not None and frames.follows_frame
        while done < count:
            if (shares := self._renewed_shares()) is not None:
                self._set_shares(shares)
            steps = self._chunk_sizer.next(count - done)
            if frames is not None:
                steps = frames.align(done, steps, count)
            whole_items = items = _work_items(done, [steps], frames, after_evaluation)
            if len(lengths := self._item_lengths(steps)) > 1:
                items = _work_items(done, lengths, frames, after_evaluation)
            for stepper in self._steppers:
                if frames is not None:
                    stepper.prepare_evaluation(frames)
                for item in whole_items if items is whole_items else (*whole_items, *items):
                    for chunks in item.batches(stepper, frames):
                        stepper.capture(chunks)
            start = time.perf_counter()
            with _defer_interrupts():
                self._step_all(steps, whole_items, items, frames)
                took = time.perf_counter() - start
                done += steps
                after_evaluation = frames is not None and done % frames.every == 0
                yield done
            self._chunk_sizer.record(steps, took)
            self._step_seconds = took / steps * (1 if self._is_serial(steps) else self._threads)

    def record_frame(self, frames: FrameSchedule) -> None:
        """Records a frame of the current state, the first of ``frames``."""
        items = [_WorkItem(frames.first_frame, (StepChunk(0, evaluates=True),))]
        for stepper in self._steppers:
            stepper.prepare_evaluation(frames)
            stepper.capture(items[0].chunks)
        with _defer_interrupts():
            self._step_all(1, items, items, frames)

    def _is_serial(self, count: int) -> bool:
        """Returns whether one thread takes ``count`` steps faster than several threads can be started."""
        return self._threads < 2 or count * self._step_seconds < SERIAL_SECONDS

    def _item_lengths(self, steps: int) -> list[int]:
        """Returns the steps of consecutive work items: each is half of the remaining steps, down to a minimum."""
        grain = _MIN_STEPS_GPU if self._gpu_slices else _MIN_STEPS
        last = steps if self._is_serial(steps) else max(grain, self._last_item_fraction * steps)
        lengths = []
        while steps > last:
            lengths.append(-(-steps // (2 * grain)) * grain)
            steps -= lengths[-1]
        return [*lengths, steps] if steps else lengths

    def _step_all(
        self,
        count: int,
        whole_items: Sequence[_WorkItem],
        items: Sequence[_WorkItem],
        frames: FrameSchedule | None,
    ) -> None:
        """Takes ``count`` steps in all slices: most slices as ``whole_items``, the last ones split into ``items``."""
        _work(0, _make_queue(self._gpu_slices, whole_items), frames)
        if self._is_serial(count):
            for slices, _ in self._thread_groups:
                _work(0, _make_queue(slices, whole_items), frames)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="warpcontact")
        futures = []
        for slices, threads in self._thread_groups:
            # A single thread needs no load balancing.
            static_count = max(0, len(slices) - _DYNAMIC_SLICES * threads) if threads > 1 else len(slices)
            queue = _make_queue(slices[:static_count], whole_items) + _make_queue(slices[static_count:], items)
            futures += [self._pool.submit(_work, thread, queue, frames) for thread in range(threads)]
        wait(futures)
        for future in futures:
            future.result()


def _device_slices(shares: Iterable[DeviceShare]) -> list[tuple[DeviceShare, slice]]:
    """Returns all slices, each with its share."""
    return [(share, own) for share in shares for own in share.slices]


def _work_items(
    done: int, lengths: Sequence[int], frames: FrameSchedule | None, after_evaluation: bool
) -> list[_WorkItem]:
    """Returns work items of about ``lengths`` steps, after the first ``done`` steps, that end at frames.

    ``after_evaluation`` is the attribute of the first chunk.
    """
    if frames is None:
        return [_WorkItem(0, (StepChunk(length),)) for length in lengths]
    items: list[_WorkItem] = []
    own: list[StepChunk] = []
    frame, size, length = frames.first_frame + done // frames.every, 0, lengths[0]
    for count in frames.split(done, sum(lengths)):
        done += count
        evaluates = done % frames.every == 0
        own.append(StepChunk(count, after_evaluation, evaluates))
        size, after_evaluation = size + count, evaluates
        if size >= length:
            items.append(_WorkItem(frame, tuple(own)))
            frame, own, size = frames.first_frame + done // frames.every, [], 0
            length = lengths[min(len(items), len(lengths) - 1)]
    return [*items, _WorkItem(frame, tuple(own))] if own else items


def _make_queue(slices: Iterable[tuple[DeviceShare, slice]], items: Sequence[_WorkItem]) -> deque[_QueueEntry]:
    """Returns a queue of slices, each with all ``items``."""
    return deque((share, own, items) for share, own in slices)


def _work(thread: int, queue: deque[_QueueEntry], frames: FrameSchedule | None) -> None:
    """Runs work items from the queue, as worker number ``thread``, until the queue is empty."""
    while True:
        try:
            # ``deque.popleft`` is thread-safe.
            share, own, items = queue.popleft()
        except IndexError:
            return
        stepper = share.steppers[thread]
        stepper.select(own)
        _run_item(stepper, items[0], frames)
        if len(items) > 1:
            queue.append((share, own, items[1:]))


def _run_item(stepper: Stepper, item: _WorkItem, frames: FrameSchedule | None) -> None:
    """Runs a work item in the selected slice, and evaluates and delivers its frames."""
    if frames is None or stepper.records(frames):
        stepper.set_frame(item.frame)
        stepper.step(item.chunks)
        return
    frame = item.frame
    for chunk in item.chunks:
        stepper.step((chunk,))
        if chunk.evaluates:
            stepper.deliver(frames, frame)
            frame += 1


@contextlib.contextmanager
def _defer_interrupts() -> Iterator[None]:
    """Defers Ctrl-C until all environments have taken the same number of steps; only in the main thread."""
    previous_handler = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(previous_handler):
        yield
        return
    interrupts: list[tuple[int, Any]] = []
    signal.signal(signal.SIGINT, lambda number, frame: interrupts.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous_handler)
        if interrupts:
            previous_handler(*interrupts[0])
