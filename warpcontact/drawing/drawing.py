"""Renderer-independent data of a drawing: figures, curves and contact forces over time."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpcontact.validation.checks import Array


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangle mesh in its own frame.

    Attributes:
        vertices: Positions, (V, 3) [m].
        faces: Vertex indices, (F, 3), counter-clockwise as seen from outside.
        colors: RGB of each face, (F, 3) in 0…1; ``None``: the color of the figure.
        normals: Vertex normals, (V, 3), for smooth shading; ``None``: flat shading.
    """

    vertices: Array
    faces: NDArray[np.int32]
    colors: Array | None = None
    normals: Array | None = None


@dataclass(frozen=True, eq=False)
class Figure:
    """Copies of one shape, placed in each record of each environment.

    Arrays of poses are (time, env, item, …); the size of time is 1 for static figures.

    Attributes:
        name: Name of the scene element.
        kind: ``"surface"``, ``"sphere"``, ``"shape"``, ``"plane"`` (a part of an infinite plane) or ``"point"``.
        shape: Shape that is placed.
        color: RGB in 0…1.
        positions: Origins of the frame of the shape, (time, env, item, 3), world [m].
        orientations: Rotations from shape to world, (time, env, item, 4), x, y, z, w.
        scales: Factors along the axes of the shape, (env, item, 3).
        present: Whether an item exists in an environment, (env, item).
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
    """Moving polyline: a spring, a rope, a catenary.

    Attributes:
        name: Name of the coupling.
        color: RGB in 0…1.
        points: Points, (time, env, n, 3), world [m].
        shown: Visibility, (time, env); false for broken couplings.
    """

    name: str
    color: Array
    points: Array
    shown: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Contact points of a contact, with the forces on the body of the points.

    Attributes:
        name: Name of the contact.
        color: RGB of the arrows in 0…1.
        points: Points K where the forces act, (time, env, item, 3), world [m].
        forces: Forces on the body of the points, (time, env, item, 3), world [N]; zero without contact.
        gaps: Signed distances, (time, env, item) [m], NaN if unknown or large; ``None``: not recorded.
    """

    name: str
    color: Array
    points: Array
    forces: Array
    gaps: Array | None


@dataclass(frozen=True, eq=False)
class Drawing:
    """Drawing of the selected environments of a recording, Z up. Created by ``drawing_of``.

    Attributes:
        times: Simulated time of each record, (time,) [s].
        envs: Numbers of the environments, in the order of the arrays.
        figures: Bodies and surfaces.
        curves: Couplings.
        contact_forces: Contacts whose normal force, normal and point were recorded.
        size: Size of the drawing, the length of the largest body [m]; unit of arrow and line widths.
        force_scale: Arrow length per force [m/N], which draws the largest force at 1.5 times ``size``.
    """

    times: Array
    envs: list[int]
    figures: list[Figure]
    curves: list[Curve]
    contact_forces: list[ContactForces]
    size: float
    force_scale: float
