"""Stepping of slices of environments.

A slice is a range of environments whose state fits into the cache of a core. ``Stepper`` prepares the launches of a
step once and captures them as graphs of up to 8 steps on a CPU and 32 on a GPU. On a CPU the launches read the range
of environments from memory, so a worker uses the same graphs for every slice. A step with substeps
(``crossing_substeps``) depends on a host decision and is launched without a graph.
"""

from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.execution_plan import (
    ExecutionPlan,
    StepLength,
    accept_stages,
    copy_state_stage,
    mask_substeps_stage,
)
from warpcontact.forces.launch_shape import LOOP_PER_ENVIRONMENT
from warpcontact.kernels.lowlevel.unique_kernel import QUICK
from warpcontact.model.sensor_evaluation import provides_contacts
from warpcontact.stepping.frame_copies import FrameCopies, FrameRecording
from warpcontact.stepping.integrators import Integrator
from warpcontact.stepping.outcomes.observer import Monitor
from warpcontact.stepping.outcomes.watch import MonitorSettings
from warpcontact.storage.allocation_plan import AllocationPlan, broadcast, per_env
from warpcontact.system.capture_lock import exclusive_capture_lock, shared_capture_lock

if TYPE_CHECKING:
    from warpcontact.model.model import DeviceModel
    from warpcontact.model.plan import DeviceModelPlan

# Steps per graph, largest first; any number of steps is composed of these. A graph of an odd number ends in the other
# buffer and copies it back. On a CPU Warp takes 0.25 ms to capture a launch, for each thread.
GRAPH_STEPS = (32, 2, 1)
CPU_GRAPH_STEPS, SHORT_GRAPH_STEPS = (8, 2, 1), (2, 1)
# Steps between two frames and the evaluation are captured as one graph up to this many times the largest graph.
MAX_FRAME_GRAPHS = 2


@dataclass(frozen=True)
class StepLengths:
    """Lengths of a step and of a substep, and their differences.

    Attributes:
        full: Length of a step.
        substep: Length of a substep.
        to_substep: Change from a step to a substep, negative [env, 0] [s].
        to_full: Change from a substep to a step [env, 0] [s].
    """

    full: StepLength
    substep: StepLength
    to_substep: wp.array
    to_full: wp.array


@dataclass(eq=False)
class _LengthArrays:
    """Memory of step lengths, one for all environments [1, 1] [s]; ``None`` before allocation.

    Attributes:
        full: Time step.
        substep: Substep.
        to_substep: Change from a time step to a substep.
        to_full: Change from a substep to a time step.
        full_clock: Time step, in float64.
        full_half_clock: Half of it.
        substep_clock: Substep, in float64.
        substep_half_clock: Half of it.
    """

    full: Any = None
    substep: Any = None
    to_substep: Any = None
    to_full: Any = None
    full_clock: Any = None
    full_half_clock: Any = None
    substep_clock: Any = None
    substep_half_clock: Any = None


class StepBuffers:
    """Device buffers for stepping a model; valid after ``allocate``.

    Args:
        model: The model, or its plan.
        integrator: The time integrator.
        dt: Time step [s].
        substeps: Number of substeps of a step with a crossing.
        settings: Monitor settings.

    Attributes:
        layout: Allocation plan of the buffers.
        times: Step lengths.
        other_state: Second state buffer. Steps alternate between the model's state and this buffer; between calls the
            current state is in the model.
        nonsmooth: The nonsmooth contacts. ``None``: the integrator has none.
        monitor: Monitor of outcomes, events and stop conditions. ``None``: nothing is monitored.
    """

    def __init__(
        self,
        model: "DeviceModel | DeviceModelPlan",
        integrator: Integrator,
        dt: float = 0.0,
        substeps: int = 1,
        settings: MonitorSettings | None = None,
    ) -> None:
        self.layout = AllocationPlan(model.device)
        unallocated = StepLength(None, None, None)
        self.times = StepLengths(unallocated, unallocated, None, None)
        self.other_state = self.layout.struct(
            "stepping",
            model.types.State,
            per_env(model.body_count),
            transient=True,
            body_orientation_remainder=per_env(model.body_count if model.splits_orientation else 0),
        )
        self.nonsmooth = integrator.declare(model, self.layout)
        self.monitor = Monitor(model, settings, self.layout, self.nonsmooth) if settings else None
        if self.nonsmooth is not None:
            self.nonsmooth.monitored = self.monitor is not None
        # A reference keeps this memory alive; ``times`` are views of it.
        self._lengths = _LengthArrays()
        substep = dt / substeps
        lengths = {"full": dt, "substep": substep, "to_substep": substep - dt, "to_full": dt - substep}
        for name, length in lengths.items():
            self.layout.constant("stepping", self._lengths, name, [[length]], model.types.real)
        for name, length in (("full", dt), ("substep", substep)):
            self.layout.constant("stepping", self._lengths, f"{name}_clock", [[length]], wp.float64)
            self.layout.constant("stepping", self._lengths, f"{name}_half_clock", [[0.5 * length]], wp.float64)

    @shared_capture_lock()
    def allocate(self, envs: int) -> None:
        """Allocates the buffers for ``envs`` environments."""
        self.layout.allocate(envs)
        lengths = {name: broadcast(memory, envs) for name, memory in vars(self._lengths).items()}
        full, substep = (
            StepLength(lengths[name], lengths[f"{name}_clock"], lengths[f"{name}_half_clock"])
            for name in ("full", "substep")
        )
        self.times = StepLengths(full, substep, lengths["to_substep"], lengths["to_full"])


@dataclass(frozen=True)
class FrameSchedule:
    """Frames to record during stepping.

    Attributes:
        every: Number of steps between frames.
        needs: Quantities to compute for each frame, see ``Sensor.needs``.
        deliver_frame: Called by the worker that evaluated a frame, with the model, the slice of its environments and
            the number of the frame. Slices come in any order, frames of a slice in order.
        copies: Per model on a CPU, the copies that launches make of each slice; ``deliver_frame`` is not called then.
        first_frame: Number of the first frame.
        follows_frame: Whether the steps follow a frame with the same needs and the model was neither changed nor
            evaluated since.
    """

    every: int
    needs: frozenset[str]
    deliver_frame: Callable[["DeviceModel", slice, int], None]
    copies: Mapping["DeviceModel", FrameCopies] = field(default_factory=dict)
    first_frame: int = 0
    follows_frame: bool = False

    def align(self, done: int, steps: int, count: int) -> int:
        """Returns ``steps`` adjusted to end at a frame if possible; ``done`` of ``count`` steps were taken before.

        A remainder of a frame interval would need its own launches and cannot reuse the contacts of the last frame.
        """
        excess = (done + steps) % self.every
        to_frame = self.every - excess
        if not excess or done + steps == count:
            return steps
        if excess < steps:
            return steps - excess
        return steps + to_frame if to_frame <= steps and done + steps + to_frame <= count else steps

    def split(self, done: int, count: int) -> list[int]:
        """Returns ``count`` steps after the first ``done``, split at frames: numbers of steps."""
        first = min(self.every - done % self.every, count)
        full, rest = divmod(count - first, self.every)
        return [first, *[self.every] * full, *([rest] if rest else [])]


@dataclass(frozen=True)
class StepChunk:
    """Consecutive steps with an optional evaluation after them.

    Attributes:
        steps: Number of steps.
        after_evaluation: Whether an evaluation directly precedes the steps; they may reuse its contacts.
        evaluates: Whether an evaluation follows.
    """

    steps: int
    after_evaluation: bool = False
    evaluates: bool = False


@dataclass(frozen=True)
class _StepLaunches:
    """The launches of a step, or of a substep, from a first state buffer to a second one."""

    full: list[wp.Launch]
    substep: list[wp.Launch]
    to_substeps: list[wp.Launch]  # prepares the first buffer for the first substep
    to_full_steps: list[wp.Launch]  # prepares the second buffer, after the last substep, for full steps
    copy_back: list[wp.Launch]  # copies the second buffer to the first


class Stepper:
    """Steps slices of environments, one at a time, using the model's state and a second state buffer.

    Args:
        plan: Execution plan of all environments.
        integrator: The time integrator.
        buffers: Step buffers.
        substeps: Number of substeps of a step with a crossing.
        captured: Whether steps are captured as graphs and replayed.
        short_graphs: Whether graphs on a CPU have few steps, which takes less time to capture.

    Attributes:
        slice: The selected environments; at first all.
        device: Device of the environments.
        shape: Launch shape of the steps.
        captured: Whether steps are replayed from graphs. On a GPU the host then does not wait for steps.
        multi_step: Whether one multi-step launch takes any number of steps.
        graph_steps: Steps per graph, largest first; used if ``multi_step`` is false.
    """

    def __init__(
        self,
        plan: ExecutionPlan,
        integrator: Integrator,
        buffers: StepBuffers,
        *,
        substeps: int,
        captured: bool,
        short_graphs: bool = False,
    ) -> None:
        model = plan.model
        self._monitor = buffers.monitor
        self._span = plan = replace(
            plan, write_outputs=self._monitor is not None, semi_implicit_euler=integrator.is_fusible
        )
        self.slice = slice(0, plan.count)
        self._slice_values = None if plan.slice is None else plan.slice.numpy()
        self.device = model.device
        self._substeps = substeps
        has_substeps = model.has_swept_contacts and substeps > 1
        self._crossing_flag = wp.zeros(1, dtype=wp.int32, device=model.device) if has_substeps else None
        # Copy of the flag that the host reads.
        self._host_crossing_flag = self._crossing_flag
        if has_substeps and model.device.is_cuda:
            self._host_crossing_flag = wp.zeros(1, dtype=wp.int32, device="cpu", pinned=True)
        self._integrator, self._times = integrator, buffers.times
        self._states = own, other = model.arrays.state, buffers.other_state
        self.shape = plan.shape
        self.multi_step = self.shape.name == LOOP_PER_ENVIRONMENT
        if self.multi_step:
            one = integrator.multi_step_stages(plan, self._times.full, own)
            self._steps = [_StepLaunches(one, [], [], [], [])] * 2
        else:
            self._steps = [self._prepare(*chunk) for chunk in ((own, other), (other, own))]
        # A step from the model's state that reuses the contacts of an evaluation; prepared on demand.
        self._step_after_evaluation: list[wp.Launch] = []
        self._pause, self._resume = (
            mask_substeps_stage(plan, unmask=unmask) if has_substeps else [] for unmask in (False, True)
        )
        # A decision on the host cannot be captured in a graph.
        self.captured = captured and not has_substeps
        cpu_steps = SHORT_GRAPH_STEPS if QUICK or short_graphs else CPU_GRAPH_STEPS
        self.graph_steps = cpu_steps if model.device.is_cpu else GRAPH_STEPS
        # Graphs by chunk and needs of its evaluation. Never evicted: a simulation has few different sets of needs.
        self._graphs: dict[tuple[StepChunk, frozenset[str]], wp.Graph] = {}
        # Graphs of a sequence of chunks, each with its number of steps in a multi-step launch; by chunks, needs and
        # ``_provides_contacts``.
        self._sequences: dict[tuple[tuple[StepChunk, ...], frozenset[str], bool], list[tuple[int, wp.Graph]]] = {}
        # Launches of evaluations by needs; the current needs; whether steps can reuse the contacts of the evaluation.
        self._evaluations: dict[frozenset[str], list[wp.Launch]] = {}
        self._needs: frozenset[str] = frozenset()
        self._provides_contacts = False
        self._frame_recording: FrameRecording | None = None

    def select(self, own: slice) -> None:
        """Selects the environments to step. Ranges other than all require a plan with ``slice``."""
        self.slice = own
        if self._slice_values is not None:
            self._slice_values[:2] = own.start, own.stop - own.start

    def _set_step_count(self, steps: int) -> None:
        """Sets the number of steps of the next multi-step launch."""
        if self._slice_values is not None:
            self._slice_values[2] = steps

    def _prepare(self, state_in: Any, state_out: Any) -> _StepLaunches:
        plan, times, substep, to_substeps, to_full_steps = self._span, self._times, [], [], []
        if self._crossing_flag is not None:
            substep = self._stages(plan, times.substep, state_in, state_out, None)
            to_substeps = self._integrator.change_stages(plan, times.to_substep, state_in)
            to_full_steps = self._integrator.change_stages(plan, times.to_full, state_out)
        return _StepLaunches(
            full=self._stages(plan, times.full, state_in, state_out, self._crossing_flag),
            substep=substep,
            to_substeps=to_substeps,
            to_full_steps=to_full_steps,
            copy_back=copy_state_stage(plan, state_out, state_in),
        )

    def _stages(
        self, plan: ExecutionPlan, dt: StepLength, state_in: Any, state_out: Any, mark: wp.array | None
    ) -> list[wp.Launch]:
        """Returns the launches of a step, including monitors and acceptance."""
        launches = self._integrator.step_stages(plan, dt, state_in, state_out, mark)
        if self._monitor is not None:
            launches += self._monitor.stages(plan, dt, state_in)
        return launches + accept_stages(plan, dt, state_in, state_out)

    @property
    def step_launches(self) -> list[wp.Launch]:
        """The launches of a step from the model's state."""
        return self._steps[0].full

    def launches(self) -> list[list[wp.Launch]]:
        """Returns all prepared launches, as lists."""
        steps = [substep for step in self._steps for substep in vars(step).values()]
        return [*steps, self._step_after_evaluation, self._pause, self._resume]

    def graph(self, chunk: StepChunk) -> list[wp.Launch]:
        """Returns the launches of a graph; none if steps are not captured."""
        if not self.captured:
            return []
        launches: list[wp.Launch] = []
        first = int(chunk.after_evaluation and chunk.steps > 0)
        if self.multi_step:
            launches += first * self._step_after_evaluation + (chunk.steps > first) * self._steps[0].full
        else:
            for number in range(chunk.steps):
                launches += self._step_after_evaluation if number < first else self._steps[number % 2].full
            if chunk.steps % 2:
                launches += self._steps[0].copy_back
        return launches + self._evaluations[self._needs] if chunk.evaluates else launches

    def _graphs_for(self, chunk: StepChunk) -> Iterator[tuple[StepChunk, int]]:
        """Yields the graphs of a chunk, each with the number of steps to set for its multi-step launch (or 0)."""
        count, graph_steps = chunk.steps, self.graph_steps[0]
        if self.multi_step:
            # One graph for any number of steps. A first step that reuses the contacts of an evaluation has its own
            # launches in it.
            yield (
                replace(chunk, steps=min(count, 1 + chunk.after_evaluation)),
                max(0, count - chunk.after_evaluation),
            )
            return
        if chunk.after_evaluation and chunk.evaluates and count <= MAX_FRAME_GRAPHS * graph_steps:
            # Steps from frame to frame: one graph, because each graph launch has a cost in Python.
            yield chunk, 0
            return
        if chunk.after_evaluation and count:
            first = count % graph_steps or graph_steps
            yield StepChunk(first, after_evaluation=True), 0
            count -= first
        for steps in self.graph_steps:
            for _ in range(count // steps):
                yield StepChunk(steps), 0
            count %= steps
        if chunk.evaluates:
            yield StepChunk(0, evaluates=True), 0

    def capture(self, chunks: tuple[StepChunk, ...]) -> None:
        """Captures the graphs that ``step`` replays. Must not run while other threads step."""
        sequence = chunks, self._needs, self._provides_contacts
        if not self.captured or sequence in self._sequences:
            return
        graphs = []
        for chunk in chunks:
            # The contacts can be reused only after an evaluation that computes them.
            for one, multi_step in self._graphs_for(
                replace(chunk, after_evaluation=chunk.after_evaluation and self._provides_contacts)
            ):
                key = one, self._needs if one.evaluates else frozenset()
                if key not in self._graphs:
                    self._graphs[key] = self._capture_graph(self.graph(one))
                graphs.append((multi_step, self._graphs[key]))
        self._sequences[sequence] = graphs

    def _capture_graph(self, launches: list[wp.Launch]) -> wp.Graph:
        with exclusive_capture_lock(), wp.ScopedCapture(device=self.device) as capture:
            _launch(launches)
        return capture.graph

    def step(self, chunks: tuple[StepChunk, ...]) -> None:
        """Takes the steps and evaluations of chunks. Before and after each chunk the state is in the model's buffer.

        If steps are captured, ``capture`` must have been called with the same chunks.
        """
        if self.captured:
            # One lookup for all graphs: stepping evicts the interpreter from the core's cache, so Python is slow here.
            for multi_step, graph in self._sequences[chunks, self._needs, self._provides_contacts]:
                if multi_step:
                    self._set_step_count(multi_step)
                wp.capture_launch(graph)
            return
        with shared_capture_lock():
            for chunk in chunks:
                if self.multi_step:
                    self._set_step_count(chunk.steps)
                    _launch(self._steps[0].full)
                else:
                    for number in range(chunk.steps):
                        self._take_step(number % 2)
                    if chunk.steps % 2:
                        _launch(self._steps[0].copy_back)
                if chunk.evaluates:
                    _launch(self._evaluations[self._needs])

    def prepare_evaluation(self, frames: FrameSchedule) -> None:
        """Prepares the evaluations of subsequent chunks. Must not run while other threads step."""
        if self._frame_recording is None:
            self._frame_recording = FrameRecording(self._span)
        self._frame_recording.set_copies(frames.copies.get(self._span.model))
        self._needs = frames.needs
        if frames.needs not in self._evaluations:
            evaluation_launches = self._span.model.evaluation_launches(frames.needs, self._span.slice)
            self._evaluations[frames.needs] = [*evaluation_launches, *self._frame_recording.launches]
        self._provides_contacts = self.prepare_step_after_evaluation(frames.needs)

    def prepare_step_after_evaluation(self, needs: Set[str]) -> bool:
        """Prepares the step after an evaluation for ``needs``; returns whether it can reuse the contacts."""
        if not (self.captured and provides_contacts(self._span, needs)):
            return False
        if not self._step_after_evaluation:
            own, other = self._states
            plan = replace(self._span, evaluated_state=own)
            with shared_capture_lock():
                self._step_after_evaluation = self._stages(plan, self._times.full, own, other, self._crossing_flag)
                if self.multi_step:
                    self._step_after_evaluation += copy_state_stage(self._span, other, own)
        return True

    def set_frame(self, number: int) -> None:
        """Sets the number of the next frame that launches record."""
        if self._frame_recording is not None:
            self._frame_recording.set_frame(number)

    def records(self, frames: FrameSchedule) -> bool:
        """Whether launches copy the frames, so that ``deliver`` is not needed."""
        return self._span.model in frames.copies

    def deliver(self, frames: FrameSchedule, number: int) -> None:
        """Passes frame ``number`` of the selected environments, which was evaluated, to ``frames.deliver_frame``."""
        frames.deliver_frame(self._span.model, self.slice, number)

    def _take_step(self, chunk: int) -> None:
        """Takes one step from one buffer to the other; environments with a crossing repeat it in substeps."""
        if self._crossing_flag is not None:
            self._crossing_flag.zero_()
        _launch(self._steps[chunk].full)
        if not self._crossed():
            return
        # Environments with a crossing did not accept the step and repeat it. The others are paused.
        _launch(self._pause)
        _launch(self._steps[chunk].to_substeps)
        for substep in range(self._substeps):
            _launch(self._steps[(chunk + substep) % 2].substep)
        if self._substeps % 2 == 0:
            _launch(self._steps[1 - chunk].copy_back)
        _launch(self._steps[chunk].to_full_steps)
        _launch(self._resume)

    def _crossed(self) -> bool:
        """Returns whether a surface was crossed in the last step; synchronizes with its own device only."""
        if self._crossing_flag is None or self._host_crossing_flag is None:
            return False
        if self._host_crossing_flag is not self._crossing_flag:
            # ``wp.array.numpy()`` on a GPU would change the default device of the process while other threads step.
            wp.copy(self._host_crossing_flag, self._crossing_flag)
            wp.synchronize_stream(self.device)
        return bool(self._host_crossing_flag.numpy()[0])


def _launch(launches: list[wp.Launch]) -> None:
    for launch in launches:
        launch.launch()
