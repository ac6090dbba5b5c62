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

from warpcontact.arrays import Layout, broadcast, per_env
from warpcontact.captures import beside_captures, capturing
from warpcontact.copies import Copies, Taking
from warpcontact.integrators import Integrator
from warpcontact.kernels.unique import QUICK
from warpcontact.looks import looks_at_near
from warpcontact.outcomes.observer import Observer
from warpcontact.outcomes.watch import Watch
from warpcontact.schedule import (
    Span,
    StepLength,
    accept_stages,
    adopt_stage,
    turn_stage,
)

if TYPE_CHECKING:
    from warpcontact.draft import PartDraft
    from warpcontact.model import Model

# Steps in a graph, the most first; whatever is asked for is made up of these. An odd one ends in the other buffer
# and is copied back. On the CPU Warp takes a quarter of a millisecond to capture a launch, for each thread.
GRAPH_STEPS = (32, 2, 1)
CPU_GRAPH_STEPS = (2, 1) if QUICK else (8, 2, 1)
# Graphs of the most steps in whose place steps to a frame have one of their own, with its look, at most.
FRAME_GRAPHS = 2


@dataclass(frozen=True)
class Times:
    """Lengths of steps [env, 0] [s]: of a whole one, of a part, and what the one is longer or shorter by."""

    whole: StepLength
    part: StepLength
    shorter: wp.array
    longer: wp.array


class Buffers:
    """What steps of a model need on its device; there once it is allocated.

    Args:
        model: The model, or what is drawn up of it.
        integrator: The scheme.
        dt: Length of a step [s].
        parts: Parts into which a step with a crossing is divided.
        watch: What to watch meanwhile.

    Attributes:
        layout: What is to lie on the device.
        times: Lengths of steps.
        other: A second state. Steps go from the model's to it and back; between calls the state is in the model's.
        hard: The contacts that the scheme solves for impulses, ``None``: it has none.
        observer: What watches it; ``None``: nothing does.
    """

    def __init__(
        self,
        model: "Model | PartDraft",
        integrator: Integrator,
        dt: float = 0.0,
        parts: int = 1,
        watch: Watch | None = None,
    ) -> None:
        self.layout = Layout(model.device)
        nothing = StepLength(None, None, None)
        self.times = Times(nothing, nothing, None, None)
        self.other = self.layout.struct("stepping", model.types.State, per_env(model.body_count), transient=True)
        self.hard = integrator.declare(model, self.layout)
        self.observer = Observer(model, watch, self.layout, self.hard) if watch else None
        if self.hard is not None:
            self.hard.watched = self.observer is not None
        # Kept alive: the times share their memory.
        self._lengths = SimpleNamespace()
        part = dt / parts
        lengths = {"whole": dt, "part": part, "shorter": part - dt, "longer": dt - part}
        for name, length in lengths.items():
            self.layout.content("stepping", self._lengths, name, [[length]], model.types.real)
        for name, length in (("whole", dt), ("part", part)):
            self.layout.content("stepping", self._lengths, f"{name}_clock", [[length]], wp.float64)
            self.layout.content("stepping", self._lengths, f"{name}_half_clock", [[0.5 * length]], wp.float64)

    @beside_captures()
    def allocate(self, envs: int) -> None:
        """Makes them for ``envs`` environments."""
        self.layout.allocate(envs)
        lengths = {name: broadcast(memory, envs) for name, memory in vars(self._lengths).items()}
        whole, part = (
            StepLength(lengths[name], lengths[f"{name}_clock"], lengths[f"{name}_half_clock"])
            for name in ("whole", "part")
        )
        self.times = Times(whole, part, lengths["shorter"], lengths["longer"])


@dataclass(frozen=True)
class Frames:
    """What is to be looked at while steps are taken.

    Attributes:
        every: Steps from frame to frame.
        needs: What is computed for each, see ``Sensor.needs``.
        take: Called when it is, by the thread that computed it, with the model, its environments that are there,
            and the number of the frame: in any order of environments, one frame after the other.
        copies: By model, on the CPU, what launches take where looks are at slices; ``take`` is not called there.
        first: Number of the first of these frames.
        follows: Whether the steps to it follow a frame with these needs, since when nobody changed the model or
            looked at it.
    """

    every: int
    needs: frozenset[str]
    take: Callable[["Model", slice, int], None]
    copies: Mapping["Model", Copies] = field(default_factory=dict)
    first: int = 0
    follows: bool = False

    def whole(self, done: int, some: int, count: int) -> int:
        """Returns about ``some`` of ``count`` steps, after the first ``done``: whole frames, if one is near.

        What is left of another would take launches of its own, and does not know what the frame before told.
        """
        over = (done + some) % self.every
        missing = self.every - over
        if not over or done + some == count:
            return some
        if over < some:
            return some - over
        return some + missing if missing <= some and done + some + missing <= count else some

    def cut(self, done: int, count: int) -> list[int]:
        """Returns ``count`` steps after the first ``done`` as those from frame to frame."""
        first = min(self.every - done % self.every, count)
        whole, rest = divmod(count - first, self.every)
        return [first, *[self.every] * whole, *([rest] if rest else [])]


@dataclass(frozen=True)
class Way:
    """Steps that are taken one after the other, and what comes before and after them.

    Attributes:
        steps: How many.
        known: Whether a look came just before, which may have told what is near of contacts.
        looks: Whether a look follows.
    """

    steps: int
    known: bool = False
    looks: bool = False


@dataclass(frozen=True)
class _Step:
    """The launches of a step from one buffer to the other, and those of a part of it."""

    whole: list[wp.Launch]
    part: list[wp.Launch]
    divide: list[wp.Launch]  # before a first part from the first buffer
    resume: list[wp.Launch]  # after a last part into the second
    back: list[wp.Launch]  # copies the second buffer to the first


class Stepper:
    """Steps one slice of a span after the other, between the model's state and another buffer.

    Args:
        span: All environments.
        integrator: The scheme.
        buffers: What steps need on the device.
        parts: Parts into which a step with a crossing is divided.
        captured: Whether steps are captured and replayed.

    Attributes:
        slice: The environments that are stepped next; at first all.
        device: Their device.
        captured: Whether steps are replayed: on a GPU nothing is then waited for.
        in_place: Whether steps are one launch, of any number.
        graph_steps: Steps in its graphs, the most first, if they are not.
    """

    def __init__(
        self, span: Span, integrator: Integrator, buffers: Buffers, *, parts: int, captured: bool
    ) -> None:
        model = span.model
        self._observer = buffers.observer
        self._span = span = replace(span, watched=self._observer is not None)
        self.slice = slice(0, span.count)
        self._place = None if span.slice is None else span.slice.numpy()
        self.device = model.device
        self._parts = parts
        divides = model.sweeps and parts > 1
        self._mark = wp.zeros(1, dtype=wp.int32, device=model.device) if divides else None
        # Where the host looks at it.
        self._seen = self._mark
        if divides and model.device.is_cuda:
            self._seen = wp.zeros(1, dtype=wp.int32, device="cpu", pinned=True)
        self._integrator, self._times = integrator, buffers.times
        self._states = own, other = model.arrays.state, buffers.other
        # Whether steps go from a state to itself.
        unseen = self._observer is None and not divides
        one = integrator.in_place_stages(span, self._times.whole, own) if unseen else []
        self.in_place = bool(one)
        if self.in_place:
            self._steps = [_Step(one, [], [], [], [])] * 2
        else:
            self._steps = [self._prepare(*way) for way in ((own, other), (other, own))]
        # A step from the model's state after a look has told what is near, once there are such looks.
        self._after_look: list[wp.Launch] = []
        self._wait, self._wake = (turn_stage(span, back=back) for back in (False, True))
        # What is decided on the host cannot be captured.
        self.captured = captured and not divides
        self.graph_steps = CPU_GRAPH_STEPS if model.device.is_cpu else GRAPH_STEPS
        # With what a look at their end is for. All are kept: few sets of needs come up in a simulation.
        self._graphs: dict[tuple[Way, frozenset[str]], wp.Graph] = {}
        # Of those, which make up ways that are taken one after the other, each with the steps it takes in place;
        # by what else decides that.
        self._sequences: dict[tuple[tuple[Way, ...], frozenset[str], bool], list[tuple[int, wp.Graph]]] = {}
        # By what is needed; what is now, and whether it tells steps what is near; and what takes frames.
        self._looks: dict[frozenset[str], list[wp.Launch]] = {}
        self._needs: frozenset[str] = frozenset()
        self._tells = False
        self._taking: Taking | None = None

    def go_to(self, own: slice) -> None:
        """Takes the environments that are stepped next: others than all of the span only if it has slices."""
        self.slice = own
        if self._place is not None:
            self._place[:2] = own.start, own.stop - own.start

    def _go_for(self, steps: int) -> None:
        """Has the next launch in place take ``steps`` steps."""
        if self._place is not None:
            self._place[2] = steps

    def _prepare(self, state_in: Any, state_out: Any) -> _Step:
        span, times, part, divide, resume = self._span, self._times, [], [], []
        if self._mark is not None:
            part = self._stages(span, times.part, state_in, state_out, None)
            divide = self._integrator.change_stages(span, times.shorter, state_in)
            resume = self._integrator.change_stages(span, times.longer, state_out)
        return _Step(
            whole=self._stages(span, times.whole, state_in, state_out, self._mark),
            part=part,
            divide=divide,
            resume=resume,
            back=adopt_stage(span, state_out, state_in),
        )

    def _stages(
        self, span: Span, dt: StepLength, state_in: Any, state_out: Any, mark: wp.array | None
    ) -> list[wp.Launch]:
        """Returns the launches of a step that is accepted, and watched."""
        ends = self._observer is None and self._integrator.may_end(span)
        launches = self._integrator.step_stages(span, dt, state_in, state_out, mark, ends=ends)
        if self._observer is not None:
            launches += self._observer.stages(span, dt, state_in)
        return launches + accept_stages(span, dt, state_in, state_out, ended=ends)

    def launches(self) -> list[list[wp.Launch]]:
        """Returns everything that is prepared."""
        steps = [part for step in self._steps for part in vars(step).values()]
        return [*steps, self._after_look, self._wait, self._wake]

    def graph(self, way: Way) -> list[wp.Launch]:
        """Returns the launches of a graph, none if nothing is captured."""
        if not self.captured:
            return []
        launches: list[wp.Launch] = []
        first = int(way.known and way.steps > 0)
        if self.in_place:
            launches += first * self._after_look + (way.steps > first) * self._steps[0].whole
        else:
            for number in range(way.steps):
                launches += self._after_look if number < first else self._steps[number % 2].whole
            if way.steps % 2:
                launches += self._steps[0].back
        return launches + self._looks[self._needs] if way.looks else launches

    def _graphs_of(self, way: Way) -> Iterator[tuple[Way, int]]:
        """Yields the graphs that make up a way, each with the steps that it reads that it takes in place."""
        count, most = way.steps, self.graph_steps[0]
        if self.in_place:
            # The same for any number, after a first step that knows what is near, which has launches of its own.
            yield replace(way, steps=min(count, 1 + way.known)), max(0, count - way.known)
            return
        if way.known and way.looks and count <= FRAME_GRAPHS * most:
            # Of frame after frame: whatever is launched apart, Python has to come by for.
            yield way, 0
            return
        if way.known and count:
            first = count % most or most
            yield Way(first, known=True), 0
            count -= first
        for steps in self.graph_steps:
            for _ in range(count // steps):
                yield Way(steps), 0
            count %= steps
        if way.looks:
            yield Way(0, looks=True), 0

    def capture(self, ways: tuple[Way, ...]) -> None:
        """Captures what ``step`` will replay. Not while other threads step."""
        sequence = ways, self._needs, self._tells
        if not self.captured or sequence in self._sequences:
            return
        graphs = []
        for way in ways:
            # It knows no more than looks tell.
            for one, in_place in self._graphs_of(replace(way, known=way.known and self._tells)):
                key = one, self._needs if one.looks else frozenset()
                if key not in self._graphs:
                    self._graphs[key] = self._captured(self.graph(one))
                graphs.append((in_place, self._graphs[key]))
        self._sequences[sequence] = graphs

    def _captured(self, launches: list[wp.Launch]) -> wp.Graph:
        with capturing(), wp.ScopedCapture(device=self.device) as capture:
            _launch(launches)
        return capture.graph

    def step(self, ways: tuple[Way, ...]) -> None:
        """Takes steps, captured ones, and looks; the state is in the model's buffer before and after each way."""
        if self.captured:
            # Looked up once: Python is slow where steps drive it out of the cache of a core.
            for in_place, graph in self._sequences[ways, self._needs, self._tells]:
                if in_place:
                    self._go_for(in_place)
                wp.capture_launch(graph)
            return
        with beside_captures():
            for way in ways:
                if self.in_place:
                    self._go_for(way.steps)
                    _launch(self._steps[0].whole)
                else:
                    for number in range(way.steps):
                        self._take(number % 2)
                    if way.steps % 2:
                        _launch(self._steps[0].back)
                if way.looks:
                    _launch(self._looks[self._needs])

    def ready_look(self, frames: Frames) -> None:
        """Prepares looks, for ways from now on. Not while other threads step."""
        if self._taking is None:
            self._taking = Taking(self._span)
        self._taking.read(frames.copies.get(self._span.model))
        self._needs = frames.needs
        if frames.needs not in self._looks:
            look = self._span.model.look(frames.needs, self._span.slice)
            self._looks[frames.needs] = [*look, *self._taking.launches]
        self._tells = self.ready_after_look(frames.needs)

    def ready_after_look(self, needs: Set[str]) -> bool:
        """Prepares the step after a look for sensors with ``needs``; returns whether it has less to do."""
        if not (self.captured and looks_at_near(self._span, needs)):
            return False
        if not self._after_look:
            own, other = self._states
            span = replace(self._span, looked_at=own)
            with beside_captures():
                self._after_look = self._stages(span, self._times.whole, own, other, self._mark)
                if self.in_place:
                    self._after_look += adopt_stage(self._span, other, own)
        return True

    def go_to_frame(self, number: int) -> None:
        """Takes frame ``number`` next, where launches do."""
        if self._taking is not None:
            self._taking.go_to(number)

    def takes(self, frames: Frames) -> bool:
        """Whether launches take frames where they are looked at, and nobody has to hand them on."""
        return self._span.model in frames.copies

    def hand_on(self, frames: Frames, number: int) -> None:
        """Hands on frame ``number`` of its environments, which was looked at."""
        frames.take(self._span.model, self.slice, number)

    def _take(self, way: int) -> None:
        """Takes one step from one buffer to the other, and again in parts where a surface was crossed."""
        if self._mark is not None:
            self._mark.zero_()
        _launch(self._steps[way].whole)
        if not self._crossed():
            return
        # Environments with a crossing have not moved on. The others wait.
        _launch(self._wait)
        _launch(self._steps[way].divide)
        for part in range(self._parts):
            _launch(self._steps[(way + part) % 2].part)
        if self._parts % 2 == 0:
            _launch(self._steps[1 - way].back)
        _launch(self._steps[way].resume)
        _launch(self._wake)

    def _crossed(self) -> bool:
        """Whether a surface was crossed in the step just taken; waits for no other device than its own."""
        if self._mark is None or self._seen is None:
            return False
        if self._seen is not self._mark:
            # Of a GPU wp.array.numpy() would change the default device of the process while other threads step.
            wp.copy(self._seen, self._mark)
            wp.synchronize_stream(self.device)
        return bool(self._seen.numpy()[0])


def _launch(launches: list[wp.Launch]) -> None:
    for launch in launches:
        launch.launch()
