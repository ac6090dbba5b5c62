"""Contact of edges of a polyhedron with the circular edges of the flat ends of a cylinder.

The points of an edge and a circular edge that are nearest to each other are found by samples along the circular edge and
bisection. Their normal is perpendicular to both edges.
"""

import warp as wp
from warpcontact.kernels.body_contact.solids import RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.manifolds.features import moved

double = wp.float64
vec3d = wp.vec3d

#: Samples along a circular edge, and bisections between two of them.
CIRCLE_SAMPLES, BISECTIONS = 24, 40
STEP = wp.constant(double(0.2617993877991494))  # 2 π/24


@wp.struct
class CircularEdgeContact:
    """Nearest points of a circular edge and an edge, in the frame of the polyhedron."""

    found: wp.int32  # 1: there is a contact
    normal: vec3d  # out of the polyhedron
    gap: double  # [m]
    place: vec3d  # on the edge [m]


@wp.func
def circle_point(pose: RelativePose, radius: double, z: double, angle: double):
    """Returns a point of a circular edge, and its tangent [m]."""
    cosine = wp.cos(angle)
    sine = wp.sin(angle)
    position = moved(pose, vec3d(radius * cosine, radius * sine, z))
    return position, pose.rotation * vec3d(-sine, cosine, double(0.0))


@wp.func
def slope(pose: RelativePose, radius: double, z: double, angle: double, start: vec3d, along: vec3d):
    """Returns the derivative of half of the squared distance of a circular edge from a line, divided by the radius [m].

    ``start``, ``along``: a point and the unit vector of the line.
    """
    position, tangent = circle_point(pose, radius, z, angle)
    difference = position - start
    return wp.dot(difference - wp.dot(difference, along) * along, tangent)


@wp.func
def circular_edge_contact(
    other: SolidGeometry,
    pose: RelativePose,
    side: int,
    start: vec3d,
    end: vec3d,
    outward: vec3d,
    within: double,
):
    """Returns the ``CircularEdgeContact`` of an edge with the smallest distance.

    Args:
        other: The cylinder.
        pose: Its pose in the frame of the polyhedron.
        side: Side of the flat end, −1 or 1.
        start: Start of the edge [m].
        end: End of the edge [m].
        outward: A direction out of the polyhedron at the edge.
        within: Largest distance that matters [m].
    """
    result = CircularEdgeContact()
    radius = other.scale[0]
    z = double(side) * other.scale[2]
    length = wp.length(end - start)
    along = (end - start) / length
    least = within
    angle = double(0.0)
    before = slope(pose, radius, z, angle, start, along)
    for _ in range(CIRCLE_SAMPLES):
        low = angle
        angle += STEP
        after = slope(pose, radius, z, angle, start, along)
        if before < double(0.0) and after >= double(0.0):
            high = angle
            for _k in range(BISECTIONS):
                middle = double(0.5) * (low + high)
                if slope(pose, radius, z, middle, start, along) < double(0.0):
                    low = middle
                else:
                    high = middle
            position, tangent = circle_point(pose, radius, z, high)
            at = wp.dot(position - start, along)
            place = start + at * along
            distance = wp.length(position - place)
            normal = wp.cross(along, tangent)
            size = wp.length(normal)
            if at > double(0.0) and at < length and distance <= least and size > double(1.0e-6):
                normal = normal / size
                if wp.dot(normal, outward) < double(0.0):
                    normal = -normal
                # Towards the edge, between the directions out of the curved surface and out of the flat end.
                to_edge = -(wp.transpose(pose.rotation) * normal)
                local = wp.transpose(pose.rotation) * (position - pose.origin)
                outside = to_edge[0] * local[0] + to_edge[1] * local[1] >= double(0.0)
                if outside and to_edge[2] * double(side) >= double(0.0):
                    least = distance
                    result.found = 1
                    result.normal = normal
                    result.gap = wp.dot(normal, position - place)
                    result.place = place
        before = after
    return result
