"""Separation of two convex solids from their support functions, by repeated refinement of grids of directions.

The separation has ridges where a straight line of a solid is normal to the direction. They are circles on the sphere of directions, and
have grids of their own.
"""

import numpy as np

#: Half extents, radii, half lengths, heights and semi-axes of the solids [m].
SIZES = {
    "sphere": 0.1,
    "capsule": (0.08, 0.12),
    "cylinder": (0.1, 0.15),
    "cone": (0.1, 0.25),
    "ellipsoid": (0.12, 0.08, 0.05),
    "box": (0.1, 0.07, 0.12),
}
#: Largest edges of the bounding boxes of the curved ones [m].
LENGTHS = {"sphere": 0.2, "capsule": 0.4, "cylinder": 0.3, "cone": 0.25, "ellipsoid": 0.24}
STARTS, ROUNDS, SHRINK = 3, 30, 0.55


def support(kind, directions):
    """Returns the support function of a solid of ``SIZES`` for directions, (count, 3) → (count,) [m]."""
    size = SIZES[kind]
    across, along = np.linalg.norm(directions[:, :2], axis=1), directions[:, 2]
    if kind == "sphere":
        return size * np.linalg.norm(directions, axis=1)
    if kind == "capsule":
        return size[0] * np.linalg.norm(directions, axis=1) + size[1] * np.abs(along)
    if kind == "cylinder":
        return size[0] * across + size[1] * np.abs(along)
    if kind == "cone":
        return np.maximum(size[0] * across, size[1] * along)
    if kind == "ellipsoid":
        return np.linalg.norm(directions * np.array(size), axis=1)
    return np.abs(directions) @ np.array(size)


def excess(kind, position):
    """Returns by how much a point is outside a solid of ``SIZES``, negative inside [m]."""
    size = SIZES[kind]
    across, along = np.linalg.norm(position[:2]), position[2]
    if kind == "sphere":
        return np.linalg.norm(position) - size
    if kind == "capsule":
        return np.hypot(across, max(abs(along) - size[1], 0.0)) - size[0]
    if kind == "cylinder":
        return max(across - size[0], abs(along) - size[1])
    if kind == "cone":
        slant = np.hypot(*size)
        return max(-along, ((across - size[0]) * size[1] + along * size[0]) / slant)
    if kind == "ellipsoid":
        # To first order.
        scaled = position / np.array(size)
        return (scaled @ scaled - 1.0) / (2.0 * np.linalg.norm(scaled / np.array(size)))
    return np.max(np.abs(position) - np.array(size))


def circle_about(axis, height):
    """Returns the function of an angle that runs on the unit directions with a component along a coordinate axis."""

    def points(angles):
        across = np.sqrt(1.0 - height**2) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        return np.insert(across, axis, height, axis=1)

    return points


def ridges(kind):
    """Returns the circles of directions that are normal to straight lines of a solid, as functions of an angle."""
    if kind == "box":
        return [circle_about(axis, 0.0) for axis in range(3)]
    if kind in ("capsule", "cylinder"):
        return [circle_about(2, 0.0)]
    if kind == "cone":
        return [circle_about(2, SIZES[kind][0] / np.hypot(*SIZES[kind]))]
    return []


def separation_along(first, second, position, rotation, n):
    """Returns the separation along unit vectors ``n``, (count, 3) → (count,) [m]; other arguments as ``separation``."""
    return n @ position - support(second, n) - support(first, -(n @ rotation))


def separation(first, second, position, rotation):
    """Returns the largest separation of two solids over all directions, and this direction, out of the second one.

    Args:
        first: Kind of the first solid.
        second: Kind of the second one, at the origin.
        position: Position of the first solid (3,) [m].
        rotation: Rotation matrix of the first solid (3, 3).
    """

    def gaps(n):
        return separation_along(first, second, position, rotation, n)

    n = np.random.default_rng(0).normal(size=(3000, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    # The best directions that are not close to each other.
    order, starts = np.argsort(-gaps(n)), []
    for i in order:
        if all(n[i] @ one < 0.95 for one in starts):
            starts.append(n[i])
        if len(starts) == STARTS:
            break
    steps = np.linspace(-1.0, 1.0, 9)
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    found = []
    for start in starts:
        center, width = start, 0.3
        for _ in range(ROUNDS):
            plane = np.linalg.svd(center[None])[2][1:]
            trial = center + width * grid @ plane
            trial /= np.linalg.norm(trial, axis=1)[:, None]
            center = trial[np.argmax(gaps(trial))]
            width *= SHRINK
        found.append(center)
    for points in [ridges(second), [lambda t, one=one: -one(t) @ rotation.T for one in ridges(first)]]:
        for circle in points:
            angles = np.linspace(0.0, 2.0 * np.pi, 721)
            for _ in range(10):
                best = angles[np.argmax(gaps(circle(angles)))]
                width = angles[1] - angles[0]
                angles = np.linspace(best - 2 * width, best + 2 * width, 41)
            found.append(circle(np.array([best]))[0])
    values = gaps(np.array(found))
    return values.max(), found[np.argmax(values)]
