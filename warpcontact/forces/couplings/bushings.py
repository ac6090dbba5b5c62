"""Device data of bushings."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp

from warpcontact.algebra.vectors import inverse, quat_multiply
from warpcontact.forces.couplings.coupling_set import CouplingSet
from warpcontact.forces.couplings.step_warnings import bushing_warnings
from warpcontact.kernels.couplings import bushing
from warpcontact.scene import couplings as elements
from warpcontact.scene import elements as limits_of
from warpcontact.scene.couplings import Bushing
from warpcontact.storage.allocation_plan import per_env
from warpcontact.validation import checks
from warpcontact.validation.checks import Array

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.scene.elements import Body
    from warpcontact.storage.allocation_plan import AllocationPlan
    from warpcontact.storage.parameters import Parameters

_RANGES = {
    "stiffness": elements.STIFFNESS,
    "damping": elements.DAMPING,
    "turn_stiffness": elements.TURN_STIFFNESS,
    "turn_damping": elements.TURN_DAMPING,
    "orientation": checks.FINITE,
    "enabled": limits_of.ENABLED,
}


class BushingSet(CouplingSet):
    """All bushings of a scene."""

    couplings: list[Bushing]
    quantities: ClassVar[Mapping[str, tuple[str, str, str]]] = {
        "displacement": (
            "displacement",
            "m",
            "displacement of the second end from the first, axes of the bushing",
        ),
        "rotation": ("rotation", "rad", "rotation vector of the second body from rest, axes of the bushing"),
        "force": ("force", "N", "force on the second body, axes of the bushing"),
        "torque": ("torque", "N·m", "torque on the second body, axes of the bushing"),
        "status": ("status", "-", "state of the coupling"),
    }

    @property
    def results(self) -> Any:
        """Results of the last evaluation."""
        return self._bushings

    def _make(self, layout: "AllocationPlan", parameters: "Parameters") -> None:
        t = bushing.bushing_structs(self.types.real)
        self._bushings = layout.struct("couplings", t.Bushings, per_env(self.count), transient=True)
        self.settings: Any = None
        # Rotation from the first body to the second at rest, which is their relative orientation in the scene.
        rest = np.array(
            [
                quat_multiply(inverse(_orientation(one.bodies[1])), _orientation(one.bodies[0]))
                for one in self.couplings
            ]
        )

        def computed(values: dict[str, Array]) -> dict[str, Array]:
            first = values.pop("orientation")
            return {**values, "orientation_1": first, "orientation_2": quat_multiply(rest, first)}

        self._add_settings(parameters, self, t.Settings, _RANGES, computed)

    def force_launches(
        self, plan: "ExecutionPlan", state: Any, step: wp.array, status: wp.array, *, by_cluster: bool = False
    ) -> list[wp.Launch]:
        """Returns the launch that computes the forces of the bushings."""
        return plan.prepare(
            bushing.kernel(self.types.real),
            self.count,
            status=status,
            model=plan.model.arrays.model,
            state=state,
            first=self.first,
            settings=self.settings,
            bushings=self._bushings,
            ends=plan.model.arrays.end_wrenches,
        )

    def advice(self, model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None") -> list[str]:
        """Returns the warnings about the step length."""
        return [sentence for one in self.couplings for sentence in bushing_warnings(model, one, dt)]


def _orientation(body: "Body | None") -> Array:
    return np.array([0.0, 0.0, 0.0, 1.0]) if body is None else body.orientation
