"""The closed contacts of a step as rows of its contact problem: one thread goes through an environment.

A row takes as its guess the impulse of the last step, if its contact was closed in that.
"""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, HERTZ_PATCH, MODE_SLIP, Work, structs
from warpcontact.kernels.unilateral.records import record_structs
from warpcontact.kernels.unilateral.rows import row_structs


@functools.cache
def add_row(real: type) -> wp.Function:
    """Returns the device function that adds a contact to the rows of its environment.

    Its arguments are ``(state, rows, outcome, memory, account, env, contact, material, body_1, body_2, arm_1,
    arm_2, normal, radius, torsion_radius)``; the state has the velocities before the step, of which restitution
    takes that of approach.
    """
    t = structs(real)
    vec3, State = t.vec3, t.State
    r, records = row_structs(real), record_structs(real)
    Rows, Outcome, Memory, Account, Material = r.Rows, r.Outcome, records.Memory, records.Account, records.Material
    velocity_at = frames.functions(real).velocity_at

    @wp.func
    def add_row(
        state: State,
        rows: Rows,
        outcome: Outcome,
        memory: Memory,
        account: Account,
        env: int,
        contact: int,
        material: Material,
        body_1: int,
        body_2: int,
        arm_1: vec3,
        arm_2: vec3,
        normal: vec3,
        radius: real,
        torsion_radius: real,
    ):
        row = outcome.count[env]
        outcome.count[env] = row + 1
        rows.contact[env, row] = contact
        rows.body_1[env, row] = body_1
        rows.body_2[env, row] = body_2
        rows.arm_1[env, row] = arm_1
        rows.arm_2[env, row] = arm_2
        rows.normal[env, row] = normal
        rows.rolling[env, row] = material.rolling * radius
        rows.spinning[env, row] = material.spinning * torsion_radius
        mu = material.mu_static
        impulse = vec3()
        couple = vec3()
        if memory.stamp[env, contact] == account.step[env]:
            impulse = memory.impulse[env, contact]
            couple = memory.couple[env, contact]
            if memory.mode[env, contact] == MODE_SLIP:
                mu = material.mu_dynamic
        rows.mu[env, row] = mu
        rows.impulse[env, row] = impulse
        rows.couple[env, row] = couple
        bounce = real(0.0)
        if material.restitution > real(0.0):
            approach = velocity_at(state, env, body_2, arm_2) - velocity_at(state, env, body_1, arm_1)
            bounce = material.restitution * wp.max(wp.dot(approach, normal), real(0.0))
        rows.bounce[env, row] = bounce

    return add_row


@functools.cache
def mesh(real: type) -> wp.Kernel:
    """Returns the kernel that adds what touches a mesh; items: 1."""
    t = structs(real)
    Model, State, Contacts, Near = t.Model, t.State, t.Contacts, t.Near
    r, records = row_structs(real), record_structs(real)
    Rows, Outcome, Memory, Account, Material = r.Rows, r.Outcome, records.Memory, records.Account, records.Material
    apart = frames.functions(real).apart
    add = add_row(real)

    @wp.kernel(module="unique", enable_backward=False)
    def collect_mesh_contacts(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        contacts: Contacts,
        near: Near,
        blocks: wp.array(dtype=wp.int32),  # those of hard contacts
        block_count: wp.int32,
        material: wp.array2d(dtype=Material),
        memory: Memory,
        account: Account,
        rows: Rows,
        outcome: Outcome,
    ):
        for task in range(wp.tid(), work.tasks, work.threads):
            env = work.first + task
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
                        geometry.radius, torsion_radius,
                    )  # fmt: skip

    return collect_mesh_contacts
