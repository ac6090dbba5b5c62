"""What is to be said after a run: environments that were frozen, and problems that were not solved on the way."""

from warpcontact.environments import Environments


class Remarks:
    """Compares a model with what it was when this was made.

    Args:
        model: The model.
    """

    def __init__(self, model: Environments) -> None:
        self.model = model
        self._frozen = len(model.health().frozen)
        self._failed = model.failed_lines()
        self._unsolved = model.unsolved_contacts()
        self._unfinished = model.unfinished_solves()

    def new(self) -> list[str]:
        """Returns what there is to say about the time since then, but for frozen environments."""
        return [*self._about_lines(), *self._about_unsolved(), *self._about_unfinished()]

    def about_frozen(self) -> list[str]:
        """Returns what there is to say if more environments are frozen than then."""
        health = self.model.health()
        return [str(health)] if len(health.frozen) > self._frozen else []

    def _about_lines(self) -> list[str]:
        return [
            f"catenary {line!r} was without a solution in some steps of {count} of {self.model.envs} "
            f"environments; {line}.failures has their number"
            for line, count in self.model.failed_lines().items()
            if count > self._failed.get(line, 0)
        ]

    def _about_unsolved(self) -> list[str]:
        """Of smooth contacts for which more steps failed."""
        now = self.model.unsolved_contacts()
        told = []
        for contact in self.model.scene.smooth_contacts:
            failed = (now[contact.name] > self._unsolved[contact.name]).nonzero()[0]
            if len(failed):
                told.append(
                    f"{contact.name}: where {contact.shape.name!r} and {contact.other_shape.name!r} meet was not "
                    f"found in some steps of {len(failed)} of {self.model.envs} environments, the first of them "
                    f"{self.model.first_env + failed[0]}, and no force acted then; {contact.name}.failures has "
                    "their number"
                )
        return told

    def _about_unfinished(self) -> list[str]:
        """Of contact problems that were not solved."""
        more = self.model.unfinished_solves() - self._unfinished
        count = int((more > 0).sum())
        if not count:
            return []
        worst = int(more.argmax())
        return [
            f"the contact problem was not solved to the tolerance in some steps of {count} of "
            f"{self.model.envs} environments, most in {self.model.first_env + worst}, in {more[worst]} steps; "
            "scene.solve_failures has their number, scene.solve_residual what was left: give the integrator more "
            "iterations, solver='accelerated', or a larger tolerance"
        ]
