"""After a step: what nonsmooth contacts remember of it, what they took of the energy, and how it is read."""

import functools
from typing import Any

import warp as wp
from warpcontact.kernels.piles.base import TOUCHES, pile_structs
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    ENV_RESTING,
    MODE_OPEN,
    MODE_SLIP,
    MODE_STICK,
    Work,
    env_of,
    first_env,
    item_of,
    structs,
    task_count,
)
from warpcontact.kernels.unilateral import relative
from warpcontact.kernels.unilateral.records import record_structs
from warpcontact.kernels.unilateral.rows import moving_struct, row_structs
from warpcontact.kernels.unique import unique_kernel


@functools.cache
def kernel(real: type, moves: bool, rolls: bool) -> wp.Kernel:
    """Returns the kernel that takes the rows of an accepted step into the memory of their contacts; items: 1.

    With ``moves`` not all bodies are free, and with ``rolls`` some contacts oppose rolling or spinning.
    Environments that were left out of the step, by ``rest``, are active again.

    An impulse P at a contact with the velocities U⁻ before and U⁺ after takes −P·(U⁻ + U⁺)/2 of the energy: with
    θ = ½ this and the work of the forces make up the change of the kinetic energy of free bodies.
    """
    t = structs(real)
    vec3, State, Wrenches = t.vec3, t.State, t.Wrenches
    r, records = row_structs(real), record_structs(real)
    Rows, Outcome = r.Rows, r.Outcome
    Memory, Memories, Account = records.Memory, records.Memories, records.Account
    Restraint = records.Restraint
    Moving = wp.array2d(dtype=moving_struct(real, moves))
    f = relative.functions(real, moves)
    velocity_before, velocity_after = f.before, f.after
    spin_before, spin_after = f.spin_before, f.spin_after
    # As near as that to the edge of the cone a contact slips: within rounding, and within what a solve leaves.
    ROUNDING = wp.constant(real(64.0 * t.epsilon))
    UNSOLVED = wp.constant(real(20.0))

    @wp.func
    def push(wrenches: Wrenches, env: int, body: int, force: vec3, torque: vec3):
        if body >= 0:
            wrenches.force[env, body] = wrenches.force[env, body] + force
            wrenches.torque[env, body] = wrenches.torque[env, body] + torque

    @unique_kernel()
    def remember_rows(
        work: Work,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        tolerance: real,
        bodies: wp.int32,
        middle: State,
        rows: Rows,
        moving: Moving,
        outcome: Outcome,
        restraint: Restraint,
        memory: Memories,
        account: Account,
        reactions: Wrenches,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            if status[env] == ENV_RESTING:
                status[env] = ENV_ACTIVE
                continue
            if status[env] != ENV_ACTIVE:
                continue
            number = account.step[env] + 1
            account.step[env] = number
            if restraint.part[env] < real(1.0):
                account.restitution_limited[env] = account.restitution_limited[env] + 1
            account.failures[env] = account.failures[env] + 1 - outcome.converged[env]
            if outcome.converged[env] == 0:
                account.largest_residual[env] = wp.max(account.largest_residual[env], outcome.residual[env])
            calm = wp.min(account.calm[env] + 1, 2)
            if outcome.converged[env] == 0 or outcome.iterations[env] > 0 or restraint.part[env] < real(1.0):
                calm = wp.int32(0)
            for body in range(bodies):
                reactions.force[env, body] = vec3()
                reactions.torque[env, body] = vec3()
                # What moves neither before nor after a step has the same pose after it.
                still = middle.body_linear_velocity[env, body] == vec3() and moving[env, body].linear == vec3()
                still = still and middle.body_angular_velocity[env, body] == vec3()
                if not (still and moving[env, body].angular == vec3()):
                    calm = wp.int32(0)
            per_step = real(1.0) / step[env, 0]
            inside = real(1.0) - wp.max(ROUNDING, UNSOLVED * tolerance)
            by_friction = wp.float64(0.0)
            by_impact = wp.float64(0.0)
            for number_of_row in range(outcome.count[env]):
                row = rows[env, number_of_row]
                impulse = row.impulse
                along = wp.dot(impulse, row.normal)
                across = impulse - along * row.normal
                u_after = velocity_after(moving, env, row.body_1, row.body_2, row.arm_1, row.arm_2)
                u_before = velocity_before(middle, env, row.body_1, row.body_2, row.arm_1, row.arm_2)
                mean = real(0.5) * (u_after + u_before)
                by_impact -= wp.float64(along * wp.dot(mean, row.normal))
                by_friction -= wp.float64(wp.dot(across, mean))
                turn_1 = wp.cross(row.arm_1, impulse)
                turn_2 = wp.cross(row.arm_2, impulse)
                if wp.static(rolls):
                    turned = spin_before(middle, env, row.body_1, row.body_2)
                    turned += spin_after(moving, env, row.body_1, row.body_2)
                    by_friction -= wp.float64(real(0.5) * wp.dot(row.couple, turned))
                    turn_1 += row.couple
                    turn_2 += row.couple
                push(reactions, env, row.body_1, per_step * impulse, per_step * turn_1)
                push(reactions, env, row.body_2, -per_step * impulse, -per_step * turn_2)
                parting = wp.dot(u_after, row.normal)
                limit = inside * row.mu * along
                known = Memory()
                known.impulse = impulse
                known.couple = row.couple
                known.normal = row.normal
                known.approach_speed = -parting
                known.slip_speed = wp.length(u_after - parting * row.normal)
                known.mode = wp.int32(MODE_SLIP)
                if along <= real(0.0):
                    known.mode = wp.int32(MODE_OPEN)
                elif limit > real(0.0) and wp.length_sq(across) < limit * limit:
                    known.mode = wp.int32(MODE_STICK)
                known.stamp = number
                # Which coefficient of friction the next step takes.
                if known.mode != memory[env, row.contact].mode or memory[env, row.contact].stamp != number - 1:
                    calm = wp.int32(0)
                memory[env, row.contact] = known
            account.calm[env] = calm
            account.friction_dissipation[env] = account.friction_dissipation[env] + by_friction
            account.impact_dissipation[env] = account.impact_dissipation[env] + by_impact

    return remember_rows


@functools.cache
def read(real: type, Contacts: Any) -> wp.Kernel:
    """Returns the kernel that shows what the last step of active environments did, where sensors look.

    Items: nonsmooth contacts. ``Contacts`` is the struct of the arrays of its contacts.
    """
    vec3 = structs(real).vec3
    records = record_structs(real)
    Memories, Account, Shown = records.Memories, records.Account, records.Shown

    @unique_kernel()
    def show_contacts(
        work: Work,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        first: wp.int32,  # number of the first contact of the arrays
        items: wp.array(dtype=wp.int32),  # [item] those of the arrays that are hard
        memory: Memories,
        account: Account,
        contacts: Contacts,
        shown: Shown,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            item = items[item_of(work, task)]
            if status[env] != ENV_ACTIVE:
                continue
            contact = first + item
            impulse = vec3()
            couple = vec3()
            approach_speed = real(0.0)
            slip_speed = real(0.0)
            mode = wp.int32(MODE_OPEN)
            along = real(0.0)
            normal = vec3()
            if memory[env, contact].stamp == account.step[env]:
                mode = memory[env, contact].mode
                if mode != MODE_OPEN:
                    impulse = memory[env, contact].impulse
                    couple = memory[env, contact].couple
                    normal = memory[env, contact].normal
                    along = wp.dot(impulse, normal)
                    approach_speed = memory[env, contact].approach_speed
                    slip_speed = memory[env, contact].slip_speed
            per_step = real(1.0) / step[env, 0]
            shown.impulse[env, contact] = impulse
            shown.mode[env, contact] = mode
            contacts.normal_force[env, item] = per_step * along
            contacts.friction_force[env, item] = per_step * (impulse - along * normal)
            contacts.torque[env, item] = per_step * couple
            contacts.approach_speed[env, item] = approach_speed
            contacts.slip_speed[env, item] = slip_speed

    return show_contacts


@functools.cache
def read_pile(real: type) -> wp.Kernel:
    """Returns the kernel that shows what the last step did in a pile. Launch with dim (env, shape).

    What pressed in it is shown as touching, even if it has come apart since.
    """
    vec3 = structs(real).vec3
    p = pile_structs(real)
    Shapes, Lists, Touches = p.Shapes, p.Lists, p.Touches
    records = record_structs(real)
    Memories, Account = records.Memories, records.Account

    @unique_kernel()
    def show_pile(
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        first: wp.int32,  # number of the contact of the first record
        shapes: Shapes,
        lists: Lists,
        memory: Memories,
        account: Account,
        touches: Touches,
    ):
        env, shape = wp.tid()
        if touches.busy[env, shape] == 0:
            return
        per_step = real(1.0) / step[env, 0]
        start = shapes.slot_start[shape]
        for slot in range(start, start + lists.owned[env, shape]):
            bits = touches.bits[env, slot]
            if bits == 0:
                continue
            force = vec3()
            along = real(0.0)
            approach_speed = real(0.0)
            contact = first + slot
            if memory[env, contact].stamp == account.step[env]:  # noqa: SIM102  Warp would look at both sides
                if memory[env, contact].mode != MODE_OPEN:
                    force = per_step * memory[env, contact].impulse
                    normal = memory[env, contact].normal
                    along = wp.dot(force, normal)
                    approach_speed = memory[env, contact].approach_speed
                    touches.normal[env, slot] = normal
                    touches.bits[env, slot] = bits | TOUCHES
            touches.force[env, slot] = force
            touches.normal_force[env, slot] = along
            touches.approach_speed[env, slot] = approach_speed

    return show_pile


@functools.cache
def push(real: type) -> wp.Kernel:
    """Returns the kernel that adds the mean forces of the last step to wrenches. Launch with dim (env, body)."""
    Wrenches = structs(real).Wrenches

    @unique_kernel()
    def add_reactions(reactions: Wrenches, wrenches: Wrenches):
        env, body = wp.tid()
        wrenches.force[env, body] = wrenches.force[env, body] + reactions.force[env, body]
        wrenches.torque[env, body] = wrenches.torque[env, body] + reactions.torque[env, body]

    return add_reactions


@functools.cache
def forget(real: type) -> wp.Kernel:
    """Returns the kernel that empties what chosen environments remember. Launch with dim env."""
    Wrenches = structs(real).Wrenches
    vec3 = structs(real).vec3
    Outcome, Account = row_structs(real).Outcome, record_structs(real).Account

    @unique_kernel()
    def forget_steps(
        mask: wp.array(dtype=wp.bool),
        everything: wp.int32,  # 0: but for the account
        bodies: wp.int32,
        outcome: Outcome,
        account: Account,
        reactions: Wrenches,
    ):
        env = wp.tid()
        if not mask[env]:
            return
        # No contact has the stamp of a step that none has taken.
        account.step[env] = account.step[env] + 1
        account.calm[env] = 0
        if everything == 1:
            account.failures[env] = 0
            account.largest_residual[env] = real(0.0)
            account.restitution_limited[env] = 0
            account.friction_dissipation[env] = wp.float64(0.0)
            account.impact_dissipation[env] = wp.float64(0.0)
        outcome.count[env] = 0
        outcome.residual[env] = real(0.0)
        outcome.iterations[env] = 0
        outcome.converged[env] = 1
        for body in range(bodies):
            reactions.force[env, body] = vec3()
            reactions.torque[env, body] = vec3()

    return forget_steps
