"""Moreau–Jean time-stepping scheme: nonsmooth contact by impulses per step, without locating impacts.

Reference: M. Jean, "The non-smooth contact dynamics method", Comput. Methods Appl. Mech. Eng. 177 (1999) 235–257.
Kernels: ``kernels/nonsmooth``.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.execution_plan import ExecutionPlan, StepLength, force_stages
from warpcontact.forces.nonsmooth.materials import IMPACT_LAWS, check_rigid
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.lowlevel.warps import LANES
from warpcontact.kernels.nonsmooth import (
    accelerated,
    gauss_seidel,
    load_sharing,
    lost_gaps,
    restitution_limiter,
    sequence,
    step,
)
from warpcontact.stepping.integrators.base import Integrator, formulas_of
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.validation import checks
from warpcontact.validation.checks import limits

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.model import DeviceModel
    from warpcontact.model.plan import DeviceModelPlan
    from warpcontact.scene.scene_data import SceneData

KERNELS = {"gauss_seidel": gauss_seidel, "accelerated": accelerated}
#: Kernels of each value of ``solver``; the second one is used if the first one does not converge.
SOLVERS = {"auto": tuple(KERNELS), **{name: (name,) for name in KERNELS}}
#: Default maximum number of iterations per step.
ITERATIONS = {"gauss_seidel": 200, "accelerated": 2000}
#: Largest number of Gauss–Seidel sweeps on a GPU before ``accelerated`` takes over, whose iterations are parallel there.
SWEEPS_GPU = 20
#: Default tolerance of the relative residual, by precision.
TOLERANCES = {wp.float32: 1.0e-5, wp.float64: 1.0e-8}
#: Half width, as a fraction of the step, of the difference that gives velocities of prescribed motions.
INSTANT = 0.005
THETA = limits("-", at_least=0.5, at_most=1.0)
TOLERANCE = limits("-", above=0.0, at_most=1.0)
RECOVERY_TIME = limits("s", above=0.0)


@explain_keywords_of
@dataclass(frozen=True)
class MoreauJean(Integrator):
    """Moreau–Jean scheme: contact impulses with Newton's restitution and Coulomb friction.

    Contacts are detected at the pose at half a step, q + (h/2) v. A contact is closed if its gap is below 1e-9 m in
    float64 and 1e-6 m in float32. The velocities U⁺ after the step and the impulses P of closed contacts satisfy
    0 ≤ P_n ⟂ U_n⁺ + e U_n⁻ ≥ 0 and Coulomb's friction cone; then q⁺ = q + h (θ v⁺ + (1 − θ) v). Impacts are not
    located, so the scheme is of first order and steps across accumulations of impacts. Penetration is bounded by the
    displacement per step.

    Newton's law with friction can add energy in an impact. In such a step the restitution of the contacts involved
    is reduced until the impact adds no energy.

    Newton's law does not determine the outcome of simultaneous impacts, as in Newton's cradle. With
    ``impacts="simultaneous"`` it holds for each closed contact with its own U_n⁻, in one contact problem: five equal
    touching balls, e = 1, the first hit at 1 m/s, leave at (−0.6, 0.4, 0.4, 0.4, 0.4) m/s. With ``"sequential"``
    pairs of bodies collide one after the other, the fastest first: (0, 0, 0, 0, 1) m/s. The contact problem of the
    step then prescribes the resulting normal velocities and adds friction.

    All contacts are nonsmooth, with the ``restitution`` of their law (0 if it has none) and the coefficient of their
    friction model, the dynamic one if the contact slipped in the last step. Other parameters of laws and friction
    models are ignored, so the same scene can be stepped with either integrator. ``wc.laws.Rigid`` and
    ``wc.friction.Coulomb`` have only these parameters. Adhesive laws and friction models without a coefficient are
    rejected. ``force_scale`` has no effect.

    Args:
        theta: θ in [½, 1]. θ = ½ conserves energy between impacts.
        solver: ``"gauss_seidel"``: one contact after the other. ``"accelerated"``: all contacts simultaneously, by
            projected gradients with momentum, for heavy bodies on light ones and statically indeterminate supports.
            ``"auto"``: the first, then the second for sets of bodies in contact where the first did not converge (on a
            GPU, in 20 sweeps). If two
            bodies have several contacts and these or their load have changed, accelerated steps from zero come first, so
            that all contacts share the load.
        iterations: Maximum number of iterations per step. Default: 200 (``"gauss_seidel"``), 2000
            (``"accelerated"``).
        tolerance: Tolerance of the relative residual. Default: 1e-5 in float32, 1e-8 in float64.
        compliant: Names of contacts that use the force of their law instead of impulses.
        impacts: Law of simultaneous impacts: ``"simultaneous"`` or ``"sequential"``.
        recovery_time: Penetration d beyond g h² is reduced with the velocity d / recovery_time [s]; use ten steps or
            more. This lifts bodies and adds energy. Default: penetration is not reduced.

    Raises:
        ValueError: If a value is out of range.
    """

    theta: float = 0.5
    solver: str = "auto"
    iterations: int | None = None
    tolerance: float | None = None
    compliant: Collection[str] = ()
    recovery_time: float | None = None
    impacts: str = "simultaneous"

    order = 1

    def __post_init__(self) -> None:
        checks.numbers("theta", self.theta, (), THETA)
        checks.choice("solver", self.solver, tuple(SOLVERS))
        checks.choice("impacts", self.impacts, IMPACT_LAWS)
        if self.iterations is not None:
            checks.integer("iterations", self.iterations)
        if self.tolerance is not None:
            checks.numbers("tolerance", self.tolerance, (), TOLERANCE)
        if self.recovery_time is not None:
            checks.numbers("recovery_time", self.recovery_time, (), RECOVERY_TIME)
        if isinstance(self.compliant, str):
            raise TypeError(f"compliant must be a list of names of contacts, got the string {self.compliant!r}")
        object.__setattr__(self, "compliant", tuple(self.compliant))

    def check(self, scene: "SceneData") -> None:
        """Checks that nonsmooth contacts have a rigid law and a friction coefficient, and compliant ones a force.

        Raises:
            ValueError: If not, if a contact is swept, or if a name in ``compliant`` does not exist.
        """
        contacts = formulas_of(scene)
        forces = {contact.name for contact in scene.contacts if contact.facing is not None}
        for name in self.compliant:
            if name not in contacts or name in forces:
                known = ", ".join(repr(own) for own in contacts if own not in forces) or "none"
                raise ValueError(f"compliant: there is no contact {name!r}; contacts: {known}")
        for name, formulas in contacts.items():
            if name not in self.compliant and name not in forces:
                check_rigid(name, formulas, f"Or use SemiImplicitEuler, or compliant=[{name!r}]")
                continue
            for part, formula in formulas.items():
                if formula.rigid:
                    why = "compliant: " if name in self.compliant else "contact couplings are forces: "
                    raise ValueError(f"{why}{name}.{part} is {type(formula).__name__}, which has no force")
        for contact in scene.contacts:
            if contact.swept:
                raise ValueError(
                    f"{contact.name}.swept must be False with MoreauJean, which has no substeps. Use "
                    "SemiImplicitEuler for swept contacts"
                )

    @property
    def stiffness_factor(self) -> float:
        """2 θ: forces are those at half a step with the velocity before, so θ = ½ has the limit of ``SemiImplicitEuler``."""
        return 2.0 * float(self.theta)

    def check_step(self, dt: float) -> None:
        """Checks that the recovery time is at least a step.

        Raises:
            ValueError: If it is shorter.
        """
        if self.recovery_time is not None and self.recovery_time < dt:
            raise ValueError(
                f"recovery_time must be at least dt = {dt:g} s, got {self.recovery_time:g} s; use ten steps or more"
            )

    def declare(self, model: "DeviceModel | DeviceModelPlan", layout: AllocationPlan) -> "NonsmoothContacts":
        """Declares the nonsmooth contacts of ``model``."""
        from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts

        # All solvers start with accelerated steps where loads are shared.
        scratch = {name: KERNELS[name].scratch for name in dict.fromkeys((*SOLVERS[self.solver], "accelerated"))}
        tolerance = TOLERANCES[model.types.real] if self.tolerance is None else self.tolerance
        recovery = 0.0 if self.recovery_time is None else 1.0 / self.recovery_time
        sequential = self.impacts == "sequential"
        return NonsmoothContacts(model, self.compliant, scratch, tolerance, recovery, layout, sequential)

    def step_stages(
        self,
        plan: ExecutionPlan,
        dt: StepLength,
        state_in: Any,
        state_out: Any,
        mark: wp.array | None,
    ) -> list[wp.Launch]:
        """Returns the launches: half step, contacts and forces there, contact problem, full step."""
        model, nonsmooth = plan.model, plan.nonsmooth
        assert nonsmooth is not None
        a, real, has_joints, bodies = model.arrays, model.types.real, model.has_joints, model.body_count
        middle = nonsmooth.half_step_state
        status, h = a.status, dt.real
        launches = nonsmooth.sleep_stages(plan, dt.clock)
        launches += plan.prepare(
            step.half_step(real, has_joints),
            bodies,
            status=status,
            step=h,
            model=a.model,
            state_in=state_in,
            state_out=middle,
            solve_result=nonsmooth.solve_result,
            restitution_limit=nonsmooth.restitution_limit,
        )
        # Velocities of prescribed motion are taken at the times (fractions of the step) at which bodies carried along
        # have the same velocity from step to step.
        before, after = 2.0 * (0.5 - self.theta), 1.5 - self.theta
        positions = [
            (length, (at - INSTANT, at + INSTANT), state)
            for length, at, state in ((dt.half_clock, before, middle), (dt.clock, after, state_out))
        ]
        for element in plan.force_elements:
            launches += element.motion_launches(plan, positions)
        launches += force_stages(plan, middle, h, status)
        launches += nonsmooth.collect_stages(plan)
        motion = {
            "step": h,
            "model": a.model,
            "state_in": state_in,
            "half_step_state": middle,
            "wrenches": a.wrenches,
            "state_out": state_out,
            "body_response": nonsmooth.body_response,
        }
        free_velocities = step.free_velocities(real, has_joints)
        launches += plan.prepare(free_velocities, bodies, status=status, **motion)
        if nonsmooth.impact_rows is not None and model.has_restitution:
            launches += plan.prepare(
                sequence.kernel(real, has_joints),
                1,
                status=status,
                step=h,
                half_step_state=middle,
                impact_rows=nonsmooth.impact_rows,
                **nonsmooth.problem_inputs,
            )
        launches += self._solve(plan, status)
        limit = nonsmooth.restitution_limit
        for number in range(restitution_limiter.MAX_ROUNDS if model.has_restitution else 0):
            launches += plan.prepare(
                restitution_limiter.kernel(real, has_joints),
                1,
                status=status,
                number=number,
                half_step_state=middle,
                restitution_limit=limit,
                **nonsmooth.problem_inputs,
            )
            launches += plan.prepare(free_velocities, bodies, status=limit.status, **motion)
            launches += self._solve(plan, limit.status)
        if nonsmooth.shares_loads and not model.has_compliance:
            launches += plan.prepare(
                load_sharing.equalize_loads(real, has_joints),
                1,
                status=status,
                rows=nonsmooth.rows,
                solve_result=nonsmooth.solve_result,
            )
        launches += plan.prepare(
            lost_gaps.restore_lost_gaps(real, has_joints),
            1,
            status=status,
            model=a.model,
            rows=nonsmooth.rows,
            body_response=nonsmooth.body_response,
            solve_result=nonsmooth.solve_result,
            velocity_change=nonsmooth.velocity_change,
        )
        return launches + plan.prepare(
            step.full_step(real, has_joints),
            bodies,
            status=status,
            theta=float(self.theta),
            correction=nonsmooth.velocity_change,
            guard=a.guard,
            **motion,
        )

    def _solve(self, plan: ExecutionPlan, status: wp.array) -> list[wp.Launch]:
        """Returns the launches that solve the contact problem where ``status`` [env] is active."""
        nonsmooth, real = plan.nonsmooth, plan.model.types.real
        assert nonsmooth is not None
        launches: list[wp.Launch] = []
        solvers = SOLVERS[self.solver]
        kinds = real, plan.model.has_joints, nonsmooth.rolls, plan.model.has_compliance
        if nonsmooth.shares_loads:
            launches += plan.prepare(
                load_sharing.clear_warm_starts(*kinds), 1, status=status, **nonsmooth.problem_inputs
            )
            if solvers[0] != "accelerated":
                launches += plan.prepare(
                    accelerated.kernel(*kinds, is_start=True),
                    1,
                    threads=plan.count * LANES,
                    status=status,
                    iterations=min(load_sharing.START_ITERATIONS, self.iterations or ITERATIONS[solvers[0]]),
                    scratch=nonsmooth.scratch["accelerated"],
                    **nonsmooth.problem_inputs,
                )
        options: list[dict[str, bool]] = (
            [{}] if len(solvers) == 1 else [{"has_fallback": True}, {"is_fallback": True}]
        )
        for name, option in zip(solvers, options, strict=True):
            iterations = ITERATIONS[name] if self.iterations is None else self.iterations
            if "has_fallback" in option and plan.model.device.is_cuda:
                iterations = min(iterations, SWEEPS_GPU)
            launches += plan.prepare(
                KERNELS[name].kernel(*kinds, **option),
                1,
                threads=plan.count * LANES if name == "accelerated" else None,
                status=status,
                iterations=iterations,
                scratch=nonsmooth.scratch[name],
                **nonsmooth.problem_inputs,
            )
        return launches
