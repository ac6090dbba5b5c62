"""Trees over the normals of a convex solid: those of its planes, and those of its convex edges, between the normals of two faces.

A normal n and the offset n·p of a point p of its plane or edge are a point of four dimensions, and nodes are boxes of such points.
The height n·(x − p) of a point x above all planes or edges of a node has an upper bound by one box.
"""

import warp as wp
from warpcontact.kernels.body_contact.solids import Geometries
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry, plane_offset
from warpcontact.kernels.manifolds.features import Features

double = wp.float64
vec3d = wp.vec3d


@wp.struct
class NormalLeaf:
    """A leaf of a tree of normals that a traversal reaches."""

    first: wp.int32  # of its planes or edges in ``Features.normal_item``
    end: wp.int32  # equal to ``first``: there is no further leaf
    top: wp.int32  # number of pending nodes


@wp.struct
class NormalPoint:
    """A position from the center of a geometry, and a height, in its unit."""

    position: vec3d
    limit: double


@wp.func
def in_unit(side: SolidGeometry, position: vec3d, limit: double):
    """Returns a position in the frame of a solid and a height as a ``NormalPoint`` [m].

    Trees of boxes, which may have different scales along their axes, are one leaf, so that their bounds are not used.
    """
    result = NormalPoint()
    result.position = wp.cw_div(position - side.center, side.scale)
    result.limit = limit / side.scale[0]
    return result


@wp.func
def height_bound(features: Features, node: int, position: vec3d):
    """Returns an upper bound of the height of a position above planes or edges of a node, as ``NormalPoint``."""
    lower = features.normal_lower[node]
    upper = features.normal_upper[node]
    bound = -lower[3]
    for i in range(3):
        bound += wp.max(lower[i] * position[i], upper[i] * position[i])
    return bound


@wp.func
def next_normals(pending: wp.array(dtype=wp.int32), bottom: int, top: int, features: Features, point: NormalPoint):
    """Returns the next ``NormalLeaf`` with planes or edges above which a point may be higher than its limit.

    ``pending``: pending nodes of the thread; the first ``bottom`` are those of others, and there are ``top``.
    """
    leaf = NormalLeaf()
    while top > bottom:
        top -= 1
        node = features.normal_node[pending[top]]
        if node[0] < 0:
            leaf.first = node[1]
            leaf.end = node[2]
            leaf.top = top
            return leaf
        bound = height_bound(features, node[0], point.position)
        bound_2 = height_bound(features, node[0] + 1, point.position)
        # The one with the larger bound first.
        first = wp.where(bound > bound_2, 1, 0)
        if wp.min(bound, bound_2) > point.limit:
            pending[top] = node[0] + first
            top += 1
        if wp.max(bound, bound_2) > point.limit:
            pending[top] = node[0] + 1 - first
            top += 1
    leaf.top = bottom
    return leaf


@wp.func
def height_above_plane(geometries: Geometries, own: SolidGeometry, plane: int, position: vec3d):
    """Returns the height of a point above a plane of a solid, in its frame [m]."""
    face = geometries.plane_face[plane]
    return wp.dot(geometries.normal[face], position) - plane_offset(geometries, own, face)


@wp.func
def highest_plane_above(
    geometries: Geometries,
    features: Features,
    own: SolidGeometry,
    geometry: int,
    position: vec3d,
    limit: double,
    pending: wp.array(dtype=wp.int32),
):
    """Returns the plane above which a point is highest and the height [m]; −1 and ``limit`` if it is not higher than ``limit``."""
    best = wp.int32(-1)
    highest = limit
    point = in_unit(own, position, limit)
    pending[0] = features.plane_root[geometry]
    leaf = next_normals(pending, 0, 1, features, point)
    while leaf.end > leaf.first:
        for i in range(leaf.first, leaf.end):
            plane = features.normal_item[i]
            height = height_above_plane(geometries, own, plane, position)
            if height > highest:
                highest = height
                best = plane
        point.limit = highest / own.scale[0]
        leaf = next_normals(pending, 0, leaf.top, features, point)
    return best, highest
