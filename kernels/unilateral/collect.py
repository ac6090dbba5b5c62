"""The closed contacts of a step as rows of its contact problem: one thread goes through an environment.

A row takes as its guess the impulse of the last step, if its contact was closed in that.
"""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.piles.base import TOUCHES, pile_structs
from warpcontact.kernels.smooth.records import Members, Settings, contact_structs
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    HERTZ_PATCH,
    MODE_SLIP,
    Work,
    first_env,
    structs,
    task_count,
)
from warpcontact.kernels.unilateral.records import record_structs
from warpcontact.kernels.unilateral.rows import row_structs
from warpcontact.kernels.unique import unique_kernel


@functools.cache
def add_row(real: type) -> wp.Function:
    """Returns the device function that adds a contact to the rows of its environment.

    Its arguments are ``(state, rows, outcome, memory, account, env, contact, material, body_1, body_2, arm_1,
    arm_2, normal, gap, recovery, radius, torsion_radius)``; the state has the velocities before the step, of which
    restitution takes that of approach; ``recovery`` is the share of an overlap that is taken back in a second.
    """
    t = structs(real)
    vec3, State = t.vec3, t.State
    r, records = row_structs(real), record_structs(real)
    Row = r.Row
    velocity_at = frames.functions(real).velocity_at

    @wp.func
    def add_row(
        state: State,
        rows: r.Rows,
        outcome: r.Outcome,
        memory: records.Memories,
        account: records.Account,
        env: int,
        contact: int,
        material: records.Material,
        body_1: int,
        body_2: int,
        arm_1: vec3,
        arm_2: vec3,
        normal: vec3,
        gap: real,
        recovery: real,
        radius: real,
        torsion_radius: real,
    ):
        added = Row()
        added.contact = contact
        added.body_1 = body_1
        added.body_2 = body_2
        added.arm_1 = arm_1
        added.arm_2 = arm_2
        added.normal = normal
        added.rolling = material.rolling * radius
        added.spinning = material.spinning * torsion_radius
        added.mu = material.mu_static
        if memory[env, contact].stamp == account.step[env]:
            added.impulse = memory[env, contact].impulse
            added.couple = memory[env, contact].couple
            if memory[env, contact].mode == MODE_SLIP:
                added.mu = material.mu_dynamic
        added.restitution = material.restitution
        if material.restitution > real(0.0):
            approach = velocity_at(state, env, body_2, arm_2) - velocity_at(state, env, body_1, arm_1)
            added.bounce = material.restitution * wp.max(wp.dot(approach, normal), real(0.0))
        # What bodies fall in a step stays: a contact must be closed to be held.
        added.recovery = recovery * wp.max(-gap - outcome.slack[env], real(0.0))
        row = outcome.count[env]
        rows[env, row] = added
        outcome.count[env] = row + 1

    return add_row


@functools.cache
def mesh(real: type) -> wp.Kernel:
    """Returns the kernel that adds what touches a mesh; items: 1."""
    t = structs(real)
    Model, State, Contacts, Near = t.Model, t.State, t.Contacts, t.Near
    r, records = row_structs(real), record_structs(real)
    apart = frames.functions(real).apart
    add = add_row(real)

    @unique_kernel()
    def collect_mesh_contacts(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        contacts: Contacts,
        near: Near,
        blocks: wp.array(dtype=wp.int32),  # those of nonsmooth contacts
        block_count: wp.int32,
        recovery: real,  # [1/s]
        material: wp.array2d(dtype=records.Material),
        memory: records.Memories,
        account: records.Account,
        rows: r.Rows,
        outcome: r.Outcome,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            if status[env] != ENV_ACTIVE:
                continue
            for number in range(block_count):
                block = blocks[number]
                count = near.count[env, block]
                if count == 0:
                    continue
                start = model.block_start[block]
                contact = model.block_contact[start]
                surface = model.patch_surface[model.contact_patch[contact]]
                point = model.contact_point[contact]
                body_1 = model.point_body[point]
                body_2 = model.surface_body[surface]
                apart_W = apart(model, state, env, point, surface)
                for place in range(start, start + count):
                    contact = near.contact[env, place]
                    if contacts.status[env, contact] != CONTACT:
                        continue
                    geometry = model.contact_geometry[env, contact]
                    torsion_radius = geometry.torsion_radius
                    if (model.contact_options[contact] & HERTZ_PATCH) != 0:
                        # Rigid bodies have no overlap, and touch in a point.
                        torsion_radius = real(0.0)
                    arm_W = contacts.arm[env, contact]
                    add(
                        state, rows, outcome, memory, account, env, contact, material[env, contact],
                        body_1, body_2, arm_W, apart_W + arm_W, contacts.normal[env, contact],
                        contacts.gap[env, contact], recovery, geometry.radius, torsion_radius,
                    )  # fmt: skip

    return collect_mesh_contacts


@functools.cache
def smooth(real: type, rolls: bool) -> wp.Kernel:
    """Returns the kernel that adds shape contacts of one group; items: 1.

    ``rolls``: whether their radii of rolling are known.
    """
    State, Smooth = structs(real).State, contact_structs(real).Smooth
    r, records = row_structs(real), record_structs(real)
    add = add_row(real)

    @unique_kernel()
    def collect_shape_contacts(
        work: Work,
        status: wp.array(dtype=wp.int32),
        state: State,
        first: wp.int32,  # number of the first contact of the group
        items: wp.array(dtype=wp.int32),  # those of the group that are hard
        item_count: wp.int32,
        members: Members,
        settings: wp.array2d(dtype=Settings),
        smooth: Smooth,
        recovery: real,  # [1/s]
        material: wp.array2d(dtype=records.Material),
        memory: records.Memories,
        account: records.Account,
        rows: r.Rows,
        outcome: r.Outcome,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            if status[env] != ENV_ACTIVE:
                continue
            for place in range(item_count):
                item = items[place]
                # For a law that is to act later it began at rest.
                smooth.approach_speed[env, item] = real(0.0)
                if smooth.status[env, item] != CONTACT:
                    continue
                radius = real(0.0)
                if wp.static(rolls):
                    radius = smooth.radius[env, item]
                # Rigid bodies have no overlap, and touch in a point.
                torsion_radius = wp.max(real(settings[env, item].torsion_radius), real(0.0))
                contact = first + item
                add(
                    state, rows, outcome, memory, account, env, contact, material[env, contact],
                    members.body_a[item], members.body_b[item], smooth.arm_a[env, item], smooth.arm_b[env, item],
                    smooth.normal[env, item], smooth.gap[env, item], recovery, radius, torsion_radius,
                )  # fmt: skip

    return collect_shape_contacts


@functools.cache
def pile(real: type) -> wp.Kernel:
    """Returns the kernel that adds the pairs of a pile in the order of their records; items: 1."""
    State = structs(real).State
    p = pile_structs(real)
    Shapes, Lists, Touches = p.Shapes, p.Lists, p.Touches
    r, records = row_structs(real), record_structs(real)
    add = add_row(real)

    @unique_kernel()
    def collect_pile(
        work: Work,
        status: wp.array(dtype=wp.int32),
        state: State,
        shape_count: wp.int32,
        shapes: Shapes,
        lists: Lists,
        touches: Touches,
        first: wp.int32,  # number of the contact of the first record
        substance: wp.int32,  # number of the material of all pairs
        recovery: real,  # [1/s]
        material: wp.array2d(dtype=records.Material),
        memory: records.Memories,
        account: records.Account,
        rows: r.Rows,
        outcome: r.Outcome,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            if status[env] != ENV_ACTIVE:
                continue
            own = material[env, substance]
            # Rigid bodies have no overlap, and touch in a point.
            torsion_radius = wp.max(shapes.settings[env, 0].torsion_radius, real(0.0))
            for shape in range(shape_count):
                if (touches.busy[env, shape] & TOUCHES) == 0:
                    continue
                start = shapes.entry_start[shape]
                slot = shapes.slot_start[shape]
                for k in range(lists.owned[env, shape]):
                    if (touches.bits[env, slot + k] & TOUCHES) == 0:
                        continue
                    partner = lists.partner[env, start + k]
                    body_1 = shapes.body[wp.min(shape, partner)]
                    body_2 = shapes.body[wp.max(shape, partner)]
                    apart = state.body_position[env, body_1] - state.body_position[env, body_2]
                    apart += (
                        state.body_position_remainder[env, body_1] - state.body_position_remainder[env, body_2]
                    )
                    arm = touches.arm[env, slot + k]
                    radius_1 = shapes.radius[env, shape]
                    radius_2 = shapes.radius[env, partner]
                    add(
                        state, rows, outcome, memory, account, env, first + slot + k, own, body_1, body_2, arm,
                        apart + arm, touches.normal[env, slot + k], touches.gap[env, slot + k], recovery,
                        radius_1 * radius_2 / (radius_1 + radius_2), torsion_radius,
                    )  # fmt: skip

    return collect_pile
