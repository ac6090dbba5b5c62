"""The contract of a time integrator."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
from warpcontact.storage.allocation_plan import AllocationPlan

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.model import Model
    from warpcontact.model.plan import DeviceModelPlan
    from warpcontact.scene.scene import Scene


class Integrator(ABC):
    """A scheme that takes a state over one step."""

    #: Order of convergence of the state for smooth forces.
    order: int

    @abstractmethod
    def check(self, scene: "Scene") -> None:
        """Checks that it can step a scene.

        Raises:
            ValueError: If it cannot; the message names what is in the way.
        """

    def check_step(self, dt: float) -> None:  # noqa: B027  most schemes take any
        """Checks the length of a step [s].

        Raises:
            ValueError: If it does not go with the settings.
        """

    def declare(self, model: "Model | DeviceModelPlan", layout: AllocationPlan) -> "NonsmoothContacts | None":
        """Declares what it takes beside the model; ``None``: contacts act by their forces alone."""
        return None

    def can_accept(self, plan: ExecutionPlan) -> bool:
        """Whether ``step_stages`` can end steps of these environments, where nobody has to see them before."""
        return False

    @abstractmethod
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
        """Returns the launches that propose a step from ``state_in`` to ``state_out``.

        With ``accepts`` it is accepted at once, as far as clocks and the history of contacts go; and what formulas
        remember, if the span is ``alone``.

        ``mark`` [0] is set, and the status of the environment changed, where a swept point crosses a surface;
        with ``None`` such a step is taken as it is.
        """

    def multi_step_stages(self, plan: ExecutionPlan, dt: StepLength, state: Any) -> list[wp.Launch]:
        """Returns the launches that take accepted steps of ``state`` in place, as many as ``span.slice`` says.

        Nobody sees them. None: these environments have no such steps.
        """
        return []

    def change_stages(self, plan: ExecutionPlan, change: wp.array, state: Any) -> list[wp.Launch]:
        """Returns the launches that ready ``state`` for steps longer by ``change`` [env, 0] than those before [s].

        None: a state does not depend on the step that led to it.
        """
        return []


def formulas_of(scene: "Scene") -> dict[str, dict[str, Any]]:
    """Returns law and friction models by the name of their part, of every contact of a scene by its name."""
    return {
        **{contact.name: contact.material.formulas for contact in scene.contacts},
        **{contact.name: contact.formulas for contact in scene.shape_contacts},
        **{contact.name: contact.formulas for contact in scene.particle_contacts},
    }
