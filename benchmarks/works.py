"""The works that all engines do: geometry, masses, contact parameters and start positions, as plain NumPy.

W1 is a sphere on a terrain of 20 000 triangles, W2p8 and W2p64 a box of 8 or 64 points on it, W3 ten spheres that
also touch each other in a bowl of 1280 triangles. Every body starts with its lowest point 0.4 m above the surface
below its centre, at rest, and environments are spread over the surface. SI units.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

DT = 1e-3
STEPS = 1000
GRAVITY = 9.81
STIFFNESS = 1e5  # k [N/m]
DAMPING = 400.0  # c [N·s/m]
FRICTION = 0.5  # μ
SLIP_SPEED = 0.01  # speed over which friction builds up [m/s]
DENSITY = 1000.0
DROP = 0.4
HALF = 0.1  # radius of a sphere, half the edge of the box
POINT_RADIUS = 0.025  # of a sphere that stands for a point of the box, where an engine has no points


@dataclass(frozen=True)
class Surface:
    """Heights on a grid, which is a triangle mesh and a height field at once.

    Attributes:
        x: Grid lines along x, rising.
        y: Grid lines along y, rising.
        heights: z at the crossings, ``(len(x), len(y))``.
    """

    x: Array
    y: Array
    heights: Array

    @property
    def vertices(self) -> Array:
        """Crossings of the grid, y running fastest."""
        return np.stack((*np.meshgrid(self.x, self.y, indexing="ij"), self.heights), axis=-1).reshape(-1, 3)

    @property
    def faces(self) -> npt.NDArray[np.int64]:
        """Two triangles in each cell, facing up, parted along the diagonal from the lower to the upper corner."""
        number = np.arange(self.heights.size).reshape(self.heights.shape)
        a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
        return np.stack((a, b, c, a, c, d), axis=-1).reshape(-1, 3)

    def height(self, positions: Array) -> Array:
        """Returns the height of the surface at positions ``(…, 2 or more)``; beyond the border, that at it."""
        lines = (self.x, self.y)
        u, v = (np.interp(positions[..., k], line, np.arange(len(line))) for k, line in enumerate(lines))
        i, j = (np.minimum(w.astype(int), len(line) - 2) for w, line in zip((u, v), lines, strict=True))
        s, t = u - i, v - j
        z = self.heights
        low, high, right, left = z[i, j], z[i + 1, j + 1], z[i + 1, j], z[i, j + 1]
        return np.where(
            s >= t, low + s * (right - low) + t * (high - right), low + t * (left - low) + s * (high - left)
        )


def terrain(length: float = 10.0, cells: int = 100, amplitude: float = 0.2, wavelength: float = 2.5) -> Surface:
    """Returns hills z = a·sin(2πx/λ)·sin(2πy/λ)."""
    line = length * (np.arange(cells + 1) / cells - 0.5)
    wave = np.sin(2 * np.pi / wavelength * line)
    return Surface(line, line, amplitude * np.outer(wave, wave))


def bowl(cells: tuple[int, int] = (32, 20), edge: float = 0.1, radius: float = 1.6) -> Surface:
    """Returns a paraboloid z = (x² + y²)/2R."""
    x, y = (edge * (np.arange(n + 1) - n / 2) for n in cells)
    return Surface(x, y, (x[:, None] ** 2 + y**2) / (2 * radius))


def box_points(count: int) -> Array:
    """Returns points on the surface of the box: its 8 corners, or 64 of which 16 are a grid on every face."""
    edge = {8: 2, 64: 4}[count]
    ticks = np.linspace(-HALF, HALF, edge)
    points = np.array(np.meshgrid(ticks, ticks, ticks)).reshape(3, -1).T
    inside = np.max(np.abs(points), axis=1) < HALF
    # A grid of 64 has eight points inside; they go to the bottom and the top, between the others.
    points[inside] = np.sign(points[inside]) * (HALF * 2 / 3, HALF * 2 / 3, HALF)
    return points


@dataclass(frozen=True)
class Work:
    """What an engine has to simulate.

    Attributes:
        name: Name in tables.
        surface: The fixed surface.
        bodies: Number of bodies in an environment; more than one touch each other.
        points: Points of the box in its frame; ``None``: the body is a sphere.
    """

    name: str
    surface: Surface
    bodies: int = 1
    points: Array | None = None

    @property
    def radius(self) -> float:
        """Radius of the sphere; 0 for a box of points."""
        return HALF if self.points is None else 0.0

    @property
    def mass(self) -> float:
        """Mass of a body [kg]."""
        return DENSITY * (4 / 3 * np.pi * HALF**3 if self.points is None else (2 * HALF) ** 3)

    @property
    def inertia(self) -> float:
        """Moment of inertia about any axis through the centre [kg·m²]."""
        return self.mass * HALF**2 * (2 / 5 if self.points is None else 2 / 3)

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
        rng = np.random.default_rng(1)
        if self.bodies == 1:
            # A meter from the border, so that none gets there.
            reach = np.array([self.surface.x[-1], self.surface.y[-1]]) - 1.0
            plane = rng.uniform(-reach, reach, (envs, 1, 2))
        else:
            rows = 2
            grid = np.stack(np.meshgrid(np.arange(self.bodies // rows), np.arange(rows)), axis=-1).reshape(-1, 2)
            # Rows and columns three radii apart, moved a little so that no environment is like another.
            plane = 3 * HALF * (grid - grid.mean(axis=0)) + rng.uniform(-0.2, 0.2, (envs, self.bodies, 2)) * HALF
        z = self.surface.height(plane) + DROP + HALF
        return np.concatenate((plane, z[..., None]), axis=-1)


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


WORKS = {
    work.name: work
    for work in (
        Work("W1", terrain()),
        Work("W2p8", terrain(), points=box_points(8)),
        Work("W2p64", terrain(), points=box_points(64)),
        Work("W3", bowl(), bodies=10),
    )
}
