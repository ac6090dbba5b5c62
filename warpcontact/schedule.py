"""The step as a list of prepared launches.

Each stage reads what earlier ones wrote:

    travel → closest point → couplings → contact force (one launch per law) → wrenches → integrate, motions
    → sweep → finish → history
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.kernels import contact_coupling, history, integrate, near, queues, sweep, travel, wrenches
from warpcontact.kernels.closest_point import KNOWN, LISTED, SEARCH
from warpcontact.kernels.motions import driven, step
from warpcontact.kernels.types import Work

if TYPE_CHECKING:
    from warpcontact.integrators import Integrator
    from warpcontact.model import Model


# Most threads of a GPU that work off a queue, in whole warps, however long it is.
LOOKING = 262144
SEARCHING = 65536
# Threads of a block of these: with many registers each, small blocks fill a processor better.
FEW_TOGETHER = 64


@dataclass(frozen=True)
class Span:
    """Environments side by side, of one model, and how their contacts are computed.

    Attributes:
        model: The model.
        first: Their first environment.
        count: How many.
        cached: Whether what is known of distances saves work.
        ordered: Whether wrenches are summed in one order, the same in every run.
        queued: Whether threads share out contacts by what they need, not by blocks: for many threads.
    """

    model: "Model"
    first: int
    count: int
    cached: bool
    ordered: bool
    queued: bool = False

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
        work.first, work.items, work.tasks = self.first, items, self.count * items
        work.threads = (threads or work.tasks) if device.is_cuda else 1
        inputs = [work, *inputs]
        return [wp.launch(kernel, work.threads, inputs, device=device, record_cmd=True, block_dim=together)]


@dataclass(frozen=True)
class StepLength:
    """Length of a step [env, 0] [s].

    Attributes:
        dynamic: In the precision of the model, for what forces do over it.
        clock: In float64, for clocks and for motions that are functions of time.
    """

    dynamic: wp.array
    clock: wp.array


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
    launches = []
    if span.cached:
        launches += span.prepare(travel.kernel(real), model.blocks.set_count, [status, a.model, state, a.cache])
    if span.cached and span.queued:
        launches += queue_stages(span, state, status)
    else:
        launches += span.prepare(
            near.kernel(real, model.follows),
            model.blocks.count,
            [status, a.model, state, a.history, span.cached, a.cache, a.contacts, a.near],
        )
    for couplings in model.couplings:
        launches += couplings.force_stages(span, state, status)
    sources = (bool(model.couplings), model.pushed)
    if not span.ordered:
        kernel = wrenches.clear(real, *sources)
        launches += span.prepare(kernel, model.body_count, [status, a.model, a.ends, a.wrenches])
    for group in model.groups:
        launches += span.prepare(
            group.kernel,
            group.block_count,
            [
                status,
                a.model,
                state,
                a.history,
                group.memory,
                step,
                group.first_block,
                group.first,
                group.coefficients,
                a.contacts,
                group.kept,
                a.near,
                span.ordered,
                a.wrenches,
            ],
        )
    if span.ordered:
        kernel = wrenches.add_up(real, *sources)
        launches += span.prepare(kernel, model.body_count, [status, a.model, a.near, a.ends, a.wrenches])
    return launches


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
    for part, most in ((KNOWN, LOOKING), (LISTED, LOOKING), (SEARCH, SEARCHING)):
        launches += span.prepare(
            queues.work_off(real, follows, part),
            contacts,
            [a.model, state, a.history, a.cache, a.contacts, a.near],
            threads=some(contacts, most),
            together=FEW_TOGETHER,
        )
    return launches + span.prepare(queues.gather(real), blocks, [status, a.model, a.cache, a.near])


def step_stages(
    span: Span, integrator: "Integrator", dt: StepLength, state_in: Any, state_out: Any, mark: wp.array | None
) -> list[wp.Launch]:
    """Returns the launches that propose a step from ``state_in`` to ``state_out``.

    ``mark`` [0] is set, and the status of the environment changed, where a swept point crosses a surface; with
    ``None`` such a step is taken as it is.
    """
    model = span.model
    a, real = model.arrays, model.types.real
    launches = force_stages(span, state_in, dt.dynamic, a.status)
    launches += span.prepare(
        integrator.kernel(real, model.moves),
        model.body_count,
        [a.status, dt.dynamic, a.model, state_in, a.wrenches, state_out],
    )
    launches += motion_stages(span, integrator, dt, state_in, state_out)
    if model.sweeps:
        marked = wp.zeros(1, dtype=wp.int32, device=model.device) if mark is None else mark
        launches += span.prepare(
            sweep.kernel(real),
            model.blocks.count,
            [
                a.status,
                a.model,
                state_in,
                state_out,
                span.cached,
                a.cache,
                a.contacts,
                a.near,
                int(mark is not None),
                marked,
            ],
        )
    return launches


def motion_stages(
    span: Span, integrator: "Integrator", dt: StepLength, state_in: Any, state_out: Any
) -> list[wp.Launch]:
    """Returns the launches that step the bodies that are not free; none if all are."""
    model = span.model
    a, real = model.arrays, model.types.real
    if not model.moves:
        return []
    launches = span.prepare(
        integrator.motions(real),
        model.constrained_count,
        [a.status, dt.dynamic, a.model, a.constrained, state_in, a.wrenches, state_out],
    )
    for drive in model.drives:
        launches += span.prepare(
            driven.follow(drive.motion, real),
            drive.count,
            [a.status, dt.clock, a.time, a.model, *drive.inputs, a.wrenches, state_out],
        )
    return launches


def change_stages(span: Span, integrator: "Integrator", change: wp.array, state: Any) -> list[wp.Launch]:
    """Returns the launches that ready ``state`` for steps longer by ``change`` [env, 0] than those before [s]."""
    model = span.model
    a, real = model.arrays, model.types.real
    kernel = integrator.change_step(real, model.moves)
    if kernel is None:
        return []
    launches = force_stages(span, state, model.no_step, a.status) + span.prepare(
        kernel, model.body_count, [a.status, change, a.model, a.wrenches, state]
    )
    if not model.moves:
        return launches
    launches += span.prepare(
        step.change_step(real),
        model.constrained_count,
        [a.status, change, a.model, a.constrained, a.wrenches, state],
    )
    for drive in model.drives:
        launches += span.prepare(
            driven.change_step(drive.motion, real),
            drive.count,
            [a.status, change, a.time, a.model, *drive.inputs, state],
        )
    return launches


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
    return launches


def adopt_stage(span: Span, source: Any, target: Any) -> list[wp.Launch]:
    """Returns the launch that copies the state of the active environments; a frozen one is left as it is."""
    model = span.model
    kernel = integrate.adopt(model.types.real)
    return span.prepare(kernel, model.body_count, [model.arrays.status, source, target])


def turn_stage(span: Span, *, back: bool) -> list[wp.Launch]:
    """Returns the launch that lets environments with a crossing step and the others wait, or all step again."""
    return span.prepare(sweep.turn(), 1, [span.model.arrays.status, int(back)])
