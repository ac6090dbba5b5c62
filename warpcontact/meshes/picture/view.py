"""Orthographic view of a surface: choice of the direction, projection and visibility."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Candidate elevations [°], number of azimuths, and first azimuth [°], which is not along an axis.
ELEVATIONS, AROUND, OFFSET = (30.0, 55.0, -30.0), 8, -65.0
# Bonus for views from above, as a fraction of the visible area.
FROM_ABOVE = 0.03
# Fraction of the picture filled by the surface, and its upward shift, which leaves space for axes and scale bar.
FILLED, RAISED = 0.82, 0.045
# Depth behind the surface up to which a line on it is visible, as a fraction of the picture size.
TOLERANCE = 4.0e-3


@dataclass(frozen=True)
class View:
    """Direction of view and mapping to picture coordinates.

    Attributes:
        direction: Unit vector to the camera.
        right, up: Unit vectors in the plane of the picture.
        centre: Point at the center of the picture [m].
        scale: Pixels per meter.
        size: Numbers of rows and columns of pixels.
    """

    direction: Array
    right: Array
    up: Array
    centre: Array
    scale: float
    size: tuple[int, int]

    @classmethod
    def towards(cls, direction: Array, points: Array, size: tuple[int, int]) -> "View":
        """Returns the view from ``direction`` (3,) that shows all ``points`` (n, 3) in a picture of ``size``."""
        eye = direction / np.linalg.norm(direction)
        # z is up; in views along z, y is up.
        upright = np.array([0.0, 1.0, 0.0]) if abs(eye[2]) > 0.999 else np.array([0.0, 0.0, 1.0])
        right = np.cross(upright, eye)
        right /= np.linalg.norm(right)
        up = np.cross(eye, right)
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        flat = (points - middle) @ np.stack([right, up], axis=1)
        low, high = flat.min(axis=0), flat.max(axis=0)
        # Limit the extent from below, for surfaces seen edge-on or of zero size.
        extent = np.maximum(high - low, 1e-3 * (np.ptp(points, axis=0).max() or 1.0))
        scale = FILLED * min(size[1] / extent[0], size[0] / extent[1])
        offset = 0.5 * (low + high) - (0.0, RAISED * size[0] / scale)
        return cls(eye, right, up, middle + offset[0] * right + offset[1] * up, float(scale), size)

    def project(self, points: Array) -> Array:
        """Returns column, row and depth of points (…, 3), all in pixels."""
        local = points - self.centre
        column = 0.5 * self.size[1] + self.scale * (local @ self.right)
        row = 0.5 * self.size[0] - self.scale * (local @ self.up)
        return np.stack([column, row, -self.scale * (local @ self.direction)], axis=-1)

    def visible(self, places: Array, depth: Array) -> npt.NDArray[np.bool_]:
        """Returns which of the projected points (n, 3) are not hidden.

        Args:
            places: Result of ``project``, (n, 3).
            depth: Depth in each pixel; infinite where there is no surface.
        """
        rows, columns = self.size
        column, row = places[:, 0].astype(np.int64), places[:, 1].astype(np.int64)
        farthest = np.full(len(places), -np.inf)
        # Compare with the neighboring pixels too: on slopes and at boundaries their depth differs.
        for i in (-1, 0, 1):
            for j in (-1, 0, 1):
                near = depth[np.clip(row + i, 0, rows - 1), np.clip(column + j, 0, columns - 1)]
                farthest = np.maximum(farthest, near)
        return places[:, 2] <= farthest + TOLERANCE * max(self.size)


def best_direction(cross: Array) -> Array:
    """Returns the candidate direction from which most of the outer side is visible.

    Args:
        cross: Face normals with twice the areas as lengths, (F, 3).
    """
    candidates = np.array(
        [
            (np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e))
            for e in np.radians(ELEVATIONS)
            for a in np.radians(OFFSET + np.arange(AROUND) * 360.0 / AROUND)
        ]
    )
    total = np.linalg.norm(cross, axis=1).sum() or 1.0
    seen = np.array([np.maximum(cross @ direction, 0.0).sum() for direction in candidates]) / total
    # Round, so that the first of equally good directions is chosen.
    worth = np.round(seen + FROM_ABOVE * (candidates[:, 2] > 0.0), 6)
    return candidates[int(worth.argmax())]


def direction_text(direction: Array) -> str:
    """Returns a direction as text: azimuth from x towards y, elevation above the x–y plane."""
    elevation = np.degrees(np.arcsin(np.clip(direction[2], -1.0, 1.0)))
    if abs(elevation) > 89.0:
        return "from above, +z" if elevation > 0.0 else "from below, −z"
    azimuth = round(np.degrees(np.arctan2(direction[1], direction[0])))
    where = "above" if elevation >= 0.0 else "below"
    return f"from azimuth {str(azimuth).replace('-', '−')}°, {abs(elevation):.0f}° {where}"
