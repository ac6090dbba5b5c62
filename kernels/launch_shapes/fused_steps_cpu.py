"""Multi-step kernel for single-body environments on a CPU.

One launch takes n accepted semi-implicit Euler steps of each environment of a slice, one environment after the
other, and updates the state in place. Environment data and nearby faces stay in the core's cache, and branches are
predicted better. It calls the device functions of the stages, so results are bitwise identical. Conditions:
``warpcontact/forces/launch_shape.py``.
"""

import functools

import warp as wp
from warpcontact.kernels.contact import history
from warpcontact.kernels.contact import wrenches as wrench_functions
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.integrators import semi_implicit
from warpcontact.kernels.launch_shapes import fused_contact
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative, hide_from_optimizer
from warpcontact.kernels.lowlevel.static_strides import assume_strides
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    ENV_FROZEN,
    NO_CAUSE,
    LaunchRange,
    first_env,
    step_count,
    structs,
    task_count,
)


@functools.cache
def kernel(contact_model: ContactModel, real: type, projected: bool, has_external_forces: bool) -> wp.Kernel:
    """Returns the kernel of accepted semi-implicit Euler steps; their number is in the slice; items: one.

    Args:
        contact_model: Classes of the law and friction models of all contacts.
        real: Scalar type, ``wp.float32`` or ``wp.float64``.
        projected: Whether forces are multiplied by the fraction of the area that faces the surface.
        has_external_forces: Whether there are external forces.
    """
    t = structs(real)
    Model, State, History, Contacts, ActiveContacts, Cache, EndWrenches = (
        t.Model,
        t.State,
        t.History,
        t.Contacts,
        t.ActiveContacts,
        t.Cache,
        t.EndWrenches,
    )
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    update_set = fused_contact.set_function(contact_model, real, False, projected)
    body_wrench = wrench_functions.functions(real, False, has_external_forces).body_wrench
    body_functions = semi_implicit.euler(real)
    Guard, stepped_body, write_body, step_failure_cause = (
        body_functions.Guard,
        body_functions.stepped_body,
        body_functions.write_body,
        body_functions.step_failure_cause,
    )
    advance, store_history = history.advance(real, False), history.material_history_function(contact_model, real)
    has_history = any(part.memories for part in contact_model)
    assume_model_strides, assume_state_strides, assume_history_strides = (
        assume_strides(Model),
        assume_strides(State),
        assume_strides(History),
    )
    assume_cache_strides, assume_contacts_strides, assume_active_strides = (
        assume_strides(Cache),
        assume_strides(Contacts),
        assume_strides(ActiveContacts),
    )
    assume_coefficient_strides = assume_strides(Coefficients)

    @wp.func
    def accept_cluster(
        time: wp.array(dtype=wp.float64),
        step: wp.array2d(dtype=real),
        model: Model,
        history: History,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        cache: Cache,
        env_index: int,
        cluster: int,
    ):
        """Advances the history of the contacts of a cluster."""
        env = hide_from_optimizer(env_index)
        advance(time, step, model, contacts, active_contacts, history, cache, env, cluster)
        if wp.static(has_history):
            start = assume_nonnegative(model.cluster_start[cluster])
            for index in range(start, start + active_contacts.count[env, cluster]):
                store_history(
                    history_in, history_out, env, assume_nonnegative(active_contacts.contact[env, index])
                )

    @unique_kernel()
    def fused_steps(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        clock_step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        time: wp.array(dtype=wp.float64),  # [env] [s]
        model: Model,
        guard: Guard,
        history: History,
        history_in: MaterialHistory,
        coefficients: Coefficients,
        history_out: MaterialHistory,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        cache: Cache,
        ends: EndWrenches,
        sets: wp.int32,
        clusters: wp.int32,
        state: State,
    ):
        assume_model_strides(model)
        assume_state_strides(state)
        assume_history_strides(history)
        assume_coefficient_strides(coefficients)
        assume_cache_strides(cache)
        assume_contacts_strides(contacts)
        assume_active_strides(active_contacts)
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env_index = first_env(launch) + task
            left = step_count(launch)
            while left > 0:
                env = hide_from_optimizer(env_index)
                if status[env] != ENV_ACTIVE:
                    break
                left -= 1
                set_index = assume_nonnegative(0)
                while set_index < sets:
                    update_set(
                        model,
                        state,
                        history,
                        history_in,
                        step[env, 0],
                        0,
                        coefficients,
                        history_out,
                        cache,
                        contacts,
                        active_contacts,
                        env,
                        set_index,
                    )
                    set_index = assume_nonnegative(set_index + 1)
                env = hide_from_optimizer(env_index)
                wrench = body_wrench(model, active_contacts, ends, env, 0)
                body_step = stepped_body(model, state, env, 0, wrench.force, wrench.torque, step[env, 0])
                cause = step_failure_cause(guard, env, body_step)
                if cause != NO_CAUSE:
                    # The state of the last accepted step is kept.
                    status[env] = ENV_FROZEN
                    guard.cause[env] = cause
                    break
                write_body(state, env, 0, body_step)
                time[env] = time[env] + clock_step[env, 0]
                cluster = assume_nonnegative(0)
                while cluster < clusters:
                    accept_cluster(
                        time,
                        step,
                        model,
                        history,
                        history_in,
                        history_out,
                        contacts,
                        active_contacts,
                        cache,
                        env_index,
                        cluster,
                    )
                    cluster = assume_nonnegative(cluster + 1)

    return fused_steps
