"""Patches: columns of a pair with similar normals, which share the history of one normal force, friction force and torque.

A law with history variables acts once per patch, at the root mean square δ of the depths t of its columns. Its pressure is distributed
as p = law(δ, δ̇) t/δ. So the power of all columns is law(δ, δ̇) δ̇ while the area does not change: work and dissipation are those of
the law. The pressure of a linear law is that at each column, and the force of columns of equal depth that of the law at this depth.

A patch has the center of its pressure, and a friction radius r_f: pure spin at rate ω under Coulomb friction has the torque
μ N r_f. The slip of a patch is the vector of its tangential velocity and, along the normal, r_f ω. A friction model limits
the length of the force that opposes this vector, so force and torque are on the ellipse |F|² + (M/r_f)² ≤ (μ N)².
Patches share stiffness and damping of the model in proportion to their normal forces.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.body_contact.records import Patches
from warpcontact.kernels.catalogue import history_variables
from warpcontact.kernels.catalogue.device_model import Formula, coefficient_struct, coefficients_in_precision
from warpcontact.kernels.contact.contact_evaluation import history_precision
from warpcontact.kernels.frames import functions as frame_functions
from warpcontact.kernels.types import Struct, structs

double = wp.float64
vec3d = wp.vec3d

#: Largest number of patches of a pair.
PATCH_COUNT = 4
# Cosine of the largest angle, 40°, between the normals of a patch in successive steps, and within a patch.
SIMILAR = wp.constant(double(0.766))
TINY = wp.constant(double(1.0e-300))
#: Columns of the array of sums over a patch: normal force, its moment of first order (3), of second order (xx, yy, zz, xy, xz,
#: yz), sum of normals (3).
PATCH_SUMS = 13
#: Further columns for laws with history variables, whose sums above have depths instead of pressures: area, sum of its magnitudes,
#: integral of the squares of depths, integral of depths times the moments of normals (3), largest depth.
DEPTH_SUMS = 7


@wp.struct
class PatchShape:
    """Distribution of the pressure of a patch."""

    normal_force: wp.float64  # [N]; for ``friction``, that of all patches of the pair
    normal: wp.vec3d  # mean, unit, out of the second solid, W
    center: wp.vec3d  # of pressure, W, relative to the origin of the sums [m]
    friction_radius: wp.float64  # r_f [m]


@wp.func
def row_vector(rows: wp.array2d(dtype=double), i: int):
    """Returns the first three elements of row ``i``."""
    return vec3d(rows[i, 0], rows[i, 1], rows[i, 2])


@wp.func
def set_row(rows: wp.array2d(dtype=double), i: int, vector: vec3d):
    """Stores the first three elements of row ``i``."""
    for k in range(3):
        rows[i, k] = vector[k]


@wp.func
def start_patches(
    normals: wp.array2d(dtype=double), sums: wp.array2d(dtype=double), patches: Patches, env: int, pair: int
):
    """Stores the normals of the patches of a pair after the last step, and clears their sums."""
    for patch in range(PATCH_COUNT):
        set_row(normals, patch, patches.normal[env, PATCH_COUNT * pair + patch])
        for k in range(PATCH_SUMS):
            sums[patch, k] = double(0.0)


@wp.func
def start_depths(sums: wp.array2d(dtype=double)):
    """Clears the sums of the depths of all patches."""
    for patch in range(PATCH_COUNT):
        for k in range(DEPTH_SUMS):
            sums[patch, PATCH_SUMS + k] = double(0.0)


@wp.struct
class PatchDepths:
    """Sums of the depths of the columns of a patch."""

    area: double  # [m²]
    gross_area: double  # sum of the magnitudes of the parts of ``area`` [m²]
    squares: double  # integral of the squares of depths [m⁴]
    turning: wp.vec3d  # integral of depths times the moment of the normal about the first center of mass, W [m⁴]
    largest: double  # [m]


@wp.func
def add_depths_to_patch(sums: wp.array2d(dtype=double), patch: int, depths: PatchDepths):
    """Adds sums of depths to those of a patch."""
    sums[patch, PATCH_SUMS] = sums[patch, PATCH_SUMS] + depths.area
    sums[patch, PATCH_SUMS + 1] = sums[patch, PATCH_SUMS + 1] + depths.gross_area
    sums[patch, PATCH_SUMS + 2] = sums[patch, PATCH_SUMS + 2] + depths.squares
    for i in range(3):
        sums[patch, PATCH_SUMS + 3 + i] = sums[patch, PATCH_SUMS + 3 + i] + depths.turning[i]
    sums[patch, PATCH_SUMS + 6] = wp.max(sums[patch, PATCH_SUMS + 6], depths.largest)


@wp.func
def use_areas_of_exits(sums: wp.array2d(dtype=double)):
    """Sets the areas of patches on a half-space to those of the columns down to exits; others are subtracted from them."""
    for patch in range(PATCH_COUNT):
        sums[patch, PATCH_SUMS] = double(0.5) * (sums[patch, PATCH_SUMS] + sums[patch, PATCH_SUMS + 1])


@wp.func
def depths_of_patch(sums: wp.array2d(dtype=double), patch: int):
    """Returns the sums of the depths of a patch."""
    depths = PatchDepths()
    depths.area = sums[patch, PATCH_SUMS]
    depths.gross_area = sums[patch, PATCH_SUMS + 1]
    depths.squares = sums[patch, PATCH_SUMS + 2]
    depths.turning = vec3d(sums[patch, PATCH_SUMS + 3], sums[patch, PATCH_SUMS + 4], sums[patch, PATCH_SUMS + 5])
    depths.largest = sums[patch, PATCH_SUMS + 6]
    return depths


@wp.func
def most_similar(rows: wp.array2d(dtype=double), normal: vec3d):
    """Returns the index of the row with the largest component along ``normal``."""
    best = wp.int32(0)
    largest = double(-2.0)
    for i in range(PATCH_COUNT):
        similarity = wp.dot(row_vector(rows, i), normal)
        # Zero rows are free.
        if wp.length_sq(row_vector(rows, i)) == double(0.0):
            similarity = double(-2.0)
        if similarity > largest:
            largest = similarity
            best = i
    return best


@wp.func
def free_row(rows: wp.array2d(dtype=double)):
    """Returns the index of the first zero row; −1: there is none."""
    for i in range(PATCH_COUNT):
        if wp.length_sq(row_vector(rows, i)) == double(0.0):
            return i
    return -1


@wp.func
def patch_of(rows: wp.array2d(dtype=double), normal: vec3d):
    """Returns the patch of columns with ``normal``: one with a similar normal, else a free one, else the most similar."""
    patch = most_similar(rows, normal)
    if wp.dot(row_vector(rows, patch), normal) >= SIMILAR:
        return patch
    free = free_row(rows)
    if free >= 0:
        return free
    return patch


@wp.func
def add_moments_to_patch(
    sums: wp.array2d(dtype=double), patch: int, force: double, moment: vec3d, second: wp.mat33d, normal: vec3d
):
    """Adds a normal force and its first and second moments, W, to the sums of a patch."""
    sums[patch, 0] = sums[patch, 0] + force
    for i in range(3):
        sums[patch, 1 + i] = sums[patch, 1 + i] + moment[i]
        sums[patch, 4 + i] = sums[patch, 4 + i] + second[i, i]
        sums[patch, 10 + i] = sums[patch, 10 + i] + force * normal[i]
    sums[patch, 7] = sums[patch, 7] + second[0, 1]
    sums[patch, 8] = sums[patch, 8] + second[0, 2]
    sums[patch, 9] = sums[patch, 9] + second[1, 2]


@wp.func
def friction_radius(variance_1: double, variance_2: double):
    """Returns the mean distance from the center of a uniformly loaded rectangle with these variances along its sides [m].

    It is exact for rectangles, and 0.6 % too small for a disc.
    """
    a = wp.sqrt(double(12.0) * wp.max(variance_1, TINY))
    b = wp.sqrt(double(12.0) * wp.max(variance_2, TINY))
    short = wp.min(a, b)
    long = wp.max(a, b)
    diagonal = wp.sqrt(a * a + b * b)
    # asinh(x) = log(x + √(x² + 1)); for a line, short² asinh(long/short) tends to 0.
    ratio = short / long
    across = double(0.0)
    if ratio > double(1.0e-9):
        inverse = double(1.0) / ratio
        across = short * short / (double(12.0) * long) * wp.log(inverse + wp.sqrt(inverse * inverse + double(1.0)))
    along = double(0.25) * long
    if ratio > double(1.0e-9):
        along = long * long / (double(12.0) * short) * wp.log(ratio + wp.sqrt(ratio * ratio + double(1.0)))
    else:
        along = long / double(12.0)
    return diagonal / double(6.0) + across + along


@wp.func
def shape_of_patch(sums: wp.array2d(dtype=double), patch: int):
    """Returns the distribution of the pressure of a patch; its normal force is 0 or less if there is none."""
    shape = PatchShape()
    force = sums[patch, 0]
    shape.normal_force = force
    if force <= double(0.0):
        return shape
    center = vec3d(sums[patch, 1], sums[patch, 2], sums[patch, 3]) / force
    shape.center = center
    shape.normal = wp.normalize(vec3d(sums[patch, 10], sums[patch, 11], sums[patch, 12]))
    covariance = wp.mat33d(
        sums[patch, 4] / force - center[0] * center[0],
        sums[patch, 7] / force - center[0] * center[1],
        sums[patch, 8] / force - center[0] * center[2],
        sums[patch, 7] / force - center[0] * center[1],
        sums[patch, 5] / force - center[1] * center[1],
        sums[patch, 9] / force - center[1] * center[2],
        sums[patch, 8] / force - center[0] * center[2],
        sums[patch, 9] / force - center[1] * center[2],
        sums[patch, 6] / force - center[2] * center[2],
    )
    # Principal variances in the tangent plane.
    n = shape.normal
    helper = vec3d(double(1.0), double(0.0), double(0.0))
    if wp.abs(n[0]) > double(0.7):
        helper = vec3d(double(0.0), double(1.0), double(0.0))
    u = wp.normalize(wp.cross(n, helper))
    v = wp.cross(n, u)
    uu = wp.dot(u, covariance * u)
    vv = wp.dot(v, covariance * v)
    uv = wp.dot(u, covariance * v)
    mean = double(0.5) * (uu + vv)
    difference = wp.sqrt(double(0.25) * (uu - vv) * (uu - vv) + uv * uv)
    shape.friction_radius = friction_radius(mean + difference, mean - difference)
    return shape


class Functions(NamedTuple):
    """Device functions of the friction of patches."""

    #: ``(state, env, body_1, body_2, arm_1, arm_2, shape, coefficients, history_in, history_out, member, max_elapsed,
    #: dt, q_WS)``: returns friction force (3) and torque along the normal (3) on the first body, W, as a ``FrictionWrench``,
    #: of the normal force of all patches.
    friction: wp.Function
    #: ``(history_out, env, member, dt)``: clears the history of a patch.
    clear_history: wp.Function


@wp.struct
class FrictionWrench:
    """Friction of a patch, at its center; W."""

    force: wp.vec3d  # on the first body [N]
    torque: wp.vec3d  # on the first body [N·m]


@functools.cache
def functions(friction: type[Formula], real: type) -> Functions:
    """Returns the device functions of the friction of patches with one friction model."""
    t = structs(real)
    vec3, State = t.vec3, t.State
    Coefficients: Struct = coefficient_struct(friction, real)
    # Precision of the friction model, as that of its history variables.
    precise = history_precision("friction", friction, real, per_patch=True)
    precise_quat, TangentialState = structs(precise).quat, structs(precise).TangentialState
    in_precision = coefficients_in_precision(friction, real, precise)
    Memory = wp.array2d(dtype=history_variables.memory_struct(friction, precise))
    evaluate, _, clear = history_variables.functions(friction, precise, vectors="any")
    frame, precise_frame = frame_functions(real), frame_functions(precise)
    velocity_at, to_float64, from_float64 = frame.velocity_at, frame.to_float64, frame.from_float64
    precise_vector, precise_to_float64 = precise_frame.from_float64, precise_frame.to_float64

    @wp.func
    def angular_velocity(state: State, env: int, body: int):
        if body < 0:
            return vec3()
        return state.body_angular_velocity[env, body]

    @wp.func
    def friction_of_patch(
        state: State,
        env: int,
        body_1: int,
        body_2: int,
        arm_1: vec3d,
        arm_2: vec3d,
        shape: PatchShape,
        coefficients: Coefficients,
        history_in: Memory,
        history_out: Memory,
        member: int,
        max_elapsed: real,
        dt: real,
        q_WS: wp.quatd,
    ):
        slip = velocity_at(state, env, body_1, from_float64(arm_1)) - velocity_at(
            state, env, body_2, from_float64(arm_2)
        )
        spin = angular_velocity(state, env, body_1) - angular_velocity(state, env, body_2)
        n_W = precise_vector(shape.normal)
        radius = precise(shape.friction_radius)
        slip_W = precise_vector(to_float64(slip))
        spin_W = precise_vector(to_float64(spin))
        velocity = slip_W - wp.dot(slip_W, n_W) * n_W + (radius * wp.dot(spin_W, n_W)) * n_W
        tangential_state = TangentialState()
        tangential_state.normal = n_W
        tangential_state.normal_force = precise(shape.normal_force)
        tangential_state.velocity = velocity
        tangential_state.speed = wp.length(velocity)
        q = precise_quat(precise(q_WS[0]), precise(q_WS[1]), precise(q_WS[2]), precise(q_WS[3]))
        force = precise_to_float64(
            evaluate(
                history_in, history_out, env, member, in_precision(coefficients), tangential_state,
                precise(max_elapsed), precise(dt), q, n_W,
            )
        )  # fmt: skip
        along = wp.dot(force, shape.normal)
        result = FrictionWrench()
        result.force = force - along * shape.normal
        result.torque = (shape.friction_radius * along) * shape.normal
        return result

    @wp.func
    def clear_history(history_out: Memory, env: int, member: int, dt: real):
        clear(history_out, env, member, precise(dt))

    return Functions(friction=friction_of_patch, clear_history=clear_history)
