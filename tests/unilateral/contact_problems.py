"""Random solvable contact problems w = W l + q, and the violation of the contact law by a solution."""

import numpy as np


def problems(seed, count, contacts, dim, freedoms=1.5, mu=2.0, shared=1):
    """Returns W, q and μ of many problems; groups of ``shared`` problems have the same W.

    As for contacts of a mechanism, W = H Hᵀ and q = g + H v. The gaps g at v = 0 are open, so a solution exists
    for any friction (Acary and others, 2011).

    Args:
        seed: Seed of the random numbers.
        count: Number of problems.
        contacts: Number of contacts of each problem.
        dim: Rows per contact.
        freedoms: Degrees of freedom over rows; below 1, the distribution of forces is not unique.
        mu: Largest coefficient of friction.
        shared: Number of problems with the same W.
    """
    random = np.random.default_rng(seed)
    rows = contacts * dim
    n = max(round(freedoms * rows), 1)
    H = random.normal(size=(count // shared, rows, n)) / np.sqrt(n)
    W = np.repeat(H @ np.swapaxes(H, 1, 2), shared, axis=0)
    q = 3.0 * (np.repeat(H, shared, axis=0) @ random.normal(size=(count, n, 1))).reshape(count, contacts, dim)
    q[..., 0] += np.abs(random.normal(size=(count, contacts)))
    return W, q, random.uniform(0.0, mu, (count, contacts)) if dim > 1 else np.zeros(contacts)


def violation(W, q, mu, lam):
    """Returns the violation of the contact law by each solution, relative to its velocities.

    Computed without projections: signs, complementarity, the cone, and friction opposed to slip.
    """
    count, contacts, dim = q.shape
    w = (W @ lam.reshape(count, -1, 1)).reshape(q.shape) + q
    block = np.einsum("biaia->bi", W.reshape(count, contacts, dim, contacts, dim)) / dim
    press, push = block * lam[..., 0], block[..., None] * lam[..., 1:]
    slip, across = np.linalg.norm(w[..., 1:], axis=-1), np.linalg.norm(push, axis=-1)
    wrong = [
        -press,
        -w[..., 0],
        np.minimum(press, w[..., 0]),
        across - mu * press,
        # Friction is at the limit or slip is zero, and friction opposes slip.
        np.minimum(mu * press - across, slip),
        (slip * across + (w[..., 1:] * push).sum(axis=-1)) / np.maximum(slip + across, 1e-300),
    ]
    return np.max([x.max(axis=1) for x in wrong], axis=0) / np.linalg.norm(q, axis=-1).max(axis=1)
