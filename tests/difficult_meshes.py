"""Meshes that are difficult for closest-point searches, and points near them where errors are likely."""

import numpy as np

import warpcontact as wc

# Exact in float32 as well: a mesh moved there and back loses only its digits below 1e-13.
FAR_AWAY = np.array([1024.0, -512.0, 768.0])


def tetrahedron():
    return wc.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def extruded(outline, triangles, height):
    """A prism over a polygon (n, 2), whose area is covered by ``triangles``."""
    n = len(outline)
    vertices = [(*corner, z) for z in (0.0, height) for corner in outline]
    faces = [triangle[::-1] for triangle in triangles] + [tuple(k + n for k in triangle) for triangle in triangles]
    for i in range(n):
        j = (i + 1) % n
        faces += [(i, j, j + n), (i, j + n, i + n)]
    return wc.Mesh(vertices, faces)


def angle_bracket():
    """Nonconvex, with a concave edge."""
    outline = [(0, 0), (1, 0), (1, 0.4), (0.3, 0.4), (0.3, 1), (0, 1)]
    return extruded(outline, [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)], 0.5)


def slotted_block(gap=1e-2):
    """A block with a slit: two faces at a small distance opposite each other."""
    h = gap / 2
    outline = [(-0.5, 0), (0.5, 0), (0.5, 1), (h, 1), (h, 0.3), (-h, 0.3), (-h, 1), (-0.5, 1)]
    return extruded(outline, [(0, 5, 7), (5, 6, 7), (0, 4, 5), (0, 1, 4), (1, 2, 4), (2, 3, 4)], 0.7)


def rod(sides=100, radius=0.5):
    """A cylinder of long facets over fans of blade-like triangles."""
    angle = 2 * np.pi * np.arange(sides) / sides
    outline = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return extruded(outline, [(0, i, i + 1) for i in range(1, sides - 1)], 1.0)


def burr(height=3.0):
    """An icosahedron with a spike on every face."""
    core = wc.meshes.icosphere(0.3, 0)
    vertices, faces = core.vertices.tolist(), []
    for a, b, c in core.faces.tolist():
        middle = np.mean([vertices[a], vertices[b], vertices[c]], axis=0)
        top = len(vertices)
        vertices.append(0.3 * height * middle / np.linalg.norm(middle))
        faces += [(a, b, top), (b, c, top), (c, a, top)]
    return wc.Mesh(vertices, faces)


def wedge(angle=0.1):
    """A blade with an edge of twice this angle."""
    t = np.tan(angle)
    vertices = [(0, -0.5, 0), (0, 0.5, 0), (1, -0.5, t), (1, 0.5, t), (1, -0.5, -t), (1, 0.5, -t)]
    return wc.Mesh(
        vertices, [(0, 2, 3), (0, 3, 1), (0, 1, 5), (0, 5, 4), (2, 4, 5), (2, 5, 3), (0, 4, 2), (1, 3, 5)]
    )


def moved(mesh, shift):
    return wc.Mesh(mesh.vertices + shift, mesh.faces)


def rough_sheet():
    """An open height field with boundaries."""
    flat = wc.meshes.grid((1.0, 1.0), (6, 6))
    height = np.random.default_rng(5).uniform(-0.1, 0.1, len(flat.vertices))
    return wc.Mesh(flat.vertices + height[:, None] * [0, 0, 1], flat.faces)


# Closed, without inner walls or intersections.
CLOSED = {
    "tetrahedron": tetrahedron,
    "cube": wc.meshes.box,
    "bracket, not convex": angle_bracket,
    "ball of 1280 facets": lambda: wc.meshes.icosphere(1.0, 3),
    "plate": lambda: wc.meshes.box((1.0, 1.0, 1e-2)),
    "sheet metal": lambda: wc.meshes.box((1.0, 0.7, 5e-4)),
    "burr": burr,
    "wedge": wedge,
    "rod, uneven triangles": rod,
    "slotted block": slotted_block,
    "bracket, beside its origin": lambda: moved(angle_bracket(), np.array([3.0, -1.3, 2.7])),
    "bracket, modelled 1 km away": lambda: moved(angle_bracket(), FAR_AWAY),
}
# With boundaries; height fields over a rectangle.
OPEN = {
    "terrain": lambda: wc.meshes.sinusoidal_terrain((5.0, 5.0), (24, 24)),
    "rough sheet": rough_sheet,
}
# Files of the reference data; all are closed.
FILES = ("fandisk.obj", "Duck.glb", "20mm-xyz-cube.stl")
CUTS_ITSELF = ("Duck.glb",)


def difficult_points(surface, count, seed=1):
    """Returns about ``count`` points (n, 3) by kind.

    Args:
        surface: The mesh as a ``brute_force.Surface``, in the pose in which the points are needed.
        count: Approximate number of points of all kinds together.
        seed: Seed of the random numbers.
    """
    rng = np.random.default_rng(seed)
    n = count // 10
    size, corners = surface.size, surface.corners
    middle, extent = 0.5 * (surface.low + surface.high), surface.high - surface.low

    def directions(number):
        x = rng.normal(size=(number, 3))
        return x / np.linalg.norm(x, axis=1, keepdims=True)

    def tiny(number, largest=-1):
        return size * 10.0 ** rng.uniform(-9, largest, (number, 1))

    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    normal = cross / area[:, None]
    # Half by number, so that small faces are included, and half by area.
    by_area = rng.choice(len(corners), n, p=area / area.sum())
    face = np.where(rng.random(n) < 0.5, rng.integers(len(corners), size=n), by_area)
    on_face = np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), n), corners[face])
    edge = rng.integers(3, size=n)
    start, end = corners[face, edge], corners[face, (edge + 1) % 3]
    on_edge = start + rng.random((n, 1)) * (end - start)
    vertex = corners[face, edge]
    out = rng.choice([-1.0, 1.0], (n, 1))

    # Above an edge of a face and slightly to its side: face and edge are equally near to first order.
    sideways = np.cross(end - start, normal[face])
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    height = size * 10.0 ** rng.uniform(-5, 0, (n, 1))
    aside = height * 10.0 ** rng.uniform(-6, -1, (n, 1)) * rng.choice([-1.0, 1.0], (n, 1))

    # Halfway to the opposite part of the surface, inside or outside.
    through = -out[: n // 2] * normal[face[: n // 2]]
    opposite = surface.first_hit(on_face[: n // 2], through)
    opposite = np.where(np.isfinite(opposite), opposite, size)
    return {
        "about": middle + rng.uniform(-0.5, 0.5, (2 * n, 3)) * (extent + 0.6 * size),
        "in the bounds": middle + rng.uniform(-0.5, 0.5, (n, 3)) * extent,
        "near a face": on_face + out * tiny(n) * normal[face],
        "near an edge": on_edge + tiny(n) * directions(n),
        "near a vertex": vertex + tiny(n) * directions(n),
        "on a face": on_face[: n // 2],
        "on an edge": 0.5 * (start + end)[: n // 2],
        "on a vertex": vertex[: n // 2],
        "between face and edge": on_edge + out * height * normal[face] + aside * sideways,
        "half way": on_face[: n // 2] + 0.5 * opposite[:, None] * through,
        "far": middle + 100 * size * directions(n // 2),
    }


def plate(size=(2.0, 2.0), thickness=2e-3, cells=(8, 8)):
    """A closed plate about the origin, both sides divided into cells of two triangles."""
    top = wc.meshes.grid(size, cells)
    count = len(top.vertices)
    ends = np.concatenate([top.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    there = {tuple(edge) for edge in ends.tolist()}
    rim = [(a, b) for a, b in there if (b, a) not in there]
    sides = [face for a, b in rim for face in ((a, a + count, b + count), (a, b + count, b))]
    up = 0.5 * thickness * np.array([0.0, 0.0, 1.0])
    return wc.Mesh(
        np.concatenate([top.vertices + up, top.vertices - up]),
        np.concatenate([top.faces, top.faces[:, ::-1] + count, sides]),
    )
