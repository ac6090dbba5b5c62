"""The step as a list of prepared launches.

Each stage reads what earlier ones wrote:

    travel → closest point → couplings → smooth contacts → contact force (one launch per law) → wrenches → piles
    → integrate, motions → sweep → outcomes → finish → history

What an integrator does between forces and ``finish`` is its own: ``integrators/``.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.kernels import (
    contact_coupling,
    history,
    integrate,
    near,
    queues,
    sweep,
    travel,
    warps,
    wrenches,
)
from warpcontact.kernels.closest_point import CELLS, KNOWN, LISTED, RECALLED, SEARCH
from warpcontact.kernels.types import Work

if TYPE_CHECKING:
    from warpcontact.model import Model
    from warpcontact.unilateral.hard_contacts import HardContacts


# Most threads of a GPU that work off a queue, in whole warps, however long it is.
LOOKING = 262144
SEARCHING = 65536
# Up to so many blocks one launch less is worth more than threads side by side that do the same.
FEW = 131072
# Threads of a block of these: with many registers each, small blocks fill a processor better.
FEW_TOGETHER = 64


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
        slice: Where launches read, when they run, which of these environments they are for: the first and how
            many; ``None``: for all.
    """

    model: "Model"
    count: int
    cached: bool
    ordered: bool
    queued: bool = False
    hard: "HardContacts | None" = None
    looked_at: Any = None
    slice: wp.array | None = None

    def prepare(
        self,
        kernel: wp.Kernel,
        items: int,
        inputs: list[Any],
        threads: int | None = None,
        together: int = 256,
    ) -> list[wp.Launch]:
        """Returns the launch for some items per environment, recorded once; none if there is no work.

        Args:
            kernel: The kernel.
            items: Items per environment.
            inputs: Its inputs after the work.
            threads: How many, on a GPU; one for each item if not given.
            together: How many of them share the registers of a GPU block.
        """
        if items == 0:
            return []
        device = self.model.device
        work = Work()
        work.envs, work.items = self.count, items
        work.threads = (threads or self.count * items) if device.is_cuda else 1
        if self.slice is not None:
            work.slice = self.slice
        inputs = [work, *inputs]
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


def force_stages(span: Span, state: Any, step: wp.array, status: wp.array) -> list[wp.Launch]:
    """Returns the launches that compute contacts and wrenches of ``state``; they change nothing else.

    Args:
        span: The environments.
        state: Their state.
        step: What the forces act over [env, 0] [s]; zeros for the forces of the instant.
        status: Of the environments [env]; left out are those that are not active.
    """
    model = span.model
    a, real = model.arrays, model.types.real
    launches = [] if state is span.looked_at else near_stages(span, state, status)
    for couplings in model.couplings:
        launches += couplings.force_stages(span, state, status)
    for contacts in model.smooth:
        launches += contacts.force_stages(span, state, step, status)
    sources = (bool(model.couplings or model.smooth), model.pushed)
    if not span.ordered:
        kernel = wrenches.clear(real, *sources)
        launches += span.prepare(kernel, model.body_count, [status, a.model, a.ends, a.wrenches])
    for group in model.groups:
        blocks = [(group.first_block, group.block_count)]
        for first_block, count in blocks if span.hard is None else span.hard.compliant_blocks(group):
            inputs = [status, a.model, state, a.history, group.memory, step, first_block]
            inputs += [group.first, group.coefficients, a.contacts, group.kept, a.near, span.ordered, a.wrenches]
            launches += span.prepare(group.kernel, count, inputs)
    if span.ordered:
        kernel = wrenches.add_up(real, *sources)
        launches += span.prepare(kernel, model.body_count, [status, a.model, a.near, a.ends, a.wrenches])
    for pile in model.piles:
        launches += pile.force_stages(span, state, step, status)
    return launches


def near_stages(span: Span, state: Any, status: wp.array) -> list[wp.Launch]:
    """Returns the launches that look at what is near of points and meshes; arguments as in ``force_stages``."""
    model = span.model
    a, real = model.arrays, model.types.real
    launches = []
    if span.cached:
        launches += span.prepare(travel.kernel(real), model.blocks.set_count, [status, a.model, state, a.cache])
    if span.cached and span.queued:
        return launches + queue_stages(span, state, status)
    inputs = [status, a.model, state, a.history, span.cached, a.cache, a.contacts, a.near]
    return launches + span.prepare(near.kernel(real, model.follows), model.blocks.count, inputs)


def queue_stages(span: Span, state: Any, status: wp.array) -> list[wp.Launch]:
    """Returns the launches that look at what is near on a GPU, by what it takes."""
    model = span.model
    a, real, follows = model.arrays, model.types.real, model.follows
    blocks, contacts = model.blocks.count, model.contact_count

    def some(items: int, most: int) -> int:
        return min(most, -(-span.count * items // 32) * 32)

    launches = span.prepare(queues.pick(real, follows), blocks, [contacts, status, a.model, a.cache])
    if contacts > blocks:
        launches += span.prepare(
            queues.probe(real, follows),
            blocks,
            [contacts, a.model, state, a.history, a.cache, a.contacts, a.near],
            threads=some(blocks, SEARCHING),
            together=FEW_TOGETHER,
        )
    parts = [KNOWN, LISTED] if span.count * blocks > FEW else [RECALLED]
    parts += [CELLS, SEARCH] if a.celled else [SEARCH]
    for part, next_part in zip(parts, [*parts[1:], SEARCH], strict=True):
        each = warps.LANES if part == CELLS else 1
        launches += span.prepare(
            queues.work_off(real, follows, part, next_part),
            contacts,
            [a.model, state, a.history, a.cache, a.contacts, a.near],
            threads=some(each * contacts, SEARCHING if part in (CELLS, SEARCH) else LOOKING),
            together=FEW_TOGETHER,
        )
    return launches + span.prepare(queues.gather(real), blocks, [status, a.model, a.cache, a.near])


def accept_stages(span: Span, dt: StepLength, state_in: Any, state_out: Any) -> list[wp.Launch]:
    """Returns the launches that accept a proposed step in all active environments."""
    model = span.model
    a, real = model.arrays, model.types.real
    launches = span.prepare(
        integrate.finish(real), 1, [a.status, dt.clock, a.time, model.body_count, state_in, state_out]
    )
    launches += span.prepare(
        history.kernel(real, model.follows),
        model.blocks.count,
        [a.status, a.time, dt.dynamic, a.model, a.contacts, a.near, a.history],
    )
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


def adopt_stage(span: Span, source: Any, target: Any) -> list[wp.Launch]:
    """Returns the launch that copies the state of the active environments; a frozen one is left as it is."""
    model = span.model
    kernel = integrate.adopt(model.types.real)
    return span.prepare(kernel, model.body_count, [model.arrays.status, source, target])


def turn_stage(span: Span, *, back: bool) -> list[wp.Launch]:
    """Returns the launch that lets environments with a crossing step and the others wait, or all step again."""
    return span.prepare(sweep.turn(), 1, [span.model.arrays.status, int(back)])
