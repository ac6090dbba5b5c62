"""Layout of a stage: paths of prims and positions of environments."""

import math
from dataclasses import dataclass

from warpcontact.drawing.body_sets import CENTRES, BodySet
from warpcontact.drawing.shapes import ShapePlacement
from warpcontact.drawing.surfaces import Placement
from warpcontact.scene.elements import Body
from warpcontact.validation.checks import Array

WORLD = "/World"
#: Class prim that environments refer to.
PROTOTYPE = f"{WORLD}/Prototype"
#: Class prim with the surface meshes that differ between environments.
SHAPES = f"{WORLD}/Shapes"
ENSEMBLE = f"{WORLD}/Ensemble"
#: Names of children of an environment or body that elements must not take.
RESERVED = (
    "contacts",
    "couplings",
    "joints",
    "FixedPoints",
    "PhysicsMaterials",
    "PhysicsScene",
    "Surfaces",
    CENTRES,
)


@dataclass(frozen=True)
class Layout:
    """Layout of a stage.

    Attributes:
        names: Prim names by element name.
        envs: Numbers of the environments.
        spacing: Grid spacing of environments along x and y [m]; 0: all in place.
        size: Size of the drawing, the length of the largest body [m].
        force_scale: Arrow length per force [m/N].
        own_surfaces: Names of surfaces and shapes that have one prim per environment, because they differ.
    """

    names: dict[str, str]
    envs: list[int]
    spacing: Array
    size: float
    force_scale: float
    own_surfaces: frozenset[str]

    @property
    def apart(self) -> bool:
        """Whether environments are spread on a grid."""
        return bool(self.spacing.any())

    @property
    def surfaces(self) -> str:
        """Path of the surfaces fixed to the world and common to all environments."""
        return f"{PROTOTYPE if self.apart else WORLD}/Surfaces"

    def place(self, row: int) -> tuple[float, float, float]:
        """Returns the position of an environment on the grid [m]; the first is at the origin."""
        x, y = self.spacing.tolist()
        count = len(self.envs)
        columns = count if y == 0.0 else 1 if x == 0.0 else math.ceil(math.sqrt(count))
        return row % columns * x, row // columns * y, 0.0

    def env(self, row: int) -> str:
        """Returns the path of environment ``row`` of the export."""
        return f"{WORLD}/env_{self.envs[row]}"

    def body(self, env: str, body: Body | None) -> str:
        """Returns the path of a body, or, for ``None``, of the scope of points fixed to the world."""
        return f"{env}/{'FixedPoints' if body is None else self.names[body.name]}"

    def body_set(self, env: str, body_set: BodySet) -> str:
        """Returns the path of spheres or points on a set of bodies."""
        return f"{self.body(env, body_set.body)}/{self.names[body_set.name] if body_set.contacts else CENTRES}"

    def surface(self, env: str, placement: Placement) -> str:
        """Returns the path of a surface in an environment."""
        surface = placement.surface
        return f"{self._carrier(env, surface.body)}/{self.names[surface.name]}"

    def form(self, env: str, form: ShapePlacement) -> str:
        """Returns the path of a shape in an environment."""
        return f"{self._carrier(env, form.shape.body)}/{self.names[form.shape.name]}"

    def _carrier(self, env: str, body: Body | None) -> str:
        return f"{env}/Surfaces" if body is None else self.body(env, body)

    def contact(self, env: str, name: str) -> str:
        """Returns the path of a contact, a contact coupling or a particle contact."""
        return f"{env}/contacts/{self.names[name]}"

    def coupling(self, env: str, name: str) -> str:
        """Returns the path of a coupling."""
        return f"{env}/couplings/{self.names[name]}"

    def joint(self, env: str, body: Body) -> str:
        """Returns the path of the joint of a body."""
        return f"{env}/joints/{self.names[body.name]}"
