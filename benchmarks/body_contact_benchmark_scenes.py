"""Benchmark scenes of body contact, as plain NumPy: W4, parts dropped into a bin, and W5, a mesh rolling on a mesh.

W4 is a bin of a floor and four walls. Four boxes, four cylinders and two convex meshes of 500 triangles fall into it from
random poses, and come to rest on each other. W5 is a geodesic sphere of 20 480 triangles that rolls down a terrain of 20 000.
SI units. Poses are arrays (…, 7) of position and quaternion (x, y, z, w).
"""

import itertools
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt

from warpcontact.benchmark.scenes import Surface, terrain

Array = npt.NDArray[np.float64]
Faces = npt.NDArray[np.int64]

DT = 1e-3
STEPS = 2000
AT_REST = 1000  # further steps, in which bodies should not move
SAMPLED_ENVS = 16  # environments in which overlaps are computed
DENSITY = 1000.0
FRICTION = 0.5
STIFFNESS = 1e7  # of compliant contact over an area [Pa/m]
COMPLIANT_SUBSTEPS = 5  # of a step with this stiffness
INNER, HEIGHT, WALL = 0.3, 0.8, 0.1  # inner edge length, height and thickness of the bin [m]
BALL = 0.1  # radius of the sphere of W5 [m]


@dataclass(frozen=True)
class Part:
    """A rigid body with its principal axes along x, y and z, and its center of mass at the origin.

    Attributes:
        kind: ``"box"``, ``"cylinder"`` (about z) or ``"mesh"`` (convex).
        size: Half edge lengths of a box; radius and half length of a cylinder [m].
        vertices: Vertices of a mesh, (n, 3) [m].
        faces: Triangles of a mesh, (m, 3), with outward normals.
    """

    kind: str
    size: tuple[float, ...] = ()
    vertices: Array | None = None
    faces: Faces | None = None

    @cached_property
    def mass(self) -> float:
        """Mass [kg]."""
        return DENSITY * self._integrals[0]

    @cached_property
    def inertia(self) -> Array:
        """Principal moments of inertia (3,) [kg·m²]."""
        squares = self._integrals[1]
        return DENSITY * (squares.sum() - squares)

    @property
    def _integrals(self) -> tuple[float, Array]:
        """Volume, and integrals of x², y² and z²."""
        if self.kind == "box":
            a = np.array(self.size)
            return 8 * a.prod(), 8 * a.prod() * a**2 / 3
        if self.kind == "cylinder":
            r, h = self.size
            volume = 2 * np.pi * r**2 * h
            return volume, volume * np.array([r**2 / 4, r**2 / 4, h**2 / 3])
        corners = self.vertices[self.faces]
        volumes = np.linalg.det(corners) / 6
        # ∫ x² over a tetrahedron with a vertex at the origin: V/20 ((Σ xᵢ)² + Σ xᵢ²).
        return volumes.sum(), (volumes[:, None] / 20 * (corners.sum(axis=1) ** 2 + (corners**2).sum(axis=1))).sum(
            0
        )

    def support(self, directions: Array) -> Array:
        """Returns the largest d·x over its points x for directions d of the body frame, (n, 3) → (n,) [m]."""
        if self.kind == "box":
            return np.abs(directions) @ np.array(self.size)
        if self.kind == "cylinder":
            r, h = self.size
            return r * np.hypot(directions[:, 0], directions[:, 1]) + h * np.abs(directions[:, 2])
        return (directions @ self.vertices.T).max(axis=1)

    @cached_property
    def normals(self) -> Array:
        """Candidates of separating directions in the body frame, (n, 3): normals of faces, and of a cylinder's side."""
        if self.kind == "box":
            return np.concatenate([np.eye(3), -np.eye(3)])
        if self.kind == "cylinder":
            angles = 2 * np.pi * np.arange(64) / 64
            around = np.stack([np.cos(angles), np.sin(angles), np.zeros(64)], axis=1)
            return np.concatenate([around, [[0, 0, 1.0], [0, 0, -1.0]]])
        corners = self.vertices[self.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return normals / np.linalg.norm(normals, axis=1)[:, None]


@dataclass(frozen=True)
class Bin:
    """W4."""

    name: str = "W4"

    @cached_property
    def parts(self) -> list[Part]:
        """The bodies of an environment."""
        boxes = [
            Part("box", size) for size in ((0.05, 0.04, 0.03), (0.04,) * 3, (0.06, 0.03, 0.03), (0.05, 0.05, 0.02))
        ]
        cylinders = [Part("cylinder", size) for size in ((0.03, 0.05), (0.04, 0.03), (0.025, 0.06), (0.045, 0.02))]
        hulls = [turned_part(*size) for size in ((0.045, 0.03), (0.03, 0.05))]
        return [*boxes, *cylinders, *hulls]

    @cached_property
    def walls(self) -> list[tuple[Array, tuple[float, ...]]]:
        """Centers and half edge lengths of the floor and the four walls, which are boxes [m]."""
        half, outer, t = INNER / 2, INNER / 2 + WALL, WALL / 2
        walls = [(np.array([0.0, 0.0, -t]), (outer, outer, t))]
        for sign in (1, -1):
            walls.append((np.array([sign * (half + t), 0, HEIGHT / 2]), (t, outer, HEIGHT / 2)))
            walls.append((np.array([0, sign * (half + t), HEIGHT / 2]), (outer, t, HEIGHT / 2)))
        return walls

    def start(self, envs: int) -> Array:
        """Returns the initial poses of the bodies, (envs, bodies, 7): in layers of four, turned and moved at random."""
        rng = np.random.default_rng(4)
        count = len(self.parts)
        poses = np.empty((envs, count, 7))
        grid = 0.07 * np.array([(-1, -1), (1, -1), (-1, 1), (1, 1)])
        order = np.argsort(rng.random((envs, count)), axis=1)
        poses[..., :2] = grid[order % 4] + rng.uniform(-0.005, 0.005, (envs, count, 2))
        poses[..., 2] = 0.09 + 0.16 * (order // 4)
        turns = rng.normal(size=(envs, count, 4))
        poses[..., 3:] = turns / np.linalg.norm(turns, axis=-1, keepdims=True)
        return poses

    def velocities(self, envs: int) -> Array:
        """Returns the initial linear and angular velocities, (envs, bodies, 6) [m/s, rad/s]."""
        return np.zeros((envs, len(self.parts), 6))

    def overlaps(self, poses: Array) -> Array:
        """Returns the deepest overlap of each environment at poses (envs, bodies, 7), (envs,) [m]."""
        return np.array([max(self._overlaps(frame)) for frame in poses])

    def _overlaps(self, poses: Array) -> list[float]:
        """Returns overlaps of all pairs of bodies and walls that overlap at poses (bodies, 7), and 0."""
        found = [0.0]
        axes = [matrix(pose[3:]) for pose in poses]
        for part, pose, turn in zip(self.parts, poses, axes, strict=True):
            for center, size in self.walls:
                # The inner face of a wall, which is the one towards the center of the bin.
                thin = int(np.argmin(size))
                normal = np.zeros(3)
                normal[thin] = -np.sign(center[thin])
                face = normal @ center + size[thin]
                found.append(face - normal @ pose[:3] + part.support(-normal[None] @ turn)[0])
        for (i, one), (j, other) in itertools.combinations(enumerate(self.parts), 2):
            found.append(overlap(one, poses[i, :3], axes[i], other, poses[j, :3], axes[j]))
        return found

    def above(self, poses: Array) -> Array:
        """Returns heights above the floor, (envs, bodies) [m]; negative outside of the bin."""
        inside = (np.abs(poses[..., :2]) < INNER / 2).all(axis=-1)
        return np.where(inside, poses[..., 2], -1.0)


@dataclass(frozen=True)
class Rolling:
    """W5."""

    name: str = "W5"
    surface: Surface = field(default_factory=terrain)

    @cached_property
    def parts(self) -> list[Part]:
        """The body of an environment."""
        return [geodesic_sphere(BALL, 5)]

    @property
    def walls(self) -> list[tuple[Array, tuple[float, ...]]]:
        """There are no boxes."""
        return []

    def start(self, envs: int) -> Array:
        """Returns the initial poses, (envs, 1, 7): on slopes, spread over the terrain."""
        rng = np.random.default_rng(5)
        poses = np.zeros((envs, 1, 7))
        poses[..., 6] = 1.0
        poses[:, 0, :2] = rng.uniform(-3.0, 3.0, (envs, 2))
        # Just above the surface below it: a ball on a slope does not touch at its lowest point.
        around = poses[:, :1, :2] + self.parts[0].vertices[None, :, :2]
        under = self.surface.height(around) - self.parts[0].vertices[None, :, 2]
        poses[:, 0, 2] = under.max(axis=1) + 1e-4
        return poses

    def velocities(self, envs: int) -> Array:
        """Returns the initial linear and angular velocities, (envs, 1, 6) [m/s, rad/s]."""
        return np.zeros((envs, 1, 6))

    def overlaps(self, poses: Array) -> Array:
        """Returns how deep vertices of the sphere are below the terrain at most, at poses (envs, 1, 7), (envs,) [m]."""
        found = np.zeros(len(poses))
        for i, pose in enumerate(poses[:, 0]):
            points = pose[:3] + self.parts[0].vertices @ matrix(pose[3:]).T
            found[i] = (self.surface.height(points) - points[:, 2]).max()
        return np.maximum(found, 0.0)

    def above(self, poses: Array) -> Array:
        """Returns heights of the centers above the terrain, (envs, 1) [m]."""
        return poses[..., 2] - self.surface.height(poses[..., :3])


def turned_part(radius: float, half_length: float) -> Part:
    """Returns a convex mesh of 500 triangles: a barrel about z with flat ends, rings of 36 vertices at 7 heights."""
    count = 36
    angles = 2 * np.pi * np.arange(count) / count
    rings = []
    for height in np.linspace(-1.0, 1.0, 7):
        r = radius * (1 - 0.3 * abs(height) ** 3)
        rings.append(
            np.stack([r * np.cos(angles), r * np.sin(angles), np.full(count, height * half_length)], axis=1)
        )
    number = np.arange(7 * count).reshape(7, count)
    after = np.roll(number, -1, axis=1)
    low, high, next_low, next_high = number[:-1], number[1:], after[:-1], after[1:]
    sides = np.stack([low, next_low, next_high, low, next_high, high], axis=-1).reshape(-1, 3)
    fan = np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], axis=1)
    faces = np.concatenate([sides, fan[:, ::-1], 6 * count + fan])
    return Part("mesh", vertices=np.concatenate(rings), faces=faces)


def geodesic_sphere(radius: float, divisions: int) -> Part:
    """Returns an icosahedron with each triangle divided into four ``divisions`` times, with all vertices on the sphere."""
    golden = (1 + 5**0.5) / 2
    points = [(0, s, t * golden) for s in (1, -1) for t in (1, -1)]
    vertices = np.array([np.roll(p, k) for p in points for k in range(3)], dtype=float)
    corners = [
        c
        for c in itertools.combinations(range(12), 3)
        if all(abs(np.linalg.norm(vertices[a] - vertices[b]) - 2) < 1e-9 for a, b in itertools.combinations(c, 2))
    ]
    faces = np.array([c if np.linalg.det(vertices[list(c)]) > 0 else c[::-1] for c in corners])
    for _ in range(divisions):
        sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        edges, where = np.unique(sides, axis=0, return_inverse=True)
        middle = len(vertices) + where.reshape(-1, 3)
        vertices = np.concatenate([vertices, vertices[edges].mean(axis=1)])
        a, b, c = faces.T
        ab, bc, ca = middle.T
        faces = np.stack([a, ab, ca, b, bc, ab, c, ca, bc, ab, bc, ca], axis=1).reshape(-1, 3)
    return Part("mesh", vertices=radius * vertices / np.linalg.norm(vertices, axis=1)[:, None], faces=faces)


def matrix(quaternion: Array) -> Array:
    """Returns the rotation matrix of a quaternion (x, y, z, w)."""
    x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def overlap(one: Part, at: Array, turn: Array, other: Part, other_at: Array, other_turn: Array) -> float:
    """Returns the shortest translation that separates two convex parts; 0 or negative without overlap [m].

    It is the smallest overlap along any direction. Candidates are the normals of both and the line of the centers; the best
    ones are refined, so the result is an upper bound, within about 1e-7 m.

    Args:
        one: First part.
        at: Its center, (3,) [m].
        turn: Its rotation matrix.
        other: Second part.
        other_at: Its center, (3,) [m].
        other_turn: Its rotation matrix.
    """
    between = other_at - at
    distance = np.linalg.norm(between)
    if distance > sum(float(part.support(np.eye(3)).max()) * 2 for part in (one, other)):
        return 0.0

    def along(directions: Array) -> Array:
        """Returns the overlaps along unit directions from the first to the second part, (n, 3) → (n,)."""
        return one.support(directions @ turn) + other.support(-directions @ other_turn) - directions @ between

    edges = np.cross((turn @ np.eye(3)).T[:, None], (other_turn @ np.eye(3)).T[None]).reshape(-1, 3)
    length = np.linalg.norm(edges, axis=1)
    edges = edges[length > 1e-6] / length[length > 1e-6, None]
    directions = np.concatenate(
        [one.normals @ turn.T, -other.normals @ other_turn.T, edges, -edges, between[None] / distance]
    )
    values = along(directions)
    if values.min() <= 0.0:
        return float(values.min())
    best = np.inf
    for start in directions[np.argsort(values)[:4]]:
        direction = start
        value, step = along(direction[None])[0], 0.05
        while step > 1e-6:
            tangents = np.linalg.svd(direction[None])[2][1:]
            angles = np.arange(8) * np.pi / 4
            around = direction + step * (
                np.cos(angles)[:, None] * tangents[0] + np.sin(angles)[:, None] * tangents[1]
            )
            around /= np.linalg.norm(around, axis=1)[:, None]
            found = along(around)
            if found.min() < value:
                value, direction = found.min(), around[np.argmin(found)]
            else:
                step /= 2
        best = min(best, value)
    return float(best)


def sanity(scene: "Bin | Rolling", before: Array, after: Array, velocities: Array) -> dict[str, float]:
    """Returns figures that show whether a run was physical.

    Args:
        scene: The benchmark scene.
        before: Poses at the end of a run, (envs, bodies, 7).
        after: Poses ``AT_REST`` steps later.
        velocities: Linear and angular velocities then, (envs, bodies, 6), in world axes [m/s, rad/s].

    Returns:
        Deepest overlap at the end: median and maximum over environments [m]; median and maximum distance that bodies moved
        in between [m]; mean kinetic energy of a body [J] and mean height of the centers [m]; fraction of bodies that are not
        inside the bin or above the terrain, or not finite.
    """
    finite = np.isfinite(after).all(axis=(1, 2)) & np.isfinite(before).all(axis=(1, 2))
    overlaps = scene.overlaps(before[finite][:SAMPLED_ENVS])
    moved = np.linalg.norm(after[finite][..., :3] - before[finite][..., :3], axis=-1)
    height = scene.above(after[finite])
    mass = np.array([part.mass for part in scene.parts])
    inertia = np.array([part.inertia.mean() for part in scene.parts])
    energy = 0.5 * (
        mass * (velocities[finite][..., :3] ** 2).sum(axis=-1)
        + inertia * (velocities[finite][..., 3:] ** 2).sum(axis=-1)
    )
    return {
        "penetration_m": float(np.median(overlaps)),
        "deepest_m": float(np.max(overlaps)),
        "drift_m": float(np.median(moved)),
        "largest_drift_m": float(np.max(moved)),
        "kinetic_energy_j": float(np.mean(energy)),
        "mean_height": float(np.mean(height)),
        "below": float(np.mean(height < 0.0)),
        "not_finite": float(np.mean(~finite)),
    }


SCENES: dict[str, "Bin | Rolling"] = {scene.name: scene for scene in (Bin(), Rolling())}
