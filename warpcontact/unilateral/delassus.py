"""Contact problems in the contacts alone, w = W l + q with the law of each contact, and what judges a solution."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from warpcontact.validation.checks import Array

_ROUNDING = float(np.finfo(np.float64).eps)


@dataclass
class Delassus:
    """Problems, many at once; what all share has 1 in place of their number.

    Attributes:
        W: Shape (problems or 1, rows, rows), symmetric; the rows of contact i are dim·i to dim·i + dim − 1.
        q: Shape (problems, contacts, dim); the normal comes first.
        mu: Shape (problems or 1, contacts).
        rounding: What of w is rounding of what it is the difference of, (problems or 1, contacts).
        rho: ρ = dim / trace of the contact's block of W, (problems or 1, contacts), a stiffness.
        scale: Largest ρ |q|, or 1, a force, (problems,).
        unit: Force that each contact is judged by, (problems, contacts): the scale, or ρ times the largest |q|
            where that is less, of a contact softer than others.
    """

    W: Array
    q: Array
    mu: Array
    rounding: Array = field(default_factory=lambda: np.zeros((1, 1)))

    def __post_init__(self) -> None:
        shape = (len(self.W), self.contacts, self.dim, self.contacts, self.dim)
        blocks = np.einsum("biaia->bi", self.W.reshape(shape))
        # What does not move takes the ρ of what moves most.
        largest = np.abs(blocks).max(axis=1, keepdims=True, initial=0.0)
        usual = np.where(largest > 0.0, largest, 1.0)
        self.rho = self.dim / np.where(np.abs(blocks) > 1e-14 * usual, np.abs(blocks), usual)
        sizes = length(self.q)
        scale = (self.rho * sizes).max(axis=1, initial=0.0)
        self.scale = np.where(scale > 0.0, scale, 1.0)
        unit = np.minimum(self.scale[:, None], self.rho * sizes.max(axis=1, initial=0.0)[:, None])
        self.unit = np.where(unit > 0.0, unit, 1.0)

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

        It is the largest of |l − P(l − ρ ŵ)| and |l_n − max(0, l_n − ρ w_n)| of a contact over its unit, with
        ŵ = (w_n + μ |w_t|, w_t) and the projection P onto the cone |l_t| ≤ μ l_n. The second says more where μ is
        large. What is rounding of w is none. It is not less than the rounding of the largest l, in which w may
        drown.
        """
        if not self.contacts:
            return np.zeros(self.count)
        w = self.velocity(lam) if w is None else w
        de_saxce = w.copy()
        de_saxce[..., 0] += self.mu * length(w[..., 1:])
        deviation = length(lam - project(lam - self.rho[..., None] * de_saxce, self.mu))
        pressed = np.maximum(lam[..., 0] - self.rho * w[..., 0], 0.0)
        deviation = np.maximum(deviation, np.abs(lam[..., 0] - pressed)) - self.rho * self.rounding
        return np.maximum(
            (deviation / self.unit).max(axis=1), _ROUNDING * np.abs(lam).max(axis=(1, 2)) / self.scale
        )

    def part(self, which: NDArray[np.intp]) -> "Delassus":
        """Returns the problems of an index array."""
        return Delassus(
            _select(self.W, which), self.q[which], _select(self.mu, which), _select(self.rounding, which)
        )

    def normals(self) -> "Delassus":
        """Returns the problems without friction: of each contact the normal alone."""
        rows = slice(0, None, self.dim)
        mu = np.zeros((1, self.contacts))
        return Delassus(self.W[:, rows, rows], self.q[..., :1], mu, self.rounding)


def length(vectors: Array) -> Array:
    """Returns the lengths of vectors (…, dim); nothing overflows on the way. Of none it is 0."""
    result: Array = np.hypot.reduce(vectors, axis=-1)
    return np.abs(result)


def project(z: Array, mu: Array) -> Array:
    """Returns the points of the cones |l_t| ≤ μ l_n nearest to ``z`` of shape (…, dim)."""
    normal, across = z[..., 0], length(z[..., 1:])
    # Cosine and sine of the angle of the cone: μ may be large.
    cos = 1.0 / np.hypot(1.0, mu)
    sin = mu * cos
    inside = (normal >= 0.0) & (cos * across <= sin * normal)
    along = np.maximum(cos * normal + sin * across, 0.0)
    height, fraction = cos * along, sin * along / np.where(across > 0.0, across, 1.0)
    nearest = np.concatenate([height[..., None], fraction[..., None] * z[..., 1:]], axis=-1)
    return np.where(inside[..., None], z, nearest)


def _select(shared: Array, which: NDArray[np.intp]) -> Array:
    return shared if len(shared) == 1 else shared[which]
