"""One solid of a pair: its bounding box, and distances from one of its faces."""

import warp as wp
from warpcontact.kernels.body_contact.solids import (
    Geometries,
    RelativePose,
    SolidPose,
    corner_count,
    face_vertex,
    inverse_pose,
    scaled,
)

double = wp.float64
vec3d = wp.vec3d

# Cosine of two normals below which a face is parallel to a ray.
PARALLEL = wp.constant(double(1.0e-12))
# Offset of a search from the point where it starts, relative to the size of the solid.
OFFSET = wp.constant(double(1.0e-12))
# Distance from an edge, relative to its length, up to which a point beyond it counts as on the face.
EDGE_TOLERANCE = wp.constant(double(1.0e-12))
# Distance from an edge, relative to the size of the solid, up to which a line beyond it crosses the face. Larger than the distance
# that a line covers across a face to which it counts as parallel.
LINE_TOLERANCE = wp.constant(double(1.0e-11))
INFINITE = wp.constant(double(wp.inf))


@wp.struct
class SolidGeometry:
    """One solid of a pair."""

    first_face: wp.int32
    end_face: wp.int32
    root: wp.int32  # of its tree of faces
    first_plane: wp.int32
    end_plane: wp.int32
    flags: wp.int32  # of its geometry
    scale: vec3d  # [m per unit]
    center: vec3d  # of its bounding box [m]
    half_extents: vec3d  # of its bounding box [m]


@wp.func
def solid_geometry(geometries: Geometries, pose: SolidPose):
    """Returns the ``SolidGeometry`` of a solid."""
    side = SolidGeometry()
    side.first_face = geometries.face_start[pose.geometry]
    side.end_face = geometries.face_start[pose.geometry + 1]
    side.root = geometries.root[pose.geometry]
    side.first_plane = geometries.plane_start[pose.geometry]
    side.end_plane = geometries.plane_start[pose.geometry + 1]
    side.flags = geometries.flags[pose.geometry]
    side.scale = pose.scale
    side.center = scaled(geometries.center[pose.geometry], pose.scale)
    side.half_extents = scaled(geometries.half_extents[pose.geometry], pose.scale)
    return side


@wp.func
def largest_extent(side: SolidGeometry):
    """Returns the largest edge of the bounding box of a solid [m]."""
    return double(2.0) * wp.max(side.half_extents)


@wp.struct
class BoundingBox:
    """A box with the axes of a frame."""

    lower: vec3d  # [m]
    upper: vec3d  # [m]


@wp.struct
class SolidMotion:
    """Bounds of the motion of a solid, and the plane of a half-space."""

    place: vec3d  # center of mass of its body, or its origin in the world, W [m]
    radius: double  # of a sphere around this place that contains it [m]
    speed: double  # of this place [m/s]
    spin: double  # angular speed [rad/s]
    extent: double  # largest edge of its bounding box; infinite for half-spaces and open surfaces [m]
    normal: vec3d  # of a half-space, outward, W; others: zero
    offset: double  # of the plane of a half-space along its normal [m]


@wp.struct
class SolidBoxes:
    """Boxes around solids with world axes, and bounds of their motion: [env, solid]."""

    box: wp.array2d(dtype=BoundingBox)
    motion: wp.array2d(dtype=SolidMotion)


@wp.func
def bounding_box(solid: SolidGeometry, pose: RelativePose, margin: double):
    """Returns a box in another frame around the bounding box of a solid.

    Args:
        solid: The solid.
        pose: Its pose in the other frame.
        margin: Distance of the faces of the box from the solid [m].
    """
    center = pose.rotation * solid.center + pose.origin
    reach = vec3d(margin, margin, margin)
    for i in range(3):
        for k in range(3):
            reach[i] = reach[i] + wp.abs(pose.rotation[i, k]) * solid.half_extents[k]
    result = BoundingBox()
    result.lower = center - reach
    result.upper = center + reach
    return result


@wp.func
def are_boxes_apart(first: BoundingBox, second: BoundingBox):
    """Returns whether two boxes of one frame have no common point."""
    gap = wp.max(first.lower - second.upper, second.lower - first.upper)
    return wp.max(gap) > double(0.0)


@wp.func
def are_apart(first: SolidGeometry, second: SolidGeometry, first_in_second: RelativePose, margin: double):
    """Returns whether an axis of one of their bounding boxes separates two solids by more than ``margin`` [m]."""
    for side in range(2):
        own = second
        other = first
        pose = first_in_second
        if side == 1:
            own = first
            other = second
            pose = inverse_pose(first_in_second)
        box = BoundingBox()
        box.lower = own.center - own.half_extents
        box.upper = own.center + own.half_extents
        if are_boxes_apart(box, bounding_box(other, pose, margin)):
            return True
    return False


@wp.func
def is_face_outside(geometries: Geometries, solid: SolidGeometry, face: int, box: BoundingBox):
    """Returns whether a face of a solid is outside a box in the frame of the solid."""
    vertices = geometries.face[face]
    own = BoundingBox()
    own.lower = face_vertex(geometries, vertices, 0, solid.scale)
    own.upper = own.lower
    for i in range(1, corner_count(vertices)):
        vertex = face_vertex(geometries, vertices, i, solid.scale)
        own.lower = wp.min(own.lower, vertex)
        own.upper = wp.max(own.upper, vertex)
    return are_boxes_apart(own, box)


@wp.func
def plane_offset(geometries: Geometries, side: SolidGeometry, face: int):
    """Returns the offset of the plane of a face along its normal [m]."""
    normal = geometries.normal[face]
    return geometries.offset[face] * wp.dot(wp.cw_mul(normal, normal), side.scale)


@wp.func
def is_on_face(geometries: Geometries, side: SolidGeometry, face: int, position: vec3d):
    """Returns whether a point of the plane of a face is on the face."""
    normal = geometries.normal[face]
    vertices = geometries.face[face]
    count = corner_count(vertices)
    previous = face_vertex(geometries, vertices, count - 1, side.scale)
    for i in range(count):
        current = face_vertex(geometries, vertices, i, side.scale)
        edge = current - previous
        # A point on a common edge is on both faces.
        if wp.dot(wp.cross(edge, position - previous), normal) < -EDGE_TOLERANCE * wp.length_sq(edge):
            return False
        previous = current
    return True


@wp.func
def crosses_face(geometries: Geometries, side: SolidGeometry, face: int, origin: vec3d, direction: vec3d):
    """Returns whether a line, along which one leaves the solid at a face, passes through the face.

    A line through a common edge passes through both faces, also if it is nearly parallel to one of them.
    """
    vertices = geometries.face[face]
    count = corner_count(vertices)
    tolerance = LINE_TOLERANCE * wp.length(side.half_extents)
    previous = face_vertex(geometries, vertices, count - 1, side.scale)
    for i in range(count):
        current = face_vertex(geometries, vertices, i, side.scale)
        edge = current - previous
        if wp.dot(wp.cross(edge, origin - previous), direction) < -tolerance * wp.length(edge):
            return False
        previous = current
    return True


@wp.func
def distance_to_segment(position: vec3d, start: vec3d, end: vec3d):
    """Returns the distance of a point from a segment [m]."""
    along = end - start
    fraction = wp.clamp(wp.dot(position - start, along) / wp.dot(along, along), double(0.0), double(1.0))
    return wp.length(position - start - fraction * along)


@wp.func
def distance_to_face(geometries: Geometries, side: SolidGeometry, face: int, position: vec3d):
    """Returns the distance of a point from a face [m]."""
    normal = geometries.normal[face]
    height = wp.dot(normal, position) - plane_offset(geometries, side, face)
    if is_on_face(geometries, side, face, position - height * normal):
        return wp.abs(height)
    vertices = geometries.face[face]
    count = corner_count(vertices)
    previous = face_vertex(geometries, vertices, count - 1, side.scale)
    least = INFINITE
    for i in range(count):
        current = face_vertex(geometries, vertices, i, side.scale)
        least = wp.min(least, distance_to_segment(position, previous, current))
        previous = current
    return least
