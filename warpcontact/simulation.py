"""Time stepping: takes a model forward and records what is asked for."""

import contextlib
import warnings
from collections.abc import Callable, Mapping, Sequence, Set
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray

from warpcontact import checks
from warpcontact.advice import ContactWarning, advice
from warpcontact.captures import beside_captures
from warpcontact.crew import Crew, available_threads
from warpcontact.environments import Environments
from warpcontact.footprint import Footprint, require
from warpcontact.integrators import Integrator, SemiImplicitEuler
from warpcontact.model import Model, State
from warpcontact.parameters import rounded
from warpcontact.recorder import Recorder, Recording
from warpcontact.schedule import Span
from warpcontact.slices import Buffers, Frames, Slice, Times
from warpcontact.stepping import on_cpu, slice_size, stepping_footprint

# Steps between two looks at the progress bar, whole graphs; a step of a large model takes milliseconds.
STEPS_PER_UPDATE = 64


class Simulation:
    """Steps a model through time.

    Args:
        model: The model, on one device or split over several; its state is the state of the simulation.
        dt: Time step [s].
        integrator: Scheme, semi-implicit Euler if not given.
        crossing_steps: Parts into which a step is divided, in environments in which a swept point crosses a
            surface in that step. 1: such a step is taken as it is, and the contact begins as deep as it led.
        threads: Threads that step the environments on the CPU, of all parts of a model; ``None``: one per core.
        deterministic: Whether a run repeats to the bit on a GPU as well, where several points of a body touch;
            on the CPU it does in any case, whatever the number of threads.
        distance_cache: Whether what is known of distances from earlier steps saves work; results are the same.
        graphs: Whether steps are captured and replayed, without a word from Python; results are the same.

    Raises:
        MemoryError: If stepping takes more memory than there is.
    """

    def __init__(
        self,
        model: Environments,
        dt: float,
        integrator: Integrator | None = None,
        *,
        crossing_steps: int = 1,
        threads: int | None = None,
        deterministic: bool = False,
        distance_cache: bool = True,
        graphs: bool = True,
    ) -> None:
        integrator = SemiImplicitEuler() if integrator is None else integrator
        if not isinstance(model, Environments):
            raise TypeError(f"model must come from Scene.build, got {model!r}")
        if not isinstance(integrator, Integrator):
            raise TypeError(
                f"integrator must be an object of wc.integrators, such as SemiImplicitEuler(), got {integrator!r}"
            )
        integrator.check(model.scene)
        self.model = model
        self.integrator = integrator
        self.dt = float(checks.numbers("dt", dt, (), checks.limits("s", above=0.0)))
        integrator.check_step(self.dt)
        rounded("dt", np.array(self.dt), wp.dtype_to_numpy(model.parts[0].types.real))
        self.crossing_steps = _at_least_one("crossing_steps", crossing_steps)
        if self.crossing_steps > 1 and not model.parts[0].sweeps:
            warnings.warn(
                f"crossing_steps = {self.crossing_steps} divides no step: no contact of the scene has swept=True",
                ContactWarning,
                stacklevel=2,
            )
        self.threads = available_threads() if threads is None else _at_least_one("threads", threads)
        self.deterministic = bool(deterministic)
        self.distance_cache = bool(distance_cache)
        self.graphs = bool(graphs)
        self._advised = False
        launched = ", or take graphs=False" if any(device.is_cpu for device in model.devices) else ""
        require(self._stepping, model.envs, "to step them, ", launched if self.graphs else "")
        self._buffers = [Buffers(part, integrator, self.dt, self.crossing_steps) for part in model.parts]
        for part, buffers in zip(model.parts, self._buffers, strict=True):
            buffers.allocate(part.envs)
            if buffers.hard is not None:
                buffers.hard.begin(part, buffers.times.whole.dynamic)
        self._attach()
        self._prepared: tuple[tuple[int, ...], Crew | None] = ((), None)

    @property
    def times(self) -> Times:
        """Lengths of steps, on the device of the first part of the model."""
        return self._buffers[0].times

    @property
    def state(self) -> State:
        """The current state; see ``Model``. That of a model on several devices is in ``model.parts``."""
        return self.model.state

    @property
    def time(self) -> float:
        """Simulated time since the last complete reset of the model [s]."""
        return self.model.time

    @property
    def steps(self) -> int:
        """That time in steps of this simulation."""
        return round(self.model.time / self.dt)

    def _attach(self) -> None:
        """Lets readings tell what this simulation does with contacts, not another one of the same model."""
        for part, buffers in zip(self.model.parts, self._buffers, strict=True):
            part.attach(buffers.hard)

    def advice(self) -> list[str]:
        """Returns what there is to say about the model as it is, and this step for it.

        The first step from the start of the model warns of it.
        """
        return advice(self.model, self.dt, self._buffers[0].hard)

    def memory(self) -> Footprint:
        """Returns what the model and this simulation take of memory; recordings come on top."""
        return self.model.footprint().with_needs(self._stepping(self.model.envs).needs)

    def _stepping(self, envs: int) -> Footprint:
        """Returns what this simulation would take if it had ``envs`` environments, beside the model."""
        return stepping_footprint(
            self.model.shares_of(envs),
            self.integrator,
            crossing_steps=self.crossing_steps,
            threads=self.threads,
            distance_cache=self.distance_cache,
            graphs=self.graphs,
        )

    def reset(self, env_mask: ArrayLike | None = None) -> None:
        """Puts environments back to their initial state, with empty history.

        Args:
            env_mask: Booleans (envs,) of the environments to reset; ``None``: all, and the clock too.
        """
        self.model.reset(env_mask)

    def step(self, count: int = 1) -> None:
        """Takes ``count`` steps without recording.

        Raises:
            RuntimeError: If a list of partners of a mutual contact was too short. On a GPU that is said by what
                waits for it, such as a reading or the end of a run.
        """
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 0:
            raise ValueError(f"count must be a whole number of at least 0, got {count!r}")
        if count:
            self._advance(count, None)

    def step_in_frames(
        self, frames: int, every: int, needs: Set[str], take: Callable[[Model, slice, int], None]
    ) -> None:
        """Takes ``frames`` times ``every`` steps, and looks at the state after each ``every`` of them.

        On the CPU that costs little, since it is done slice by slice, while a slice is near its thread.

        Args:
            frames: How many.
            every: Steps from frame to frame.
            needs: What to compute for each, see ``Reading.needs``; there is room to measure into.
            take: Called when it is computed, with a part of the model, a range of its environments and the number
                of the frame, from 0. Of each environment frames come in their order; ranges come from several
                threads and may be at different frames, so only the range may be read.
        """
        self._attach()
        needs = frozenset(needs)
        if all(part.looks_in_parts(needs) for part in self.model.parts):
            self._advance(frames * every, Frames(every, needs, take))
            return
        for number in range(frames):
            self._advance(every, None)
            # All parts are at work before the first is waited for.
            for part in self.model.parts:
                part.prepare(needs)
            for part in self.model.parts:
                take(part, slice(0, part.envs), number)

    def _advance(self, count: int, frames: Frames | None) -> None:
        model = self.model
        self._attach()
        if model.at_start and not self._advised:
            self._advised = True
            for sentence in self.advice():
                warnings.warn(sentence, ContactWarning, stacklevel=3)
        for part in model.parts:
            part.untouched = False
        revisions = tuple(part.revision for part in model.parts)
        prepared, crew = self._prepared
        if crew is None or prepared != revisions:
            crew = Crew(self._slices(), self.threads)
            self._prepared = (revisions, crew)
        before = [part.elapsed for part in model.parts]
        for done in crew.step(count, frames):
            for part, elapsed in zip(model.parts, before, strict=True):
                part.elapsed = elapsed + done * self.dt
        # A GPU is still at work, and is asked when it is waited for.
        if all(device.is_cpu for device in model.devices):
            model.check_piles()

    @beside_captures()
    def _slices(self) -> list[Slice]:
        parts = self.model.parts
        on_threads = on_cpu((part, part.envs) for part in parts)
        return [
            piece
            for part, buffers in zip(parts, self._buffers, strict=True)
            for piece in self._slices_of(part, buffers, slice_size(part, part.envs, on_threads, self.threads))
        ]

    def _slices_of(self, model: Model, buffers: Buffers, size: int) -> list[Slice]:
        # On the CPU a slice is stepped by one thread, so the order is the same in any case.
        queued = model.device.is_cuda
        ordered = self.deterministic or not queued
        return [
            Slice(
                Span(
                    model, first, min(size, model.envs - first), self.distance_cache, ordered, queued, buffers.hard
                ),
                self.integrator,
                buffers,
                parts=self.crossing_steps,
                captured=self.graphs,
            )
            for first in range(0, model.envs, size)
        ]

    def run(
        self,
        duration: float,
        record: Sequence[str] = (),
        every: float | None = None,
        *,
        poses: bool = True,
        parameters: Sequence[str] = (),
        progress: Any = None,
    ) -> Recording:
        """Simulates for ``duration`` and returns what was recorded, the state at the start included.

        Args:
            duration: Simulated time [s]; rounded up to whole steps.
            record: Names of readings, see ``model.reading_names``.
            every: Time between records [s], a multiple of the step; ``None``: every step.
            poses: Whether to record the position and orientation of every body as well, and the parameters
                that differ between environments, so that the recording can be replayed and exported.
            parameters: Names of further parameters to keep with the recording, whether or not they differ.
            progress: Whether to show a progress bar; ``None``: on runs of over a second, in a terminal. A bar of
                tqdm is moved on by the steps of this run, and left open.

        Returns:
            A data set with dimensions (time, env), then ``item`` for sets of points and ``axis`` or
            ``component`` for vectors and quaternions; units are in the attributes.

        Raises:
            ValueError: If a time is not allowed.
            KeyError: If there is no such reading.
            MemoryError: If the recording takes more memory than there is, before anything runs.
        """
        from tqdm import tqdm

        steps, stride = recorded_steps(duration, every, self.dt)
        if isinstance(record, str):
            raise TypeError(f"record must be a list of readings, got the string {record!r}")
        self._attach()
        recorder = Recorder(
            self.model, record, frames=frame_count(steps, stride), poses=poses, parameters=parameters
        )
        recorder.start()
        start = self.time
        recorder.take(start)
        frozen = len(self.model.health().frozen)
        failed = self.model.failed_lines()
        unsolved = self.model.unsolved_contacts()
        unfinished = self.model.unfinished_solves()
        done = 0
        bar_of_run = (
            contextlib.nullcontext(progress)
            if isinstance(progress, tqdm)
            else tqdm(
                total=steps,
                unit="step",
                desc=f"{self.model.envs} environments",
                delay=1.0,
                disable=None if progress is None else not progress,
            )
        )
        with bar_of_run as bar:
            while done < steps:
                ahead = min(stride - done % stride, STEPS_PER_UPDATE, steps - done)
                self.step(ahead)
                done += ahead
                bar.update(ahead)
                if done % stride == 0:
                    recorder.take(start + done * self.dt)
        health = self.model.health()
        if len(health.frozen) > frozen:
            warnings.warn(str(health), RuntimeWarning, stacklevel=2)
        for line, count in self.model.failed_lines().items():
            if count > failed.get(line, 0):
                warnings.warn(
                    f"catenary {line!r} was without a solution in some steps of {count} of {self.model.envs} "
                    f"environments; {line}.failures has their number",
                    RuntimeWarning,
                    stacklevel=2,
                )
        for sentence in (*self._about_unsolved(unsolved), *self._about_unfinished(unfinished)):
            warnings.warn(sentence, RuntimeWarning, stacklevel=2)
        return recorder.finish(
            {
                "dt": self.dt,
                "integrator": type(self.integrator).__name__,
                "frozen_environments": health.frozen.tolist(),
            }
        )

    def _about_unsolved(self, before: Mapping[str, NDArray[np.int32]]) -> list[str]:
        """Returns what to say about smooth contacts for which more steps failed than ``before``."""
        sentences = []
        now = self.model.unsolved_contacts()
        for contact in self.model.scene.smooth_contacts:
            failed = np.flatnonzero(now[contact.name] > before[contact.name])
            if len(failed):
                sentences.append(
                    f"{contact.name}: where {contact.shape.name!r} and {contact.other_shape.name!r} meet was not "
                    f"found in some steps of {len(failed)} of {self.model.envs} environments, the first of them "
                    f"{self.model.first_env + failed[0]}, and no force acted then; {contact.name}.failures has "
                    "their number"
                )
        return sentences

    def _about_unfinished(self, before: NDArray[np.int32]) -> list[str]:
        """Returns what to say about contact problems, of which more were not solved than ``before``."""
        more = self.model.unfinished_solves() - before
        failed = np.flatnonzero(more > 0)
        if not len(failed):
            return []
        worst = int(more.argmax())
        return [
            f"the contact problem was not solved to the tolerance in some steps of {len(failed)} of "
            f"{self.model.envs} environments, most in {self.model.first_env + worst}, in {more[worst]} steps; "
            "scene.solve_failures has their number, scene.solve_residual what was left: give the integrator more "
            "iterations, solver='accelerated', or a larger tolerance"
        ]

    def __repr__(self) -> str:
        return f"<Simulation of {self.model!r}, dt = {self.dt:g} s, at {self.time:g} s>"


def _at_least_one(name: str, value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise ValueError(f"{name} must be a whole number of at least 1, got {value!r}")
    return int(value)


def recorded_steps(duration: float, every: float | None, dt: float) -> tuple[int, int]:
    """Returns the number of steps of a run, and of those from frame to frame; arguments are those of ``run``."""
    steps = whole_steps("duration", duration, dt, exact=False)
    return steps, 1 if every is None else whole_steps("every", every, dt, exact=True)


def frame_count(steps: int, stride: int) -> int:
    """Returns the number of frames of a run, that of the start included."""
    return steps // stride + 1


def whole_steps(name: str, time: float, dt: float, *, exact: bool) -> int:
    """Returns the number of steps in a time.

    Args:
        name: What to call it in a message.
        time: The time [s], positive.
        dt: The step [s].
        exact: Whether the time must be a multiple of the step; if not, it is rounded up.

    Raises:
        ValueError: If ``time`` is not positive, or not a multiple of the step.
    """
    value = float(checks.numbers(name, time, (), checks.limits("s", above=0.0)))
    steps = value / dt
    nearest = round(steps)
    # Decimal fractions of a second are not exact; a millionth of a step is far below what anyone means.
    if nearest >= 1 and abs(steps - nearest) <= 1.0e-6:
        return nearest
    if exact:
        below, above = max(int(steps), 1), int(steps) + 1
        raise ValueError(
            f"{name} must be a multiple of dt = {dt:g} s, got {value:g} s; "
            f"the nearest are {below * dt:g} s and {above * dt:g} s"
        )
    return int(steps) + 1
