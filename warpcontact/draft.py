"""A scene ready to be built: what its model takes of memory is known, and nothing of it is taken."""

from collections.abc import Collection
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import warp as wp

from warpcontact.arrays import Layout
from warpcontact.blocks import Blocks
from warpcontact.footprint import Footprint, require
from warpcontact.groups import Group, compile_group
from warpcontact.model import Model
from warpcontact.of_scene import OfScene
from warpcontact.parameters import Parameters, needs_of
from warpcontact.readings import Reading
from warpcontact.scene import Scene
from warpcontact.stepping import stepping_needs


@dataclass(frozen=True)
class Draft(OfScene):
    """Everything of a model but the number of environments, and no memory on its device yet.

    Attributes:
        scene: The scene.
        device: Warp device.
        precision: ``"float32"`` or ``"float64"``.
        types: Structs.
        layout: What is to lie on the device.
        arrays: The arrays, once they are built.
        parameters: The parameters.
        groups: The contacts by the code of their laws and frictions.
        blocks: The contacts by what lies together.
        readings: What can be measured.
        meshes: What is searched, once it is built.
        no_step: What a model has as an array; see there.
    """

    scene: Scene
    device: wp.Device
    precision: str
    types: SimpleNamespace
    layout: Layout
    arrays: SimpleNamespace
    parameters: Parameters
    groups: list[Group]
    blocks: Blocks
    readings: dict[str, Reading]
    meshes: list[wp.Mesh]
    no_step: None = None

    def memory(self, envs: int, varied: Collection[str] = (), **stepping: Any) -> Footprint:
        """Returns what ``envs`` environments would take, and a simulation that steps them.

        Args:
            envs: Number of environments.
            varied: Names of the parameters that are to have a value per environment.
            stepping: Options of the simulation, see ``stepping_needs``.
        """
        needs = self.layout.needs(envs)
        needs += needs_of(self.parameters.by_name, self.parameters.uploads, envs, varied)
        return Footprint(envs, str(self.device), tuple(needs + stepping_needs(self, envs, **stepping)))

    def build(self, envs: int) -> Model:
        """Returns the model of ``envs`` environments; once.

        Raises:
            MemoryError: If it takes more memory than there is.
            TypeError: If a law or friction does not compile.
        """
        # Whether steps are to be captured is for the simulation to say.
        require(lambda count: self.memory(count, graphs=False), envs)
        for group in self.groups:
            compile_group(group, self.device, self.types.real)
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
            uploads=self.parameters.uploads,
            groups=self.groups,
            blocks=self.blocks,
            readings=self.readings,
            meshes=self.meshes,
        )
