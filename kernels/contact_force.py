"""Contact force of one group of points on meshes: what each touch does, added up for the bodies of a block.

A factory compiles law, friction, rolling and torsion into the kernel, once per combination and precision; their
coefficients are data. A pure function of model, state and history: nothing here changes them.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import frames, touch
from warpcontact.kernels.touch import Parts, group_structs, touch_structs
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    HERTZ_PATCH,
    Work,
    env_of,
    item_of,
    natural,
    structs,
    task_count,
)
from warpcontact.kernels.unique import unique_kernel


@functools.cache
def functions(parts: Parts, real: type, moves: bool, projected: bool) -> SimpleNamespace:
    """Returns the device functions of a contact that touches; arguments: ``kernel``."""
    t = structs(real)
    vec3, quat, mat33, Model, State = t.vec3, t.quat, t.mat33, t.Model, t.State
    Contacts, Wrenches = t.Contacts, t.Wrenches
    Coefficients, Memory = group_structs(parts, real)
    Place = touch_structs(real).Place
    act, forget = touch.functions(parts, real, moves)
    twists, needs_curvature = parts.twists, parts.law.needs_curvature
    facing = frames.functions(real).facing

    @wp.struct
    class Push:
        """What one contact does, and what that adds to both bodies about their centres of mass."""

        approach_speed: real  # dδ/dt at K [m/s]
        slip_speed: real  # tangential, at K [m/s]
        normal_force: real  # [N]
        friction_force: vec3  # on the point's body, W [N]
        torque: vec3  # couple of rolling and torsion on it, W [N·m]
        force: vec3  # on it; on the surface's the opposite
        torque_1: vec3  # on the point's body
        torque_2: vec3  # on the surface's

    @wp.func
    def push_of(
        model: Model,
        state: State,
        remembered: Memory,
        dt: real,
        coefficients: Coefficients,
        kept: Memory,
        env: int,
        contact: int,
        member: int,
        body_1: int,
        body_2: int,
        apart_W: vec3,
        q_WS: quat,
        R_W1: mat33,
        arm: vec3,
        normal: vec3,
        penetration: real,
        entry_speed: real,
    ):
        """What a contact that touches does: with the arm to K from the point's body, from the surface outwards."""
        geometry = model.contact_geometry[env, contact]
        place = Place()
        place.body_1 = body_1
        place.body_2 = body_2
        # To K, from the centre of mass of either body.
        place.arm_1 = arm
        place.arm_2 = apart_W + arm
        place.normal = normal
        place.penetration = penetration
        place.radius = geometry.radius
        if wp.static(needs_curvature):
            # The facets are flat, whatever the mesh stands for.
            place.curvature_1 = real(1.0) / geometry.radius
            place.curvature_2 = place.curvature_1
        torsion_radius = real(-1.0)
        if wp.static(twists):
            of_overlap = (model.contact_options[contact] & HERTZ_PATCH) != 0
            torsion_radius = wp.where(of_overlap, real(-1.0), geometry.torsion_radius)
        acts = act(
            model, state, env, place, entry_speed, dt, coefficients, remembered, kept, member, torsion_radius, q_WS
        )

        # After the formulas: what is springy or viscous in them is shared like what is in proportion to N.
        force_scale = geometry.force_scale
        if wp.static(projected):
            force_scale *= facing(model, env, model.contact_point[contact], R_W1, normal)
        push = Push()
        push.approach_speed = acts.approach_speed
        push.slip_speed = acts.slip_speed
        push.normal_force = force_scale * acts.normal_force
        push.friction_force = force_scale * acts.friction_force
        push.torque = force_scale * acts.torque
        # The same force at the same point K, and the same couple, on both bodies: nothing is left in total.
        push.force = push.normal_force * normal + push.friction_force
        push.torque_1 = wp.cross(place.arm_1, push.force) + push.torque
        push.torque_2 = -(wp.cross(place.arm_2, push.force) + push.torque)
        return push

    @wp.func
    def tell_nothing(contacts: Contacts, kept: Memory, env: int, contact: int, member: int, dt: real):
        """Tells of a contact that does not touch that nothing acts, and that formulas may forget it."""
        contacts.approach_speed[env, contact] = real(0.0)
        contacts.normal_force[env, contact] = real(0.0)
        contacts.friction_force[env, contact] = vec3()
        contacts.slip_speed[env, contact] = real(0.0)
        contacts.torque[env, contact] = vec3()
        forget(kept, env, member, contacts.armed[env, contact], dt)

    @wp.func
    def add_wrench(wrenches: Wrenches, env: int, body: int, force_W: vec3, torque_W: vec3):
        if body >= 0:
            wp.atomic_add(wrenches.force, env, body, force_W)
            wp.atomic_add(wrenches.torque, env, body, torque_W)

    return SimpleNamespace(push_of=push_of, forget=forget, tell_nothing=tell_nothing, add_wrench=add_wrench)


@functools.cache
def kernel(parts: Parts, real: type, moves: bool = False, projected: bool = False) -> wp.Kernel:
    """Returns the kernel for the classes of ``parts``; items: blocks of the group.

    With ``moves``, bodies that are not free oppose to a force what their motions let them. With ``projected`` a
    contact has the share of the area that faces the surface, by the normal of its point.

    What a block adds to its bodies goes to the block if ``ordered``, to be summed in order; else to the bodies,
    whoever comes first. Forces of each contact are ``told`` where anyone may ask for them.
    """
    t = structs(real)
    vec3, quat, mat33, Model, State, History = t.vec3, t.quat, t.mat33, t.Model, t.State, t.History
    Contacts, Near, Wrenches = t.Contacts, t.Near, t.Wrenches
    Coefficients, Memory = group_structs(parts, real)
    of_contact = functions(parts, real, moves, projected)
    push_of, tell_nothing, add_wrench = of_contact.push_of, of_contact.tell_nothing, of_contact.add_wrench
    oriented = parts.oriented
    frame = frames.functions(real)
    orientation_to_world, apart = frame.orientation_to_world, frame.apart
    rotation_to_world = frame.rotation_to_world

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
        told: bool,
    ):
        """Forces of one contact: into ``contacts`` if they are ``told``, and what they add to both bodies."""
        pair = Pair()
        # Returned early: of both sides of a branch Warp copies what they change.
        if contacts.status[env, contact] != CONTACT:
            tell_nothing(contacts, kept, env, contact, member, dt)
            return pair
        push = push_of(
            model, state, remembered, dt, coefficients, kept, env, contact, member, body_1, body_2, apart_W, q_WS,
            R_W1, contacts.arm[env, contact], contacts.normal[env, contact], contacts.penetration[env, contact],
            history.entry_speed[env, contact],
        )  # fmt: skip
        contacts.approach_speed[env, contact] = push.approach_speed
        if told:
            contacts.slip_speed[env, contact] = push.slip_speed
            contacts.normal_force[env, contact] = push.normal_force
            contacts.friction_force[env, contact] = push.friction_force
            contacts.torque[env, contact] = push.torque
        pair.force = push.force
        pair.torque_1 = push.torque_1
        pair.torque_2 = push.torque_2
        return pair

    @unique_kernel()
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
        told: wp.bool,
        ordered: wp.bool,
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            block = first_block + item_of(work, task)
            if status[env] != ENV_ACTIVE or near.count[env, block] == 0:
                continue
            # One body and one surface for all contacts of a block.
            start = natural(model.block_start[block])
            contact = natural(model.block_contact[start])
            surface = natural(model.patch_surface[natural(model.contact_patch[contact])])
            point = natural(model.contact_point[contact])
            body_1 = model.point_body[point]
            body_2 = model.surface_body[surface]
            apart_W = apart(model, state, env, point, surface)
            q_WS = quat()
            if wp.static(oriented):
                q_WS = orientation_to_world(state, env, body_2, model.surface_orientation[env, surface])
            R_W1 = mat33()
            if wp.static(projected):
                R_W1 = rotation_to_world(state, env, body_1)
            dt = step[env, 0]
            total = Pair()
            for place in range(start, start + near.count[env, block]):
                contact = natural(near.contact[env, place])
                member = contact - first_contact
                pair = touch_of(
                    model, state, history, remembered, dt, coefficients, contacts, kept, env, contact, member,
                    body_1, body_2, apart_W, q_WS, R_W1, told,
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
