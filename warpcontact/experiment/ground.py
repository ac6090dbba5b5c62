"""The surfaces of the world in the picture of a run: seen from above, or cut by the plane of the tracks."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from warpcontact.checks import Array
from warpcontact.frames import placed
from warpcontact.recorder import Recording
from warpcontact.scene import Surface
from warpcontact.smooth.elements import Shape
from warpcontact.smooth.tessellate import tessellate

# Direction of the light on the ground, from the upper left.
LIGHT = np.array([-0.5, 0.5, 0.7]) / np.linalg.norm([-0.5, 0.5, 0.7])
# What grey is multiplied with, red, green and blue, where faces are active and where not: no track is so coloured.
ACTIVE, INACTIVE = np.array([1.0, 1.0, 1.0]), np.array([0.62, 0.90, 0.92])
# Grey of patches in the legend.
SAMPLE = 0.72
# Colours of sections: thin lines need more of it.
ACTIVE_LINE, INACTIVE_LINE = (0.45, 0.45, 0.45), (0.15, 0.72, 0.76)


@dataclass(frozen=True)
class Ground:
    """A surface of the world as it is in the first environment of a recording.

    Attributes:
        corners: Corners of its faces, (F, 3, 3) [m].
        active: Mask (F,) of those that can touch.
        shared: Whether it is the same in all environments.
    """

    corners: Array
    active: NDArray[np.bool_]
    shared: bool

    @classmethod
    def of(cls, recording: Recording, surface: Surface) -> "Ground":
        """Returns ``surface`` with pose, scale and mesh as recorded, or else as in the scene."""
        first: dict[str, Any] = {
            "position": surface.position,
            "orientation": surface.orientation,
            "scale": surface.scale,
            "mesh": 0,
        }
        shared = True
        for key in first:
            if (recorded := recording.get(f"{surface.name}.{key}")) is not None:
                values = recorded.transpose("env", ...).values
                first[key] = values[0]
                shared &= bool((values == values[:1]).all())
        which = int(first["mesh"])
        mesh = surface.meshes[which]
        vertices = placed(first["scale"] * mesh.vertices, first["position"], first["orientation"])
        return cls(vertices[mesh.faces], surface.active[which], shared)

    @classmethod
    def of_shape(cls, recording: Recording, shape: Shape, reach: float) -> "Ground":
        """Returns ``shape`` with pose and sizes as recorded, or else as in the scene.

        ``reach`` is how far from the world's origin the square that is drawn of a half-space goes at least [m].
        """
        first = {"position": shape.positions[0], "orientation": shape.orientations[0]}
        first |= {key: values[0] for key, values in shape.sizes.items()}
        shared = True
        for key in first:
            if (recorded := recording.get(f"{shape.name}.{key}")) is not None:
                values = recorded.transpose("env", ...).values
                first[key] = values[0]
                shared &= bool((values == values[:1]).all())
        position, orientation = first.pop("position"), first.pop("orientation")
        vertices, faces = tessellate(shape.kind, first, reach + float(np.linalg.norm(position)))
        return cls(placed(vertices, position, orientation)[faces], np.ones(len(faces), dtype=bool), shared)


def grounds_of(recording: Recording, reach: float) -> list[Ground]:
    """Returns the visible surfaces and shapes of the world, lower ones first; for ``reach`` see ``of_shape``."""
    scene = recording.scene
    fixed = [surface for surface in scene.surfaces if surface.body is None and surface.visible]
    shapes = [shape for shape in scene.shapes if shape.body is None and shape.visible]
    grounds = [Ground.of(recording, surface) for surface in fixed]
    grounds += [Ground.of_shape(recording, shape, reach) for shape in shapes]
    return sorted(grounds, key=lambda ground: float(ground.corners[..., 2].mean()))


def draw_from_above(axes: Any, ground: Ground, lower: Array, upper: Array) -> None:
    """Draws the faces within a window, lower ones first, grey by height and by their slope to the light.

    Args:
        axes: Where to draw.
        ground: What to draw.
        lower: Lower left corner of the window, x and y [m].
        upper: Upper right corner.
    """
    low, high = ground.corners[..., :2].min(axis=1), ground.corners[..., :2].max(axis=1)
    near = (high >= lower).all(axis=1) & (low <= upper).all(axis=1)
    corners, active = ground.corners[near], ground.active[near]
    if not len(corners):
        return
    height = corners[..., 2].mean(axis=1)
    order = np.argsort(height)
    corners, active, height = corners[order], active[order], height[order]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # Seen from above whatever its outer side.
    normal *= np.where(normal[:, 2:] < 0.0, -1.0, 1.0)
    level = (height - height[0]) / max(float(height[-1] - height[0]), 1.0e-9)
    grey = np.clip(0.45 + 0.25 * level + 0.35 * (normal @ LIGHT - LIGHT[2]) + 0.2, 0.0, 1.0)
    tint = np.where(active[:, None], ACTIVE, INACTIVE)
    polygons = PolyCollection(list(corners[..., :2]), facecolors=grey[:, None] * tint, edgecolors="face")
    # Smoothed edges would leave a seam between neighbours.
    polygons.set(linewidth=0.5, antialiased=False)
    axes.add_collection(polygons)


def draw_section(axes: Any, ground: Ground, y: float) -> None:
    """Draws where the plane at ``y`` [m] cuts a surface."""
    corners = ground.corners
    # Not through vertices and along edges.
    y += 1.0e-6 * float(np.ptp(corners[..., 1]) or 1.0)
    side = corners[..., 1] > y
    cut = side.any(axis=1) & ~side.all(axis=1)
    corners, side, active = corners[cut], side[cut], ground.active[cut]
    if not len(corners):
        return
    ends = np.roll(corners, -1, axis=1)
    crossing = side != np.roll(side, -1, axis=1)  # two of the three edges
    start, end = corners[crossing], ends[crossing]
    part = (y - start[:, 1]) / (end[:, 1] - start[:, 1])
    points = (start + part[:, None] * (end - start))[:, [0, 2]]
    colors = np.where(active[:, None], ACTIVE_LINE, INACTIVE_LINE)
    axes.add_collection(LineCollection(list(points.reshape(-1, 2, 2)), colors=colors, linewidths=2.0, zorder=0))


def legend_entries(from_above: bool) -> list[Any]:
    """Returns the entries of a legend that tell active faces from others."""
    labels = "active faces", "inactive faces, which cannot touch"
    if from_above:
        tints = zip((ACTIVE, INACTIVE), labels, strict=True)
        return [Patch(facecolor=SAMPLE * tint, edgecolor="0.3", lw=0.5, label=label) for tint, label in tints]
    colors = zip((ACTIVE_LINE, INACTIVE_LINE), labels, strict=True)
    return [Line2D([], [], color=color, lw=2.0, label=label) for color, label in colors]
