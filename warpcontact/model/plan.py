"""A scene ready to be built: what its model takes of memory is known, and nothing of it is taken."""

from collections.abc import Collection
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.forces.contact_groups import ContactGroup
from warpcontact.forces.couplings.coupling_set import CouplingSet
from warpcontact.forces.joints.joint_data import PrescribedMotionSet
from warpcontact.geometry.contact_clusters import ContactClusters
from warpcontact.geometry.side_regions import SideRegion
from warpcontact.model.model import Model
from warpcontact.model.scene_traits import SceneTraits
from warpcontact.model.sensors import Sensor
from warpcontact.model.split_model import SplitModel
from warpcontact.scene.scene import Contact, Scene
from warpcontact.stepping.requirements import stepping_memory
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.storage.memory_estimate import MemoryEstimate, MemoryItem, require, total
from warpcontact.storage.parameters import Parameter, Parameters, parameter_memory
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.devices import split_evenly

if TYPE_CHECKING:
    from warpcontact.forces.particle_contact.contact_set import ParticleContactSet
    from warpcontact.forces.shape_contact.contact_sets import ShapeContactSet


@dataclass(frozen=True)
class DeviceModelPlan(SceneTraits):
    """Everything of a model on one device but the number of environments, and no memory there yet.

    Attributes:
        scene: The scene.
        device: Warp device.
        precision: ``"float32"`` or ``"float64"``.
        types: Structs.
        layout: What is to lie on the device.
        arrays: The arrays, once they are built.
        parameters: The parameters.
        groups: The contacts by the code of their laws and friction models.
        couplings: The couplings by their code.
        shape_contact_sets: The shape contacts by the code of their laws and friction models.
        particle_contact_sets: The particle contacts.
        prescribed_motions: The bodies that follow functions of time, by class.
        clusters: The contacts by what lies together.
        sensors: What can be measured.
        side_regions: Where the surface of each contact keeps its sides apart, mesh by mesh.
        meshes: What is searched, once it is built.
        zero_step: What a model has as an array; see there.
        has_restitution: Whether restitution is to be looked after, where it may come.
    """

    scene: Scene
    device: wp.Device
    precision: str
    types: SimpleNamespace
    layout: AllocationPlan
    arrays: SimpleNamespace
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
        """The parameters by their names."""
        return self.parameters.by_name

    def memory_items(self, envs: int, varied: Collection[str] = ()) -> list[MemoryItem]:
        """Returns what ``envs`` environments would take; ``varied`` are to have a value in each."""
        return self.layout.memory_items(envs) + parameter_memory(
            self.parameters.by_name, self.parameters.device_fields, envs, varied
        )

    @shared_capture_lock()
    def build(self, envs: int) -> Model:
        """Returns the model of ``envs`` environments; once.

        Raises:
            TypeError: If a law, a friction, a shape, a spring or a motion of a user does not compile.
        """
        # What is the library's own does, and waits for whatever launches it.
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
    """Everything of a model, on one device or several, but the number of environments.

    Attributes:
        parts: What is drawn up for each device.
    """

    parts: tuple[DeviceModelPlan, ...]

    def shares(self, envs: int) -> list[tuple[DeviceModelPlan, int]]:
        """Returns the parts that ``envs`` environments are split over, each with how many it has."""
        return list(zip(self.parts, split_evenly(envs, len(self.parts)), strict=False))

    def memory(self, envs: int, varied: Collection[str] = (), **stepping: Any) -> MemoryEstimate:
        """Returns what ``envs`` environments would take, and a simulation that steps them.

        Args:
            envs: Number of environments.
            varied: Names of the parameters that are to have a value per environment.
            stepping: Options of the simulation, see ``stepping_memory``.
        """
        shares = self.shares(envs)
        model = total(
            MemoryEstimate(own, str(part.device), tuple(part.memory_items(own, varied))) for part, own in shares
        )
        return model.with_items(stepping_memory(shares, varied=varied, **stepping).items)

    def build(self, envs: int) -> Model | SplitModel:
        """Returns the model of ``envs`` environments; once.

        Raises:
            MemoryError: If it takes more memory than there is.
            TypeError: If a law, a shape or such of a user does not compile.
        """
        # Whether steps are to be captured is for the simulation to say.
        require(lambda count: self.memory(count, capture_graphs=False), envs)
        models = [part.build(own) for part, own in self.shares(envs)]
        return models[0] if len(models) == 1 else SplitModel(models)
