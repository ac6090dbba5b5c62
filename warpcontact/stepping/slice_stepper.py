"""Steps of slices of the environments: so few that their state stays in the cache of the core that steps them.

A step is a list of launches. Where nothing has to be decided on the host they are captured once, many steps at a
time, and replayed; launches and replays compute the same. They are the same for all slices on the CPU, and read
from memory which slice they are for: each thread has its own, and takes them from slice to slice.
"""

from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass, field, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.execution_plan import (
    ExecutionPlan,
    StepLength,
    accept_stages,
    copy_state_stage,
    mask_substeps_stage,
)
from warpcontact.kernels.lowlevel.unique_kernel import QUICK
from warpcontact.model.sensor_evaluation import provides_contacts
from warpcontact.stepping.frame_copies import FrameCopies, FrameRecording
from warpcontact.stepping.integrators import Integrator
from warpcontact.stepping.outcomes.observer import Monitor
from warpcontact.stepping.outcomes.watch import MonitorSettings
from warpcontact.storage.allocation_plan import AllocationPlan, broadcast, per_env
from warpcontact.system.capture_lock import exclusive_capture_lock, shared_capture_lock

if TYPE_CHECKING:
    from warpcontact.model.model import Model
    from warpcontact.model.plan import DeviceModelPlan

# Steps in a graph, the most first; whatever is asked for is made up of these. An odd one ends in the other buffer
# and is copied back. On the CPU Warp takes a quarter of a millisecond to capture a launch, for each thread.
GRAPH_STEPS = (32, 2, 1)
CPU_GRAPH_STEPS = (2, 1) if QUICK else (8, 2, 1)
# Graphs of the most steps in whose place steps to a frame have one of their own, with its look, at most.
MAX_FRAME_GRAPHS = 2


@dataclass(frozen=True)
class StepLengths:
    """Lengths of steps [env, 0] [s]: of a whole one, of a part, and what the one is longer or shorter by."""

    full: StepLength
    substep: StepLength
    to_substep: wp.array
    to_full: wp.array


class StepBuffers:
    """What steps of a model need on its device; there once it is allocated.

    Args:
        model: The model, or what is drawn up of it.
        integrator: The scheme.
        dt: Length of a step [s].
        substeps: Parts into which a step with a crossing is divided.
        settings: What to watch meanwhile.

    Attributes:
        layout: What is to lie on the device.
        times: Lengths of steps.
        other_state: A second state. Steps go from the model's to it and back; between calls the state is in the model's.
        nonsmooth: The contacts that the scheme solves for impulses, ``None``: it has none.
        monitor: What watches it; ``None``: nothing does.
    """

    def __init__(
        self,
        model: "Model | DeviceModelPlan",
        integrator: Integrator,
        dt: float = 0.0,
        substeps: int = 1,
        settings: MonitorSettings | None = None,
    ) -> None:
        self.layout = AllocationPlan(model.device)
        unallocated = StepLength(None, None, None)
        self.times = StepLengths(unallocated, unallocated, None, None)
        self.other_state = self.layout.struct(
            "stepping", model.types.State, per_env(model.body_count), transient=True
        )
        self.nonsmooth = integrator.declare(model, self.layout)
        self.monitor = Monitor(model, settings, self.layout, self.nonsmooth) if settings else None
        if self.nonsmooth is not None:
            self.nonsmooth.monitored = self.monitor is not None
        # Kept alive: the times share their memory.
        self._lengths = SimpleNamespace()
        substep = dt / substeps
        lengths = {"full": dt, "substep": substep, "to_substep": substep - dt, "to_full": dt - substep}
        for name, length in lengths.items():
            self.layout.constant("stepping", self._lengths, name, [[length]], model.types.real)
        for name, length in (("full", dt), ("substep", substep)):
            self.layout.constant("stepping", self._lengths, f"{name}_clock", [[length]], wp.float64)
            self.layout.constant("stepping", self._lengths, f"{name}_half_clock", [[0.5 * length]], wp.float64)

    @shared_capture_lock()
    def allocate(self, envs: int) -> None:
        """Makes them for ``envs`` environments."""
        self.layout.allocate(envs)
        lengths = {name: broadcast(memory, envs) for name, memory in vars(self._lengths).items()}
        full, substep = (
            StepLength(lengths[name], lengths[f"{name}_clock"], lengths[f"{name}_half_clock"])
            for name in ("full", "substep")
        )
        self.times = StepLengths(full, substep, lengths["to_substep"], lengths["to_full"])


@dataclass(frozen=True)
class FrameSchedule:
    """What is to be looked at while steps are taken.

    Attributes:
        every: Steps from frame to frame.
        needs: What is computed for each, see ``Sensor.needs``.
        deliver_frame: Called when it is, by the thread that computed it, with the model, its environments that are there,
            and the number of the frame: in any order of environments, one frame after the other.
        copies: By model, on the CPU, what launches take where looks are at slices; ``take`` is not called there.
        first_frame: Number of the first of these frames.
        follows_frame: Whether the steps to it follow a frame with these needs, since when nobody changed the model or
            looked at it.
    """

    every: int
    needs: frozenset[str]
    deliver_frame: Callable[["Model", slice, int], None]
    copies: Mapping["Model", FrameCopies] = field(default_factory=dict)
    first_frame: int = 0
    follows_frame: bool = False

    def align(self, done: int, steps: int, count: int) -> int:
        """Returns about ``steps`` of ``count`` steps, after the first ``done``: whole frames, if one is near.

        What is left of another would take launches of its own, and does not know what the frame before told.
        """
        excess = (done + steps) % self.every
        to_frame = self.every - excess
        if not excess or done + steps == count:
            return steps
        if excess < steps:
            return steps - excess
        return steps + to_frame if to_frame <= steps and done + steps + to_frame <= count else steps

    def split(self, done: int, count: int) -> list[int]:
        """Returns ``count`` steps after the first ``done`` as those from frame to frame."""
        first = min(self.every - done % self.every, count)
        full, rest = divmod(count - first, self.every)
        return [first, *[self.every] * full, *([rest] if rest else [])]


@dataclass(frozen=True)
class StepChunk:
    """Steps that are taken one after the other, and what comes before and after them.

    Attributes:
        steps: How many.
        after_evaluation: Whether a look came just before, which may have told what is near of contacts.
        evaluates: Whether a look follows.
    """

    steps: int
    after_evaluation: bool = False
    evaluates: bool = False


@dataclass(frozen=True)
class _StepLaunches:
    """The launches of a step from one buffer to the other, and those of a part of it."""

    full: list[wp.Launch]
    substep: list[wp.Launch]
    to_substeps: list[wp.Launch]  # before a first part from the first buffer
    to_full_steps: list[wp.Launch]  # after a last part into the second
    copy_back: list[wp.Launch]  # copies the second buffer to the first


class Stepper:
    """Steps one slice of a span after the other, between the model's state and another buffer.

    Args:
        plan: All environments.
        integrator: The scheme.
        buffers: What steps need on the device.
        substeps: Parts into which a step with a crossing is divided.
        captured: Whether steps are captured and replayed.

    Attributes:
        slice: The environments that are stepped next; at first all.
        device: Their device.
        captured: Whether steps are replayed: on a GPU nothing is then waited for.
        multi_step: Whether steps are one launch, of any number.
        graph_steps: Steps in its graphs, the most first, if they are not.
    """

    def __init__(
        self, plan: ExecutionPlan, integrator: Integrator, buffers: StepBuffers, *, substeps: int, captured: bool
    ) -> None:
        model = plan.model
        self._monitor = buffers.monitor
        self._span = plan = replace(plan, write_outputs=self._monitor is not None)
        self.slice = slice(0, plan.count)
        self._slice_values = None if plan.slice is None else plan.slice.numpy()
        self.device = model.device
        self._substeps = substeps
        has_substeps = model.has_swept_contacts and substeps > 1
        self._crossing_flag = wp.zeros(1, dtype=wp.int32, device=model.device) if has_substeps else None
        # Where the host looks at it.
        self._host_crossing_flag = self._crossing_flag
        if has_substeps and model.device.is_cuda:
            self._host_crossing_flag = wp.zeros(1, dtype=wp.int32, device="cpu", pinned=True)
        self._integrator, self._times = integrator, buffers.times
        self._states = own, other = model.arrays.state, buffers.other_state
        # Whether steps go from a state to itself.
        unmonitored = self._monitor is None and not has_substeps
        one = integrator.multi_step_stages(plan, self._times.full, own) if unmonitored else []
        self.multi_step = bool(one)
        if self.multi_step:
            self._steps = [_StepLaunches(one, [], [], [], [])] * 2
        else:
            self._steps = [self._prepare(*chunk) for chunk in ((own, other), (other, own))]
        # A step from the model's state after a look has told what is near, once there are such looks.
        self._step_after_evaluation: list[wp.Launch] = []
        self._pause, self._resume = (mask_substeps_stage(plan, unmask=unmask) for unmask in (False, True))
        # What is decided on the host cannot be captured.
        self.captured = captured and not has_substeps
        self.graph_steps = CPU_GRAPH_STEPS if model.device.is_cpu else GRAPH_STEPS
        # With what a look at their end is for. All are kept: few sets of needs come up in a simulation.
        self._graphs: dict[tuple[StepChunk, frozenset[str]], wp.Graph] = {}
        # Of those, which make up ways that are taken one after the other, each with the steps it takes in place;
        # by what else decides that.
        self._sequences: dict[tuple[tuple[StepChunk, ...], frozenset[str], bool], list[tuple[int, wp.Graph]]] = {}
        # By what is needed; what is now, and whether it tells steps what is near; and what takes frames.
        self._evaluations: dict[frozenset[str], list[wp.Launch]] = {}
        self._needs: frozenset[str] = frozenset()
        self._provides_contacts = False
        self._frame_recording: FrameRecording | None = None

    def select(self, own: slice) -> None:
        """Takes the environments that are stepped next: others than all of the span only if it has slices."""
        self.slice = own
        if self._slice_values is not None:
            self._slice_values[:2] = own.start, own.stop - own.start

    def _set_step_count(self, steps: int) -> None:
        """Has the next launch in place take ``steps`` steps."""
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
        """Returns the launches of a step that is accepted, and watched."""
        accepts = self._monitor is None and self._integrator.can_accept(plan)
        launches = self._integrator.step_stages(plan, dt, state_in, state_out, mark, accepts=accepts)
        if self._monitor is not None:
            launches += self._monitor.stages(plan, dt, state_in)
        return launches + accept_stages(plan, dt, state_in, state_out, accepted=accepts)

    def launches(self) -> list[list[wp.Launch]]:
        """Returns everything that is prepared."""
        steps = [substep for step in self._steps for substep in vars(step).values()]
        return [*steps, self._step_after_evaluation, self._pause, self._resume]

    def graph(self, chunk: StepChunk) -> list[wp.Launch]:
        """Returns the launches of a graph, none if nothing is captured."""
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
        """Yields the graphs that make up a way, each with the steps that it reads that it takes in place."""
        count, most = chunk.steps, self.graph_steps[0]
        if self.multi_step:
            # The same for any number, after a first step that knows what is near, which has launches of its own.
            yield (
                replace(chunk, steps=min(count, 1 + chunk.after_evaluation)),
                max(0, count - chunk.after_evaluation),
            )
            return
        if chunk.after_evaluation and chunk.evaluates and count <= MAX_FRAME_GRAPHS * most:
            # Of frame after frame: whatever is launched apart, Python has to come by for.
            yield chunk, 0
            return
        if chunk.after_evaluation and count:
            first = count % most or most
            yield StepChunk(first, after_evaluation=True), 0
            count -= first
        for steps in self.graph_steps:
            for _ in range(count // steps):
                yield StepChunk(steps), 0
            count %= steps
        if chunk.evaluates:
            yield StepChunk(0, evaluates=True), 0

    def capture(self, chunks: tuple[StepChunk, ...]) -> None:
        """Captures what ``step`` will replay. Not while other threads step."""
        sequence = chunks, self._needs, self._provides_contacts
        if not self.captured or sequence in self._sequences:
            return
        graphs = []
        for chunk in chunks:
            # It knows no more than looks tell.
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
        """Takes steps, captured ones, and looks; the state is in the model's buffer before and after each way."""
        if self.captured:
            # Looked up once: Python is slow where steps drive it out of the cache of a core.
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
        """Prepares looks, for ways from now on. Not while other threads step."""
        if self._frame_recording is None:
            self._frame_recording = FrameRecording(self._span)
        self._frame_recording.set_copies(frames.copies.get(self._span.model))
        self._needs = frames.needs
        if frames.needs not in self._evaluations:
            evaluation_launches = self._span.model.evaluation_launches(frames.needs, self._span.slice)
            self._evaluations[frames.needs] = [*evaluation_launches, *self._frame_recording.launches]
        self._provides_contacts = self.prepare_step_after_evaluation(frames.needs)

    def prepare_step_after_evaluation(self, needs: Set[str]) -> bool:
        """Prepares the step after a look for sensors with ``needs``; returns whether it has less to do."""
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
        """Takes frame ``number`` next, where launches do."""
        if self._frame_recording is not None:
            self._frame_recording.set_frame(number)

    def records(self, frames: FrameSchedule) -> bool:
        """Whether launches take frames where they are looked at, and nobody has to hand them on."""
        return self._span.model in frames.copies

    def deliver(self, frames: FrameSchedule, number: int) -> None:
        """Hands on frame ``number`` of its environments, which was looked at."""
        frames.deliver_frame(self._span.model, self.slice, number)

    def _take_step(self, chunk: int) -> None:
        """Takes one step from one buffer to the other, and again in parts where a surface was crossed."""
        if self._crossing_flag is not None:
            self._crossing_flag.zero_()
        _launch(self._steps[chunk].full)
        if not self._crossed():
            return
        # Environments with a crossing have not moved on. The others wait.
        _launch(self._pause)
        _launch(self._steps[chunk].to_substeps)
        for substep in range(self._substeps):
            _launch(self._steps[(chunk + substep) % 2].substep)
        if self._substeps % 2 == 0:
            _launch(self._steps[1 - chunk].copy_back)
        _launch(self._steps[chunk].to_full_steps)
        _launch(self._resume)

    def _crossed(self) -> bool:
        """Whether a surface was crossed in the step just taken; waits for no other device than its own."""
        if self._crossing_flag is None or self._host_crossing_flag is None:
            return False
        if self._host_crossing_flag is not self._crossing_flag:
            # Of a GPU wp.array.numpy() would change the default device of the process while other threads step.
            wp.copy(self._host_crossing_flag, self._crossing_flag)
            wp.synchronize_stream(self.device)
        return bool(self._host_crossing_flag.numpy()[0])


def _launch(launches: list[wp.Launch]) -> None:
    for launch in launches:
        launch.launch()
