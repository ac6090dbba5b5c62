"""Sums particle contact forces to the wrenches of bodies, in a fixed order."""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.lowlevel.warps import lowest_set_bit, popcount
from warpcontact.kernels.particles.base import BATCH_SIZE, IN_CONTACT, particle_structs
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, Struct, structs, task_count, task_env, task_item


class Functions(NamedTuple):
    """Struct and device function for the sum of the contacts of a particle."""

    WrenchSum: Struct  # wrench on a body, and number of contacts
    add_particle: wp.Function  # a sum, plus the contacts of a particle in list order


@functools.cache
def functions(real: type) -> Functions:
    """Returns the struct ``WrenchSum`` and the device function that sums contacts of a particle in list order."""
    t, p = structs(real), particle_structs(real)
    vec3, State = t.vec3, t.State
    Particles, NeighborLists, PairRecords = p.Particles, p.NeighborLists, p.PairRecords

    @wp.struct
    class WrenchSum:
        force: vec3  # W [N]
        torque: vec3  # about the center of mass, W [N·m]
        contact_count: wp.int32

    @wp.func
    def torque_on_second(
        state: State, particles: Particles, env: int, first: int, second: int, force: vec3, torque: vec3
    ):
        """Returns the torque on the second about its center of mass, from force and torque on the first."""
        body_1 = assume_nonnegative(particles.body[first])
        body_2 = assume_nonnegative(particles.body[second])
        separation = state.body_position[env, body_1] - state.body_position[env, body_2]
        separation += state.body_position_remainder[env, body_1] - state.body_position_remainder[env, body_2]
        return -(torque + wp.cross(separation, force))

    @wp.func
    def add_particle(
        total: WrenchSum,
        state: State,
        particles: Particles,
        neighbor_lists: NeighborLists,
        pair_records: PairRecords,
        env: int,
        particle: int,
    ):
        start = particles.entry_start[particle]
        slot = particles.slot_start[particle]
        owned = neighbor_lists.owned[env, particle]
        count = neighbor_lists.count[env, particle]
        for batch_start in range(0, count, wp.static(BATCH_SIZE)):
            touching = wp.int32(0)
            for k in range(batch_start, wp.min(batch_start + wp.static(BATCH_SIZE), count)):
                record = slot + k
                if k >= owned:
                    record = neighbor_lists.slot[env, start + k]
                if record >= 0:
                    if (pair_records.flags[env, record] & IN_CONTACT) != 0:
                        touching = touching | (1 << (k - batch_start))
            total.contact_count += popcount(touching)
            while touching != 0:
                k = batch_start + lowest_set_bit(touching)
                touching = touching & (touching - 1)
                record = slot + k
                if k >= owned:
                    record = neighbor_lists.slot[env, start + k]
                neighbor = assume_nonnegative(neighbor_lists.neighbor[env, start + k])
                force = pair_records.force[env, record]
                torque = pair_records.torque[env, record]
                if particle < neighbor:
                    total.force += force
                    total.torque += torque
                else:
                    total.force -= force
                    total.torque += torque_on_second(state, particles, env, neighbor, particle, force, torque)
        return total

    return Functions(WrenchSum=WrenchSum, add_particle=add_particle)


@functools.cache
def add(real: type, one_particle_per_body: bool) -> wp.Kernel:
    """Returns the kernel that adds the contact forces of its particles to the wrench of each body, in list order.

    Runs are bitwise reproducible. Items: bodies with particles. ``one_particle_per_body``: whether every body has
    exactly one.
    """
    t = structs(real)
    State, Wrenches = t.State, t.Wrenches
    p = particle_structs(real)
    Particles, NeighborLists, PairRecords = p.Particles, p.NeighborLists, p.PairRecords
    sum_functions = functions(real)
    WrenchSum, add_particle = sum_functions.WrenchSum, sum_functions.add_particle

    @unique_kernel()
    def add_particle_wrenches(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        state: State,
        particles: Particles,
        neighbor_lists: NeighborLists,
        pair_records: PairRecords,
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            owner = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            total = WrenchSum()
            if wp.static(one_particle_per_body):
                total = add_particle(total, state, particles, neighbor_lists, pair_records, env, owner)
            else:
                for index in range(particles.owner_start[owner], particles.owner_start[owner + 1]):
                    total = add_particle(
                        total, state, particles, neighbor_lists, pair_records, env, particles.owner_particle[index]
                    )
            if total.contact_count > 0:
                body = particles.owner_body[owner]
                wrenches.force[env, body] = wrenches.force[env, body] + total.force
                wrenches.torque[env, body] = wrenches.torque[env, body] + total.torque

    return add_particle_wrenches
