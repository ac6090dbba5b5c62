"""Plan of a model: everything but the number of environments, without allocated memory.

``build.plan_model`` creates it. It estimates memory (``ModelPlan.memory``) and builds the model (``ModelPlan.build``).
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.contact_groups import ContactGroup
from warpcontact.forces.couplings.coupling_set import CouplingSet
from warpcontact.forces.joints.joint_data import PrescribedMotionSet
from warpcontact.forces.sensor import Sensor
from warpcontact.geometry.contact_clusters import ContactClusters
from warpcontact.geometry.side_regions import SideRegion
from warpcontact.kernels.types import Structs
from warpcontact.model.model import Model
from warpcontact.model.scene_traits import SceneTraits
from warpcontact.model.split_model import SplitModel
from warpcontact.scene.scene import Contact, Scene
from warpcontact.stepping.requirements import stepping_memory
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.storage.memory_estimate import MemoryEstimate, MemoryItem, require, total
from warpcontact.storage.model_arrays import ModelArrays
from warpcontact.storage.parameters import Parameter, Parameters, parameter_memory
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.devices import split_evenly

if TYPE_CHECKING:
    from warpcontact.forces.particle_contact.contact_set import ParticleContactSet
    from warpcontact.forces.shape_contact.contact_sets import ShapeContactSet


@dataclass(frozen=True)
class DeviceModelPlan(SceneTraits):
    """Plan of a model on one device; no device memory is allocated before ``build``.

    Attributes:
        scene: The scene.
        device: Warp device.
        precision: ``"float32"`` or ``"float64"``.
        types: Warp structs of the precision.
        layout: Allocation plan.
        arrays: The arrays; allocated by ``build``.
        parameters: The parameters.
        groups: Contacts, grouped by contact model.
        couplings: Couplings, grouped by formulas.
        shape_contact_sets: Shape contacts, grouped by contact model.
        particle_contact_sets: Particle contacts.
        prescribed_motions: Bodies with prescribed motion, by class of motion.
        clusters: Clusters of contacts.
        sensors: Sensors by name.
        side_regions: Side regions of the surface of each contact, per mesh.
        meshes: Warp meshes of the queries; created by ``build``.
        zero_step: ``None``; an array in ``Model``.
        has_restitution: True, because nonsmooth contacts may have a restitution; see ``Model``.
    """

    scene: Scene
    device: wp.Device
    precision: str
    types: Structs
    layout: AllocationPlan
    arrays: ModelArrays
    parameters: Parameters
    groups: list[ContactGroup]
    couplings: list[CouplingSet]
    shape_contact_sets: "list[ShapeContactSet]"
    particle_contact_sets: "list[ParticleContactSet]"
    prescribed_motions: list[PrescribedMotionSet]
    clusters: ContactClusters
    sensors: dict[str, Sensor]
    side_regions: dict[Contact, list[SideRegion]]
    meshes: list[wp.Mesh]
    zero_step: None = None
    has_restitution: bool = True

    @property
    def parameters_by_name(self) -> dict[str, Parameter]:
        """The parameters by name."""
        return self.parameters.by_name

    def memory_items(self, envs: int, varied: Collection[str] = ()) -> list[MemoryItem]:
        """Returns the memory of ``envs`` environments; parameters ``varied`` have separate values per environment."""
        return self.layout.memory_items(envs) + parameter_memory(
            self.parameters.by_name, self.parameters.device_fields, envs, varied
        )

    @shared_capture_lock()
    def build(self, envs: int) -> Model:
        """Returns the model of ``envs`` environments. Can be called only once.

        Raises:
            TypeError: If a user-defined law, friction model, shape, spring or motion does not compile.
        """
        # ``compile`` compiles user-defined formulas only; other kernels are compiled when they are launched.
        for group in self.groups:
            group.compile(self.device)
        for contacts in self.shape_contact_sets:
            contacts.compile(self.device)
        for couplings in self.couplings:
            couplings.compile(self.device)
        for particle_set in self.particle_contact_sets:
            particle_set.compile(self.device)
        for motion_set in self.prescribed_motions:
            motion_set.compile(self.device, self.types.real)
        self.layout.allocate(envs)
        return Model(
            scene=self.scene,
            envs=envs,
            device=self.device,
            precision=self.precision,
            types=self.types,
            layout=self.layout,
            arrays=self.arrays,
            parameters=self.parameters.by_name,
            device_fields=self.parameters.device_fields,
            groups=self.groups,
            couplings=self.couplings,
            shape_contact_sets=self.shape_contact_sets,
            particle_contact_sets=self.particle_contact_sets,
            prescribed_motions=self.prescribed_motions,
            clusters=self.clusters,
            sensors=self.sensors,
            side_regions=self.side_regions,
            meshes=self.meshes,
        )


@dataclass(frozen=True)
class ModelPlan:
    """Plan of a model on one or several devices.

    Attributes:
        parts: Plan of each device.
    """

    parts: tuple[DeviceModelPlan, ...]

    def shares(self, envs: int) -> list[tuple[DeviceModelPlan, int]]:
        """Returns the parts over which ``envs`` environments are split, each with its number."""
        return list(zip(self.parts, split_evenly(envs, len(self.parts)), strict=False))

    def memory(self, envs: int, varied: Collection[str] = (), **stepping: Any) -> MemoryEstimate:
        """Returns the memory estimate of a model with ``envs`` environments and a simulation.

        Args:
            envs: Number of environments.
            varied: Names of parameters with separate values per environment.
            stepping: Options of the simulation, see ``stepping_memory``.
        """
        shares = self.shares(envs)
        model = total(
            MemoryEstimate(own, str(part.device), tuple(part.memory_items(own, varied))) for part, own in shares
        )
        return model.with_items(stepping_memory(shares, varied=varied, **stepping).items)

    def build(self, envs: int) -> Model | SplitModel:
        """Returns the model of ``envs`` environments. Can be called only once.

        Raises:
            MemoryError: If the model does not fit into memory.
            TypeError: If a user-defined formula does not compile.
        """
        # Without graphs, because the simulation decides later whether steps are captured.
        require(lambda count: self.memory(count, capture_graphs=False), envs)
        models = [part.build(own) for part, own in self.shares(envs)]
        return models[0] if len(models) == 1 else SplitModel(models)
