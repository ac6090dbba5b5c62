"""The Moreau–Jean scheme: nonsmooth contact in time steps, without locating impacts."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.execution_plan import ExecutionPlan, StepLength, force_stages
from warpcontact.forces.nonsmooth.materials import IMPACT_LAWS, check_rigid
from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.kernels.joints import driven
from warpcontact.kernels.nonsmooth import accelerated, gauss_seidel, restitution_limiter, sequence, step
from warpcontact.stepping.integrators.base import Integrator, formulas_of
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.validation import checks
from warpcontact.validation.checks import limits

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.model import Model
    from warpcontact.model.plan import DeviceModelPlan
    from warpcontact.scene.scene import Scene

KERNELS = {"gauss_seidel": gauss_seidel, "accelerated": accelerated}
#: What is chosen by a name: these, one where those before do not converge.
SOLVERS = {"auto": tuple(KERNELS), **{name: (name,) for name in KERNELS}}
#: Most iterations of each in a step, if nothing is said.
ITERATIONS = {"gauss_seidel": 200, "accelerated": 2000}
#: Relative residual to reach, if nothing is said, by precision.
TOLERANCES = {wp.float32: 1.0e-5, wp.float64: 1.0e-8}
#: Share of a step within which velocities of functions of time are those of an instant.
INSTANT = 0.005
THETA = limits("-", at_least=0.5, at_most=1.0)
TOLERANCE = limits("-", above=0.0, at_most=1.0)
RECOVERY_TIME = limits("s", above=0.0)


@explain_keywords_of
@dataclass(frozen=True)
class MoreauJean(Integrator):
    """Impulses that keep contacts from approaching, with Newton's restitution and Coulomb's friction.

    Contacts are those of the pose at half a step, q + (h/2) v. A contact is closed if its gap is below 1e-9 m in
    float64 and 1e-6 m in float32. The velocities U⁺ after the step and the impulses P of closed contacts satisfy
    0 ≤ P_n ⟂ U_n⁺ + e U_n⁻ ≥ 0 and the cone of Coulomb; then q⁺ = q + h (θ v⁺ + (1 − θ) v). Impacts are not
    located: the scheme is of first order, and steps through infinitely many of them. Bodies overlap by no more
    than they move in a step.

    Newton's law and friction may together bring energy into an impact. Where they would, the restitution of the
    contacts that do is lowered for that step until they do not.

    Newton's law leaves open what several contacts do that are hit together, as in Newton's cradle. With
    ``impacts="simultaneous"`` it holds for each closed contact with its own U_n⁻, and all are solved in one
    problem: five equal touching balls, e = 1, the first hit at 1 m/s, leave at (−0.6, 0.4, 0.4, 0.4, 0.4) m/s.
    With ``"sequential"`` pairs of bodies collide one after the other, the fastest first: (0, 0, 0, 0, 1) m/s. The
    contacts that were hit then part with these normal velocities, and friction acts in the one problem of the
    step.

    Every contact is hard, with the ``restitution`` of its law, 0 if that has none, and the coefficient of its
    friction, the dynamic one where it slipped in the step before; so the same scene may be stepped either way.
    ``wc.laws.Rigid`` and ``wc.friction.Coulomb`` have only these. A law that pulls and a friction without a
    coefficient are refused; a ``force_scale`` does not matter, since there is no force to scale.

    Args:
        theta: θ, from ½, which keeps the energy, to 1.
        solver: ``"gauss_seidel"``, one contact after the other; ``"accelerated"``, all at once by projected
            gradients with momentum, for heavy bodies on light ones and feet that share a load; ``"auto"``, the
            first, and the other instead in the environments where that was not enough.
        iterations: Most iterations of a solver in a step; ``None``: 200 of the first, 2000 of the other.
        tolerance: Relative residual to reach; ``None``: 1e-5 in float32, 1e-8 in float64.
        compliant: Names of contacts that act by the force of their law instead.
        impacts: Law of multiple impacts: ``"simultaneous"`` or ``"sequential"``.
        recovery_time: An overlap d, beyond the g h² of a step, is taken back at d over this time, of ten steps or
            more [s]; ``None``: it is not. That lifts bodies, which brings energy.

    Raises:
        ValueError: If a value is not allowed.
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

    def check(self, scene: "Scene") -> None:
        """Checks that contacts without a force do not pull and have Coulomb's cone, and that others have a force.

        Raises:
            ValueError: If not, or if there is no contact of a name in ``compliant``.
        """
        contacts = formulas_of(scene)
        forces = {contact.name for contact in scene.contacts if contact.facing is not None}
        for name in self.compliant:
            if name not in contacts or name in forces:
                known = ", ".join(repr(own) for own in contacts if own not in forces) or "none"
                raise ValueError(f"compliant: there is no contact {name!r}; there is {known}")
        for name, formulas in contacts.items():
            if name not in self.compliant and name not in forces:
                check_rigid(name, formulas, f"Or use SemiImplicitEuler, or compliant=[{name!r}]")
                continue
            for part, formula in formulas.items():
                if formula.rigid:
                    why = "compliant: " if name in self.compliant else "contact couplings are forces: "
                    raise ValueError(
                        f"{why}{name}.{part} is {type(formula).__name__}, which has no force of its own"
                    )
        for contact in scene.contacts:
            if contact.swept:
                raise ValueError(
                    f"{contact.name}.swept is for contacts with a force under SemiImplicitEuler; MoreauJean looks "
                    "at contacts at half a step, and has no steps to divide"
                )

    def check_step(self, dt: float) -> None:
        """Checks that overlap is not to be taken back within a step.

        Raises:
            ValueError: If it is.
        """
        if self.recovery_time is not None and self.recovery_time < dt:
            raise ValueError(
                f"recovery_time must be at least the step, {dt:g} s, got {self.recovery_time:g} s; take ten steps "
                "or more"
            )

    def declare(self, model: "Model | DeviceModelPlan", layout: AllocationPlan) -> "NonsmoothContacts":
        """Declares the nonsmooth contacts of ``model``."""
        from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts

        scratch = {name: KERNELS[name].scratch for name in SOLVERS[self.solver]}
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
        *,
        accepts: bool = False,
    ) -> list[wp.Launch]:
        """Returns the launches: half a step, forces and contacts there, the contact problem, the whole step."""
        model, nonsmooth = plan.model, plan.nonsmooth
        assert nonsmooth is not None
        a, real, has_joints, bodies = model.arrays, model.types.real, model.has_joints, model.body_count
        middle = nonsmooth.half_step_state
        status, h = a.status, dt.real
        launches = nonsmooth.sleep_stages(plan, dt.clock)
        launches += plan.prepare(
            step.half_step(real, has_joints),
            bodies,
            [status, h, a.model, state_in, middle, nonsmooth.solve_result, nonsmooth.restitution_limit],
        )
        for motion_set in model.prescribed_motions:
            follow = driven.follow(motion_set.motion, real)
            # Of the instant at which what rides on them moves as they do, from step to step.
            before, after = 2.0 * (0.5 - self.theta), 1.5 - self.theta
            for length, at, state in ((dt.half_clock, before, middle), (dt.clock, after, state_out)):
                share = (at - INSTANT, at + INSTANT)
                inputs = [status, length, a.time, a.model, a.guard, *motion_set.inputs, *share, a.wrenches, state]
                launches += plan.prepare(follow, motion_set.count, inputs)
        launches += force_stages(plan, middle, h, status)
        launches += nonsmooth.collect_stages(plan)
        free_inputs = [h, a.model, state_in, middle, a.wrenches, state_out, nonsmooth.body_response]

        free_velocities = step.free_velocities(real, has_joints)
        launches += plan.prepare(free_velocities, bodies, [status, *free_inputs])
        if nonsmooth.impact_rows is not None and model.has_restitution:
            inputs = [
                status,
                h,
                middle,
                nonsmooth.rows,
                nonsmooth.body_response,
                nonsmooth.solve_result,
                nonsmooth.tolerance,
                nonsmooth.impact_rows,
            ]
            launches += plan.prepare(sequence.kernel(real, has_joints), 1, [*inputs, nonsmooth.velocity_change])
        launches += self._solve(plan, status)
        for number in range(restitution_limiter.MAX_ROUNDS if model.has_restitution else 0):
            inputs = [
                status,
                number,
                middle,
                nonsmooth.rows,
                nonsmooth.body_response,
                nonsmooth.solve_result,
                nonsmooth.velocity_change,
            ]
            inputs += [nonsmooth.tolerance, nonsmooth.restitution_limit]
            launches += plan.prepare(restitution_limiter.kernel(real, has_joints), 1, inputs)
            launches += plan.prepare(free_velocities, bodies, [nonsmooth.restitution_limit.status, *free_inputs])
            launches += self._solve(plan, nonsmooth.restitution_limit.status)
        inputs = [
            status,
            h,
            float(self.theta),
            a.model,
            a.guard,
            state_in,
            middle,
            nonsmooth.body_response,
            a.wrenches,
        ]
        inputs.append(state_out)
        return launches + plan.prepare(step.full_step(real, has_joints), bodies, inputs)

    def _solve(self, plan: ExecutionPlan, status: wp.array) -> list[wp.Launch]:
        """Returns the launches that solve the contact problem where ``status`` [env] is active."""
        nonsmooth, real = plan.nonsmooth, plan.model.types.real
        assert nonsmooth is not None
        launches: list[wp.Launch] = []
        options: list[dict[str, bool]] = (
            [{}] if len(nonsmooth.scratch) == 1 else [{"has_fallback": True}, {"is_fallback": True}]
        )
        for (name, scratch), option in zip(nonsmooth.scratch.items(), options, strict=True):
            iterations = ITERATIONS[name] if self.iterations is None else self.iterations
            kernel = KERNELS[name].kernel(real, plan.model.has_joints, nonsmooth.rolls, **option)
            inputs = [
                status,
                nonsmooth.rows,
                nonsmooth.body_response,
                nonsmooth.solve_result,
                nonsmooth.tolerance,
                iterations,
            ]
            launches += plan.prepare(kernel, 1, [*inputs, scratch, nonsmooth.velocity_change])
        return launches
