"""Monitor of a part of a model: device state and launches of outcomes, stop conditions and events.

``Monitor`` declares the arrays, resolves the sensors (``sources.py``) and prepares the launches that run in each step
before it is accepted (``kernels/outcomes``). ``report.py`` returns the results as data sets.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.outcomes import monitors
from warpcontact.kernels.outcomes.base import Condition, Outcome
from warpcontact.kernels.outcomes.source import MAX_SOURCES, SourceForm
from warpcontact.model.sensor_evaluation import sensor_stages
from warpcontact.stepping.outcomes.sources import ResolvedSource, SourceResolver
from warpcontact.stepping.outcomes.watch import MonitorSettings
from warpcontact.storage.allocation_plan import AllocationPlan, per_env
from warpcontact.storage.state_storage import COUNT, SWITCH
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.compilation import load
from warpcontact.validation.custom_law_errors import compile_error_text

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.model import DeviceModel
    from warpcontact.model.plan import DeviceModelPlan

PURPOSE = "outcomes"
#: Maximum number of events of an environment in a checkpoint: the index in the ring buffer is derived from an int32.
MOST_EVENTS = 2**30


@dataclass
class OutcomeState:
    """An outcome of a part.

    Attributes:
        name: Its name.
        outcome: Its definition.
        sources: Its resolved sources.
        memory: Accumulated values, vectors of float64 [env, result].
    """

    name: str
    outcome: Outcome
    sources: tuple[ResolvedSource, ...]
    memory: Any = None

    @property
    def length(self) -> int:
        """Length of the memory vector; at least 2, the minimum of Warp's vectors."""
        return max(2, len(self.outcome.memory))

    @property
    def results(self) -> int:
        """Number of results per environment."""
        return self.sources[0].items * self.sources[0].components


class Monitor:
    """Evaluates outcomes, stop conditions and events of a part of a model in each step.

    Args:
        model: The model, or its plan.
        settings: Outcomes, stop conditions, events and quarantine.
        layout: Allocation plan to which the arrays are added.
        nonsmooth: The nonsmooth contacts, if any.

    Attributes:
        settings: The settings.
        outcome_states: The outcomes.
        event_sources: One source per contact with events.
        needs: Quantities that the results need, see ``Sensor.needs``.
        needs_all_distances: Whether all contacts must be evaluated in every step, without the distance cache.

    Raises:
        KeyError: If a sensor does not exist.
        ValueError: If a sensor cannot be used as requested.
    """

    def __init__(
        self,
        model: "DeviceModel | DeviceModelPlan",
        settings: MonitorSettings,
        layout: AllocationPlan,
        nonsmooth: "NonsmoothContacts | None",
    ) -> None:
        self.settings = settings
        self._real, self._device = model.types.real, layout.device
        self._model: DeviceModel | None = None
        self._nonsmooth = nonsmooth
        resolver = SourceResolver(model, nonsmooth)
        self.outcome_states = [
            OutcomeState(name, outcome, sources_of(resolver, f"outcomes[{name!r}]", outcome))
            for name, outcome in settings.outcomes.items()
        ]
        self._stops = [
            resolver.resolve_scalar(f"stop[{name!r}]", one.source) for name, one in settings.stops.items()
        ]
        names = () if settings.events is None else settings.events.contacts
        self.event_sources = [resolver.contact_indicator("events", name) for name in names]
        #: Number of the first item of each contact with events.
        self.event_offsets = np.cumsum([0, *(one.items for one in self.event_sources)]).tolist()
        step_sources = [
            one
            for outcome_state in self.outcome_states
            if not outcome_state.outcome.at_end
            for one in outcome_state.sources
        ]
        step_sources += [*self._stops, *self.event_sources]
        self._step_needs = frozenset(need for one in step_sources for need in one.sensor.needs)
        self.needs = self._step_needs.union(
            need
            for outcome_state in self.outcome_states
            for one in outcome_state.sources
            for need in one.sensor.needs
        )
        self.needs_all_distances = any(one.needs_all_distances for one in step_sources)
        self._has_nonsmooth = any(one.is_nonsmooth for one in step_sources)
        for outcome_state in self.outcome_states:
            Memory = wp.types.vector(length=outcome_state.length, dtype=wp.float64)
            layout.array(PURPOSE, outcome_state, "memory", Memory, per_env(outcome_state.results))
        self.stops = monitors.StopStates()
        if self._stops:
            count = len(self._stops)
            stop_range = {"stopped_by": (-1, count - 1)}
            self.stops = layout.struct(
                PURPOSE, monitors.StopStates, per_env(count), ranges=stop_range, stopped_by=per_env()
            )
        self.events = monitors.Events()
        if settings.events is not None:
            slots, places = per_env(settings.events.most), per_env(self.event_offsets[-1])
            ranges = {"touching": SWITCH, "count": (0, MOST_EVENTS), "what": (0, 2 * self.event_offsets[-1] - 1)}
            self.events = layout.struct(
                PURPOSE, monitors.Events, slots, ranges=ranges, count=per_env(), touching=places
            )
        self.resets: Any = None
        layout.array(PURPOSE, self, "resets", wp.int32, per_env(), ranges={"resets": COUNT})

    def initialize(self, model: "DeviceModel") -> None:
        """Attaches the allocated model and compiles the outcomes, which may be user-defined.

        Raises:
            TypeError: If an outcome does not compile.
        """
        self._model = model
        for outcome_state in self.outcome_states:
            outcome = outcome_state.outcome
            forms, _ = self._forms_and_views(outcome_state, model.arrays.state)
            try:
                kernel = monitors.report(outcome.update, outcome.result, outcome_state.length, forms)
                load(kernel, self._device)
            except Exception as error:
                text = compile_error_text(error, [type(outcome)])
                raise TypeError(
                    f"outcomes[{outcome_state.name!r}]: {type(outcome).__name__} does not compile: {text}\n"
                    "m is the memory, a vector of float64; x is a float64, or a vector of float64 for an outcome of "
                    "a contact; time and dt are float64; write constants as wp.float64(1.5)."
                ) from error

    def stages(self, plan: "ExecutionPlan", dt: "StepLength", state: Any) -> list[wp.Launch]:
        """Returns the launches that evaluate the ``state`` at the start of a step, before the step is accepted."""
        model, status = plan.model, plan.model.arrays.status
        launches = self._sensor_stages(plan, status, state)
        time = model.arrays.time
        for first, one in zip(self.event_offsets, self.event_sources, strict=False):
            form, view = self._form_and_view(one, state)
            inputs = {"first": first, "a": view, "events": self.events}
            launches += plan.prepare(monitors.record_events(form), 1, status=status, time=time, **inputs)
        for number, (one, stop_condition) in enumerate(
            zip(self._stops, self.settings.stops.values(), strict=True)
        ):
            form, view = self._form_and_view(one, state)
            condition = monitors.StopCriterion()
            condition.limit, condition.sign = stop_condition.condition
            condition.lasting, condition.number = stop_condition.lasting, number
            inputs = {"condition": condition, "a": view, "stops": self.stops}
            launches += plan.prepare(
                monitors.check_stop(form), 1, status=status, time=time, step=dt.clock, **inputs
            )
        for outcome_state in self.outcome_states:
            if outcome_state.outcome.at_end:
                continue
            forms, views = self._forms_and_views(outcome_state, state)
            kernel = monitors.accumulate(
                outcome_state.outcome.update, outcome_state.length, forms, outcome_state.results == 1
            )
            launches += plan.prepare(
                kernel,
                outcome_state.results,
                status=status,
                time=time,
                step=dt.clock,
                **_outcome_inputs(outcome_state, views),
            )
        return launches

    def _sensor_stages(self, plan: "ExecutionPlan", status: wp.array, state: Any) -> list[wp.Launch]:
        """Returns the launches that compute the sensors of the sources."""
        launches = sensor_stages(plan, self._step_needs, state, status)
        if self._has_nonsmooth and self._nonsmooth is not None:
            launches += self._nonsmooth.show_stages(plan, status)
        return launches

    def _form_and_view(self, sources: ResolvedSource, state: Any) -> tuple[SourceForm, Any]:
        """Returns the form and the array of a source in ``state``; ``None`` as array before allocation."""
        form = sources.form(self._real)
        if self._model is None:
            return form, None
        view = sources.view(replace(self._model.arrays, state=state))
        return form._replace(dtype=view.dtype), view

    def _forms_and_views(
        self, outcome_state: OutcomeState, state: Any
    ) -> tuple[tuple[SourceForm, ...], list[Any]]:
        """Returns the forms of the sources of an outcome, and their arrays, padded to ``MAX_SOURCES``."""
        pairs = [self._form_and_view(one, state) for one in outcome_state.sources]
        views = [view for _, view in pairs]
        return tuple(form for form, _ in pairs), views + views[:1] * (MAX_SOURCES - len(views))

    def reset_state(self, chosen: wp.array) -> None:
        """Restarts outcomes, stop conditions and events in the environments of the mask ``chosen`` [env]."""
        envs = len(chosen)
        for outcome_state in self.outcome_states:
            start = outcome_state.memory.dtype(
                *outcome_state.outcome.memory, *[0.0] * (outcome_state.length - len(outcome_state.outcome.memory))
            )
            kernel, shape = monitors.reset_outcome(outcome_state.length), (envs, outcome_state.results)
            wp.launch(kernel, dim=shape, inputs=[chosen, start, outcome_state.memory], device=self._device)
        if self._stops:
            inputs = [chosen, len(self._stops), self.stops]
            wp.launch(monitors.reset_stops(), dim=envs, inputs=inputs, device=self._device)
        if self.event_sources:
            wp.launch(monitors.reset_events(), dim=envs, inputs=[chosen, self.events], device=self._device)
        wp.launch(monitors.reset_counts(), dim=envs, inputs=[chosen, self.resets], device=self._device)

    @shared_capture_lock()
    def results(self, outcome_state: OutcomeState) -> NDArray[np.float64]:
        """Returns the results of an outcome at the current state (env, item, component).

        The sensors in ``needs`` must have been evaluated.
        """
        from warpcontact.forces.execution_plan import ExecutionPlan

        model = self._model
        assert model is not None
        plan = ExecutionPlan(model, model.envs, uses_cache=False, ordered_sum=True)
        forms, views = self._forms_and_views(outcome_state, model.arrays.state)
        outcome = outcome_state.outcome
        results = wp.empty((model.envs, outcome_state.results), dtype=wp.float64, device=self._device)
        for launch in plan.prepare(
            monitors.report(outcome.update, outcome.result, outcome_state.length, forms),
            outcome_state.results,
            status=model.arrays.status,
            time=model.arrays.time,
            results=results,
            **_outcome_inputs(outcome_state, views),
        ):
            launch.launch()
        first = outcome_state.sources[0]
        return results.numpy().reshape(model.envs, first.items, first.components).copy()


def sources_of(resolver: SourceResolver, owner: str, outcome: Outcome) -> tuple[ResolvedSource, ...]:
    """Returns the sources of an outcome.

    Raises:
        KeyError: If a sensor does not exist.
        ValueError: If a sensor cannot be used as requested. Messages begin with ``owner``.
    """
    try:
        outcome.check(resolver.nonsmooth)
    except ValueError as error:
        raise ValueError(f"{owner}: {error}") from None
    find = resolver.resolve if outcome.at_end else resolver.resolve_in_step
    return tuple(find(owner, source) for source in outcome.sources)


def _outcome_inputs(outcome_state: OutcomeState, views: Sequence[Any]) -> dict[str, Any]:
    """Returns the arguments of kernels of an outcome: its sources and its memory."""
    arrays = dict(zip("abcd", views, strict=True))
    return {"view": _source_view(outcome_state), "memory": outcome_state.memory, **arrays}


def _source_view(outcome_state: OutcomeState) -> Any:
    condition: Condition = outcome_state.outcome.condition
    source_view = monitors.SourceView()
    source_view.limit, source_view.sign = condition
    source_view.components = outcome_state.sources[0].components
    return source_view
