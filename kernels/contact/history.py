"""Advances the memory of the contacts, once per accepted step; ``alone.py`` and ``in_place.py`` do so themselves.

The record belongs to the pair of point and surface, not to a triangle: a point that slides over a mesh edge does
not enter anew.
"""

import functools

import warp as wp
from warpcontact.kernels.acceptance import accept_step
from warpcontact.kernels.catalogue.device_model import Formula
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    LaunchRange,
    assume_nonnegative,
    structs,
    task_count,
    task_env,
    task_item,
)


@functools.cache
def entry_function(real: type) -> wp.Function:
    """Returns the device function that takes whether a contact touches, and how fast, into ``history``."""
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
            # Not below 0, which says "not touching".
            speed = wp.max(previous, wp.max(approach_speed, real(0.0)))
            if previous < real(0.0):
                # Whoever found it: what others know of distances must not leave it out when it ends.
                cache.safe_travel[env, contact] = real(0.0)
                cache.cluster_safe_travel[env, cluster] = real(0.0)
                cache.cluster_inactive[env, cluster] = 0
                cache.set_safe_travel[env, assume_nonnegative(model.cluster_set[cluster])] = real(0.0)
        history.entry_speed[env, contact] = speed

    return record_entry


@functools.cache
def advance(real: type, tracks: bool) -> wp.Function:
    """Returns the device function that takes the contacts of a block that are near into ``history``.

    ``tracks``: whether any contact stays with the face that it touched, or crossed; it asks for the time then.
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
    """Returns the device function that takes what the force kept of a contact into the memory of its formulas."""
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
    """Returns the kernel that takes contacts that are near into ``history``; items: blocks.

    With ``accepts_step``, the first cluster of an environment accepts the step before, as ``finish.kernel`` does;
    not with ``tracks``, which needs the time.
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
        clock_step: wp.array2d(dtype=wp.float64),  # [env, 0] the same for the clock [s]
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
                # What it does to the status makes none active, whoever looks at it meanwhile.
                if cluster == 0:
                    accept(status, clock_step, time, bodies, state_in, state_out, env, previous)
            if previous == ENV_ACTIVE:
                advance_cluster(time, step, model, contacts, active_contacts, history, cache, env, cluster)

    return advance_history


@functools.cache
def material_history_kernel(formula: type[Formula], real: type) -> wp.Kernel:
    """Returns the kernel that takes what the force stage kept into the memory of ``formula``.

    Items: blocks of the group.
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
