"""The semi-implicit Euler scheme."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.integrators.base import Integrator, formulas_of
from warpcontact.kernels import integrate, sweep
from warpcontact.kernels.keywords import explain_keywords_of
from warpcontact.kernels.motions import driven, step
from warpcontact.piles.pile import touches_of
from warpcontact.schedule import FEW_TOGETHER, Span, StepLength, alone_stages, force_stages, in_place_stages

if TYPE_CHECKING:
    from warpcontact.scene import Scene


@explain_keywords_of
@dataclass(frozen=True)
class SemiImplicitEuler(Integrator):
    """Velocities from the forces at the state before the step, positions from the new velocities.

    First order; symplectic for conservative forces, so the energy of an elastic bounce does not drift.
    """

    order = 1

    def check(self, scene: "Scene") -> None:
        """Checks that every contact of ``scene`` has a force.

        Raises:
            ValueError: If one is rigid.
        """
        for name, formulas in formulas_of(scene).items():
            for part, formula in formulas.items():
                if formula.rigid:
                    raise ValueError(
                        f"{name}.{part} is {type(formula).__name__}, which has no force of its own; it needs the "
                        "integrator MoreauJean"
                    )

    def may_end(self, span: Span) -> bool:
        """Of one body alone."""
        return span.alone or span.ends_by_body

    def step_stages(
        self,
        span: Span,
        dt: StepLength,
        state_in: Any,
        state_out: Any,
        mark: wp.array | None,
        *,
        ends: bool = False,
    ) -> list[wp.Launch]:
        """Returns the launches of forces, of free bodies and of others, and those that look for crossings."""
        if ends and span.alone:
            return alone_stages(span, dt, state_in, state_out)
        model = span.model
        a, real = model.arrays, model.types.real
        by_block = span.sums_by_body
        launches = force_stages(span, state_in, dt.dynamic, a.status, by_block=by_block)
        pile = model.piles[0] if by_block and model.piles else None
        sources = span.sources if by_block else None
        kernel = integrate.semi_implicit_euler(real, model.moves, sources, ends, pile is not None)
        inputs = [a.status, dt.dynamic, a.model, a.guard, state_in, a.cache.waiting, a.near, a.ends]
        inputs += touches_of(pile, real)
        # Steps that nobody asks about them need no wrenches but those of bodies that are not free.
        inputs += [span.watched or model.moves or bool(model.drives), a.wrenches]
        inputs += [dt.clock, a.time, model.blocks.count, a.contacts, a.history, a.cache, state_out]
        launches += span.prepare(kernel, model.body_count, inputs, together=FEW_TOGETHER if pile else None)
        if model.moves:
            inputs = [a.status, dt.dynamic, a.model, a.guard, a.constrained, state_in, a.wrenches, state_out]
            launches += span.prepare(step.semi_implicit_euler(real), model.constrained_count, inputs)
        for drive in model.drives:
            inputs = [a.status, dt.clock, a.time, a.model, a.guard, *drive.inputs]
            inputs += [0.0, 1.0, a.wrenches, state_out]
            launches += span.prepare(driven.follow(drive.motion, real), drive.count, inputs)
        if model.sweeps:
            marked = wp.zeros(1, dtype=wp.int32, device=model.device) if mark is None else mark
            inputs = [a.status, a.model, state_in, state_out, span.cached, a.cache, a.contacts, a.near]
            inputs += [int(mark is not None), marked]
            launches += span.prepare(sweep.kernel(real), model.blocks.count, inputs)
        return launches

    def in_place_stages(self, span: Span, dt: StepLength, state: Any) -> list[wp.Launch]:
        """Returns one launch, of bodies alone on a CPU; none of a subclass whose steps are others."""
        own = type(self).step_stages is SemiImplicitEuler.step_stages
        return in_place_stages(span, dt, state) if own and span.in_place else []

    def change_stages(self, span: Span, change: wp.array, state: Any) -> list[wp.Launch]:
        """Returns the launches that take the velocities, half a step behind the positions, to another step."""
        model = span.model
        a, real = model.arrays, model.types.real
        launches = force_stages(span, state, model.no_step, a.status)
        inputs = [a.status, change, a.model, a.wrenches, state]
        launches += span.prepare(integrate.change_step(real, model.moves), model.body_count, inputs)
        if model.moves:
            inputs = [a.status, change, a.model, a.constrained, a.wrenches, state]
            launches += span.prepare(step.change_step(real), model.constrained_count, inputs)
        for drive in model.drives:
            inputs = [a.status, change, a.time, a.model, *drive.inputs, state]
            launches += span.prepare(driven.change_step(drive.motion, real), drive.count, inputs)
        return launches
