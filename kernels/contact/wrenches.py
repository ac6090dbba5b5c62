"""Sums the wrenches of contact clusters, of ends and of external forces per body.

The first kernel after contact detection that writes wrenches also empties the work queues of detection.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    QUEUE_COUNT,
    LaunchRange,
    structs,
    task_count,
    task_env,
    task_item,
)


@wp.func
def reset_queues(queue_count: wp.array(dtype=wp.int32)):
    """Empties the work queues of contact detection for the next step."""
    for kind in range(QUEUE_COUNT):
        queue_count[kind] = 0


class Functions(NamedTuple):
    """Device functions of the wrench on a body about its center of mass."""

    external_wrench: wp.Function  # of external forces and of forces at ends
    body_wrench: wp.Function  # of these and of the contacts, summed in a fixed order


@functools.cache
def functions(real: type, has_ends: bool, has_external_forces: bool) -> Functions:
    """Returns the device functions of the wrench on a body: ``external_wrench``; ``body_wrench`` adds contacts.

    Args:
        real: Scalar type, ``wp.float32`` or ``wp.float64``.
        has_ends: Whether force elements have forces at their ends.
        has_external_forces: Whether there are external forces.
    """
    t = structs(real)
    vec3, Model, ActiveContacts, EndWrenches = t.vec3, t.Model, t.ActiveContacts, t.EndWrenches

    @wp.struct
    class Wrench:
        force: vec3  # W [N]
        torque: vec3  # about the center of mass, W [N·m]

    @wp.func
    def external_wrench(model: Model, ends: EndWrenches, env: int, body: int):
        wrench = Wrench()
        if wp.static(has_external_forces):
            wrench.force = model.body_external_force[env, body]
            wrench.torque = model.body_external_torque[env, body]
        if wp.static(has_ends):
            for index in range(model.body_end_start[body], model.body_end_start[body + 1]):
                end = model.body_end[index]
                wrench.force += ends.force[env, end]
                wrench.torque += ends.torque[env, end]
        return wrench

    @wp.func
    def body_wrench(model: Model, active_contacts: ActiveContacts, ends: EndWrenches, env: int, body: int):
        """Returns the wrench on a body; the fixed order of clusters makes runs bitwise reproducible."""
        wrench = external_wrench(model, ends, env, body)
        index = assume_nonnegative(model.body_cluster_start[body])
        stop = model.body_cluster_start[body + 1]
        while index < stop:
            entry = assume_nonnegative(model.body_cluster[index])
            index = assume_nonnegative(index + 1)
            # entry = 2 · cluster + side; side 1: the body of the surface.
            cluster = entry // 2
            if active_contacts.count[env, cluster] > 0:
                if entry == 2 * cluster:
                    wrench.force += active_contacts.force[env, cluster]
                    wrench.torque += active_contacts.torque_1[env, cluster]
                else:
                    wrench.force -= active_contacts.force[env, cluster]
                    wrench.torque += active_contacts.torque_2[env, cluster]
        return wrench

    return Functions(external_wrench=external_wrench, body_wrench=body_wrench)


@functools.cache
def initialize_wrenches(real: type, has_ends: bool = False, has_external_forces: bool = False) -> wp.Kernel:
    """Returns the kernel that sets ``wrenches`` to forces at ends and external forces; items: bodies.

    Clusters are then added to them. The kernel also empties the work queues of contact detection.

    Args:
        real: Scalar type, ``wp.float32`` or ``wp.float64``.
        has_ends: Whether force elements have forces at their ends.
        has_external_forces: Whether there are external forces.
    """
    t = structs(real)
    Model, EndWrenches, Wrenches = t.Model, t.EndWrenches, t.Wrenches
    external_wrench = functions(real, has_ends, has_external_forces).external_wrench

    @unique_kernel()
    def initialize_wrenches(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        queue_count: wp.array(dtype=wp.int32),
        model: Model,
        ends: EndWrenches,
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            if task == 0:
                reset_queues(queue_count)
            env = task_env(launch, task)
            body = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            wrench = external_wrench(model, ends, env, body)
            wrenches.force[env, body] = wrench.force
            wrenches.torque[env, body] = wrench.torque

    return initialize_wrenches


@functools.cache
def sum_by_body(real: type, has_ends: bool = False, has_external_forces: bool = False) -> wp.Kernel:
    """Returns the kernel that sums the wrenches on each body, clusters in their order; items: bodies.

    The kernel also empties the work queues of contact detection.

    Arguments are those of ``initialize_wrenches``.
    """
    t = structs(real)
    Model, ActiveContacts, EndWrenches, Wrenches = t.Model, t.ActiveContacts, t.EndWrenches, t.Wrenches
    body_wrench = functions(real, has_ends, has_external_forces).body_wrench

    @unique_kernel()
    def sum_wrenches(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        queue_count: wp.array(dtype=wp.int32),
        model: Model,
        active_contacts: ActiveContacts,
        ends: EndWrenches,
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            if task == 0:
                reset_queues(queue_count)
            env = task_env(launch, task)
            body = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            wrench = body_wrench(model, active_contacts, ends, env, body)
            wrenches.force[env, body] = wrench.force
            wrenches.torque[env, body] = wrench.torque

    return sum_wrenches
