"""Motion of the nearest points of two solids, and of their common normal, with the relative pose, to first order.

The nearest points are those that are farthest along the common normal n, on the second solid, and against it, on the first one.
As the normal turns by dn, the farthest point of a solid moves by C dn: C is r times the projection across n for a ball, has
the radius of curvature across the line for a cylinder, and is zero at edges and vertices. It moves freely along a
straight line of its surface, and n remains normal to this line. With the displacement d of the first solid at its point,
relative to the second one, and its turn θ,

    d + C₁ (θ × n − dn) + s₁ u₁ = C₂ dn + s₂ u₂ + gap dn

across n, where u₁ and u₂ are unit vectors along lines, if there are any.
"""

import warp as wp
from warpcontact.kernels.body_contact.curved_solids import CAPSULE, CONE, CURVED, CYLINDER, ELLIPSOID
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry
from warpcontact.kernels.manifolds.candidates import axes_across
from warpcontact.kernels.manifolds.features import Features, vertex_position

double = wp.float64
vec3d = wp.vec3d
mat33d = wp.mat33d

# Kinds of features, in the order of their numbers.
VERTEX, EDGE, PLANE = (wp.constant(i) for i in range(3))
# Distance from the end of a surface, relative to its size, up to which a point is at the end.
AT_END = wp.constant(double(1.0e-6))
# Component of a unit normal of a circular edge along and across the axis, below which the point is on an adjacent surface.
BESIDE = wp.constant(double(1.0e-3))
# Sine of the angle of two lines below which they are parallel.
PARALLEL_LINES = wp.constant(double(0.05))
# Radius of curvature, relative to the size, below which the normal turns too fast.
SHARP = wp.constant(double(0.01))


@wp.func
def feature_kind(feature: int):
    """Returns the kind of a feature: VERTEX, EDGE or PLANE."""
    return (feature - 1) % 3


@wp.func
def edge_direction(geometries: Geometries, features: Features, feature: int, side: SolidGeometry):
    """Returns the unit vector along an edge in the frame of its solid."""
    ends = features.edge[(feature - 1) // 3]
    start = vertex_position(geometries, ends[0], side)
    return wp.normalize(vertex_position(geometries, ends[1], side) - start)


@wp.struct
class SurfacePart:
    """The surface of a solid near its point that is farthest along an outward normal, in the frame of the second solid."""

    response: mat33d  # C, displacement of this point over the change of the normal [m]
    along: vec3d  # unit vector along a line of the surface; zero: none
    is_known: wp.bool


@wp.func
def curved_part(flags: int, scale: vec3d, position: vec3d, outward: vec3d):
    """Returns the ``SurfacePart`` of a curved solid in its own frame.

    Args:
        flags: Properties of the solid.
        scale: Its scale [m].
        position: The point [m].
        outward: Unit normal.
    """
    part = SurfacePart()
    part.is_known = True
    if (flags & ELLIPSOID) != 0:
        squares = wp.cw_mul(scale, scale)
        height = wp.length(wp.cw_mul(scale, outward))
        farthest = wp.cw_mul(squares, outward) / height
        part.response = (wp.diag(squares) - wp.outer(farthest, farthest)) / height
        return part
    r = scale[0]
    if (flags & CAPSULE) != 0:
        half = scale[2] - r
        if wp.abs(position[2]) >= half * (double(1.0) - AT_END):
            part.response = r * (wp.identity(n=3, dtype=double) - wp.outer(outward, outward))
            part.is_known = wp.abs(outward[2]) > BESIDE
            return part
    beside = wp.sqrt(outward[0] * outward[0] + outward[1] * outward[1])
    if beside <= BESIDE:
        part.is_known = False
        return part
    # Across the axis: points at one height are on a circle.
    tangent = vec3d(-outward[1], outward[0], double(0.0)) / beside
    radius = wp.sqrt(position[0] * position[0] + position[1] * position[1])
    part.response = (radius / beside) * wp.outer(tangent, tangent)
    if (flags & CONE) != 0:
        top = vec3d(double(0.0), double(0.0), scale[2])
        if position[2] > AT_END * scale[2] and position[2] < (double(1.0) - AT_END) * scale[2]:
            part.along = wp.normalize(top - position)
        elif position[2] <= AT_END * scale[2]:
            # On the circular edge, unless the normal is that of the curved surface.
            slope = wp.normalize(vec3d(scale[2], r, double(0.0)))
            part.is_known = wp.abs(outward[2] - slope[1]) > BESIDE
        else:
            part.response = mat33d()
    elif (flags & CYLINDER) == 0 or wp.abs(position[2]) < scale[2] * (double(1.0) - AT_END):
        part.along = vec3d(double(0.0), double(0.0), double(1.0))
    else:
        part.is_known = wp.abs(outward[2]) > BESIDE
    return part


@wp.func
def surface_part(
    geometries: Geometries,
    features: Features,
    side: SolidGeometry,
    pose: RelativePose,
    feature: int,
    position: vec3d,
    outward: vec3d,
):
    """Returns the ``SurfacePart`` of a solid.

    Args:
        geometries: The geometries.
        features: Their features.
        side: The solid.
        pose: Its pose in the frame of the second solid.
        feature: Its feature of the point, if it is a polyhedron.
        position: The point in the frame of the second solid [m].
        outward: Unit normal in that frame.
    """
    part = SurfacePart()
    if (side.flags & CURVED) != 0:
        to_own = wp.transpose(pose.rotation)
        part = curved_part(side.flags, side.scale, to_own * (position - pose.origin), to_own * outward)
        part.response = pose.rotation * part.response * to_own
        part.along = pose.rotation * part.along
        return part
    kind = feature_kind(feature)
    part.is_known = kind != PLANE
    if kind == EDGE:
        part.along = pose.rotation * edge_direction(geometries, features, feature, side)
    return part


@wp.struct
class NearestMotion:
    """Motion of the nearest points of two solids, to first order."""

    turn: vec3d  # of the normal
    shift: vec3d  # of the point of the second solid, across the normal [m]
    is_known: wp.bool


@wp.func
def nearest_motion(
    first: SurfacePart,
    second: SurfacePart,
    normal: vec3d,
    gap: double,
    displacement: vec3d,
    turned: vec3d,
    size: double,
):
    """Returns the ``NearestMotion`` of two solids.

    Args:
        first: Surface of the first solid.
        second: Surface of the second solid.
        normal: Unit normal out of the second solid.
        gap: Gap [m].
        displacement: Displacement of the first solid at its point, relative to the second one [m].
        turned: Change θ × n of the normal if it were fixed to the first solid.
        size: Size of the smaller solid [m].
    """
    result = NearestMotion()
    if not (first.is_known and second.is_known):
        return result
    identity = wp.identity(n=3, dtype=double)
    response = first.response + second.response + gap * identity
    # Across the normal: the change of the normal has response · dn = driving, but for motion along lines.
    driving = displacement + first.response * turned
    across_1 = wp.cross(normal, first.along)
    across_2 = wp.cross(normal, second.along)
    has_1 = wp.length_sq(first.along) > double(0.0)
    has_2 = wp.length_sq(second.along) > double(0.0)
    limit = SHARP * size
    if has_1 and has_2:
        sine = wp.dot(across_2, first.along)
        if wp.abs(sine) < PARALLEL_LINES:
            return result
        result.turn = (wp.dot(turned, first.along) / sine) * across_2
        rest = driving - response * result.turn
        result.shift = (wp.dot(across_1, rest) / wp.dot(across_1, second.along)) * second.along
    elif has_1 or has_2:
        line = second.along
        across = across_2
        if has_1:
            line = first.along
            across = across_1
            result.turn = wp.dot(turned, first.along) * first.along
        radius = wp.dot(across, response * across)
        if radius < limit:
            return NearestMotion()
        rest = driving - response * result.turn
        result.turn += (wp.dot(across, rest) / radius) * across
        if has_2:
            result.shift = wp.dot(line, driving - response * result.turn) * line
    else:
        u_axis, v_axis = axes_across(normal)
        uu = wp.dot(u_axis, response * u_axis)
        uv = wp.dot(u_axis, response * v_axis)
        vv = wp.dot(v_axis, response * v_axis)
        determinant = uu * vv - uv * uv
        if determinant < limit * (uu + vv):
            return result
        u = wp.dot(u_axis, driving)
        v = wp.dot(v_axis, driving)
        result.turn = ((vv * u - uv * v) * u_axis + (uu * v - uv * u) * v_axis) / determinant
    result.shift += second.response * result.turn
    result.is_known = True
    return result
