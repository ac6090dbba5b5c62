"""Benchmark scenes of nonsmooth contact, as plain NumPy: boxes on feet that slide and come to rest.

``table`` is one box with feet on a grid, ``stack`` is a stack of boxes with four feet each. Each environment
throws its boxes along the ground with another velocity. A run ends at rest. SI units.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

DT = 2e-3
STEPS = 500
GRAVITY = 9.81
FRICTION = 0.4
EDGE, HEIGHT, MASS = 0.5, 0.2, 20.0
RADIUS = 0.01  # of a foot, a small sphere [m]
SAMPLES = 20  # states of a run at which residuals are computed
FASTEST = 1.5  # largest initial speed of a box along the ground [m/s]


@dataclass(frozen=True)
class NonsmoothScene:
    """Boxes with feet.

    Attributes:
        name: Name of the scene.
        boxes: Number of stacked boxes.
        feet: Number of feet of each box.
    """

    name: str
    boxes: int
    feet: int

    @property
    def contacts(self) -> int:
        """Number of contacts of an environment at rest."""
        return self.boxes * self.feet

    @property
    def feet_centers(self) -> Array:
        """Centers of the feet of a box in its frame, ``(feet, 3)`` [m]: on a grid below it."""
        across = int(np.sqrt(self.feet))
        while self.feet % across:
            across -= 1
        sides = (0.35 * EDGE * np.linspace(-1.0, 1.0, n) for n in (self.feet // across, across))
        grid = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
        return np.insert(grid, 2, RADIUS - 0.5 * HEIGHT, axis=1)

    @property
    def inertia(self) -> Array:
        """Principal moments of inertia of a box [kg·m²]."""
        edges = np.array([EDGE, EDGE, HEIGHT])
        return MASS / 12.0 * (np.square(edges).sum() - np.square(edges))

    def start(self) -> Array:
        """Returns the centers of the boxes, ``(boxes, 3)`` [m], with small gaps between them."""
        z = 0.5 * HEIGHT + (HEIGHT + 1e-4) * np.arange(self.boxes) + 1e-4
        return np.stack([np.zeros(self.boxes), np.zeros(self.boxes), z], axis=1)

    def velocities(self, envs: int) -> Array:
        """Returns the initial velocity of all boxes in each environment, ``(envs, 3)`` [m/s]."""
        rng = np.random.default_rng(7)
        angle, speed = rng.uniform(0.0, 2.0 * np.pi, envs), rng.uniform(0.0, FASTEST, envs)
        return np.stack([speed * np.cos(angle), speed * np.sin(angle), np.zeros(envs)], axis=1)


SCENES = {
    scene.name: scene
    for scene in (
        NonsmoothScene("table4", 1, 4),
        NonsmoothScene("table8", 1, 8),
        NonsmoothScene("table16", 1, 16),
        NonsmoothScene("table32", 1, 32),
        NonsmoothScene("table64", 1, 64),
        NonsmoothScene("stack8", 2, 4),
        NonsmoothScene("stack16", 4, 4),
        NonsmoothScene("stack32", 8, 4),
    )
}


def residual(W: Array, w: Array, impulses: Array, mu: float) -> float:
    """Returns the relative residual of a contact problem, as this engine computes it.

    Args:
        W: Delassus matrix, (3 n, 3 n), contact by contact, normal first [1/kg].
        w: Relative velocities after the step, (n, 3) [m/s].
        impulses: Impulses of the step, (n, 3) [N·s].
        mu: Coefficient of friction.
    """
    if not len(w):
        return 0.0
    blocks = W.reshape(len(w), 3, len(w), 3)
    rho = 3.0 / np.einsum("iaia->i", blocks)
    shifted = w.copy()
    shifted[:, 0] += mu * np.linalg.norm(w[:, 1:], axis=1)
    z = impulses - rho[:, None] * shifted
    normal, across = z[:, 0], np.linalg.norm(z[:, 1:], axis=1)
    top = np.maximum(normal + mu * across, 0.0) / (1.0 + mu * mu)
    direction = z[:, 1:] / np.maximum(across, 1e-300)[:, None]
    on_cone = np.concatenate([top[:, None], mu * top[:, None] * direction], axis=1)
    inside = across <= mu * normal
    projected = np.where(inside[:, None], z, np.where((mu * across <= -normal)[:, None], 0.0, on_cone))
    free = w - (W @ impulses.ravel()).reshape(-1, 3)
    # In these scenes all contacts are connected by bodies.
    fastest = np.linalg.norm(free, axis=1).max()
    scale = np.maximum(np.linalg.norm(impulses, axis=1), rho * fastest)
    return float((np.linalg.norm(impulses - projected, axis=1) / np.where(scale > 0.0, scale, 1.0)).max())
