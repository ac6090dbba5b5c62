"""The works that all engines do: geometry, masses, contact parameters and start positions, as plain NumPy.

W1 is a sphere on a terrain of 20 000 triangles, W2p8 and W2p64 a box of 8 or 64 points on it, which
``warpcontact bench`` does as well; W3 is ten spheres that also touch each other in a bowl of 1280 triangles. Every
body starts with its lowest point 0.4 m above the surface below its centre, at rest, and environments are spread
over the surface. SI units.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# The interpreters of other engines have no warpcontact installed. This part of it needs NumPy alone.
sys.path.append(str(Path(__file__).resolve().parents[1]))

from warpcontact.benchmark import works as of_one_body
from warpcontact.benchmark.works import (
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
POINT_RADIUS = 0.025  # of a sphere that stands for a point of the box, where an engine has no points


def bowl(cells: tuple[int, int] = (32, 20), edge: float = 0.1, radius: float = 1.6) -> Surface:
    """Returns a paraboloid z = (x² + y²)/2R."""
    x, y = (edge * (np.arange(n + 1) - n / 2) for n in cells)
    return Surface(x, y, (x[:, None] ** 2 + y**2) / (2 * radius))


@dataclass(frozen=True)
class Work(of_one_body.Work):
    """What an engine has to simulate.

    Attributes:
        bodies: Number of bodies in an environment; more than one touch each other.
    """

    bodies: int = 1

    @property
    def resting_contacts(self) -> int:
        """Contacts of a body that lies on a plane."""
        return 1 if self.points is None else round(len(self.points) ** (2 / 3))

    def spheres(self) -> list[tuple[Array, float]]:
        """Returns centre and radius of spheres for engines without points: one at each point, within the box."""
        if self.points is None:
            return [(np.zeros(3), self.radius)]
        outermost = np.isclose(np.abs(self.points), HALF)
        return [(point, POINT_RADIUS) for point in self.points - POINT_RADIUS * np.sign(self.points) * outermost]

    def start(self, envs: int) -> Array:
        """Returns the positions at the start, ``(envs, bodies, 3)``."""
        if self.bodies == 1:
            return super().start(envs)
        rows = 2
        grid = np.stack(np.meshgrid(np.arange(self.bodies // rows), np.arange(rows)), axis=-1).reshape(-1, 2)
        # Rows and columns three radii apart, moved a little so that no environment is like another.
        moved = np.random.default_rng(1).uniform(-0.2, 0.2, (envs, self.bodies, 2)) * HALF
        return self.above(3 * HALF * (grid - grid.mean(axis=0)) + moved)


def sanity(work: Work, positions: Array) -> dict[str, float]:
    """Returns figures that tell whether a run was physical.

    Args:
        work: The work.
        positions: Centres of the bodies at the end, ``(envs, bodies, 3)``.

    Returns:
        Mean and highest height of the centres above the surface [m], and fractions of the bodies that are below
        the surface or not finite.
    """
    finite = np.isfinite(positions).all(axis=-1)
    height = positions[finite][:, 2] - work.surface.height(positions[finite])
    return {
        "mean_height": float(np.mean(height)) if height.size else float("nan"),
        "highest_body": float(np.max(height)) if height.size else float("nan"),
        "below": float(np.mean(height < 0.0)) if height.size else 0.0,
        "not_finite": float(np.mean(~finite)),
    }


WORKS = {work.name: Work(work.name, work.surface, work.points) for work in of_one_body.WORKS.values()}
WORKS["W3"] = Work("W3", bowl(), bodies=10)
