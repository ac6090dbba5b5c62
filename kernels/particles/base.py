"""Structs of particle contact: particles, neighbor lists, pair records and cell lists.

A particle is a rigid sphere or capsule fixed to a body. Each particle has a list of its neighbors. A pair is in
the lists of both particles. One of them owns the pair: it has the neighbor in the first part of its list and
stores the record of the pair. The first particle of a pair is the one with the lower index.
"""

import functools
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels.types import Struct, structs

# Flags of a record: in contact in the state of the force evaluation; in contact in the last accepted step.
IN_CONTACT = 1
WAS_IN_CONTACT = 2

#: Value for no neighbor or no record.
NO_INDEX = -1
#: Number of records checked before any is processed, so that the threads of a GPU warp stay together: bits of an
#: int32.
BATCH_SIZE = 32


class ParticleTraits(NamedTuple):
    """Properties that particle kernels are compiled for.

    Attributes:
        has_offsets: Whether the center of any particle differs from the center of mass of its body.
        has_capsules: Whether any particle is a capsule.
        all_pairs: Whether the lists contain all pairs, the same in all environments.
    """

    has_offsets: bool
    has_capsules: bool
    all_pairs: bool


@wp.func
def owns_pair(particle: int, other_particle: int):
    """Returns whether ``particle`` owns its pair with the other one: if their sum is odd, the lower index does."""
    return (((particle + other_particle) & 1) == 1) == (particle < other_particle)


class ParticleStructs(NamedTuple):
    """Structs of particle contact, in one precision."""

    ParticleContactSettings: Struct  # parameters of a particle contact
    Particles: Struct  # the particles
    NeighborLists: Struct  # neighbors per particle
    PairRecords: Struct  # records of pairs
    CellList: Struct  # work arrays for building the lists


@functools.cache
def particle_structs(real: type) -> ParticleStructs:
    """Returns the structs of particle contact for ``real``."""
    vec3 = structs(real).vec3

    @wp.struct
    class ParticleContactSettings:
        kappa: real  # contact point K = S + kappa (D − S), S on the second, D on the first particle [-]
        max_depth: real  # deepest penetration that still counts as contact [m]
        torsion_radius: real  # arm at which torsion acts [m]; < 0: radius of the overlap
        force_scale: real  # factor on forces and couples [-]
        contact_tolerance: real  # gap below which there is contact [m]: 0, or the tolerance of nonsmooth contact
        skin: real  # particles with a smaller gap are neighbors [m]
        cell: real  # edge of a cell, at least the largest center distance of neighbors [m]
        enabled: wp.int32  # 0 or 1

    @wp.struct
    class Particles:
        body: wp.array(dtype=wp.int32)  # [particle] body that carries it
        kind: wp.array(dtype=wp.int32)  # [particle] row of ``allowed``
        allowed: wp.array2d(dtype=wp.int32)  # [kind, kind] whether contact is allowed
        offset: wp.array2d(dtype=vec3)  # [env, particle] its center, B [m]
        axis: wp.array2d(dtype=vec3)  # [env, particle] from there to the center of an end cap, B [m]; 0: a sphere
        radius: wp.array2d(dtype=real)  # [env, particle] [m]
        settings: wp.array2d(dtype=ParticleContactSettings)  # [env, 0]
        entry_start: wp.array(dtype=wp.int32)  # [particle + 1] first entry of its list
        slot_start: wp.array(dtype=wp.int32)  # [particle + 1] first record that it owns
        particle_of_body: wp.array(dtype=wp.int32)  # [body] its particle, if none has several; NO_INDEX: none
        owner_body: wp.array(dtype=wp.int32)  # [owner] bodies that have particles
        owner_start: wp.array(dtype=wp.int32)  # [owner + 1] first of its particles in ``owner_particle``
        owner_particle: wp.array(dtype=wp.int32)  # particles, sorted by body

    @wp.struct
    class NeighborLists:
        """Neighbors per particle, a cache that changes no result: owned pairs first, both parts sorted."""

        owned: wp.array2d(dtype=wp.int32)  # [env, particle] number of owned pairs
        count: wp.array2d(dtype=wp.int32)  # [env, particle] number of neighbors
        neighbor: wp.array2d(dtype=wp.int32)  # [env, entry]
        slot: wp.array2d(dtype=wp.int32)  # [env, entry] record of the pair; NO_INDEX: owner list full

    @wp.struct
    class PairRecords:
        """Records of pairs. Without contact only the flags are valid.

        Fields that every step reads and writes come first: a GPU transfers memory in sectors of 32 bytes.
        """

        entry_speed: wp.array2d(dtype=real)  # [env, slot] speed at entry, if WAS_IN_CONTACT [m/s]
        approach_speed: wp.array2d(dtype=real)  # [env, slot] dδ/dt at K [m/s]
        force: wp.array2d(dtype=vec3)  # [env, slot] on the first particle, W [N]
        torque: wp.array2d(dtype=vec3)  # [env, slot] on the first particle, about its center of mass, W [N·m]
        gap: wp.array2d(dtype=real)  # [env, slot] [m]
        normal_force: wp.array2d(dtype=real)  # [env, slot] [N]
        normal: wp.array2d(dtype=vec3)  # [env, slot] out of the second, towards the first, W
        arm: wp.array2d(dtype=vec3)  # [env, slot] to K from the center of mass of the first, W [m]
        flags: wp.array2d(dtype=wp.int32)  # [env, slot] IN_CONTACT, WAS_IN_CONTACT
        particle_flags: wp.array2d(dtype=wp.int32)  # [env, particle] whether any record that it owns has flags

    @wp.struct
    class CellList:
        """Work arrays for building the lists."""

        stale: wp.array(dtype=wp.int32)  # [env] whether the lists must be rebuilt
        valid: wp.array(dtype=wp.int32)  # [env] whether lists exist
        build_count: wp.array(dtype=wp.int32)  # [env] number of builds since reset
        overflow: wp.array(dtype=wp.int32)  # [env] largest number of entries by which a list was too short
        origin: wp.array2d(dtype=vec3)  # [env, particle] position at the last build, as a sum of two parts, W [m]
        offset_from_origin: wp.array2d(dtype=vec3)  # [env, particle] second part, W [m]
        axis: wp.array2d(dtype=vec3)  # [env, particle] axis at the last build, W [m]
        cell: wp.array2d(dtype=wp.vec3i)  # [env, particle] cell at the last build
        head: wp.array2d(dtype=wp.int32)  # [env, bucket] a particle in it
        link: wp.array2d(dtype=wp.int32)  # [env, particle] another in the same bucket
        key: wp.array2d(dtype=wp.int32)  # [env, entry] neighbor index, plus the number of particles if not owned
        key_count: wp.array2d(dtype=wp.int32)  # [env, particle] number of keys

    return ParticleStructs(
        ParticleContactSettings=ParticleContactSettings,
        Particles=Particles,
        NeighborLists=NeighborLists,
        PairRecords=PairRecords,
        CellList=CellList,
    )


def no_pairs(real: type) -> dict[str, Any]:
    """Returns the arguments of a kernel that can sum the forces of pairs, if there are none: empty structs."""
    t = particle_structs(real)
    return {"particles": t.Particles(), "neighbor_lists": t.NeighborLists(), "pair_records": t.PairRecords()}


@functools.cache
def records_with_flags(real: type) -> wp.Function:
    """Returns the device function that selects the records with any of some flags."""
    PairRecords = particle_structs(real).PairRecords

    @wp.func
    def records_with_flags(pair_records: PairRecords, env: int, first: int, count: int, mask: int):
        """Returns the records with any flag of ``mask`` as bits: ``count`` ≤ ``BATCH_SIZE`` from ``first`` on."""
        selected = wp.int32(0)
        for k in range(count):
            if (pair_records.flags[env, first + k] & mask) != 0:
                selected = selected | (1 << k)
        return selected

    return records_with_flags
