"""What is to be said after a run: frozen environments, problems that were not solved, points behind meshes."""

import warnings

from warpcontact.advice import ContactWarning
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
        self._deep = model.deep_entries()

    def warn(self, stacklevel: int, *, frozen: bool = False) -> None:
        """Warns of what there is to say about the time since then, of frozen environments only if asked to."""
        told = [*self._about_lines(), *self._about_unsolved(), *self._about_unfinished()]
        for sentence in [*(self._about_frozen() if frozen else []), *told]:
            warnings.warn(sentence, RuntimeWarning, stacklevel=stacklevel + 1)
        for sentence in self._about_deep():
            warnings.warn(sentence, ContactWarning, stacklevel=stacklevel + 1)

    def _about_frozen(self) -> list[str]:
        """Of environments, if more are frozen than then."""
        health = self.model.health()
        return [str(health)] if len(health.frozen) > self._frozen else []

    def _about_deep(self) -> list[str]:
        """Of points that came to lie behind a mesh, and were in contact from there on."""
        more = self.model.deep_entries() > self._deep
        if not more.any():
            return []
        first = int(more.argmax())
        contact = self.model.deep_contact(first)
        return [
            f"{contact.name}: in {int(more.sum())} of {self.model.envs} environments, the first of them "
            f"{self.model.first_env + first}, points came to lie behind a surface, past its border or where it is "
            "hidden, and were pushed out with energy from nowhere; scene.deep_entries has how often: "
            "entry='latched' or a max_depth lets them go, a stop condition ends such environments"
        ]

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
