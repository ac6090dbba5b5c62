"""Neighbor lists of particles (Verlet lists), rebuilt when a particle has moved by half the skin.

The host takes no decision: the kernels run in every step and return early for environments with valid lists.
Particles are sorted into cells, and cells into hash buckets. Neighbors are sorted by index, so lists do not depend
on thread order. The history of a pair moves with it, and a pair with history stays listed at any distance.
Conditions are nested because Warp evaluates both operands of ``and`` and would read out of bounds.

    check_validity → clear → fill → build → [transfer_impulses] → transfer_history → build_reverse
"""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.contact.impulse_records import record_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.particles import particle_geometry
from warpcontact.kernels.particles.base import (
    NO_INDEX,
    WAS_IN_CONTACT,
    ParticleTraits,
    owns_pair,
    particle_structs,
)
from warpcontact.kernels.particles.history import copy_memory
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item

# Fraction of the skin that a particle may move before lists are stale: half, with a margin for rounding.
SKIN_FRACTION = 0.49
# Cell indices are taken modulo this number.
CELL_RANGE = 1 << 30


@wp.func
def bucket_of(cell: wp.vec3i, buckets: int):
    """Returns the bucket of a cell; ``buckets`` is a power of two."""
    # Unsigned: overflow of signed products is undefined behavior.
    x = wp.uint32(cell[0]) * wp.uint32(73856093)
    y = wp.uint32(cell[1]) * wp.uint32(19349663)
    z = wp.uint32(cell[2]) * wp.uint32(83492791)
    return wp.int32((x ^ y ^ z) & wp.uint32(buckets - 1))


@functools.cache
def check_validity(traits: ParticleTraits, real: type) -> wp.Kernel:
    """Returns the kernel that marks environments with stale lists; items: particles."""
    t = structs(real)
    State = t.State
    p = particle_structs(real)
    axis_point = particle_geometry.functions(traits, real).axis_point
    has_capsules = traits.has_capsules

    @unique_kernel()
    def check_lists(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        state: State,
        particles: p.Particles,
        cell_list: p.CellList,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            particle = task_item(launch, task)
            if status[env] != ENV_ACTIVE or cell_list.stale[env] != 0:
                continue
            if cell_list.valid[env] == 0:
                cell_list.stale[env] = 1
                continue
            point = axis_point(particles, state, env, particle)
            displacement = (point.origin - cell_list.origin[env, particle]) + (
                point.offset - cell_list.offset_from_origin[env, particle]
            )
            limit = real(SKIN_FRACTION) * particles.settings[env, 0].skin
            if wp.static(has_capsules):
                # The displacement of an axis is largest at one of its ends.
                axis_change = point.axis - cell_list.axis[env, particle]
                if wp.length(displacement + axis_change) > limit or wp.length(displacement - axis_change) > limit:
                    cell_list.stale[env] = 1
            elif wp.length_sq(displacement) > limit * limit:
                cell_list.stale[env] = 1

    return check_lists


@functools.cache
def clear(real: type) -> wp.Kernel:
    """Returns the kernel that clears the buckets; items: buckets."""
    CellList = particle_structs(real).CellList

    @unique_kernel()
    def clear_buckets(launch: LaunchRange, status: wp.array(dtype=wp.int32), cell_list: CellList):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            if status[env] == ENV_ACTIVE and cell_list.stale[env] != 0:
                cell_list.head[env, task_item(launch, task)] = NO_INDEX

    return clear_buckets


@functools.cache
def fill(traits: ParticleTraits, real: type) -> wp.Kernel:
    """Returns the kernel that sorts particles into buckets and stores their poses; items: particles."""
    t = structs(real)
    State = t.State
    p = particle_structs(real)
    axis_point = particle_geometry.functions(traits, real).axis_point
    to_float64 = frames.functions(real).to_float64
    has_capsules = traits.has_capsules

    @wp.func
    def cell_along(x: wp.float64, cell: wp.float64):
        return wp.int32(wp.int64(wp.floor(x / cell)) & wp.int64(wp.static(CELL_RANGE - 1)))

    @unique_kernel()
    def fill_buckets(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        buckets: wp.int32,
        state: State,
        particles: p.Particles,
        cell_list: p.CellList,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            particle = task_item(launch, task)
            if status[env] != ENV_ACTIVE or cell_list.stale[env] == 0:
                continue
            point = axis_point(particles, state, env, particle)
            cell_list.origin[env, particle] = point.origin
            cell_list.offset_from_origin[env, particle] = point.offset
            if wp.static(has_capsules):
                cell_list.axis[env, particle] = point.axis
            position = to_float64(point.origin) + to_float64(point.offset)
            size = wp.float64(particles.settings[env, 0].cell)
            cell = wp.vec3i(
                cell_along(position[0], size), cell_along(position[1], size), cell_along(position[2], size)
            )
            cell_list.cell[env, particle] = cell
            cell_list.link[env, particle] = wp.atomic_exch(cell_list.head, env, bucket_of(cell, buckets), particle)
            if particle == 0:
                cell_list.build_count[env] = cell_list.build_count[env] + 1

    return fill_buckets


@functools.cache
def build(traits: ParticleTraits, real: type) -> wp.Kernel:
    """Returns the kernel that collects the neighbors of a particle; items: particles.

    The current lists are not changed.
    """
    t = structs(real)
    State = t.State
    p = particle_structs(real)
    geometry = particle_geometry.functions(traits, real)
    axis_point, closest_approach = geometry.axis_point, geometry.closest_approach

    @wp.func
    def insert(cell_list: p.CellList, env: int, start: int, capacity: int, count: int, key: int):
        """Inserts a key into the sorted list; returns the number of keys, including one that did not fit."""
        last = wp.min(count, capacity)
        position = start + last
        key_before = wp.int32(NO_INDEX)
        while position > start:
            key_before = cell_list.key[env, position - 1]
            if key_before <= key:
                break
            position -= 1
        if position > start and key_before == key:
            return count
        if last == capacity:
            return count + 1
        k = start + last
        while k > position:
            cell_list.key[env, k] = cell_list.key[env, k - 1]
            k -= 1
        cell_list.key[env, position] = key
        return count + 1

    @wp.func
    def sort_key(particle: int, neighbor: int, particles: int):
        if owns_pair(particle, neighbor):
            return neighbor
        return neighbor + particles

    @unique_kernel()
    def build_lists(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        buckets: wp.int32,
        state: State,
        particles: p.Particles,
        neighbor_lists: p.NeighborLists,
        pair_records: p.PairRecords,
        cell_list: p.CellList,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            particle = task_item(launch, task)
            if status[env] != ENV_ACTIVE or cell_list.stale[env] == 0:
                continue
            own_point = axis_point(particles, state, env, particle)
            cell = cell_list.cell[env, particle]
            kind = particles.kind[particle]
            body = particles.body[particle]
            reach = particles.radius[env, particle] + particles.settings[env, 0].skin
            start = particles.entry_start[particle]
            capacity = particles.entry_start[particle + 1] - start
            count = wp.int32(0)
            for number in range(27):
                wanted = wp.vec3i(
                    (cell[0] + number % 3 - 1) & wp.static(CELL_RANGE - 1),
                    (cell[1] + (number // 3) % 3 - 1) & wp.static(CELL_RANGE - 1),
                    (cell[2] + number // 9 - 1) & wp.static(CELL_RANGE - 1),
                )
                other_particle = cell_list.head[env, bucket_of(wanted, buckets)]
                while other_particle != NO_INDEX:
                    cell_2 = cell_list.cell[env, other_particle]
                    if cell_2[0] == wanted[0] and cell_2[1] == wanted[1] and cell_2[2] == wanted[2]:
                        if other_particle != particle and particles.body[other_particle] != body:
                            if particles.allowed[kind, particles.kind[other_particle]] != 0:
                                pair = closest_approach(
                                    own_point, axis_point(particles, state, env, other_particle)
                                )
                                if wp.length(pair.separation) < reach + particles.radius[env, other_particle]:
                                    key = sort_key(particle, other_particle, launch.items)
                                    count = insert(cell_list, env, start, capacity, count, key)
                    other_particle = cell_list.link[env, other_particle]
            # Pairs with history stay at any distance: this may be a trial state that is not accepted.
            first_slot = particles.slot_start[particle]
            for k in range(neighbor_lists.count[env, particle]):
                slot = first_slot + k
                if k >= neighbor_lists.owned[env, particle]:
                    slot = neighbor_lists.slot[env, start + k]
                if slot >= 0:
                    if (pair_records.flags[env, slot] & WAS_IN_CONTACT) != 0:
                        key = sort_key(particle, neighbor_lists.neighbor[env, start + k], launch.items)
                        count = insert(cell_list, env, start, capacity, count, key)
            count_that_fit = wp.min(count, capacity)
            excess = count - count_that_fit
            owned = wp.int32(0)
            for k in range(count_that_fit):
                if cell_list.key[env, start + k] < launch.items:
                    owned += 1
            records = particles.slot_start[particle + 1] - first_slot
            excess = wp.max(excess, owned - records)
            cell_list.key_count[env, particle] = count_that_fit
            if excess > 0:
                wp.atomic_max(cell_list.overflow, env, excess)

    return build_lists


@functools.cache
def transfer_history(parts: ContactModel, real: type) -> wp.Kernel:
    """Returns the kernel that activates the new lists and moves the history of pairs; items: particles."""
    p = particle_structs(real)
    _, Memory = group_structs(parts, real)
    copy = copy_memory(parts, real)

    @unique_kernel()
    def transfer_pair_history(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        particles: p.Particles,
        neighbor_lists: p.NeighborLists,
        pair_records: p.PairRecords,
        cell_list: p.CellList,
        history_out: Memory,
        memory: Memory,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            particle = task_item(launch, task)
            if status[env] != ENV_ACTIVE or cell_list.stale[env] == 0:
                continue
            start = particles.entry_start[particle]
            first = particles.slot_start[particle]
            count = cell_list.key_count[env, particle]
            old_count = neighbor_lists.owned[env, particle]
            records = particles.slot_start[particle + 1] - first
            owned = wp.int32(0)
            old = wp.int32(0)
            # Old and new lists share their records, so arrays that the force stage overwrites hold the history
            # meanwhile.
            for k in range(count):
                key = cell_list.key[env, start + k]
                if key >= launch.items or owned == records:
                    break
                owned += 1
                while old < old_count:
                    if neighbor_lists.neighbor[env, start + old] >= key:
                        break
                    old += 1
                speed = real(-1.0)
                if old < old_count:
                    if neighbor_lists.neighbor[env, start + old] == key:
                        if (pair_records.flags[env, first + old] & WAS_IN_CONTACT) != 0:
                            speed = pair_records.entry_speed[env, first + old]
                            copy(memory, first + old, history_out, first + k, env)
                pair_records.approach_speed[env, first + k] = speed
            flags = wp.int32(0)
            for k in range(owned):
                speed = pair_records.approach_speed[env, first + k]
                pair_records.flags[env, first + k] = 0
                if speed >= real(0.0):
                    flags = WAS_IN_CONTACT
                    pair_records.flags[env, first + k] = WAS_IN_CONTACT
                    pair_records.entry_speed[env, first + k] = speed
                    copy(history_out, first + k, memory, first + k, env)
            for k in range(count):
                key = cell_list.key[env, start + k]
                neighbor_lists.neighbor[env, start + k] = wp.where(key < launch.items, key, key - launch.items)
            pair_records.particle_flags[env, particle] = flags
            neighbor_lists.owned[env, particle] = owned
            neighbor_lists.count[env, particle] = count

    return transfer_pair_history


@functools.cache
def transfer_impulses(real: type) -> wp.Kernel:
    """Returns the kernel that moves the stored impulses of nonsmooth pairs, before the new lists are active.

    Items: particles. Both lists are sorted. Moving first the records whose index decreases, in ascending order,
    and then those whose index increases, in descending order, overwrites no record that is still to be moved.
    """
    p = particle_structs(real)
    StoredImpulses = record_structs(real).StoredImpulses

    @wp.func
    def clear_impulse(stored: StoredImpulses, env: int, number: int):
        # No step has this stamp.
        stored[env, number].stamp = 0

    @wp.func
    def move(stored: StoredImpulses, env: int, source: int, target: int):
        stored[env, target] = stored[env, source]
        clear_impulse(stored, env, source)

    @unique_kernel()
    def transfer_pair_impulses(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        particles: p.Particles,
        neighbor_lists: p.NeighborLists,
        cell_list: p.CellList,
        first: wp.int32,  # contact index of the first record
        stored: StoredImpulses,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            particle = task_item(launch, task)
            if status[env] != ENV_ACTIVE or cell_list.stale[env] == 0:
                continue
            start = particles.entry_start[particle]
            slot = particles.slot_start[particle]
            number = first + slot
            old_count = neighbor_lists.owned[env, particle]
            capacity = wp.min(cell_list.key_count[env, particle], particles.slot_start[particle + 1] - slot)
            owned = wp.int32(0)
            old = wp.int32(0)
            while owned < capacity:
                key = cell_list.key[env, start + owned]
                if key >= launch.items:
                    break
                while old < old_count:
                    if neighbor_lists.neighbor[env, start + old] >= key:
                        break
                    clear_impulse(stored, env, number + old)
                    old += 1
                if old < old_count:
                    if neighbor_lists.neighbor[env, start + old] == key:
                        old += 1
                owned += 1
            while old < old_count:
                clear_impulse(stored, env, number + old)
                old += 1

            old = wp.int32(0)
            for new in range(owned):
                key = cell_list.key[env, start + new]
                while old < old_count:
                    if neighbor_lists.neighbor[env, start + old] >= key:
                        break
                    old += 1
                if new < old and old < old_count:
                    if neighbor_lists.neighbor[env, start + old] == key:
                        move(stored, env, number + old, number + new)
            old = old_count - 1
            for position in range(owned):
                new = owned - 1 - position
                key = cell_list.key[env, start + new]
                while old >= 0:
                    if neighbor_lists.neighbor[env, start + old] <= key:
                        break
                    old -= 1
                if old >= 0 and old < new:
                    if neighbor_lists.neighbor[env, start + old] == key:
                        move(stored, env, number + old, number + new)

    return transfer_pair_impulses


@functools.cache
def build_reverse(real: type) -> wp.Kernel:
    """Returns the kernel that finds the records of pairs that a particle does not own; items: particles."""
    p = particle_structs(real)

    @unique_kernel()
    def build_reverse_lists(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        particles: p.Particles,
        neighbor_lists: p.NeighborLists,
        cell_list: p.CellList,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            particle = task_item(launch, task)
            if status[env] != ENV_ACTIVE or cell_list.stale[env] == 0:
                continue
            start = particles.entry_start[particle]
            for k in range(neighbor_lists.owned[env, particle], neighbor_lists.count[env, particle]):
                neighbor = neighbor_lists.neighbor[env, start + k]
                begin = particles.entry_start[neighbor]
                low = wp.int32(0)
                high = neighbor_lists.owned[env, neighbor]
                while low < high:
                    middle = (low + high) // 2
                    if neighbor_lists.neighbor[env, begin + middle] < particle:
                        low = middle + 1
                    else:
                        high = middle
                slot = wp.int32(NO_INDEX)
                if low < neighbor_lists.owned[env, neighbor]:
                    if neighbor_lists.neighbor[env, begin + low] == particle:
                        slot = particles.slot_start[neighbor] + low
                neighbor_lists.slot[env, start + k] = slot

    return build_reverse_lists
