"""Contact couplings: closest approach, advanced with accepted steps, and total force."""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.catalogue.device_model import Formula, coefficient_struct
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item


@wp.struct
class ContactCouplings:
    """Forces of contact couplings."""

    force: wp.array2d(dtype=wp.vec3d)  # [env, coupling] on the body of the first surface, W [N]
    torque: wp.array2d(dtype=wp.vec3d)  # [env, coupling] on that body, about its center of mass, W [N·m]


@wp.struct
class CouplingSets:
    """Contact sets of a coupling: one, or two consecutive ones, the second with the surfaces exchanged."""

    first: wp.array(dtype=wp.int32)  # [coupling] first set
    count: wp.array(dtype=wp.int32)  # [coupling] number of sets


@functools.cache
def advance(law: type[Formula], real: type, projected: bool) -> wp.Kernel:
    """Returns the kernel that updates ``extremes`` with the active contacts of one group; items: couplings.

    ``projected``: Whether the group weights areas by the normals of its points.
    """
    t = structs(real)
    mat33, Model, State, Contacts = t.mat33, t.Model, t.State, t.Contacts
    ActiveContacts, CouplingExtremes = t.ActiveContacts, t.CouplingExtremes
    Coefficients = wp.array2d(dtype=coefficient_struct(law, real))
    frame = frames.functions(real)
    facing_fraction, rotation_to_world = frame.facing_fraction, frame.rotation_to_world

    @unique_kernel()
    def advance_extremes(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,  # state before the step, from which the contacts were computed
        contacts: Contacts,
        active_contacts: ActiveContacts,
        sets: CouplingSets,
        first_coupling: wp.int32,
        first_contact: wp.int32,
        coefficients: Coefficients,
        extremes: CouplingExtremes,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            coupling = first_coupling + task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            area = real(0.0)
            closest = extremes.minimum_distance[env, coupling]
            first = sets.first[coupling]
            for cluster in range(
                model.set_cluster_start[first], model.set_cluster_start[first + sets.count[coupling]]
            ):
                count = active_contacts.count[env, cluster]
                if count == 0:
                    continue
                start = model.cluster_start[cluster]
                R_WB = mat33()
                if wp.static(projected):
                    # All points of a cluster belong to one body.
                    point = model.contact_point[model.cluster_contact[start]]
                    R_WB = rotation_to_world(state, env, model.point_body[point])
                for index in range(start, start + count):
                    contact = active_contacts.contact[env, index]
                    if contacts.status[env, contact] == CONTACT:
                        # If both surfaces have points, each set counts with its force scale.
                        contribution = model.contact_geometry[env, contact].force_scale
                        contribution *= coefficients[env, contact - first_contact].area
                        if wp.static(projected):
                            point = model.contact_point[contact]
                            contribution *= facing_fraction(model, env, point, R_WB, contacts.normal[env, contact])
                        area += contribution
                        radius = model.contact_geometry[env, contact].radius
                        # Faces that point away from the other surface do not count.
                        if contribution > real(0.0):
                            distance = radius - contacts.penetration[env, contact]
                            if not (distance >= closest):
                                closest = distance
            extremes.effective_area[env, coupling] = wp.max(extremes.effective_area[env, coupling], area)
            extremes.minimum_distance[env, coupling] = closest

    return advance_extremes


@functools.cache
def reset(real: type) -> wp.Kernel:
    """Returns the kernel that clears ``extremes`` of selected environments. Launch with dim (env, coupling)."""
    CouplingExtremes = structs(real).CouplingExtremes

    @unique_kernel(runs_rarely=True)
    def reset_extremes(mask: wp.array(dtype=wp.bool), extremes: CouplingExtremes):
        env, coupling = wp.tid()
        if mask[env]:
            extremes.effective_area[env, coupling] = real(0.0)
            extremes.minimum_distance[env, coupling] = real(wp.nan)

    return reset_extremes


@functools.cache
def measure(real: type) -> wp.Kernel:
    """Returns the kernel that sums the forces of each coupling. Launch with dim (env, coupling)."""
    t = structs(real)
    Model, State, Contacts = t.Model, t.State, t.Contacts
    frame = frames.functions(real)
    offset_between, to_float64 = frame.offset_between, frame.to_float64

    @unique_kernel()
    def measure_couplings(
        model: Model, state: State, contacts: Contacts, sets: CouplingSets, measured: ContactCouplings
    ):
        env, coupling = wp.tid()
        force = wp.vec3d()
        torque = wp.vec3d()
        first = sets.first[coupling]
        for number in range(first, first + sets.count[coupling]):
            point = model.contact_point[model.set_contact[number]]
            surface = model.query_mesh_surface[model.contact_query_mesh[model.set_contact[number]]]
            start = model.cluster_start[model.set_cluster_start[number]]
            stop = model.cluster_start[model.set_cluster_start[number + 1]]
            for index in range(start, stop):
                contact = model.cluster_contact[index]
                if contacts.status[env, contact] == CONTACT:
                    arm = contacts.arm[env, contact]
                    contribution = to_float64(contacts.normal_force[env, contact] * contacts.normal[env, contact])
                    contribution += to_float64(contacts.friction_force[env, contact])
                    if number > first:
                        # The points belong to the other body: add the reaction.
                        arm += offset_between(model, state, env, point, surface)
                        contribution = -contribution
                    force += contribution
                    torque += wp.cross(to_float64(arm), contribution)
        measured.force[env, coupling] = force
        measured.torque[env, coupling] = torque

    return measure_couplings
