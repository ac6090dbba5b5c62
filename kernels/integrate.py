"""Time integration of rigid bodies: one kernel per scheme, from ``state_in`` to ``state_out``."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import finish, frames, history, quarantine, rotations
from warpcontact.kernels import wrenches as of_wrenches
from warpcontact.kernels.piles import sums as sums_of_piles
from warpcontact.kernels.piles.base import pile_structs
from warpcontact.kernels.strides import anew, telling
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    ENV_FAILED,
    FREE,
    NO_CAUSE,
    Work,
    env_of,
    item_of,
    natural,
    structs,
    task_count,
)
from warpcontact.kernels.unique import unique_kernel

# Registers of a thread of a GPU in float32 that adds touches up, so that many wait for memory at once; measured.
REGISTERS = 72


@functools.cache
def _spin(real: type) -> wp.Function:
    t = structs(real)
    vec3, quat, mat33 = t.vec3, t.quat, t.mat33

    @wp.func
    def spin(inverse_inertia_B: mat33, q_WB: quat, momentum_W: vec3):
        """Angular velocity in W of a body with angular momentum ``momentum_W``."""
        return wp.quat_rotate(q_WB, inverse_inertia_B * wp.quat_rotate_inv(q_WB, momentum_W))

    return spin


@functools.cache
def euler(real: type) -> SimpleNamespace:
    """Returns the struct ``Moved`` and the device functions of a semi-implicit Euler step of a free body.

    Velocities first, from the wrenches at ``state_in``; positions with the new velocities. Rotation advances the
    angular momentum L, which carries the gyroscopic term without an approximation, and turns the body by the
    exponential of the angular velocity at mid-step: a free body keeps L to rounding and its energy to second
    order. One with the same inertia about all axes needs no more than its spin.
    """
    t = structs(real)
    vec3, quat, Model, State = t.vec3, t.quat, t.Model, t.State
    rotated = rotations.functions(real).rotated
    spin = _spin(real)
    of_guard = quarantine.guard(real)
    Guard, cause_of = of_guard.Guard, of_guard.cause_of

    @wp.struct
    class Moved:
        """State of a body after a step."""

        position: vec3
        remainder: vec3
        orientation: quat
        velocity: vec3
        spin: vec3

    @wp.func
    def moved_by(model: Model, state: State, env: int, body: int, force: vec3, torque: vec3, dt: real):
        """The state that a wrench, beside gravity, leads to."""
        acceleration = (real(1.0) / model.body_mass[env, body]) * force + model.gravity[env, 0]
        velocity = state.body_linear_velocity[env, body] + dt * acceleration
        # A step is often smaller than what a position is rounded to: nothing of it is lost.
        before = state.body_position[env, body]
        way = dt * velocity + state.body_position_remainder[env, body]
        position = before + way
        gone = position - before

        q_WB = state.body_orientation[env, body]
        w_W = state.body_angular_velocity[env, body]
        inverse_B = model.body_inverse_inertia[env, body]
        turning = w_W + (dt * inverse_B[0, 0]) * torque
        orientation = q_WB
        if model.body_round[env, body]:
            orientation = rotated(q_WB, dt * turning)
        else:
            inertia_B = model.body_inertia[env, body]
            last_momentum = wp.quat_rotate(q_WB, inertia_B * wp.quat_rotate_inv(q_WB, w_W))
            momentum = last_momentum + dt * torque
            start = spin(inverse_B, q_WB, momentum)
            q_middle = rotated(q_WB, real(0.5) * dt * start)
            orientation = rotated(q_WB, dt * spin(inverse_B, q_middle, momentum))
            # The change of spin, not the spin itself: a quaternion is a little longer or shorter than one and
            # scales what it rotates, which in a difference from step to step cancels instead of adding up.
            turning = w_W + (spin(inverse_B, orientation, momentum) - spin(inverse_B, q_WB, last_momentum))
        moved = Moved()
        moved.position = position
        moved.remainder = (before - (position - gone)) + (way - gone)
        moved.orientation = orientation
        moved.velocity = velocity
        moved.spin = turning
        return moved

    @wp.func
    def put(state: State, env: int, body: int, moved: Moved):
        state.body_position[env, body] = moved.position
        state.body_position_remainder[env, body] = moved.remainder
        state.body_orientation[env, body] = moved.orientation
        state.body_linear_velocity[env, body] = moved.velocity
        state.body_angular_velocity[env, body] = moved.spin

    @wp.func
    def failure_of(guard: Guard, env: int, moved: Moved):
        """Why a step may not be taken, or NO_CAUSE."""
        # One sum is finite only if every term is: squares have no opposite signs.
        sizes = wp.length_sq(moved.position) + wp.length_sq(moved.velocity) + wp.length_sq(moved.spin)
        if sizes < guard.suspect[env, 0]:
            return NO_CAUSE
        return cause_of(moved.position, moved.velocity, moved.spin, guard.limits[env, 0])

    return SimpleNamespace(Guard=Guard, moved_by=moved_by, put=put, failure_of=failure_of)


@functools.cache
def semi_implicit_euler(
    real: type,
    moves: bool = False,
    sources: tuple[bool, bool] | None = None,
    accepts: bool = False,
    piled: bool = False,
) -> wp.Kernel:
    """Returns the semi-implicit Euler kernel; items: bodies.

    With ``moves``, bodies that are not free are left to ``motions``. With ``sources``, the options of
    ``wrenches.functions``, it adds the wrenches up before, with what touches of a pile do if ``piled``, and writes
    them if they are ``told``. With ``accepts``, for environments of one body, it ends their step, and takes their
    contacts into the history.
    """
    t = structs(real)
    vec3, Model, State, Near, Ends, Wrenches = t.vec3, t.Model, t.State, t.Near, t.Ends, t.Wrenches
    sums = sources is not None
    History, Contacts, Cache = t.History, t.Contacts, t.Cache
    end, advance = finish.end_of_step(real), history.advance(real, False)
    total = of_wrenches.functions(real, *(sources or (False, False))).total
    empty = of_wrenches.empty
    of_body = euler(real)
    Guard, moved_by, put, failure_of = of_body.Guard, of_body.moved_by, of_body.put, of_body.failure_of
    p, of_shape = pile_structs(real), sums_of_piles.functions(real)
    Shapes, Lists, Touches, Sum, add_shape = p.Shapes, p.Lists, p.Touches, of_shape.Sum, of_shape.add_shape
    registers = REGISTERS if piled and real is wp.float32 else None
    tell_model, tell_state, tell_near = telling(Model), telling(State), telling(Near)
    tell_contacts, tell_history, tell_cache = telling(Contacts), telling(History), telling(Cache)

    @unique_kernel(registers)
    def semi_implicit_euler(
        work: Work,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        model: Model,
        guard: Guard,
        state_in: State,
        waiting: wp.array(dtype=wp.int32),
        near: Near,
        ends: Ends,
        shapes: Shapes,
        lists: Lists,
        touches: Touches,
        told: wp.bool,
        wrenches: Wrenches,
        clock_step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]; this and what follows if it accepts
        time: wp.array(dtype=wp.float64),  # [env] [s]
        blocks: wp.int32,
        contacts: Contacts,
        history_of: History,
        cache: Cache,
        state_out: State,
    ):
        tell_model(model)
        tell_state(state_in)
        tell_state(state_out)
        tell_near(near)
        tell_contacts(contacts)
        tell_history(history_of)
        tell_cache(cache)
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            body = item_of(work, task)
            if wp.static(sums):  # noqa: SIM102  Warp would evaluate both sides
                if task == 0:
                    empty(waiting)
            if status[env] != ENV_ACTIVE:
                continue
            force = vec3()
            torque = vec3()
            if wp.static(sums):
                wrench = total(model, near, ends, env, body)
                force = wrench.force
                torque = wrench.torque
                if wp.static(piled):
                    shape = shapes.of_body[body]
                    if shape >= 0:
                        of_pile = add_shape(Sum(), state_in, shapes, lists, touches, env, shape)
                        force += of_pile.force
                        torque += of_pile.torque
                if told:
                    wrenches.force[env, body] = force
                    wrenches.torque[env, body] = torque
            else:
                force = wrenches.force[env, body]
                torque = wrenches.torque[env, body]
            if wp.static(moves):  # noqa: SIM102  Warp would evaluate both sides
                if model.body_motion[env, body].kind != FREE:
                    continue
            moved = moved_by(model, state_in, env, body, force, torque, step[env, 0])
            put(state_out, env, body, moved)
            cause = failure_of(guard, env, moved)
            if cause != NO_CAUSE:
                status[env] = ENV_FAILED
                guard.cause[env] = cause
            if wp.static(accepts):
                found = status[env]
                end(status, clock_step, time, 1, state_in, state_out, env, found)
                if found == ENV_ACTIVE:
                    block = natural(0)
                    while block < blocks:
                        advance(time, step, model, contacts, near, history_of, cache, anew(env), block)
                        block = natural(block + 1)

    return semi_implicit_euler


@functools.cache
def change_step(real: type, moves: bool = False) -> wp.Kernel:
    """Returns the kernel that readies a state for steps of another length; items: bodies.

    With ``moves``, bodies that are not free are left to ``motions``.

    The velocities of semi-implicit Euler belong to half a step before the positions, so a step that is longer by
    ``change`` begins from velocities of change/2 earlier. Without this the energy of a contact jumps.
    """
    t = structs(real)
    Model, State, Wrenches = t.Model, t.State, t.Wrenches
    spin = _spin(real)

    @unique_kernel()
    def change_step(
        work: Work,
        status: wp.array(dtype=wp.int32),
        change: wp.array2d(dtype=real),  # [env, 0] length of the next step less that of the last [s]
        model: Model,
        wrenches: Wrenches,  # of this instant
        state: State,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            body = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            if wp.static(moves):  # noqa: SIM102  Warp would evaluate both sides
                if model.body_motion[env, body].kind != FREE:
                    continue
            earlier = real(0.5) * change[env, 0]
            acceleration = wrenches.force[env, body] / model.body_mass[env, body] + model.gravity[env, 0]
            turning = spin(
                model.body_inverse_inertia[env, body],
                state.body_orientation[env, body],
                wrenches.torque[env, body],
            )
            state.body_linear_velocity[env, body] = state.body_linear_velocity[env, body] - earlier * acceleration
            state.body_angular_velocity[env, body] = state.body_angular_velocity[env, body] - earlier * turning

    return change_step


@functools.cache
def adopt(real: type) -> wp.Kernel:
    """Returns the kernel that copies the active environments of a state; items: bodies."""
    State = structs(real).State
    copy_body = frames.functions(real).copy_body

    @unique_kernel()
    def adopt(work: Work, status: wp.array(dtype=wp.int32), source: State, target: State):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            body = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            copy_body(source, target, env, body)

    return adopt
