"""Force and torque of one contact, from its kinematics, the normal law and the friction models.

Used by point contact on meshes, shape contact and particle contact.
"""

import functools
import math
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.catalogue import history_variables
from warpcontact.kernels.catalogue.device_model import Formula, coefficient_struct, named_struct
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.joints import bodies
from warpcontact.kernels.laws import pull_off
from warpcontact.kernels.types import FREE, Struct, structs


class ContactModel(NamedTuple):
    """Classes of the models of a contact, for which kernels are compiled."""

    law: type[Formula]
    friction: type[Formula] = Frictionless
    rolling: type[Formula] = Frictionless
    torsion: type[Formula] = Frictionless

    @property
    def needs_surface_axes(self) -> bool:
        """Whether any model needs axes that rotate with the surface."""
        return self.directional or any(part.memories for part in self)

    @property
    def directional(self) -> bool:
        """Whether any friction model depends on the direction in the tangent plane."""
        return self.friction.directional or self.rolling.directional

    @property
    def has_rolling(self) -> bool:
        """Whether there is rolling friction."""
        return self.rolling is not Frictionless

    @property
    def acts_per_patch(self) -> bool:
        """Whether law or friction have history variables, of which body contact has one set per patch."""
        return bool(self.law.memories or self.friction.memories)

    @property
    def has_torsion(self) -> bool:
        """Whether there is torsional friction."""
        return self.torsion is not Frictionless


def history_precision(part: str, formula: type[Formula], real: type, per_patch: bool) -> type:
    """Returns the scalar type of the history variables of a part of a material.

    Springs of patches are in float64: the slip of a step of a body at rest is below the rounding of a stretch in float32, and a
    stretch is rotated in each step, so that bodies would creep.

    Args:
        part: Name of the part.
        formula: Its class.
        real: Precision of the model.
        per_patch: Whether friction acts once per patch of a body contact.
    """
    return wp.float64 if per_patch and part == "friction" and formula.memories else real


def group_structs(contact_model: ContactModel, real: type, per_patch: bool = False) -> tuple[Any, Any]:
    """Returns the structs of arrays [env, contact of the group]: coefficients and history variables.

    ``per_patch``: as for ``history_precision``.
    """
    parts = contact_model._asdict()
    coefficients = [(part, coefficient_struct(formula, real)) for part, formula in parts.items()]
    memories = [
        (part, history_variables.memory_struct(formula, history_precision(part, formula, real, per_patch)))
        for part, formula in parts.items()
    ]
    return array_struct("Coefficients", tuple(coefficients)), array_struct("MaterialHistory", tuple(memories))


@functools.cache
def array_struct(name: str, elements: tuple[tuple[str, Any], ...]) -> Struct:
    """Returns the struct of arrays [env, item] with these elements (name, Warp type)."""
    return named_struct(name, tuple((part, wp.array2d(dtype=dtype)) for part, dtype in elements))


class KinematicsStructs(NamedTuple):
    """Structs of the inputs and outputs of a contact evaluation."""

    ContactKinematics: Struct  # kinematics of a contact at its point K
    ContactForce: Struct  # force of the second body on the first


@functools.cache
def kinematics_structs(real: type) -> KinematicsStructs:
    """Returns the structs of the inputs and outputs of a contact evaluation."""
    vec3 = structs(real).vec3

    @wp.struct
    class ContactKinematics:
        """Kinematics of a contact at its point K; the normal points from the second body to the first."""

        body_1: wp.int32  # or WORLD
        body_2: wp.int32
        arm_1: vec3  # from the center of mass to K, W [m]
        arm_2: vec3
        normal: vec3  # unit, W
        penetration: real  # > 0 [m]
        radius: real  # of the rolling body; the radius of the contact patch is √(radius × penetration) [m]
        # Relative principal curvatures, the smaller first; only for laws with needs_curvature
        curvature_1: real  # [1/m]
        curvature_2: real  # [1/m]

    @wp.struct
    class ContactForce:
        """Force of the second body on the first; zero without contact."""

        approach_speed: real  # dδ/dt at K [m/s]
        slip_speed: real  # tangential, at K [m/s]
        normal_force: real  # [N]
        friction_force: vec3  # W [N]
        torque: vec3  # rolling and torsional friction, W [N·m]

    return KinematicsStructs(ContactKinematics=ContactKinematics, ContactForce=ContactForce)


class Functions(NamedTuple):
    """Device functions of one group of contacts."""

    #: ``(model, state, env, kinematics, entry_speed, dt, coefficients, history_in, history_out, member,
    #: torsion_radius, q_WS)``: returns the contact force. ``entry_speed`` < 0: the contact begins [m/s];
    #: ``torsion_radius`` < 0: mean arm of a Hertz pressure, from the overlap [m]; ``q_WS``: axes of the surface →
    #: W, read only if ``needs_surface_axes``.
    evaluate_contact: wp.Function
    #: ``(p, normal_state, is_new, history_in, history_out, env, member, max_elapsed, dt, q_WS, n_W)``: returns the normal
    #: force of the law; ``p``: its coefficients, ``is_new``: whether the contact begins [N].
    force_of_law: wp.Function
    #: ``(model, state, env, body, arm_W, n_W)``: returns the inverse effective mass of a body along a unit vector at a point;
    #: 0 for the world [1/kg].
    mobility: wp.Function
    #: ``(history_out, env, member, armed, dt)``: clears the history variables of an open contact. A contact that
    #: was never on the outer side (``armed`` 0) starts without slip when it is enabled or placed in overlap.
    clear_history: wp.Function


@functools.cache
def functions(
    contact_model: ContactModel,
    real: type,
    has_joints: bool = False,
    has_friction: bool = True,
    histories: int = 1,
) -> Functions:
    """Returns the device functions for the classes of ``contact_model``.

    Args:
        contact_model: Classes of law and friction models.
        real: Precision.
        has_joints: Whether the mobility of bodies with joints is that of their joint.
        has_friction: Whether friction is computed; otherwise it is zero.
        histories: Number of histories per contact. ``member`` is the index of a history, and member // histories that
            of the coefficients.
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
    Coefficients, MaterialHistory = group_structs(contact_model, real, per_patch=not has_friction)
    LawCoefficients = coefficient_struct(contact_model.law, real)
    LawMemory = wp.array2d(dtype=history_variables.memory_struct(contact_model.law, real))
    law_force, law_start_force, clear_law_history = history_variables.functions(contact_model.law, real)
    friction_force, _, clear_friction_history = history_variables.functions(contact_model.friction, real)
    rolling_force, _, clear_rolling_history = history_variables.functions(contact_model.rolling, real)
    torsion_force, _, clear_torsion_history = history_variables.functions(
        contact_model.torsion, real, vectors="normal"
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
    # Mean arm of friction under a Hertz pressure over radius a: (3π/16) a.
    hertz_arm = wp.constant(real(3.0 * math.pi / 16.0))
    velocity_at = frames.functions(real).velocity_at
    mobility_of_motion = bodies.functions(real).mobility

    @wp.func
    def mobility(model: Model, state: State, env: int, body: int, arm_W: vec3, n_W: vec3):
        """Returns the inverse effective mass of ``body`` along ``n_W`` at ``arm_W`` [1/kg]; world: 0."""
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
        """Clips the force of a law without adhesion at zero. Not with max, which would turn NaN into 0."""
        if force < lowest:
            return lowest
        return force

    @wp.func
    def surface_axis(q_WS: quat, n_W: vec3):
        """Returns the x axis of the surface in the tangent plane, or the y axis if x is normal to it."""
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
    def force_of_law(
        p: LawCoefficients,
        normal_state: NormalState,
        is_new: bool,
        history_in: LawMemory,
        history_out: LawMemory,
        env: int,
        member: int,
        max_elapsed: real,
        dt: real,
        q_WS: quat,
        n_W: vec3,
    ):
        """Returns the normal force of the law [N]."""
        force = clip_pull(
            law_force(history_in, history_out, env, member, p, normal_state, max_elapsed, dt, q_WS, n_W)
        )
        # The force of a step acts from half a step before this state to half a step after. If the contact began
        # since the last state, its part of that interval is δ/(δ̇ dt) + 1/2 steps. For a law that is continuous at
        # δ = 0 the correction is of higher order; a law with a jump (dashpot) gets its missing impulse.
        approach_distance = normal_state.delta_dot * dt
        if is_new and normal_state.delta <= approach_distance * real(1.001):
            step_fraction = wp.min(normal_state.delta / approach_distance, real(1.0))
            normal_state.delta = normal_state.delta * real(1.0e-6)
            force = clip_pull(force + (step_fraction - real(0.5)) * clip_pull(law_start_force(p, normal_state)))
        return force

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
        item = member
        if wp.static(histories > 1):
            item = member // wp.static(histories)
        n_W = kinematics.normal
        # Velocity of the second body relative to the first: positive in approach.
        v_W = velocity_at(state, env, kinematics.body_2, kinematics.arm_2) - velocity_at(
            state, env, kinematics.body_1, kinematics.arm_1
        )
        approach = wp.dot(v_W, n_W)

        normal_state = NormalState()
        normal_state.delta = kinematics.penetration
        normal_state.delta_dot = approach
        # A new contact has no entry speed yet; a contact that reloads faster than it began takes the higher speed.
        # The same rule advances the history, so trial states get the same force.
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
        # A new contact cannot have slipped for longer than it took to reach this penetration.
        max_elapsed = real(math.inf)
        if is_new and approach > real(0.0):
            max_elapsed = normal_state.delta / approach
        p = coefficients.law[env, item]
        normal_force = force_of_law(
            p, normal_state, is_new, history_in.law, history_out.law, env, member, max_elapsed, dt, q_WS, n_W
        )
        tension = real(0.0)
        if wp.static(pulls):
            # Clipped at 0 with a comparison; max would turn NaN into 0.
            tension = tension_of(p, normal_state)
            if tension < real(0.0):
                tension = real(0.0)

        tangential_state = TangentialState()
        tangential_state.normal = n_W
        # Load of friction: N, plus the pull-off force for a law with adhesion.
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
        friction_W = vec3()
        if wp.static(has_friction):
            friction_W = friction_force(
                history_in.friction,
                history_out.friction,
                env,
                member,
                coefficients.friction[env, item],
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
                # Rolling velocity of the contact point, and the torque of equal power.
                tangential_state = with_velocity(tangential_state, kinematics.radius * wp.cross(w_W, n_W))
                rolling_W = rolling_force(
                    history_in.rolling,
                    history_out.rolling,
                    env,
                    member,
                    coefficients.rolling[env, item],
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
                    coefficients.torsion[env, item],
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
        """Clears the history: a contact from the outer side may slip over one step at its start, others not."""
        elapsed = wp.where(armed != 0, dt, real(0.0))
        clear_law_history(history_out.law, env, member, elapsed)
        clear_friction_history(history_out.friction, env, member, elapsed)
        clear_rolling_history(history_out.rolling, env, member, elapsed)
        clear_torsion_history(history_out.torsion, env, member, elapsed)

    return Functions(evaluate_contact, force_of_law, mobility, clear_history)
