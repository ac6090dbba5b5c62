"""Geometry in each environment: contact points, surfaces, shapes, and sets of bodies; sizes and colors of bodies."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpcontact.algebra.vectors import quat_multiply, transform_points
from warpcontact.drawing.replay import Replay
from warpcontact.kernels import shapes
from warpcontact.kernels.shapes.base import Plane
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface
from warpcontact.scene.elements import Body, Contact, Surface
from warpcontact.scene.scene_data import SceneData
from warpcontact.scene.shapes import Shape, tessellate
from warpcontact.validation.checks import Array

WORLD_COLOR = (0.55, 0.55, 0.5)
BODY_COLOR = (0.35, 0.5, 0.7)

# Brightness of inactive faces.
INACTIVE = 0.4

# Half the side of the square that represents a plane, as a multiple of the size.
PLANE = 10.0

#: Name used for the centers of mass of a set without contacts.
CENTRES = "centres"


@dataclass(frozen=True)
class Spheres:
    """Spheres or points shared by one or several contacts.

    Attributes:
        contacts: Contacts with the same points and radii.
        radii: Radii, (env, item) [m]; all zero: points.
        places: Centers in the frame of the body, (env, item, 3) [m].
    """

    contacts: list[Contact]
    radii: Array
    places: Array

    @property
    def name(self) -> str:
        """Name of the first contact."""
        return self.contacts[0].name

    @property
    def body(self) -> Body | None:
        """Body of the points; ``None``: the world."""
        return self.contacts[0].points.body

    @property
    def are_points(self) -> bool:
        """Whether all radii are zero."""
        return not self.radii.any()

    def differs(self, row: int) -> bool:
        """Returns whether radii or positions in environment ``row`` differ from those in the first one."""
        return bool((self.radii[row] != self.radii[0]).any() or (self.places[row] != self.places[0]).any())


def find_spheres(replay: Replay) -> list[Spheres]:
    """Returns the spheres and points of all contacts, without duplicates."""
    found: dict[tuple[str, bytes], Spheres] = {}
    for contact in replay.scene.contacts:
        radii = replay.radii(contact)
        key = (contact.points.name, radii.tobytes())
        if key not in found:
            found[key] = Spheres([], radii, replay.places(contact.points))
        found[key].contacts.append(contact)
    return list(found.values())


def body_size(body: Body, placements: Iterable["Placement"], spheres: Iterable[Spheres]) -> float:
    """Returns twice the largest distance of a body's surfaces and spheres from its center of mass [m]."""
    reach = [placement.reach for placement in placements if placement.surface.body is body]
    reach += [
        float((np.linalg.norm(group.places, axis=-1) + group.radii).max())
        for group in spheres
        if group.body is body
    ]
    return 2.0 * max(reach, default=0.0)


def scene_size(replay: Replay, placements: Sequence["Placement"], spheres: Sequence[Spheres]) -> float:
    """Returns the size of the drawing [m]: that of the largest body, or a tenth of the occupied space."""
    bodies = replay.scene.bodies
    largest = max((body_size(body, placements, spheres) for body in bodies), default=0.0)
    if largest > 0.0:
        return largest
    places = [replay.pose(body)[0].reshape(-1, 3) for body in bodies]
    places += [placement.corners for placement in placements]
    if not places:
        return 1.0
    return 0.1 * float(np.linalg.norm(np.ptp(np.concatenate(places), axis=0))) or 1.0


def body_color(body: Body | None) -> NDArray[np.float64]:
    """Returns the color of the geometry on a body, RGB in 0…1; ``None``: the world."""
    if body is None:
        return np.array(WORLD_COLOR)
    return np.array(BODY_COLOR) if body.color is None else body.color


@dataclass(frozen=True)
class Placement:
    """Surface in the environments of a replay.

    Attributes:
        surface: Surface element.
        position: Origin of the surface frame in the carrier frame, (env, 3) [m].
        orientation: Rotation from surface to carrier frame, (env, 4), x, y, z, w.
        scale: Scale factor, (env,).
        mesh: Index of the mesh, (env,).
    """

    surface: Surface
    position: Array
    orientation: Array
    scale: Array
    mesh: Array

    @classmethod
    def of(cls, replay: Replay, surface: Surface) -> "Placement":
        """Returns the surface as recorded, or as in the scene."""
        return cls(surface, *replay.pose_of(surface), replay.setting(f"{surface.name}.mesh", np.zeros(())))

    @property
    def reach(self) -> float:
        """Largest distance from the origin of the carrier [m]."""
        # The rotation does not change the distance of the vertices from the origin of the surface frame.
        far = np.array([np.linalg.norm(mesh.vertices, axis=1).max() for mesh in self.surface.meshes])
        return float((self.scale * far[self.mesh.astype(int)] + np.linalg.norm(self.position, axis=1)).max())

    @property
    def corners(self) -> Array:
        """Corners of the mesh bounding boxes of all environments in the carrier frame, (n, 3) [m]."""
        bounds = np.array([mesh.bounds for mesh in self.surface.meshes])[self.mesh.astype(int)]
        box = np.stack([bounds[:, [i, j, k], [0, 1, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)], axis=1)
        return transform_points(self.scale[:, None, None] * box, self.position, self.orientation).reshape(-1, 3)

    @property
    def shared(self) -> bool:
        """Whether the surface is the same in all environments."""
        return all(
            (values == values[:1]).all() for values in (self.position, self.orientation, self.scale, self.mesh)
        )


def surface_color(surface: Surface) -> Array:
    """Returns the color of the active faces of a surface, RGB in 0…1."""
    return body_color(surface.body) if surface.color is None else surface.color


@dataclass(frozen=True)
class ShapePlacement:
    """Shape, or set of shapes, in the environments of a replay; arrays are (env, item, …).

    Attributes:
        shape: Shape element.
        positions: Origins of the shape frames in the carrier frames [m].
        orientations: Rotations from shape to carrier frames, x, y, z, w.
        sizes: Shape parameters by name.
    """

    shape: Shape
    positions: Array
    orientations: Array
    sizes: dict[str, Array]

    @classmethod
    def of(cls, replay: Replay, shape: Shape) -> "ShapePlacement":
        """Returns the shape as recorded, or as in the scene."""

        def setting(key: str, default: Array) -> Array:
            found = replay.setting(f"{shape.name}.{key}", default[0] if shape.single else default)
            return found[:, None] if shape.single else found

        return cls(
            shape,
            setting("position", shape.positions),
            setting("orientation", shape.orientations),
            {key: setting(key, values) for key, values in shape.sizes.items()},
        )

    @property
    def shared(self) -> bool:
        """Whether the shape is the same in all environments."""
        arrays = (self.positions, self.orientations, *self.sizes.values())
        return all(bool((values == values[:1]).all()) for values in arrays)

    @property
    def reach(self) -> float:
        """Largest distance from the origin of the carrier in any environment [m]; 0 for a plane."""
        if issubclass(self.shape.kind, Plane):
            return 0.0
        far = [np.linalg.norm(tessellate(self.shape.kind, sizes)[0], axis=1).max() for sizes in self._largest()]
        return float(max(far) + np.linalg.norm(self.positions, axis=-1).max())

    def _largest(self) -> Iterator[dict[str, Array]]:
        """Iterates over parameter sets, one of which has the largest reach."""
        kind = self.shape.kind
        lengths = {key for key in self.sizes if kind.limits(key)["unit"] == "m"}
        if issubclass(kind, ParametricSurface):
            lengths = set()
        most = {key: self.sizes[key].max(axis=(0, 1)) for key in lengths}
        others = [key for key in self.sizes if key not in lengths]
        count = self.positions.shape[0] * self.positions.shape[1]
        rows = [self.sizes[key].reshape(count, -1) for key in others]
        _, first = np.unique(np.concatenate([np.zeros((count, 1)), *rows], axis=1), axis=0, return_index=True)
        for number in first.tolist():
            own = self.item_sizes(*divmod(number, self.positions.shape[1]))
            yield {key: most.get(key, value) for key, value in own.items()}

    def item_sizes(self, row: int, item: int) -> dict[str, Array]:
        """Returns the parameters of one shape in environment ``row``."""
        return {key: values[row, item] for key, values in self.sizes.items()}

    @property
    def color(self) -> Array:
        """Color of the shape, RGB in 0…1."""
        return body_color(self.shape.body) if self.shape.color is None else self.shape.color


class ShapeSet:
    """Shapes on the bodies of a set: poses over time, and grouping by size.

    Args:
        placement: The shapes.
        poses: Positions (time, env, item, 3) and orientations of the bodies.

    Attributes:
        placement: The shapes.
        places: Origins of the shapes, (time, env, item, 3), world [m].
        turns: Rotations from shape to world, (time, env, item, 4), x, y, z, w.
        scaled: Whether all items are scaled from one prototype.
        first: Flat index (env, item) of the first item of each distinct size.
        numbers: Index of the size of each item, (env, item).
    """

    def __init__(self, placement: ShapePlacement, poses: tuple[Array, Array]) -> None:
        self.placement = placement
        positions, orientations = poses
        self.places = transform_points(placement.positions[..., None, :], positions, orientations)[..., 0, :]
        turns = np.broadcast_to(placement.orientations, orientations.shape)
        self.turns = quat_multiply(orientations, turns)
        # One prototype per distinct size; spheres and ellipsoids are scaled from a unit sphere.
        sizes = placement.sizes
        self.scaled = issubclass(placement.shape.kind, shapes.Sphere | shapes.Ellipsoid)
        shape = placement.positions.shape[:2]
        rows = np.concatenate([values.reshape(*shape, -1) for values in sizes.values()], axis=-1)
        flat = rows.reshape(shape[0] * shape[1], -1)
        _, self.first, numbers = np.unique(flat, axis=0, return_index=True, return_inverse=True)
        self.numbers = numbers.reshape(shape)


@dataclass(frozen=True)
class BodySet:
    """Spheres or points, one on each body of a set.

    Attributes:
        body: Set of bodies.
        name: Name of their first contact; ``"centres"``: centers of mass of a set without contacts.
        contacts: Names of their contacts.
        places: Centers, (time, env, item, 3), world [m].
        radii: Radii, (env, item) [m]; all zero: points.
    """

    body: Body
    name: str
    contacts: list[str]
    places: Array
    radii: Array

    @property
    def are_points(self) -> bool:
        """Whether all radii are zero."""
        return not self.radii.any()


def body_sets_of(
    scene: SceneData, spheres: Sequence[Spheres], poses: Mapping[str, tuple[Array, Array]]
) -> list[BodySet]:
    """Returns the spheres and points on all sets of bodies.

    Args:
        scene: Scene of the recording.
        spheres: Spheres and points of all contacts.
        poses: Positions and orientations of the bodies by name.
    """
    found = []
    for body in scene.bodies:
        if body.single:
            continue
        positions, orientations = poses[body.name]
        groups = [group for group in spheres if group.body is body]
        for group in groups:
            places = transform_points(group.places[..., None, :], positions, orientations)[..., 0, :]
            found.append(BodySet(body, group.name, [one.name for one in group.contacts], places, group.radii))
        if not groups:
            found.append(BodySet(body, CENTRES, [], positions, np.zeros(positions.shape[1:3])))
    return found
