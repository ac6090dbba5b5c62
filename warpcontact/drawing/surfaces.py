"""Surfaces with pose, scale and mesh in each environment."""

from dataclasses import dataclass

import numpy as np

from warpcontact.algebra.vectors import transform_points
from warpcontact.drawing.replay import Replay
from warpcontact.drawing.spheres import body_color
from warpcontact.scene.elements import Surface
from warpcontact.validation.checks import Array

# Brightness of inactive faces.
INACTIVE = 0.4


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
