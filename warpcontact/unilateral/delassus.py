"""Contact problems in the contacts alone, w = W l + q with the law of each contact, and what judges a solution."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpcontact.checks import Array


@dataclass
class Delassus:
    """Problems, many at once; what all share has 1 in place of their number.

    Attributes:
        W: Shape (problems or 1, rows, rows), symmetric; the rows of contact i are dim·i to dim·i + dim − 1.
        q: Shape (problems, contacts, dim); the normal comes first.
        mu: Shape (problems or 1, contacts).
    """

    W: Array
    q: Array
    mu: Array

    def __post_init__(self) -> None:
        shape = (len(self.W), self.contacts, self.dim, self.contacts, self.dim)
        blocks = np.einsum("biaia->bi", self.W.reshape(shape))
        # What does not move takes the ρ of what moves most.
        largest = np.abs(blocks).max(axis=1, keepdims=True, initial=0.0)
        usual = np.where(largest > 0.0, largest, 1.0)
        self.rho = self.dim / np.where(np.abs(blocks) > 1e-14 * usual, np.abs(blocks), usual)
        scale = (self.rho * np.linalg.norm(self.q, axis=-1)).max(axis=1, initial=0.0)
        self.scale = np.where(scale > 0.0, scale, 1.0)

    @property
    def count(self) -> int:
        """Number of problems."""
        return len(self.q)

    @property
    def contacts(self) -> int:
        """Number of contacts of each."""
        return self.q.shape[1]

    @property
    def dim(self) -> int:
        """Rows of a contact: 1, 2 or 3."""
        return self.q.shape[2]

    def velocity(self, lam: Array) -> Array:
        """Returns w = W l + q, shape (problems, contacts, dim)."""
        flat = lam.reshape(self.count, self.contacts * self.dim)
        return (self.W @ flat[..., None])[..., 0].reshape(self.q.shape) + self.q

    def residual(self, lam: Array, w: Array | None = None) -> Array:
        """Returns how far each problem is from solved, shape (problems,), without unit.

        It is the largest |l − P(l − ρ ŵ)| of a contact over the largest ρ |q|, with ŵ = (w_n + μ |w_t|, w_t), the
        projection P onto the cone |l_t| ≤ μ l_n, and ρ = dim / trace of the contact's block of W.
        """
        if not self.contacts:
            return np.zeros(self.count)
        w = self.velocity(lam) if w is None else w
        moved = w.copy()
        moved[..., 0] += self.mu * np.linalg.norm(w[..., 1:], axis=-1)
        away = lam - project(lam - self.rho[..., None] * moved, self.mu)
        return np.linalg.norm(away, axis=-1).max(axis=1) / self.scale

    def part(self, which: NDArray[np.intp]) -> "Delassus":
        """Returns the problems of an index array."""
        return Delassus(_of(self.W, which), self.q[which], _of(self.mu, which))

    def normals(self) -> "Delassus":
        """Returns the problems without friction: of each contact the normal alone."""
        rows = slice(0, None, self.dim)
        return Delassus(self.W[:, rows, rows], self.q[..., :1], np.zeros((1, self.contacts)))


def project(z: Array, mu: Array) -> Array:
    """Returns the points of the cones |l_t| ≤ μ l_n nearest to ``z`` of shape (…, dim)."""
    normal, across = z[..., 0], np.linalg.norm(z[..., 1:], axis=-1)
    inside = (normal >= 0.0) & (across <= mu * normal)
    height = np.maximum(normal + mu * across, 0.0) / (1.0 + mu * mu)
    share = mu * height / np.where(across > 0.0, across, 1.0)
    nearest = np.concatenate([height[..., None], share[..., None] * z[..., 1:]], axis=-1)
    return np.where(inside[..., None], z, nearest)


def _of(shared: Array, which: NDArray[np.intp]) -> Array:
    return shared if len(shared) == 1 else shared[which]
