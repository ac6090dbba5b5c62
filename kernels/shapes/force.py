"""Forces of one group of shape contacts, and their history.

The forces are a pure function of state and history: they change neither. The history advances once per accepted
step.
"""

import functools

import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.contact import contact_evaluation
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs, kinematics_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.shapes.base import WarmStart
from warpcontact.kernels.shapes.records import (
    ContactShapes,
    ShapeContactSettings,
    WarmStarts,
    shape_contact_structs,
)
from warpcontact.kernels.types import (
    CONTACT,
    DISABLED,
    ENV_ACTIVE,
    UNSOLVED,
    LaunchRange,
    structs,
    task_count,
    task_env,
    task_item,
)


def uses_curvature(parts: ContactModel) -> bool:
    """Returns whether law or friction models of these classes read curvatures at the contact."""
    return parts.law.needs_curvature or parts.friction.needs_radius or parts.has_rolling or parts.has_torsion


@functools.cache
def contact_forces(parts: ContactModel, real: type, has_joints: bool = False) -> wp.Kernel:
    """Returns the force kernel for the classes of ``parts``; items: contacts of the group, consecutive.

    With ``has_joints``, the effective mass accounts for the joints of bodies.
    """
    t = structs(real)
    vec3, quat, Model, State, EndWrenches = t.vec3, t.quat, t.Model, t.State, t.EndWrenches
    ShapeContacts = shape_contact_structs(real).ShapeContacts
    Coefficients, Memory = group_structs(parts, real)
    ContactKinematics = kinematics_structs(real).ContactKinematics
    evaluation = contact_evaluation.functions(parts, real, has_joints)
    evaluate_contact, clear_history = evaluation.evaluate_contact, evaluation.clear_history
    needs_curvature, oriented = uses_curvature(parts), parts.needs_surface_axes

    @unique_kernel()
    def shape_contact_forces(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history_in: Memory,
        step: wp.array2d(dtype=real),  # [env, 0] duration over which the force acts [s]; 0: instantaneous force
        first: wp.int32,  # contact
        first_end: wp.int32,
        contact_shapes: ContactShapes,
        settings: wp.array2d(dtype=ShapeContactSettings),
        coefficients: Coefficients,
        shape_contacts: ShapeContacts,
        history_out: Memory,
        ends: EndWrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            contact = first + task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            end = first_end + 2 * contact
            if shape_contacts.status[env, contact] != CONTACT:
                shape_contacts.approach_speed[env, contact] = real(0.0)
                shape_contacts.slip_speed[env, contact] = real(0.0)
                shape_contacts.normal_force[env, contact] = real(0.0)
                shape_contacts.friction_force[env, contact] = vec3()
                shape_contacts.torque[env, contact] = vec3()
                for side in range(2):
                    ends.force[env, end + side] = vec3()
                    ends.torque[env, end + side] = vec3()
                clear_history(history_out, env, contact, 1, step[env, 0])
                continue

            setting = settings[env, contact]
            kinematics = ContactKinematics()
            kinematics.body_1 = contact_shapes.body_a[contact]
            kinematics.body_2 = contact_shapes.body_b[contact]
            kinematics.arm_1 = shape_contacts.arm_a[env, contact]
            kinematics.arm_2 = shape_contacts.arm_b[env, contact]
            kinematics.normal = shape_contacts.normal[env, contact]
            kinematics.penetration = shape_contacts.penetration[env, contact]
            if wp.static(needs_curvature):
                kinematics.radius = shape_contacts.radius[env, contact]
                kinematics.curvature_1 = shape_contacts.curvature_1[env, contact]
                kinematics.curvature_2 = shape_contacts.curvature_2[env, contact]
            q_WS = quat()
            if wp.static(oriented):
                q_WS = shape_contacts.orientation[env, contact]
            result = evaluate_contact(
                model, state, env, kinematics, shape_contacts.entry_speed[env, contact], step[env, 0],
                coefficients, history_in, history_out, contact, real(setting.torsion_radius), q_WS,
            )  # fmt: skip

            # Scaled after the evaluation, so that elastic and viscous parts scale like those proportional to N.
            force_scale = real(setting.force_scale)
            normal_force = force_scale * result.normal_force
            friction_W = force_scale * result.friction_force
            torque_W = force_scale * result.torque
            shape_contacts.approach_speed[env, contact] = result.approach_speed
            shape_contacts.slip_speed[env, contact] = result.slip_speed
            shape_contacts.normal_force[env, contact] = normal_force
            shape_contacts.friction_force[env, contact] = friction_W
            shape_contacts.torque[env, contact] = torque_W
            # Equal and opposite force at the same point K, and couple: the total wrench is zero.
            force_W = normal_force * kinematics.normal + friction_W
            ends.force[env, end] = force_W
            ends.torque[env, end] = wp.cross(kinematics.arm_1, force_W) + torque_W
            ends.force[env, end + 1] = -force_W
            ends.torque[env, end + 1] = -(wp.cross(kinematics.arm_2, force_W) + torque_W)

    return shape_contact_forces


@functools.cache
def accept_contacts(real: type) -> wp.Kernel:
    """Returns the kernel that stores warm starts, entry speeds and failures of accepted steps; items: contacts."""
    ShapeContacts = shape_contact_structs(real).ShapeContacts

    @unique_kernel()
    def accept_shape_contacts(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        new_warm_starts: WarmStarts,
        warm_starts: WarmStarts,
        shape_contacts: ShapeContacts,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            contact = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            contact_status = shape_contacts.status[env, contact]
            if contact_status == CONTACT:
                # At least 0: negative values mean "not in contact".
                speed = wp.max(shape_contacts.approach_speed[env, contact], real(0.0))
                shape_contacts.entry_speed[env, contact] = wp.max(shape_contacts.entry_speed[env, contact], speed)
            else:
                shape_contacts.entry_speed[env, contact] = real(-1.0)
            if contact_status == UNSOLVED:
                shape_contacts.failures[env, contact] = shape_contacts.failures[env, contact] + 1
            if contact_status == UNSOLVED or contact_status == DISABLED:  # noqa: SIM109 - Warp has no ``in``
                warm_starts.warm_start[env, contact] = WarmStart()
            else:
                warm_starts.warm_start[env, contact] = new_warm_starts.warm_start[env, contact]

    return accept_shape_contacts


@functools.cache
def advance_history(formula: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that copies the history written by the force stage of ``formula``; items: contacts."""
    Array = wp.array2d(dtype=memory_struct(formula, real))

    @unique_kernel()
    def advance_memory(launch: LaunchRange, status: wp.array(dtype=wp.int32), history_out: Array, memory: Array):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            contact = task_item(launch, task)
            if status[env] == ENV_ACTIVE:
                memory[env, contact] = history_out[env, contact]

    return advance_memory


@functools.cache
def reset_contacts(real: type) -> wp.Kernel:
    """Returns the kernel that resets the history of contacts. Launch with dim (env, contact)."""
    ShapeContacts = shape_contact_structs(real).ShapeContacts

    @unique_kernel(runs_rarely=True)
    def reset_shape_contacts(
        mask: wp.array(dtype=wp.bool), warm_starts: WarmStarts, shape_contacts: ShapeContacts
    ):
        env, contact = wp.tid()
        if mask[env]:
            warm_starts.warm_start[env, contact] = WarmStart()
            shape_contacts.entry_speed[env, contact] = real(-1.0)
            shape_contacts.failures[env, contact] = 0

    return reset_shape_contacts
