"""Contact force of one group of contacts: from law, friction, rolling and torsion to the wrenches of both bodies.

A factory compiles these four parts into the kernel, once per combination and precision; their coefficients are
data. A pure function of model, state and history: nothing here changes them.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels import frames, memory
from warpcontact.kernels.formula import Formula, coefficient_struct, named_struct
from warpcontact.kernels.frictions import Frictionless
from warpcontact.kernels.motions import bodies
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, FREE, HERTZ_PATCH, INLINED, Work, structs


class Parts(NamedTuple):
    """The formulas of a contact, as classes: what the kernel is compiled from."""

    law: type[Formula]
    friction: type[Formula] = Frictionless
    rolling: type[Formula] = Frictionless
    torsion: type[Formula] = Frictionless


def group_structs(parts: Parts, real: type) -> tuple[Any, Any]:
    """Returns the structs of arrays [env, contact of the group]: coefficients and memory of every part."""

    def struct(name: str, dtype_of: Callable[[type[Formula], type], Any]) -> Any:
        elements = [(part, dtype_of(formula, real)) for part, formula in parts._asdict().items()]
        return arrays_of(name, tuple(elements))

    return struct("Coefficients", coefficient_struct), struct("Memory", memory.memory_struct)


@functools.cache
def arrays_of(name: str, elements: tuple[tuple[str, Any], ...]) -> Any:
    """Returns the struct of arrays [env, item] of these elements (name, Warp type)."""
    return named_struct(name, tuple((part, wp.array2d(dtype=dtype)) for part, dtype in elements))


@functools.cache
def kernel(parts: Parts, real: type, moves: bool = False, projected: bool = False) -> wp.Kernel:
    """Returns the kernel for the classes of ``parts``; items: blocks of the group.

    With ``moves``, bodies that are not free oppose to a force what their motions let them. With ``projected`` a
    contact has the share of the area that faces the surface, by the normal of its point.

    What a block adds to its bodies goes to the block if ``ordered``, to be summed in order; else to the bodies,
    whoever comes first.
    """
    t = structs(real)
    vec3, quat, mat33, Model, State, History = t.vec3, t.quat, t.mat33, t.Model, t.State, t.History
    Contacts, Near, Wrenches, Touch, Slip = t.Contacts, t.Near, t.Wrenches, t.Touch, t.Slip
    Coefficients, Memory = group_structs(parts, real)
    law_force, law_begins, law_forget = memory.functions(parts.law, real)
    friction_force, _, friction_forget = memory.functions(parts.friction, real)
    rolling_force, _, rolling_forget = memory.functions(parts.rolling, real)
    torsion_force, _, torsion_forget = memory.functions(parts.torsion, real, along_normal=True)
    needs_mass = parts.law.needs_mass
    rolls = parts.rolling is not Frictionless
    twists = parts.torsion is not Frictionless
    directional = parts.friction.directional or parts.rolling.directional
    oriented = directional or any(part.memories for part in parts)
    lowest = wp.constant(real(-math.inf if parts.law.pulls else 0.0))
    # Mean arm of friction under the pressure of Hertz: (3π/16) a.
    hertz_arm = wp.constant(real(3.0 * math.pi / 16.0))
    frame = frames.functions(real)
    velocity_at, orientation_to_world, apart = frame.velocity_at, frame.orientation_to_world, frame.apart
    mobility_of_motion = bodies.functions(real).mobility
    facing, rotation_to_world = frame.facing, frame.rotation_to_world

    @wp.func
    def mobility(model: Model, state: State, env: int, body: int, arm_W: vec3, n_W: vec3):
        """Inverse of the mass that ``body`` opposes to a force along ``n_W`` at ``arm_W``; 0 for the world."""
        if body < 0:
            return real(0.0)
        if wp.static(moves):
            motion = model.body_motion[env, body]
            if motion.kind != FREE:
                return mobility_of_motion(model, state, env, body, motion, arm_W, n_W)
        q_WB = state.body_orientation[env, body]
        lever_B = wp.quat_rotate_inv(q_WB, wp.cross(arm_W, n_W))
        turning = wp.dot(lever_B, model.body_inverse_inertia[env, body] * lever_B)
        return real(1.0) / model.body_mass[env, body] + turning

    @wp.func
    def angular_velocity(state: State, env: int, body: int):
        if body < 0:
            return vec3()
        return state.body_angular_velocity[env, body]

    @wp.func
    def cut(force: real):
        """A law that does not pull is cut at zero. Not by max, which turns a NaN into 0 and hides it."""
        if force < lowest:
            return lowest
        return force

    @wp.func
    def surface_axis(q_WS: quat, n_W: vec3):
        """The x axis of the surface, laid into the tangent plane; where it is normal to that, the y axis."""
        x_W = wp.quat_rotate(q_WS, vec3(real(1.0), real(0.0), real(0.0)))
        flat = x_W - wp.dot(x_W, n_W) * n_W
        if wp.length_sq(flat) < real(1.0e-6):
            y_W = wp.quat_rotate(q_WS, vec3(real(0.0), real(1.0), real(0.0)))
            flat = y_W - wp.dot(y_W, n_W) * n_W
        return wp.normalize(flat)

    @wp.func
    def moving(slip: Slip, velocity: vec3):
        slip.velocity = velocity
        slip.speed = wp.length(velocity)
        return slip

    @wp.func
    def add_wrench(wrenches: Wrenches, env: int, body: int, force_W: vec3, torque_W: vec3):
        if body >= 0:
            wp.atomic_add(wrenches.force, env, body, force_W)
            wp.atomic_add(wrenches.torque, env, body, torque_W)

    @wp.struct
    class Pair:
        """Wrenches on the point's body and on the surface's, about their centres of mass; forces are opposite."""

        force: vec3
        torque_1: vec3
        torque_2: vec3

    @wp.func
    def touch_of(
        model: Model,
        state: State,
        history: History,
        remembered: Memory,
        dt: real,
        coefficients: Coefficients,
        contacts: Contacts,
        kept: Memory,
        env: int,
        contact: int,
        member: int,
        body_1: int,
        body_2: int,
        apart_W: vec3,
        q_WS: quat,
        R_W1: mat33,
    ):
        """Forces of one contact: into ``contacts``, and as what they add to both bodies."""
        pair = Pair()
        if contacts.status[env, contact] != CONTACT:
            contacts.approach_speed[env, contact] = real(0.0)
            contacts.normal_force[env, contact] = real(0.0)
            contacts.friction_force[env, contact] = vec3()
            contacts.slip_speed[env, contact] = real(0.0)
            contacts.torque[env, contact] = vec3()
            law_forget(kept.law, env, member, dt)
            friction_forget(kept.friction, env, member, dt)
            rolling_forget(kept.rolling, env, member, dt)
            torsion_forget(kept.torsion, env, member, dt)
            return pair

        n_W = contacts.normal[env, contact]
        # To K, from the centre of mass of either body.
        arm_1 = contacts.arm[env, contact]
        arm_2 = apart_W + arm_1
        # Of the surface relative to the point: approach is positive.
        v_W = velocity_at(state, env, body_2, arm_2) - velocity_at(state, env, body_1, arm_1)
        approach = wp.dot(v_W, n_W)

        touch = Touch()
        touch.delta = contacts.penetration[env, contact]
        touch.delta_dot = approach
        # A contact that begins here has no entry speed yet; one that reloads faster than it began takes the
        # faster speed. The same rule advances the history, so a trial state sees the same force.
        touch.entry_speed = wp.max(wp.max(history.entry_speed[env, contact], approach), real(0.0))
        if wp.static(needs_mass):
            touch.mass = real(1.0) / (
                mobility(model, state, env, body_1, arm_1, n_W) + mobility(model, state, env, body_2, arm_2, n_W)
            )
        touch.dt = dt
        begins = history.entry_speed[env, contact] < real(0.0)
        # What begins since the last step has not moved for longer than it took to come this deep.
        lasted = real(math.inf)
        if begins and approach > real(0.0):
            lasted = touch.delta / approach
        p = coefficients.law[env, member]
        normal_force = cut(law_force(remembered.law, kept.law, env, member, p, touch, lasted, dt, q_WS, n_W))

        # The force of a step stands for the time from half a step before this state to half a step after: the
        # contact's share of it, when it began since the last state, is δ/(δ̇ dt) + 1/2 steps. A law continuous
        # at touch makes no difference of first order; one that jumps (a dashpot) is given its missing impulse.
        travel = approach * dt
        if begins and touch.delta <= travel * real(1.001):
            late = wp.min(touch.delta / travel, real(1.0))
            touch.delta = touch.delta * real(1.0e-6)
            normal_force = cut(normal_force + (late - real(0.5)) * cut(law_begins(p, touch)))

        slip = Slip()
        slip.normal = n_W
        slip.normal_force = normal_force
        if normal_force < real(0.0):
            slip.normal_force = real(0.0)
        geometry = model.contact_geometry[env, contact]
        slip.patch_radius = wp.sqrt(geometry.radius * contacts.penetration[env, contact])
        if wp.static(directional):
            slip.axis = surface_axis(q_WS, n_W)

        slip = moving(slip, approach * n_W - v_W)
        contacts.slip_speed[env, contact] = slip.speed
        friction_W = friction_force(
            remembered.friction, kept.friction, env, member, coefficients.friction[env, member], slip, lasted, dt,
            q_WS, n_W,
        )  # fmt: skip

        torque_W = vec3()
        if wp.static(rolls or twists):
            w_W = angular_velocity(state, env, body_1) - angular_velocity(state, env, body_2)
            if wp.static(rolls):
                # The velocity at which the point of contact travels, and a couple of the same power.
                slip = moving(slip, geometry.radius * wp.cross(w_W, n_W))
                rolling_W = rolling_force(
                    remembered.rolling, kept.rolling, env, member, coefficients.rolling[env, member], slip, lasted,
                    dt, q_WS, n_W,
                )  # fmt: skip
                torque_W = geometry.radius * wp.cross(n_W, rolling_W)
            if wp.static(twists):
                arm = geometry.torsion_radius
                if (model.contact_options[contact] & HERTZ_PATCH) != 0:
                    arm = hertz_arm * slip.patch_radius
                slip = moving(slip, (arm * wp.dot(w_W, n_W)) * n_W)
                torsion_W = torsion_force(
                    remembered.torsion, kept.torsion, env, member, coefficients.torsion[env, member], slip, lasted,
                    dt, q_WS, n_W,
                )  # fmt: skip
                torque_W += arm * torsion_W

        # After the formulas: what is springy or viscous in them is shared like what is in proportion to N.
        share = geometry.share
        if wp.static(projected):
            share *= facing(model, env, model.contact_point[contact], R_W1, n_W)
        normal_force *= share
        friction_W *= share
        torque_W *= share

        contacts.approach_speed[env, contact] = approach
        contacts.normal_force[env, contact] = normal_force
        contacts.friction_force[env, contact] = friction_W
        contacts.torque[env, contact] = torque_W

        # The same force at the same point K, and the same couple, on both bodies: nothing is left in total.
        pair.force = normal_force * n_W + friction_W
        pair.torque_1 = wp.cross(arm_1, pair.force) + torque_W
        pair.torque_2 = -(wp.cross(arm_2, pair.force) + torque_W)
        return pair

    @wp.kernel(module="unique", enable_backward=False, module_options=INLINED)
    def contact_force(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        remembered: Memory,
        step: wp.array2d(dtype=real),  # [env, 0] what the force acts over [s]; 0: the force of this instant
        first_block: wp.int32,
        first_contact: wp.int32,
        coefficients: Coefficients,
        contacts: Contacts,
        kept: Memory,
        near: Near,
        ordered: wp.bool,
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), work.tasks, work.threads):
            env = work.first + task // work.items
            block = first_block + task % work.items
            if status[env] != ENV_ACTIVE or near.count[env, block] == 0:
                continue
            # One body and one surface for all contacts of a block.
            start = model.block_start[block]
            contact = model.block_contact[start]
            surface = model.patch_surface[model.contact_patch[contact]]
            point = model.contact_point[contact]
            body_1 = model.point_body[point]
            body_2 = model.surface_body[surface]
            apart_W = apart(model, state, env, point, surface)
            q_WS = quat()
            if wp.static(oriented):
                q_WS = orientation_to_world(state, env, body_2, model.surface_orientation[env, surface])
            R_W1 = mat33()
            if wp.static(projected):
                R_W1 = rotation_to_world(state, env, body_1)
            total = Pair()
            for place in range(start, start + near.count[env, block]):
                contact = near.contact[env, place]
                pair = touch_of(
                    model, state, history, remembered, step[env, 0], coefficients, contacts, kept,
                    env, contact, contact - first_contact, body_1, body_2, apart_W, q_WS, R_W1,
                )  # fmt: skip
                total.force += pair.force
                total.torque_1 += pair.torque_1
                total.torque_2 += pair.torque_2
            if ordered:
                near.force[env, block] = total.force
                near.torque_1[env, block] = total.torque_1
                near.torque_2[env, block] = total.torque_2
            else:
                add_wrench(wrenches, env, body_1, total.force, total.torque_1)
                add_wrench(wrenches, env, body_2, -total.force, total.torque_2)

    return contact_force
