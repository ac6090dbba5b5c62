"""Time stepping: takes a model forward and records what is asked for."""

import os
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpcontact import checkpoint, checks
from warpcontact.advice import advice, level_outside, to_search
from warpcontact.arrays import Layout
from warpcontact.available import HOST, available_threads
from warpcontact.captures import beside_captures
from warpcontact.compiling import load_all
from warpcontact.contact_warning import ContactWarning, WarningLevel
from warpcontact.crew import Crew, Share
from warpcontact.environments import Environments
from warpcontact.footprint import Footprint, Need, environments, require
from warpcontact.integrators import Integrator, SemiImplicitEuler
from warpcontact.kernels.keywords import explain_keywords_of
from warpcontact.kernels.outcomes.base import Outcome
from warpcontact.kernels.renamed import explain_renamed
from warpcontact.looks import EVALUATED, in_parts, known_needs
from warpcontact.model import Model, State
from warpcontact.outcomes.watch import ContactEvents, StopCondition, Watch
from warpcontact.pace import Pace, bar_of
from warpcontact.parameters import rounded
from warpcontact.quarantine import CADENCE, raise_failed, reset_failed
from warpcontact.remarks import Remarks
from warpcontact.schedule import Span
from warpcontact.slices import Buffers, Frames, Stepper, Times
from warpcontact.stepping import Tally, cut, kernels_of_steps, slice_sizes, stepping_footprint
from warpcontact.taking import take_after, take_first
from warpcontact.uncopied import Uncopied
from warpcontact.whole_steps import frame_count, recorded_steps

# Labelled data, and what reads and writes it, takes as long to import as all the rest; who only steps has no need.
if TYPE_CHECKING:
    import xarray as xr

    from warpcontact.recorder import Recorder
    from warpcontact.recording import Recording

# Steps between two looks at the progress bar at least, whole graphs; and on a GPU, which queues them, at most.
SHORTEST_PIECE = 8
LONGEST_PIECE_QUEUED = 64


@explain_renamed
@explain_keywords_of
class Simulation(Uncopied, instead="simulation.save(path) and simulation.load(path) keep its state"):
    """Steps a model through time.

    Args:
        model: The model, on one device or split over several; its state is the state of the simulation.
        dt: Time step [s].
        integrator: Scheme, semi-implicit Euler if not given.
        crossing_substeps: Substeps in environments in which a swept point crosses a surface. 1: no substeps.
        threads: Threads that step the environments on the CPU, of all parts of a model; ``None``: one per core.
        deterministic: Whether a run repeats to the bit on a GPU as well, where several points of a body touch;
            on the CPU it does in any case, whatever the number of threads.
        distance_cache: Whether what is known of distances from earlier steps saves work; results are the same.
        capture_graphs: Whether steps are captured and replayed, without a word from Python; results are the same.
        outcomes: What to sum up of sensors while stepping, ``wc.outcomes``, by name; see ``outcomes()``.
        stop: Conditions that stop an environment, by name; the first in order wins.
        events: The contacts of which to write down when they are made and lost; see ``events()``.
        quarantine: What becomes of an environment that turns non-finite or goes beyond ``scene.max_speed`` or
            ``scene.max_distance``: ``"freeze"`` holds it at its last good state, ``"reset"`` puts it back to its
            initial one, ``"raise"`` raises a ``QuarantineError``; the last two look every ``CADENCE`` steps.

    Raises:
        KeyError: If there is no sensor of a name.
        ValueError: If an argument is not allowed.
        MemoryError: If stepping takes more memory than there is.
    """

    def __init__(
        self,
        model: Environments,
        dt: float,
        integrator: Integrator | None = None,
        *,
        crossing_substeps: int = 1,
        threads: int | None = None,
        deterministic: bool = False,
        distance_cache: bool = True,
        capture_graphs: bool = True,
        outcomes: Mapping[str, Outcome] | None = None,
        stop: Mapping[str, StopCondition] | None = None,
        events: ContactEvents | None = None,
        quarantine: str = "freeze",
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
        self.crossing_substeps = checks.whole("crossing_substeps", crossing_substeps)
        if self.crossing_substeps > 1 and not model.parts[0].sweeps:
            unused = f"crossing_substeps = {self.crossing_substeps} divides no step: no contact has swept=True"
            warnings.warn(ContactWarning(unused, WarningLevel.NOTE), stacklevel=level_outside())
        self.threads = available_threads() if threads is None else checks.whole("threads", threads)
        self.deterministic = bool(deterministic)
        self.distance_cache = bool(distance_cache)
        self.capture_graphs = bool(capture_graphs)
        self.watch = Watch.of(outcomes, stop, events, quarantine)
        # Whether the first step has nothing to warn of any more.
        self.advised = False
        require(self._stepping, model.envs, "to step them, ")
        self._buffers = [
            Buffers(part, integrator, self.dt, self.crossing_substeps, self.watch) for part in model.parts
        ]
        self._observers = [own.observer for own in self._buffers if own.observer is not None]
        if self._observers:
            model.make_measures(self._observers[0].needs)
            self.distance_cache = self.distance_cache and not self._observers[0].searches
        for part, buffers in zip(model.parts, self._buffers, strict=True):
            buffers.allocate(part.envs)
            if buffers.hard is not None:
                buffers.hard.begin(part, buffers.times.whole.dynamic)
            if buffers.observer is not None:
                buffers.observer.begin(part)
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
        """Lets sensors tell what this simulation does with contacts, not another one of the same model."""
        for part, buffers in zip(self.model.parts, self._buffers, strict=True):
            part.attach(buffers.hard, buffers.observer)

    def check(self) -> list[str]:
        """Returns what there is to say about the model as it is, and this step for it.

        The first step from the start of the model warns of it.
        """
        return advice(self.model, self.dt, self._buffers[0].hard)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes state, history, clocks and parameters into a file, from which ``load`` goes on to the bit.

        Args:
            path: The file, an ``.npz`` of plain arrays; one that is there is replaced as a whole.

        Raises:
            OSError: If it cannot be written.
        """
        self._attach()
        checkpoint.save(self, path)

    def load(self, path: str | os.PathLike[str]) -> None:
        """Takes over everything from a file that ``save`` wrote, in this process or another.

        The simulation must be of the same scene, number of environments, kind of device, precision, step and
        integrator. Its parameters become those of the file.

        Raises:
            CheckpointError: If the file is damaged or of another simulation; names the entry. Nothing is changed.
            FileNotFoundError: If there is none.
        """
        self._attach()
        checkpoint.load(self, path)

    def stepping_layouts(self) -> list[Layout]:
        """Returns what steps of each part of the model take on its device, beside the model."""
        return [buffers.layout for buffers in self._buffers]

    def memory(self) -> Footprint:
        """Returns what the model and this simulation take of memory; recordings come on top."""
        return self.model.footprint().with_needs(self._stepping(self.model.envs).needs)

    def needs_of_frames(self, needs: Set[str]) -> list[Need]:
        """Returns what steps take more of memory if they are recorded, by what sensors need."""
        alone, with_frames = (self._stepping(self.model.envs, looks) for looks in (None, frozenset(needs)))
        return [Need("launches", HOST, with_frames.of("launches") - alone.of("launches"))]

    def _stepping(self, envs: int, looks: frozenset[str] | None = None) -> Footprint:
        """Returns what this simulation would take if it had ``envs`` environments, beside the model."""
        return stepping_footprint(
            self.model.shares_of(envs),
            self.integrator,
            crossing_substeps=self.crossing_substeps,
            threads=self.threads,
            distance_cache=self.distance_cache,
            capture_graphs=self.capture_graphs,
            outcomes=self.watch.outcomes,
            stop=self.watch.stops,
            events=self.watch.events,
            quarantine=self.watch.quarantine,
            looks=looks,
        )

    def outcomes(self) -> "xr.Dataset":
        """Returns the outcomes so far, the current state included (env[, item][, axis]).

        Beside them ``status``, ``cause`` of being frozen, ``end_time``, the time of each environment, how many
        ``resets`` it had by the quarantine, and what it was ``stopped_by``, if there are conditions.

        Raises:
            RuntimeError: If another simulation of the model has taken over.
        """
        self._require_watch()
        from warpcontact.outcomes.report import outcomes_of

        return outcomes_of(self.model, self.watch, self._observers)

    def events(self) -> "xr.Dataset":
        """Returns when contacts were made and lost, up to the last step (env, event).

        Raises:
            ValueError: If no events are watched.
            RuntimeError: If another simulation of the model has taken over.
        """
        self._require_watch()
        from warpcontact.outcomes.report import events_of

        return events_of(self.model, self.watch, self._observers)

    def _require_watch(self) -> None:
        """Raises ``RuntimeError`` if the state is no longer what this simulation watched."""
        watched = [part.observer for part in self.model.parts]
        if self._observers and watched != self._observers:
            raise RuntimeError(
                "another simulation of the model has taken over since, and this one knows nothing of its steps; "
                "when this one steps again, outcomes and events begin anew"
            )

    def reset(self, env_mask: ArrayLike | None = None) -> None:
        """Resets state and history of the environments of a mask (envs,); ``None``: of all, and the clock."""
        self.model.reset(env_mask)

    def step(self, count: int = 1) -> None:
        """Takes ``count`` steps without recording.

        Raises:
            QuarantineError: If an environment failed and the quarantine is to raise.
            RuntimeError: If a neighbor list was too short. On a GPU the next evaluation raises it.
        """
        if checks.whole("count", count, least=0):
            self._advance(count, None)

    def step_with_callback(
        self, frames: int, every: int, needs: Iterable[str], take: Callable[[Model, slice, int], None]
    ) -> None:
        """Takes ``frames`` times ``every`` steps, and evaluates the state after each ``every`` of them.

        Args:
            frames: Number of frames.
            every: Steps between frames.
            needs: Quantities to compute, see ``Sensor.needs``; memory for them is allocated.
            take: Called with a part of the model, a range of its environments and the number of the frame, from 0.
                Several threads call it, each environment in order of frames. It may read only its range.

        Raises:
            ValueError: If a number or a need is not allowed.
            QuarantineError, RuntimeError: As ``step``.
        """
        count = checks.whole("frames", frames, least=0)
        self.step_to_frames(count, Frames(checks.whole("every", every), known_needs(needs), take))

    def step_to_frames(self, count: int, frames: Frames) -> None:
        """Takes steps to ``count`` frames, and looks at each."""
        self._attach()
        parts = self.model.parts
        if self.looks_by_slice(frames.needs):
            self._advance(count * frames.every, frames)
            return
        for number in range(frames.first, frames.first + count):
            self._advance(frames.every, None)
            # All parts are at work before the first is waited for.
            for part in parts:
                part.prepare(frames.needs)
            for part in parts:
                frames.take(part, slice(0, part.envs), number)

    def looks_by_slice(self, needs: frozenset[str]) -> bool:
        """Whether frames are looked at slice by slice."""
        parts = self.model.parts
        return self.watch.quarantine == "freeze" and all(in_parts(p.device, p.hard, needs) for p in parts)

    def _advance(self, count: int, frames: Frames | None) -> None:
        model = self.model
        self._attach()
        self._compile(frozenset() if frames is None else frames.needs)
        if model.at_start and not self.advised:
            self.advised = True
            for sentence in self.check():
                warnings.warn(ContactWarning(sentence), stacklevel=level_outside())
        for part, buffers in zip(model.parts, self._buffers, strict=True):
            part.untouched = False
            if buffers.hard is not None:
                buffers.hard.wake()
        crew, done = self.crew(), 0
        while done < count:
            some = count - done
            if self.watch.quarantine != "freeze":
                some = min(some, CADENCE - self.steps % CADENCE)
            before = [part.elapsed for part in model.parts]
            for taken in crew.step(some, frames):
                for part, elapsed in zip(model.parts, before, strict=True):
                    part.elapsed = elapsed + taken * self.dt
            done += some
            if self.watch.quarantine == "raise":
                raise_failed(model)
            elif self.watch.quarantine == "reset" and self.steps % CADENCE == 0:
                reset_failed(model, self._observers)
        # A GPU is still at work, and is asked when it is waited for.
        if all(device.is_cpu for device in model.devices):
            model.check_piles()

    def crew(self) -> Crew:
        """Returns the worker pool for the model as it is built now."""
        self._attach()
        revisions = tuple(part.revision for part in self.model.parts)
        prepared, crew = self._prepared
        if crew is None or prepared != revisions:
            crew = Crew(self._shares())
            self._prepared = (revisions, crew)
        return crew

    def _compile(self, needs: Set[str]) -> None:
        """Compiles the CPU kernels of steps and of frames with ``needs``, unless steps were prepared before."""
        if self._prepared[1] is not None or not any(device.is_cpu for device in self.model.devices):
            return
        with beside_captures():
            first = [EVALUATED] if self.model.at_start and not self.advised and self.evaluates_start else []
            load_all(self.kernels_of_steps([*first, needs]), wp.get_device("cpu"), self.threads)

    @beside_captures()
    def kernels_of_steps(self, looks: Sequence[Set[str]]) -> list[wp.Kernel]:
        """Returns the CPU kernels of steps and of frames, each once; ``looks``: needs of each kind of frame."""
        own = zip(self.model.parts, self._buffers, strict=True)
        on_cpu = [(part, self._stepper(part, buffers, Tally)) for part, buffers in own if part.device.is_cpu]
        return list(dict.fromkeys(kernel for one in on_cpu for kernel in kernels_of_steps(*one, looks)))

    @property
    def evaluates_start(self) -> bool:
        """Whether ``advice`` evaluates contacts at the present state."""
        return to_search(self.model, self._buffers[0].hard) is not None

    @beside_captures()
    def _shares(self) -> list[Share]:
        parts = [(part, part.envs) for part in self.model.parts]
        sizes = slice_sizes(parts, self.threads)
        slices = [cut(envs, size) for (_, envs), size in zip(parts, sizes, strict=True)]
        on_cpu = sum(len(own) for (part, _), own in zip(parts, slices, strict=True) if part.device.is_cpu)
        members = min(self.threads, on_cpu)
        return [
            Share(own, [self._stepper(part, buffers) for _ in range(members if part.device.is_cpu else 1)])
            for (part, _), own, buffers in zip(parts, slices, self._buffers, strict=True)
        ]

    def _stepper(self, model: Model, buffers: Buffers, kind: type[Span] | None = None) -> Stepper:
        # On the CPU a slice is stepped by one thread at a time, so the order is the same in any case.
        queued = model.device.is_cuda
        ordered = self.deterministic or not queued
        own = None if queued else wp.array([0, model.envs, 0], dtype=wp.int32, device=model.device)
        span = (kind or Span)(model, model.envs, self.distance_cache, ordered, queued, buffers.hard, slice=own)
        return Stepper(span, self.integrator, buffers, parts=self.crossing_substeps, captured=self.capture_graphs)

    def run(
        self,
        duration: float,
        record: Sequence[str] = (),
        every: float | None = None,
        *,
        poses: bool = True,
        parameters: Sequence[str] = (),
        progress: Any = None,
    ) -> "Recording":
        """Simulates for ``duration`` and returns what was recorded, the state at the start included.

        Args:
            duration: Simulated time [s]; rounded up to whole steps.
            record: Names of sensors, see ``model.sensor_names``.
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
            KeyError: If there is no such sensor.
            MemoryError: If the recording takes more memory than there is, before anything runs.
        """
        steps, stride = recorded_steps(duration, every, self.dt)
        if isinstance(record, str):
            raise TypeError(f"record must be a list of sensors, got the string {record!r}")
        self._attach()
        from warpcontact.recorder import Recorder

        recorder = Recorder(
            self.model, record, frames=frame_count(steps, stride), poses=poses, parameters=parameters
        )
        recorder.start(self.needs_of_frames(recorder.needs))
        remarks = Remarks(self.model)
        start = self.time
        with bar_of(progress, steps, environments(self.model.envs)) as bar:
            before = 0
            # Who gave a bar may look at the model when it moves.
            alone = bar is not progress
            for done in self.advance(recorder, steps, stride, start=start, alone=alone):
                bar.update(done - before)
                before = done
        for warning in (*remarks.about_frozen(), *remarks.new()):
            warnings.warn(warning, stacklevel=level_outside())
        attributes = {
            "dt": self.dt,
            "integrator": type(self.integrator).__name__,
            "frozen_environments": self.model.health().frozen.tolist(),
        }
        if (iterations := getattr(self.integrator, "iterations", None)) is not None:
            attributes["iterations"] = iterations
        return recorder.finish(attributes)

    def advance(
        self,
        recorder: "Recorder",
        steps: int,
        stride: int,
        *,
        start: float,
        done: int = 0,
        taken: int = 0,
        alone: bool = False,
    ) -> Iterator[int]:
        """Takes steps and records frames; yields the number of steps taken, at the start and after each chunk.

        Args:
            recorder: Records the frames, the first before the first step.
            steps: Number of steps.
            stride: Steps between frames.
            start: Time at the start [s].
            done: Number of steps taken before.
            taken: Number of frames taken before.
            alone: Whether the caller leaves the model unchanged meanwhile. Steps then reuse contacts of a frame.
        """
        follows, queued = False, any(device.is_cuda for device in self.model.devices)
        pace = Pace(SHORTEST_PIECE, LONGEST_PIECE_QUEUED if queued else None)
        self._compile(frozenset(recorder.needs))
        if done == taken * stride:
            take_first(self, recorder, start + done * self.dt)
            taken, follows = taken + 1, alone
        while True:
            yield done
            if done >= steps:
                return
            begin = time.perf_counter()
            count = pace.of(steps - done)
            every = taken * stride - done
            # A frame that is not much farther is taken with its steps.
            if every > min(2 * pace.steps, steps - done):
                self.step(count)
                follows = False
            else:
                # The first of a piece may be nearer than the others are apart.
                most = min(recorder.room, (steps - done) // stride)
                frames = max(1, pace.of(most * stride) // stride) if every == stride else 1
                take_after(self, recorder, frames, every, start, done, follows)
                count, taken, follows = frames * every, taken + frames, alone
            pace.took(count, time.perf_counter() - begin)
            done += count

    def __repr__(self) -> str:
        return f"<Simulation of {self.model!r}, dt = {self.dt:g} s, at {self.time:g} s>"
