"""Abstract base class of time integrators."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
from warpcontact.storage.allocation_plan import AllocationPlan

if TYPE_CHECKING:
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.model import DeviceModel
    from warpcontact.model.plan import DeviceModelPlan
    from warpcontact.scene.scene_data import SceneData


class Integrator(ABC):
    """A time integration scheme: builds the launches that propose a step."""

    #: Order of convergence of the state for smooth forces.
    order: int

    @abstractmethod
    def check(self, scene: "SceneData") -> None:
        """Checks that the integrator can step a scene.

        Raises:
            ValueError: If it cannot; the message names the element.
        """

    def check_step(self, dt: float) -> None:  # noqa: B027  most schemes accept any step
        """Checks the time step [s].

        Raises:
            ValueError: If it is incompatible with the settings of the integrator.
        """

    def declare(
        self, model: "DeviceModel | DeviceModelPlan", layout: AllocationPlan
    ) -> "NonsmoothContacts | None":
        """Declares the arrays of the integrator and returns the nonsmooth contacts; ``None`` if there are none."""
        return None

    @property
    def is_fusible(self) -> bool:
        """Whether kernels exist that fuse the integration with other stages, see ``launch_shape``."""
        return False

    @property
    def stiffness_factor(self) -> float:
        """Factor f of the limit of stability: a mass m on a spring k and a damper c is stable for f h² k/m + 2 h c/m < 4."""
        return 1.0

    @abstractmethod
    def step_stages(
        self,
        plan: ExecutionPlan,
        dt: StepLength,
        state_in: Any,
        state_out: Any,
        mark: wp.array | None,
    ) -> list[wp.Launch]:
        """Returns the launches that propose a step from ``state_in`` to ``state_out``.

        Args:
            plan: Execution plan of the environments.
            dt: Step length.
            state_in: State at the start of the step.
            state_out: Receives the proposed state.
            mark: Flag [1] that is set to 1 if a swept point crosses a surface; the status of the environment is
                changed, too. ``None``: crossings do not reject the step.
        """

    def multi_step_stages(self, plan: ExecutionPlan, dt: StepLength, state: Any) -> list[wp.Launch]:
        """Returns the launch of a loop per environment, which updates ``state`` in place.

        ``plan.slice`` has the number of steps. Called only if the integrator is fusible.
        """
        raise NotImplementedError(f"{type(self).__name__} has no multi-step launch")

    def change_stages(self, plan: ExecutionPlan, change: wp.array, state: Any) -> list[wp.Launch]:
        """Returns the launches that adapt ``state`` to a step length that changes by ``change`` [env, 0] [s].

        An empty list if the state does not depend on the step length.
        """
        return []


def formulas_of(scene: "SceneData") -> dict[str, dict[str, Any]]:
    """Returns the law and friction models of all contacts of a scene: contact name → part → model."""
    return {one.name: one.formulas for one in scene.elements() if hasattr(one, "material")}
