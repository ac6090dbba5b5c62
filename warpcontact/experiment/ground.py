"""Draws the fixed surfaces and shapes in the picture of a run: a relief from above, or a section along the tracks."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from warpcontact.algebra.vectors import transform_points
from warpcontact.meshes.topology import area_vectors
from warpcontact.scene.elements import Surface
from warpcontact.scene.shapes import Shape, tessellate
from warpcontact.stepping.recording import Recording
from warpcontact.validation.checks import Array

# Gray of the lowest and the highest faces, and the darkening of vertical ones.
DARKEST, LIGHTEST, STEEP = 0.46, 0.92, 0.3
# A height span below this fraction of the width counts as level.
LEVEL = 1.0e-6
# Faces whose normal has a vertical component below this fraction of the horizontal one count as upright.
UPRIGHT = 1.0e-2
# Approximate maximum number of contours, their color, the color of height labels, and the smallest distance between
# labels in widths of the window.
CONTOURS, CONTOUR, HEIGHT, APART = 8, (0.0, 0.0, 0.0, 0.35), (0.0, 0.0, 0.0, 0.75), 0.05
# Factors of red, green and blue on the gray of active and inactive faces: colors that tracks do not have.
ACTIVE, INACTIVE = np.array([1.0, 1.0, 1.0]), np.array([0.62, 0.90, 0.92])
# Gray of patches in the legend.
SAMPLE = 0.72
# Colors of sections, more saturated because lines are thin.
ACTIVE_LINE, INACTIVE_LINE = (0.45, 0.45, 0.45), (0.15, 0.72, 0.76)


@dataclass(frozen=True)
class GroundSurface:
    """A fixed surface, as in the first environment of a recording.

    Attributes:
        corners: Vertices of its faces (F, 3, 3), world frame [m].
        active: Mask (F,) of the active faces.
        shared: Whether the surface is the same in all environments.
    """

    corners: Array
    active: NDArray[np.bool_]
    shared: bool

    @classmethod
    def of(cls, recording: Recording, surface: Surface) -> "GroundSurface":
        """Returns ``surface`` with pose, scale and mesh as recorded, otherwise as in the scene."""
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
        vertices = transform_points(first["scale"] * mesh.vertices, first["position"], first["orientation"])
        return cls(vertices[mesh.faces], surface.active[which], shared)

    @classmethod
    def of_shape(cls, recording: Recording, shape: Shape, reach: float) -> "GroundSurface":
        """Returns ``shape`` with pose and sizes as recorded, otherwise as in the scene.

        A half-space is drawn as a square that extends at least ``reach`` from the origin of the world [m].
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
        return cls(
            transform_points(vertices, position, orientation)[faces], np.ones(len(faces), dtype=bool), shared
        )


def ground_surfaces(recording: Recording, reach: float) -> list[GroundSurface]:
    """Returns the visible surfaces and shapes of the world, from low to high; for ``reach`` see ``of_shape``."""
    scene = recording.scene
    fixed = [surface for surface in scene.surfaces if surface.body is None and surface.visible]
    shapes = [shape for shape in scene.shapes if shape.body is None and shape.visible]
    grounds = [GroundSurface.of(recording, surface) for surface in fixed]
    grounds += [GroundSurface.of_shape(recording, shape, reach) for shape in shapes]
    return sorted(grounds, key=lambda ground: float(ground.corners[..., 2].mean()))


def contour_step(grounds: list[GroundSurface], lower: Array, upper: Array) -> float:
    """Returns the height between contours [m]: 1, 2 or 5 times a power of ten; 0 if all faces in a window are level.

    Args:
        grounds: The surfaces.
        lower: Lower left corner of the window, x and y [m].
        upper: Upper right corner of the window.
    """
    inclined = [_contoured(ground.corners[_within(ground, lower, upper)]) for ground in grounds]
    heights = np.concatenate([np.zeros(0), *(corners[..., 2].ravel() for corners in inclined)])
    span = float(np.ptp(heights)) if len(heights) else 0.0
    if span <= LEVEL * float(np.max(upper - lower)):
        return 0.0
    power = 10.0 ** np.floor(np.log10(span / CONTOURS))
    return float(min(power * nice for nice in (1.0, 2.0, 5.0, 10.0) if power * nice >= span / CONTOURS))


def draw_from_above(axes: Any, ground: GroundSurface, lower: Array, upper: Array, step: float) -> None:
    """Draws the faces within a window as a relief, from low to high, with contours of their height.

    Faces are lighter the higher they are above the mean plane of all, and darker the steeper they are relative to it.
    A directional light would hide ridges along its direction, and the inclination of the mean plane the shape.

    Args:
        axes: Axes of Matplotlib.
        ground: The surface.
        lower: Lower left corner of the window, x and y [m].
        upper: Upper right corner of the window.
        step: Height between contours [m]; 0: no contours.
    """
    in_window = _within(ground, lower, upper)
    corners, active = ground.corners[in_window], ground.active[in_window]
    if not len(corners):
        return
    order = np.argsort(corners[..., 2].mean(axis=1))
    corners, active = corners[order], active[order]
    tint = np.where(active[:, None], ACTIVE, INACTIVE)
    polygons = PolyCollection(
        list(corners[..., :2]), facecolors=relief_greys(corners)[:, None] * tint, edgecolors="face"
    )
    # Antialiasing would leave seams between neighboring faces.
    polygons.set(linewidth=0.5, antialiased=False)
    axes.add_collection(polygons)
    if step > 0.0:
        _draw_contours(axes, corners, lower, upper, step)


def _draw_contours(axes: Any, corners: Array, lower: Array, upper: Array, step: float) -> None:
    """Draws contours of faces (n, 3, 3), each with one label that does not overlap others."""
    corners = _contoured(corners)
    written: list[Array] = []
    if not len(corners):
        return
    low, high = float(corners[..., 2].min()), float(corners[..., 2].max())
    for level in step * np.arange(np.floor(low / step), np.ceil(high / step) + 1.0):
        lines = _cut(corners, 2, level)[0][..., :2]
        axes.add_collection(LineCollection(list(lines), colors=CONTOUR, linewidths=0.5, zorder=1))
        # Relative to the window, excluding a margin.
        positions = (lines.mean(axis=1) - lower) / (upper - lower)
        positions = positions[(np.abs(positions - 0.5) < 0.45).all(axis=1)]
        for other in written:
            positions = positions[np.linalg.norm(positions - other, axis=1) > APART]
        if len(positions):
            written.append(positions[np.argmin(np.linalg.norm(positions - 0.5, axis=1))])
            x, y = lower + written[-1] * (upper - lower)
            # In front of tracks and dots, with a white outline.
            edge = [withStroke(linewidth=1.5, foreground="white")]
            layout = {"ha": "center", "va": "center", "zorder": 4}
            axes.text(x, y, f"{level:.10g}", fontsize=7, color=HEIGHT, path_effects=edge, **layout)


def relief_greys(corners: Array) -> Array:
    """Returns the grays of faces viewed from above, (n,) in 0…1, from their vertices (n, 3, 3) [m]."""
    middle = corners.mean(axis=1)
    middle = middle - middle.mean(axis=0)
    normal = area_vectors(corners)
    # Weighted by the projected areas, which are zero for vertical faces.
    projected = np.abs(normal[:, 2])
    weight = np.sqrt(projected / (projected.max() or 1.0))
    plane = np.stack([middle[:, 0], middle[:, 1], np.ones(len(middle))], axis=1)
    slopes = np.linalg.lstsq(weight[:, None] * plane, weight * middle[:, 2])[0]
    height = middle[:, 2] - plane @ slopes
    span = float(np.ptp(height))
    # Ignore rounding errors of plane surfaces.
    relief = span > LEVEL * float(np.ptp(middle, axis=0).max())
    level = (height - height.min()) / span if relief else np.full(len(height), 0.5)
    upright = np.array([-slopes[0], -slopes[1], 1.0]) / np.linalg.norm([*slopes[:2], 1.0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1.0e-300)
    # Sine of the angle to the mean normal, independent of the orientation of a face.
    sine = np.sqrt(np.clip(1.0 - (normal @ upright) ** 2, 0.0, 1.0))
    return np.clip(DARKEST + (LIGHTEST - DARKEST) * level - STEEP * sine, 0.0, 1.0)


def _contoured(corners: Array) -> Array:
    """Returns the faces that have contours: neither level nor upright, which are only an edge from above."""
    normal = area_vectors(corners)
    across = np.linalg.norm(normal[:, :2], axis=1)
    upwards = np.abs(normal[:, 2])
    return corners[(across > LEVEL * upwards) & (upwards > UPRIGHT * across)]


def _within(ground: GroundSurface, lower: Array, upper: Array) -> NDArray[np.bool_]:
    """Returns a mask (F,) of the faces that overlap a window."""
    low, high = ground.corners[..., :2].min(axis=1), ground.corners[..., :2].max(axis=1)
    return np.asarray((high >= lower).all(axis=1) & (low <= upper).all(axis=1))


def _cut(corners: Array, axis: int, value: float) -> tuple[Array, NDArray[np.bool_]]:
    """Returns the section of faces by a plane across an axis: segments (n, 2, 3) [m], and a mask of the faces."""
    # Shifted, so that the plane does not contain vertices or edges.
    value += 1.0e-6 * float(np.ptp(corners[..., axis]) or 1.0)
    side = corners[..., axis] > value
    cut = np.asarray(side.any(axis=1) & ~side.all(axis=1))
    corners, side = corners[cut], side[cut]
    ends = np.roll(corners, -1, axis=1)
    crossing = side != np.roll(side, -1, axis=1)  # two of the three edges
    start, end = corners[crossing], ends[crossing]
    part = (value - start[:, axis]) / (end[:, axis] - start[:, axis])
    return (start + part[:, None] * (end - start)).reshape(-1, 2, 3), cut


def draw_section(axes: Any, ground: GroundSurface, y: float) -> None:
    """Draws the section of a surface with the plane at ``y`` [m]."""
    lines, cut = _cut(ground.corners, 1, y)
    if len(lines):
        colors = np.where(ground.active[cut][:, None], ACTIVE_LINE, INACTIVE_LINE)
        axes.add_collection(LineCollection(list(lines[..., [0, 2]]), colors=colors, linewidths=2.0, zorder=0))


def legend_entries(from_above: bool) -> list[Any]:
    """Returns the legend entries for active and inactive faces."""
    labels = "active faces", "inactive faces, which cannot touch"
    if from_above:
        tints = zip((ACTIVE, INACTIVE), labels, strict=True)
        return [Patch(facecolor=SAMPLE * tint, edgecolor="0.3", lw=0.5, label=label) for tint, label in tints]
    colors = zip((ACTIVE_LINE, INACTIVE_LINE), labels, strict=True)
    return [Line2D([], [], color=color, lw=2.0, label=label) for color, label in colors]
