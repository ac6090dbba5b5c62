"""The mechanics of one touch: from depth and velocities, through law, friction, rolling and torsion, to forces.

Whatever found the touch, a point on a mesh, two smooth shapes or two spheres of many, it is computed here.
"""

import functools
import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import warp as wp
from warpcontact.kernels import frames, memory, pull_off
from warpcontact.kernels.formula import Formula, coefficient_struct, named_struct
from warpcontact.kernels.friction import Frictionless
from warpcontact.kernels.motions import bodies
from warpcontact.kernels.types import FREE, structs


class Parts(NamedTuple):
    """The formulas of a contact, as classes: what kernels are compiled from."""

    law: type[Formula]
    friction: type[Formula] = Frictionless
    rolling: type[Formula] = Frictionless
    torsion: type[Formula] = Frictionless

    @property
    def oriented(self) -> bool:
        """Whether any of them has directions that turn with what is touched."""
        return self.directional or any(part.memories for part in self)

    @property
    def directional(self) -> bool:
        """Whether any of them tells directions in the tangent plane apart."""
        return self.friction.directional or self.rolling.directional

    @property
    def rolls(self) -> bool:
        """Whether anything opposes rolling."""
        return self.rolling is not Frictionless

    @property
    def twists(self) -> bool:
        """Whether anything opposes spinning about the normal."""
        return self.torsion is not Frictionless


def group_structs(parts: Parts, real: type) -> tuple[Any, Any]:
    """Returns the structs of arrays [env, contact of the group]: coefficients and memory of every part."""

    def struct(name: str, dtype_of: Callable[[type[Formula], type], Any]) -> Any:
        elements = [(part, dtype_of(formula, real)) for part, formula in parts._asdict().items()]
        return arrays_of(name, tuple(elements))

    return struct("Coefficients", coefficient_struct), struct("Memory", memory.memory_struct)


@functools.cache
def arrays_of(name: str, elements: tuple[tuple[str, Any], ...]) -> Any:
    """Returns the struct of arrays [env, item] of these elements (name, Warp type)."""
    return named_struct(name, tuple((part, wp.array2d(dtype=dtype)) for part, dtype in elements))


@functools.cache
def touch_structs(real: type) -> SimpleNamespace:
    """Returns what goes into a touch and what comes out of it."""
    vec3 = structs(real).vec3

    @wp.struct
    class Place:
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
    class Acts:
        """What the second body does to the first; nothing while they do not touch."""

        approach_speed: real  # dδ/dt at K [m/s]
        slip_speed: real  # tangential, at K [m/s]
        normal_force: real  # [N]
        friction_force: vec3  # W [N]
        torque: vec3  # couple of rolling and torsion, W [N·m]

    return SimpleNamespace(Place=Place, Acts=Acts)


class Functions(NamedTuple):
    """Device functions of one group of contacts."""

    #: ``(model, state, env, place, entry_speed, dt, coefficients, remembered, kept, member, torsion_radius,
    #: q_WS)``: what acts there. ``entry_speed`` is that of the history, < 0 if the contact begins;
    #: ``torsion_radius`` < 0: that of the overlap under the pressure of Hertz; ``q_WS`` turns the axes of what is
    #: touched to W, and is only looked at if the parts are ``oriented``.
    act: wp.Function
    #: ``(kept, env, member, armed, dt)``: empties the memory of a contact that does not touch. Was it never on the
    #: outer side (``armed`` 0), it will begin where it is put, or enabled.
    forget: wp.Function


@functools.cache
def functions(parts: Parts, real: type, moves: bool = False) -> Functions:
    """Returns the device functions for the classes of ``parts``.

    With ``moves``, bodies that are not free oppose to a force what their motions let them.
    """
    t = structs(real)
    vec3, quat, Model, State, Touch, Slip = t.vec3, t.quat, t.Model, t.State, t.Touch, t.Slip
    Place, Acts = touch_structs(real).Place, touch_structs(real).Acts
    Coefficients, Memory = group_structs(parts, real)
    law_force, law_begins, law_forget = memory.functions(parts.law, real)
    friction_force, _, friction_forget = memory.functions(parts.friction, real)
    rolling_force, _, rolling_forget = memory.functions(parts.rolling, real)
    torsion_force, _, torsion_forget = memory.functions(parts.torsion, real, along_normal=True)
    needs_mass, needs_curvature = parts.law.needs_mass, parts.law.needs_curvature
    pulls = parts.law.pulls
    tension_of = pull_off.function(parts.law, real) if pulls else None
    rolls, twists, directional = parts.rolls, parts.twists, parts.directional
    lowest = wp.constant(real(-math.inf if parts.law.pulls else 0.0))
    # Mean arm of friction under the pressure of Hertz: (3π/16) a.
    hertz_arm = wp.constant(real(3.0 * math.pi / 16.0))
    velocity_at = frames.functions(real).velocity_at
    mobility_of_motion = bodies.functions(real).mobility

    @wp.func
    def mobility(model: Model, state: State, env: int, body: int, arm_W: vec3, n_W: vec3):
        """Inverse of the mass that ``body`` opposes to a force along ``n_W`` at ``arm_W``; 0 for the world."""
        if body < 0:
            return real(0.0)
        if wp.static(moves):
            motion = model.body_motion[env, body]
            if motion.kind != FREE:
                return mobility_of_motion(model, state, env, body, motion, arm_W, n_W)
        lever_W = wp.cross(arm_W, n_W)
        inverse_B = model.body_inverse_inertia[env, body]
        turning = inverse_B[0, 0] * wp.length_sq(lever_W)
        if not model.body_round[env, body]:
            lever_B = wp.quat_rotate_inv(state.body_orientation[env, body], lever_W)
            turning = wp.dot(lever_B, inverse_B * lever_B)
        return real(1.0) / model.body_mass[env, body] + turning

    @wp.func
    def angular_velocity(state: State, env: int, body: int):
        if body < 0:
            return vec3()
        return state.body_angular_velocity[env, body]

    @wp.func
    def cut(force: real):
        """A law that does not pull is cut at zero. Not by max, which turns a NaN into 0 and hides it."""
        if force < lowest:
            return lowest
        return force

    @wp.func
    def surface_axis(q_WS: quat, n_W: vec3):
        """The x axis of the surface, laid into the tangent plane; where it is normal to that, the y axis."""
        x_W = wp.quat_rotate(q_WS, vec3(real(1.0), real(0.0), real(0.0)))
        flat = x_W - wp.dot(x_W, n_W) * n_W
        if wp.length_sq(flat) < real(1.0e-6):
            y_W = wp.quat_rotate(q_WS, vec3(real(0.0), real(1.0), real(0.0)))
            flat = y_W - wp.dot(y_W, n_W) * n_W
        return wp.normalize(flat)

    @wp.func
    def moving(slip: Slip, velocity: vec3):
        slip.velocity = velocity
        slip.speed = wp.length(velocity)
        return slip

    @wp.func
    def act(
        model: Model,
        state: State,
        env: int,
        place: Place,
        entry_speed: real,
        dt: real,
        coefficients: Coefficients,
        remembered: Memory,
        kept: Memory,
        member: int,
        torsion_radius: real,
        q_WS: quat,
    ):
        acts = Acts()
        n_W = place.normal
        # Of the second relative to the first: approach is positive.
        v_W = velocity_at(state, env, place.body_2, place.arm_2) - velocity_at(
            state, env, place.body_1, place.arm_1
        )
        approach = wp.dot(v_W, n_W)

        touch = Touch()
        touch.delta = place.penetration
        touch.delta_dot = approach
        # A contact that begins here has no entry speed yet; one that reloads faster than it began takes the
        # faster speed. The same rule advances the history, so a trial state sees the same force.
        touch.entry_speed = wp.max(wp.max(entry_speed, approach), real(0.0))
        if wp.static(needs_mass):
            touch.inverse_mass = mobility(model, state, env, place.body_1, place.arm_1, n_W) + mobility(
                model, state, env, place.body_2, place.arm_2, n_W
            )
            touch.mass = real(1.0) / touch.inverse_mass
        if wp.static(needs_curvature):
            touch.curvature_1 = place.curvature_1
            touch.curvature_2 = place.curvature_2
        touch.dt = dt
        begins = entry_speed < real(0.0)
        # What begins since the last step has not moved for longer than it took to come this deep.
        lasted = real(math.inf)
        if begins and approach > real(0.0):
            lasted = touch.delta / approach
        p = coefficients.law[env, member]
        normal_force = cut(law_force(remembered.law, kept.law, env, member, p, touch, lasted, dt, q_WS, n_W))
        tension = real(0.0)
        if wp.static(pulls):
            # Not below 0, and not by max, which hides a NaN.
            tension = tension_of(p, touch)
            if tension < real(0.0):
                tension = real(0.0)

        # The force of a step stands for the time from half a step before this state to half a step after: the
        # contact's share of it, when it began since the last state, is δ/(δ̇ dt) + 1/2 steps. A law continuous
        # at touch makes no difference of first order; one that jumps (a dashpot) is given its missing impulse.
        travel = approach * dt
        if begins and touch.delta <= travel * real(1.001):
            late = wp.min(touch.delta / travel, real(1.0))
            touch.delta = touch.delta * real(1.0e-6)
            normal_force = cut(normal_force + (late - real(0.5)) * cut(law_begins(p, touch)))

        slip = Slip()
        slip.normal = n_W
        # The load of friction: N, and with a law that pulls the pull-off force as well.
        slip.normal_force = normal_force
        if wp.static(pulls):
            slip.normal_force = normal_force + tension
        if slip.normal_force < real(0.0):
            slip.normal_force = real(0.0)
        slip.patch_radius = wp.sqrt(place.radius * place.penetration)
        if wp.static(directional):
            slip.axis = surface_axis(q_WS, n_W)

        slip = moving(slip, approach * n_W - v_W)
        acts.slip_speed = slip.speed
        friction_W = friction_force(
            remembered.friction, kept.friction, env, member, coefficients.friction[env, member], slip, lasted, dt,
            q_WS, n_W,
        )  # fmt: skip

        torque_W = vec3()
        if wp.static(rolls or twists):
            w_W = angular_velocity(state, env, place.body_1) - angular_velocity(state, env, place.body_2)
            if wp.static(rolls):
                # The velocity at which the point of contact travels, and a couple of the same power.
                slip = moving(slip, place.radius * wp.cross(w_W, n_W))
                rolling_W = rolling_force(
                    remembered.rolling, kept.rolling, env, member, coefficients.rolling[env, member], slip, lasted,
                    dt, q_WS, n_W,
                )  # fmt: skip
                torque_W = place.radius * wp.cross(n_W, rolling_W)
            if wp.static(twists):
                arm = torsion_radius
                if torsion_radius < real(0.0):
                    arm = hertz_arm * slip.patch_radius
                slip = moving(slip, (arm * wp.dot(w_W, n_W)) * n_W)
                torsion_W = torsion_force(
                    remembered.torsion, kept.torsion, env, member, coefficients.torsion[env, member], slip, lasted,
                    dt, q_WS, n_W,
                )  # fmt: skip
                torque_W += arm * torsion_W

        acts.approach_speed = approach
        acts.normal_force = normal_force
        acts.friction_force = friction_W
        acts.torque = torque_W
        return acts

    @wp.func
    def forget(kept: Memory, env: int, member: int, armed: int, dt: real):
        """Empties the memory: what begins next moved for a step at most if it comes from outside, else not yet."""
        moved_for = wp.where(armed != 0, dt, real(0.0))
        law_forget(kept.law, env, member, moved_for)
        friction_forget(kept.friction, env, member, moved_for)
        rolling_forget(kept.rolling, env, member, moved_for)
        torsion_forget(kept.torsion, env, member, moved_for)

    return Functions(act, forget)
