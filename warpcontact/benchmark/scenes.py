"""Scenes of the benchmark in plain NumPy: one body on a terrain.

A sphere, or a box of points, starts at rest with its lowest point 0.4 m above the surface below its center. It
falls, bounces and comes to rest within the steps of a run. Environments are spread over the surface. SI units.

Only NumPy is required, so that other engines can use the same scenes in environments without other packages.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

DT = 1e-3
STEPS = 1000
STIFFNESS = 1e5  # k [N/m]
DAMPING = 400.0  # c [N·s/m]
FRICTION = 0.5  # μ
SLIP_SPEED = 0.01  # regularization speed of friction [m/s]
DENSITY = 1000.0
DROP = 0.4
HALF = 0.1  # radius of the sphere, half the edge length of the box [m]


@dataclass(frozen=True)
class Surface:
    """Heights on a grid, usable as a triangle mesh and as a height field.

    Attributes:
        x: Grid lines along x, ascending [m].
        y: Grid lines along y, ascending [m].
        heights: Heights z of the grid points, (len(x), len(y)) [m].
    """

    x: Array
    y: Array
    heights: Array

    @property
    def vertices(self) -> Array:
        """Grid points (n, 3), with y varying fastest [m]."""
        return np.stack((*np.meshgrid(self.x, self.y, indexing="ij"), self.heights), axis=-1).reshape(-1, 3)

    @property
    def faces(self) -> npt.NDArray[np.int64]:
        """Two upward triangles per cell, split along the diagonal from the lower to the upper corner."""
        number = np.arange(self.heights.size).reshape(self.heights.shape)
        a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
        return np.stack((a, b, c, a, c, d), axis=-1).reshape(-1, 3)

    def height(self, positions: Array) -> Array:
        """Returns the height at positions (…, 2 or more) [m]; beyond the boundary, that at the boundary."""
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
    """Returns a terrain with the hills z = a·sin(2πx/λ)·sin(2πy/λ)."""
    line = length * (np.arange(cells + 1) / cells - 0.5)
    wave = np.sin(2 * np.pi / wavelength * line)
    return Surface(line, line, amplitude * np.outer(wave, wave))


def box_points(count: int) -> Array:
    """Returns points on the surface of the box: its 8 corners, or 64 points with a 4 × 4 grid on each face."""
    edge = {8: 2, 64: 4}[count]
    ticks = np.linspace(-HALF, HALF, edge)
    points = np.array(np.meshgrid(ticks, ticks, ticks)).reshape(3, -1).T
    inside = np.max(np.abs(points), axis=1) < HALF
    # The 4 × 4 × 4 grid has eight interior points; they are moved to the bottom and top, between the others.
    points[inside] = np.sign(points[inside]) * (HALF * 2 / 3, HALF * 2 / 3, HALF)
    return points


@dataclass(frozen=True)
class BenchmarkScene:
    """A scene of the benchmark.

    Attributes:
        name: Name in tables.
        surface: The fixed surface.
        points: Points of the box in its frame; ``None``: the body is a sphere.
    """

    name: str
    surface: Surface
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
        """Moment of inertia about any axis through the center [kg·m²]."""
        return self.mass * HALF**2 * (2 / 5 if self.points is None else 2 / 3)

    def start(self, envs: int) -> Array:
        """Returns the initial positions, (envs, bodies, 3) [m]."""
        # At a distance of one meter from the boundary, so that no body reaches it.
        reach = np.array([self.surface.x[-1], self.surface.y[-1]]) - 1.0
        return self.above(np.random.default_rng(1).uniform(-reach, reach, (envs, 1, 2)))

    def above(self, plane: Array) -> Array:
        """Returns positions (…, 3) at the initial height above the positions ``plane`` (…, 2) [m]."""
        z = self.surface.height(plane) + DROP + HALF
        return np.concatenate((plane, z[..., None]), axis=-1)


#: Scenes by their names in tables for users; the names of ``benchmarks/`` are in ``BenchmarkScene.name``.
SCENES = {
    "sphere": BenchmarkScene("W1", terrain()),
    "box of 8 points": BenchmarkScene("W2p8", terrain(), box_points(8)),
    "box of 64 points": BenchmarkScene("W2p64", terrain(), box_points(64)),
}
