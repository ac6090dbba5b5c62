"""Forces of one group of shape contacts: what each touch does, at the ends of its contact.

A pure function of state and history: nothing here changes them.
"""

import functools

import warp as wp
from warpcontact.kernels import touch
from warpcontact.kernels.smooth.records import Members, Settings, contact_structs
from warpcontact.kernels.touch import Parts, group_structs, touch_structs
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, Work, env_of, item_of, structs, task_count
from warpcontact.kernels.unique import unique_kernel


def looks_at_curvature(parts: Parts) -> bool:
    """Whether law or friction models of these classes look at the curvatures of what touches."""
    return parts.law.needs_curvature or parts.friction.needs_radius or parts.rolls or parts.twists


@functools.cache
def kernel(parts: Parts, real: type, moves: bool = False) -> wp.Kernel:
    """Returns the kernel for the classes of ``parts``; items: contacts side by side of the group.

    With ``moves``, bodies that are not free oppose to a force what their motions let them.
    """
    t = structs(real)
    vec3, quat, Model, State, Ends = t.vec3, t.quat, t.Model, t.State, t.Ends
    Smooth = contact_structs(real).Smooth
    Coefficients, Memory = group_structs(parts, real)
    Place = touch_structs(real).Place
    act, forget = touch.functions(parts, real, moves)
    curved, oriented = looks_at_curvature(parts), parts.oriented

    @unique_kernel()
    def smooth_forces(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        remembered: Memory,
        step: wp.array2d(dtype=real),  # [env, 0] what the force acts over [s]; 0: the force of this instant
        first: wp.int32,  # contact
        first_end: wp.int32,
        members: Members,
        settings: wp.array2d(dtype=Settings),
        coefficients: Coefficients,
        smooth: Smooth,
        kept: Memory,
        ends: Ends,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            contact = first + item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            end = first_end + 2 * contact
            if smooth.status[env, contact] != CONTACT:
                smooth.approach_speed[env, contact] = real(0.0)
                smooth.slip_speed[env, contact] = real(0.0)
                smooth.normal_force[env, contact] = real(0.0)
                smooth.friction_force[env, contact] = vec3()
                smooth.torque[env, contact] = vec3()
                for place in range(2):
                    ends.force[env, end + place] = vec3()
                    ends.torque[env, end + place] = vec3()
                forget(kept, env, contact, 1, step[env, 0])
                continue

            own = settings[env, contact]
            touching = Place()
            touching.body_1 = members.body_a[contact]
            touching.body_2 = members.body_b[contact]
            touching.arm_1 = smooth.arm_a[env, contact]
            touching.arm_2 = smooth.arm_b[env, contact]
            touching.normal = smooth.normal[env, contact]
            touching.penetration = smooth.penetration[env, contact]
            if wp.static(curved):
                touching.radius = smooth.radius[env, contact]
                touching.curvature_1 = smooth.curvature_1[env, contact]
                touching.curvature_2 = smooth.curvature_2[env, contact]
            q_WS = quat()
            if wp.static(oriented):
                q_WS = smooth.orientation[env, contact]
            acts = act(
                model, state, env, touching, smooth.entry_speed[env, contact], step[env, 0], coefficients,
                remembered, kept, contact, real(own.torsion_radius), q_WS,
            )  # fmt: skip

            # After the formulas: what is springy or viscous in them is shared like what is in proportion to N.
            force_scale = real(own.force_scale)
            normal_force = force_scale * acts.normal_force
            friction_W = force_scale * acts.friction_force
            torque_W = force_scale * acts.torque
            smooth.approach_speed[env, contact] = acts.approach_speed
            smooth.slip_speed[env, contact] = acts.slip_speed
            smooth.normal_force[env, contact] = normal_force
            smooth.friction_force[env, contact] = friction_W
            smooth.torque[env, contact] = torque_W
            # The same force at the same point K, and the same couple, on both bodies: nothing is left in total.
            force_W = normal_force * touching.normal + friction_W
            ends.force[env, end] = force_W
            ends.torque[env, end] = wp.cross(touching.arm_1, force_W) + torque_W
            ends.force[env, end + 1] = -force_W
            ends.torque[env, end + 1] = -(wp.cross(touching.arm_2, force_W) + torque_W)

    return smooth_forces
