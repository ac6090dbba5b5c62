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
from warpcontact.forces.particle_contact.contact_set import particle_arrays
from warpcontact.kernels.broadphase import swept
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.integrators import semi_implicit
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
        # The kernel sums the wrenches of particles, see ``sums_by_body``.
        particle_set = next(iter(model.of_family("particle contact") if by_cluster else ()), None)
        sources = plan.other_forces if by_cluster else None
        kernel = semi_implicit.semi_implicit_euler(
            real, model.has_joints, sources, plan.shape.integrator_accepts, particle_set is not None
        )
        inputs = [
            a.status,
            dt.real,
            a.model,
            a.guard,
            state_in,
            a.cache.queue_count,
            a.active_contacts,
            a.coupling_wrenches,
        ]
        inputs += particle_arrays(particle_set, real)
        # Without monitors, only bodies with joints or prescribed motion need the sum of wrenches in memory.
        inputs += [plan.write_outputs or model.has_joints, a.wrenches]
        inputs += [dt.clock, a.time, model.clusters.count, a.contacts, a.history, a.cache, state_out]
        launches += plan.prepare(kernel, model.body_count, inputs, block_dim=SMALL_BLOCK if particle_set else None)
        for element in plan.force_elements:
            launches += element.integration_launches(plan, dt, state_in, state_out)
        if model.has_swept_contacts:
            marked = wp.zeros(1, dtype=wp.int32, device=model.device) if mark is None else mark
            inputs = [
                a.status,
                a.model,
                state_in,
                state_out,
                plan.uses_cache,
                a.cache,
                a.contacts,
                a.active_contacts,
            ]
            inputs += [int(mark is not None), marked]
            launches += plan.prepare(swept.kernel(real), model.clusters.count, inputs)
        return launches

    def multi_step_stages(self, plan: ExecutionPlan, dt: StepLength, state: Any) -> list[wp.Launch]:
        """Returns the launch of a loop per environment."""
        return multi_step_stages(plan, dt, state)

    def change_stages(self, plan: ExecutionPlan, change: wp.array, state: Any) -> list[wp.Launch]:
        """Returns the launches that adapt the velocities, which lag half a step behind the positions."""
        model = plan.model
        a, real = model.arrays, model.types.real
        launches = force_stages(plan, state, model.zero_step, a.status)
        inputs = [a.status, change, a.model, a.wrenches, state]
        launches += plan.prepare(semi_implicit.change_step(real, model.has_joints), model.body_count, inputs)
        for element in plan.force_elements:
            launches += element.change_launches(plan, change, state)
        return launches
