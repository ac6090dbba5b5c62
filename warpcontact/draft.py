"""A scene ready to be built: what its model takes of memory is known, and nothing of it is taken."""

from collections.abc import Collection
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import warp as wp

from warpcontact.arrays import Layout
from warpcontact.blocks import Blocks
from warpcontact.captures import beside_captures
from warpcontact.couplings.coupling_set import CouplingSet
from warpcontact.devices import spread
from warpcontact.drives import Drive
from warpcontact.footprint import Footprint, Need, require, total
from warpcontact.groups import Group
from warpcontact.model import Model
from warpcontact.of_scene import OfScene
from warpcontact.parameters import Parameter, Parameters, needs_of
from warpcontact.scene import Contact, Scene
from warpcontact.sensors import Sensor
from warpcontact.sides import Sides
from warpcontact.split_model import SplitModel
from warpcontact.stepping import stepping_footprint

if TYPE_CHECKING:
    from warpcontact.piles.pile import Pile
    from warpcontact.smooth.contact_sets import ShapeContactSet


@dataclass(frozen=True)
class PartDraft(OfScene):
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
        smooth: The shape contacts by the code of their laws and friction models.
        piles: The particle contacts.
        drives: The bodies that follow functions of time, by class.
        blocks: The contacts by what lies together.
        sensors: What can be measured.
        sides: Where the surface of each contact keeps its sides apart, mesh by mesh.
        meshes: What is searched, once it is built.
        no_step: What a model has as an array; see there.
        bounces: Whether restitution is to be looked after, where it may come.
    """

    scene: Scene
    device: wp.Device
    precision: str
    types: SimpleNamespace
    layout: Layout
    arrays: SimpleNamespace
    parameters: Parameters
    groups: list[Group]
    couplings: list[CouplingSet]
    smooth: "list[ShapeContactSet]"
    piles: "list[Pile]"
    drives: list[Drive]
    blocks: Blocks
    sensors: dict[str, Sensor]
    sides: dict[Contact, list[Sides]]
    meshes: list[wp.Mesh]
    no_step: None = None
    bounces: bool = True

    @property
    def parameters_by_name(self) -> dict[str, Parameter]:
        """The parameters by their names."""
        return self.parameters.by_name

    def needs(self, envs: int, varied: Collection[str] = ()) -> list[Need]:
        """Returns what ``envs`` environments would take; ``varied`` are to have a value in each."""
        return self.layout.needs(envs) + needs_of(self.parameters.by_name, self.parameters.uploads, envs, varied)

    @beside_captures()
    def build(self, envs: int) -> Model:
        """Returns the model of ``envs`` environments; once.

        Raises:
            TypeError: If a law, a friction, a shape, a spring or a motion of a user does not compile.
        """
        # What is the library's own does, and waits for whatever launches it.
        for group in self.groups:
            group.compile(self.device)
        for contacts in self.smooth:
            contacts.compile(self.device)
        for couplings in self.couplings:
            couplings.compile(self.device)
        for pile in self.piles:
            pile.compile(self.device)
        for drive in self.drives:
            drive.compile(self.device, self.types.real)
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
            couplings=self.couplings,
            smooth=self.smooth,
            piles=self.piles,
            drives=self.drives,
            blocks=self.blocks,
            sensors=self.sensors,
            sides=self.sides,
            meshes=self.meshes,
        )


@dataclass(frozen=True)
class Draft:
    """Everything of a model, on one device or several, but the number of environments.

    Attributes:
        parts: What is drawn up for each device.
    """

    parts: tuple[PartDraft, ...]

    def shares(self, envs: int) -> list[tuple[PartDraft, int]]:
        """Returns the parts that ``envs`` environments are split over, each with how many it has."""
        return list(zip(self.parts, spread(envs, len(self.parts)), strict=False))

    def memory(self, envs: int, varied: Collection[str] = (), **stepping: Any) -> Footprint:
        """Returns what ``envs`` environments would take, and a simulation that steps them.

        Args:
            envs: Number of environments.
            varied: Names of the parameters that are to have a value per environment.
            stepping: Options of the simulation, see ``stepping_footprint``.
        """
        shares = self.shares(envs)
        model = total(Footprint(own, str(part.device), tuple(part.needs(own, varied))) for part, own in shares)
        return model.with_needs(stepping_footprint(shares, varied=varied, **stepping).needs)

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
