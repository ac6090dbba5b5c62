"""Warnings after a run: frozen environments, and steps in which a solver did not converge."""

from warpcontact.model.environments import Environments
from warpcontact.validation.warning_levels import RunWarning, WarningLevel

# Residual of the contact problem, relative to impulses and impact velocities. Up to HARMLESS the error is below
# that of the time step. Above MISSED the contact law is not satisfied.
MAX_HARMLESS_RESIDUAL = 1.0e-3
MAX_TOLERABLE_RESIDUAL = 1.0e-1


class RunWarnings:
    """Collects the failures of a model since this object was created.

    Args:
        model: The model. Its largest residuals are reset.
    """

    def __init__(self, model: Environments) -> None:
        self.model = model
        self._frozen = len(model.health().frozen)
        self._failed = model.failures()
        self._unfinished = model.unfinished_solves()
        model.reset_residuals()

    def new(self) -> list[RunWarning]:
        """Returns the warnings about forces and solvers; see ``frozen_warnings`` for the others."""
        elements = self.model.parts[0].force_elements
        final = [warning for element in elements for warning in element.final_warnings(self.model)]
        return [*self._force_warnings(), *self._solver_warnings(), *final]

    def frozen_warnings(self) -> list[RunWarning]:
        """Returns a warning if the number of frozen environments has grown."""
        health = self.model.health()
        more = len(health.frozen) > self._frozen
        return [RunWarning(str(health), WarningLevel.ERROR)] if more else []

    def _force_warnings(self) -> list[RunWarning]:
        """Returns a warning for each element whose forces could not be computed in further steps."""
        now, envs, warned = self.model.failures(), self.model.envs, []
        for element in self.model.parts[0].force_elements:
            for name in element.failures():
                failed = (now[name] > self._failed[name]).nonzero()[0]
                if len(failed):
                    first = self.model.first_env + int(failed[0])
                    warned.append(element.failure_warning(name, len(failed), envs, first))
        return warned

    def _solver_warnings(self) -> list[RunWarning]:
        """Returns a warning about contact problems that did not converge to the tolerance."""
        more = self.model.unfinished_solves() - self._unfinished
        count = int((more > 0).sum())
        if not count:
            return []
        most, residuals = int(more.argmax()), self.model.largest_residuals()
        residuals[more == 0] = 0.0
        worst = int(residuals.argmax())
        residual = float(residuals[worst])
        text = (
            f"the contact problem did not converge to the tolerance in {count} of {self.model.envs} environments "
            f"(most often in environment {self.model.first_env + most}: {more[most]} steps). The largest residual "
            f"is {residual:.1e}, in environment {self.model.first_env + worst}: the relative error of contact "
            f"impulses and velocities is about {100.0 * residual:.2g} %"
        )
        if residual <= MAX_HARMLESS_RESIDUAL:
            return [RunWarning(f"{text}. This error is harmless; a larger tolerance is faster", WarningLevel.NOTE)]
        return [
            RunWarning(
                f"{text}. Use more iterations, solver='accelerated' or a smaller dt; "
                "scene.solve_failures counts such steps",
                WarningLevel.CAUTION if residual <= MAX_TOLERABLE_RESIDUAL else WarningLevel.ERROR,
            )
        ]
