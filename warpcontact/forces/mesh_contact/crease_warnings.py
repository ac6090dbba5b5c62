"""Warnings about spheres in creases: they touch several walls, but the force acts at the closest one only.

A run checks them once, in its last state, on the host. Steps have no additional cost, and the check has none unless a
sphere is in contact.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from warpcontact.algebra.vectors import cross, dot, inverse, norm, transform_points
from warpcontact.forces.contact_warnings import is_nonsmooth
from warpcontact.validation.checks import Array
from warpcontact.validation.warning_levels import RunWarning, WarningLevel

if TYPE_CHECKING:
    from collections.abc import Mapping

    from warpcontact.model.environments import Environments
    from warpcontact.model.model import DeviceModel
    from warpcontact.scene.elements import Contact

#: Angle between two walls from which on a sphere between them counts as in a crease, the second default of
#: ``group_angle`` [rad].
CREASE_ANGLE = math.radians(40.0)
# Relative rounding of positions; larger than that of float32.
ROUNDING = 1.0e-5
# Nonsmooth contacts of a sphere at rest open and close. Walls count up to this distance, relative to the radius.
NONSMOOTH_REACH = 1.001
# Largest number of spheres that are checked per contact and device, evenly chosen among those in contact, and of bounding
# boxes that are compared with them.
MAX_SPHERES, MAX_DISTANCES = 64, 1_000_000


def crease_warnings(model: "Environments", start_of: "Mapping[Contact, int]") -> list[RunWarning]:
    """Returns a warning for each contact whose spheres touch walls of a crease without a force.

    ``start_of``: index of the first item of each contact.
    """
    found = []
    for contact in model.scene.contacts:
        if contact.minima != "nearest" or contact.facing is not None or not contact.radius.any():
            continue
        angles = [
            angle
            for part, own in model.shares()
            for angle in _angles(part, contact, start_of[contact], model.first_env + own.start)
        ]
        if not angles:
            continue
        env, angle = max(angles, key=lambda pair: pair[1])
        cure = "Use minima='all'"
        if is_nonsmooth(contact.name, model.parts[0].nonsmooth):
            cure = "Use minima='all', or a surface and a contact for each wall"
        text = (
            f"{contact.name}: a sphere touches several walls of {contact.surface.name!r}, up to "
            f"{math.degrees(angle):.0f}° apart (environment {env}), but only the closest one carries it, in turn. {cure}"
        )
        found.append(RunWarning(text, WarningLevel.CAUTION))
    return found


def _angles(part: "DeviceModel", contact: "Contact", start: int, first_env: int) -> list[tuple[int, float]]:
    """Returns environment and angle between walls [rad] of the spheres of a contact that are in a crease."""
    touching = part.arrays.history.entry_speed.numpy()[:, start : start + contact.count] >= 0.0
    radii = np.broadcast_to(part.parameters[f"{contact.name}.radius"].values, touching.shape)
    envs, items = np.nonzero(touching & (radii > 0.0))
    most = max(len(mesh.faces) for mesh in contact.surface.meshes)
    limit = min(MAX_SPHERES, max(1, MAX_DISTANCES // most))
    if len(envs) > limit:
        chosen = np.linspace(0, len(envs) - 1, limit).astype(int)
        envs, items = envs[chosen], items[chosen]
    reach = NONSMOOTH_REACH if is_nonsmooth(contact.name, part.nonsmooth) else 1.0
    found, faces = [], {}
    for env, item in zip(envs.tolist(), items.tolist(), strict=True):
        number, center, unit = _in_mesh(part, contact, env, item)
        if np.isfinite(center).all():
            if number not in faces:
                mesh, active = contact.surface.meshes[number], contact.surface.active[number]
                faces[number] = FaceBoxes(mesh.vertices[mesh.faces[active]])
            with_boundary = contact.boundary == "outer"
            angle = widest_angle(faces[number], center, reach * radii[env, item] / unit, with_boundary)
            if angle > CREASE_ANGLE:
                found.append((first_env + env, angle))
    return found


def _in_mesh(part: "DeviceModel", contact: "Contact", env: int, item: int) -> tuple[int, Array, float]:
    """Returns the number of the mesh, the center of a sphere in its frame (3,) and the scale [m per unit]."""
    points, surface = contact.points, contact.surface

    def value(name: str, own: int = 0) -> Array:
        values = part.parameters[name].values
        return np.asarray(values[min(env, len(values) - 1), own])

    def pose(body_number: int) -> tuple[Array, Array]:
        state = part.arrays.state
        position = state.body_position[env : env + 1, body_number : body_number + 1].numpy()[0]
        orientation = state.body_orientation[env : env + 1, body_number : body_number + 1].numpy()[0]
        remainder = state.body_position_remainder[env : env + 1, body_number : body_number + 1].numpy()[0]
        return position.astype(np.float64) + remainder, orientation.astype(np.float64)

    place = value(f"{points.name}.position", item)[None]
    if points.surface is not None:
        carrier = points.surface.name
        place = value(f"{carrier}.scale") * place
        place = transform_points(place, value(f"{carrier}.position"), value(f"{carrier}.orientation"))
    if points.body is not None:
        position, orientation = pose(int(points.body_numbers[item]))
        place = transform_points(place, position[0], orientation[0])
    frames = [(value(f"{surface.name}.position"), value(f"{surface.name}.orientation"))]
    if surface.body is not None:
        position, orientation = pose(surface.body.index)
        frames.insert(0, (position[0], orientation[0]))
    for position, orientation in frames:
        place = transform_points(place - position, np.zeros(3), inverse(orientation))
    unit = float(value(f"{surface.name}.scale"))
    number = int(value(f"{surface.name}.mesh")) if len(surface.meshes) > 1 else 0
    return number, place[0] / unit, unit


class FaceBoxes:
    """Faces with their bounding boxes.

    Args:
        corners: Vertices of the faces (n, 3, 3).
    """

    def __init__(self, corners: Array) -> None:
        self.corners = corners
        self.lower, self.upper = self.corners.min(axis=1), self.corners.max(axis=1)

    def near(self, center: Array, radius: float) -> Array:
        """Returns the vertices (k, 3, 3) of the faces whose boxes are within ``radius`` of ``center`` along each axis."""
        is_near = np.ones(len(self.corners), dtype=bool)
        for axis in range(3):
            is_near &= self.lower[:, axis] <= center[axis] + radius
            is_near &= self.upper[:, axis] >= center[axis] - radius
        return np.asarray(self.corners[is_near])


def widest_angle(faces: FaceBoxes, center: Array, radius: float, with_boundary: bool) -> float:
    """Returns the largest angle between the directions to local minima of the distance to a mesh within a sphere [rad].

    Only minima with the center on the outer side count; 0 if there are fewer than two.

    Args:
        faces: Its active faces.
        center: Center of the sphere, in the frame of the mesh (3,).
        radius: Its radius, in the unit of the mesh.
        with_boundary: Whether boundary edges count.
    """
    corners = faces.near(center, radius) - center
    if not len(corners):
        return 0.0
    tolerance = ROUNDING * (np.abs(corners).max() + np.abs(center).max())
    closest, in_face = closest_to_origin(corners)
    distance = norm(closest)
    normal = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outer = -dot(closest, normal) > 0.0
    chosen = np.flatnonzero(outer & (distance < radius) & (distance > tolerance))
    directions = []
    for i in chosen:
        # Faces that contain the place have it as their closest point, if it is a minimum.
        there = norm(closest_to_origin(corners - closest[i])[0]) <= tolerance
        if not with_boundary and not in_face[i] and there.sum() == 1:
            continue
        if (norm(closest[there] - closest[i]) <= tolerance).all():
            directions.append(-closest[i] / distance[i])
    if len(directions) < 2:
        return 0.0
    cosines = np.array(directions) @ np.array(directions).T
    return float(np.arccos(np.clip(cosines.min(), -1.0, 1.0)))


def closest_to_origin(corners: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Returns the points of triangles (n, 3, 3) that are closest to the origin, (n, 3), and whether they are inside (n,)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = cross(b - a, c - a)
    area = np.maximum(dot(normal, normal), np.finfo(np.float64).tiny)[:, None]
    projection = (dot(a, normal)[:, None] / area) * normal
    inside = np.ones(len(corners), dtype=bool)
    best, least = a, np.full(len(corners), np.inf)
    for start, end in ((a, b), (b, c), (c, a)):
        edge = end - start
        inside &= dot(cross(edge, projection - start), normal) > 0.0
        along = np.clip(-dot(start, edge) / np.maximum(dot(edge, edge), np.finfo(np.float64).tiny), 0.0, 1.0)
        point = start + along[:, None] * edge
        square = dot(point, point)
        best = np.where((square < least)[:, None], point, best)
        least = np.minimum(least, square)
    return np.where(inside[:, None], projection, best), inside
