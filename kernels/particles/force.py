"""Contact forces of particles: evaluates the pairs that each particle owns.

The distance test comes first, with little memory traffic; forces are computed by ``contact_evaluation.py``. A pure
function of model, state and history: listed pairs without contact do not change the result.
"""

import functools

import warp as wp
from warpcontact.kernels.catalogue.history_variables import memory_struct
from warpcontact.kernels.contact import contact_evaluation
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs, kinematics_structs
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.particles import particle_geometry
from warpcontact.kernels.particles.base import (
    IN_CONTACT,
    NO_INDEX,
    WAS_IN_CONTACT,
    ParticleTraits,
    particle_structs,
)
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, structs, task_count, task_env, task_item


@functools.cache
def _start_memory(parts: ContactModel, real: type) -> wp.Function:
    """Returns ``(memory, env, slot, dt)``, which clears the history of a pair that was not in contact."""
    _, Memory = group_structs(parts, real)
    law, friction, rolling, torsion = (bool(part.memories) for part in parts)
    LawMemory, FrictionMemory = memory_struct(parts.law, real), memory_struct(parts.friction, real)
    RollingMemory, TorsionMemory = memory_struct(parts.rolling, real), memory_struct(parts.torsion, real)

    @wp.func
    def start_memory(memory: Memory, env: int, slot: int, dt: real):
        if wp.static(law):
            of_law = LawMemory()
            of_law.elapsed = dt
            memory.law[env, slot] = of_law
        if wp.static(friction):
            of_friction = FrictionMemory()
            of_friction.elapsed = dt
            memory.friction[env, slot] = of_friction
        if wp.static(rolling):
            of_rolling = RollingMemory()
            of_rolling.elapsed = dt
            memory.rolling[env, slot] = of_rolling
        if wp.static(torsion):
            of_torsion = TorsionMemory()
            of_torsion.elapsed = dt
            memory.torsion[env, slot] = of_torsion

    return start_memory


@functools.cache
def kernel(
    parts: ContactModel,
    traits: ParticleTraits,
    real: type,
    has_joints: bool,
    single_thread: bool,
    nonsmooth: bool = False,
) -> wp.Kernel:
    """Returns the force kernel for the pairs that a particle owns; items: particles.

    Args:
        parts: Classes of law and friction models.
        traits: Properties of the particles.
        real: Precision.
        has_joints: Whether the effective mass accounts for joints of bodies.
        single_thread: Whether one thread processes all particles of an environment in order. It then adds forces
            to the wrenches itself; otherwise ``sums.add`` does.
        nonsmooth: Whether contacts are only located, without forces. Contacts of the last step that have opened
            are located, too, because their impulses are reported.
    """
    t = structs(real)
    vec3, quat, Model, State, Wrenches = t.vec3, t.quat, t.Model, t.State, t.Wrenches
    p = particle_structs(real)
    Coefficients, Memory = group_structs(parts, real)
    ContactKinematics = kinematics_structs(real).ContactKinematics
    evaluate_contact = contact_evaluation.functions(parts, real, has_joints).evaluate_contact
    start_memory = _start_memory(parts, real)
    geometry = particle_geometry.functions(traits, real)
    AxisPoint, ClosestApproach, axis_point, closest_approach = (
        geometry.AxisPoint,
        geometry.ClosestApproach,
        geometry.axis_point,
        geometry.closest_approach,
    )
    has_offsets, has_capsules, all_pairs, oriented = (
        traits.has_offsets,
        traits.has_capsules,
        traits.all_pairs,
        parts.needs_surface_axes,
    )
    curvatures, needs_curvature = geometry.curvatures, parts.law.needs_curvature
    remembers = any(part.memories for part in parts)

    @wp.func
    def kinematics_of(
        state: State,
        particles: p.Particles,
        settings: p.ParticleContactSettings,
        env: int,
        first: int,
        second: int,
        axis_point_1: AxisPoint,
        axis_point_2: AxisPoint,
        pair: ClosestApproach,
        distance: real,
        radius_1: real,
        radius_2: real,
    ):
        """Returns the contact kinematics of two particles."""
        n_W = vec3(real(0.0), real(0.0), real(1.0))
        if distance > real(0.0):
            n_W = (real(1.0) / distance) * pair.separation
        gap = distance - radius_1 - radius_2
        kinematics = ContactKinematics()
        kinematics.body_1 = assume_nonnegative(particles.body[first])
        kinematics.body_2 = assume_nonnegative(particles.body[second])
        # S on the second, D on the first; K between them.
        kinematics.arm_1 = (-(radius_1 + (real(1.0) - settings.kappa) * gap)) * n_W
        kinematics.arm_2 = (radius_2 + settings.kappa * gap) * n_W
        if wp.static(has_offsets):
            kinematics.arm_1 += axis_point_1.offset - state.body_position_remainder[env, kinematics.body_1]
            kinematics.arm_2 += axis_point_2.offset - state.body_position_remainder[env, kinematics.body_2]
        if wp.static(has_capsules):
            kinematics.arm_1 += pair.s * axis_point_1.axis
            kinematics.arm_2 += pair.t * axis_point_2.axis
        kinematics.normal = n_W
        kinematics.penetration = -gap
        kinematics.radius = radius_1 * radius_2 / (radius_1 + radius_2)
        if wp.static(needs_curvature):
            smaller, larger = curvatures(pair, axis_point_1, axis_point_2, radius_1, radius_2)
            kinematics.curvature_1 = smaller
            kinematics.curvature_2 = larger
        return kinematics

    @wp.func
    def record_geometry(kinematics: ContactKinematics, pair_records: p.PairRecords, env: int, slot: int):
        """Writes gap, normal and arm to the record of the pair."""
        pair_records.gap[env, slot] = -kinematics.penetration
        pair_records.normal[env, slot] = kinematics.normal
        pair_records.arm[env, slot] = kinematics.arm_1

    @wp.func
    def evaluate_pair(
        model: Model,
        state: State,
        kinematics: ContactKinematics,
        settings: p.ParticleContactSettings,
        pair_records: p.PairRecords,
        coefficients: Coefficients,
        history_in: Memory,
        history_out: Memory,
        dt: real,
        env: int,
        slot: int,
        flags: int,
        write_outputs: bool,
        wrenches: Wrenches,
    ):
        """Evaluates a contact; writes its record if ``write_outputs`` or needed for the sums."""
        entry_speed = real(-1.0)
        if (flags & WAS_IN_CONTACT) != 0:
            entry_speed = pair_records.entry_speed[env, slot]
        else:
            if wp.static(remembers):
                # Cleared here, not read: a pair that was not in contact has no history, whether it was listed or
                # not.
                start_memory(history_in, env, slot, dt)
        q_WS = quat()
        if wp.static(oriented):
            q_WS = state.body_orientation[env, kinematics.body_2]
        result = evaluate_contact(
            model, state, env, kinematics, entry_speed, dt, coefficients, history_in, history_out, slot,
            settings.torsion_radius, q_WS,
        )  # fmt: skip
        normal_force = settings.force_scale * result.normal_force
        force = normal_force * kinematics.normal + settings.force_scale * result.friction_force
        torque = settings.force_scale * result.torque
        pair_records.approach_speed[env, slot] = result.approach_speed
        if write_outputs:
            pair_records.normal_force[env, slot] = normal_force
            record_geometry(kinematics, pair_records, env, slot)
        if write_outputs or wp.static(not single_thread):
            pair_records.force[env, slot] = force
        torque_1 = wp.cross(kinematics.arm_1, force) + torque
        if wp.static(single_thread):
            body_1 = assume_nonnegative(kinematics.body_1)
            body_2 = assume_nonnegative(kinematics.body_2)
            wrenches.force[env, body_1] = wrenches.force[env, body_1] + force
            wrenches.torque[env, body_1] = wrenches.torque[env, body_1] + torque_1
            wrenches.force[env, body_2] = wrenches.force[env, body_2] - force
            torque_2 = wp.cross(kinematics.arm_2, force) + torque
            wrenches.torque[env, body_2] = wrenches.torque[env, body_2] - torque_2
        else:
            # The torque on the second follows from it (``sums.torque_on_second``).
            pair_records.torque[env, slot] = torque_1

    @unique_kernel()
    def particle_forces(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        particles: p.Particles,
        neighbor_lists: p.NeighborLists,
        cell_list: p.CellList,
        history_in: Memory,
        step: wp.array2d(dtype=real),  # [env, 0] duration over which the force acts [s]; 0: instantaneous force
        coefficients: Coefficients,
        pair_records: p.PairRecords,
        history_out: Memory,
        write_outputs: wp.bool,  # whether to write gap, normal, arm and force of each pair for sensors
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            particle = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            if wp.static(not all_pairs):
                if particle == 0:
                    cell_list.stale[env] = 0
                    cell_list.valid[env] = 1
            owned = neighbor_lists.owned[env, particle]
            if owned == 0:
                continue
            own_point = axis_point(particles, state, env, particle)
            radius = particles.radius[env, particle]
            settings = particles.settings[env, 0]
            entry = assume_nonnegative(particles.entry_start[particle])
            slot = assume_nonnegative(particles.slot_start[particle])
            stop = entry + owned
            old_flags = pair_records.particle_flags[env, particle]
            new_flags = wp.int32(0)
            while entry < stop:
                # Find the next contact, so that the threads of a warp evaluate contacts together.
                selected = wp.bool(False)
                touching = wp.bool(False)
                neighbor = wp.int32(NO_INDEX)
                flags = wp.int32(0)
                first = particle
                axis_point_1 = own_point
                axis_point_2 = own_point
                radius_1 = radius
                radius_2 = radius
                pair = ClosestApproach()
                distance = real(0.0)
                while entry < stop and not selected:
                    neighbor = assume_nonnegative(neighbor_lists.neighbor[env, assume_nonnegative(entry)])
                    radius_2 = particles.radius[env, neighbor]
                    reach = radius + radius_2
                    contact_distance = reach
                    if wp.static(nonsmooth):
                        contact_distance = reach + settings.contact_tolerance
                    axis_point_2 = axis_point(particles, state, env, neighbor)
                    may_touch = wp.bool(True)
                    if wp.static(has_capsules):
                        # First by bounding spheres of capsules, with a margin for rounding.
                        origin_offset = (own_point.origin - axis_point_2.origin) + (
                            own_point.offset - axis_point_2.offset
                        )
                        bounding_distance = real(1.0001) * (
                            reach + wp.length(own_point.axis) + wp.length(axis_point_2.axis)
                        )
                        may_touch = wp.length_sq(origin_offset) < bounding_distance * bounding_distance
                    if may_touch:
                        pair = closest_approach(own_point, axis_point_2)
                        squared = wp.length_sq(pair.separation)
                        if squared < contact_distance * contact_distance:
                            distance = wp.sqrt(squared)
                            touching = reach - distance <= settings.max_depth and settings.enabled != 0
                            touching = touching and distance < contact_distance
                    if old_flags != 0:
                        flags = pair_records.flags[env, assume_nonnegative(slot)] & WAS_IN_CONTACT
                        new_flags = new_flags | flags
                        if not touching:
                            pair_records.flags[env, assume_nonnegative(slot)] = flags
                    selected = touching
                    if wp.static(nonsmooth):
                        selected = touching or flags != 0
                    entry += 1
                    slot += 1
                if selected:
                    record = assume_nonnegative(slot - 1)
                    if touching:
                        new_flags = new_flags | IN_CONTACT
                        pair_records.flags[env, record] = flags | IN_CONTACT
                    if wp.static(nonsmooth):
                        # An opened contact may have been skipped by the bounding-sphere test.
                        pair = closest_approach(axis_point_1, axis_point_2)
                        distance = wp.length(pair.separation)
                    if neighbor < particle:
                        # The first particle has the lower index, so the result is bitwise independent of the
                        # owner.
                        first = neighbor
                        neighbor = particle
                        axis_point_1 = axis_point_2
                        axis_point_2 = own_point
                        radius_1 = radius_2
                        radius_2 = radius
                        pair = closest_approach(axis_point_1, axis_point_2)
                        distance = wp.length(pair.separation)
                    kinematics = kinematics_of(
                        state, particles, settings, env, first, neighbor, axis_point_1, axis_point_2, pair,
                        distance, radius_1, radius_2,
                    )  # fmt: skip
                    if wp.static(nonsmooth):
                        record_geometry(kinematics, pair_records, env, record)
                        # A compliant law that is switched on later starts at rest.
                        pair_records.approach_speed[env, record] = real(0.0)
                        if wp.static(remembers):
                            if flags == 0:
                                start_memory(history_in, env, record, step[env, 0])
                    else:
                        evaluate_pair(
                            model, state, kinematics, settings, pair_records, coefficients, history_in,
                            history_out, step[env, 0], env, record, flags, write_outputs, wrenches,
                        )  # fmt: skip
            if new_flags != old_flags:
                pair_records.particle_flags[env, particle] = new_flags

    return particle_forces
