"""The step as a list of prepared launches.

Each stage reads what earlier ones wrote:

    travel → closest point → couplings → shape contacts → contact force (one launch per law) → wrenches → piles
    → integrate, motions → sweep → outcomes → finish → history

or, of bodies alone in their environment, one launch for all of it.

What an integrator does between forces and ``finish`` is its own: ``integrators/``.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.compiling import round_each_product
from warpcontact.kernels import (
    alone,
    contact_coupling,
    finish,
    history,
    in_place,
    integrate,
    meet,
    meet_in_cells,
    near,
    near_cells,
    queues,
    sweep,
    travel,
    warps,
    wrenches,
)
from warpcontact.kernels.closest_point import CELL, KNOWN, LISTED, QUERY, RECALLED, SEARCH
from warpcontact.kernels.types import Work
from warpcontact.kernels.unique import QUICK

if TYPE_CHECKING:
    from warpcontact.groups import Group
    from warpcontact.model import Model
    from warpcontact.unilateral.hard_contacts import HardContacts


# Whether stages are fused into one kernel where results stay bitwise identical. Staged kernels compile faster.
FUSES = not QUICK
# Most threads of a GPU that work off a queue, in whole warps, however long it is.
LOOKING = 262144
SEARCHING = 65536
# Contacts, or threads, that are few for a GPU, at most.
FEW = 131072
# Blocks of contacts that who integrates a body adds up on a GPU, at most.
MOST_ADDED_UP = 16
# Threads of a block: of kernels with many registers each, small blocks fill a processor better.
FEW_TOGETHER, TOGETHER_IN_CELLS, MANY_TOGETHER = 64, 128, 256
# Warps that fill the processors of a GPU; measured on an H200.
WARPS = 2048


@dataclass(frozen=True)
class Span:
    """Environments of one model, and how their contacts are computed.

    Attributes:
        model: The model.
        count: How many, from the first on.
        cached: Whether what is known of distances saves work: gap, normal and point are not told of what is far
            away then, which steps do without.
        ordered: Whether wrenches are summed in one order, the same in every run.
        queued: Whether threads share out contacts by what they need, not by blocks: for many threads.
        hard: The contacts that are solved for impulses and have no force; ``None``: all have theirs.
        looked_at: A state whose contacts are known, as nothing changed since they were looked at; ``None``: none.
        watched: Whether anyone asks what contacts did in a step: else they need not tell.
        slice: Where launches read, when they run, which of these environments they are for, the first and how
            many, and how many steps those in place take of them; ``None``: for all.
    """

    model: "Model"
    count: int
    cached: bool
    ordered: bool
    queued: bool = False
    hard: "HardContacts | None" = None
    looked_at: Any = None
    watched: bool = True
    slice: wp.array | None = None

    @property
    def sources(self) -> tuple[bool, bool]:
        """What acts on bodies beside contacts: couplings or shape contacts, and forces from outside."""
        return bool(self.model.couplings or self.model.smooth), self.model.pushed

    @property
    def few(self) -> bool:
        """Whether contacts are so few that a launch less is worth more than threads that do the same."""
        return self.count * self.model.contact_count <= FEW

    @property
    def sums_by_body(self) -> bool:
        """Whether who integrates a body may add up few blocks, and touches of a pile: nothing comes between."""
        model = self.model
        few = model.device.is_cpu or model.blocks.most_of_a_body <= MOST_ADDED_UP
        return few and (not model.piles or (len(model.piles) == 1 and model.piles[0].sums_by_body))

    @property
    def meets(self) -> bool:
        """Whether who looks at a contact computes its force, and tells nobody: on a CPU, or of single contacts."""
        model = self.model
        asked = self.watched or model.follows or self._coupled
        celled, single = model.arrays.celled, model.blocks.width == 1 and len(model.groups) == 1
        able = celled and single if self.queued else model.device.is_cpu and not celled
        return FUSES and able and self.cached and self.hard is None and not asked

    @property
    def ends_by_body(self) -> bool:
        """Whether who integrates a body may end the step of its environment: it has no other, and few contacts."""
        model = self.model
        # Of many environments of a GPU two launches, with fewer registers each, take less.
        few = model.device.is_cpu or (model.blocks.count == 1 and self.few)
        return FUSES and few and self._of_one and model.blocks.count > 0 and self.sums_by_body

    @property
    def _coupled(self) -> bool:
        """Whether contacts are those of contact couplings, which ask where each of them is."""
        return any(group.coupling_count for group in self.model.groups)

    @property
    def _of_one(self) -> bool:
        """Whether environments have one body, which is free, and contacts that follow no surface."""
        model = self.model
        return model.body_count == 1 and not (model.moves or model.drives or model.follows)

    @property
    def alone(self) -> bool:
        """Whether one launch takes a step: of bodies alone in their environments with one set of contacts."""
        model, blocks = self.model, self.model.blocks
        looks = self.queued and self.cached and model.arrays.celled and blocks.set_count == 1
        return FUSES and looks and self._of_one and not self._else_acts and blocks.count <= MOST_ADDED_UP

    @property
    def in_place(self) -> bool:
        """Whether one launch takes any number of steps: on a CPU, of bodies alone with one kind of contacts."""
        by_body = not self.queued and self.meets and self.ends_by_body
        return by_body and len(self.model.groups) == 1 and not self._else_acts and self.looked_at is None

    @property
    def _else_acts(self) -> bool:
        """Whether other things act on bodies than contacts of points and forces from outside."""
        model = self.model
        return bool(model.couplings or model.smooth or model.piles or self._coupled)

    def prepare(
        self,
        kernel: wp.Kernel,
        items: int,
        inputs: list[Any],
        threads: int | None = None,
        together: int | None = None,
    ) -> list[wp.Launch]:
        """Returns the launch for some items per environment, recorded once; none if there is no work.

        Args:
            kernel: The kernel.
            items: Items per environment.
            inputs: Its inputs after the work.
            threads: How many, on a GPU; one for each item if not given.
            together: How many of them share the registers of a GPU block; so many that few are spread over all
                processors if not given.
        """
        if items == 0:
            return []
        device = self.model.device
        work = Work()
        work.envs, work.items = self.count, items
        work.threads = (threads or self.count * items) if device.is_cuda else 1
        if self.slice is not None:
            work.slice = self.slice
        together = together or (FEW_TOGETHER if work.threads <= FEW else MANY_TOGETHER)
        inputs = [work, *inputs]
        round_each_product(kernel, device)
        return [wp.launch(kernel, work.threads, inputs, device=device, record_cmd=True, block_dim=together)]


@dataclass(frozen=True)
class StepLength:
    """Length of a step [env, 0] [s].

    Attributes:
        dynamic: In the precision of the model, for what forces do over it.
        clock: In float64, for clocks and for motions that are functions of time.
        half_clock: Half of that.
    """

    dynamic: wp.array
    clock: wp.array
    half_clock: wp.array


def force_stages(
    span: Span, state: Any, step: wp.array, status: wp.array, *, by_block: bool = False
) -> list[wp.Launch]:
    """Returns the launches that compute contacts and wrenches of ``state``; they change nothing else.

    Args:
        span: The environments.
        state: Their state.
        step: What the forces act over [env, 0] [s]; zeros for the forces of the instant.
        status: Of the environments [env]; left out are those that are not active.
        by_block: Whether what blocks of contacts and touches of a pile do is left with them, to be added up by
            whoever comes next, or by nobody.
    """
    model = span.model
    a, real = model.arrays, model.types.real
    ordered = span.ordered or by_block
    known = state is span.looked_at
    meets = span.meets and not known
    launches = [] if known or meets else near_stages(span, state, status)
    for couplings in model.couplings:
        launches += couplings.force_stages(span, state, status)
    for contacts in model.smooth:
        launches += contacts.force_stages(span, state, step, status)
    if not ordered:
        kernel = wrenches.clear(real, *span.sources)
        inputs = [status, a.cache.waiting, a.model, a.ends, a.wrenches]
        launches += span.prepare(kernel, model.body_count, inputs)
    for group in model.groups:
        if meets:
            launches += _meet_stages(span, group, state, step, status, ordered=ordered)
            continue
        blocks = [(group.first_block, group.block_count)]
        for first_block, count in blocks if span.hard is None else span.hard.compliant_blocks(group):
            inputs = [status, a.model, state, a.history, group.memory, step, first_block]
            inputs += [group.first, group.coefficients, a.contacts, group.kept, a.near, span.watched, ordered]
            inputs += [a.wrenches]
            launches += span.prepare(group.kernel, count, inputs)
    if ordered and not by_block:
        kernel = wrenches.add_up(real, *span.sources)
        inputs = [status, a.cache.waiting, a.model, a.near, a.ends, a.wrenches]
        launches += span.prepare(kernel, model.body_count, inputs)
    for pile in model.piles:
        launches += pile.force_stages(span, state, step, status, by_block=by_block)
    return launches


def _meet_stages(
    span: Span, group: "Group", state: Any, step: wp.array, status: wp.array, *, ordered: bool
) -> list[wp.Launch]:
    """Returns the launches that look at the contacts of a group and compute what they do."""
    model = span.model
    a, codes = model.arrays, (group.parts, model.types.real, group.moves, group.projected)
    whole = [a.model, state, a.history, group.memory, step]
    found = [group.coefficients, group.kept, a.cache, a.contacts, a.near]
    if not span.queued:
        kernel = meet.kernel(*codes)
        return span.prepare(kernel, group.set_count, [status, *whole, group.first_set, group.first, *found])
    inputs = [*whole, *found, ordered, a.wrenches]
    kernel = meet_in_cells.kernel(*codes, span.few)
    launches = span.prepare(kernel, group.block_count, [status, *inputs], None, TOGETHER_IN_CELLS)
    if span.few:
        return launches
    threads = min(SEARCHING, _whole_warps(span.count * group.block_count))
    return launches + span.prepare(meet_in_cells.rest(*codes), group.block_count, inputs, threads, FEW_TOGETHER)


def near_stages(span: Span, state: Any, status: wp.array) -> list[wp.Launch]:
    """Returns the launches that look at what is near of points and meshes; arguments as in ``force_stages``.

    What adds up wrenches has to follow: it empties the queues.
    """
    model = span.model
    a, real = model.arrays, model.types.real
    if span.cached and a.celled and (span.few or model.blocks.width == 1 or not span.queued):
        return _cell_stages(span, state, status)
    launches = []
    if span.cached:
        launches += span.prepare(travel.kernel(real), model.blocks.set_count, [status, a.model, state, a.cache])
    if span.cached and span.queued:
        return launches + _queue_stages(span, state, status)
    inputs = [status, a.model, state, a.history, span.cached, a.cache, a.contacts, a.near]
    return launches + span.prepare(near.kernel(real, model.follows), model.blocks.count, inputs)


def _cell_stages(span: Span, state: Any, status: wp.array) -> list[wp.Launch]:
    """Returns the launches that look at all contacts in the cells of meshes, and search for the rest."""
    model = span.model
    a, real, follows, blocks = model.arrays, model.types.real, model.follows, model.blocks.count
    inputs = [a.model, state, a.history, a.cache, a.contacts, a.near]
    # On a CPU one thread looks at a whole block.
    width = model.blocks.width if model.device.is_cuda else 0
    whole = span.few or not span.queued
    kernel = near_cells.kernel(real, follows, width, whole)
    threads, together = _whole_warps(span.count * blocks * width), warps.LANES if whole else TOGETHER_IN_CELLS
    launches = span.prepare(kernel, blocks, [status, *inputs], threads, together)
    if whole:
        return launches
    threads = min(SEARCHING, _whole_warps(span.count * blocks))
    return launches + span.prepare(near_cells.rest(real, follows), blocks, inputs, threads, FEW_TOGETHER)


def _queue_stages(span: Span, state: Any, status: wp.array) -> list[wp.Launch]:
    """Returns the launches that look at what is near on a GPU, by what it takes."""
    model = span.model
    a, real, follows = model.arrays, model.types.real, model.follows
    blocks, contacts = model.blocks.count, model.contact_count
    inputs = [a.model, state, a.history, a.cache, a.contacts, a.near]
    launches = span.prepare(queues.pick(real, follows), blocks, [contacts, status, a.model, a.cache])
    if contacts > blocks:
        kernel, threads = queues.probe(real, follows, a.celled), min(SEARCHING, _whole_warps(span.count * blocks))
        launches += span.prepare(kernel, blocks, [contacts, *inputs], threads, FEW_TOGETHER)
    parts = [CELL, QUERY] if a.celled else [RECALLED, SEARCH] if span.few else [KNOWN, LISTED, SEARCH]
    for part, next_part in zip(parts, [*parts[1:], parts[-1]], strict=True):
        kernel = queues.work_off(real, follows, part, next_part)
        most = SEARCHING if part in (SEARCH, QUERY) else LOOKING
        threads = min(most, _whole_warps(span.count * contacts))
        launches += span.prepare(kernel, contacts, inputs, threads, FEW_TOGETHER)
    return launches + span.prepare(queues.gather(real), blocks, [status, a.model, a.cache, a.near])


def _whole_warps(threads: int) -> int:
    return -(-threads // warps.LANES) * warps.LANES


def accept_stages(
    span: Span, dt: StepLength, state_in: Any, state_out: Any, *, ended: bool = False
) -> list[wp.Launch]:
    """Returns the launches that accept a proposed step in all active environments.

    ``ended``: whether clocks and the history of contacts have gone on already.
    """
    if ended and span.alone:
        # What formulas remember has as well, see ``Integrator.step_stages``.
        return []
    model = span.model
    a, real = model.arrays, model.types.real
    launches = []
    if not ended:
        at_once = model.blocks.count > 0 and not model.follows
        states = [model.body_count, state_in, state_out]
        inputs = [a.status, dt.clock, a.time, *states]
        launches += [] if at_once else span.prepare(finish.kernel(real), 1, inputs)
        inputs = [a.status, a.time, dt.dynamic, dt.clock, *states]
        inputs += [a.model, a.contacts, a.near, a.history, a.cache]
        launches += span.prepare(history.kernel(real, model.follows, at_once), model.blocks.count, inputs)
    for group in model.groups:
        if group.coupling_count:
            launches += span.prepare(
                contact_coupling.advance(group.parts.law, real, group.projected),
                group.coupling_count,
                [
                    a.status,
                    a.model,
                    state_in,
                    a.contacts,
                    a.near,
                    a.coupling_contacts,
                    group.first_coupling,
                    group.first,
                    group.coefficients.law,
                    a.reached,
                ],
            )
        for formula, memory, kept in group.memories():
            launches += span.prepare(
                history.memory_kernel(formula, real),
                group.block_count,
                [a.status, a.model, a.near, group.first_block, group.first, kept, memory],
            )
    for couplings in model.couplings:
        launches += couplings.accept_stages(span)
    for contacts in model.smooth:
        launches += contacts.accept_stages(span)
    for pile in model.piles:
        launches += pile.accept_stages(span)
    if span.hard is not None:
        launches += span.hard.accept_stages(span, dt.dynamic)
    return launches


def alone_stages(span: Span, dt: StepLength, state_in: Any, state_out: Any) -> list[wp.Launch]:
    """Returns the launch that takes an accepted semi-implicit Euler step of a span that is ``alone``."""
    model, blocks = span.model, span.model.blocks
    a, real, (group,) = model.arrays, model.types.real, model.groups
    lanes = warps.LANES if model.device.is_cuda else 1
    codes = group.parts, real, group.projected, model.pushed
    kernel = alone.kernel(*codes, blocks.width, blocks.count, lanes)
    # Of many environments each thread has one; of few so many that all processors have warps. One contact is not
    # shared out.
    own = lanes if model.contact_count == 1 else min(lanes, max(1, span.count // WARPS))
    inputs = [own, a.status, dt.dynamic, dt.clock, a.time, a.model, a.guard, state_in, a.history, group.memory]
    inputs += [group.coefficients, group.kept, a.contacts, a.near, a.cache, a.ends, state_out]
    together = FEW_TOGETHER if span.few else MANY_TOGETHER
    return span.prepare(kernel, 1, inputs, -(-span.count // own) * lanes, together)


def in_place_stages(span: Span, dt: StepLength, state: Any) -> list[wp.Launch]:
    """Returns the launch that takes accepted semi-implicit Euler steps of a slice, if the span is ``in_place``."""
    model, blocks = span.model, span.model.blocks
    a, (group,) = model.arrays, model.groups
    kernel = in_place.kernel(group.parts, model.types.real, group.projected, model.pushed)
    inputs = [a.status, dt.dynamic, dt.clock, a.time, a.model, a.guard, a.history, group.memory]
    inputs += [group.coefficients, group.kept, a.contacts, a.near, a.cache, a.ends]
    return span.prepare(kernel, 1, [*inputs, blocks.set_count, blocks.count, state])


def adopt_stage(span: Span, source: Any, target: Any) -> list[wp.Launch]:
    """Returns the launch that copies the state of the active environments; a frozen one is left as it is."""
    model = span.model
    kernel = integrate.adopt(model.types.real)
    return span.prepare(kernel, model.body_count, [model.arrays.status, source, target])


def turn_stage(span: Span, *, back: bool) -> list[wp.Launch]:
    """Returns the launch that lets environments with a crossing step and the others wait, or all step again."""
    return span.prepare(sweep.turn(), 1, [span.model.arrays.status, int(back)])
