"""Plan of a model on one or several devices, with its memory and that of a simulation."""

import warnings
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from warpcontact.building.model import Model, SplitModel
from warpcontact.geometry.query_mesh import QueryMeshCache
from warpcontact.model.build import plan_on_devices
from warpcontact.model.plan import DeviceModelPlan
from warpcontact.scene.point_contact_warnings import point_contact_warnings
from warpcontact.scene.repeated_pair_warnings import repeated_pair_warnings
from warpcontact.stepping.requirements import stepping_memory
from warpcontact.storage.memory_estimate import MemoryEstimate, require, total
from warpcontact.system.devices import split_evenly
from warpcontact.validation.warning_levels import ContactWarning, caller_stacklevel

if TYPE_CHECKING:
    from warpcontact.building.scene import Scene


def plan_model(
    scene: "Scene",
    device: str | Sequence[str] = "auto",
    precision: str = "float32",
    mesh_cache: QueryMeshCache | None = None,
) -> "ModelPlan":
    """Plans a model of ``scene``; arguments and errors as for ``plan_on_devices``."""
    return ModelPlan(plan_on_devices(scene, device, precision, mesh_cache))


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
        model = total(part.memory_estimate(own, varied) for part, own in shares)
        return model.with_items(stepping_memory(shares, varied=varied, **stepping).items)

    def build(self, envs: int) -> Model | SplitModel:
        """Returns the model of ``envs`` environments, and warns of contacts that should be body contacts or repeat pairs.

        Can be called only once.

        Raises:
            MemoryError: If the model does not fit into memory.
            TypeError: If a user-defined formula does not compile.
        """
        # Without graphs, because the simulation decides later whether steps are captured.
        require(lambda count: self.memory(count, capture_graphs=False), envs)
        models = [Model(part, own) for part, own in self.shares(envs)]
        scene = self.parts[0].scene
        for sentence in (*point_contact_warnings(scene), *repeated_pair_warnings(scene)):
            warnings.warn(ContactWarning(sentence), stacklevel=caller_stacklevel())
        return models[0] if len(models) == 1 else SplitModel(models)
