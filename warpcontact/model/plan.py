"""Plan of a model on one device: everything but the number of environments, without allocated memory.

``build.plan_on_devices`` creates it, and ``DeviceModel`` is the model that it describes.
"""

from collections.abc import Collection
from dataclasses import dataclass

import warp as wp

from warpcontact.forces.contact_groups import ContactGroup
from warpcontact.forces.force_element import ForceElement
from warpcontact.forces.sensor import Sensor
from warpcontact.geometry.contact_clusters import ContactClusters
from warpcontact.geometry.side_regions import SideRegion
from warpcontact.kernels.types import Structs
from warpcontact.model.model_traits import ModelTraits
from warpcontact.scene.elements import Contact
from warpcontact.scene.scene_data import SceneData
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.storage.memory_estimate import MemoryEstimate
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.storage.parameters import Parameter, Parameters, parameter_memory
from warpcontact.system.capture_lock import shared_capture_lock


@dataclass(frozen=True)
class DeviceModelPlan(ModelTraits):
    """Plan of a model on one device; no device memory is allocated before ``allocate``.

    Attributes:
        scene: The scene.
        device: Warp device.
        precision: ``"float32"`` or ``"float64"``.
        types: Warp structs of the precision.
        layout: Allocation plan.
        arrays: The arrays; allocated by ``allocate``.
        parameters: The parameters.
        force_elements: All force elements, in launch order.
        groups: Contacts of points with meshes, grouped by contact model.
        clusters: Clusters of contacts.
        sensors: Sensors by name.
        side_regions: Side regions of the surface of each contact, per mesh.
        meshes: Warp meshes of the queries; created by ``allocate``.
        zero_step: ``None``; an array in ``DeviceModel``.
        has_restitution: True, because nonsmooth contacts may have a restitution; see ``DeviceModel``.
        has_compliance: False: kernels of nonsmooth contacts with a compliance are compiled on demand.
    """

    scene: SceneData
    device: wp.Device
    precision: str
    types: Structs
    layout: AllocationPlan
    arrays: ModelArrays
    parameters: Parameters
    force_elements: tuple[ForceElement, ...]
    groups: list[ContactGroup]
    clusters: ContactClusters
    sensors: dict[str, Sensor]
    side_regions: dict[Contact, list[SideRegion]]
    meshes: list[wp.Mesh]
    zero_step: None = None
    has_restitution: bool = True
    has_compliance: bool = False

    @property
    def parameters_by_name(self) -> dict[str, Parameter]:
        """The parameters by name."""
        return self.parameters.by_name

    def memory_estimate(self, envs: int, varied: Collection[str] = ()) -> MemoryEstimate:
        """Returns the memory estimate of a model with ``envs`` environments, without a simulation.

        Args:
            envs: Number of environments.
            varied: Names of parameters with separate values per environment.
        """
        items = self.layout.memory_items(envs) + parameter_memory(
            self.parameters.by_name, self.parameters.device_fields, envs, varied
        )
        return MemoryEstimate(envs, str(self.device), tuple(items))

    @shared_capture_lock()
    def allocate(self, envs: int) -> None:
        """Compiles user-defined formulas and allocates the arrays of ``envs`` environments. Can be called only once.

        Raises:
            TypeError: If a user-defined law, friction model, shape, spring or motion does not compile.
        """
        # ``compile`` compiles user-defined formulas only; other kernels are compiled when they are launched.
        for element in self.force_elements:
            element.compile(self.device)
        self.layout.allocate(envs)
