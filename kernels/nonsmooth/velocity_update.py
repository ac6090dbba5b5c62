"""Relative velocities, response of bodies to impulses, cone projections and residuals, shared by the solvers.

Solvers compute the velocity change by contact, not the velocity: it is independent of the speed of the bodies, and
so is its float32 rounding. A row has w = q + U(change), where q is its relative velocity without contact minus its
prescribed separation speed.
"""

import functools
from typing import NamedTuple

import numpy as np
import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.types import structs


class Functions(NamedTuple):
    """Device functions of the response of bodies to impulses, and of the friction cone in W."""

    project_couple: wp.Function  # nearest couple within the limits of rolling and spinning
    projected_normal: wp.Function  # normal part of the projection of an impulse and a couple onto their cone
    velocity_change_at: wp.Function  # velocity change at an arm from the center of mass [m/s]
    relative_spin_change: wp.Function  # change of the angular velocity of the first body relative to the second
    apply_impulse: wp.Function  # adds the response of a body to an impulse and an angular impulse
    apply_impulse_pair: wp.Function  # adds the responses of two bodies to opposite impulses
    apply_row_impulse: wp.Function  # adds the responses of the bodies of a row to an impulse at K
    response_trace: wp.Function  # trace of the block of a body, a measure of its mobility [1/kg]
    angular_response_trace: wp.Function  # trace of the response to angular impulses [1/(kg·m²)]
    impulse_response: wp.Function  # velocity change at an arm by an impulse there [m/s]
    block: wp.Function  # velocity change at an arm per impulse there [1/kg]
    project_onto_cone: wp.Function  # admissible impulse nearest to an impulse
    invert_symmetric: wp.Function  # inverse of a symmetric block, and whether it exists
    de_saxce_velocity: wp.Function  # velocity plus μ times the slip speed along the normal
    residual_squared: wp.Function  # squared violation of the contact law


@functools.cache
def functions(real: type, has_joints: bool) -> Functions:
    """Returns the device functions for ``real``; with ``has_joints`` some bodies have joints."""
    t = structs(real)
    vec3, mat33 = t.vec3, t.mat33
    Rows, _, BodyResponse, VelocityChange = solve_types(real, has_joints)
    zero, one, two, three = (wp.constant(real(x)) for x in (0.0, 1.0, 2.0, 3.0))
    rounding = float(np.finfo(wp.dtype_to_numpy(real)).eps)
    # A block with a smaller determinant, relative to the cube of a third of its trace, counts as singular.
    SINGULAR = wp.constant(real(100.0 * rounding))

    @wp.func
    def velocity_change_at(velocity_change: VelocityChange, env: int, body: int, arm: vec3):
        """Returns the velocity change at ``arm`` from the center of mass; 0 for the world."""
        if body < 0:
            return vec3()
        return velocity_change[env, body].linear + wp.cross(velocity_change[env, body].angular, arm)

    @wp.func
    def relative_spin_change(velocity_change: VelocityChange, env: int, body_1: int, body_2: int):
        """Returns the change of the angular velocity of the first body relative to the second."""
        difference = vec3()
        if body_1 >= 0:
            difference = velocity_change[env, body_1].angular
        if body_2 >= 0:
            difference -= velocity_change[env, body_2].angular
        return difference

    @wp.func
    def apply_impulse(
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        env: int,
        body: int,
        impulse: vec3,
        turning: vec3,
    ):
        """Adds the response of a body to an impulse and an angular impulse about its center of mass."""
        if body < 0:
            return
        if wp.static(has_joints):
            B = body_response[env, body].inverse_mass_coupling
            linear = body_response[env, body].inverse_mass_matrix * impulse + B * turning
            angular = wp.transpose(B) * impulse + body_response[env, body].inverse_inertia * turning
            velocity_change[env, body].linear = velocity_change[env, body].linear + linear
            velocity_change[env, body].angular = velocity_change[env, body].angular + angular
        else:
            linear = body_response[env, body].inverse_mass * impulse
            velocity_change[env, body].linear = velocity_change[env, body].linear + linear
            velocity_change[env, body].angular = (
                velocity_change[env, body].angular + body_response[env, body].inverse_inertia * turning
            )

    @wp.func
    def apply_impulse_pair(
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        env: int,
        body_1: int,
        body_2: int,
        impulse: vec3,
        turning_1: vec3,
        turning_2: vec3,
    ):
        """Adds the responses of two bodies to opposite impulses and an angular impulse on each."""
        apply_impulse(body_response, velocity_change, env, body_1, impulse, turning_1)
        apply_impulse(body_response, velocity_change, env, body_2, -impulse, turning_2)

    @wp.func
    def apply_row_impulse(
        rows: Rows, body_response: BodyResponse, velocity_change: VelocityChange, env: int, row: int, impulse: vec3
    ):
        """Adds the responses of the bodies of a row to an impulse at K, on the first body."""
        turning_1, turning_2 = wp.cross(rows[env, row].arm_1, impulse), -wp.cross(rows[env, row].arm_2, impulse)
        apply_impulse_pair(
            body_response, velocity_change, env, rows[env, row].body_1, rows[env, row].body_2, impulse,
            turning_1, turning_2,
        )  # fmt: skip

    @wp.func
    def response_trace(body_response: BodyResponse, env: int, body: int, arm: vec3):
        """Returns the trace of the block of one body at ``arm``, a measure of its mobility [1/kg]."""
        if body < 0:
            return zero
        C = body_response[env, body].inverse_inertia
        trace = (C[0, 0] + C[1, 1] + C[2, 2]) * wp.length_sq(arm) - wp.dot(arm, C * arm)
        if wp.static(has_joints):
            A = body_response[env, body].inverse_mass_matrix
            B = body_response[env, body].inverse_mass_coupling
            trace += A[0, 0] + A[1, 1] + A[2, 2]
            largest = trace
            trace += two * wp.dot(arm, vec3(B[1, 2] - B[2, 1], B[2, 0] - B[0, 2], B[0, 1] - B[1, 0]))
            if trace <= SINGULAR * largest:
                # The point does not move; the remainder is rounding.
                trace = zero
        else:
            trace += three * body_response[env, body].inverse_mass
        return trace

    @wp.func
    def angular_response_trace(body_response: BodyResponse, env: int, body: int):
        """Returns the trace of the response of the angular velocity to angular impulses [1/(kg·m²)]."""
        if body < 0:
            return zero
        C = body_response[env, body].inverse_inertia
        return C[0, 0] + C[1, 1] + C[2, 2]

    @wp.func
    def impulse_response(body_response: BodyResponse, env: int, body: int, arm: vec3, impulse: vec3):
        """Returns the velocity change at ``arm`` by an impulse there: ``block`` times the impulse."""
        if body < 0:
            return vec3()
        turning = wp.cross(arm, impulse)
        spin = body_response[env, body].inverse_inertia * turning
        if wp.static(has_joints):
            B = body_response[env, body].inverse_mass_coupling
            linear = body_response[env, body].inverse_mass_matrix * impulse + B * turning
            spin += wp.transpose(B) * impulse
        else:
            linear = body_response[env, body].inverse_mass * impulse
        return linear + wp.cross(spin, arm)

    @wp.func
    def block(body_response: BodyResponse, env: int, body: int, arm: vec3):
        """Returns the velocity change at ``arm`` per impulse there, W [1/kg]."""
        if body < 0:
            return mat33()
        cross = wp.skew(arm)
        C = body_response[env, body].inverse_inertia
        result = -(cross * C * cross)
        if wp.static(has_joints):
            across = body_response[env, body].inverse_mass_coupling * cross
            result += body_response[env, body].inverse_mass_matrix + across + wp.transpose(across)
        else:
            m = body_response[env, body].inverse_mass
            result += wp.diag(vec3(m, m, m))
        return result

    @wp.func
    def invert_symmetric(W: mat33):
        """Returns the inverse of a symmetric block, and whether it exists."""
        c0 = vec3(
            W[1, 1] * W[2, 2] - W[1, 2] * W[1, 2],
            W[0, 2] * W[1, 2] - W[0, 1] * W[2, 2],
            W[0, 1] * W[1, 2] - W[0, 2] * W[1, 1],
        )
        determinant = W[0, 0] * c0[0] + W[0, 1] * c0[1] + W[0, 2] * c0[2]
        mean_eigenvalue = (W[0, 0] + W[1, 1] + W[2, 2]) / three
        if determinant <= SINGULAR * mean_eigenvalue * mean_eigenvalue * mean_eigenvalue:
            return mat33(), 0
        f = one / determinant
        a11 = f * (W[0, 0] * W[2, 2] - W[0, 2] * W[0, 2])
        a12 = f * (W[0, 1] * W[0, 2] - W[0, 0] * W[1, 2])
        a22 = f * (W[0, 0] * W[1, 1] - W[0, 1] * W[0, 1])
        c0 = f * c0
        return mat33(c0[0], c0[1], c0[2], c0[1], a11, a12, c0[2], a12, a22), 1

    @wp.func
    def project_onto_cone(impulse: vec3, n: vec3, mu: real):
        """Returns the admissible impulse nearest to ``impulse``, as ``cone.project``; all in W."""
        along = wp.dot(impulse, n)
        l_t = impulse - along * n
        across_squared = wp.length_sq(l_t)
        limit = mu * along
        if along >= zero and across_squared <= limit * limit:
            return impulse
        across = wp.sqrt(across_squared)
        a = along + mu * across
        if a <= zero:
            return vec3()
        a = a / (one + mu * mu)
        share = zero
        if across > zero:
            share = a * mu / across
        return a * n + share * l_t

    @wp.func
    def project_couple(couple: vec3, n: vec3, rolling: real, spinning: real):
        """Returns the nearest couple within the limits normal to n (rolling) and along n (spinning)."""
        along = wp.dot(couple, n)
        across = couple - along * n
        size = wp.length(across)
        if size > rolling:
            across = (rolling / size) * across
        return across + wp.clamp(along, -spinning, spinning) * n

    @wp.func
    def projected_normal(impulse: vec3, couple: vec3, n: vec3, mu: real, rolling: real, spinning: real):
        """Returns the normal part of the projection of an impulse and a couple onto the cone with couples.

        The couple and its coefficients are divided by an arm, which gives them the units of an impulse and 1.
        Parts that exceed their limits increase the normal impulse. Parts that are within the limits of the result
        do not.
        """
        along = wp.dot(impulse, n)
        turning = wp.dot(couple, n)
        slip = wp.length(impulse - along * n)
        roll = wp.length(couple - turning * n)
        twist = wp.abs(turning)
        normal = along + mu * slip + rolling * roll + spinning * twist
        normal = normal / (one + mu * mu + rolling * rolling + spinning * spinning)
        for _ in range(3):
            # Removing a part increases the normal impulse.
            sum = along
            weight = real(1.0)
            if slip > mu * normal:
                sum += mu * slip
                weight += mu * mu
            if roll > rolling * normal:
                sum += rolling * roll
                weight += rolling * rolling
            if twist > spinning * normal:
                sum += spinning * twist
                weight += spinning * spinning
            normal = sum / weight
        return wp.max(normal, zero)

    @wp.func
    def de_saxce_velocity(w: vec3, n: vec3, mu: real):
        """Returns De Saxcé's velocity: ``w`` plus μ times the slip speed along the normal, W."""
        return w + mu * wp.length(w - wp.dot(w, n) * n) * n

    @wp.func
    def residual_squared(impulse: vec3, w: vec3, n: vec3, mu: real, rho: real):
        """Returns the squared violation of the contact law at the velocity ``w``, as ``cone.residual``; all in W."""
        w_n = wp.dot(w, n)
        w_t = w - w_n * n
        l_n = wp.dot(impulse, n)
        l_t = impulse - l_n * n
        slip_squared = wp.length_sq(w_t)
        parting = w_n + mu * wp.sqrt(slip_squared)
        z_n = l_n - rho * parting
        z_t = l_t - rho * w_t
        limit = mu * z_n
        across_squared = wp.length_sq(z_t)
        if z_n >= zero and across_squared <= limit * limit:
            return rho * rho * (parting * parting + slip_squared)
        across = wp.sqrt(across_squared)
        a = z_n + mu * across
        if a <= zero:
            return wp.length_sq(impulse)
        a = a / (one + mu * mu)
        rest = l_n - a
        # across is 0 here only if mu is.
        share = zero
        if across > zero:
            share = a * mu / across
        return rest * rest + wp.length_sq(l_t - share * z_t)

    return Functions(
        project_couple=project_couple,
        projected_normal=projected_normal,
        velocity_change_at=velocity_change_at,
        relative_spin_change=relative_spin_change,
        apply_impulse=apply_impulse,
        apply_impulse_pair=apply_impulse_pair,
        apply_row_impulse=apply_row_impulse,
        response_trace=response_trace,
        angular_response_trace=angular_response_trace,
        impulse_response=impulse_response,
        block=block,
        project_onto_cone=project_onto_cone,
        invert_symmetric=invert_symmetric,
        de_saxce_velocity=de_saxce_velocity,
        residual_squared=residual_squared,
    )


class RelativeVelocities(NamedTuple):
    """Device functions of the velocity of the first body relative to the second, W."""

    before: wp.Function  # at K, in a state [m/s]
    after: wp.Function  # at K, in a solve [m/s]
    spin_before: wp.Function  # angular, in a state [rad/s]
    spin_after: wp.Function  # angular, in a solve [rad/s]


@functools.cache
def relative_velocities(real: type, has_joints: bool) -> RelativeVelocities:
    """Returns the device functions for ``real``; all give the first body relative to the second.

    With ``has_joints`` some bodies have joints.
    """
    t = structs(real)
    vec3, State = t.vec3, t.State
    BodyResponse = solve_types(real, has_joints).BodyResponse
    velocity_at = frames.functions(real).velocity_at

    @wp.func
    def before(state: State, env: int, body_1: int, body_2: int, arm_1: vec3, arm_2: vec3):
        """Returns the relative velocity at K in a state."""
        return velocity_at(state, env, body_1, arm_1) - velocity_at(state, env, body_2, arm_2)

    @wp.func
    def after(body_response: BodyResponse, env: int, body_1: int, body_2: int, arm_1: vec3, arm_2: vec3):
        """Returns the relative velocity at K in a solve."""
        velocity = vec3()
        if body_1 >= 0:
            velocity = body_response[env, body_1].linear + wp.cross(body_response[env, body_1].angular, arm_1)
        if body_2 >= 0:
            velocity -= body_response[env, body_2].linear + wp.cross(body_response[env, body_2].angular, arm_2)
        return velocity

    @wp.func
    def spin_before(state: State, env: int, body_1: int, body_2: int):
        """Returns the relative angular velocity in a state."""
        difference = vec3()
        if body_1 >= 0:
            difference = state.body_angular_velocity[env, body_1]
        if body_2 >= 0:
            difference -= state.body_angular_velocity[env, body_2]
        return difference

    @wp.func
    def spin_after(body_response: BodyResponse, env: int, body_1: int, body_2: int):
        """Returns the relative angular velocity in a solve."""
        difference = vec3()
        if body_1 >= 0:
            difference = body_response[env, body_1].angular
        if body_2 >= 0:
            difference -= body_response[env, body_2].angular
        return difference

    return RelativeVelocities(before=before, after=after, spin_before=spin_before, spin_after=spin_after)
