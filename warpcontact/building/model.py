"""``Model`` and ``SplitModel``: models that also estimate the memory of a simulation."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

from warpcontact.kernels.catalogue.keywords import explain_keywords_of
from warpcontact.model.environments import Environments
from warpcontact.model.model import DeviceModel
from warpcontact.stepping.requirements import stepping_memory
from warpcontact.storage.memory_estimate import MemoryEstimate

if TYPE_CHECKING:
    from warpcontact.building.scene import Scene


@explain_keywords_of
class BuiltEnvironments(Environments):
    """Environments that ``Scene.build`` creates: base class of ``Model`` and ``SplitModel``."""

    def memory(self) -> MemoryEstimate:
        """Returns the memory estimate of the model and a simulation with default options.

        Arrays of sensors that were evaluated are included, recordings are not. ``print(model.memory())`` shows a
        table by location and purpose.
        """
        stepping = stepping_memory([(part, part.envs) for part in self.parts])
        return self.memory_estimate().with_items(stepping.items)


class Model(BuiltEnvironments, DeviceModel):
    """Environments of one scene on one device. Created by ``Scene.build``.

    ``model["ball.mass"]`` reads a parameter, (envs, …); ``model["ball.mass"] = values`` sets it, from one value
    or one per environment. ``model.sensor("touch.gap")`` evaluates a sensor at the current state.

    Attributes:
        scene: A copy of the scene it was built from.
        envs: Number of environments.
        first_env: Number of the first environment; nonzero if they are a part, or a batch, of more environments.
        device: Warp device.
        precision: ``"float32"`` or ``"float64"``.
        state: The current state; arrays can be shared with NumPy, PyTorch or JAX without a copy.
        time: Simulated time since the last complete reset [s].
    """

    scene: "Scene"


class SplitModel(BuiltEnvironments):
    """Environments of one scene, split over several devices. Created by ``Scene.build``.

    Parameters, sensors, resets, health and simulations work as for one ``Model`` with all environments. Only the
    state arrays are separate: ``model.parts[0].state``. Use parts to read and write data on their device. Do not step
    or reset a part alone, because its clock would then differ from the others.

    Attributes:
        scene: A copy of the scene it was built from.
        envs: Number of environments, of all parts together.
        first_env: Number of the first environment; nonzero if they are a batch of more environments.
        precision: ``"float32"`` or ``"float64"``.
        parts: The models, each on one device, in the order of the environments.
        devices: The Warp device of each part.
        time: Simulated time since the last complete reset [s].
    """

    scene: "Scene"

    def __init__(self, parts: Sequence[Model]) -> None:
        self.scene = parts[0].scene
        self.precision = parts[0].precision
        self.envs = sum(part.envs for part in parts)
        self._parts = tuple(parts)
        self.first_env = 0

    @property
    def first_env(self) -> int:
        """Number of the first environment; setting it renumbers the parts."""
        return self.parts[0].first_env

    @first_env.setter
    def first_env(self, number: int) -> None:
        for part in self.parts:
            part.first_env = number
            number += part.envs

    @property
    def parts(self) -> tuple[Model, ...]:
        """The models, each on one device, in the order of the environments."""
        return self._parts

    @property
    def state(self) -> NoReturn:
        """Not available: each part has its own state.

        Raises:
            AttributeError: Always; the message names the states of the parts.
        """
        raise AttributeError(
            f"a model split over {self._listed()} has no single state: use model.parts[0].state, …, or "
            "model.sensor('<body>.position'), which gathers all environments"
        )

    @property
    def device(self) -> NoReturn:
        """Not available: each part has its own device.

        Raises:
            AttributeError: Always; the message names ``devices``.
        """
        raise AttributeError(f"a model split over {self._listed()} has no single device: use model.devices")

    def _listed(self) -> str:
        return ", ".join(map(str, self.devices))
