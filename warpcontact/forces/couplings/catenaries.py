"""Device data of catenaries."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.forces.couplings.coupling_set import CouplingSet
from warpcontact.forces.couplings.step_warnings import catenary_warnings
from warpcontact.kernels.couplings import catenary, line_measures
from warpcontact.scene import couplings as elements
from warpcontact.scene import elements as limits_of
from warpcontact.scene.couplings import Catenary
from warpcontact.scene.status import CatenaryStatus
from warpcontact.storage.allocation_plan import per_env
from warpcontact.storage.state_storage import COUNT, SWITCH
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.launches import launch_kernel
from warpcontact.validation.warning_levels import RunWarning

if TYPE_CHECKING:
    from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel
    from warpcontact.storage.allocation_plan import AllocationPlan
    from warpcontact.storage.parameters import Parameters

_RANGES = {
    "length": elements.LINE_LENGTH,
    "mass_per_length": elements.MASS_PER_LENGTH,
    "axial_stiffness": elements.AXIAL_STIFFNESS,
    "floor": elements.FLOOR,
    "enabled": limits_of.ENABLED,
}


class CatenarySet(CouplingSet):
    """The catenaries of a scene with a floor, or those without."""

    couplings: list[Catenary]
    quantities: ClassVar[Mapping[str, tuple[str, str, str]]] = {
        "tension_a": ("tension_a", "N", "tension at end a"),
        "tension_b": ("tension_b", "N", "tension at end b"),
        "horizontal_tension": (
            "horizontal_tension",
            "N",
            "horizontal component of the tension, constant along the cable",
        ),
        "dip": ("dip", "m", "depth of the lowest point of the cable below end a"),
        "stretched_length": ("stretched_length", "m", "stretched length of the cable"),
        "grounded_length": ("grounded_length", "m", "unstretched length of the part on the floor"),
        "iterations": ("iterations", "-", "number of evaluations of the cable's span by the solver"),
        "status": ("status", "-", "status of the catenary"),
        "failures": ("failures", "-", "number of steps in which the solver did not converge, since reset"),
    }
    codes = CatenaryStatus

    @staticmethod
    def key(coupling: Catenary) -> bool:
        """Returns whether there is a floor."""
        return coupling.floor is not None

    @property
    def floored(self) -> bool:
        """Whether there is a floor."""
        return self.key(self.couplings[0])

    @property
    def results(self) -> Any:
        """Results of the last evaluation."""
        return self._lines

    def _make(self, layout: "AllocationPlan", parameters: "Parameters") -> None:
        shape = per_env(self.count)
        Lines = catenary.line_structs(self.types.real).Lines
        measured = [name for name in Lines.vars if name != "failures"]
        self._lines = layout.struct("couplings", Lines, shape, transient=measured, ranges={"failures": COUNT})
        self._accepted_solution = layout.struct(
            "couplings", catenary.CatenarySolution, shape, ranges={"grounded": SWITCH}
        )
        self._trial_solution = layout.struct("couplings", catenary.CatenarySolution, shape, transient=True)
        self.settings: Any = None
        ranges = {key: allowed for key, allowed in _RANGES.items() if self.floored or key != "floor"}
        self._add_settings(parameters, self, catenary.Settings, ranges)

    def force_launches(
        self, plan: "ExecutionPlan", state: Any, step: wp.array, status: wp.array, *, by_cluster: bool = False
    ) -> list[wp.Launch]:
        """Returns the launch that computes the forces of the catenaries."""
        a = plan.model.arrays
        return plan.prepare(
            catenary.kernel(self.types.real, self.floored),
            self.count,
            status=status,
            model=a.model,
            state=state,
            first=self.first,
            settings=self.settings,
            last_solution=self._accepted_solution,
            new_solution=self._trial_solution,
            lines=self._lines,
            ends=a.end_wrenches,
        )

    def accept_launches(self, plan: "ExecutionPlan", dt: "StepLength", state_in: Any) -> list[wp.Launch]:
        """Returns the launch that stores the solution as warm start and counts failures."""
        return plan.prepare(
            catenary.accept(self.types.real),
            self.count,
            status=plan.model.arrays.status,
            new_solution=self._trial_solution,
            last_solution=self._accepted_solution,
            lines=self._lines,
        )

    def advice(self, model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None") -> list[str]:
        """Returns the warnings about the step length, and ends below the floor."""
        return [sentence for one in self.couplings for sentence in catenary_warnings(model, one, dt)]

    def reset_state(self, chosen: wp.array) -> None:
        """Clears warm starts and failures in the environments of the mask ``chosen`` [env]."""
        kernel, inputs = catenary.reset(self.types.real), [chosen, self._accepted_solution, self._lines]
        wp.launch(kernel, dim=(len(chosen), self.count), inputs=inputs, device=chosen.device)

    @shared_capture_lock()
    def shape(self, model: "DeviceModel", item: int, count: int) -> NDArray[np.float64]:
        """Returns points on a catenary at its last evaluation, (envs, count, 3), world [m]."""
        points = wp.zeros((model.envs, count), dtype=wp.vec3d, device=model.device)
        kernel = line_measures.shapes(self.types.real, self.floored)
        self._measure(model, kernel, item, points=points)
        return points.numpy()

    @shared_capture_lock()
    def stiffness(self, model: "DeviceModel", item: int) -> NDArray[np.float64]:
        """Returns the derivative of the force on end b by its position, (envs, 3, 3), world [N/m]."""
        rates = wp.zeros(model.envs, dtype=wp.mat33d, device=model.device)
        kernel = line_measures.stiffness(self.types.real, self.floored)
        self._measure(model, kernel, item, rates=rates)
        return rates.numpy()

    def _measure(self, model: "DeviceModel", kernel: wp.Kernel, item: int, **target: wp.array) -> None:
        """Launches a kernel for a catenary, one thread per element of the array ``target``."""
        (array,) = target.values()
        launch_kernel(
            kernel,
            array.shape,
            device=model.device,
            model=model.arrays.model,
            state=model.arrays.state,
            first=self.first,
            line=item,
            settings=self.settings,
            solution=self._trial_solution,
            **target,
        )

    def failures(self) -> dict[str, NDArray[np.int32]]:
        """Returns the number of steps since reset in which a catenary did not converge, (envs,) by name."""
        values = self._lines.failures.numpy()
        return {one.name: values[:, item] for item, one in enumerate(self.couplings)}

    def failure_warning(self, name: str, count: int, envs: int, first: int) -> RunWarning:
        """Returns a warning that a catenary did not converge in some steps."""
        return RunWarning(
            f"catenary {name!r} did not converge in {count} of {envs} environments. In those steps its forces are "
            f"those of the last iterate; {name}.failures counts them"
        )
