"""Converts colliders to analytic shapes or meshes in the frame of their body, with volumes and moments of solids."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from warpcontact.kernels import shapes
from warpcontact.kernels.shapes.base import Shape as Form
from warpcontact.meshes import Mesh, MeshError, icosphere
from warpcontact.meshes.repair import repaired
from warpcontact.meshes.topology import area_vectors
from warpcontact.usd.importing.findings import InvalidValue, Unsupported
from warpcontact.usd.importing.properties import APPROXIMATIONS
from warpcontact.validation.checks import Array

# Relative tolerance of scales and right angles, larger than rounding to float32.
_EQUAL = 1.0e-5
# Number of segments around the axis in tessellations.
_AROUND = 32
# Half the side of the square that represents a plane in contact with a mesh [m].
REACH = 1000.0


@dataclass(frozen=True)
class Solid:
    """Solid, with moments for density 1.

    Attributes:
        volume: Volume [m³].
        centre: Centroid (3,) [m].
        moments: ∫ y yᵀ dV about the centroid, (3, 3) [m⁵].
    """

    volume: float
    centre: Array
    moments: Array

    def transformed(self, linear: Array, position: Array) -> "Solid":
        """Returns the image of the solid under y ↦ ``linear`` y + ``position``."""
        size = abs(float(np.linalg.det(linear)))
        return Solid(size * self.volume, linear @ self.centre + position, size * linear @ self.moments @ linear.T)


@dataclass(frozen=True)
class Weight:
    """Mass properties.

    Attributes:
        mass: Mass [kg].
        centre: Center of mass (3,) [m].
        inertia: Inertia tensor about the center of mass, (3, 3) [kg·m²].
    """

    mass: float
    centre: Array
    inertia: Array

    @classmethod
    def of(cls, solid: Solid, mass: float) -> "Weight":
        """Returns the mass properties of a homogeneous solid of given mass [kg]."""
        second = solid.moments * (mass / solid.volume)
        return cls(mass, solid.centre, np.trace(second) * np.eye(3) - second)

    @classmethod
    def total(cls, parts: Iterable["Weight"]) -> "Weight":
        """Returns the mass properties of parts fixed to each other, with a positive total mass."""
        each = list(parts)
        mass = sum(part.mass for part in each)
        centre = sum((part.mass * part.centre for part in each), np.zeros(3)) / mass
        inertia = sum(
            (part.inertia + part.mass * point_inertia(part.centre - centre) for part in each), np.zeros((3, 3))
        )
        return cls(mass, centre, inertia)

    def scaled(self, mass: float) -> "Weight":
        """Returns the same distribution with another total mass [kg]."""
        return Weight(mass, self.centre, self.inertia * (mass / self.mass))

    def with_center(self, centre: Array) -> "Weight":
        """Returns the mass properties with another center of mass, and the inertia moved to it (parallel axes)."""
        return Weight(self.mass, centre, self.inertia + self.mass * point_inertia(centre - self.centre))


def point_inertia(arm: Array) -> Array:
    """Returns the inertia tensor [m²] of a unit mass at ``arm`` (3,) from the reference point."""
    return np.dot(arm, arm) * np.eye(3) - np.outer(arm, arm)


def ball(radius: float) -> Solid:
    """Returns a ball centered at the origin."""
    volume = 4.0 / 3.0 * pi * radius**3
    return Solid(volume, np.zeros(3), volume * radius**2 / 5.0 * np.eye(3))


def cuboid(half: Array) -> Solid:
    """Returns a box centered at the origin, with half extents (3,)."""
    volume = 8.0 * float(np.prod(half))
    return Solid(volume, np.zeros(3), volume / 3.0 * np.diag(half**2))


def rod(radius: float, half: float) -> Solid:
    """Returns a cylinder along the z axis, with half length ``half``."""
    volume = 2.0 * pi * radius**2 * half
    return Solid(volume, np.zeros(3), volume * np.diag([radius**2 / 4.0, radius**2 / 4.0, half**2 / 3.0]))


def capsule(radius: float, half: float) -> Solid:
    """Returns a capsule along the z axis: a cylinder with half length ``half`` and two hemispherical ends."""
    middle, ends = rod(radius, half), ball(radius)
    # ∫ (half + z)² dV over both half balls; the centroid of a half ball is at 3/8 of the radius.
    along = ends.volume * (radius**2 / 5.0 + half**2 + 0.75 * half * radius)
    across = ends.moments[0, 0]
    moments = middle.moments + np.diag([across, across, along])
    return Solid(middle.volume + ends.volume, np.zeros(3), moments)


def cone(radius: float, half: float) -> Solid:
    """Returns a cone along the z axis, with its base at z = −half and its apex at z = half."""
    height = 2.0 * half
    volume = pi * radius**2 * height / 3.0
    across, along = 3.0 / 20.0 * radius**2, 3.0 / 80.0 * height**2
    return Solid(volume, np.array([0.0, 0.0, -half / 2.0]), volume * np.diag([across, across, along]))


def mesh_solid(mesh: Mesh) -> Solid | None:
    """Returns the solid enclosed by a closed mesh; ``None`` if the mesh encloses no volume."""
    if not mesh.report.volume:
        return None
    middle = mesh.bounds.mean(axis=0)
    corners = (mesh.vertices - middle)[mesh.faces]
    six = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    six *= np.sign(mesh.report.volume)
    volume = float(six.sum()) / 6.0
    top = corners.sum(axis=1)
    centre = six @ top / 24.0 / volume
    second = np.einsum("f,fki,fkj->ij", six, corners, corners) + np.einsum("f,fi,fj->ij", six, top, top)
    return Solid(volume, middle + centre, second / 120.0 - volume * np.outer(centre, centre))


@dataclass(frozen=True)
class ColliderShape:
    """Collider in the frame of its body, or of the world.

    Attributes:
        form: Analytic shape; ``None`` if the collider is a mesh.
        mesh: Mesh in the collider's frame; ``None`` if the collider is a shape.
        position: Origin of the collider's frame in the frame of the body (3,) [m].
        orientation: Rotation from the collider's frame to that of the body, quaternion (x, y, z, w).
        solid: Enclosed solid in the frame of the body; ``None`` if there is none.
        remarks: Notes on the conversion.
    """

    form: Form | None
    mesh: Mesh | None
    position: Array
    orientation: Array
    solid: Solid | None
    remarks: tuple[str, ...] = ()

    def surface(self, name: str) -> Mesh:
        """Returns the surface as a mesh in the collider's frame."""
        if self.mesh is not None:
            return self.mesh
        assert self.form is not None
        return triangles(self.form, name)


def collider_shape(
    shape: dict[str, Any], linear: Array, position: Array, name: str, *, filled: bool
) -> ColliderShape:
    """Returns the shape or mesh of a collider.

    Args:
        shape: Result of ``colliders.shape_of``.
        linear: Linear map from prim to body frame, (3, 3), including scale and units [m].
        position: Origin of the prim in the body frame (3,) [m].
        name: Name of the mesh.
        filled: Whether a closed mesh is a solid, not a cavity.

    Raises:
        InvalidValue: If the mesh cannot be used for contact.
        Unsupported: If the transformation distorts the shape into one without a counterpart.
    """
    kind = shape["kind"]
    if kind == "mesh":
        return _mesh(shape, linear, position, name, filled)
    if kind == "sphere":
        return _sphere(shape["radius"], linear, position)
    if kind == "box":
        return _box(shape["half"], linear, position)
    if kind == "plane":
        normal = np.linalg.solve(linear.T, shape["axes"][2])
        tangent = np.linalg.svd(normal[None])[2][1]
        return ColliderShape(shapes.Plane(), None, position, _rotation_from_axes(tangent, normal), None)
    return _about_axis(shape, linear, position)


def _rotation_from_axes(u: Array, w: Array) -> Array:
    """Returns the rotation whose x and z axes are along two orthogonal directions, as a quaternion."""
    x, z = u / np.linalg.norm(u), w / np.linalg.norm(w)
    return Rotation.from_matrix(np.column_stack([x, np.cross(z, x), z])).as_quat()


def _sphere(radius: float, linear: Array, position: Array) -> ColliderShape:
    axes, sizes, _ = np.linalg.svd(linear)
    solid = ball(radius).transformed(linear, position)
    if sizes[0] - sizes[2] <= _EQUAL * sizes[0]:
        return ColliderShape(
            shapes.Sphere(radius * float(sizes.mean())), None, position, np.array([0.0, 0, 0, 1]), solid
        )
    semi_axes: Any = tuple((radius * sizes).tolist())
    return ColliderShape(
        shapes.Ellipsoid(semi_axes), None, position, _rotation_from_axes(axes[:, 0], axes[:, 2]), solid
    )


def _box(half: Array, linear: Array, position: Array) -> ColliderShape:
    lengths = np.linalg.norm(linear, axis=0)
    _check_square(linear / lengths, "box")
    extents: Any = tuple((half * lengths).tolist())
    solid = cuboid(half).transformed(linear, position)
    return ColliderShape(
        shapes.RoundedBox(extents), None, position, _rotation_from_axes(linear[:, 0], linear[:, 2]), solid
    )


def _check_square(axes: Array, kind: str) -> None:
    if np.abs(axes.T @ axes - np.eye(3)).max() > _EQUAL:
        raise Unsupported(f"a sheared {kind}")


def _about_axis(shape: dict[str, Any], linear: Array, position: Array) -> ColliderShape:
    kind, radius, half, frame = shape["kind"], shape["radius"], shape["half"], shape["axes"].T
    shape_axes = linear @ frame  # columns: x, y and z of the shape in the frame of the body
    lengths = np.linalg.norm(shape_axes, axis=0)
    _check_square(shape_axes / lengths, kind)
    if abs(lengths[0] - lengths[1]) > _EQUAL * lengths[0]:
        raise Unsupported(f"a {kind} with unequal scales across its axis, {lengths[:2].tolist()}")
    if kind == "capsule" and abs(lengths[2] - lengths[0]) > _EQUAL * lengths[0]:
        raise Unsupported(f"a capsule with unequal scales, {lengths.tolist()}")
    make_solid = {"capsule": capsule, "cylinder": rod, "cone": cone}[kind]
    solid = make_solid(radius, half).transformed(shape_axes, position)
    scaled_radius, scaled_half = radius * float(lengths[0]), half * float(lengths[2])
    orientation = _rotation_from_axes(shape_axes[:, 0], shape_axes[:, 2])
    if kind == "capsule":
        return ColliderShape(shapes.Capsule(scaled_radius, scaled_half), None, position, orientation, solid)
    if kind == "cylinder":
        return ColliderShape(shapes.Cylinder(scaled_radius, scaled_half), None, position, orientation, solid)
    return ColliderShape(
        shapes.Cone(scaled_radius, 2.0 * scaled_half), None, position - half * shape_axes[:, 2], orientation, solid
    )


def _mesh(shape: dict[str, Any], linear: Array, position: Array, name: str, filled: bool) -> ColliderShape:
    vertices, faces, approximation_name = shape["vertices"], shape["faces"], shape["approximation"]
    used = vertices[np.unique(faces)]
    approximation = APPROXIMATIONS[approximation_name]
    if approximation == "box":
        lower, upper = used.min(axis=0), used.max(axis=0)
        if (upper <= lower).any():
            raise InvalidValue(
                f"the bounding box of its points must have a volume, got sizes {(upper - lower).tolist()}"
            )
        return _box(0.5 * (upper - lower), linear, position + linear @ (0.5 * (lower + upper)))
    points = used @ linear.T
    if approximation == "sphere":
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        radius = float(np.linalg.norm(points - middle, axis=1).max())
        return _sphere(radius, np.eye(3), position + middle)
    remarks = []
    if approximation == "hull":
        mesh = hull(points, name)
    else:
        if approximation_name != "none":
            remarks.append(f"the approximation {approximation_name} is not applied: the mesh itself is used")
        flipped = faces[:, ::-1] if np.linalg.det(linear) < 0.0 else faces
        mesh = _repaired_if_needed(vertices @ linear.T, flipped, name, remarks)
        if mesh.report.orientation == "inward" and (filled or approximation_name != "none"):
            mesh = mesh.flipped()
            remarks.append("its faces were oriented inward and were flipped")
    solid = mesh_solid(mesh)
    if solid is None and mesh.report.closed is False:
        try:
            solid = mesh_solid(hull(points, name))
        except InvalidValue:
            solid = None  # a flat hull has no mass
    placed = None if solid is None else solid.transformed(np.eye(3), position)
    return ColliderShape(None, mesh, position, np.array([0.0, 0.0, 0.0, 1.0]), placed, tuple(remarks))


def _repaired_if_needed(vertices: Array, faces: Any, name: str, remarks: list[str]) -> Mesh:
    """Returns a mesh, repaired if it is invalid."""
    try:
        return Mesh(vertices, faces, name=name)
    except MeshError:
        try:
            mesh = repaired(_Triangles(vertices, faces), name=name)
        except MeshError as error:
            raise InvalidValue(error) from error
    remarks += [f"its mesh was repaired: {step.text}" for step in mesh.report.repairs if step.count]
    return mesh


@dataclass(frozen=True)
class _Triangles:
    vertices: Array
    faces: Any


def hull(points: Array, name: str) -> Mesh:
    """Returns the convex hull of points (n, 3) as a mesh.

    Raises:
        InvalidValue: If the points are coplanar.
    """
    try:
        found = ConvexHull(points)
    except (QhullError, ValueError) as error:
        raise InvalidValue("the points must not be coplanar, because their convex hull has no volume") from error
    faces, corners = found.simplices, points[found.simplices]
    outward = area_vectors(corners)
    back = (outward * found.equations[:, :3]).sum(axis=1) < 0.0
    faces = np.where(back[:, None], faces[:, ::-1], faces)
    used, numbers = np.unique(faces, return_inverse=True)
    return _repaired_if_needed(points[used], numbers.reshape(-1, 3), name, [])


def triangles(form: Form, name: str) -> Mesh:
    """Returns the surface of a shape as a mesh in its frame; for a plane, a square of side 2 ``REACH``."""
    match form:
        case shapes.Plane():
            corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
            return Mesh(REACH * corners, [[0, 1, 2], [0, 2, 3]], name=name)
        case shapes.RoundedBox():
            signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            return hull(signs * np.array(form.half_extents), name)
        case shapes.Sphere() | shapes.Ellipsoid():
            semi_axes = (form.radius,) * 3 if isinstance(form, shapes.Sphere) else form.semi_axes
            sphere = icosphere(1.0, 3)
            return Mesh(sphere.vertices * np.array(semi_axes), sphere.faces, name=name)
        case shapes.Cylinder():
            return hull(_rings([(form.radius, -form.half_length), (form.radius, form.half_length)]), name)
        case shapes.Cone():
            return hull(np.vstack([_rings([(form.radius, 0.0)]), [[0.0, 0.0, form.height]]]), name)
        case shapes.Capsule():
            angles = np.linspace(0.0, 0.5 * np.pi, _AROUND // 4, endpoint=False)
            ends = [
                (form.radius * np.cos(angle), sign * (form.half_length + form.radius * np.sin(angle)))
                for sign in (-1.0, 1.0)
                for angle in angles
            ]
            tips = [[0.0, 0.0, sign * (form.half_length + form.radius)] for sign in (-1.0, 1.0)]
            return hull(np.vstack([_rings(ends), tips]), name)
    raise Unsupported(f"contact of a {type(form).__name__} with a mesh")


def _rings(profile: list[tuple[float, float]]) -> Array:
    """Returns points on circles about the z axis, given as pairs of radius and height."""
    angles = np.linspace(0.0, 2.0 * np.pi, _AROUND, endpoint=False)
    return np.concatenate(
        [np.column_stack([r * np.cos(angles), r * np.sin(angles), np.full(_AROUND, z)]) for r, z in profile]
    )
