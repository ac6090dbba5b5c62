"""Sequential impacts: separation speeds of the active contacts of a step.

The pair of bodies with the largest approach speed collides first. Its contacts are solved together, without
friction, by Newton's law with the current velocities. This repeats until no contact approaches.
``restitution_speed`` of each contact that was hit is its normal velocity after the sequence; the solvers reach it
with friction and forces. So an impact propagates through bodies in contact, as in Newton's cradle. With
simultaneous impacts, ``restitution_speed`` depends only on the velocities before the step. Reference: Smith et
al., Reflections on simultaneous impact, ACM Transactions on Graphics 31, 2012.
"""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.nonsmooth import solver_common, velocity_update
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, Struct, first_env, structs, task_count

#: Maximum number of impacts in a step, per active contact. Contacts that still approach then do not bounce.
MAX_IMPACTS_PER_CONTACT = 50
# Maximum number of sweeps over the contacts of one impact.
MAX_SWEEPS = 200
# Relative difference below which approach speeds are equal; of equal ones the first contact is used.
TIE = 1.0e-3


@functools.cache
def scratch(real: type) -> Struct:
    """Returns the struct of a row of the sequence."""

    @wp.struct
    class ImpactRow:
        response: real  # normal velocity per normal impulse [1/kg]
        target: real  # separation speed after the current impact [m/s]
        impulse: real  # normal impulse of the current impact [N·s]
        was_hit: wp.int32  # 1: an impact exerted an impulse on it

    return ImpactRow


@functools.cache
def kernel(real: type, has_joints: bool) -> wp.Kernel:
    """Returns the kernel that sets ``restitution_speed`` of all rows by sequential impacts; items: 1.

    With ``has_joints`` some bodies have joints.
    """
    State = structs(real).State
    Rows, SolveResult, BodyResponse, VelocityChange = solve_types(real, has_joints)
    ImpactRows = wp.array2d(dtype=scratch(real))
    before = velocity_update.relative_velocities(real, has_joints).before
    f = velocity_update.functions(real, has_joints)
    velocity_change_at, impulse_response, apply_row_impulse = (
        f.velocity_change_at,
        f.impulse_response,
        f.apply_row_impulse,
    )
    clear_change = solver_common.functions(real, has_joints, False).clear_change
    zero = wp.constant(real(0.0))
    impacts, sweeps = wp.constant(MAX_IMPACTS_PER_CONTACT), wp.constant(MAX_SWEEPS)
    tie_factor, solve_fraction = wp.constant(real(1.0 + TIE)), wp.constant(real(0.1))

    @wp.func
    def separation_speed(half_step_state: State, rows: Rows, velocity_change: VelocityChange, env: int, row: int):
        """Returns the current normal relative velocity, positive in separation."""
        body_1 = rows[env, row].body_1
        body_2 = rows[env, row].body_2
        arm_1 = rows[env, row].arm_1
        arm_2 = rows[env, row].arm_2
        u = before(half_step_state, env, body_1, body_2, arm_1, arm_2) + velocity_change_at(
            velocity_change, env, body_1, arm_1
        )
        return wp.dot(u - velocity_change_at(velocity_change, env, body_2, arm_2), rows[env, row].normal)

    @wp.func
    def connects(rows: Rows, env: int, row: int, body_1: int, body_2: int):
        """Returns whether a row is between two bodies."""
        first = rows[env, row].body_1
        second = rows[env, row].body_2
        return (first == body_1 and second == body_2) or (first == body_2 and second == body_1)

    @wp.func
    def initialize(rows: Rows, body_response: BodyResponse, impact_rows: ImpactRows, env: int, count: int):
        """Initializes all rows; returns whether any has restitution."""
        elastic = wp.bool(False)
        for row in range(count):
            n = rows[env, row].normal
            response_velocity = impulse_response(
                body_response, env, rows[env, row].body_1, rows[env, row].arm_1, n
            )
            response_velocity += impulse_response(
                body_response, env, rows[env, row].body_2, rows[env, row].arm_2, n
            )
            impact_rows[env, row].response = wp.dot(response_velocity, n)
            if rows[env, row].recovery < zero:
                # An open contact has no impact.
                impact_rows[env, row].response = zero
            impact_rows[env, row].was_hit = 0
            elastic = elastic or rows[env, row].restitution > zero
        return elastic

    @wp.func
    def fastest(
        half_step_state: State,
        rows: Rows,
        velocity_change: VelocityChange,
        impact_rows: ImpactRows,
        env: int,
        count: int,
    ):
        """Returns the row with the largest approach speed, and that speed; of equal ones the first."""
        found = wp.int32(-1)
        speed = zero
        for row in range(count):
            if impact_rows[env, row].response > zero:
                approach = -separation_speed(half_step_state, rows, velocity_change, env, row)
                if approach > speed * tie_factor:
                    found = row
                    speed = approach
        return found, speed

    @wp.func
    def collide(
        half_step_state: State,
        rows: Rows,
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        impact_rows: ImpactRows,
        env: int,
        count: int,
        body_1: int,
        body_2: int,
        rest_speed: real,
    ):
        """Computes one impact of two bodies, by projected Gauss–Seidel over their contacts."""
        for row in range(count):
            if connects(rows, env, row, body_1, body_2):
                approach = wp.max(-separation_speed(half_step_state, rows, velocity_change, env, row), zero)
                impact_rows[env, row].target = rows[env, row].restitution * approach
                impact_rows[env, row].impulse = zero
        for _ in range(sweeps):
            worst = zero
            for row in range(count):
                if impact_rows[env, row].response > zero and connects(rows, env, row, body_1, body_2):
                    impulse = impact_rows[env, row].impulse
                    speed_deficit = impact_rows[env, row].target - separation_speed(
                        half_step_state, rows, velocity_change, env, row
                    )
                    new = wp.max(impulse + speed_deficit / impact_rows[env, row].response, zero)
                    impact_rows[env, row].impulse = new
                    step = (new - impulse) * rows[env, row].normal
                    apply_row_impulse(rows, body_response, velocity_change, env, row, step)
                    worst = wp.max(worst, wp.abs(new - impulse) * impact_rows[env, row].response)
            if worst <= rest_speed:
                break
        for row in range(count):
            if connects(rows, env, row, body_1, body_2) and impact_rows[env, row].impulse > zero:
                impact_rows[env, row].was_hit = 1

    @unique_kernel()
    def sequence_impacts(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        half_step_state: State,
        rows: Rows,
        body_response: BodyResponse,
        solve_result: SolveResult,
        tolerance: real,
        impact_rows: ImpactRows,
        velocity_change: VelocityChange,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            count = solve_result.count[env]
            if not initialize(rows, body_response, impact_rows, env, count):
                continue
            clear_change(velocity_change, env)
            row, speed = fastest(half_step_state, rows, velocity_change, impact_rows, env, count)
            # Approach below the tolerance times the speed gained by gravity in a step counts as rest.
            rest_speed = tolerance * wp.max(speed, solve_result.slack[env] / step[env, 0])
            remaining = impacts * count
            while remaining > 0 and speed > rest_speed:
                collide(
                    half_step_state, rows, body_response, velocity_change, impact_rows, env, count,
                    rows[env, row].body_1, rows[env, row].body_2,
                    solve_fraction * rest_speed,
                )  # fmt: skip
                row, speed = fastest(half_step_state, rows, velocity_change, impact_rows, env, count)
                remaining -= 1
            for number in range(count):
                restitution_speed = zero
                if impact_rows[env, number].was_hit == 1:
                    restitution_speed = wp.max(
                        separation_speed(half_step_state, rows, velocity_change, env, number), zero
                    )
                rows[env, number].restitution_speed = restitution_speed

    return sequence_impacts
