"""The mechanics of one touch: from depth and velocities, through law, friction, rolling and torsion, to forces.

Whatever found the touch, a point on a mesh, two smooth shapes or two spheres of many, it is computed here.
"""

import functools
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.catalogue import history_variables
from warpcontact.kernels.catalogue.device_model import Formula, coefficient_struct, named_struct
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.joints import bodies
from warpcontact.kernels.laws import pull_off
from warpcontact.kernels.types import FREE, structs


class ContactModel(NamedTuple):
    """The formulas of a contact, as classes: what kernels are compiled from."""

    law: type[Formula]
    friction: type[Formula] = Frictionless
    rolling: type[Formula] = Frictionless
    torsion: type[Formula] = Frictionless

    @property
    def needs_surface_axes(self) -> bool:
        """Whether any of them has directions that turn with what is touched."""
        return self.directional or any(part.memories for part in self)

    @property
    def directional(self) -> bool:
        """Whether any of them tells directions in the tangent plane apart."""
        return self.friction.directional or self.rolling.directional

    @property
    def has_rolling(self) -> bool:
        """Whether anything opposes rolling."""
        return self.rolling is not Frictionless

    @property
    def has_torsion(self) -> bool:
        """Whether anything opposes spinning about the normal."""
        return self.torsion is not Frictionless


def group_structs(contact_model: ContactModel, real: type) -> tuple[Any, Any]:
    """Returns the structs of arrays [env, contact of the group]: coefficients and memory of every part."""

    def struct(name: str, dtype_of: Callable[[type[Formula], type], Any]) -> Any:
        elements = [(part, dtype_of(formula, real)) for part, formula in contact_model._asdict().items()]
        return array_struct(name, tuple(elements))

    return struct("Coefficients", coefficient_struct), struct("MaterialHistory", history_variables.memory_struct)


@functools.cache
def array_struct(name: str, elements: tuple[tuple[str, Any], ...]) -> Any:
    """Returns the struct of arrays [env, item] of these elements (name, Warp type)."""
    return named_struct(name, tuple((part, wp.array2d(dtype=dtype)) for part, dtype in elements))


@functools.cache
def kinematics_structs(real: type) -> SimpleNamespace:
    """Returns what goes into a touch and what comes out of it."""
    vec3 = structs(real).vec3

    @wp.struct
    class ContactKinematics:
        """Where two bodies touch, at a point K; normals point from the second to the first."""

        body_1: wp.int32  # or WORLD
        body_2: wp.int32
        arm_1: vec3  # to K from the centre of mass, W [m]
        arm_2: vec3
        normal: vec3  # unit, W
        penetration: real  # > 0 [m]
        radius: real  # of the rolling body, and of a patch of contact √(radius × penetration) [m]
        # Relative principal curvatures, the smaller first; only for laws with needs_curvature
        curvature_1: real  # [1/m]
        curvature_2: real  # [1/m]

    @wp.struct
    class ContactForce:
        """What the second body does to the first; nothing while they do not touch."""

        approach_speed: real  # dδ/dt at K [m/s]
        slip_speed: real  # tangential, at K [m/s]
        normal_force: real  # [N]
        friction_force: vec3  # W [N]
        torque: vec3  # couple of rolling and torsion, W [N·m]

    return SimpleNamespace(ContactKinematics=ContactKinematics, ContactForce=ContactForce)


class Functions(NamedTuple):
    """Device functions of one group of contacts."""

    #: ``(model, state, env, place, entry_speed, dt, coefficients, remembered, kept, member, torsion_radius,
    #: q_WS)``: what acts there. ``entry_speed`` is that of the history, < 0 if the contact begins;
    #: ``torsion_radius`` < 0: that of the overlap under the pressure of Hertz; ``q_WS`` turns the axes of what is
    #: touched to W, and is only looked at if the parts are ``needs_surface_axes``.
    evaluate_contact: wp.Function
    #: ``(kept, env, member, armed, dt)``: empties the memory of a contact that does not touch. Was it never on the
    #: outer side (``armed`` 0), it will begin where it is put, or enabled.
    clear_history: wp.Function


@functools.cache
def functions(contact_model: ContactModel, real: type, has_joints: bool = False) -> Functions:
    """Returns the device functions for the classes of ``contact_model``.

    With ``has_joints``, bodies that are not free oppose to a force what their motions let them.
    """
    t = structs(real)
    vec3, quat, Model, State, NormalState, TangentialState = (
        t.vec3,
        t.quat,
        t.Model,
        t.State,
        t.NormalState,
        t.TangentialState,
    )
    ContactKinematics, ContactForce = (
        kinematics_structs(real).ContactKinematics,
        kinematics_structs(real).ContactForce,
    )
    Coefficients, MaterialHistory = group_structs(contact_model, real)
    law_force, law_start_force, clear_law_history = history_variables.functions(contact_model.law, real)
    friction_force, _, clear_friction_history = history_variables.functions(contact_model.friction, real)
    rolling_force, _, clear_rolling_history = history_variables.functions(contact_model.rolling, real)
    torsion_force, _, clear_torsion_history = history_variables.functions(
        contact_model.torsion, real, along_normal=True
    )
    needs_mass, needs_curvature = contact_model.law.needs_mass, contact_model.law.needs_curvature
    pulls = contact_model.law.pulls
    tension_of = pull_off.function(contact_model.law, real) if pulls else None
    has_rolling, has_torsion, directional = (
        contact_model.has_rolling,
        contact_model.has_torsion,
        contact_model.directional,
    )
    lowest = wp.constant(real(-math.inf if contact_model.law.pulls else 0.0))
    # Mean arm of friction under the pressure of Hertz: (3π/16) a.
    hertz_arm = wp.constant(real(3.0 * math.pi / 16.0))
    velocity_at = frames.functions(real).velocity_at
    mobility_of_motion = bodies.functions(real).mobility

    @wp.func
    def mobility(model: Model, state: State, env: int, body: int, arm_W: vec3, n_W: vec3):
        """Inverse of the mass that ``body`` opposes to a force along ``n_W`` at ``arm_W``; 0 for the world."""
        if body < 0:
            return real(0.0)
        if wp.static(has_joints):
            motion = model.body_motion[env, body]
            if motion.kind != FREE:
                return mobility_of_motion(model, state, env, body, motion, arm_W, n_W)
        lever_W = wp.cross(arm_W, n_W)
        inverse_B = model.body_inverse_inertia[env, body]
        angular_mobility = inverse_B[0, 0] * wp.length_sq(lever_W)
        if not model.body_isotropic_inertia[env, body]:
            lever_B = wp.quat_rotate_inv(state.body_orientation[env, body], lever_W)
            angular_mobility = wp.dot(lever_B, inverse_B * lever_B)
        return real(1.0) / model.body_mass[env, body] + angular_mobility

    @wp.func
    def angular_velocity(state: State, env: int, body: int):
        if body < 0:
            return vec3()
        return state.body_angular_velocity[env, body]

    @wp.func
    def clip_pull(force: real):
        """A law that does not pull is cut at zero. Not by max, which turns a NaN into 0 and hides it."""
        if force < lowest:
            return lowest
        return force

    @wp.func
    def surface_axis(q_WS: quat, n_W: vec3):
        """The x axis of the surface, laid into the tangent plane; where it is normal to that, the y axis."""
        x_W = wp.quat_rotate(q_WS, vec3(real(1.0), real(0.0), real(0.0)))
        tangent = x_W - wp.dot(x_W, n_W) * n_W
        if wp.length_sq(tangent) < real(1.0e-6):
            y_W = wp.quat_rotate(q_WS, vec3(real(0.0), real(1.0), real(0.0)))
            tangent = y_W - wp.dot(y_W, n_W) * n_W
        return wp.normalize(tangent)

    @wp.func
    def with_velocity(tangential_state: TangentialState, velocity: vec3):
        tangential_state.velocity = velocity
        tangential_state.speed = wp.length(velocity)
        return tangential_state

    @wp.func
    def evaluate_contact(
        model: Model,
        state: State,
        env: int,
        kinematics: ContactKinematics,
        entry_speed: real,
        dt: real,
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        member: int,
        torsion_radius: real,
        q_WS: quat,
    ):
        result = ContactForce()
        n_W = kinematics.normal
        # Of the second relative to the first: approach is positive.
        v_W = velocity_at(state, env, kinematics.body_2, kinematics.arm_2) - velocity_at(
            state, env, kinematics.body_1, kinematics.arm_1
        )
        approach = wp.dot(v_W, n_W)

        normal_state = NormalState()
        normal_state.delta = kinematics.penetration
        normal_state.delta_dot = approach
        # A contact that begins here has no entry speed yet; one that reloads faster than it began takes the
        # faster speed. The same rule advances the history, so a trial state sees the same force.
        normal_state.entry_speed = wp.max(wp.max(entry_speed, approach), real(0.0))
        if wp.static(needs_mass):
            normal_state.inverse_mass = mobility(
                model, state, env, kinematics.body_1, kinematics.arm_1, n_W
            ) + mobility(model, state, env, kinematics.body_2, kinematics.arm_2, n_W)
            normal_state.mass = real(1.0) / normal_state.inverse_mass
        if wp.static(needs_curvature):
            normal_state.curvature_1 = kinematics.curvature_1
            normal_state.curvature_2 = kinematics.curvature_2
        normal_state.dt = dt
        is_new = entry_speed < real(0.0)
        # What begins since the last step has not moved for longer than it took to come this deep.
        max_elapsed = real(math.inf)
        if is_new and approach > real(0.0):
            max_elapsed = normal_state.delta / approach
        p = coefficients.law[env, member]
        normal_force = clip_pull(
            law_force(history_in.law, history_out.law, env, member, p, normal_state, max_elapsed, dt, q_WS, n_W)
        )
        tension = real(0.0)
        if wp.static(pulls):
            # Not below 0, and not by max, which hides a NaN.
            tension = tension_of(p, normal_state)
            if tension < real(0.0):
                tension = real(0.0)

        # The force of a step stands for the time from half a step before this state to half a step after: the
        # contact's share of it, when it began since the last state, is δ/(δ̇ dt) + 1/2 steps. A law continuous
        # at touch makes no difference of first order; one that jumps (a dashpot) is given its missing impulse.
        approach_distance = approach * dt
        if is_new and normal_state.delta <= approach_distance * real(1.001):
            step_fraction = wp.min(normal_state.delta / approach_distance, real(1.0))
            normal_state.delta = normal_state.delta * real(1.0e-6)
            normal_force = clip_pull(
                normal_force + (step_fraction - real(0.5)) * clip_pull(law_start_force(p, normal_state))
            )

        tangential_state = TangentialState()
        tangential_state.normal = n_W
        # The load of friction: N, and with a law that pulls the pull-off force as well.
        tangential_state.normal_force = normal_force
        if wp.static(pulls):
            tangential_state.normal_force = normal_force + tension
        if tangential_state.normal_force < real(0.0):
            tangential_state.normal_force = real(0.0)
        tangential_state.patch_radius = wp.sqrt(kinematics.radius * kinematics.penetration)
        if wp.static(directional):
            tangential_state.axis = surface_axis(q_WS, n_W)

        tangential_state = with_velocity(tangential_state, approach * n_W - v_W)
        result.slip_speed = tangential_state.speed
        friction_W = friction_force(
            history_in.friction,
            history_out.friction,
            env,
            member,
            coefficients.friction[env, member],
            tangential_state,
            max_elapsed,
            dt,
            q_WS,
            n_W,
        )

        torque_W = vec3()
        if wp.static(has_rolling or has_torsion):
            w_W = angular_velocity(state, env, kinematics.body_1) - angular_velocity(state, env, kinematics.body_2)
            if wp.static(has_rolling):
                # The velocity at which the point of contact travels, and a couple of the same power.
                tangential_state = with_velocity(tangential_state, kinematics.radius * wp.cross(w_W, n_W))
                rolling_W = rolling_force(
                    history_in.rolling,
                    history_out.rolling,
                    env,
                    member,
                    coefficients.rolling[env, member],
                    tangential_state,
                    max_elapsed,
                    dt,
                    q_WS,
                    n_W,
                )
                torque_W = kinematics.radius * wp.cross(n_W, rolling_W)
            if wp.static(has_torsion):
                arm = torsion_radius
                if torsion_radius < real(0.0):
                    arm = hertz_arm * tangential_state.patch_radius
                tangential_state = with_velocity(tangential_state, (arm * wp.dot(w_W, n_W)) * n_W)
                torsion_W = torsion_force(
                    history_in.torsion,
                    history_out.torsion,
                    env,
                    member,
                    coefficients.torsion[env, member],
                    tangential_state,
                    max_elapsed,
                    dt,
                    q_WS,
                    n_W,
                )
                torque_W += arm * torsion_W

        result.approach_speed = approach
        result.normal_force = normal_force
        result.friction_force = friction_W
        result.torque = torque_W
        return result

    @wp.func
    def clear_history(history_out: MaterialHistory, env: int, member: int, armed: int, dt: real):
        """Empties the memory: what begins next moved for a step at most if it comes from outside, else not yet."""
        elapsed = wp.where(armed != 0, dt, real(0.0))
        clear_law_history(history_out.law, env, member, elapsed)
        clear_friction_history(history_out.friction, env, member, elapsed)
        clear_rolling_history(history_out.rolling, env, member, elapsed)
        clear_torsion_history(history_out.torsion, env, member, elapsed)

    return Functions(evaluate_contact, clear_history)
