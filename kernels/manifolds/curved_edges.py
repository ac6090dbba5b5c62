"""Contact of a curved solid with an edge or a vertex of a polyhedron.

The separation along a direction n normal to an edge is that of the lowest point of the curved solid from the edge. Its maxima over the
directions between the normals of both faces are searched one by one: the arc is divided where another piece of the solid becomes the
lowest one and where it is nearest to the axis of a circle, and where the slope changes sign within a part or between two parts, there
is one. If the lowest point is beyond an end of the edge, the vertex there may have the contact.
"""

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import CAPSULE
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose, corner_count
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.manifolds.curved_hull import (
    ALONG_AXIS,
    CIRCLES,
    ONE_ELLIPSOID,
    CurvedHull,
    PointContact,
    curvature_radius,
    lower_piece,
    lowest_of_piece,
    nearest_surface_point,
)
from warpcontact.kernels.manifolds.curved_separation import CurvedPair
from warpcontact.kernels.manifolds.features import Features, moved, vertex_position
from warpcontact.kernels.manifolds.separation import edge_bound, height_above_plane

double = wp.float64
vec3d = wp.vec3d
zero, half, one = (wp.constant(double(value)) for value in (0.0, 0.5, 1.0))

# Sine up to which a direction counts as perpendicular to an edge.
PERPENDICULAR = wp.constant(double(1.0e-9))
# Distance from the end of an edge, relative to its length, up to which a point is at the vertex.
AT_VERTEX = wp.constant(double(1.0e-9))
# Sine up to which two directions of an arc are equal, and length of a projected axis up to which it has no direction.
SAME_DIRECTION, NO_DIRECTION = (wp.constant(double(value)) for value in (1.0e-15, 1.0e-14))
# Slope at a maximum, relative to the size, and largest number of steps to it.
FLAT, MAX_STEPS = wp.constant(double(4.0e-15)), 60
#: Largest number of parts of an arc: less than 180° between directions that are 90° or two arbitrary angles apart.
MAX_PARTS = 5


@wp.struct
class EdgeContact:
    """The contact of a curved solid with an edge or one of its ends, in the frame of the polyhedron."""

    gap: double  # negative in overlap; −∞: there is none [m]
    normal: vec3d  # towards the curved solid
    on_curved: vec3d  # [m]
    on_edge: vec3d  # [m]
    vertex: wp.int32  # the end; −1: none
    edge: wp.int32


@wp.struct
class Line:
    """An edge as a line, and the arc of directions between the normals of its faces."""

    start: vec3d  # [m]
    axis: vec3d  # unit vector
    length: double  # [m]
    first: vec3d  # unit vectors normal to the line; the second one is ahead of the first one about the axis
    second: vec3d


@wp.func
def turned_before(line: Line, one_direction: vec3d, other: vec3d):
    """Returns whether a direction of an arc is before another one."""
    return wp.dot(wp.cross(one_direction, other), line.axis) > SAME_DIRECTION


@wp.func
def slope_towards(hull: CurvedHull, piece: int, line: Line, n: vec3d, side: double):
    """Returns the rate of the separation from a line at a direction of its arc, seen from one side, and the lowest point [m].

    ``side``: 1 ahead of the direction, −1 behind it; it matters along the axis of a circle.
    """
    tangent = wp.cross(line.axis, n)
    lowest = lowest_of_piece(hull, piece, n)
    slope = wp.dot(tangent, lowest - line.start)
    if hull.kind == CIRCLES:
        along = wp.dot(n, hull.axis)
        if wp.length(n - along * hull.axis) <= ALONG_AXIS:
            slope -= side * wp.where(piece == 1, hull.second_radius, hull.first_radius)
    return slope, lowest


@wp.func
def highest_between(
    hull: CurvedHull,
    piece: int,
    line: Line,
    first: vec3d,
    last: vec3d,
    first_slope: double,
    last_slope: double,
    tolerance: double,
):
    """Returns the direction between two others with the largest separation of a piece from a line.

    The slopes at both are positive and negative [m]. ``tolerance``: slope that counts as zero [m].
    """
    n = wp.normalize(first_slope * last - last_slope * first)
    before = wp.min(first_slope, -last_slope)
    # A loop bound in a variable, so that Warp does not unroll.
    steps = wp.int32(MAX_STEPS)
    for _ in range(steps):
        tangent = wp.cross(line.axis, n)
        between = lowest_of_piece(hull, piece, n) - line.start
        slope = wp.dot(tangent, between)
        if wp.abs(slope) <= tolerance:
            break
        if slope > zero:
            first = n
        else:
            last = n
        trial = first + last
        # Newton's step, if it stays between both and the last one was good. It is exact for a ball.
        curvature = wp.dot(n, between) + curvature_radius(hull, piece, n, tangent)
        if curvature > zero and wp.abs(slope) <= before:
            step = n + (slope / curvature) * tangent
            if turned_before(line, first, step) and turned_before(line, step, last):
                trial = step
        before = double(0.5) * wp.abs(slope)
        if not turned_before(line, first, last):
            break
        n = wp.normalize(trial)
    return n


@wp.func
def beyond_maximum(
    hull: CurvedHull, piece: int, line: Line, start: vec3d, end: vec3d, start_slope: double, tolerance: double
):
    """Returns a direction behind the first maximum of the separation from ``start`` towards ``end``, and the slope there [m].

    Without a maximum before the separation becomes a convex function, returns ``start`` and its slope. Newton's steps towards a
    maximum near the axis of a circle that is seen from its side do not pass it by far. ``tolerance``: slope that counts as zero [m].
    """
    side = wp.sign(start_slope)
    n = vec3d(start)
    slope = double(start_slope)
    steps = wp.int32(MAX_STEPS)
    for _ in range(steps):
        tangent = wp.cross(line.axis, n)
        between = lowest_of_piece(hull, piece, n) - line.start
        height = wp.dot(n, between)
        curvature = height + curvature_radius(hull, piece, n, tangent)
        if height >= zero or curvature <= zero:
            break
        step = wp.normalize(n + (slope / curvature) * tangent)
        if side * wp.dot(wp.cross(step, end), line.axis) <= zero:
            break
        n = step
        tangent = wp.cross(line.axis, n)
        slope = wp.dot(tangent, lowest_of_piece(hull, piece, n) - line.start)
        if side * slope <= tolerance:
            return n, side * wp.min(side * slope, zero)
    return start, start_slope


@wp.func
def maximum_within(
    hull: CurvedHull,
    piece: int,
    line: Line,
    first: vec3d,
    last: vec3d,
    first_slope: double,
    last_slope: double,
    tolerance: double,
):
    """Returns the direction between two others with a maximum of the separation of a piece from a line; zero if there is none.

    ``first_slope``, ``last_slope``: slopes at both, seen from between them [m]. ``tolerance``: slope that counts as zero [m].
    """
    lower = vec3d(first)
    upper = vec3d(last)
    lower_slope = double(first_slope)
    upper_slope = double(last_slope)
    if hull.kind == CIRCLES and first_slope * last_slope > zero:
        # Two extrema, or none.
        rises = first_slope > zero
        start = wp.where(rises, first, last)
        end = wp.where(rises, last, first)
        start_slope = wp.where(rises, first_slope, last_slope)
        turned, turned_slope = beyond_maximum(hull, piece, line, start, end, start_slope, tolerance)
        if rises:
            upper = turned
            upper_slope = turned_slope
        else:
            lower = turned
            lower_slope = turned_slope
    if lower_slope < zero or upper_slope > zero or lower_slope == upper_slope:
        return vec3d()
    return highest_between(hull, piece, line, lower, upper, lower_slope, upper_slope, tolerance)


@wp.func
def next_direction(hull: CurvedHull, line: Line, current: vec3d):
    """Returns the first direction behind ``current`` at which an arc is divided, or its end."""
    following = line.second
    along = hull.axis - wp.dot(hull.axis, line.axis) * line.axis
    size = wp.length(along)
    if hull.height == zero or size <= NO_DIRECTION:
        return following
    along = along / size
    aside = wp.cross(line.axis, along)
    directions = wp.int32(wp.where(hull.kind == CIRCLES, 4, 2))
    for k in range(directions):
        side = wp.where(k % 2 == 0, one, -one)
        trial = side * along
        if k < 2:
            cosine = hull.slope / size
            if wp.abs(cosine) > one:
                continue
            trial = cosine * along + (side * wp.sqrt(one - cosine * cosine)) * aside
        if turned_before(line, current, trial) and turned_before(line, trial, following):
            following = trial
    return following


@wp.func
def contact_with_line(hull: CurvedHull, line: Line):
    """Returns the contact of a curved solid with a line, at the largest separation along the directions of its arc.

    Also returns where on the line the lowest points along other directions with larger separations are: at a maximum beyond the
    ends of the edge, or without any maximum at the better end of the arc, as a fraction of the length; 0.5 if there are none.
    """
    result = PointContact()
    result.gap = -double(wp.inf)
    # The largest separation at a maximum with its point beyond the ends, and at an end of the arc.
    highest = -double(wp.inf)
    highest_end = -double(wp.inf)
    beyond = double(0.5)
    at_arc_end = double(0.5)
    tolerance = FLAT * (wp.length(hull.first - line.start) + hull.first_radius + hull.height)
    current = line.first
    last_slope = -double(wp.inf)
    last_point = vec3d()
    has_maximum = wp.bool(False)
    parts = wp.int32(MAX_PARTS)
    for part in range(parts):
        following = next_direction(hull, line, current)
        middle = wp.normalize(current + following)
        piece = lower_piece(hull, middle)
        slope, lowest = slope_towards(hull, piece, line, current, one)
        end_slope, end_point = slope_towards(hull, piece, line, following, -one)
        places = wp.int32(2)
        for k in range(places):
            n = current
            point = lowest
            is_maximum = wp.bool(False)
            if k == 0:
                # Between two parts; along the axis of a circle, a flat end has the contact.
                along = wp.dot(n, hull.axis)
                is_maximum = part > 0 and last_slope >= zero and slope <= zero
                if is_maximum and hull.kind == CIRCLES:
                    is_maximum = wp.length(n - along * hull.axis) > ALONG_AXIS
                if is_maximum and last_slope > slope:
                    point = last_point + (last_slope / (last_slope - slope)) * (lowest - last_point)
            else:
                within = maximum_within(hull, piece, line, current, following, slope, end_slope, tolerance)
                if wp.length_sq(within) > zero:
                    is_maximum = True
                    n = within
                    point = lowest_of_piece(hull, piece, within)
            if is_maximum:
                has_maximum = True
                gap = wp.dot(n, point - line.start)
                fraction = wp.dot(line.axis, point - line.start) / line.length
                if fraction >= zero and fraction <= one:
                    if gap > result.gap:
                        result.gap = gap
                        result.normal = n
                        result.on_curved = point
                elif gap > highest:
                    highest = gap
                    beyond = fraction
        if part == 0:
            highest_end = wp.dot(current, lowest - line.start)
            at_arc_end = wp.dot(line.axis, lowest - line.start) / line.length
        current = following
        last_slope = end_slope
        last_point = end_point
        if not turned_before(line, following, line.second):
            break
    if not has_maximum:
        beyond = at_arc_end
        if wp.dot(line.second, last_point - line.start) > highest_end:
            beyond = wp.dot(line.axis, last_point - line.start) / line.length
    elif highest <= result.gap:
        beyond = double(0.5)
    return result, beyond


@wp.func
def leaves_face(
    geometries: Geometries,
    own: SolidGeometry,
    face: int,
    vertex: int,
    direction: vec3d,
):
    """Returns whether a direction from a vertex leads away from both of its edges of a face."""
    vertices = geometries.face[face]
    count = corner_count(vertices)
    place = vertex_position(geometries, vertex, own)
    for i in range(count):
        following = wp.where(i == count - 1, 0, i + 1)
        neighbor = wp.int32(-1)
        if vertices[i] == vertex:
            neighbor = vertices[following]
        elif vertices[following] == vertex:
            neighbor = vertices[i]
        if neighbor >= 0:
            edge = wp.normalize(vertex_position(geometries, neighbor, own) - place)
            if wp.dot(direction, edge) > PERPENDICULAR:
                return False
    return True


@wp.func
def leaves_vertex(geometries: Geometries, features: Features, own: SolidGeometry, vertex: int, direction: vec3d):
    """Returns whether a direction from a vertex of a convex polyhedron leads away from all of its edges."""
    place = vertex_position(geometries, vertex, own)
    for i in range(features.neighbor_start[vertex], features.neighbor_start[vertex + 1]):
        edge = wp.normalize(vertex_position(geometries, features.neighbor[i], own) - place)
        if wp.dot(direction, edge) > PERPENDICULAR:
            return False
    return True


@wp.func
def contact_of_ellipsoid(other: SolidGeometry, pose: RelativePose, position: vec3d):
    """Returns the contact of an ellipsoid with a point.

    The point y has the nearest point x of an ellipsoid with the semi-axes a if yᵢ = (1 + t/aᵢ²) xᵢ. The largest such t is a root of a
    convex function, to which Newton's method rises from a lower bound.
    """
    result = PointContact()
    result.gap = -double(wp.inf)
    local = wp.transpose(pose.rotation) * (position - pose.origin)
    axes = other.scale
    squares = wp.cw_mul(axes, axes)
    size = wp.max(squares)
    t = wp.max(wp.cw_mul(axes, wp.abs(local)) - squares)
    outward = vec3d()
    steps = wp.int32(MAX_STEPS)
    for _ in range(steps):
        shifted = squares + vec3d(t, t, t)
        if wp.min(shifted) <= FLAT * size:
            # Near the plane or the center in which the nearest point is not unique.
            return result
        outward = wp.cw_div(local, shifted)
        scaled_normal = wp.cw_mul(axes, outward)
        square = wp.length_sq(scaled_normal)
        step = half * (square - one) / wp.dot(scaled_normal, wp.cw_div(scaled_normal, shifted))
        t += step
        if step <= FLAT * size:
            break
    length = wp.length(outward)
    result.gap = t * length
    result.normal = -(pose.rotation * outward) / length
    result.on_curved = position + result.gap * result.normal
    return result


@wp.func
def contact_with_vertex(hull: CurvedHull, other: SolidGeometry, pose: RelativePose, position: vec3d):
    """Returns the contact of a curved solid with a vertex at ``position``; flat ends do not count."""
    if hull.kind == ONE_ELLIPSOID:
        return contact_of_ellipsoid(other, pose, position)
    return nearest_surface_point(hull, position, False)


@wp.func
def contact_with_edge(
    geometries: Geometries,
    features: Features,
    own: SolidGeometry,
    number: int,
    other: SolidGeometry,
    pose: RelativePose,
    hull: CurvedHull,
    depth: double,
):
    """Returns the ``EdgeContact`` of a convex edge of a polyhedron with the largest separation from a curved solid.

    Args:
        geometries: The geometries.
        features: Their features.
        own: The polyhedron.
        number: The edge.
        other: The curved solid.
        pose: Its pose in the frame of the polyhedron.
        hull: The curved solid in that frame.
        depth: Largest depth of a contact [m].
    """
    result = EdgeContact()
    result.gap = -double(wp.inf)
    result.vertex = -1
    result.edge = number
    edge = features.edge[number]
    line = Line()
    line.start = vertex_position(geometries, edge[0], own)
    end = vertex_position(geometries, edge[1], own)
    line.length = wp.length(end - line.start)
    line.axis = (end - line.start) / line.length
    normal = geometries.normal[edge[2]]
    line.first = wp.normalize(normal - wp.dot(normal, line.axis) * line.axis)
    normal = geometries.normal[edge[3]]
    line.second = wp.normalize(normal - wp.dot(normal, line.axis) * line.axis)
    found, beyond = contact_with_line(hull, line)
    if found.gap >= -depth:
        result.gap = found.gap
        result.normal = found.normal
        result.on_curved = found.on_curved
        result.on_edge = found.on_curved - found.gap * found.normal
        fraction = wp.dot(found.on_curved - line.start, line.axis) / line.length
        if fraction <= AT_VERTEX:
            result.vertex = edge[0]
        elif fraction >= one - AT_VERTEX:
            result.vertex = edge[1]
    if beyond < zero or beyond > one:
        vertex = wp.where(beyond < zero, edge[0], edge[1])
        position = vertex_position(geometries, vertex, own)
        at_vertex = contact_with_vertex(hull, other, pose, position)
        if at_vertex.gap > result.gap and at_vertex.gap >= -depth:
            if (
                leaves_face(geometries, own, edge[2], vertex, at_vertex.normal)
                and leaves_face(geometries, own, edge[3], vertex, at_vertex.normal)
                and leaves_vertex(geometries, features, own, vertex, at_vertex.normal)
            ):
                result.gap = at_vertex.gap
                result.normal = at_vertex.normal
                result.on_curved = at_vertex.on_curved
                result.on_edge = position
                result.vertex = vertex
    return result


@wp.func
def is_largest_of_all(hull: CurvedHull, contact: EdgeContact, tolerance: double):
    """Returns whether it is certain that no direction has a larger separation than a contact with an edge of a convex polyhedron.

    ``tolerance``: rounding of separations [m].
    """
    if contact.gap >= zero:
        return True
    if contact.gap == -double(wp.inf) or hull.kind == ONE_ELLIPSOID:
        return False
    # No separation is larger than the distance of a point of the polyhedron from the curved solid.
    found = nearest_surface_point(hull, contact.on_edge, True)
    return found.gap > -double(wp.inf) and found.gap <= contact.gap + tolerance


@wp.func
def largest_edge_contact(
    geometries: Geometries,
    features: Features,
    geometry: int,
    pair: CurvedPair,
    hull: CurvedHull,
    known: EdgeContact,
    near: vec3d,
    least: double,
    margin: double,
):
    """Returns the ``EdgeContact`` of a convex polyhedron with the largest separation, the first one above ``margin`` if there is one.

    Args:
        geometries: The geometries.
        features: Their features.
        geometry: That of the polyhedron.
        pair: The pair.
        hull: The curved solid in the frame of the polyhedron.
        known: A contact, which is returned if there is no larger separation.
        near: A point of the curved solid near the polyhedron [m].
        least: Separation above which edges matter [m].
        margin: Separation that ends the search [m].
    """
    own = pair.own
    result = EdgeContact()
    result.gap = known.gap
    result.normal = known.normal
    result.on_curved = known.on_curved
    result.on_edge = known.on_edge
    result.vertex = known.vertex
    result.edge = known.edge
    limit = wp.max(least, known.gap)
    # A separation is at most the height of any point of the curved solid above the edge.
    closest = near
    if known.gap > least:
        closest = known.on_curved
    for plane in range(own.first_plane, own.end_plane):
        # An edge above which a point is higher than the limit has such a face, or one below the point.
        if height_above_plane(geometries, own, plane, near) <= wp.min(limit, zero):
            continue
        for outline_number in range(features.plane_outline_start[plane], features.plane_outline_start[plane + 1]):
            outline = features.plane_outline[outline_number]
            for i in range(features.outline_start[outline], features.outline_start[outline + 1]):
                number = features.outline_edge[i]
                if number >= features.sharp_end[geometry]:
                    continue
                edge = features.edge[number]
                beside = features.face_plane[edge[2]]
                if beside == plane:
                    beside = features.face_plane[edge[3]]
                if beside < plane and height_above_plane(geometries, own, beside, near) > wp.min(limit, zero):
                    # It was compared before.
                    continue
                if edge_bound(geometries, edge, own, near) <= limit:
                    continue
                if edge_bound(geometries, edge, own, closest) <= limit:
                    continue
                found = contact_with_edge(
                    geometries, features, own, number, pair.other, pair.pose, hull, double(wp.inf)
                )
                if found.gap > limit:
                    limit = found.gap
                    closest = found.on_curved
                    result.gap = found.gap
                    result.normal = found.normal
                    result.on_curved = found.on_curved
                    result.on_edge = found.on_edge
                    result.vertex = found.vertex
                    result.edge = number
                    if limit > margin:
                        return result
    return result


@wp.func
def nearest_on_segments(start_1: vec3d, along_1: vec3d, start_2: vec3d, along_2: vec3d):
    """Returns the fractions of the nearest points of two segments; both may be points."""
    between = start_1 - start_2
    a = wp.dot(along_1, along_1)
    b = wp.dot(along_1, along_2)
    c = wp.dot(along_2, along_2)
    d = wp.dot(along_1, between)
    e = wp.dot(along_2, between)
    scale = a * c - b * b
    first = double(0.5)
    second = double(0.5)
    if scale > PERPENDICULAR * PERPENDICULAR * a * c:
        first = wp.clamp((b * e - c * d) / scale, zero, one)
    if c > zero:
        second = wp.clamp((b * first + e) / c, zero, one)
    if a > zero:
        first = wp.clamp((b * second - d) / a, zero, one)
    return first, second


@wp.func
def is_edge_apart(other: SolidGeometry, pose: RelativePose, start: vec3d, end: vec3d, margin: double):
    """Returns whether an edge is farther than ``margin`` from a capsule around a curved solid."""
    # The axis of the capsule is the z axis of the bounding box.
    radius = wp.max(other.half_extents[0], other.half_extents[1])
    half = other.half_extents[2]
    if (other.flags & CAPSULE) != 0:
        half -= radius
    axis = half * (pose.rotation * vec3d(zero, zero, one))
    center = moved(pose, other.center)
    first, second = nearest_on_segments(center - axis, double(2.0) * axis, start, end - start)
    place = center + (double(2.0) * first - one) * axis
    return wp.length(start + second * (end - start) - place) > radius + margin
