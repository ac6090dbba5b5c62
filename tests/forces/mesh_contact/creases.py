"""Meshes with creases, and scenes of a sphere in them."""

import math

import numpy as np

import warpcontact as wc

RADIUS = 0.05  # m


def groove(angle, length=0.3, width=0.2):
    """Two walls that meet in the y axis, open upward; ``angle`` between their normals [rad]."""
    x, z = width * math.cos(angle / 2), width * math.sin(angle / 2)
    line = [(0, -length, 0), (0, length, 0)]
    right = [(x, -length, z), (x, length, z)]
    left = [(-x, -length, z), (-x, length, z)]
    return wc.Mesh([*line, *right, *left], [(0, 2, 3), (0, 3, 1), (0, 1, 5), (0, 5, 4)])


def depth_in_groove(angle, depth):
    """Height of the center of the sphere that is ``depth`` deep in both walls of a groove [m]."""
    return (RADIUS - depth) / math.cos(angle / 2)


def corner(size=0.3):
    """Three walls x = 0, y = 0 and z = 0, with material on the negative sides."""
    s = size
    vertices = [(0, 0, 0), (s, 0, 0), (s, s, 0), (0, s, 0), (0, 0, s), (s, 0, s), (0, s, s)]
    return wc.Mesh(vertices, [(0, 1, 2), (0, 2, 3), (0, 5, 1), (0, 4, 5), (0, 3, 6), (0, 6, 4)])


def trough(facets, radius=0.0505, length=0.3):
    """The inner side of a tube along y with a vertex of its section at the bottom."""
    angles = 2 * np.pi * np.arange(facets) / facets
    vertices = [(radius * math.sin(a), y, -radius * math.cos(a)) for a in angles for y in (-length, length)]
    faces = []
    for i in range(facets):
        a, b, c, d = 2 * i, 2 * i + 1, 2 * ((i + 1) % facets), 2 * ((i + 1) % facets) + 1
        faces += [(a, c, b), (b, c, d)]
    return wc.Mesh(vertices, faces)


def prism(outline, length=1.0):
    """A closed body along y from a convex or star-shaped outline (n, 2) in the xz plane, counter-clockwise."""
    n = len(outline)
    vertices = [(x, y, z) for y in (-length, length) for x, z in outline]
    faces = [(0, i, i + 1) for i in range(1, n - 1)] + [(n, n + i + 1, n + i) for i in range(1, n - 1)]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, i + n, j), (j, i + n, j + n)]
    return wc.Mesh(vertices, faces)


def similarity(cosine):
    """C of two normals: 1 up to 10°, 0 from 40° on, a smooth step between."""
    first, second = np.cos(np.radians([10, 40]))
    x = np.clip((cosine - second) / (first - second), 0.0, 1.0)
    return x * x * (3 - 2 * x)


def ball_in(
    meshes, material=None, *, envs=1, device="cpu", precision="float64", minima="all", gravity=(0, 0, 0), **contact
):
    """Returns a model of a sphere of 0.5 kg in contact with a surface, or with one surface per mesh."""
    scene = wc.Scene(gravity=gravity)
    ball = scene.add_body(0.5, (0.4 * 0.5 * RADIUS**2,) * 3, (0.0, 0.0, 1.0), name="ball")
    centre = scene.add_point(ball, (0, 0, 0), name="centre")
    material = material or wc.ContactMaterial(law=wc.laws.Hooke(stiffness=1e4))
    separate = isinstance(meshes, tuple)
    for i, mesh in enumerate(meshes if separate else [meshes]):
        surface = scene.add_surface(mesh, name=f"wall_{i}" if separate else "wall")
        name = f"touch_{i}" if separate else "touch"
        scene.add_contact(centre, surface, material, radius=RADIUS, minima=minima, name=name, **contact)
    return scene.build(envs=envs, device=device, precision=precision)


def forces_at(meshes, positions, **options):
    """Returns the force on a sphere at ``positions`` (n, 3) [N]."""
    model = ball_in(meshes, envs=len(positions), **options)
    model["ball.position"] = positions
    return model.sensor("touch.force")
