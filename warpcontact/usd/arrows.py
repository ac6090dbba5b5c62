"""Force arrows of a stage: a shaft and a head each, as instances of a cylinder and a cone."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from warpcontact.algebra.poses import shortest_rotations
from warpcontact.drawing.forces import ForceLines
from warpcontact.usd.author import Samples, integers, long_integers, quaternions, vectors
from warpcontact.usd.geometry import set_color
from warpcontact.validation.checks import Array

# Radius of a shaft, as a multiple of the drawing size. Radius and length of a head, in shaft radii.
SHAFT = 0.012
HEAD = 2.5
HEAD_LENGTH = 7.0
# Largest length of the head, as a fraction of the arrow. Shorter arrows are scaled down.
MAX_HEAD = 0.5


def define_arrows(stage: Any, path: str, count: int, color: ArrayLike, meaning: str, scale: float) -> None:
    """Defines an instancer of arrows with everything that does not change over time.

    Args:
        stage: Stage to write to.
        path: Path of the new prim.
        count: Number of arrows.
        color: RGB in 0…1.
        meaning: Description of the forces, a sentence.
        scale: Arrow length per force [m/N].
    """
    from pxr import UsdGeom

    arrows = UsdGeom.PointInstancer.Define(stage, path)
    shaft, head = UsdGeom.Cylinder.Define(stage, f"{path}/shaft"), UsdGeom.Cone.Define(stage, f"{path}/head")
    for part in (shaft, head):
        part.CreateRadiusAttr(1.0)
        part.CreateHeightAttr(1.0)
        part.CreateAxisAttr(UsdGeom.Tokens.z)
        part.CreateExtentAttr(vectors(np.array([[-1.0, -1.0, -0.5], [1.0, 1.0, 0.5]])))
        set_color(part, color)
    arrows.CreatePrototypesRel().SetTargets([shaft.GetPath(), head.GetPath()])
    arrows.CreateProtoIndicesAttr(integers(np.repeat([0, 1], count)))
    arrows.CreateIdsAttr(long_integers(np.arange(2 * count)))
    arrows.GetPrim().SetDocumentation(f"{meaning} {scale:g} m for 1 N. Shafts come first, then heads.")


def write_arrows(prim: Any, samples: Samples, lines: ForceLines, row: int, scale: float, size: float) -> None:
    """Writes the arrows of environment ``row`` of the export, ``scale`` m/N long; hidden where the force is 0."""
    from pxr import UsdGeom

    start, vector = lines.start[:, row], scale * lines.force[:, row]
    poses, hidden = _shapes(start, vector, SHAFT * size)
    positions, orientations, scales = poses
    arrows = UsdGeom.PointInstancer(prim)
    samples.write(arrows.CreatePositionsAttr(), [vectors(frame) for frame in positions])
    samples.write(arrows.CreateOrientationsfAttr(), [quaternions(frame) for frame in orientations])
    samples.write(arrows.CreateScalesAttr(), [vectors(frame) for frame in scales])
    masked = [long_integers(np.flatnonzero(frame)) for frame in hidden]
    samples.write(arrows.CreateInvisibleIdsAttr(), masked)
    # Heads rotate; this is the half-diagonal of the bounding square of a head.
    reach = math.sqrt(2.0) * HEAD * SHAFT * size
    ends = np.concatenate([start, start + vector], axis=1)
    extents = np.stack([ends.min(axis=1) - reach, ends.max(axis=1) + reach], axis=1)
    samples.write(arrows.CreateExtentAttr(), [vectors(frame) for frame in extents])


def _shapes(start: Array, vector: Array, radius: float) -> tuple[tuple[Array, Array, Array], Array]:
    """Returns positions, orientations and scales of shafts and heads, (time, 2 n, …), and which are hidden.

    Args:
        start: Starting points of the arrows, world, (time, n, 3) [m].
        vector: Vectors from start to tip, world, (time, n, 3) [m].
        radius: Shaft radius of an arrow that is not scaled down [m].
    """
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    hidden = length <= 0.0
    along = np.where(hidden, (0.0, 0.0, 1.0), vector / np.where(hidden, 1.0, length))
    shrunk = np.where(hidden, 1.0, np.minimum(1.0, MAX_HEAD * length / (HEAD_LENGTH * radius)))
    head = shrunk * HEAD_LENGTH * radius
    shaft = np.where(hidden, 1.0, length - head)
    middles = np.concatenate([start + 0.5 * shaft * along, start + (shaft + 0.5 * head) * along], axis=1)
    width = shrunk * radius
    shafts = np.concatenate([width, width, shaft], axis=-1)
    heads = np.concatenate([HEAD * width, HEAD * width, head], axis=-1)
    scales = np.concatenate([shafts, heads], axis=1)
    orientations = shortest_rotations((0.0, 0.0, 1.0), along)
    both = np.concatenate([hidden, hidden], axis=1)
    # Hidden arrows are equal in all frames, so that files store them once.
    return (np.where(both, 0.0, middles), np.concatenate([orientations, orientations], axis=1), scales), both[
        ..., 0
    ]
