"""What is seen of a recording: bodies that move, surfaces, lines and forces, whatever draws them."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.scene.scene import Scene
from warpcontact.validation.checks import Array


@dataclass(frozen=True, eq=False)
class Shape:
    """A triangle mesh, in its own frame.

    Attributes:
        vertices: (V, 3) [m].
        faces: (F, 3), counter-clockwise seen from outside.
        colors: RGB of each face, (F, 3) in 0…1, instead of that of the figure; ``None``: the figure's.
        normals: Of each vertex, (V, 3), where the shape is smooth; ``None``: faces are flat.
    """

    vertices: Array
    faces: NDArray[np.int32]
    colors: Array | None = None
    normals: Array | None = None


@dataclass(frozen=True, eq=False)
class Figure:
    """Copies of one shape, placed in every record of every environment.

    Arrays of poses are (time, env, item, …), where time is 1 for what never moves.

    Attributes:
        name: Element of the scene that it shows.
        kind: ``"surface"``, ``"sphere"``, ``"shape"``, ``"plane"`` (a part of one without end) or ``"point"``.
        shape: What is placed.
        color: RGB in 0…1.
        positions: Origins of the frame of the shape, (time, env, item, 3), world [m].
        orientations: Rotations of the shape to the world, (time, env, item, 4), x, y, z, w.
        scales: Factors along the axes of the shape, (env, item, 3).
        present: Whether it is in an environment at all, (env, item).
    """

    name: str
    kind: str
    shape: Shape
    color: Array
    positions: Array
    orientations: Array
    scales: Array
    present: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Curve:
    """A polyline that moves: a spring, a rope, a catenary.

    Attributes:
        name: Coupling that it shows.
        color: RGB in 0…1.
        points: (time, env, n, 3), world [m].
        shown: Whether it is there, (time, env): a broken one is not.
    """

    name: str
    color: Array
    points: Array
    shown: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ContactForces:
    """The points of a contact, with the forces that act on their body.

    Attributes:
        name: The contact.
        color: RGB in 0…1, of the arrows.
        points: Where the force acts, (time, env, item, 3), world [m].
        forces: On the body of the points, (time, env, item, 3), world [N]; zero where there is none.
        gaps: Signed distances, (time, env, item) [m], NaN where unknown or far; ``None``: not recorded.
    """

    name: str
    color: Array
    points: Array
    forces: Array
    gaps: Array | None


@dataclass(frozen=True, eq=False)
class Drawing:
    """All that is seen of the chosen environments of a recording, Z up.

    Attributes:
        times: Simulated time of each record, (time,) [s].
        envs: Numbers of the environments, in the order of the arrays.
        figures: Bodies and surfaces.
        curves: Couplings.
        contact_forces: Contacts of which force, normal and point were recorded.
        size: Length of the largest body [m], to draw arrows and widths by.
        force_scale: Metres per newton that draw the largest force at 1.5 times ``size``.
    """

    times: Array
    envs: list[int]
    figures: list[Figure]
    curves: list[Curve]
    contact_forces: list[ContactForces]
    size: float
    force_scale: float

    @classmethod
    def of(
        cls, recording: xr.Dataset, scene: Scene | None = None, envs: int | Iterable[int] | None = None
    ) -> "Drawing":
        """Returns what is seen of some environments of a recording; arguments and errors as of ``drawing_of``."""
        from warpcontact.drawing.draw import drawing_of

        return drawing_of(recording, scene, envs)
