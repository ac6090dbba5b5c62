"""Solids: polyhedra with convex faces of up to four vertices, half-spaces and curved solids, on bodies or the world.

A geometry is a polyhedron in coordinates of its own; a solid is a geometry with a scale and a pose. Faces run
counter-clockwise as seen from outside. A scale that differs between the axes is allowed for boxes only, whose normals and
edges it does not turn. Curved solids (``curved_solids.py``) have no faces, and their sizes as scale.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.types import Struct, structs

double = wp.float64

# Properties of a geometry.
HALF_SPACE = 1  # z ≤ 0; it has one face without vertices
HAS_BOUNDARY = 2  # a surface with a boundary; only its own faces carry columns
FEW_PLANES = 4  # convex, with at most MAX_PLANES planes
CONVEX = 8  # a convex polyhedron
#: Largest number of planes of a convex solid by which faces are cut.
MAX_PLANES = 8


@wp.struct
class Geometries:
    """Polyhedra that all environments share."""

    vertex: wp.array(dtype=wp.vec3d)  # [vertex] [unit of the geometry]
    face: wp.array(dtype=wp.vec4i)  # [face] vertices; the last is −1 for a triangle
    normal: wp.array(dtype=wp.vec3d)  # [face] unit, outward
    u_axis: wp.array(dtype=wp.vec3d)  # [face] unit, along its first edge
    offset: wp.array(dtype=wp.float64)  # [face] of its plane along the normal [unit of the geometry]
    face_start: wp.array(dtype=wp.int32)  # [geometry + 1]
    plane_face: wp.array(dtype=wp.int32)  # [plane] the first face in each plane of faces
    plane_start: wp.array(dtype=wp.int32)  # [geometry + 1]
    # Trees of bounding boxes over faces: [node] first of two children, which are consecutive, or −1; first face; end of faces.
    node: wp.array(dtype=wp.vec3i)
    node_lower: wp.array(dtype=wp.vec3d)  # [node] [unit of the geometry]
    node_upper: wp.array(dtype=wp.vec3d)
    root: wp.array(dtype=wp.int32)  # [geometry] node
    flags: wp.array(
        dtype=wp.int32
    )  # [geometry] HALF_SPACE, HAS_BOUNDARY, FEW_PLANES, CONVEX; kind of a curved solid
    center: wp.array(dtype=wp.vec3d)  # [geometry] of its bounding box [unit of the geometry]
    half_extents: wp.array(dtype=wp.vec3d)  # [geometry] of its bounding box [unit of the geometry]


@wp.struct
class SolidPose:
    """A geometry on a body."""

    position: wp.vec3d  # origin of the geometry in the frame of the body, or of the world [m]
    orientation: wp.quatd  # geometry → body (or world)
    scale: wp.vec3d  # along the axes of the geometry [m per unit]
    geometry: wp.int32


@wp.struct
class Solids:
    """Solids of body contacts."""

    pose: wp.array2d(dtype=SolidPose)  # [env, solid]
    body: wp.array(dtype=wp.int32)  # [solid] body or WORLD


@wp.struct
class RelativePose:
    """Pose of a solid relative to another one, in metres."""

    origin: wp.vec3d  # of the solid in the frame of the other one [m]
    rotation: wp.mat33d  # solid → other


@wp.struct
class PairPose:
    """Rotations and arms of the two solids of a pair."""

    first_in_second: RelativePose
    first_axes: RelativePose  # pose of the first solid in W axes at the origin of the second solid
    second_axes: RelativePose  # likewise of the second solid
    orientation: wp.quatd  # second solid → W
    arm_1: wp.vec3d  # from the center of mass of the first body to the origin of the second solid, W [m]
    arm_2: wp.vec3d  # likewise from the second body


@wp.func
def scaled(position: wp.vec3d, scale: wp.vec3d):
    """Returns a position of a geometry in metres."""
    return wp.cw_mul(position, scale)


@wp.func
def no_motion():
    """Returns the pose of a frame relative to itself."""
    result = RelativePose()
    result.rotation = wp.identity(n=3, dtype=double)
    return result


@wp.func
def inverse_pose(pose: RelativePose):
    """Returns the pose of the other solid relative to the solid."""
    result = RelativePose()
    result.rotation = wp.transpose(pose.rotation)
    result.origin = -(result.rotation * pose.origin)
    return result


@wp.func
def face_vertex(geometries: Geometries, face: wp.vec4i, i: int, scale: wp.vec3d):
    """Returns corner ``i`` of a face [m]."""
    return scaled(geometries.vertex[face[i]], scale)


@wp.func
def corner_count(face: wp.vec4i):
    """Returns the number of vertices of a face."""
    if face[3] < 0:
        return wp.int32(3)
    return wp.int32(4)


class Functions(NamedTuple):
    """Device functions of solids, for states of one precision."""

    #: ``(state, env, solids, first, second)``: the ``PairPose`` of two solids.
    pair_pose: wp.Function
    #: ``(state, env, solids, solid)``: the pose of a solid in the world, a ``RelativePose``.
    pose_in_world: wp.Function


@functools.cache
def functions(real: type) -> Functions:
    """Returns the device functions for states of precision ``real``."""
    State: Struct = structs(real).State

    @wp.func
    def body_rotation(state: State, env: int, body: int):
        """Returns the rotation B → W of ``body`` (WORLD: identity), normalized in float64."""
        if body < 0:
            return wp.quatd(double(0.0), double(0.0), double(0.0), double(1.0))
        q = state.body_orientation[env, body]
        q_64 = wp.quatd(double(q[0]), double(q[1]), double(q[2]), double(q[3]))
        if wp.static(real is wp.float32):
            if state.body_orientation_remainder.shape[1] > 0:
                r = state.body_orientation_remainder[env, body]
                q_64 = q_64 + wp.quatd(double(r[0]), double(r[1]), double(r[2]), double(r[3]))
        return wp.normalize(q_64)

    @wp.func
    def body_center(state: State, env: int, body: int):
        """Returns the center of mass of ``body`` without its rounding remainder (WORLD: the origin), W [m]."""
        if body < 0:
            return wp.vec3d()
        p = state.body_position[env, body]
        return wp.vec3d(double(p[0]), double(p[1]), double(p[2]))

    @wp.func
    def body_remainder(state: State, env: int, body: int):
        if body < 0:
            return wp.vec3d()
        p = state.body_position_remainder[env, body]
        return wp.vec3d(double(p[0]), double(p[1]), double(p[2]))

    @wp.func
    def pair_pose(state: State, env: int, solids: Solids, first: int, second: int):
        """Returns rotations and arms of two solids. Large positions are subtracted before offsets are added."""
        body_1 = solids.body[first]
        body_2 = solids.body[second]
        pose_1 = solids.pose[env, first]
        pose_2 = solids.pose[env, second]
        q_1 = body_rotation(state, env, body_1)
        q_2 = body_rotation(state, env, body_2)
        offset_1 = wp.quat_rotate(q_1, pose_1.position)
        offset_2 = wp.quat_rotate(q_2, pose_2.position)
        between = body_center(state, env, body_1) - body_center(state, env, body_2)
        between += body_remainder(state, env, body_1) - body_remainder(state, env, body_2)
        result = PairPose()
        result.orientation = q_2 * pose_2.orientation
        result.second_axes.rotation = wp.quat_to_matrix(result.orientation)
        result.first_axes.rotation = wp.quat_to_matrix(q_1 * pose_1.orientation)
        result.first_axes.origin = between + offset_1 - offset_2
        to_second = wp.transpose(result.second_axes.rotation)
        result.first_in_second.rotation = to_second * result.first_axes.rotation
        result.first_in_second.origin = to_second * result.first_axes.origin
        result.arm_2 = offset_2
        result.arm_1 = offset_2 - between
        return result

    @wp.func
    def pose_in_world(state: State, env: int, solids: Solids, solid: int):
        """Returns the pose of a solid in the world."""
        pose = solids.pose[env, solid]
        body = solids.body[solid]
        q = body_rotation(state, env, body)
        result = RelativePose()
        result.rotation = wp.quat_to_matrix(q * pose.orientation)
        result.origin = body_center(state, env, body) + body_remainder(state, env, body)
        result.origin += wp.quat_rotate(q, pose.position)
        return result

    return Functions(pair_pose=pair_pose, pose_in_world=pose_in_world)
