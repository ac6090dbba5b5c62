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

from warpcontact.pace import Pace
from warpcontact.slices import Frames, Stepper, Way

# Steps between two looks at whether somebody wants to interrupt, at least, in whole graphs: on the CPU, and where
# a GPU has graphs. Threads wait for each other then.
_FEWEST = 8
_FEWEST_QUEUED = 32
# Of what a thread does until all wait for each other, the last turn that it takes, at most, but for a whole graph
# or a frame: one may take it alone.
_LAST_TURN = 1 / 64
# Slices for each thread that are taken in turns, the last ones. Others stay with a thread to the end of what is
# taken at a time, so that it fetches them once. So many make up for a thread at a quarter of the speed of others.
_SHARED = 4
# Environment-steps of a thread that are taken at a time, at most: a fraction of a second, where all are stepped.
# Those that are held take no time, until they are reset.
_MOST = 2**21
# Environment-steps below which starting threads takes longer than what they would save.
ALONE = 4096


@dataclass(frozen=True)
class Share:
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
class _Turn:
    """What is done to a slice at a time.

    Attributes:
        frame: Number of the frame that is looked at next.
        ways: Its steps, up to each frame or the end.
    """

    frame: int
    ways: tuple[Way, ...]

    def pieces(self, stepper: Stepper, frames: Frames | None) -> list[tuple[Way, ...]]:
        """Returns ways that ``stepper`` takes at once: one by one if frames are handed on after each."""
        whole = frames is None or stepper.takes(frames)
        return [self.ways] if whole else [(way,) for way in self.ways]


# A slice that somebody may take, with the turns that are left of it.
_Waiting = tuple[Share, slice, Sequence[_Turn]]


class Crew:
    """Steps the environments of one simulation.

    Args:
        shares: All of them, by parts of the model; those on the CPU have a stepper for each thread there is to be.
    """

    def __init__(self, shares: Sequence[Share]) -> None:
        self._steppers = [stepper for share in shares for stepper in share.steppers]
        # GPUs are given their graphs in turn, which takes no time. What Python launches, and waits for, has a
        # thread for each GPU, so that none waits for another.
        self._queued = _pieces(share for share in shares if share.device.is_cuda and share.steppers[0].captured)
        launched: dict[str, list[Share]] = {}
        for share in shares:
            if share.device.is_cuda and not share.steppers[0].captured:
                launched.setdefault(str(share.device), []).append(share)
        on_cpu = [share for share in shares if share.device.is_cpu]
        # Kernels in Warp's debug mode share a pointer to the storage of tiles, which they look at when they end.
        members = 1 if wp.config.mode == "debug" else max((len(share.steppers) for share in on_cpu), default=0)
        # The other slices, and how many threads share them.
        pieces = _pieces(on_cpu)
        self._teams = [(_pieces(own), 1) for own in launched.values()] + [(pieces, members)]
        # Of few slices each thread has few: in turns, the last of which is short, they end at about the same time.
        self._last_turn = _LAST_TURN * len(pieces) / members if 1 < members < len(pieces) else 1.0
        self._threads = sum(members for _, members in self._teams)
        self._pool: ThreadPoolExecutor | None = None
        self._envs = sum(own.stop - own.start for share in shares for own in share.slices)
        most = max(_FEWEST, _MOST * members // self._envs) if members else None
        self._pace = Pace(_FEWEST_QUEUED) if self._queued else Pace(_FEWEST, most)

    def step(self, count: int, frames: Frames | None = None) -> Iterator[int]:
        """Takes ``count`` steps in all slices, some at a time; yields how many were taken so far.

        Every slice has taken as many at each yield, also after an interruption. ``frames`` are looked at by the
        way, while what a slice has written is still near its thread.
        """
        done = 0
        known = frames is not None and frames.follows
        while done < count:
            some = self._pace.of(count - done)
            if frames is not None:
                some = frames.whole(done, some, count)
            whole = turns = _cut(done, [some], frames, known)
            if len(lengths := self._lengths(some)) > 1:
                turns = _cut(done, lengths, frames, known)
            for stepper in self._steppers:
                if frames is not None:
                    stepper.ready_look(frames)
                for turn in whole if turns is whole else (*whole, *turns):
                    for ways in turn.pieces(stepper, frames):
                        stepper.capture(ways)
            start = time.perf_counter()
            with _uninterrupted():
                self._step_all(some, whole, turns, frames)
                took = time.perf_counter() - start
                done += some
                known = frames is not None and done % frames.every == 0
                yield done
            self._pace.took(some, took)

    def look(self, frames: Frames) -> None:
        """Takes a frame of the state that there is, the first of ``frames``."""
        turns = [_Turn(frames.first, (Way(0, looks=True),))]
        for stepper in self._steppers:
            stepper.ready_look(frames)
            stepper.capture(turns[0].ways)
        with _uninterrupted():
            self._step_all(1, turns, turns, frames)

    def _alone(self, count: int) -> bool:
        """Whether one thread takes ``count`` steps sooner than several are told of them."""
        return self._threads < 2 or count * self._envs < ALONE

    def _lengths(self, some: int) -> list[int]:
        """Returns steps of one turn after the other: each time half of what is left, until that is little."""
        grain = _FEWEST_QUEUED if self._queued else _FEWEST
        last = some if self._alone(some) else max(grain, self._last_turn * some)
        lengths = []
        while some > last:
            lengths.append(-(-some // (2 * grain)) * grain)
            some -= lengths[-1]
        return [*lengths, some] if some else lengths

    def _step_all(self, count: int, whole: Sequence[_Turn], turns: Sequence[_Turn], frames: Frames | None) -> None:
        """Takes ``count`` steps in all slices: in most at once, as ``whole``, in the last ones in ``turns``."""
        _step_each(0, _waiting(self._queued, whole), frames)
        if self._alone(count):
            for pieces, _ in self._teams:
                _step_each(0, _waiting(pieces, whole), frames)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads, thread_name_prefix="warpcontact")
        futures = []
        for pieces, members in self._teams:
            # Who is alone need not be waited for.
            apart = max(0, len(pieces) - _SHARED * members) if members > 1 else len(pieces)
            waiting = _waiting(pieces[:apart], whole) + _waiting(pieces[apart:], turns)
            futures += [self._pool.submit(_step_each, member, waiting, frames) for member in range(members)]
        wait(futures)
        for future in futures:
            future.result()


def _pieces(shares: Iterable[Share]) -> list[tuple[Share, slice]]:
    """Returns all slices, each with its share."""
    return [(share, own) for share in shares for own in share.slices]


def _cut(done: int, lengths: Sequence[int], frames: Frames | None, known: bool) -> list[_Turn]:
    """Returns turns of about these ``lengths``, after the first ``done`` steps; ``known`` is that of the first."""
    if frames is None:
        return [_Turn(0, (Way(length),)) for length in lengths]
    turns: list[_Turn] = []
    own: list[Way] = []
    frame, size, length = frames.first + done // frames.every, 0, lengths[0]
    for count in frames.cut(done, sum(lengths)):
        done += count
        looks = done % frames.every == 0
        own.append(Way(count, known, looks))
        size, known = size + count, looks
        if size >= length:
            turns.append(_Turn(frame, tuple(own)))
            frame, own, size = frames.first + done // frames.every, [], 0
            length = lengths[min(len(turns), len(lengths) - 1)]
    return [*turns, _Turn(frame, tuple(own))] if own else turns


def _waiting(pieces: Iterable[tuple[Share, slice]], turns: Sequence[_Turn]) -> deque[_Waiting]:
    """Returns slices that somebody may take."""
    return deque((share, own, turns) for share, own in pieces)


def _step_each(member: int, waiting: deque[_Waiting], frames: Frames | None) -> None:
    """Takes turns, as a member of a team, in each slice that nobody else has taken."""
    while True:
        try:
            # At once with others.
            share, own, turns = waiting.popleft()
        except IndexError:
            return
        stepper = share.steppers[member]
        stepper.go_to(own)
        _step(stepper, turns[0], frames)
        if len(turns) > 1:
            waiting.append((share, own, turns[1:]))


def _step(stepper: Stepper, turn: _Turn, frames: Frames | None) -> None:
    """Takes a turn in a slice, and looks at it wherever a frame is due."""
    if frames is None or stepper.takes(frames):
        stepper.go_to_frame(turn.frame)
        stepper.step(turn.ways)
        return
    frame = turn.frame
    for way in turn.ways:
        stepper.step((way,))
        if way.looks:
            stepper.hand_on(frames, frame)
            frame += 1


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
