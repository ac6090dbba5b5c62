"""Time stepping: takes a model forward and records what is asked for."""

import os
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpcontact.forces.execution_plan import ExecutionPlan
from warpcontact.forces.mesh_contact.step_warnings import caller_stacklevel, contacts_to_evaluate, scene_warnings
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.catalogue.renamed import explain_renamed
from warpcontact.kernels.outcomes.base import Outcome
from warpcontact.model.environments import Environments
from warpcontact.model.model import Model, State
from warpcontact.model.quarantine import CADENCE, raise_failed, reset_failed
from warpcontact.model.sensor_evaluation import CONTACT_NEEDS, can_evaluate_by_slice, check_needs
from warpcontact.stepping import checkpoint
from warpcontact.stepping.chunk_sizer import ChunkSizer, progress_bar
from warpcontact.stepping.frame_recording import record_first_frame, record_frames
from warpcontact.stepping.integrators import Integrator, SemiImplicitEuler
from warpcontact.stepping.outcomes.watch import ContactEvents, MonitorSettings, StopCondition
from warpcontact.stepping.requirements import KernelLister, cut_slices, slice_sizes, step_kernels, stepping_memory
from warpcontact.stepping.run_warnings import RunWarnings
from warpcontact.stepping.slice_stepper import FrameSchedule, StepBuffers, StepLengths, Stepper
from warpcontact.stepping.step_counts import frame_count, recorded_steps
from warpcontact.stepping.worker_pool import DeviceShare, WorkerPool
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.storage.memory_estimate import MemoryEstimate, MemoryItem, env_count_text, require
from warpcontact.storage.parameters import rounded
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.compilation import load_all
from warpcontact.system.resources import HOST, available_threads
from warpcontact.validation import checks
from warpcontact.validation.uncopyable import Uncopied
from warpcontact.validation.warning_levels import ContactWarning, WarningLevel

# Labelled data, and what reads and writes it, takes as long to import as all the rest; who only steps has no need.
if TYPE_CHECKING:
    import xarray as xr

    from warpcontact.stepping.recorder import Recorder
    from warpcontact.stepping.recording import Recording

# Steps between two looks at the progress bar at least, whole graphs; and on a GPU, which queues them, at most.
MIN_CHUNK = 8
MAX_CHUNK_GPU = 64


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
        self.crossing_substeps = checks.integer("crossing_substeps", crossing_substeps)
        if self.crossing_substeps > 1 and not model.parts[0].has_swept_contacts:
            unused = f"crossing_substeps = {self.crossing_substeps} divides no step: no contact has swept=True"
            warnings.warn(ContactWarning(unused, WarningLevel.NOTE), stacklevel=caller_stacklevel())
        self.threads = available_threads() if threads is None else checks.integer("threads", threads)
        self.deterministic = bool(deterministic)
        self.distance_cache = bool(distance_cache)
        self.capture_graphs = bool(capture_graphs)
        self.monitor_settings = MonitorSettings.of(outcomes, stop, events, quarantine)
        # Whether the first step has nothing to warn of any more.
        self.warned_at_start = False
        require(self._stepping_memory, model.envs, "to step them, ")
        self._buffers = [
            StepBuffers(part, integrator, self.dt, self.crossing_substeps, self.monitor_settings)
            for part in model.parts
        ]
        self._monitors = [own.monitor for own in self._buffers if own.monitor is not None]
        if self._monitors:
            model.ensure_sensor_arrays(self._monitors[0].needs)
            self.distance_cache = self.distance_cache and not self._monitors[0].needs_all_distances
        for part, buffers in zip(model.parts, self._buffers, strict=True):
            buffers.allocate(part.envs)
            if buffers.nonsmooth is not None:
                buffers.nonsmooth.attach_simulation(part, buffers.times.full.real)
            if buffers.monitor is not None:
                buffers.monitor.initialize(part)
        self._attach_to_model()
        self._prepared: tuple[tuple[int, ...], WorkerPool | None] = ((), None)

    @property
    def times(self) -> StepLengths:
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

    def _attach_to_model(self) -> None:
        """Lets sensors tell what this simulation does with contacts, not another one of the same model."""
        for part, buffers in zip(self.model.parts, self._buffers, strict=True):
            part.attach_simulation(buffers.nonsmooth, buffers.monitor)

    def check(self) -> list[str]:
        """Returns what there is to say about the model as it is, and this step for it.

        The first step from the start of the model warns of it.
        """
        return scene_warnings(self.model, self.dt, self._buffers[0].nonsmooth)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes state, history, clocks and parameters into a file, from which ``load`` goes on to the bit.

        Args:
            path: The file, an ``.npz`` of plain arrays; one that is there is replaced as a whole.

        Raises:
            OSError: If it cannot be written.
        """
        self._attach_to_model()
        checkpoint.save(self, path)

    def load(self, path: str | os.PathLike[str]) -> None:
        """Takes over everything from a file that ``save`` wrote, in this process or another.

        The simulation must be of the same scene, number of environments, kind of device, precision, step and
        integrator. Its parameters become those of the file.

        Raises:
            CheckpointError: If the file is damaged or of another simulation; names the entry. Nothing is changed.
            FileNotFoundError: If there is none.
        """
        self._attach_to_model()
        checkpoint.load(self, path)

    def step_allocations(self) -> list[AllocationPlan]:
        """Returns what steps of each part of the model take on its device, beside the model."""
        return [buffers.layout for buffers in self._buffers]

    def memory(self) -> MemoryEstimate:
        """Returns what the model and this simulation take of memory; recordings come on top."""
        return self.model.memory_estimate().with_items(self._stepping_memory(self.model.envs).items)

    def frame_memory(self, needs: Set[str]) -> list[MemoryItem]:
        """Returns what steps take more of memory if they are recorded, by what sensors need."""
        without_frames, with_frames = (
            self._stepping_memory(self.model.envs, recorded_needs) for recorded_needs in (None, frozenset(needs))
        )
        return [
            MemoryItem("launches", HOST, with_frames.bytes_for("launches") - without_frames.bytes_for("launches"))
        ]

    def _stepping_memory(self, envs: int, recorded_needs: frozenset[str] | None = None) -> MemoryEstimate:
        """Returns what this simulation would take if it had ``envs`` environments, beside the model."""
        return stepping_memory(
            self.model.shares_of(envs),
            self.integrator,
            crossing_substeps=self.crossing_substeps,
            threads=self.threads,
            distance_cache=self.distance_cache,
            capture_graphs=self.capture_graphs,
            outcomes=self.monitor_settings.outcomes,
            stop=self.monitor_settings.stops,
            events=self.monitor_settings.events,
            quarantine=self.monitor_settings.quarantine,
            recorded_needs=recorded_needs,
        )

    def outcomes(self) -> "xr.Dataset":
        """Returns the outcomes so far, the current state included (env[, item][, axis]).

        Beside them ``status``, ``cause`` of being frozen, ``end_time``, the time of each environment, how many
        ``resets`` it had by the quarantine, and what it was ``stopped_by``, if there are conditions.

        Raises:
            RuntimeError: If another simulation of the model has taken over.
        """
        self._require_monitors()
        from warpcontact.stepping.outcomes.report import outcomes_of

        return outcomes_of(self.model, self.monitor_settings, self._monitors)

    def events(self) -> "xr.Dataset":
        """Returns when contacts were made and lost, up to the last step (env, event).

        Raises:
            ValueError: If no events are watched.
            RuntimeError: If another simulation of the model has taken over.
        """
        self._require_monitors()
        from warpcontact.stepping.outcomes.report import events_of

        return events_of(self.model, self.monitor_settings, self._monitors)

    def _require_monitors(self) -> None:
        """Raises ``RuntimeError`` if the state is no longer what this simulation watched."""
        part_monitors = [part.monitor for part in self.model.parts]
        if self._monitors and part_monitors != self._monitors:
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
        if checks.integer("count", count, least=0):
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
        count = checks.integer("frames", frames, least=0)
        self.step_to_frames(count, FrameSchedule(checks.integer("every", every), check_needs(needs), take))

    def step_to_frames(self, count: int, frames: FrameSchedule) -> None:
        """Takes steps to ``count`` frames, and looks at each."""
        self._attach_to_model()
        parts = self.model.parts
        if self.evaluates_by_slice(frames.needs):
            self._advance(count * frames.every, frames)
            return
        for number in range(frames.first_frame, frames.first_frame + count):
            self._advance(frames.every, None)
            # All parts are at work before the first is waited for.
            for part in parts:
                part.evaluate_needs(frames.needs)
            for part in parts:
                frames.deliver_frame(part, slice(0, part.envs), number)

    def evaluates_by_slice(self, needs: frozenset[str]) -> bool:
        """Whether frames are looked at slice by slice."""
        parts = self.model.parts
        return self.monitor_settings.quarantine == "freeze" and all(
            can_evaluate_by_slice(p.device, p.nonsmooth, needs) for p in parts
        )

    def _advance(self, count: int, frames: FrameSchedule | None) -> None:
        model = self.model
        self._attach_to_model()
        self._compile(frozenset() if frames is None else frames.needs)
        if model.at_start and not self.warned_at_start:
            self.warned_at_start = True
            for sentence in self.check():
                warnings.warn(ContactWarning(sentence), stacklevel=caller_stacklevel())
        for part, buffers in zip(model.parts, self._buffers, strict=True):
            part.is_initial = False
            if buffers.nonsmooth is not None:
                buffers.nonsmooth.wake()
        worker_pool, done = self.worker_pool(), 0
        while done < count:
            chunk = count - done
            if self.monitor_settings.quarantine != "freeze":
                chunk = min(chunk, CADENCE - self.steps % CADENCE)
            before = [part.elapsed for part in model.parts]
            for taken in worker_pool.step(chunk, frames):
                for part, elapsed in zip(model.parts, before, strict=True):
                    part.elapsed = elapsed + taken * self.dt
            done += chunk
            if self.monitor_settings.quarantine == "raise":
                raise_failed(model)
            elif self.monitor_settings.quarantine == "reset" and self.steps % CADENCE == 0:
                reset_failed(model, self._monitors)
        # A GPU is still at work, and is asked when it is waited for.
        if all(device.is_cpu for device in model.devices):
            model.check_neighbor_lists()

    def worker_pool(self) -> WorkerPool:
        """Returns the worker pool for the model as it is built now."""
        self._attach_to_model()
        revisions = tuple(part.revision for part in self.model.parts)
        prepared, worker_pool = self._prepared
        if worker_pool is None or prepared != revisions:
            worker_pool = WorkerPool(self._device_shares())
            self._prepared = (revisions, worker_pool)
        return worker_pool

    def _compile(self, needs: Set[str]) -> None:
        """Compiles the CPU kernels of steps and of frames with ``needs``, unless steps were prepared before."""
        if self._prepared[1] is not None or not any(device.is_cpu for device in self.model.devices):
            return
        with shared_capture_lock():
            first = (
                [CONTACT_NEEDS]
                if self.model.at_start and not self.warned_at_start and self.evaluates_start
                else []
            )
            load_all(self.step_kernels([*first, needs]), wp.get_device("cpu"), self.threads)

    @shared_capture_lock()
    def step_kernels(self, recorded_needs: Sequence[Set[str]]) -> list[wp.Kernel]:
        """Returns the CPU kernels of steps and of frames, each once; ``recorded_needs``: needs of each kind of frame."""
        own = zip(self.model.parts, self._buffers, strict=True)
        on_cpu = [
            (part, self._stepper(part, buffers, KernelLister)) for part, buffers in own if part.device.is_cpu
        ]
        return list(dict.fromkeys(kernel for pair in on_cpu for kernel in step_kernels(*pair, recorded_needs)))

    @property
    def evaluates_start(self) -> bool:
        """Whether ``advice`` evaluates contacts at the present state."""
        return contacts_to_evaluate(self.model, self._buffers[0].nonsmooth) is not None

    @shared_capture_lock()
    def _device_shares(self) -> list[DeviceShare]:
        parts = [(part, part.envs) for part in self.model.parts]
        sizes = slice_sizes(parts, self.threads)
        slices = [cut_slices(envs, size) for (_, envs), size in zip(parts, sizes, strict=True)]
        on_cpu = sum(len(own) for (part, _), own in zip(parts, slices, strict=True) if part.device.is_cpu)
        thread_count = min(self.threads, on_cpu)
        return [
            DeviceShare(
                own, [self._stepper(part, buffers) for _ in range(thread_count if part.device.is_cpu else 1)]
            )
            for (part, _), own, buffers in zip(parts, slices, self._buffers, strict=True)
        ]

    def _stepper(self, model: Model, buffers: StepBuffers, kind: type[ExecutionPlan] | None = None) -> Stepper:
        # On the CPU a slice is stepped by one thread at a time, so the order is the same in any case.
        uses_gpu = model.device.is_cuda
        ordered = self.deterministic or not uses_gpu
        own = None if uses_gpu else wp.array([0, model.envs, 0], dtype=wp.int32, device=model.device)
        plan = (kind or ExecutionPlan)(
            model, model.envs, self.distance_cache, ordered, uses_gpu, buffers.nonsmooth, slice=own
        )
        return Stepper(
            plan, self.integrator, buffers, substeps=self.crossing_substeps, captured=self.capture_graphs
        )

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
        self._attach_to_model()
        from warpcontact.stepping.recorder import Recorder

        recorder = Recorder(
            self.model, record, frames=frame_count(steps, stride), poses=poses, parameters=parameters
        )
        recorder.start(self.frame_memory(recorder.needs))
        remarks = RunWarnings(self.model)
        start = self.time
        with progress_bar(progress, steps, env_count_text(self.model.envs)) as bar:
            before = 0
            # Who gave a bar may look at the model when it moves.
            exclusive = bar is not progress
            for done in self.advance(recorder, steps, stride, start=start, exclusive=exclusive):
                bar.update(done - before)
                before = done
        for warning in (*remarks.frozen_warnings(), *remarks.new()):
            warnings.warn(warning, stacklevel=caller_stacklevel())
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
        exclusive: bool = False,
    ) -> Iterator[int]:
        """Takes steps and records frames; yields the number of steps taken, at the start and after each chunk.

        Args:
            recorder: Records the frames, the first before the first step.
            steps: Number of steps.
            stride: Steps between frames.
            start: Time at the start [s].
            done: Number of steps taken before.
            taken: Number of frames taken before.
            exclusive: Whether the caller leaves the model unchanged meanwhile. Steps then reuse contacts of a frame.
        """
        follows_frame, uses_gpu = False, any(device.is_cuda for device in self.model.devices)
        chunk_sizer = ChunkSizer(MIN_CHUNK, MAX_CHUNK_GPU if uses_gpu else None)
        self._compile(frozenset(recorder.needs))
        if done == taken * stride:
            record_first_frame(self, recorder, start + done * self.dt)
            taken, follows_frame = taken + 1, exclusive
        while True:
            yield done
            if done >= steps:
                return
            begin = time.perf_counter()
            count = chunk_sizer.next(steps - done)
            every = taken * stride - done
            # A frame that is not much farther is taken with its steps.
            if every > min(2 * chunk_sizer.steps, steps - done):
                self.step(count)
                follows_frame = False
            else:
                # The first of a piece may be nearer than the others are apart.
                max_frames = min(recorder.free_frames, (steps - done) // stride)
                frames = max(1, chunk_sizer.next(max_frames * stride) // stride) if every == stride else 1
                record_frames(self, recorder, frames, every, start, done, follows_frame)
                count, taken, follows_frame = frames * every, taken + frames, exclusive
            chunk_sizer.record(count, time.perf_counter() - begin)
            done += count

    def __repr__(self) -> str:
        return f"<Simulation of {self.model!r}, dt = {self.dt:g} s, at {self.time:g} s>"
