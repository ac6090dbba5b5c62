"""Time stepping: advances a model and records sensors."""

import os
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike

from warpcontact.forces.advice import advice_needs_evaluation, scene_advice
from warpcontact.forces.launch_shape import AUTO, SHAPES
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.catalogue.names import explain_renamed
from warpcontact.kernels.outcomes.base import Outcome
from warpcontact.model.environments import Environments
from warpcontact.model.model import DeviceModel, State
from warpcontact.model.model_traits import CONTACT_NEEDS
from warpcontact.model.quarantine import CADENCE, raise_failed, reset_failed
from warpcontact.model.sensor_evaluation import can_evaluate_by_slice
from warpcontact.stepping import checkpoint
from warpcontact.stepping.chunk_sizer import ChunkSizer, progress_bar
from warpcontact.stepping.explanation import StepExplanation
from warpcontact.stepping.frame_recording import record_first_frame, record_frames
from warpcontact.stepping.integrators import Integrator, SemiImplicitEuler
from warpcontact.stepping.outcomes.watch import ContactEvents, MonitorSettings, StopCondition
from warpcontact.stepping.requirements import stepping_memory
from warpcontact.stepping.run_warnings import RunWarnings
from warpcontact.stepping.slice_stepper import FrameSchedule, StepBuffers, StepLengths
from warpcontact.stepping.step_counts import frame_count, recorded_steps
from warpcontact.stepping.step_preparation import StepOptions, StepPreparation
from warpcontact.stepping.worker_pool import WorkerPool
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.storage.memory_estimate import MemoryEstimate, MemoryItem, env_count_text, require
from warpcontact.storage.model_arrays import Uncopied
from warpcontact.storage.parameters import rounded
from warpcontact.system.resources import HOST, available_threads
from warpcontact.validation import checks
from warpcontact.validation.warning_levels import ContactWarning, WarningLevel, caller_stacklevel

# xarray takes as long to import as the rest of the package. Stepping without recording does not need it.
if TYPE_CHECKING:
    import xarray as xr

    from warpcontact.stepping.recorder import Recorder
    from warpcontact.stepping.recording import Recording

# Minimum number of steps between updates of the progress bar: one CPU graph. Maximum on a GPU, where launches are
# queued, so that their duration cannot be measured.
MIN_CHUNK = 8
MAX_CHUNK_GPU = 64


@explain_renamed
@explain_keywords_of
class Simulation(Uncopied, instead="simulation.save(path) and simulation.load(path) keep its state"):
    """Advances a model in time.

    A simulation owns the step buffers, the integrator and the monitors; the state belongs to the model. Several
    simulations of one model can exist, but only the last one that stepped has valid outcomes.

    Args:
        model: Model from ``Scene.build``, on one or several devices.
        dt: Time step [s], positive.
        integrator: Time integrator. Default: ``SemiImplicitEuler()``. ``MoreauJean()`` gives nonsmooth contact.
        crossing_substeps: Number of substeps for environments in which a swept point crosses a surface. 1: no
            substeps.
        threads: Number of CPU threads. Default: one per available core.
        deterministic: Sum contact forces in a fixed order on a GPU, so that runs are bitwise reproducible. CPU runs
            always are.
        distance_cache: Skip contacts that cannot touch, using cached distances. Does not change results.
        capture_graphs: Capture steps as graphs and replay them. Does not change results.
        launch_shape: How stages are composed into kernels: ``"warp per environment"``, ``"loop per environment"``,
            ``"fused contact"`` or ``"staged"``. Default: ``"auto"``, the fastest one that is possible, see
            ``explain()``. Does not change results.
        outcomes: Outcomes to compute while stepping, by name; see ``outcomes()``.
        stop: Stop conditions, by name. If several hold, the first one is reported.
        events: Contacts whose start and end times are recorded; see ``events()``.
        quarantine: Policy for environments that become non-finite or exceed ``scene.max_speed`` or
            ``scene.max_distance``. ``"freeze"``: keep the last valid state. ``"reset"``: return to the initial state.
            ``"raise"``: raise ``QuarantineError``. ``"reset"`` and ``"raise"`` are checked every ``CADENCE`` steps.

    Raises:
        KeyError: If a sensor or contact name does not exist.
        ValueError: If an argument is out of range; the message names it.
        MemoryError: If the step buffers do not fit into memory.
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
        launch_shape: str = AUTO,
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
        self.launch_shape = checks.choice("launch_shape", launch_shape, (AUTO, *SHAPES))
        self.monitor_settings = MonitorSettings.of(outcomes, stop, events, quarantine)
        # Whether the warnings of the first step were already issued.
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
        options = StepOptions(
            self.crossing_substeps,
            self.threads,
            self.deterministic,
            self.distance_cache,
            self.capture_graphs,
            self.launch_shape,
        )
        self._preparation = StepPreparation(model, integrator, self._buffers, options)
        if self.launch_shape != AUTO:
            self._require_shape(self.launch_shape)

    def _require_shape(self, name: str) -> None:
        """Raises ``ValueError`` if the launch shape ``name`` is not possible."""
        for part in self.explain().parts:
            if part.shape.name != name:
                raise ValueError(f'launch_shape must not be "{name}": {part.shape.rejected[name]}')

    def explain(self) -> StepExplanation:
        """Returns how steps are launched: launch shape, kernels, and why faster launch shapes are not possible.

        Print the result. It does not depend on the state of the model, and nothing is compiled.
        """
        return self._preparation.explain()

    def compile(self) -> None:
        """Compiles all kernels of steps now, for measurements. By default they are compiled in the background.

        The next step uses the fastest possible launch shape. Kernels of recorded frames are not compiled.
        """
        if self._preparation.load_release_builds():
            self._prepared = ((), None)
            self.worker_pool()

    @property
    def times(self) -> StepLengths:
        """Step lengths, on the device of the first part of the model."""
        return self._buffers[0].times

    @property
    def state(self) -> State:
        """The current state; see ``Model``. For a model on several devices use the states of ``model.parts``."""
        return self.model.state

    @property
    def time(self) -> float:
        """Simulated time since the last complete reset of the model [s]."""
        return self.model.time

    @property
    def steps(self) -> int:
        """Simulated time divided by ``dt``, rounded to an integer."""
        return round(self.model.time / self.dt)

    def _attach_to_model(self) -> None:
        """Makes the model's sensors read the nonsmooth contacts and monitors of this simulation."""
        for part, buffers in zip(self.model.parts, self._buffers, strict=True):
            part.attach_simulation(buffers.nonsmooth, buffers.monitor)

    def check(self) -> list[str]:
        """Returns the warnings for the current model state and time step.

        The first step from the initial state of the model issues them.
        """
        return scene_advice(self.model, self.dt, self._buffers[0].nonsmooth, self.integrator.stiffness_factor)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes state, history, clocks and parameters into a checkpoint.

        After ``load``, steps are bitwise identical to those of a simulation that was not interrupted.

        Args:
            path: Checkpoint file, an ``.npz`` of plain arrays. An existing file is replaced atomically.

        Raises:
            OSError: If the file cannot be written.
        """
        self._attach_to_model()
        checkpoint.save(self, path)

    def load(self, path: str | os.PathLike[str]) -> None:
        """Loads state, history, clocks and parameters from a checkpoint that ``save`` wrote in any process.

        The simulation must have the same scene, number of environments, kind of device, precision, time step and
        integrator. Its parameters are replaced by those of the file.

        Raises:
            CheckpointError: If the file is damaged or belongs to another simulation. The message names the entry;
                the simulation is unchanged.
            FileNotFoundError: If the file does not exist.
        """
        self._attach_to_model()
        checkpoint.load(self, path)

    def step_allocations(self) -> list[AllocationPlan]:
        """Returns the allocations for stepping of each part of the model, without those of the model."""
        return [buffers.layout for buffers in self._buffers]

    def memory(self) -> MemoryEstimate:
        """Returns the memory estimate of the model and this simulation, without recordings."""
        return self.model.memory_estimate().with_items(self._stepping_memory(self.model.envs).items)

    def frame_memory(self, needs: Set[str]) -> list[MemoryItem]:
        """Returns the additional memory of steps that record sensors with ``needs`` (see ``Sensor.needs``)."""
        without_frames, with_frames = (
            self._stepping_memory(self.model.envs, recorded_needs) for recorded_needs in (None, frozenset(needs))
        )
        return [
            MemoryItem("launches", HOST, with_frames.bytes_for("launches") - without_frames.bytes_for("launches"))
        ]

    def _stepping_memory(self, envs: int, recorded_needs: frozenset[str] | None = None) -> MemoryEstimate:
        """Returns the memory estimate of stepping ``envs`` environments, without the model."""
        return stepping_memory(
            self.model.shares_of(envs),
            self.integrator,
            crossing_substeps=self.crossing_substeps,
            threads=self.threads,
            distance_cache=self.distance_cache,
            capture_graphs=self.capture_graphs,
            launch_shape=self.launch_shape,
            outcomes=self.monitor_settings.outcomes,
            stop=self.monitor_settings.stops,
            events=self.monitor_settings.events,
            quarantine=self.monitor_settings.quarantine,
            recorded_needs=recorded_needs,
        )

    def outcomes(self) -> "xr.Dataset":
        """Returns the outcomes up to and including the current state (env[, item][, axis]).

        The data set also has, per environment: ``status``, ``cause`` of failure, ``end_time`` (its clock) [s],
        ``resets`` (number of resets by the quarantine) and, if there are stop conditions, ``stopped_by``.

        Raises:
            RuntimeError: If another simulation of the model stepped since.
        """
        self._require_monitors()
        from warpcontact.stepping.outcomes.report import outcomes_of

        return outcomes_of(self.model, self.monitor_settings, self._monitors)

    def events(self) -> "xr.Dataset":
        """Returns the start and end times of contacts, up to the last step (env, event).

        Raises:
            ValueError: If the simulation has no ``events``.
            RuntimeError: If another simulation of the model stepped since.
        """
        self._require_monitors()
        from warpcontact.stepping.outcomes.report import events_of

        return events_of(self.model, self.monitor_settings, self._monitors)

    def _require_monitors(self) -> None:
        """Raises ``RuntimeError`` if another simulation stepped the model since."""
        part_monitors = [part.monitor for part in self.model.parts]
        if self._monitors and part_monitors != self._monitors:
            raise RuntimeError(
                "another simulation stepped the model since, so the outcomes and events of this simulation are "
                "invalid. They restart when this simulation steps again"
            )

    def reset(self, env_mask: ArrayLike | None = None) -> None:
        """Resets state and history of the environments in a mask (envs,); ``None``: of all, and the clock."""
        self.model.reset(env_mask)

    def step(self, count: int = 1) -> None:
        """Takes ``count`` steps without recording.

        Raises:
            QuarantineError: If an environment failed and ``quarantine`` is ``"raise"``.
            RuntimeError: If a neighbor list was too short. On a GPU the next evaluation raises it.
        """
        if checks.integer("count", count, least=0):
            self._advance(count, None)

    def step_with_callback(
        self, frames: int, every: int, needs: Iterable[str], take: Callable[[DeviceModel, slice, int], None]
    ) -> None:
        """Takes ``frames`` × ``every`` steps, and evaluates the state after every ``every`` steps.

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
        self.step_to_frames(
            count, FrameSchedule(checks.integer("every", every), self.model.parts[0].check_needs(needs), take)
        )

    def step_to_frames(self, count: int, frames: FrameSchedule) -> None:
        """Takes the steps of ``count`` frames, and evaluates and delivers each frame."""
        self._attach_to_model()
        parts = self.model.parts
        if self.evaluates_by_slice(frames.needs):
            self._advance(count * frames.every, frames)
            return
        for number in range(frames.first_frame, frames.first_frame + count):
            self._advance(frames.every, None)
            # Launch all parts before waiting for the first one, so that devices run in parallel.
            for part in parts:
                part.evaluate_needs(frames.needs)
            for part in parts:
                frames.deliver_frame(part, slice(0, part.envs), number)

    def evaluates_by_slice(self, needs: frozenset[str]) -> bool:
        """Whether frames with ``needs`` can be evaluated slice by slice."""
        parts = self.model.parts
        return self.monitor_settings.quarantine == "freeze" and all(
            can_evaluate_by_slice(part, part.device, part.nonsmooth is not None, needs) for part in parts
        )

    def _advance(self, count: int, frames: FrameSchedule | None) -> None:
        model = self.model
        self._attach_to_model()
        self._load_kernels(frozenset() if frames is None else frames.needs)
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
        # A GPU may still be running; the next evaluation checks it.
        if all(device.is_cpu for device in model.devices):
            model.check_neighbor_lists()

    def worker_pool(self) -> WorkerPool:
        """Returns the worker pool; rebuilt if a part of the model has a new revision."""
        self._attach_to_model()
        revisions = tuple(part.revision for part in self.model.parts)
        prepared, worker_pool = self._prepared
        if worker_pool is None or prepared != revisions:
            worker_pool = WorkerPool(self._preparation.device_shares(), self._preparation.renewed_shares)
            self._prepared = (revisions, worker_pool)
        return worker_pool

    def _load_kernels(self, needs: frozenset[str]) -> None:
        """Loads the CPU kernels of steps, of frames with ``needs``, and of the warnings of the first step."""
        warns = self.model.at_start and not self.warned_at_start and self.evaluates_start
        self.load_kernels([*([CONTACT_NEEDS] if warns else []), needs])

    def load_kernels(self, recorded_needs: Sequence[Set[str]]) -> None:
        """Loads the CPU kernels of steps and of frames; ``recorded_needs``: needs of each kind of frame."""
        self._preparation.load_kernels(recorded_needs)

    def step_kernels(self, recorded_needs: Sequence[Set[str]]) -> list[wp.Kernel]:
        """Returns the CPU kernels of steps and frames, each once; ``recorded_needs``: needs of each kind of frame."""
        return self._preparation.step_kernels(recorded_needs)

    @property
    def evaluates_start(self) -> bool:
        """Whether ``check`` evaluates contacts at the current state."""
        return advice_needs_evaluation(self.model, self._buffers[0].nonsmooth)

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
        """Simulates for ``duration`` and returns a recording, including the state at the start.

        Args:
            duration: Simulated time [s]; rounded up to whole steps.
            record: Names of sensors, see ``model.sensor_names``.
            every: Time between frames [s], a multiple of the time step. Default: every step.
            poses: Whether to record also the position and orientation of every body, and the parameters
                that differ between environments, so that the recording can be replayed and exported.
            parameters: Names of further parameters to store in the recording, whether or not they differ.
            progress: Whether to show a progress bar. Default: in a terminal, for runs longer than 1 s. A given tqdm
                bar is advanced by the steps of this run and not closed.

        Returns:
            A data set with dimensions (time, env), then ``item`` for sets of points and ``axis`` or
            ``component`` for vectors and quaternions; units are in the attributes.

        Raises:
            ValueError: If a time is out of range.
            KeyError: If a sensor does not exist.
            MemoryError: If the recording does not fit into memory; raised before the first step.
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
            # The owner of a given bar may read the model when the bar is updated.
            exclusive = bar is not progress
            for done in self.advance(recorder, steps, stride, start=start, exclusive=exclusive):
                bar.update(done - before)
                before = done
        for warning in (*remarks.frozen_warnings(), *remarks.new()):
            warnings.warn(warning, stacklevel=caller_stacklevel())
        attributes = {
            "dt": self.dt,
            **self.integrator_attributes(),
            "frozen_environments": self.model.health().frozen.tolist(),
        }
        return recorder.finish(attributes)

    def integrator_attributes(self) -> dict[str, Any]:
        """Returns the attributes of a recording that describe the integrator."""
        attributes: dict[str, Any] = {"integrator": type(self.integrator).__name__}
        if (iterations := getattr(self.integrator, "iterations", None)) is not None:
            attributes["iterations"] = iterations
        if compliant := getattr(self.integrator, "compliant", ()):
            attributes["compliant"] = list(compliant)
        return attributes

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
            exclusive: Whether the caller leaves the model unchanged in the meantime. Steps then reuse the contacts
                of a frame.
        """
        follows_frame, uses_gpu = False, any(device.is_cuda for device in self.model.devices)
        chunk_sizer = ChunkSizer(MIN_CHUNK, MAX_CHUNK_GPU if uses_gpu else None)
        self._load_kernels(frozenset(recorder.needs))
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
            # If the next frame is within two chunks, take it together with its steps.
            if every > min(2 * chunk_sizer.steps, steps - done):
                self.step(count)
                follows_frame = False
            else:
                # The first frame may be closer than the stride; it is then recorded alone.
                max_frames = min(recorder.free_frames, (steps - done) // stride)
                frames = max(1, chunk_sizer.next(max_frames * stride) // stride) if every == stride else 1
                record_frames(self, recorder, frames, every, start, done, follows_frame)
                count, taken, follows_frame = frames * every, taken + frames, exclusive
            chunk_sizer.record(count, time.perf_counter() - begin)
            done += count

    def __repr__(self) -> str:
        return f"<Simulation of {self.model!r}, dt = {self.dt:g} s, at {self.time:g} s>"
