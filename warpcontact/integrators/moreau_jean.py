"""The Moreau–Jean scheme: hard contact in time steps, without locating impacts."""

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact import checks
from warpcontact.arrays import Layout
from warpcontact.checks import limits
from warpcontact.integrators.base import Integrator, formulas_of
from warpcontact.kernels.frictions import Friction
from warpcontact.kernels.motions import driven
from warpcontact.kernels.unilateral import accelerated, gauss_seidel, restrain, step
from warpcontact.schedule import Span, StepLength, force_stages

if TYPE_CHECKING:
    from warpcontact.draft import PartDraft
    from warpcontact.model import Model
    from warpcontact.scene import Scene
    from warpcontact.unilateral.hard_contacts import HardContacts

SOLVERS = {"gauss_seidel": gauss_seidel, "accelerated": accelerated}
#: Most iterations of a step, if nothing is said.
ITERATIONS = {"gauss_seidel": 200, "accelerated": 500}
#: Relative residual to reach, if nothing is said, by precision.
TOLERANCES = {wp.float32: 1.0e-5, wp.float64: 1.0e-8}
THETA = limits("-", at_least=0.5, at_most=1.0)
TOLERANCE = limits("-", above=0.0, at_most=1.0)


@dataclass(frozen=True)
class MoreauJean(Integrator):
    """Impulses that keep contacts from approaching, with Newton's restitution and Coulomb's friction.

    Contacts are those of the pose at half a step, q + (h/2) v. Of those that are closed there, the velocities U⁺
    after the step and the impulses P satisfy 0 ≤ P_n ⟂ U_n⁺ + e U_n⁻ ≥ 0 and the cone of Coulomb; then
    q⁺ = q + h (θ v⁺ + (1 − θ) v). Impacts are not located: the scheme is of first order, and steps through
    infinitely many of them. Bodies overlap by no more than they move in a step.

    Newton's law and friction may together bring energy into an impact. Where they would, the restitution of the
    contacts that do is lowered for that step until they do not.

    Every contact is hard, with the ``restitution`` of its law, 0 if that has none, and the coefficient of its
    friction, the dynamic one where it slipped in the step before; so the same scene may be stepped either way.
    ``wc.laws.Rigid`` and ``wc.frictions.Coulomb`` have nothing but these.

    Args:
        theta: θ, from ½, which keeps the energy, to 1.
        solver: ``"gauss_seidel"``, one contact after the other, or ``"accelerated"``, all at once with momentum,
            for heavy bodies on light ones and tall stacks.
        iterations: Most iterations of a step; ``None``: those of the solver.
        tolerance: Relative residual to reach; ``None``: 1e-5 in float32, 1e-8 in float64.
        compliant: Names of contacts that act by the force of their law instead.

    Raises:
        ValueError: If a value is not allowed.
    """

    theta: float = 0.5
    solver: str = "gauss_seidel"
    iterations: int | None = None
    tolerance: float | None = None
    compliant: Collection[str] = ()

    order = 1

    def __post_init__(self) -> None:
        checks.numbers("theta", self.theta, (), THETA)
        checks.choice("solver", self.solver, tuple(SOLVERS))
        most = self.iterations
        if most is not None and (isinstance(most, bool) or not isinstance(most, int) or most < 1):
            raise ValueError(f"iterations must be a whole number of at least 1, got {most!r}")
        if self.tolerance is not None:
            checks.numbers("tolerance", self.tolerance, (), TOLERANCE)
        if isinstance(self.compliant, str):
            raise TypeError(f"compliant must be a list of names of contacts, got the string {self.compliant!r}")
        object.__setattr__(self, "compliant", tuple(self.compliant))

    def check(self, scene: "Scene") -> None:
        """Checks that what is hard has a cone of Coulomb, and what is not a force.

        Raises:
            ValueError: If not, or if there is no contact of a name in ``compliant``.
        """
        contacts = formulas_of(scene)
        for name in self.compliant:
            if name not in contacts:
                known = ", ".join(map(repr, contacts)) or "none"
                raise ValueError(f"compliant: there is no contact {name!r}; there is {known}")
        for name, formulas in contacts.items():
            for part, formula in formulas.items():
                if name in self.compliant:
                    if formula.rigid:
                        raise ValueError(
                            f"compliant: {name}.{part} is {type(formula).__name__}, which has no force of its own"
                        )
                elif isinstance(formula, Friction) and formula.parameters() and formula.of_cone() is None:
                    raise ValueError(
                        f"{name}.{part} is {type(formula).__name__}, which has no coefficient of friction for "
                        "hard contact; take a model with mu, such as wc.frictions.Coulomb, or name the contact in "
                        "compliant="
                    )
        for contact in scene.contacts:
            if contact.swept:
                raise ValueError(
                    f"{contact.name}.swept is for contacts with a force under SemiImplicitEuler; MoreauJean looks "
                    "at contacts at half a step, and has no steps to divide"
                )

    def acts(self, name: str) -> bool:
        """Whether the contact ``name`` acts by the force of its law."""
        return name in self.compliant

    def declare(self, model: "Model | PartDraft", layout: Layout) -> "HardContacts":
        """Declares the hard contacts of ``model``."""
        from warpcontact.unilateral.hard_contacts import HardContacts

        return HardContacts(model, self.compliant, SOLVERS[self.solver].scratch, layout)

    def step_stages(
        self, span: Span, dt: StepLength, state_in: Any, state_out: Any, mark: wp.array | None
    ) -> list[wp.Launch]:
        """Returns the launches: half a step, forces and contacts there, the contact problem, the whole step."""
        model, hard = span.model, span.hard
        assert hard is not None
        a, real, moves, bodies = model.arrays, model.types.real, model.moves, model.body_count
        middle = hard.middle
        status, h = a.status, dt.dynamic
        launches = span.prepare(
            step.middle(real, moves), bodies, [status, h, a.model, state_in, middle, hard.outcome]
        )
        for drive in model.drives:
            follow = driven.follow(drive.motion, real)
            for length, state in ((dt.half_clock, middle), (dt.clock, state_out)):
                inputs = [status, length, a.time, a.model, *drive.inputs, a.wrenches, state]
                launches += span.prepare(follow, drive.count, inputs)
        launches += force_stages(span, middle, h, status)
        launches += hard.collect_stages(span)
        free_inputs = [h, a.model, state_in, middle, a.wrenches, state_out, hard.moving]

        def solve(chosen: wp.array) -> list[wp.Launch]:
            free = span.prepare(step.free(real, moves), bodies, [chosen, *free_inputs])
            return free + self._solve(span, chosen)

        launches += solve(status)
        for number in range(restrain.ROUNDS if model.bounces else 0):
            inputs = [status, number, middle, hard.rows, hard.moving, hard.outcome, hard.restraint]
            launches += span.prepare(restrain.kernel(real), 1, inputs)
            launches += solve(hard.restraint.status)
        inputs = [status, h, float(self.theta), a.model, state_in, middle, hard.moving, a.wrenches, state_out]
        return launches + span.prepare(step.advance(real, moves), bodies, inputs)

    def _solve(self, span: Span, status: wp.array) -> list[wp.Launch]:
        hard, real = span.hard, span.model.types.real
        assert hard is not None
        solver = SOLVERS[self.solver]
        tolerance = TOLERANCES[real] if self.tolerance is None else self.tolerance
        iterations = ITERATIONS[self.solver] if self.iterations is None else self.iterations
        kernel = solver.kernel(real, span.model.moves, hard.rolls)
        inputs = [status, hard.rows, hard.moving, hard.outcome, tolerance, iterations]
        return span.prepare(kernel, 1, [*inputs, hard.scratch, hard.change])
