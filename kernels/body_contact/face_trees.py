"""Trees of bounding boxes over the faces of a solid, and queries of its surface by them.

A traversal keeps its pending nodes in one array per thread, above those of the traversal from which it is called.
"""

import warp as wp
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose, scaled
from warpcontact.kernels.body_contact.surface_queries import (
    INFINITE,
    OFFSET,
    PARALLEL,
    BoundingBox,
    SolidGeometry,
    crosses_face,
    distance_to_face,
    plane_offset,
)

double = wp.float64
vec3d = wp.vec3d

# Distance by which a place where a ray enters is preferred to one where it leaves, relative to the size of the solid.
GRAZING = wp.constant(double(1.0e-9))
# Error of the distance along a ray to a plane that is normal to it, relative to the size of the solid.
ROUNDING = wp.constant(double(1.0e-15))
#: Length of the array of pending nodes: three traversals within each other, of trees of up to 2³⁰ leaves.
PENDING_NODES = 96


@wp.struct
class Leaf:
    """A leaf of a tree that a query reaches."""

    first_face: wp.int32
    end_face: wp.int32  # equal to first_face: there is no further leaf
    top: wp.int32  # number of pending nodes


@wp.struct
class Crossing:
    """Where a ray crosses a surface."""

    distance: double  # along the ray; infinite: nowhere [m]
    leaves: wp.int32  # 1: the ray leaves the solid; 0: it enters the solid


@wp.func
def start_traversal(pending: wp.array(dtype=wp.int32), bottom: int, solid: SolidGeometry):
    """Makes the root of a solid the only pending node above ``bottom``, and returns the number of pending nodes."""
    pending[bottom] = solid.root
    return bottom + 1


@wp.func
def next_leaf_in_box(
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    top: int,
    geometries: Geometries,
    solid: SolidGeometry,
    pose: RelativePose,
    box: BoundingBox,
):
    """Returns the next ``Leaf`` of a solid whose bounding box meets a box.

    Args:
        pending: Pending nodes of the thread.
        bottom: Number of pending nodes of other traversals.
        top: Number of pending nodes.
        geometries: The geometries.
        solid: The solid.
        pose: Pose of the solid in the frame of the box.
        box: The box.
    """
    leaf = Leaf()
    while top > bottom:
        top -= 1
        node = geometries.node[pending[top]]
        lower = scaled(geometries.node_lower[pending[top]], solid.scale)
        upper = scaled(geometries.node_upper[pending[top]], solid.scale)
        half = double(0.5) * (upper - lower)
        center = pose.rotation * (lower + half) + pose.origin
        reach = wp.abs(pose.rotation[0, 0]) * half[0] + wp.abs(pose.rotation[0, 1]) * half[1]
        reach += wp.abs(pose.rotation[0, 2]) * half[2]
        apart = center[0] + reach < box.lower[0] or center[0] - reach > box.upper[0]
        if not apart:
            reach = wp.abs(pose.rotation[1, 0]) * half[0] + wp.abs(pose.rotation[1, 1]) * half[1]
            reach += wp.abs(pose.rotation[1, 2]) * half[2]
            apart = center[1] + reach < box.lower[1] or center[1] - reach > box.upper[1]
        if not apart:
            reach = wp.abs(pose.rotation[2, 0]) * half[0] + wp.abs(pose.rotation[2, 1]) * half[1]
            reach += wp.abs(pose.rotation[2, 2]) * half[2]
            apart = center[2] + reach < box.lower[2] or center[2] - reach > box.upper[2]
        if apart:
            continue
        if node[0] < 0:
            leaf.first_face = node[1]
            leaf.end_face = node[2]
            leaf.top = top
            return leaf
        pending[top] = node[0]
        pending[top + 1] = node[0] + 1
        top += 2
    leaf.top = bottom
    return leaf


@wp.func
def entry_of_ray(lower: vec3d, upper: vec3d, origin: vec3d, direction: vec3d, farthest: double):
    """Returns the distance at which a ray enters a box, at least 0; infinite if it does not before ``farthest`` [m]."""
    near = double(0.0)
    far = farthest
    for i in range(3):
        if direction[i] == double(0.0):
            if origin[i] < lower[i] or origin[i] > upper[i]:
                return INFINITE
        else:
            first = (lower[i] - origin[i]) / direction[i]
            second = (upper[i] - origin[i]) / direction[i]
            near = wp.max(near, wp.min(first, second))
            far = wp.min(far, wp.max(first, second))
    if near > far:
        return INFINITE
    return near


@wp.func
def first_crossing(
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    geometries: Geometries,
    solid: SolidGeometry,
    origin: vec3d,
    direction: vec3d,
    only_exits: bool,
):
    """Returns where a ray in the frame of a solid first crosses its surface.

    Args:
        pending: Pending nodes of the thread.
        bottom: Number of pending nodes of other traversals.
        geometries: The geometries.
        solid: The solid; not a half-space.
        origin: Start of the ray [m].
        direction: Unit vector.
        only_exits: Whether to ignore places where the ray enters the solid.
    """
    result = Crossing()
    result.distance = INFINITE
    nearest = OFFSET * wp.length(solid.half_extents)
    # Crossings beyond are not the first one.
    farthest = INFINITE
    top = start_traversal(pending, bottom, solid)
    while top > bottom:
        top -= 1
        node = geometries.node[pending[top]]
        # The bounds include a margin for rounding.
        lower = scaled(geometries.node_lower[pending[top]], solid.scale)
        upper = scaled(geometries.node_upper[pending[top]], solid.scale)
        if entry_of_ray(lower, upper, origin, direction, farthest) == INFINITE:
            continue
        if node[0] >= 0:
            pending[top] = node[0]
            pending[top + 1] = node[0] + 1
            top += 2
            continue
        for face in range(node[1], node[2]):
            normal = geometries.normal[face]
            cosine = wp.dot(normal, direction)
            if wp.abs(cosine) < PARALLEL or (only_exits and cosine < double(0.0)):
                continue
            distance = (plane_offset(geometries, solid, face) - wp.dot(normal, origin)) / cosine
            if distance < nearest:
                continue
            # A ray that enters and leaves at an edge does not come from inside. The distance to a face that is nearly parallel to
            # the ray is inaccurate.
            margin = ROUNDING / cosine
            if cosine < double(0.0):
                margin -= GRAZING
            bound = distance + margin * wp.length(solid.half_extents)
            if bound >= farthest:
                continue
            if crosses_face(
                geometries, solid, face, origin, wp.where(cosine > double(0.0), direction, -direction)
            ):
                farthest = bound
                result.distance = distance
                result.leaves = wp.where(cosine > double(0.0), 1, 0)
    return result


@wp.func
def distance_from_box(lower: vec3d, upper: vec3d, position: vec3d):
    """Returns the distance of a point from a box, 0 inside [m]."""
    return wp.length(wp.max(wp.max(lower - position, position - upper), vec3d()))


@wp.func
def distance_to_surface(
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    geometries: Geometries,
    solid: SolidGeometry,
    position: vec3d,
    limit: double,
    enough: double,
):
    """Returns the distance of a point from the surface of a solid, or ``limit`` if it is larger [m].

    If it is at most ``enough``, a distance between it and ``enough`` is returned.

    Args:
        pending: Pending nodes of the thread.
        bottom: Number of pending nodes of other traversals.
        geometries: The geometries.
        solid: The solid.
        position: The point, in the frame of the solid [m].
        limit: Largest distance that matters [m].
        enough: Distance at which the search ends [m].
    """
    least = limit
    top = start_traversal(pending, bottom, solid)
    while top > bottom:
        top -= 1
        number = pending[top]
        lower = scaled(geometries.node_lower[number], solid.scale)
        upper = scaled(geometries.node_upper[number], solid.scale)
        if distance_from_box(lower, upper, position) >= least:
            continue
        node = geometries.node[number]
        child = node[0]
        if child < 0:
            for face in range(node[1], node[2]):
                least = wp.min(least, distance_to_face(geometries, solid, face, position))
            if least <= enough:
                return least
            continue
        # The nearer child is next.
        first = distance_from_box(
            scaled(geometries.node_lower[child], solid.scale),
            scaled(geometries.node_upper[child], solid.scale),
            position,
        )
        second = distance_from_box(
            scaled(geometries.node_lower[child + 1], solid.scale),
            scaled(geometries.node_upper[child + 1], solid.scale),
            position,
        )
        nearer = wp.where(first <= second, child, child + 1)
        pending[top] = 2 * child + 1 - nearer
        pending[top + 1] = nearer
        top += 2
    return least


@wp.func
def is_inside_solid(
    pending: wp.array(dtype=wp.int32),
    bottom: int,
    geometries: Geometries,
    solid: SolidGeometry,
    position: vec3d,
    direction: vec3d,
):
    """Returns whether a point is inside a solid.

    Args:
        pending: Pending nodes of the thread.
        bottom: Number of pending nodes of other traversals.
        geometries: The geometries.
        solid: The solid.
        position: The point, in the frame of the solid [m].
        direction: Direction of a ray, whose first crossing with the surface decides.
    """
    return first_crossing(pending, bottom, geometries, solid, position, direction, False).leaves != 0
