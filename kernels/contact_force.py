"""Contact force of one group of contacts: law and friction to the wrenches of both bodies.

A factory compiles the law and the friction into the kernel, once per (law, friction, precision); their
coefficients are data. A pure function of model, state and history: nothing here changes them.
"""

import functools
import math

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.formula import coefficient_struct
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, structs


@functools.cache
def kernel(law: type, friction: type, real: type) -> wp.Kernel:
    """Returns the kernel for a law and a friction class. Launch with dim (env, contact of the group)."""
    t = structs(real)
    vec3, Model, State, History = t.vec3, t.Model, t.State, t.History
    Contacts, Wrenches, Touch, Slip = t.Contacts, t.Wrenches, t.Touch, t.Slip
    LawCoefficients = coefficient_struct(law, real)
    FrictionCoefficients = coefficient_struct(friction, real)
    law_force, friction_force = law.force, friction.force
    needs_mass = law.needs_mass
    lowest = wp.constant(real(-math.inf if law.pulls else 0.0))
    velocity_at = frames.functions(real).velocity_at

    @wp.func
    def mobility(model: Model, state: State, env: int, body: int, p_W: vec3, n_W: vec3):
        """Inverse of the mass that ``body`` opposes to a force along ``n_W`` at ``p_W``; 0 for the world."""
        if body < 0:
            return real(0.0)
        q_WB = state.body_orientation[env, body]
        lever_B = wp.quat_rotate_inv(q_WB, wp.cross(p_W - state.body_position[env, body], n_W))
        turning = wp.dot(lever_B, model.body_inverse_inertia[env, body] * lever_B)
        return real(1.0) / model.body_mass[env, body] + turning

    @wp.func
    def cut(force: real):
        """A law that does not pull is cut at zero. Not by max, which turns a NaN into 0 and hides it."""
        if force < lowest:
            return lowest
        return force

    @wp.func
    def add_wrench(wrenches: Wrenches, state: State, env: int, body: int, p_W: vec3, force_W: vec3):
        if body >= 0:
            wp.atomic_add(wrenches.force, env, body, force_W)
            wp.atomic_add(wrenches.torque, env, body, wp.cross(p_W - state.body_position[env, body], force_W))

    @wp.kernel(module="unique", enable_backward=False)
    def contact_force(
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        step: wp.array2d(dtype=real),  # [env, 0] what the force acts over [s]; 0: the force of this instant
        first: wp.int32,
        law_coefficients: wp.array2d(dtype=LawCoefficients),
        friction_coefficients: wp.array2d(dtype=FrictionCoefficients),
        contacts: Contacts,
        wrenches: Wrenches,
    ):
        env, member = wp.tid()
        if status[env] != ENV_ACTIVE:
            return
        contact = first + member
        if contacts.status[env, contact] != CONTACT:
            contacts.approach_speed[env, contact] = real(0.0)
            contacts.normal_force[env, contact] = real(0.0)
            contacts.friction_force[env, contact] = vec3()
            contacts.slip_speed[env, contact] = real(0.0)
            return

        n_W = contacts.normal[env, contact]
        k_W = contacts.point[env, contact]
        body_1 = model.point_body[model.contact_point[contact]]
        body_2 = model.surface_body[model.patch_surface[model.contact_patch[contact]]]

        # Of the surface relative to the point: approach is positive.
        v_W = velocity_at(state, env, body_2, k_W) - velocity_at(state, env, body_1, k_W)
        approach = wp.dot(v_W, n_W)

        touch = Touch()
        touch.delta = contacts.penetration[env, contact]
        touch.delta_dot = approach
        # A contact that begins here has no entry speed yet; one that reloads faster than it began takes the
        # faster speed. The same rule advances the history, so a trial state sees the same force.
        touch.entry_speed = wp.max(wp.max(history.entry_speed[env, contact], approach), real(0.0))
        if wp.static(needs_mass):
            touch.mass = real(1.0) / (
                mobility(model, state, env, body_1, k_W, n_W) + mobility(model, state, env, body_2, k_W, n_W)
            )
        touch.dt = step[env, 0]
        p = law_coefficients[env, member]
        normal_force = cut(law_force(p, touch))

        # The force of a step stands for the time from half a step before this state to half a step after: the
        # contact's share of it, when it began since the last state, is δ/(δ̇ dt) + 1/2 steps. A law continuous
        # at touch makes no difference of first order; one that jumps (a dashpot) is given its missing impulse.
        travel = approach * touch.dt
        if history.entry_speed[env, contact] < real(0.0) and touch.delta <= travel * real(1.001):
            late = wp.min(touch.delta / travel, real(1.0))
            touch.delta = touch.delta * real(1.0e-6)
            normal_force = cut(normal_force + (late - real(0.5)) * cut(law_force(p, touch)))

        slip = Slip()
        slip.velocity = approach * n_W - v_W
        slip.speed = wp.length(slip.velocity)
        slip.normal_force = normal_force
        if normal_force < real(0.0):
            slip.normal_force = real(0.0)
        friction_W = friction_force(friction_coefficients[env, member], slip)

        contacts.approach_speed[env, contact] = approach
        contacts.normal_force[env, contact] = normal_force
        contacts.friction_force[env, contact] = friction_W
        contacts.slip_speed[env, contact] = slip.speed

        # The same force at the same point K on both bodies: total force and moment vanish.
        force_W = normal_force * n_W + friction_W
        add_wrench(wrenches, state, env, body_1, k_W, force_W)
        add_wrench(wrenches, state, env, body_2, k_W, -force_W)

    return contact_force
