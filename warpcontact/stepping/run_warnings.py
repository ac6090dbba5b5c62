"""Warnings after a run: environments that were frozen, and problems that were not solved in some steps."""

from warpcontact.model.environments import Environments
from warpcontact.validation.warning_levels import RunWarning, WarningLevel

# Residual of the contact problem, relative to impulses and impact velocities. Up to HARMLESS the error is below
# that of the time step. Above MISSED the contact law is not satisfied.
MAX_HARMLESS_RESIDUAL = 1.0e-3
MAX_TOLERABLE_RESIDUAL = 1.0e-1


class RunWarnings:
    """Compares a model with its state when this object was made; the largest residuals are those since then.

    Args:
        model: The model.
    """

    def __init__(self, model: Environments) -> None:
        self.model = model
        self._frozen = len(model.health().frozen)
        self._failed = model.failed_catenaries()
        self._unsolved = model.unsolved_contacts()
        self._unfinished = model.unfinished_solves()
        model.reset_residuals()

    def new(self) -> list[RunWarning]:
        """Returns the warnings since then, without that of frozen environments."""
        return [*self._catenary_warnings(), *self._unsolved_warnings(), *self._solver_warnings()]

    def frozen_warnings(self) -> list[RunWarning]:
        """Returns a warning if more environments are frozen than then."""
        health = self.model.health()
        more = len(health.frozen) > self._frozen
        return [RunWarning(str(health), WarningLevel.ERROR)] if more else []

    def _catenary_warnings(self) -> list[RunWarning]:
        return [
            RunWarning(
                f"catenary {line!r} was without a solution in some steps of {count} of {self.model.envs} "
                f"environments, and its forces were those of the last iterate; {line}.failures has their number"
            )
            for line, count in self.model.failed_catenaries().items()
            if count > self._failed.get(line, 0)
        ]

    def _unsolved_warnings(self) -> list[RunWarning]:
        """Returns a warning for each contact of two shapes that was not found in more steps."""
        now = self.model.unsolved_contacts()
        warned = []
        for contact in self.model.scene.shape_contacts:
            failed = (now[contact.name] > self._unsolved[contact.name]).nonzero()[0]
            if len(failed):
                text = (
                    f"{contact.name}: where {contact.shape.name!r} and {contact.other_shape.name!r} meet was not "
                    f"found in some steps of {len(failed)} of {self.model.envs} environments, the first of them "
                    f"{self.model.first_env + failed[0]}, and no force acted then; {contact.name}.failures has "
                    "their number"
                )
                warned.append(RunWarning(text, WarningLevel.ERROR))
        return warned

    def _solver_warnings(self) -> list[RunWarning]:
        """Returns a warning about contact problems that were not solved."""
        more = self.model.unfinished_solves() - self._unfinished
        count = int((more > 0).sum())
        if not count:
            return []
        most, residuals = int(more.argmax()), self.model.largest_residuals()
        residuals[more == 0] = 0.0
        worst = int(residuals.argmax())
        residual = float(residuals[worst])
        text = (
            f"the contact problem was not solved to the tolerance in some steps of {count} of "
            f"{self.model.envs} environments, most in {self.model.first_env + most}, in {more[most]} steps. The "
            f"largest residual was {residual:.1e}, in {self.model.first_env + worst}: contact impulses and "
            f"velocities are wrong by about {100.0 * residual:.2g} % of their size"
        )
        if residual <= MAX_HARMLESS_RESIDUAL:
            return [
                RunWarning(f"{text}, which is harmless; a larger tolerance takes less time", WarningLevel.NOTE)
            ]
        return [
            RunWarning(
                f"{text}. Give the integrator more iterations, solver='accelerated', or a shorter step; "
                "scene.solve_failures has the number of such steps",
                WarningLevel.CAUTION if residual <= MAX_TOLERABLE_RESIDUAL else WarningLevel.ERROR,
            )
        ]
