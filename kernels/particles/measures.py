"""Kernels that evaluate the sensors of particle contact."""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.particles.base import IN_CONTACT, particle_structs
from warpcontact.kernels.types import structs


@functools.cache
def measured(real: type):
    """Returns the struct of the result arrays."""
    vec3 = structs(real).vec3

    @wp.struct
    class Measured:
        contacts: wp.array(dtype=wp.int32)  # [env] pairs in contact
        normal_force: wp.array(dtype=wp.float64)  # [env] sum of their normal forces [N]
        max_penetration: wp.array(dtype=real)  # [env] [m]
        max_normal_force: wp.array(dtype=real)  # [env] [N]
        coordination: wp.array2d(dtype=wp.int32)  # [env, particle] number of particles in contact with it
        force: wp.array2d(dtype=vec3)  # [env, particle] contact force on it, W [N]

    return Measured


@functools.cache
def particles(real: type) -> wp.Kernel:
    """Returns the kernel that evaluates each particle. Launch with dim (env, particle)."""
    vec3 = structs(real).vec3
    p = particle_structs(real)
    Measured = measured(real)

    @unique_kernel()
    def measure_particles(
        particles: p.Particles, neighbor_lists: p.NeighborLists, pair_records: p.PairRecords, measured: Measured
    ):
        env, particle = wp.tid()
        start = particles.entry_start[particle]
        owned = neighbor_lists.owned[env, particle]
        count = wp.int32(0)
        force = vec3()
        for k in range(neighbor_lists.count[env, particle]):
            slot = particles.slot_start[particle] + k
            if k >= owned:
                slot = neighbor_lists.slot[env, start + k]
            if slot >= 0:
                if (pair_records.flags[env, slot] & IN_CONTACT) != 0:
                    count += 1
                    if particle < neighbor_lists.neighbor[env, start + k]:
                        force += pair_records.force[env, slot]
                    else:
                        force -= pair_records.force[env, slot]
        measured.coordination[env, particle] = count
        measured.force[env, particle] = force

    return measure_particles


@functools.cache
def totals(real: type) -> wp.Kernel:
    """Returns the kernel that evaluates totals of an environment, in the order of records. Launch with dim env."""
    p = particle_structs(real)
    Measured = measured(real)

    @unique_kernel()
    def measure_totals(
        count: wp.int32,
        particles: p.Particles,
        neighbor_lists: p.NeighborLists,
        pair_records: p.PairRecords,
        measured: Measured,
    ):
        env = wp.tid()
        contacts = wp.int32(0)
        total = wp.float64(0.0)
        deepest = real(0.0)
        strongest = real(0.0)
        for particle in range(count):
            first = particles.slot_start[particle]
            for slot in range(first, first + neighbor_lists.owned[env, particle]):
                if (pair_records.flags[env, slot] & IN_CONTACT) != 0:
                    contacts += 1
                    total += wp.float64(pair_records.normal_force[env, slot])
                    deepest = wp.max(deepest, -pair_records.gap[env, slot])
                    strongest = wp.max(strongest, pair_records.normal_force[env, slot])
        measured.contacts[env] = contacts
        measured.normal_force[env] = total
        measured.max_penetration[env] = deepest
        measured.max_normal_force[env] = strongest

    return measure_totals
