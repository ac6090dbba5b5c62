"""Volume, center and second moments of solids; mass, center of mass and inertia of assemblies."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import pi

import numpy as np

from warpcontact.meshes import Mesh
from warpcontact.validation.checks import Array


@dataclass(frozen=True)
class Solid:
    """Solid, with moments for density 1.

    Attributes:
        volume: Volume [m³].
        centre: Centroid (3,) [m].
        moments: ∫ y yᵀ dV about the centroid, (3, 3) [m⁵].
    """

    volume: float
    centre: Array
    moments: Array

    def transformed(self, linear: Array, position: Array) -> "Solid":
        """Returns the image of the solid under y ↦ ``linear`` y + ``position``."""
        size = abs(float(np.linalg.det(linear)))
        return Solid(size * self.volume, linear @ self.centre + position, size * linear @ self.moments @ linear.T)


@dataclass(frozen=True)
class Weight:
    """Mass properties.

    Attributes:
        mass: Mass [kg].
        centre: Center of mass (3,) [m].
        inertia: Inertia tensor about the center of mass, (3, 3) [kg·m²].
    """

    mass: float
    centre: Array
    inertia: Array

    @classmethod
    def of(cls, solid: Solid, mass: float) -> "Weight":
        """Returns the mass properties of a homogeneous solid of given mass [kg]."""
        second = solid.moments * (mass / solid.volume)
        return cls(mass, solid.centre, np.trace(second) * np.eye(3) - second)

    @classmethod
    def total(cls, parts: Iterable["Weight"]) -> "Weight":
        """Returns the mass properties of parts fixed to each other, with a positive total mass."""
        each = list(parts)
        mass = sum(part.mass for part in each)
        centre = sum((part.mass * part.centre for part in each), np.zeros(3)) / mass
        inertia = sum(
            (part.inertia + part.mass * point_inertia(part.centre - centre) for part in each), np.zeros((3, 3))
        )
        return cls(mass, centre, inertia)

    def scaled(self, mass: float) -> "Weight":
        """Returns the same distribution with another total mass [kg]."""
        return Weight(mass, self.centre, self.inertia * (mass / self.mass))

    def with_center(self, centre: Array) -> "Weight":
        """Returns the mass properties with another center of mass, and the inertia moved to it (parallel axes)."""
        return Weight(self.mass, centre, self.inertia + self.mass * point_inertia(centre - self.centre))


def point_inertia(arm: Array) -> Array:
    """Returns the inertia tensor [m²] of a unit mass at ``arm`` (3,) from the reference point."""
    return np.dot(arm, arm) * np.eye(3) - np.outer(arm, arm)


def ball(radius: float) -> Solid:
    """Returns a ball centered at the origin."""
    volume = 4.0 / 3.0 * pi * radius**3
    return Solid(volume, np.zeros(3), volume * radius**2 / 5.0 * np.eye(3))


def cuboid(half: Array) -> Solid:
    """Returns a box centered at the origin, with half extents (3,)."""
    volume = 8.0 * float(np.prod(half))
    return Solid(volume, np.zeros(3), volume / 3.0 * np.diag(half**2))


def rod(radius: float, half: float) -> Solid:
    """Returns a cylinder along the z axis, with half length ``half``."""
    volume = 2.0 * pi * radius**2 * half
    return Solid(volume, np.zeros(3), volume * np.diag([radius**2 / 4.0, radius**2 / 4.0, half**2 / 3.0]))


def capsule(radius: float, half: float) -> Solid:
    """Returns a capsule along the z axis: a cylinder with half length ``half`` and two hemispherical ends."""
    middle, ends = rod(radius, half), ball(radius)
    # ∫ (half + z)² dV over both half balls; the centroid of a half ball is at 3/8 of the radius.
    along = ends.volume * (radius**2 / 5.0 + half**2 + 0.75 * half * radius)
    across = ends.moments[0, 0]
    moments = middle.moments + np.diag([across, across, along])
    return Solid(middle.volume + ends.volume, np.zeros(3), moments)


def cone(radius: float, half: float) -> Solid:
    """Returns a cone along the z axis, with its base at z = −half and its apex at z = half."""
    height = 2.0 * half
    volume = pi * radius**2 * height / 3.0
    across, along = 3.0 / 20.0 * radius**2, 3.0 / 80.0 * height**2
    return Solid(volume, np.array([0.0, 0.0, -half / 2.0]), volume * np.diag([across, across, along]))


def mesh_solid(mesh: Mesh) -> Solid | None:
    """Returns the solid enclosed by a closed mesh; ``None`` if the mesh encloses no volume."""
    if not mesh.report.volume:
        return None
    middle = mesh.bounds.mean(axis=0)
    corners = (mesh.vertices - middle)[mesh.faces]
    six = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    six *= np.sign(mesh.report.volume)
    volume = float(six.sum()) / 6.0
    top = corners.sum(axis=1)
    centre = six @ top / 24.0 / volume
    second = np.einsum("f,fki,fkj->ij", six, corners, corners) + np.einsum("f,fi,fj->ij", six, top, top)
    return Solid(volume, middle + centre, second / 120.0 - volume * np.outer(centre, centre))
