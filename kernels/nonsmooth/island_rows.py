"""Rows of islands: their data in a Gauss–Seidel solve, and how changes of their impulses and couples act on bodies."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.nonsmooth import anderson, islands, solver_common, velocity_update
from warpcontact.kernels.nonsmooth.rows import solve_types
from warpcontact.kernels.types import Struct, structs

# States of a block: it is computed on first use, and recomputed with softening after some sweeps.
BLOCK_UNSET, BLOCK_EXACT, BLOCK_SOFTENED = 0, 1, 2
# Number of sweeps without an impulse after which the stored differences of a row are 0.
IDLE = anderson.HISTORY + 2


@functools.cache
def scratch(real: type, rolls: bool) -> Struct:
    """Returns the struct of solver data per row."""
    t = structs(real)
    vec3, mat33 = t.vec3, t.mat33

    Differences = anderson.types(real).Differences

    @wp.struct
    class Scratch:
        """A row of an island, in the order of islands."""

        row: wp.int32  # its index among the rows of the environment
        body_1: wp.int32  # or WORLD
        body_2: wp.int32  # or WORLD
        is_open: wp.int32  # 1: its contact is open and may close in this step
        block_state: wp.int32  # BLOCK_*: state of ``block``
        idle_sweeps: wp.int32  # number of sweeps since it had an impulse, at most IDLE
        normal: vec3  # unit, W
        arm_1: vec3  # to K from the center of mass of the first body, W [m]
        arm_2: vec3  # to K from the center of mass of the second body, W [m]
        mu: real  # coefficient of friction
        rho: real  # effective mass ρ at the contact, 3 over the trace of ``block`` [kg]
        weight: real  # 1/ρ; 0 without mobility [1/kg]
        scale: real  # (ρ V)², see ``solver_common.py`` [N²·s²]
        softness: real  # additional separation speed per normal impulse [1/kg]
        free: vec3  # q, W [m/s]
        impulse: vec3  # on the first body, W [N·s]
        guess: vec3  # impulse from which a fallback starts, W [N·s]
        inverse: mat33  # of the block, W [kg]
        block: mat33  # w per impulse, (normal, two tangents) [1/kg]
        last_step: vec3  # change of the impulse by the last sweep; with momentum, since the last sweep, W [N·s]
        last_impulse: vec3  # impulse after the last sweep, W [N·s]
        step_differences: Differences  # differences of ``last_step`` between sweeps, see ``anderson.py`` [N·s]
        impulse_differences: Differences  # likewise of ``last_impulse`` [N·s]
        if rolls:
            couple_weight: real  # a third of the trace of the response of the angular velocity [1/(kg·m²)]
            last_couple_step: vec3  # change of the couple by the last sweep, W [N·m·s]
            last_couple: vec3  # couple after the last sweep, W [N·m·s]
            couple_step_differences: Differences  # as those of the impulse [N·m·s]
            couple_differences: Differences  # [N·m·s]
            couple_guess: vec3  # couple from which a fallback starts, W [N·m·s]
            turning: vec3  # relative angular velocity without contact, W [rad/s]

    return Scratch


class Functions(NamedTuple):
    """Device functions of the rows of islands."""

    #: ``(rows, body_response, velocity_change, scratch, env, count, tolerance)``: initializes all islands and applies the
    #: warm start. Returns a number that is finite if all data are.
    initialize: wp.Function
    #: ``(velocity_change, scratch, env, island, first, end)``: assigns V to the bodies of an island in contact, and (ρ V)²
    #: to its rows, which are ``first`` to ``end`` of ``scratch``.
    initialize_scale: wp.Function
    #: ``(rows, scratch, env, first, end)``: stores the warm start and initializes the data of sweeps.
    save_guess: wp.Function
    #: ``(body_response, velocity_change, scratch, env, index, step)``: adds the responses of the bodies of a row to a
    #: change of its impulse.
    apply_step: wp.Function
    #: Likewise of its couple.
    apply_couple_step: wp.Function
    #: ``(rows, body_response, velocity_change, scratch, env, index, scale, least_residual)``: solves the couple of a row if
    #: its residual exceeds ``least_residual``. Returns the residual, squared and relative as ``least_residual``, and whether
    #: the couple changed.
    update_couple: wp.Function


@functools.cache
def functions(real: type, has_joints: bool, rolls: bool, is_soft: bool = False) -> Functions:
    """Returns the device functions for ``real``; the options are those of ``gauss_seidel.kernel``."""
    vec3 = structs(real).vec3
    Rows, _, BodyResponse, VelocityChange = solve_types(real, has_joints)
    RowScratch = scratch(real, rolls)
    Scratch = wp.array2d(dtype=RowScratch)
    Differences = anderson.types(real).Differences
    f = velocity_update.functions(real, has_joints)
    apply_impulse, apply_impulse_pair, relative_spin_change = (
        f.apply_impulse,
        f.apply_impulse_pair,
        f.relative_spin_change,
    )
    angular_response_trace, project_couple = f.angular_response_trace, f.project_couple
    spin_after = velocity_update.relative_velocities(real, has_joints).spin_after
    common = solver_common.functions(real, has_joints, rolls, is_soft)
    clear_change, initialize_row, residual_scale = (
        common.clear_change,
        common.initialize_row,
        common.residual_scale,
    )
    find_islands = islands.functions(real, has_joints, RowScratch).find_islands
    zero, one, three = (wp.constant(real(x)) for x in (0.0, 1.0, 3.0))
    block_unset, idle = wp.constant(BLOCK_UNSET), wp.constant(IDLE)

    @wp.func
    def initialize(
        rows: Rows,
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        scratch: Scratch,
        env: int,
        count: int,
        tolerance: real,
    ):
        clear_change(velocity_change, env)
        find_islands(rows, body_response, velocity_change, scratch, env, count)
        finite = zero
        for index in range(count):
            row = scratch[env, index].row
            data = initialize_row(rows, body_response, velocity_change, env, row, tolerance)
            finite += data.size
            body_1 = rows[env, row].body_1
            body_2 = rows[env, row].body_2
            scratch[env, index].body_1 = body_1
            scratch[env, index].body_2 = body_2
            scratch[env, index].normal = rows[env, row].normal
            scratch[env, index].arm_1 = rows[env, row].arm_1
            scratch[env, index].arm_2 = rows[env, row].arm_2
            scratch[env, index].mu = rows[env, row].mu
            scratch[env, index].is_open = wp.where(rows[env, row].recovery < zero, 1, 0)
            scratch[env, index].impulse = rows[env, row].impulse
            scratch[env, index].rho = data.rho
            scratch[env, index].free = data.free
            if wp.static(is_soft):
                scratch[env, index].softness = rows[env, row].softness
            if wp.static(rolls):
                trace = angular_response_trace(body_response, env, body_1) + angular_response_trace(
                    body_response, env, body_2
                )
                scratch[env, index].couple_weight = trace / three
                scratch[env, index].turning = spin_after(body_response, env, body_1, body_2)
            rows[env, row].is_unsolved = 1
        return finite

    @wp.func
    def initialize_scale(
        velocity_change: VelocityChange, scratch: Scratch, env: int, island: int, first: int, end: int
    ):
        speed_squared = zero
        body = wp.int32(island)
        while body >= 0:
            speed_squared = wp.max(speed_squared, velocity_change[env, body].speed_squared)
            body = velocity_change[env, body].next_member
        body = island
        while body >= 0:
            if velocity_change[env, body].speed_squared >= zero:
                velocity_change[env, body].speed_squared = speed_squared
            body = velocity_change[env, body].next_member
        for index in range(first, end):
            scratch[env, index].scale = residual_scale(
                velocity_change,
                env,
                scratch[env, index].body_1,
                scratch[env, index].body_2,
                scratch[env, index].rho,
            )

    @wp.func
    def save_guess(rows: Rows, scratch: Scratch, env: int, first: int, end: int):
        for index in range(first, end):
            impulse = scratch[env, index].impulse
            rho = scratch[env, index].rho
            scratch[env, index].block_state = block_unset
            scratch[env, index].weight = wp.where(rho > zero, one / rho, zero)
            scratch[env, index].last_step = vec3()
            scratch[env, index].last_impulse = impulse
            scratch[env, index].step_differences = Differences()
            scratch[env, index].impulse_differences = Differences()
            scratch[env, index].idle_sweeps = wp.where(wp.length_sq(impulse) > zero, 0, idle)
            scratch[env, index].guess = impulse
            if wp.static(rolls):
                couple = rows[env, scratch[env, index].row].couple
                scratch[env, index].couple_guess = couple
                scratch[env, index].last_couple_step = vec3()
                scratch[env, index].last_couple = couple
                scratch[env, index].couple_step_differences = Differences()
                scratch[env, index].couple_differences = Differences()
                scratch[env, index].idle_sweeps = 0

    @wp.func
    def apply_step(
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        scratch: Scratch,
        env: int,
        index: int,
        step: vec3,
    ):
        apply_impulse_pair(
            body_response, velocity_change, env, scratch[env, index].body_1, scratch[env, index].body_2, step,
            wp.cross(scratch[env, index].arm_1, step), -wp.cross(scratch[env, index].arm_2, step),
        )  # fmt: skip

    @wp.func
    def apply_couple_step(
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        scratch: Scratch,
        env: int,
        index: int,
        step: vec3,
    ):
        apply_impulse(body_response, velocity_change, env, scratch[env, index].body_1, vec3(), step)
        apply_impulse(body_response, velocity_change, env, scratch[env, index].body_2, vec3(), -step)

    @wp.func
    def update_couple(
        rows: Rows,
        body_response: BodyResponse,
        velocity_change: VelocityChange,
        scratch: Scratch,
        env: int,
        index: int,
        scale: real,
        least_residual: real,
    ):
        row = scratch[env, index].row
        body_1 = scratch[env, index].body_1
        body_2 = scratch[env, index].body_2
        n = scratch[env, index].normal
        weight = scratch[env, index].couple_weight
        if weight <= zero:
            return zero, 0
        turning = scratch[env, index].turning + relative_spin_change(velocity_change, env, body_1, body_2)
        normal_impulse = wp.max(wp.dot(scratch[env, index].impulse, n), zero)
        couple = rows[env, row].couple
        new = project_couple(
            couple - one / weight * turning,
            n,
            rows[env, row].rolling * normal_impulse,
            rows[env, row].spinning * normal_impulse,
        )
        step = new - couple
        # As an impulse: divided by the arm at which force and couple have the same mobility.
        residual = scratch[env, index].rho * weight * wp.length_sq(step) / scale
        if residual <= least_residual:
            return residual, 0
        rows[env, row].couple = new
        apply_couple_step(body_response, velocity_change, scratch, env, index, step)
        return residual, 1

    return Functions(
        initialize=initialize,
        initialize_scale=initialize_scale,
        save_guess=save_guess,
        apply_step=apply_step,
        apply_couple_step=apply_couple_step,
        update_couple=update_couple,
    )
