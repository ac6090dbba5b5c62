"""Who steps which slices of the environments: on the CPU the thread that is free, on GPUs their graphs."""

import contextlib
import signal
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any

import warp as wp

from warpcontact.stepping.chunk_sizer import ChunkSizer
from warpcontact.stepping.slice_stepper import FrameSchedule, StepChunk, Stepper

# Steps between two looks at whether somebody wants to interrupt, at least, in whole graphs: on the CPU, and where
# a GPU has graphs. Threads wait for each other then.
_MIN_STEPS = 8
_MIN_STEPS_GPU = 32
# Of what a thread does until all wait for each other, the last turn that it takes, at most, but for a whole graph
# or a frame: one may take it alone.
_LAST_ITEM_FRACTION = 1 / 64
# Slices for each thread that are taken in turns, the last ones. Others stay with a thread to the end of what is
# taken at a time, so that it fetches them once. So many make up for a thread at a quarter of the speed of others.
_DYNAMIC_SLICES = 4
# Environment-steps of a thread that are taken at a time, at most: a fraction of a second, where all are stepped.
# Those that are held take no time, until they are reset.
_MAX_ENV_STEPS = 2**21
# Environment-steps below which starting threads takes longer than what they would save.
SERIAL_ENV_STEPS = 4096


@dataclass(frozen=True)
class DeviceShare:
    """The environments of a part of the model.

    Attributes:
        slices: Them, in pieces that share nothing that is written.
        steppers: What steps them, one for each thread that may.
    """

    slices: Sequence[slice]
    steppers: Sequence[Stepper]

    @property
    def device(self) -> wp.Device:
        """Where they are."""
        return self.steppers[0].device


@dataclass(frozen=True)
class _WorkItem:
    """What is done to a slice at a time.

    Attributes:
        frame: Number of the frame that is looked at next.
        chunks: Its steps, up to each frame or the end.
    """

    frame: int
    chunks: tuple[StepChunk, ...]

    def batches(self, stepper: Stepper, frames: FrameSchedule | None) -> list[tuple[StepChunk, ...]]:
        """Returns ways that ``stepper`` takes at once: one by one if frames are handed on after each."""
        whole_items = frames is None or stepper.records(frames)
        return [self.chunks] if whole_items else [(chunk,) for chunk in self.chunks]


# A slice that somebody may take, with the turns that are left of it.
_QueueEntry = tuple[DeviceShare, slice, Sequence[_WorkItem]]


class WorkerPool:
    """Steps the environments of one simulation.

    Args:
        shares: All of them, by parts of the model; those on the CPU have a stepper for each thread there is to be.
    """

    def __init__(self, shares: Sequence[DeviceShare]) -> None:
        self._steppers = [stepper for share in shares for stepper in share.steppers]
        # GPUs are given their graphs in turn, which takes no time. What Python launches, and waits for, has a
        # thread for each GPU, so that none waits for another.
        self._gpu_slices = _device_slices(
            share for share in shares if share.device.is_cuda and share.steppers[0].captured
        )
        host_launched: dict[str, list[DeviceShare]] = {}
        for share in shares:
            if share.device.is_cuda and not share.steppers[0].captured:
                host_launched.setdefault(str(share.device), []).append(share)
        on_cpu = [share for share in shares if share.device.is_cpu]
        # Kernels in Warp's debug mode share a pointer to the storage of tiles, which they look at when they end.
        threads = 1 if wp.config.mode == "debug" else max((len(share.steppers) for share in on_cpu), default=0)
        # The other slices, and how many threads share them.
        slices = _device_slices(on_cpu)
        self._thread_groups = [(_device_slices(own), 1) for own in host_launched.values()] + [(slices, threads)]
        # Of few slices each thread has few: in turns, the last of which is short, they end at about the same time.
        self._last_item_fraction = (
            _LAST_ITEM_FRACTION * len(slices) / threads if 1 < threads < len(slices) else 1.0
        )
        self._threads = sum(threads for _, threads in self._thread_groups)
        self._pool: ThreadPoolExecutor | None = None
        self._envs = sum(own.stop - own.start for share in shares for own in share.slices)
        max_steps = max(_MIN_STEPS, _MAX_ENV_STEPS * threads // self._envs) if threads else None
        self._chunk_sizer = ChunkSizer(_MIN_STEPS_GPU) if self._gpu_slices else ChunkSizer(_MIN_STEPS, max_steps)

    def step(self, count: int, frames: FrameSchedule | None = None) -> Iterator[int]:
        """Takes ``count`` steps in all slices, some at a time; yields how many were taken so far.

        Every slice has taken as many at each yield, also after an interruption. ``frames`` are looked at by the
        way, while what a slice has written is still near its thread.
        """
        done = 0
        after_evaluation = frames is not None and frames.follows_frame
        while done < count:
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

    def record_frame(self, frames: FrameSchedule) -> None:
        """Takes a frame of the state that there is, the first of ``frames``."""
        items = [_WorkItem(frames.first_frame, (StepChunk(0, evaluates=True),))]
        for stepper in self._steppers:
            stepper.prepare_evaluation(frames)
            stepper.capture(items[0].chunks)
        with _defer_interrupts():
            self._step_all(1, items, items, frames)

    def _is_serial(self, count: int) -> bool:
        """Whether one thread takes ``count`` steps sooner than several are told of them."""
        return self._threads < 2 or count * self._envs < SERIAL_ENV_STEPS

    def _item_lengths(self, steps: int) -> list[int]:
        """Returns steps of one turn after the other: each time half of what is left, until that is little."""
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
        """Takes ``count`` steps in all slices: in most at once, as ``whole_items``, in the last ones in ``items``."""
        _work(0, _make_queue(self._gpu_slices, whole_items), frames)
        if self._is_serial(count):
            for slices, _ in self._thread_groups:
                _work(0, _make_queue(slices, whole_items), frames)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="warpcontact")
        futures = []
        for slices, threads in self._thread_groups:
            # Who is alone need not be waited for.
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
    """Returns turns of about these ``lengths``, after the first ``done`` steps; ``after_evaluation`` is that of the first."""
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
    """Returns slices that somebody may take."""
    return deque((share, own, items) for share, own in slices)


def _work(thread: int, queue: deque[_QueueEntry], frames: FrameSchedule | None) -> None:
    """Takes turns, as a member of a team, in each slice that nobody else has taken."""
    while True:
        try:
            # At once with others.
            share, own, items = queue.popleft()
        except IndexError:
            return
        stepper = share.steppers[thread]
        stepper.select(own)
        _run_item(stepper, items[0], frames)
        if len(items) > 1:
            queue.append((share, own, items[1:]))


def _run_item(stepper: Stepper, item: _WorkItem, frames: FrameSchedule | None) -> None:
    """Takes a turn in a slice, and looks at it wherever a frame is due."""
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
    """Lets Ctrl-C wait until all environments have come equally far. It reaches the main thread only."""
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
