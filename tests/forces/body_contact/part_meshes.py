"""Meshes of parts with their mass properties, for tests of body contact."""

import numpy as np
from scipy.spatial import ConvexHull

import warpcontact as wc


def prism(outline, triangles, length):
    """Returns a prism along z about z = 0; ``triangles`` of the outline are counter-clockwise."""
    outline = np.asarray(outline, dtype=float)
    triangles = np.asarray(triangles)
    n = len(outline)
    here = np.arange(n)
    there = np.roll(here, -1)
    vertices = np.concatenate([np.insert(outline, 2, z, axis=1) for z in (-length / 2, length / 2)])
    sides = [np.stack([here, there, n + there], axis=1), np.stack([here, n + there, n + here], axis=1)]
    return wc.Mesh(vertices, np.concatenate([triangles[:, ::-1], triangles + n, *sides]))


def mass_properties(mesh):
    """Returns volume, center of mass and inertia of a closed mesh about it, for a density of 1."""
    corners = mesh.vertices[mesh.faces]
    volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    volume = volumes.sum()
    center = (volumes[:, None] * corners.sum(axis=1)).sum(axis=0) / 4 / volume
    # Second moments of tetrahedra with one corner at the origin.
    corner_sums = corners.sum(axis=1)
    moments = np.einsum("i,ij,ik->jk", volumes, corner_sums, corner_sums)
    moments += np.einsum("i,icj,ick->jk", volumes, corners, corners)
    moments = moments / 20 - volume * np.outer(center, center)
    return volume, center, np.trace(moments) * np.eye(3) - moments


def centered(mesh):
    """Returns a mesh about its center of mass, and its inertia for a mass of 1."""
    volume, center, inertia = mass_properties(mesh)
    return wc.Mesh(mesh.vertices - center, mesh.faces), inertia / volume


def l_section(side, thickness, length):
    """Returns a prism with an L as its section, in the plane z = 0, and its inertia for a mass of 1."""
    a, t = side, thickness
    outline = [[0, 0], [a, 0], [a, t], [t, t], [t, a], [0, a]]
    return centered(prism(outline, [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]], length))


def bracket(length, width, thickness, height):
    """Returns a U-shaped bracket that stands on its two legs, along x, and its inertia for a mass of 1."""
    a, t, h = length, thickness, height
    # In the plane of x and z, from the left leg counter-clockwise.
    outline = [[0, 0], [t, 0], [t, h - t], [a - t, h - t], [a - t, 0], [a, 0], [a, h], [0, h]]
    triangles = [[0, 1, 2], [0, 2, 7], [2, 3, 7], [3, 6, 7], [3, 4, 5], [3, 5, 6]]
    mesh = prism(outline, triangles, width)
    # x, y, z → x, −z, y
    return centered(wc.Mesh(mesh.vertices[:, [0, 2, 1]] * [1, -1, 1], mesh.faces))


def random_hull(size, seed):
    """Returns the convex hull of 24 random points, standing on a face whose polygon contains the center, and its inertia.

    Also returns the corners (n, 2) of that face, about the projection of the center of mass.
    """
    points = np.random.default_rng(seed).normal(size=(24, 3))
    points *= size / np.linalg.norm(points, axis=1, keepdims=True)
    hull = ConvexHull(points)
    faces = hull.simplices.copy()
    normals = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    inward = np.einsum("ij,ij->i", normals, hull.equations[:, :3]) < 0
    faces[inward] = faces[inward][:, ::-1]
    mesh, _ = centered(wc.Mesh(points, faces))
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    heights = np.einsum("ij,ij->i", normals, corners[:, 0])
    feet = heights[:, None] * normals
    edges = np.roll(corners, -1, axis=1) - corners
    # Smallest distance of the projected center from the edges of each face, inside positive.
    inside = np.einsum("fij,fij->fi", np.cross(normals[:, None], edges), feet[:, None] - corners)
    face = (inside / np.linalg.norm(edges, axis=2)).min(axis=1).argmax()
    # The axis of that face points down.
    down = -normals[face]
    along = edges[face, 0] / np.linalg.norm(edges[face, 0])
    axes = np.stack([along, np.cross(down, along), down])
    turned = wc.Mesh(mesh.vertices @ axes.T, mesh.faces)
    mesh, inertia = centered(turned)
    return mesh, inertia, mesh.vertices[mesh.faces[face]][:, :2]
