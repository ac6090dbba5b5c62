"""What a part of a model is watched by on its device: the memory of outcomes, conditions and events."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.allocation import COUNT, SWITCH
from warpcontact.arrays import Layout, per_env
from warpcontact.captures import beside_captures
from warpcontact.compiling import load
from warpcontact.formula_errors import told_by_warp
from warpcontact.kernels.outcomes import events, reduce, stop
from warpcontact.kernels.outcomes.base import Condition, Outcome
from warpcontact.kernels.outcomes.source import MOST, Form
from warpcontact.looks import measure_stages
from warpcontact.outcomes.sources import Finder, Seen
from warpcontact.outcomes.watch import Watch

if TYPE_CHECKING:
    from warpcontact.draft import PartDraft
    from warpcontact.model import Model
    from warpcontact.schedule import Span, StepLength
    from warpcontact.unilateral.hard_contacts import HardContacts

PURPOSE = "outcomes"
#: Events of an environment in a checkpoint: their place in the ring follows from a 32-bit count.
MOST_EVENTS = 2**30


@dataclass
class Kept:
    """An outcome of a part.

    Attributes:
        name: Its name.
        outcome: What it is.
        seen: Its sources.
        memory: [env, result].
    """

    name: str
    outcome: Outcome
    seen: tuple[Seen, ...]
    memory: Any = None

    @property
    def length(self) -> int:
        """Numbers of its memory; a vector of Warp has two at least."""
        return max(2, len(self.outcome.memory))

    @property
    def results(self) -> int:
        """Number of results of an environment."""
        return self.seen[0].items * self.seen[0].components


class Observer:
    """What a part of a model is watched by.

    Args:
        model: The model, or what is drawn up of it.
        watch: What to watch.
        layout: Where to declare arrays.
        hard: The contacts that are solved for impulses.

    Attributes:
        watch: What it watches.
        kept: The outcomes.
        needs: What has to be computed for results, see ``Sensor.needs``.
        searches: Whether all contacts have to be looked at in every step.

    Raises:
        KeyError: If there is no sensor of a name.
        ValueError: If one is not what is asked for.
    """

    def __init__(
        self, model: "Model | PartDraft", watch: Watch, layout: Layout, hard: "HardContacts | None"
    ) -> None:
        self.watch = watch
        self._real, self._device = model.types.real, layout.device
        self._model: Model | None = None
        self._hard = hard
        finder = Finder(model, hard)
        self.kept = [
            Kept(name, outcome, sources_of(finder, f"outcomes[{name!r}]", outcome))
            for name, outcome in watch.outcomes.items()
        ]
        self._stops = [finder.find_number(f"stop[{name!r}]", one.source) for name, one in watch.stops.items()]
        names = () if watch.events is None else watch.events.contacts
        self.watched = [finder.indicator("events", name) for name in names]
        #: Number of the first item of each watched contact.
        self.first_places = np.cumsum([0, *(one.items for one in self.watched)]).tolist()
        in_step = [one for kept in self.kept if not kept.outcome.at_end for one in kept.seen]
        in_step += [*self._stops, *self.watched]
        self._needs_in_step = frozenset(need for one in in_step for need in one.sensor.needs)
        self.needs = self._needs_in_step.union(
            need for kept in self.kept for one in kept.seen for need in one.sensor.needs
        )
        self.searches = any(one.searches for one in in_step)
        self._shows = any(one.shown for one in in_step)
        for kept in self.kept:
            Memory = wp.types.vector(length=kept.length, dtype=wp.float64)
            layout.array(PURPOSE, kept, "memory", Memory, per_env(kept.results))
        self.stops = stop.Stops()
        if self._stops:
            count = len(self._stops)
            none_or_one = {"stopped_by": (-1, count - 1)}
            self.stops = layout.struct(
                PURPOSE, stop.Stops, per_env(count), ranges=none_or_one, stopped_by=per_env()
            )
        self.events = events.Events()
        if watch.events is not None:
            slots, places = per_env(watch.events.most), per_env(self.first_places[-1])
            ranges = {"touching": SWITCH, "count": (0, MOST_EVENTS), "what": (0, 2 * self.first_places[-1] - 1)}
            self.events = layout.struct(
                PURPOSE, events.Events, slots, ranges=ranges, count=per_env(), touching=places
            )
        self.resets: Any = None
        layout.array(PURPOSE, self, "resets", wp.int32, per_env(), ranges={"resets": COUNT})

    def begin(self, model: "Model") -> None:
        """Takes the model, once everything is allocated, and compiles outcomes, which may be a user's own.

        Raises:
            TypeError: If one does not compile.
        """
        self._model = model
        for kept in self.kept:
            outcome = kept.outcome
            forms, _ = self._look_at(kept, model.arrays.state)
            try:
                kernel = reduce.report(outcome.update, outcome.result, kept.length, forms)
                load(kernel, self._device)
            except Exception as error:
                text = told_by_warp(error, [type(outcome)])
                raise TypeError(
                    f"outcomes[{kept.name!r}]: {type(outcome).__name__} does not compile: {text}\n"
                    "m is the memory, a vector of float64, x a float64, or a vector of them of an outcome of a "
                    "contact, time and dt are float64; constants are written as wp.float64(1.5)."
                ) from error

    def stages(self, span: "Span", dt: "StepLength", state: Any) -> list[wp.Launch]:
        """Returns the launches that look at the ``state`` that a step begins from, before it is accepted."""
        model, status = span.model, span.model.arrays.status
        launches = self._measure_stages(span, status, state)
        time = model.arrays.time
        for first, one in zip(self.first_places, self.watched, strict=False):
            form, view = self._look(one, state)
            launches += span.prepare(events.kernel(form), 1, [status, time, first, view, self.events])
        for number, (one, what) in enumerate(zip(self._stops, self.watch.stops.values(), strict=True)):
            form, view = self._look(one, state)
            condition = stop.Condition()
            condition.limit, condition.sign = what.condition
            condition.lasting, condition.number = what.lasting, number
            inputs = [status, time, dt.clock, condition, view, self.stops]
            launches += span.prepare(stop.kernel(form), 1, inputs)
        for kept in self.kept:
            if kept.outcome.at_end:
                continue
            forms, views = self._look_at(kept, state)
            kernel = reduce.observe(kept.outcome.update, kept.length, forms, kept.results == 1)
            inputs = [status, time, dt.clock, _sight(kept), *views, kept.memory]
            launches += span.prepare(kernel, kept.results, inputs)
        return launches

    def _measure_stages(self, span: "Span", status: wp.array, state: Any) -> list[wp.Launch]:
        """Returns the launches that measure what is looked at."""
        launches = measure_stages(span, self._needs_in_step, state, status)
        if self._shows and self._hard is not None:
            launches += self._hard.show_stages(span, status)
        return launches

    def _look(self, seen: Seen, state: Any) -> tuple[Form, Any]:
        """Returns the form and the array of a source in ``state``; no array if nothing is allocated."""
        form = seen.form(self._real)
        if self._model is None:
            return form, None
        view = seen.view(SimpleNamespace(**{**vars(self._model.arrays), "state": state, "hard": self._hard}))
        return form._replace(dtype=view.dtype), view

    def _look_at(self, kept: Kept, state: Any) -> tuple[tuple[Form, ...], list[Any]]:
        """Returns the forms of the sources of an outcome, and ``MOST`` arrays."""
        looks = [self._look(one, state) for one in kept.seen]
        views = [view for _, view in looks]
        return tuple(form for form, _ in looks), views + views[:1] * (MOST - len(views))

    def restart(self, chosen: wp.array) -> None:
        """Starts anew in the environments of the mask ``chosen`` [env]."""
        envs = len(chosen)
        for kept in self.kept:
            start = kept.memory.dtype(*kept.outcome.memory, *[0.0] * (kept.length - len(kept.outcome.memory)))
            kernel, shape = reduce.restart(kept.length), (envs, kept.results)
            wp.launch(kernel, dim=shape, inputs=[chosen, start, kept.memory], device=self._device)
        if self._stops:
            inputs = [chosen, len(self._stops), self.stops]
            wp.launch(stop.restart(), dim=envs, inputs=inputs, device=self._device)
        if self.watched:
            wp.launch(events.restart(), dim=envs, inputs=[chosen, self.events], device=self._device)
        wp.launch(reduce.forget_count(), dim=envs, inputs=[chosen, self.resets], device=self._device)

    @beside_captures()
    def results(self, kept: Kept) -> NDArray[np.float64]:
        """Returns the results of an outcome at the current state (env, item, component); it has been measured."""
        from warpcontact.schedule import Span

        model = self._model
        assert model is not None
        span = Span(model, model.envs, cached=False, ordered=True)
        forms, views = self._look_at(kept, model.arrays.state)
        outcome = kept.outcome
        results = wp.empty((model.envs, kept.results), dtype=wp.float64, device=self._device)
        inputs = [model.arrays.status, model.arrays.time, _sight(kept), *views, kept.memory, results]
        for launch in span.prepare(
            reduce.report(outcome.update, outcome.result, kept.length, forms), kept.results, inputs
        ):
            launch.launch()
        first = kept.seen[0]
        return results.numpy().reshape(model.envs, first.items, first.components).copy()


def sources_of(finder: Finder, owner: str, outcome: Outcome) -> tuple[Seen, ...]:
    """Returns the sources of an outcome.

    Raises:
        KeyError: If there is no sensor of a name.
        ValueError: If one is not what is asked for; messages begin with ``owner``.
    """
    try:
        outcome.check(finder.hard)
    except ValueError as error:
        raise ValueError(f"{owner}: {error}") from None
    find = finder.find if outcome.at_end else finder.find_in_step
    return tuple(find(owner, source) for source in outcome.sources)


def _sight(kept: Kept) -> Any:
    condition: Condition = kept.outcome.condition
    sight = reduce.Sight()
    sight.limit, sight.sign = condition
    sight.components = kept.seen[0].components
    return sight
