"""What kernels of a pile read and write: its shapes, who is near whom, and the touches.

A pile is shapes that all touch each other. Every shape has a list of the shapes near it, its partners. A pair is
in two lists; one of the two shapes owns it, has it among the first of its list, and keeps its record. Of a pair
the first is the shape with the lower number.
"""

import functools
from types import SimpleNamespace
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.types import structs

# Bits of a record: touches in the state that forces were computed of; did so in the last accepted step.
IN_CONTACT = 1
WAS_IN_CONTACT = 2

#: Partner or slot that there is none of.
NO_INDEX = -1
#: Partners that are looked at before anything is done about them: threads of a GPU wait for all at once. The bits
#: of a number.
BATCH_SIZE = 32


class ParticleTraits(NamedTuple):
    """What kernels of a pile are compiled for.

    Attributes:
        has_offsets: Whether any shape has its middle elsewhere than at the centre of mass of its body.
        has_capsules: Whether any shape is a capsule.
        all_pairs: Whether the lists are those of all pairs, the same in all environments.
    """

    has_offsets: bool
    has_capsules: bool
    all_pairs: bool


@wp.func
def owns_pair(particle: int, other_particle: int):
    """Whether shape ``particle`` owns its pair with ``other_particle``: the lower number of every second pair."""
    return (((particle + other_particle) & 1) == 1) == (particle < other_particle)


@functools.cache
def particle_structs(real: type) -> SimpleNamespace:
    """Returns the structs of a pile for ``real``."""
    vec3 = structs(real).vec3

    @wp.struct
    class ParticleContactSettings:
        kappa: real  # contact point K = S + kappa (D − S) [-]
        max_depth: real  # deepest penetration that still counts as contact [m]
        torsion_radius: real  # arm at which torsion acts [m]; < 0: that of the overlap
        force_scale: real  # factor on forces and couples [-]
        closed: real  # gap below which there is contact [m]: 0, or the tolerance of nonsmooth contact
        skin: real  # shapes closer than this are partners [m]
        cell: real  # edge of a cell: no two shapes that are partners are farther apart [m]
        enabled: wp.int32  # 0 or 1

    @wp.struct
    class Particles:
        body: wp.array(dtype=wp.int32)  # [particle] that it is fixed to
        kind: wp.array(dtype=wp.int32)  # [particle] row of ``allowed``
        allowed: wp.array2d(dtype=wp.int32)  # [kind, kind] whether they touch
        offset: wp.array2d(dtype=vec3)  # [env, particle] its middle, B [m]
        axis: wp.array2d(dtype=vec3)  # [env, particle] from there to the middle of an end, B [m]; 0: a sphere
        radius: wp.array2d(dtype=real)  # [env, particle] [m]
        settings: wp.array2d(dtype=ParticleContactSettings)  # [env, 0]
        entry_start: wp.array(dtype=wp.int32)  # [shape + 1] first entry of its list
        slot_start: wp.array(dtype=wp.int32)  # [shape + 1] first of the records that it owns
        particle_of_body: wp.array(dtype=wp.int32)  # [body] its shape, if no body has several; NONE: none
        owner_body: wp.array(dtype=wp.int32)  # [carrier] bodies that have a shape
        owner_start: wp.array(dtype=wp.int32)  # [carrier + 1] first of its shapes in the list
        owner_particle: wp.array(dtype=wp.int32)  # shapes by body

    @wp.struct
    class NeighborLists:
        """A cache: it changes no result. What a shape owns comes first, both parts in the order of partners."""

        owned: wp.array2d(dtype=wp.int32)  # [env, particle] how many partners it owns
        count: wp.array2d(dtype=wp.int32)  # [env, particle] how many it has
        neighbor: wp.array2d(dtype=wp.int32)  # [env, entry]
        slot: wp.array2d(dtype=wp.int32)  # [env, entry] record of the pair; NONE: it did not fit

    @wp.struct
    class PairRecords:
        """Records of pairs; of those that do not touch only the bits tell anything.

        First what every step reads and writes: a GPU fetches and keeps 32 bytes at once.
        """

        entry_speed: wp.array2d(dtype=real)  # [env, slot] as of the history, if TOUCHED [m/s]
        approach_speed: wp.array2d(dtype=real)  # [env, slot] dδ/dt at K [m/s]
        force: wp.array2d(dtype=vec3)  # [env, slot] on the first, W [N]
        torque: wp.array2d(dtype=vec3)  # [env, slot] on it, about its centre of mass, W [N·m]
        gap: wp.array2d(dtype=real)  # [env, slot] [m]
        normal_force: wp.array2d(dtype=real)  # [env, slot] [N]
        normal: wp.array2d(dtype=vec3)  # [env, slot] out of the second, towards the first, W
        arm: wp.array2d(dtype=vec3)  # [env, slot] to K from the centre of mass of the first, W [m]
        flags: wp.array2d(dtype=wp.int32)  # [env, slot] TOUCHES, TOUCHED
        particle_flags: wp.array2d(dtype=wp.int32)  # [env, particle] whether any bits are set of what it owns

    @wp.struct
    class CellList:
        """What lists are made with."""

        stale: wp.array(dtype=wp.int32)  # [env] whether they are to be made anew
        valid: wp.array(dtype=wp.int32)  # [env] whether there are any
        build_count: wp.array(dtype=wp.int32)  # [env] how often they were made since reset
        overflow: wp.array(dtype=wp.int32)  # [env] by how many entries a list was too short, at most
        origin: wp.array2d(dtype=vec3)  # [env, particle] where it was when they were made, in two parts, W [m]
        offset_from_origin: wp.array2d(dtype=vec3)  # [env, particle]
        axis: wp.array2d(dtype=vec3)  # [env, particle] likewise, W [m]
        cell: wp.array2d(dtype=wp.vec3i)  # [env, particle] that it was in
        head: wp.array2d(dtype=wp.int32)  # [env, bucket] a shape in it
        link: wp.array2d(dtype=wp.int32)  # [env, particle] another in the same bucket
        key: wp.array2d(dtype=wp.int32)  # [env, entry] partner, more by the number of shapes if not owned
        key_count: wp.array2d(dtype=wp.int32)  # [env, particle] how many

    return SimpleNamespace(
        ParticleContactSettings=ParticleContactSettings,
        Particles=Particles,
        NeighborLists=NeighborLists,
        PairRecords=PairRecords,
        CellList=CellList,
    )


@functools.cache
def records_with_flags(real: type) -> wp.Function:
    """Returns the device function that finds the records that have any of some bits set, among a few."""
    PairRecords = particle_structs(real).PairRecords

    @wp.func
    def records_with_flags(pair_records: PairRecords, env: int, first: int, count: int, mask: int):
        """Those of ``count`` records from ``first`` on, at most ``BATCH_SIZE``, as bits by their places."""
        selected = wp.int32(0)
        for k in range(count):
            if (pair_records.flags[env, first + k] & mask) != 0:
                selected = selected | (1 << k)
        return selected

    return records_with_flags
