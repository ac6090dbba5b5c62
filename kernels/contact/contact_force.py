"""Contact forces of one group of point contacts on meshes, summed per cluster.

Law, friction, rolling and torsion are compiled into the kernel, once per combination of classes and precision;
their coefficients are arrays. Model, state and history are inputs and are not changed.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.contact import contact_evaluation
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs, kinematics_structs
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    HERTZ_TORSION,
    LaunchRange,
    Struct,
    structs,
    task_count,
    task_env,
    task_item,
)


class Functions(NamedTuple):
    """Device functions of a closed contact of one group, and the struct of its wrench."""

    ContactWrench: Struct  # force of a contact and its wrench on both bodies
    contact_wrench: wp.Function  # wrench of a closed contact on both bodies
    clear_history: wp.Function  # clears the history variables of an open contact: ``contact_evaluation.Functions``
    write_no_force: wp.Function  # writes zero forces for an open contact and clears its history variables
    add_wrench: wp.Function  # adds a force and a torque to the wrench of a body, atomically


@functools.cache
def functions(
    contact_model: ContactModel, real: type, has_joints: bool, projected: bool, histories: int = 1
) -> Functions:
    """Returns the device functions of a closed contact; for the arguments see ``kernel``.

    ``histories``: see ``contact_evaluation.functions``.
    """
    t = structs(real)
    vec3, quat, mat33, Model, State = t.vec3, t.quat, t.mat33, t.Model, t.State
    Contacts, Wrenches = t.Contacts, t.Wrenches
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    ContactKinematics = kinematics_structs(real).ContactKinematics
    evaluation = contact_evaluation.functions(contact_model, real, has_joints, histories=histories)
    evaluate_contact, clear_history = evaluation.evaluate_contact, evaluation.clear_history
    has_torsion, needs_curvature = contact_model.has_torsion, contact_model.law.needs_curvature
    facing_fraction = frames.functions(real).facing_fraction

    @wp.struct
    class ContactWrench:
        """Force of one contact and its wrench on both bodies about their centers of mass."""

        approach_speed: real  # dδ/dt at K [m/s]
        slip_speed: real  # tangential, at K [m/s]
        normal_force: real  # [N]
        friction_force: vec3  # on the point's body, W [N]
        torque: vec3  # rolling and torsional friction on it, W [N·m]
        force: vec3  # on the point's body, W [N]; opposite on the surface's
        torque_1: vec3  # on the point's body, W [N·m]
        torque_2: vec3  # on the surface's body, W [N·m]

    @wp.func
    def contact_wrench(
        model: Model,
        state: State,
        history_in: MaterialHistory,
        dt: real,
        coefficients: Coefficients,
        history_out: MaterialHistory,
        env: int,
        contact: int,
        member: int,
        body_1: int,
        body_2: int,
        offset_W: vec3,
        q_WS: quat,
        R_W1: mat33,
        arm: vec3,
        normal: vec3,
        penetration: real,
        entry_speed: real,
    ):
        """Returns the wrench of a closed contact; ``arm``: from the point's body to K."""
        geometry = model.contact_geometry[env, contact]
        kinematics = ContactKinematics()
        kinematics.body_1 = body_1
        kinematics.body_2 = body_2
        # Arms to K from the centers of mass.
        kinematics.arm_1 = arm
        kinematics.arm_2 = offset_W + arm
        kinematics.normal = normal
        kinematics.penetration = penetration
        kinematics.radius = geometry.radius
        if wp.static(needs_curvature):
            # The facets of the mesh are flat; only the curvature of the sphere counts.
            kinematics.curvature_1 = real(1.0) / geometry.radius
            kinematics.curvature_2 = kinematics.curvature_1
        torsion_radius = real(-1.0)
        if wp.static(has_torsion):
            uses_hertz_radius = (model.contact_options[contact] & HERTZ_TORSION) != 0
            torsion_radius = wp.where(uses_hertz_radius, real(-1.0), geometry.torsion_radius)
        contact_force = evaluate_contact(
            model,
            state,
            env,
            kinematics,
            entry_speed,
            dt,
            coefficients,
            history_in,
            history_out,
            member,
            torsion_radius,
            q_WS,
        )

        # Scale the results, not the load, so that elastic and viscous terms are scaled like terms proportional to
        # N.
        force_scale = geometry.force_scale
        if wp.static(projected):
            force_scale *= facing_fraction(model, env, model.contact_point[contact], R_W1, normal)
        wrench = ContactWrench()
        wrench.approach_speed = contact_force.approach_speed
        wrench.slip_speed = contact_force.slip_speed
        wrench.normal_force = force_scale * contact_force.normal_force
        wrench.friction_force = force_scale * contact_force.friction_force
        wrench.torque = force_scale * contact_force.torque
        # Equal and opposite forces at the same point K and equal and opposite torques: no net wrench.
        wrench.force = wrench.normal_force * normal + wrench.friction_force
        wrench.torque_1 = wp.cross(kinematics.arm_1, wrench.force) + wrench.torque
        wrench.torque_2 = -(wp.cross(kinematics.arm_2, wrench.force) + wrench.torque)
        return wrench

    @wp.func
    def write_no_force(
        contacts: Contacts, history_out: MaterialHistory, env: int, contact: int, member: int, dt: real
    ):
        """Writes zero forces for an open contact and clears its history variables."""
        contacts.approach_speed[env, contact] = real(0.0)
        contacts.normal_force[env, contact] = real(0.0)
        contacts.friction_force[env, contact] = vec3()
        contacts.slip_speed[env, contact] = real(0.0)
        contacts.torque[env, contact] = vec3()
        clear_history(history_out, env, member, contacts.armed[env, contact], dt)

    @wp.func
    def add_wrench(wrenches: Wrenches, env: int, body: int, force_W: vec3, torque_W: vec3):
        if body >= 0:
            wp.atomic_add(wrenches.force, env, body, force_W)
            wp.atomic_add(wrenches.torque, env, body, torque_W)

    return Functions(
        ContactWrench=ContactWrench,
        contact_wrench=contact_wrench,
        clear_history=clear_history,
        write_no_force=write_no_force,
        add_wrench=add_wrench,
    )


@functools.cache
def kernel(
    contact_model: ContactModel, real: type, has_joints: bool = False, projected: bool = False
) -> wp.Kernel:
    """Returns the kernel for the classes of ``contact_model``; items: clusters of the group.

    With ``has_joints``, the mobility of bodies with joints is that of their joint. With ``projected``, forces are
    multiplied by the fraction of the area that faces the surface, from the normal of the point.

    The wrenches of a cluster are stored per cluster if ``ordered``, to be summed in a fixed order; otherwise they
    are added to the bodies atomically. ``write_outputs``: Whether to write the forces of each contact for sensors.
    """
    t = structs(real)
    vec3, quat, mat33, Model, State, History = t.vec3, t.quat, t.mat33, t.Model, t.State, t.History
    Contacts, ActiveContacts, Wrenches = t.Contacts, t.ActiveContacts, t.Wrenches
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    contact_functions = functions(contact_model, real, has_joints, projected)
    ContactWrench, contact_wrench, write_no_force, add_wrench = (
        contact_functions.ContactWrench,
        contact_functions.contact_wrench,
        contact_functions.write_no_force,
        contact_functions.add_wrench,
    )
    needs_surface_axes = contact_model.needs_surface_axes
    frame = frames.functions(real)
    orientation_to_world, offset_between = frame.orientation_to_world, frame.offset_between
    rotation_to_world = frame.rotation_to_world

    @wp.func
    def evaluate_and_write(
        model: Model,
        state: State,
        history: History,
        history_in: MaterialHistory,
        dt: real,
        coefficients: Coefficients,
        contacts: Contacts,
        history_out: MaterialHistory,
        env: int,
        contact: int,
        member: int,
        body_1: int,
        body_2: int,
        offset_W: vec3,
        q_WS: quat,
        R_W1: mat33,
        write_outputs: bool,
    ):
        """Returns the wrench of one contact on both bodies.

        Writes the approach speed, which the history needs, and with ``write_outputs`` the other results of
        ``contacts``.
        """
        # Early return: Warp evaluates both branches and copies every variable they assign.
        if contacts.status[env, contact] != CONTACT:
            write_no_force(contacts, history_out, env, contact, member, dt)
            return ContactWrench()
        wrench = contact_wrench(
            model,
            state,
            history_in,
            dt,
            coefficients,
            history_out,
            env,
            contact,
            member,
            body_1,
            body_2,
            offset_W,
            q_WS,
            R_W1,
            contacts.arm[env, contact],
            contacts.normal[env, contact],
            contacts.penetration[env, contact],
            history.entry_speed[env, contact],
        )
        contacts.approach_speed[env, contact] = wrench.approach_speed
        if write_outputs:
            contacts.slip_speed[env, contact] = wrench.slip_speed
            contacts.normal_force[env, contact] = wrench.normal_force
            contacts.friction_force[env, contact] = wrench.friction_force
            contacts.torque[env, contact] = wrench.torque
        return wrench

    @unique_kernel()
    def contact_force(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        history_in: MaterialHistory,
        step: wp.array2d(dtype=real),  # [env, 0] step over which the force acts [s]; 0: force at this instant
        first_cluster: wp.int32,
        first_contact: wp.int32,
        coefficients: Coefficients,
        contacts: Contacts,
        history_out: MaterialHistory,
        active_contacts: ActiveContacts,
        write_outputs: wp.bool,
        ordered: wp.bool,
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            cluster = first_cluster + task_item(launch, task)
            if status[env] != ENV_ACTIVE or active_contacts.count[env, cluster] == 0:
                continue
            # All contacts of a cluster have the same body and surface.
            start = assume_nonnegative(model.cluster_start[cluster])
            contact = assume_nonnegative(model.cluster_contact[start])
            surface = assume_nonnegative(
                model.query_mesh_surface[assume_nonnegative(model.contact_query_mesh[contact])]
            )
            point = assume_nonnegative(model.contact_point[contact])
            body_1 = model.point_body[point]
            body_2 = model.surface_body[surface]
            offset_W = offset_between(model, state, env, point, surface)
            q_WS = quat()
            if wp.static(needs_surface_axes):
                q_WS = orientation_to_world(state, env, body_2, model.surface_orientation[env, surface])
            R_W1 = mat33()
            if wp.static(projected):
                R_W1 = rotation_to_world(state, env, body_1)
            dt = step[env, 0]
            force = vec3()
            torque_1 = vec3()
            torque_2 = vec3()
            for index in range(start, start + active_contacts.count[env, cluster]):
                contact = assume_nonnegative(active_contacts.contact[env, index])
                member = contact - first_contact
                wrench = evaluate_and_write(
                    model,
                    state,
                    history,
                    history_in,
                    dt,
                    coefficients,
                    contacts,
                    history_out,
                    env,
                    contact,
                    member,
                    body_1,
                    body_2,
                    offset_W,
                    q_WS,
                    R_W1,
                    write_outputs,
                )
                force += wrench.force
                torque_1 += wrench.torque_1
                torque_2 += wrench.torque_2
            if ordered:
                active_contacts.force[env, cluster] = force
                active_contacts.torque_1[env, cluster] = torque_1
                active_contacts.torque_2[env, cluster] = torque_2
            else:
                add_wrench(wrenches, env, body_1, force, torque_1)
                add_wrench(wrenches, env, body_2, -force, torque_2)

    return contact_force
