"""Benchmark scenes for all engines: geometry, masses, contact parameters and initial positions in NumPy.

W1 is a sphere on a terrain of 20 000 triangles, W2p8 and W2p64 a box of 8 or 64 points on it; ``warpcontact
bench`` runs these as well. W3 is ten spheres in a bowl of 1280 triangles, with contact between spheres. Every body
starts at rest with its lowest point 0.4 m above the surface below its center. Environments are spread over the
surface. SI units.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# Interpreters of other engines have no warpcontact installed. The imported module needs only NumPy.
sys.path.append(str(Path(__file__).resolve().parents[1]))

from warpcontact.benchmark import scenes as one_body
from warpcontact.benchmark.scenes import (
    DAMPING,
    DT,
    FRICTION,
    HALF,
    SLIP_SPEED,
    STEPS,
    STIFFNESS,
    Array,
    Surface,
    box_points,
)

__all__ = ["DAMPING", "DT", "FRICTION", "SLIP_SPEED", "STEPS", "STIFFNESS", "box_points"]  # for engines

GRAVITY = 9.81
POINT_RADIUS = 0.025  # of the sphere at a point of the box, for engines without points [m]


def bowl(cells: tuple[int, int] = (32, 20), edge: float = 0.1, radius: float = 1.6) -> Surface:
    """Returns a paraboloid z = (x² + y²)/2R."""
    x, y = (edge * (np.arange(n + 1) - n / 2) for n in cells)
    return Surface(x, y, (x[:, None] ** 2 + y**2) / (2 * radius))


@dataclass(frozen=True)
class BenchmarkScene(one_body.BenchmarkScene):
    """Benchmark scene.

    Attributes:
        bodies: Number of bodies of an environment; several bodies have contact with each other.
    """

    bodies: int = 1

    @property
    def resting_contacts(self) -> int:
        """Number of contacts of a body at rest on a plane."""
        return 1 if self.points is None else round(len(self.points) ** (2 / 3))

    def spheres(self) -> list[tuple[Array, float]]:
        """Returns center and radius of spheres for engines without points: one at each point, inside the box."""
        if self.points is None:
            return [(np.zeros(3), self.radius)]
        outermost = np.isclose(np.abs(self.points), HALF)
        return [(point, POINT_RADIUS) for point in self.points - POINT_RADIUS * np.sign(self.points) * outermost]

    def start(self, envs: int) -> Array:
        """Returns the initial positions, ``(envs, bodies, 3)`` [m]."""
        if self.bodies == 1:
            return super().start(envs)
        rows = 2
        grid = np.stack(np.meshgrid(np.arange(self.bodies // rows), np.arange(rows)), axis=-1).reshape(-1, 2)
        # Rows and columns at a distance of three radii, with a random displacement per environment.
        moved = np.random.default_rng(1).uniform(-0.2, 0.2, (envs, self.bodies, 2)) * HALF
        return self.above(3 * HALF * (grid - grid.mean(axis=0)) + moved)


def sanity(scene: BenchmarkScene, positions: Array) -> dict[str, float]:
    """Returns figures that show whether a run was physical.

    Args:
        scene: The benchmark scene.
        positions: Centers of the bodies at the end, ``(envs, bodies, 3)`` [m].

    Returns:
        Mean and maximum height of the centers above the surface [m], and fractions of the bodies that are below
        the surface or not finite.
    """
    finite = np.isfinite(positions).all(axis=-1)
    height = positions[finite][:, 2] - scene.surface.height(positions[finite])
    return {
        "mean_height": float(np.mean(height)) if height.size else float("nan"),
        "highest_body": float(np.max(height)) if height.size else float("nan"),
        "below": float(np.mean(height < 0.0)) if height.size else 0.0,
        "not_finite": float(np.mean(~finite)),
    }


SCENES = {
    scene.name: BenchmarkScene(scene.name, scene.surface, scene.points) for scene in one_body.SCENES.values()
}
SCENES["W3"] = BenchmarkScene("W3", bowl(), bodies=10)
