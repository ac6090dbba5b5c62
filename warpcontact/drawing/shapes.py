"""Analytic shapes on single bodies and on sets of bodies."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from warpcontact.algebra.vectors import product, transform_points
from warpcontact.drawing.replay import Replay
from warpcontact.drawing.spheres import body_color
from warpcontact.kernels import shapes
from warpcontact.kernels.shapes.base import Plane
from warpcontact.kernels.shapes.parametric_surface import ParametricSurface
from warpcontact.scene.shapes import Shape, tessellate
from warpcontact.validation.checks import Array

# Half the side of the square that represents a plane, as a multiple of the size.
PLANE = 10.0


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
        self.turns = product(orientations, turns)
        # One prototype per distinct size; spheres and ellipsoids are scaled from a unit sphere.
        sizes = placement.sizes
        self.scaled = issubclass(placement.shape.kind, shapes.Sphere | shapes.Ellipsoid)
        shape = placement.positions.shape[:2]
        rows = np.concatenate([values.reshape(*shape, -1) for values in sizes.values()], axis=-1)
        flat = rows.reshape(shape[0] * shape[1], -1)
        _, self.first, numbers = np.unique(flat, axis=0, return_index=True, return_inverse=True)
        self.numbers = numbers.reshape(shape)
