"""Advances the contact history, once per accepted step.

``fused_step.py`` and ``fused_steps_cpu.py`` call the same functions. The history belongs to the pair of point and
surface, not to a triangle: a point that slides over a mesh edge does not start a new contact.
"""

import functools

import warp as wp
from warpcontact.kernels.acceptance import accept_step
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item


@functools.cache
def entry_function(real: type) -> wp.Function:
    """Returns the device function that records the status and entry speed of a contact in ``history``."""
    t = structs(real)
    Model, History, Cache = t.Model, t.History, t.Cache

    @wp.func
    def record_entry(
        model: Model,
        cache: Cache,
        history: History,
        env: int,
        cluster: int,
        contact: int,
        touching: bool,
        approach_speed: real,
    ):
        previous = history.entry_speed[env, contact]
        speed = real(-1.0)
        if touching:
            # Not below 0, because negative values mean "no contact".
            speed = wp.max(previous, wp.max(approach_speed, real(0.0)))
            if previous < real(0.0):
                # A new contact must be evaluated in the next steps, until its end is in the history.
                cache.safe_travel[env, contact] = real(0.0)
                cache.cluster_safe_travel[env, cluster] = real(0.0)
                cache.cluster_inactive[env, cluster] = 0
                cache.set_safe_travel[env, assume_nonnegative(model.cluster_set[cluster])] = real(0.0)
        history.entry_speed[env, contact] = speed

    return record_entry


@functools.cache
def advance(real: type, tracks: bool) -> wp.Function:
    """Returns the device function that advances the history of the active contacts of a cluster.

    ``tracks``: Whether any contact tracks a face or is swept; only then ``time`` and ``step`` are read.
    """
    t = structs(real)
    Model, Contacts, ActiveContacts, History, Cache = t.Model, t.Contacts, t.ActiveContacts, t.History, t.Cache
    record_entry = entry_function(real)

    @wp.func
    def advance(
        time: wp.array(dtype=wp.float64),
        step: wp.array2d(dtype=real),
        model: Model,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        history: History,
        cache: Cache,
        env: int,
        cluster: int,
    ):
        start = assume_nonnegative(model.cluster_start[cluster])
        count = active_contacts.count[env, cluster]
        if wp.static(tracks):
            count += active_contacts.crossed_count[env, cluster]
        index = assume_nonnegative(start)
        while index < start + count:
            contact = assume_nonnegative(active_contacts.contact[env, index])
            index = assume_nonnegative(index + 1)
            history.armed[env, contact] = contacts.armed[env, contact]
            touching = contacts.status[env, contact] == CONTACT
            active_contacts.needs_history[env, contact] = wp.where(touching, 1, 0)
            record_entry(
                model, cache, history, env, cluster, contact, touching, contacts.approach_speed[env, contact]
            )
            if wp.static(tracks):
                face = wp.where(touching, contacts.face[env, contact], -1)
                crossed = contacts.crossed_face[env, contact]
                if crossed >= 0:
                    face = crossed
                    if history.crossings[env, contact] == 0:
                        time_left = (real(1.0) - contacts.crossing_fraction[env, contact]) * step[env, 0]
                        history.crossing_time[env, contact] = real(time[env] - wp.float64(time_left))
                    history.crossings[env, contact] = history.crossings[env, contact] + 1
                history.face[env, contact] = face

    return advance


@functools.cache
def material_history_function(contact_model: ContactModel, real: type) -> wp.Function:
    """Returns the device function that copies the history variables of a contact after an accepted step."""
    _, MaterialHistory = group_structs(contact_model, real)

    @wp.func
    def store_history(history_in: MaterialHistory, history_out: MaterialHistory, env: int, member: int):
        if wp.static(bool(contact_model.law.memories)):
            history_in.law[env, member] = history_out.law[env, member]
        if wp.static(bool(contact_model.friction.memories)):
            history_in.friction[env, member] = history_out.friction[env, member]
        if wp.static(bool(contact_model.rolling.memories)):
            history_in.rolling[env, member] = history_out.rolling[env, member]
        if wp.static(bool(contact_model.torsion.memories)):
            history_in.torsion[env, member] = history_out.torsion[env, member]

    return store_history


@functools.cache
def kernel(real: type, tracks: bool, accepts_step: bool = False) -> wp.Kernel:
    """Returns the kernel that advances the history of active contacts; items: clusters.

    With ``accepts_step``, the first cluster of an environment accepts the step, as ``accept_step.kernel`` does.
    This excludes ``tracks``, which needs the time after the step.
    """
    assert not (tracks and accepts_step)
    t = structs(real)
    Model, State, Contacts, ActiveContacts, History, Cache = (
        t.Model,
        t.State,
        t.Contacts,
        t.ActiveContacts,
        t.History,
        t.Cache,
    )
    accept, advance_cluster = accept_step.accept_step(real), advance(real, tracks)

    @unique_kernel()
    def advance_history(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),  # [env] at the end of the step [s]
        step: wp.array2d(dtype=real),  # [env, 0] [s]
        clock_step: wp.array2d(dtype=wp.float64),  # [env, 0] step of the clock, in float64 [s]
        bodies: wp.int32,
        state_in: State,
        state_out: State,
        model: Model,
        contacts: Contacts,
        active_contacts: ActiveContacts,
        history: History,
        cache: Cache,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            cluster = task_item(launch, task)
            previous = status[env]
            if wp.static(accepts_step):
                # Accepting never makes an environment active, so other clusters may read the status before or
                # after it.
                if cluster == 0:
                    accept(status, clock_step, time, bodies, state_in, state_out, env, previous)
            if previous == ENV_ACTIVE:
                advance_cluster(time, step, model, contacts, active_contacts, history, cache, env, cluster)

    return advance_history


@functools.cache
def material_history_kernel(formula: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that copies the history variables of ``formula`` after an accepted step.

    Items: clusters of the group.
    """
    t = structs(real)
    Model, ActiveContacts = t.Model, t.ActiveContacts
    Array = wp.array2d(dtype=memory_struct(formula, real))

    @unique_kernel()
    def advance_material_history(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        active_contacts: ActiveContacts,
        first_cluster: wp.int32,
        first_contact: wp.int32,
        history_out: Array,
        history_in: Array,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            cluster = task_item(launch, task)
            cluster += first_cluster
            if status[env] != ENV_ACTIVE:
                continue
            start = assume_nonnegative(model.cluster_start[cluster])
            for index in range(start, start + active_contacts.count[env, cluster]):
                member = active_contacts.contact[env, index] - first_contact
                history_in[env, member] = history_out[env, member]

    return advance_material_history
