"""Contact problems w = W l + q with the law of each contact, and the residual of a solution."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from warpcontact.validation.checks import Array

_ROUNDING = float(np.finfo(np.float64).eps)


@dataclass
class Delassus:
    """Batch of problems; arrays shared by all problems have length 1 in the first axis.

    Attributes:
        W: Delassus matrices (problems or 1, rows, rows), symmetric; the rows of contact i are dim·i to dim·i + dim
            − 1.
        q: Shape (problems, contacts, dim); the normal comes first.
        mu: Coefficients of friction (problems or 1, contacts).
        rounding: Rounding error of w (problems or 1, contacts).
        rho: ρ = dim / trace of the block of the contact in W, (problems or 1, contacts), a stiffness.
        scale: Largest ρ |q|, or 1, a force, (problems,).
        unit: Force that the residual of each contact is relative to, (problems, contacts): ``scale``, or ρ times
            the largest |q| if that is smaller (a contact more compliant than others).
    """

    W: Array
    q: Array
    mu: Array
    rounding: Array = field(default_factory=lambda: np.zeros((1, 1)))

    def __post_init__(self) -> None:
        shape = (len(self.W), self.contacts, self.dim, self.contacts, self.dim)
        blocks = np.einsum("biaia->bi", self.W.reshape(shape))
        # Contacts without mobility get the ρ of the most mobile contact.
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
        """Number of contacts of each problem."""
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
        """Returns the residual of each problem, shape (problems,), dimensionless.

        The largest of |l − P(l − ρ ŵ)| and |l_n − max(0, l_n − ρ w_n)| of a contact over its unit, with ŵ = (w_n +
        μ |w_t|, w_t) and the projection P onto the cone |l_t| ≤ μ l_n. The second is the sharper one for large μ.
        Rounding of w is subtracted. The residual is at least the rounding of the largest l, which may hide w.
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
        """Returns the problems without friction: only the normal of each contact."""
        rows = slice(0, None, self.dim)
        mu = np.zeros((1, self.contacts))
        return Delassus(self.W[:, rows, rows], self.q[..., :1], mu, self.rounding)


def length(vectors: Array) -> Array:
    """Returns the lengths of vectors (…, dim), without overflow; 0 if dim is 0."""
    result: Array = np.hypot.reduce(vectors, axis=-1)
    return np.abs(result)


def project(z: Array, mu: Array) -> Array:
    """Returns the points of the cones |l_t| ≤ μ l_n that are nearest to ``z`` of shape (…, dim)."""
    normal, across = z[..., 0], length(z[..., 1:])
    # Cosine and sine of the half angle of the cone, valid for large μ.
    cos = 1.0 / np.hypot(1.0, mu)
    sin = mu * cos
    inside = (normal >= 0.0) & (cos * across <= sin * normal)
    along = np.maximum(cos * normal + sin * across, 0.0)
    height, fraction = cos * along, sin * along / np.where(across > 0.0, across, 1.0)
    nearest = np.concatenate([height[..., None], fraction[..., None] * z[..., 1:]], axis=-1)
    return np.where(inside[..., None], z, nearest)


def _select(shared: Array, which: NDArray[np.intp]) -> Array:
    return shared if len(shared) == 1 else shared[which]
