"""Force elements: the interface of everything that acts on bodies.

A ``ForceElement`` holds the device data of elements of one family in a model on one device: arrays, launches and
sensors. The core iterates over ``model.force_elements`` and has no code for a single family. ``registry.py`` lists the families, in
the order in which they are declared and launched.
"""

from abc import ABC
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.kernels.types import Structs
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.storage.parameters import Parameters
from warpcontact.validation.warning_levels import RunWarning, WarningLevel

if TYPE_CHECKING:
    from warpcontact.forces.contact_table import ContactTable
    from warpcontact.forces.ends import Ends
    from warpcontact.forces.execution_plan import ExecutionPlan, StepLength
    from warpcontact.forces.nonsmooth.contacts import NonsmoothContacts
    from warpcontact.forces.sensor import Sensor
    from warpcontact.forces.shape_sets import ShapeSet
    from warpcontact.kernels.shapes.base import Shape
    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel
    from warpcontact.scene.scene_data import SceneData


class ForceTarget(Enum):
    """Arrays to which a force element writes, which decide when its launches run."""

    #: Force and torque at its ends (``arrays.end_wrenches``), which are then summed per body, end by end.
    ENDS = "ends"
    #: Force and torques per cluster of contacts (``arrays.active_contacts``), which are then summed per body.
    CLUSTERS = "clusters"
    #: Added to the sums of ends, clusters and external forces (``arrays.wrenches``).
    BODIES = "bodies"


@dataclass(frozen=True)
class Need:
    """A quantity that sensors of a force element need, computed on request.

    Attributes:
        declare: Declares its arrays and returns their struct; ``None``: the arrays always exist.
        by_slice: Whether ``ForceElement.sensor_launches`` computes it, for any range of environments and in every
            step. Otherwise ``ForceElement.measure`` computes it for all environments.
        all_distances: Whether it requires the evaluation of all contacts, including those that are far.
    """

    declare: Callable[[AllocationPlan], Any] | None = None
    by_slice: bool = False
    all_distances: bool = False


@dataclass(frozen=True)
class BuildContext:
    """A model on one device while its force elements are declared.

    Attributes:
        scene: The scene.
        types: Warp structs of the precision.
        layout: Allocation plan to which arrays are added.
        parameters: Parameters of the model; those of bodies, surfaces and points exist.
        arrays: Arrays of the model; allocated later.
        contacts: Contacts of points with meshes, which several families share.
        shapes: Analytic shapes by kind; their parameters exist.
        ends: Ends of force elements, at which forces act on bodies.
        has_joints: Whether any body has a joint or prescribed motion.
    """

    scene: "SceneData"
    types: Structs
    layout: AllocationPlan
    parameters: Parameters
    arrays: ModelArrays
    contacts: "ContactTable"
    shapes: "Mapping[type[Shape], ShapeSet]"
    ends: "Ends"
    has_joints: bool


class ForceElement(ABC):
    """Elements of one family that share kernels, in a model on one device.

    Subclasses declare arrays and parameters when they are created, see ``registry.Family``, and override what they
    need. By default a method does nothing. Methods that return launches are called once, when steps are prepared; the
    launches run in every step. Launches skip environments that are not active.

    Attributes:
        measures: Allocated arrays of ``needs``, by name.
    """

    #: Name of the family.
    family: ClassVar[str]
    #: Target of ``force_launches``; ``None``: it has no forces of its own.
    target: ClassVar[ForceTarget | None] = None
    #: Whether kernels that fuse several stages of a step compute its forces.
    fused: ClassVar[bool] = False
    #: Whether its steps read the outputs of contacts of points with meshes, which fused kernels do not write.
    reads_contacts: ClassVar[bool] = False

    def __init__(self) -> None:
        self.measures: dict[str, Any] = {}

    @property
    def contact_count(self) -> int:
        """Number of its contacts per environment, if their number is fixed."""
        return 0

    @property
    def cache_bytes(self) -> int:
        """Estimate of the memory that a step accesses per environment, for the size of slices [bytes]."""
        return 0

    @property
    def sums_by_body(self) -> bool:
        """Whether the integration kernel can sum its forces per body, for the target ``BODIES``."""
        return False

    @property
    def integrator_inputs(self) -> dict[str, Any]:
        """Arguments of the integration kernel from which it sums the forces, if ``sums_by_body``."""
        return {}

    def compile(self, device: wp.Device) -> None:  # noqa: B027
        """Compiles kernels with user-defined formulas, to report errors early.

        Raises:
            TypeError: If a formula does not compile.
        """

    # Stages of a step

    def detection_launches(self, plan: "ExecutionPlan", state: Any, status: wp.array) -> list[wp.Launch]:
        """Returns the launches of broad and narrow phase that run before all forces; arguments as ``force_launches``."""
        return []

    def force_launches(
        self, plan: "ExecutionPlan", state: Any, step: wp.array, status: wp.array, *, by_cluster: bool = False
    ) -> list[wp.Launch]:
        """Returns the launches that compute the forces in ``state``, without changing state or history.

        Args:
            plan: Execution plan of the environments.
            state: State of the environments.
            step: Time over which the forces act [env, 0] [s]; zeros for instantaneous forces.
            status: Status of the environments [env].
            by_cluster: Whether forces of clusters, and of the target ``BODIES``, stay unsummed. The integrator sums
                them, or they are not needed. Elements of the target ``ENDS`` ignore it.
        """
        return []

    def motion_launches(
        self, plan: "ExecutionPlan", positions: Iterable[tuple[wp.array, tuple[float, float], Any]]
    ) -> list[wp.Launch]:
        """Returns the launches that set bodies with prescribed motion.

        Args:
            plan: Execution plan of the environments.
            positions: Step length [env, 0] [s], fractions of the step between which velocities are taken, and state
                to write.
        """
        return []

    def integration_launches(
        self, plan: "ExecutionPlan", dt: "StepLength", state_in: Any, state_out: Any
    ) -> list[wp.Launch]:
        """Returns the launches of a semi-implicit Euler step of the bodies that it guides, after that of free bodies."""
        return []

    def change_launches(self, plan: "ExecutionPlan", change: wp.array, state: Any) -> list[wp.Launch]:
        """Returns the launches that adapt velocities of such bodies to a change of the step length [env, 0] [s]."""
        return []

    def accept_launches(self, plan: "ExecutionPlan", dt: "StepLength", state_in: Any) -> list[wp.Launch]:
        """Returns the launches that advance the history after an accepted step from ``state_in``."""
        return []

    # State

    def reset_state(self, chosen: wp.array) -> None:  # noqa: B027
        """Resets the history in the environments of the mask ``chosen`` [env], after their bodies were reset."""

    def invalidate_caches(self) -> None:  # noqa: B027
        """Invalidates caches after a change of parameters."""

    def restore_caches(self) -> None:  # noqa: B027
        """Sets arrays that checkpoints omit, and for which zero is no valid value, after a checkpoint was loaded."""

    def check(self) -> None:  # noqa: B027
        """Waits for the device and checks that its forces were complete in all steps since reset.

        Raises:
            RuntimeError: If they were not; the message names the element.
        """

    def sets_initial_state(self, struct: Any, attribute: str) -> bool:
        """Returns whether an array of parameters is part of the initial state of bodies."""
        return False

    # Warnings

    def advice_needs_evaluation(self, model: "Environments", nonsmooth: "NonsmoothContacts | None") -> bool:
        """Returns whether ``advice`` reads contacts of the initial state, which must be evaluated before."""
        return False

    def advice(self, model: "Environments", dt: float, nonsmooth: "NonsmoothContacts | None") -> list[str]:
        """Returns the warnings about the initial state and the time step.

        Args:
            model: The model, on all devices. Its parameters and sensors have the values of all environments.
            dt: Time step [s].
            nonsmooth: The nonsmooth contacts, which have impulses instead of forces; ``None``: there are none.
        """
        return []

    def failures(self) -> Mapping[str, NDArray[np.int32]]:
        """Returns the number of steps since reset in which forces could not be computed, (envs,) by element."""
        return {}

    def failure_warning(self, name: str, count: int, envs: int, first: int) -> RunWarning:
        """Returns a warning that forces of an element could not be computed in some steps.

        Args:
            name: Name of the element.
            count: Number of environments with such steps.
            envs: Number of environments.
            first: Number of the first such environment.
        """
        text = f"{name}: forces could not be computed in {count} of {envs} environments (first: {first})"
        return RunWarning(text, WarningLevel.ERROR)

    def final_warnings(self, model: "Environments") -> list[RunWarning]:
        """Returns the warnings about the state at the end of a run.

        Args:
            model: The model, on all devices.
        """
        return []

    # Sensors

    def sensors(self) -> Iterable["Sensor"]:
        """Returns the sensors of the elements."""
        return ()

    def needs(self) -> Mapping[str, Need]:
        """Returns the quantities that only its sensors need, by name."""
        return {}

    def sensor_launches(
        self, plan: "ExecutionPlan", needs: Collection[str], state: Any, status: wp.array
    ) -> list[wp.Launch]:
        """Returns the launches that compute ``needs`` for ``state``, after its forces; for needs ``by_slice``."""
        return []

    def measure(self, model: "DeviceModel", needs: Collection[str]) -> None:  # noqa: B027
        """Computes the remaining ``needs`` from the last evaluation of all environments."""
