"""Contact couplings: how close they came, which advances with accepted steps, and their force in total."""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.formula import Formula, coefficient_struct
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, Work, env_of, item_of, structs, task_count
from warpcontact.kernels.unique import unique_kernel


@wp.struct
class ContactCouplings:
    """What is measured of couplings."""

    force: wp.array2d(dtype=wp.vec3d)  # [env, coupling] on the body of the first surface, W [N]
    torque: wp.array2d(dtype=wp.vec3d)  # [env, coupling] on it, about its centre of mass, W [N·m]


@wp.struct
class Sets:
    """Which sets of contacts a coupling has: one, or two side by side, the second the other way round."""

    first: wp.array(dtype=wp.int32)  # [coupling] its first set
    count: wp.array(dtype=wp.int32)  # [coupling] how many


@functools.cache
def advance(law: type[Formula], real: type, projected: bool) -> wp.Kernel:
    """Returns the kernel that takes the contacts of one group that are near into ``reached``; items: couplings.

    ``projected``: whether the group weighs areas by the normals of its points.
    """
    t = structs(real)
    mat33, Model, State, Contacts = t.mat33, t.Model, t.State, t.Contacts
    Near, Reached = t.Near, t.Reached
    Coefficients = wp.array2d(dtype=coefficient_struct(law, real))
    frame = frames.functions(real)
    facing, rotation_to_world = frame.facing, frame.rotation_to_world

    @unique_kernel()
    def advance_reached(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,  # that of the contacts: the step began from it
        contacts: Contacts,
        near: Near,
        sets: Sets,
        first_coupling: wp.int32,
        first_contact: wp.int32,
        coefficients: Coefficients,
        reached: Reached,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            coupling = first_coupling + item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            area = real(0.0)
            closest = reached.minimum_distance[env, coupling]
            first = sets.first[coupling]
            for block in range(model.set_block_start[first], model.set_block_start[first + sets.count[coupling]]):
                count = near.count[env, block]
                if count == 0:
                    continue
                start = model.block_start[block]
                R_WB = mat33()
                if wp.static(projected):
                    # One body for all points of a block.
                    point = model.contact_point[model.block_contact[start]]
                    R_WB = rotation_to_world(state, env, model.point_body[point])
                for place in range(start, start + count):
                    contact = near.contact[env, place]
                    if contacts.status[env, contact] == CONTACT:
                        # Of two sides each has its share of the touch.
                        own = model.contact_geometry[env, contact].force_scale
                        own *= coefficients[env, contact - first_contact].area
                        if wp.static(projected):
                            point = model.contact_point[contact]
                            own *= facing(model, env, point, R_WB, contacts.normal[env, contact])
                        area += own
                        radius = model.contact_geometry[env, contact].radius
                        # A face that looks away is in nobody's way.
                        if own > real(0.0):
                            distance = radius - contacts.penetration[env, contact]
                            if not (distance >= closest):
                                closest = distance
            reached.effective_area[env, coupling] = wp.max(reached.effective_area[env, coupling], area)
            reached.minimum_distance[env, coupling] = closest

    return advance_reached


@functools.cache
def forget(real: type) -> wp.Kernel:
    """Returns the kernel that empties ``reached`` of chosen environments. Launch with dim (env, coupling)."""
    Reached = structs(real).Reached

    @unique_kernel()
    def forget_reached(mask: wp.array(dtype=wp.bool), reached: Reached):
        env, coupling = wp.tid()
        if mask[env]:
            reached.effective_area[env, coupling] = real(0.0)
            reached.minimum_distance[env, coupling] = real(wp.nan)

    return forget_reached


@functools.cache
def measure(real: type) -> wp.Kernel:
    """Returns the kernel that sums the forces of each coupling. Launch with dim (env, coupling)."""
    t = structs(real)
    Model, State, Contacts = t.Model, t.State, t.Contacts
    frame = frames.functions(real)
    apart, wide = frame.apart, frame.wide

    @unique_kernel()
    def measure_couplings(model: Model, state: State, contacts: Contacts, sets: Sets, measured: ContactCouplings):
        env, coupling = wp.tid()
        force = wp.vec3d()
        torque = wp.vec3d()
        first = sets.first[coupling]
        for number in range(first, first + sets.count[coupling]):
            point = model.contact_point[model.set_contact[number]]
            surface = model.patch_surface[model.contact_patch[model.set_contact[number]]]
            start = model.block_start[model.set_block_start[number]]
            stop = model.block_start[model.set_block_start[number + 1]]
            for place in range(start, stop):
                contact = model.block_contact[place]
                if contacts.status[env, contact] == CONTACT:
                    arm = contacts.arm[env, contact]
                    own = wide(contacts.normal_force[env, contact] * contacts.normal[env, contact])
                    own += wide(contacts.friction_force[env, contact])
                    if number > first:
                        # Points of the other body: what is left for this one is the reaction.
                        arm += apart(model, state, env, point, surface)
                        own = -own
                    force += own
                    torque += wp.cross(wide(arm), own)
        measured.force[env, coupling] = force
        measured.torque[env, coupling] = torque

    return measure_couplings
