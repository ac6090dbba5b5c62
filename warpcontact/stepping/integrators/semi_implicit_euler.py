"""Semi-implicit Euler scheme for compliant contact."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.execution_plan import (
    SMALL_BLOCK,
    ExecutionPlan,
    StepLength,
    force_stages,
    fused_step_stages,
    multi_step_stages,
)
from warpcontact.forces.launch_shape import WARP_PER_ENVIRONMENT
from warpcontact.kernels.broadphase import swept
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.integrators import semi_implicit
from warpcontact.kernels.particles.base import no_pairs
from warpcontact.stepping.integrators.base import Integrator, formulas_of

if TYPE_CHECKING:
    from warpcontact.scene.scene_data import SceneData


@explain_keywords_of
@dataclass(frozen=True)
class SemiImplicitEuler(Integrator):
    """Semi-implicit Euler: velocities from the forces at the start of the step, positions from the new velocities.

    First order; symplectic for conservative forces, so the energy of an elastic bounce does not drift.
    """

    order = 1

    def check(self, scene: "SceneData") -> None:
        """Checks that all contacts of ``scene`` have force laws.

        Raises:
            ValueError: If a contact has a rigid law or friction model.
        """
        for name, formulas in formulas_of(scene).items():
            for part, formula in formulas.items():
                if formula.rigid:
                    raise ValueError(
                        f"{name}.{part} is {type(formula).__name__}, which has no force; use the integrator "
                        "MoreauJean"
                    )

    @property
    def is_fusible(self) -> bool:
        """Whether the stages are those of this class, which kernels fuse, and not those of a subclass."""
        return type(self).step_stages is SemiImplicitEuler.step_stages

    def step_stages(
        self,
        plan: ExecutionPlan,
        dt: StepLength,
        state_in: Any,
        state_out: Any,
        mark: wp.array | None,
    ) -> list[wp.Launch]:
        """Returns the launches of forces, free bodies, bodies with joints or prescribed motion, and the swept test."""
        if plan.shape.name == WARP_PER_ENVIRONMENT:
            return fused_step_stages(plan, dt, state_in, state_out)
        model = plan.model
        a, real = model.arrays, model.types.real
        by_cluster = plan.shape.integrator_sums
        launches = force_stages(plan, state_in, dt.real, a.status, by_cluster=by_cluster)
        # The kernel sums the forces of this force element, see ``ForceElement.sums_by_body``.
        summed = next(iter(model.elements_added_to_bodies if by_cluster else ()), None)
        sources = plan.other_forces if by_cluster else None
        kernel = semi_implicit.semi_implicit_euler(
            real,
            model.has_joints,
            sources,
            plan.shape.integrator_accepts,
            summed is not None,
            model.splits_orientation,
        )
        contact_inputs = {"contacts": a.contacts, "active_contacts": a.active_contacts, "cache": a.cache}
        launches += plan.prepare(
            kernel,
            model.body_count,
            block_dim=SMALL_BLOCK if summed else None,
            status=a.status,
            step=dt.real,
            clock_step=dt.clock,
            time=a.time,
            model=a.model,
            guard=a.guard,
            state_in=state_in,
            state_out=state_out,
            queue_count=a.cache.queue_count,
            clusters=model.clusters.count,
            contact_history=a.history,
            ends=a.end_wrenches,
            # Without monitors, only bodies with joints or prescribed motion need the sum of wrenches in memory.
            write_outputs=plan.write_outputs or model.has_joints,
            wrenches=a.wrenches,
            **contact_inputs,
            **(no_pairs(real) if summed is None else summed.integrator_inputs),
        )
        for element in plan.force_elements:
            launches += element.integration_launches(plan, dt, state_in, state_out)
        if model.has_swept_contacts:
            marked = wp.zeros(1, dtype=wp.int32, device=model.device) if mark is None else mark
            launches += plan.prepare(
                swept.kernel(real),
                model.clusters.count,
                status=a.status,
                model=a.model,
                state_in=state_in,
                state_out=state_out,
                cached=plan.uses_cache,
                mark_crossings=int(mark is not None),
                any_crossed=marked,
                **contact_inputs,
            )
        return launches

    def multi_step_stages(self, plan: ExecutionPlan, dt: StepLength, state: Any) -> list[wp.Launch]:
        """Returns the launch of a loop per environment."""
        return multi_step_stages(plan, dt, state)

    def change_stages(self, plan: ExecutionPlan, change: wp.array, state: Any) -> list[wp.Launch]:
        """Returns the launches that adapt the velocities, which lag half a step behind the positions."""
        model = plan.model
        a, real = model.arrays, model.types.real
        launches = force_stages(plan, state, model.zero_step, a.status)
        launches += plan.prepare(
            semi_implicit.change_step(real, model.has_joints),
            model.body_count,
            status=a.status,
            change=change,
            model=a.model,
            wrenches=a.wrenches,
            state=state,
        )
        for element in plan.force_elements:
            launches += element.change_launches(plan, change, state)
        return launches
