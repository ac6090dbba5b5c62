"""Whole semi-implicit Euler step in one launch on a GPU, for single-body environments with one set of contacts.

It calls the device functions of the separate stages, without intermediate arrays, so results are the same. Contact
sensors are not written; their evaluation runs contact detection again. Monitored steps use the separate stages.

One thread per environment finds the contacts that cannot be culled. All lanes of the warp then evaluate these
contacts, one each, for any environment of the warp. Finally each thread sums the forces of its contacts in their
order, as a single thread would, and integrates its body. Conditions:
``warpcontact/forces/launch_shape.py``.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.acceptance import accept_step
from warpcontact.kernels.broadphase import contact_detection, motion_bound
from warpcontact.kernels.contact import history
from warpcontact.kernels.contact import wrenches as wrench_functions
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.integrators import semi_implicit
from warpcontact.kernels.launch_shapes import fused_contact
from warpcontact.kernels.lowlevel import warps
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.narrowphase.closest_point import DETECT_GRID_ANY
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    ENV_FAILED,
    NO_CAUSE,
    LaunchRange,
    Struct,
    first_env,
    structs,
    task_count,
)

# State of a contact in a step: open, contact just ended (history must be cleared), closed.
NO_CONTACT, ENDED, IN_CONTACT = 0, 1, 2
# Register limit per GPU thread in float32 (measured); without a limit, 190.
REGISTERS = 128


class _Functions(NamedTuple):
    """Structs and device functions of a contact, of the body and of the end of a step."""

    Guard: Struct  # limits of environments, and causes of failures: ``accept_step.py``
    has_history: bool  # whether contacts have history variables
    active_mask: wp.Function  # contacts of a cluster that cannot be culled, as bits
    cluster_safe_travel: wp.Function  # safe travel of a cluster [m]
    detect_and_evaluate: wp.Function  # result of a contact, with its force if closed
    integrate_body: wp.Function  # integrates the body and ends its step; whether the step is accepted
    accept_contact: wp.Function  # advances the history of a contact in an accepted step


@functools.cache
def _functions(contact_model: ContactModel, real: type, projected: bool, width: int) -> _Functions:
    """Returns the structs and device functions of a contact, of the body and of the end of a step."""
    t = structs(real)
    vec3, Model, State, History = t.vec3, t.Model, t.State, t.History
    ActiveContacts, Cache = t.ActiveContacts, t.Cache
    body_functions = semi_implicit.euler(real)
    Guard, stepped_body, write_body, step_failure_cause = (
        body_functions.Guard,
        body_functions.stepped_body,
        body_functions.write_body,
        body_functions.step_failure_cause,
    )
    accept = accept_step.accept_step(real)
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    contact_functions = fused_contact.functions(contact_model, real, False, projected, DETECT_GRID_ANY)
    set_bodies_of, evaluate_pair, clear_history = (
        contact_functions.set_bodies_of,
        contact_functions.detect_and_evaluate,
        contact_functions.clear_history,
    )
    has_history = any(part.memories for part in contact_model)
    record_entry, store_history = (
        history.entry_function(real),
        history.material_history_function(contact_model, real),
    )

    @wp.struct
    class ContactUpdate:
        """Result of detection and force of one contact in a step."""

        kind: wp.int32  # NO_CONTACT, ENDED, IN_CONTACT
        clearance: real  # displacement of its point without contact [m]
        armed: wp.int32  # latch; only with history variables
        approach_speed: real  # [m/s]
        force: vec3  # on the body, W [N]
        torque: vec3  # about its center of mass, W [N·m]

    @wp.func
    def active_mask(model: Model, cache: Cache, env: int, cluster: int, max_travel: real):
        """Returns the contacts of a cluster that cannot be culled, as bits by their index in the cluster."""
        start = assume_nonnegative(model.cluster_start[cluster])
        size = model.cluster_start[cluster + 1] - start
        mask = wp.int32(0)
        # Unrolled, so that all reads are issued together.
        for index in range(wp.static(width)):
            if index < size:
                if not (
                    max_travel < cache.safe_travel[env, assume_nonnegative(model.cluster_contact[start + index])]
                ):
                    mask = mask | (1 << index)
        return mask

    @wp.func
    def cluster_safe_travel(model: Model, cache: Cache, env: int, cluster: int, has_active_contact: bool):
        """Returns the safe travel of a cluster [m]; 0 with ``has_active_contact``, also if a contact has just ended."""
        safe_travel = real(wp.inf)
        if has_active_contact:
            return real(0.0)
        start = assume_nonnegative(model.cluster_start[cluster])
        size = model.cluster_start[cluster + 1] - start
        for index in range(wp.static(width)):
            if index < size:
                safe_travel = wp.min(
                    safe_travel, cache.safe_travel[env, assume_nonnegative(model.cluster_contact[start + index])]
                )
        return safe_travel

    @wp.func
    def detect_and_evaluate(
        model: Model,
        state: State,
        history: History,
        history_in: MaterialHistory,
        dt: real,
        coefficients: Coefficients,
        history_out: MaterialHistory,
        cache: Cache,
        env: int,
        contact: int,
        has_env: bool,
    ):
        """Returns the result of a contact, with its force if closed; an empty result without ``has_env``."""
        update = ContactUpdate()
        # Early return: Warp evaluates both branches and copies every variable they assign.
        if not has_env:
            return update
        set_bodies = set_bodies_of(model, state, env, 0)
        found = evaluate_pair(
            model,
            state,
            set_bodies,
            history,
            history_in,
            dt,
            coefficients,
            history_out,
            cache,
            env,
            contact,
            contact,
        )
        if found.status == CONTACT:
            update.kind = IN_CONTACT
            update.approach_speed = found.approach_speed
            if set_bodies.body_1 >= 0:
                update.force = found.force
                update.torque = found.torque_1
            else:
                update.force = -found.force
                update.torque = found.torque_2
        elif history.entry_speed[env, contact] >= real(0.0):
            update.kind = ENDED
        if wp.static(has_history):
            update.armed = found.armed
            if update.kind == NO_CONTACT and found.armed != history.armed[env, contact]:
                update.kind = ENDED
            if update.kind == ENDED:
                clear_history(history_out, env, contact, update.armed, dt)
        update.clearance = found.clearance
        return update

    @wp.func
    def accept_contact(
        model: Model,
        history: History,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        active_contacts: ActiveContacts,
        cache: Cache,
        env: int,
        cluster: int,
        contact: int,
        touching: bool,
        armed: int,
        approach_speed: real,
    ):
        """Advances the history of a contact in an accepted step."""
        active_contacts.needs_history[env, contact] = wp.where(touching, 1, 0)
        record_entry(model, cache, history, env, cluster, contact, touching, approach_speed)
        if wp.static(has_history):
            # Without history variables and latches, ``armed`` is not read.
            history.armed[env, contact] = armed
        store_history(history_in, history_out, env, contact)

    @wp.func
    def integrate_body(
        status: wp.array(dtype=wp.int32),
        clock_step: wp.array2d(dtype=wp.float64),
        time: wp.array(dtype=wp.float64),
        model: Model,
        guard: Guard,
        state_in: State,
        state_out: State,
        env: int,
        force: vec3,
        torque: vec3,
        dt: real,
    ):
        """Integrates the body of an environment and ends its step; returns whether the step is accepted."""
        body_step = stepped_body(model, state_in, env, 0, force, torque, dt)
        write_body(state_out, env, 0, body_step)
        found = wp.int32(ENV_ACTIVE)
        cause = step_failure_cause(guard, env, body_step)
        if cause != NO_CAUSE:
            found = wp.int32(ENV_FAILED)
            guard.cause[env] = cause
        accept(status, clock_step, time, 1, state_in, state_out, env, found)
        return cause == NO_CAUSE

    return _Functions(
        Guard=Guard,
        has_history=has_history,
        active_mask=active_mask,
        cluster_safe_travel=cluster_safe_travel,
        detect_and_evaluate=detect_and_evaluate,
        integrate_body=integrate_body,
        accept_contact=accept_contact,
    )


@functools.cache
def kernel(
    contact_model: ContactModel,
    real: type,
    projected: bool,
    has_external_forces: bool,
    width: int,
    clusters: int,
    lanes: int,
) -> wp.Kernel:
    """Returns the kernel of a semi-implicit Euler step; a warp handles ``envs_per_warp`` environments.

    Args:
        contact_model: Classes of the law and friction models.
        real: Scalar type, ``wp.float32`` or ``wp.float64``.
        projected: Whether forces are multiplied by the fraction of the area that faces the surface.
        has_external_forces: Whether there are external forces.
        width: Capacity of a cluster in contacts, less than the number of bits of an integer.
        clusters: Number of clusters of contacts.
        lanes: Threads of a warp.
    """
    t = structs(real)
    vec3, Model, State, History, Contacts, ActiveContacts, Cache, EndWrenches = (
        t.vec3,
        t.Model,
        t.State,
        t.History,
        t.Contacts,
        t.ActiveContacts,
        t.Cache,
        t.EndWrenches,
    )
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    set_functions = _functions(contact_model, real, projected, width)
    Guard, active_mask, cluster_safe_travel = (
        set_functions.Guard,
        set_functions.active_mask,
        set_functions.cluster_safe_travel,
    )
    detect_and_evaluate, integrate_body, accept_contact, has_history = (
        set_functions.detect_and_evaluate,
        set_functions.integrate_body,
        set_functions.accept_contact,
        set_functions.has_history,
    )
    travel_functions = motion_bound.functions(real)
    accumulate_travel, is_culled = travel_functions.accumulate_travel, travel_functions.is_culled
    safe_travel_for = contact_detection.functions(real, False, DETECT_GRID_ANY).safe_travel_for
    external_wrench_of = wrench_functions.functions(real, False, has_external_forces).external_wrench
    broadcast_from, broadcast_int_from = warps.broadcast_function(real), warps.broadcast_function(wp.int32)
    # Per cluster, until the step is accepted: one bit per contact.
    Bits = wp.types.vector(length=clusters, dtype=wp.int32)
    # A single contact is evaluated by the thread of its environment.
    single_contact = width == 1 and clusters == 1
    registers = REGISTERS if real is wp.float32 else None

    @wp.func
    def broadcast_vec3(v: vec3, lane: int):
        return vec3(broadcast_from(v[0], lane), broadcast_from(v[1], lane), broadcast_from(v[2], lane))

    @wp.func
    def mask_index(cluster: int):
        """Returns the index of the bits of a cluster."""
        if wp.static(clusters == 1):
            return 0
        return cluster

    @unique_kernel(registers)
    def fused_step(
        launch: LaunchRange,
        envs_per_warp: wp.int32,  # environments per warp
        status: wp.array(dtype=wp.int32),
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        clock_step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        time: wp.array(dtype=wp.float64),  # [env] [s]
        model: Model,
        guard: Guard,
        state_in: State,
        history: History,
        history_in: MaterialHistory,
        coefficients: Coefficients,
        history_out: MaterialHistory,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        cache: Cache,
        ends: EndWrenches,
        state_out: State,
    ):
        lane = warps.lane()
        # All lanes must reach the exchanges below together, also those without an environment.
        for warp in range(
            wp.tid() // wp.static(lanes),
            (task_count(launch) + envs_per_warp - 1) // envs_per_warp,
            launch.threads // wp.static(lanes),
        ):
            first = assume_nonnegative(first_env(launch) + warp * envs_per_warp)
            env = first
            has_env = lane < envs_per_warp and warp * envs_per_warp + lane < task_count(launch)
            if has_env:
                env = first + assume_nonnegative(lane)
                has_env = status[env] == ENV_ACTIVE
            force = vec3()
            torque = vec3()
            if has_env:
                wrench = external_wrench_of(model, ends, env, 0)
                force = wrench.force
                torque = wrench.torque
            touching = Bits()
            ended = Bits()
            armed = Bits()
            speed = real(0.0)
            if wp.static(single_contact):
                update = detect_and_evaluate(
                    model,
                    state_in,
                    history,
                    history_in,
                    step[env, 0],
                    coefficients,
                    history_out,
                    cache,
                    env,
                    0,
                    has_env,
                )
                force += update.force
                torque += update.torque
                touching[0] = wp.where(update.kind == IN_CONTACT, 1, 0)
                ended[0] = wp.where(update.kind == ENDED, 1, 0)
                armed[0] = update.armed
                speed = update.approach_speed
            else:
                max_travel = real(0.0)
                is_active = wp.bool(False)
                evaluated_clusters = wp.int32(0)
                if has_env:
                    max_travel = accumulate_travel(model, state_in, cache, env, 0)
                    is_active = not is_culled(model, cache, env, 0, max_travel)
                # Makes the writes of each lane visible to the warp.
                warps.sync()
                active_masks = Bits()
                count = wp.int32(0)
                if is_active:
                    for cluster in range(model.cluster_set.shape[0]):
                        if not (max_travel < cache.cluster_safe_travel[env, cluster]):
                            mask = active_mask(model, cache, env, cluster, max_travel)
                            active_masks[mask_index(cluster)] = mask
                            count += warps.popcount(mask)
                            evaluated_clusters = evaluated_clusters | (1 << cluster)
                # Prefix sums over the environments of the warp: position of the next own contact, its cluster and
                # remaining bits.
                inclusive_sum = warps.inclusive_scan(count)
                position = inclusive_sum - count
                start = position
                total = broadcast_int_from(inclusive_sum, wp.static(lanes - 1))
                own_cluster = wp.int32(0)
                remaining_mask = active_masks[0]
                sum_force = vec3()
                sum_torque = vec3()
                for first_item in range(0, total, wp.static(lanes)):
                    owner = warps.find_owner(start, first_item + lane)
                    number = first_item + lane - broadcast_int_from(start, owner)
                    cluster = wp.int32(0)
                    mask = broadcast_int_from(active_masks[0], owner)
                    for other in range(1, model.cluster_set.shape[0]):
                        lane_mask = broadcast_int_from(active_masks[mask_index(other)], owner)
                        if cluster == other - 1 and number >= warps.popcount(mask):
                            number -= warps.popcount(mask)
                            mask = lane_mask
                            cluster = other
                    owner_env = first
                    contact = wp.int32(0)
                    found = first_item + lane < total
                    if found:
                        owner_env = first + assume_nonnegative(owner)
                        index = assume_nonnegative(model.cluster_start[cluster]) + warps.nth_set_bit(mask, number)
                        contact = assume_nonnegative(model.cluster_contact[index])
                    update = detect_and_evaluate(
                        model,
                        state_in,
                        history,
                        history_in,
                        step[owner_env, 0],
                        coefficients,
                        history_out,
                        cache,
                        owner_env,
                        contact,
                        found,
                    )
                    if found:
                        cache.safe_travel[owner_env, contact] = safe_travel_for(
                            cache.set_travel[owner_env, 0], update.clearance
                        )
                        if update.kind == IN_CONTACT:
                            contacts.approach_speed[owner_env, contact] = update.approach_speed
                    contact_lanes = warps.ballot(update.kind == IN_CONTACT)
                    ended_lanes = warps.ballot(update.kind == ENDED)
                    armed_lanes = wp.int32(0)
                    if wp.static(has_history):
                        armed_lanes = warps.ballot(update.armed != 0)
                    pending = position < wp.min(inclusive_sum, first_item + wp.static(lanes))
                    while warps.ballot(pending) != 0:
                        source_lane = wp.where(pending, position - first_item, lane)
                        lane_force = broadcast_vec3(update.force, source_lane)
                        lane_torque = broadcast_vec3(update.torque, source_lane)
                        if pending:
                            while remaining_mask == 0:
                                force += sum_force
                                torque += sum_torque
                                sum_force = vec3()
                                sum_torque = vec3()
                                own_cluster += 1
                                remaining_mask = active_masks[mask_index(own_cluster)]
                            sum_force += lane_force
                            sum_torque += lane_torque
                            bit = remaining_mask & -remaining_mask
                            remaining_mask = remaining_mask - bit
                            slot = mask_index(own_cluster)
                            touching[slot] = touching[slot] | (
                                bit * warps.bit_range(contact_lanes, source_lane, 1)
                            )
                            ended[slot] = ended[slot] | (bit * warps.bit_range(ended_lanes, source_lane, 1))
                            if wp.static(has_history):
                                armed[slot] = armed[slot] | (bit * warps.bit_range(armed_lanes, source_lane, 1))
                            position += 1
                        pending = position < wp.min(inclusive_sum, first_item + wp.static(lanes))
                force += sum_force
                torque += sum_torque
                # Makes the safe travels written by other lanes visible.
                warps.sync()
                for cluster in range(model.cluster_set.shape[0]):
                    if warps.bit_range(evaluated_clusters, cluster, 1) != 0:
                        slot = mask_index(cluster)
                        cache.cluster_safe_travel[env, cluster] = cluster_safe_travel(
                            model, cache, env, cluster, (touching[slot] | ended[slot]) != 0
                        )
            if has_env:
                if integrate_body(
                    status, clock_step, time, model, guard, state_in, state_out, env, force,
                    torque, step[env, 0],
                ):  # fmt: skip
                    for cluster in range(model.cluster_set.shape[0]):
                        slot = mask_index(cluster)
                        remaining_mask = touching[slot] | ended[slot]
                        while remaining_mask != 0:
                            index = warps.nth_set_bit(remaining_mask, 0)
                            remaining_mask = remaining_mask & (remaining_mask - 1)
                            contact = assume_nonnegative(
                                model.cluster_contact[assume_nonnegative(model.cluster_start[cluster]) + index]
                            )
                            if wp.static(not single_contact):
                                speed = contacts.approach_speed[env, contact]
                            in_contact = warps.bit_range(touching[slot], index, 1) != 0
                            accept_contact(
                                model,
                                history,
                                history_in,
                                history_out,
                                active_contacts,
                                cache,
                                env,
                                cluster,
                                contact,
                                in_contact,
                                warps.bit_range(armed[slot], index, 1),
                                speed,
                            )

    return fused_step
