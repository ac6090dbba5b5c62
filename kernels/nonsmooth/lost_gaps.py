"""Correction of positions where closed contacts lost a part of their gap.

A step keeps gaps to first order only, so contacts of turning bodies get deeper by an error of second order. Displacements of the bodies
restore these parts of the gaps, apart from the velocities: impulses do not depend on them. Free bodies do not turn by them, so their
kinetic energy and angular momentum do not change.
Gauss–Seidel sweeps over the normals of all contacts compute them as velocities that act for one step. Open contacts keep their
room. A few sweeps are enough: what remains is corrected in the next step, and a body between two surfaces that both require more
room is moved by at most the lost part in each sweep.
"""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth import velocity_update
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.types import ENV_ACTIVE, FREE, LaunchRange, first_env, structs, task_count

#: Gauss–Seidel sweeps of a step.
SWEEPS = 4


@functools.cache
def restore_lost_gaps(real: type, has_joints: bool) -> wp.Kernel:
    """Returns the kernel that computes the velocities of the correction, in ``velocity_change``; items: 1.

    With ``has_joints`` some bodies have joints, along which they are moved.
    """
    Rows, SolveResult, BodyResponse, VelocityChange = solve_types(real, has_joints)
    vec3, Model = structs(real).vec3, structs(real).Model
    f = velocity_update.functions(real, has_joints)
    velocity_after = velocity_update.relative_velocities(real, has_joints).after
    velocity_change_at, apply_impulse_pair, impulse_response = (
        f.velocity_change_at,
        f.apply_impulse_pair,
        f.impulse_response,
    )
    zero = wp.constant(real(0.0))

    @wp.func
    def missing_speed(rows: Rows, body_response: BodyResponse, env: int, row: int):
        """Returns the least separation speed by the correction, below zero for contacts that have room [m/s]."""
        velocity = velocity_after(
            body_response,
            env,
            rows[env, row].body_1,
            rows[env, row].body_2,
            rows[env, row].arm_1,
            rows[env, row].arm_2,
        )
        room = wp.dot(rows[env, row].normal, velocity) - rows[env, row].recovery
        # Springs of compliant contacts, and solves that did not converge, have negative room.
        return rows[env, row].lost_speed - wp.max(room, zero)

    @wp.func
    def lever(model: Model, env: int, body: int, arm: vec3):
        """Returns the arm at which corrections act: the center of mass of a free body, which does not turn, W [m]."""
        if wp.static(has_joints):
            if body >= 0 and model.body_motion[env, body].kind != FREE:
                return arm
        return vec3()

    @wp.func
    def correct(
        model: Model, rows: Rows, body_response: BodyResponse, velocity_change: VelocityChange, env: int, row: int
    ):
        """Changes the correction of a row so that its points separate by it with ``missing_speed`` at least."""
        body_1 = rows[env, row].body_1
        body_2 = rows[env, row].body_2
        arm_1 = rows[env, row].arm_1
        arm_2 = rows[env, row].arm_2
        n = rows[env, row].normal
        apart = velocity_change_at(velocity_change, env, body_1, arm_1)
        apart -= velocity_change_at(velocity_change, env, body_2, arm_2)
        missing = rows[env, row].missing_speed - wp.dot(n, apart)
        before = rows[env, row].correction
        if missing == zero or (missing < zero and before == zero):
            return
        lever_1 = lever(model, env, body_1, arm_1)
        lever_2 = lever(model, env, body_2, arm_2)
        response = impulse_response(body_response, env, body_1, lever_1, n)
        response += impulse_response(body_response, env, body_2, lever_2, n)
        along = wp.dot(n, response)
        if along > zero:
            after = wp.max(before + missing / along, zero)
            rows[env, row].correction = after
            change = (after - before) * n
            apply_impulse_pair(
                body_response, velocity_change, env, body_1, body_2, change, wp.cross(lever_1, change),
                -wp.cross(lever_2, change),
            )  # fmt: skip

    @unique_kernel()
    def restore_gaps(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        rows: Rows,
        body_response: BodyResponse,
        solve_result: SolveResult,
        velocity_change: VelocityChange,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            for body in range(velocity_change.shape[1]):
                velocity_change[env, body].linear = vec3()
                velocity_change[env, body].angular = vec3()
            count = solve_result.count[env]
            has_lost = wp.bool(False)
            for row in range(count):
                has_lost = has_lost or rows[env, row].lost_speed > zero
            if not has_lost:
                continue
            for row in range(count):
                rows[env, row].missing_speed = missing_speed(rows, body_response, env, row)
            # Not a constant, so that the loop is not unrolled.
            sweeps = wp.int32(SWEEPS)
            for _sweep in range(sweeps):
                for row in range(count):
                    correct(model, rows, body_response, velocity_change, env, row)

    return restore_gaps
