"""Catenaries: elastic cables under their own weight between two points, in static equilibrium.

A cable lies in the vertical plane through its ends. Computed in float64 for any precision of the model, because
the tension of a taut cable depends on a small difference of two lengths. Equations: ``elastic_line.py``.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.couplings import ends
from warpcontact.kernels.couplings.elastic_line import (
    mean_tension,
    scale,
    size,
    solve,
    solve_grounded,
    suspended_weight,
)
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    LINE_DISABLED,
    LINE_FAILED,
    LINE_FOLDED,
    LINE_GROUNDED,
    LINE_HANGING,
    LINE_LOOSE,
    LINE_SUNK,
    LINE_TAUT,
    LaunchRange,
    Struct,
    structs,
    task_count,
    task_env,
    task_item,
)

zero = wp.constant(wp.float64(0.0))
one = wp.constant(wp.float64(1.0))
half = wp.constant(wp.float64(0.5))


@wp.struct
class Settings:
    """Parameters of a catenary."""

    length: wp.float64  # unstretched length [m]
    mass_per_length: wp.float64  # per unstretched length [kg/m]
    axial_stiffness: wp.float64  # EA [N]
    floor: wp.float64  # height of the floor above the origin of W, along the vertical [m]
    enabled: wp.int32  # 0 or 1


@wp.struct
class CatenarySolution:
    """Solution and warm start of a catenary."""

    horizontal: wp.array2d(dtype=wp.float64)  # [env, line] horizontal tension [N]
    low: wp.array2d(dtype=wp.float64)  # [env, line] upward force on the lower end [N]
    grounded: wp.array2d(dtype=wp.int32)  # [env, line] 1: partly on the floor


class LineStructs(NamedTuple):
    """Structs of catenaries, in one precision."""

    Lines: Struct  # measured quantities of catenaries


@functools.cache
def line_structs(real: type) -> LineStructs:
    """Returns the struct of the measured quantities of catenaries in one precision."""

    @wp.struct
    class Lines:
        tension_a: wp.array2d(dtype=real)  # [env, line] at the first end [N]
        tension_b: wp.array2d(dtype=real)  # [env, line] at the second end [N]
        horizontal_tension: wp.array2d(dtype=real)  # [env, line] [N]
        dip: wp.array2d(dtype=real)  # [env, line] depth of the lowest point below the first end [m]
        stretched_length: wp.array2d(dtype=real)  # [env, line] [m]
        grounded_length: wp.array2d(dtype=real)  # [env, line] unstretched length on the floor [m]
        iterations: wp.array2d(dtype=wp.int32)  # [env, line] number of evaluations of the span
        status: wp.array2d(dtype=wp.int32)  # [env, line] LINE_*
        # As of the last accepted step
        failures: wp.array2d(dtype=wp.int32)  # [env, line] steps without a solution

    return LineStructs(Lines=Lines)


class Placement(NamedTuple):
    """Device functions of the geometry of a catenary."""

    point_position: wp.Function  # position of a point, W [m]
    vertical_plane: wp.Function  # vertical plane of a catenary between two positions


@functools.cache
def placement(real: type, floored: bool) -> Placement:
    """Returns the device functions of the geometry of a catenary; ``floored``: whether there is a floor."""
    t = structs(real)
    vec3, Model, State = t.vec3, t.Model, t.State
    to_float64 = frames.functions(real).to_float64

    @wp.struct
    class Plane:
        """Vertical plane of a catenary and its ends in that plane."""

        origin: wp.vec3d  # lower end, raised to the floor if below it; W
        along: wp.vec3d  # horizontal unit vector from the lower end to the upper, 0 if one is above the other; W
        up: wp.vec3d  # upward unit vector, 0 without gravity; W
        run: wp.float64  # horizontal distance of the ends [m]
        rise: wp.float64  # height of the upper end above the lower [m]
        height: wp.float64  # height of the lower end above the floor [m]
        weight: wp.float64  # weight of the cable [N]
        b_is_lower: wp.int32  # 0 or 1
        sunk: wp.int32  # 1: an end is below the floor

    @wp.func
    def point_position(model: Model, state: State, env: int, point: int, arm_W: vec3):
        """Returns the position of ``point``, W [m]."""
        body = model.point_body[point]
        if body < 0:
            return to_float64(model.point_anchor[env, point]) + to_float64(arm_W)
        return to_float64(state.body_position[env, body]) + (
            to_float64(state.body_position_remainder[env, body]) + to_float64(arm_W)
        )

    @wp.func
    def vertical_plane(gravity_W: vec3, position_a: wp.vec3d, position_b: wp.vec3d, line_settings: Settings):
        """Returns the plane of a catenary between two positions."""
        plane = Plane()
        gravity = to_float64(gravity_W)
        strength = wp.length(gravity)
        if strength > zero:
            plane.up = -gravity / strength
        plane.weight = line_settings.mass_per_length * strength * line_settings.length
        apart = position_b - position_a
        rise = wp.dot(apart, plane.up)
        flat = apart - rise * plane.up
        plane.run = wp.length(flat)
        if plane.run > zero:
            plane.along = flat / plane.run
        raised_a = zero
        raised_b = zero
        if wp.static(floored) and plane.weight > zero:
            height_a = wp.dot(position_a, plane.up) - line_settings.floor
            height_b = height_a + rise
            raised_a = wp.max(-height_a, zero)
            raised_b = wp.max(-height_b, zero)
            rise += raised_b - raised_a
            plane.height = wp.max(wp.min(height_a, height_b), zero)
            plane.sunk = wp.where(raised_a + raised_b > zero, 1, 0)
        plane.rise = rise
        plane.origin = position_a + raised_a * plane.up
        if rise < zero:
            plane.b_is_lower = 1
            plane.rise = -rise
            plane.along = -plane.along
            plane.origin = position_b + raised_b * plane.up
        return plane

    return Placement(point_position=point_position, vertical_plane=vertical_plane)


@functools.cache
def kernel(real: type, floored: bool) -> wp.Kernel:
    """Returns the kernel of the forces of catenaries; items: those of the set.

    The initial guess is ``last_solution``, the solution of the last accepted step, which is not changed. The
    result is written to ``new_solution``.
    """
    t = structs(real)
    vec2, Model, State, EndWrenches = wp.vec2d, t.Model, t.State, t.EndWrenches
    Lines = line_structs(real).Lines
    placing = placement(real, floored)
    point_position, vertical_plane = placing.point_position, placing.vertical_plane
    end = ends.functions(real)
    arm, write_end_force = end.arm, end.write_end_force
    from_float64 = frames.functions(real).from_float64

    @unique_kernel()
    def line_forces(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        first: wp.int32,  # coupling
        settings: wp.array2d(dtype=Settings),
        last_solution: CatenarySolution,
        new_solution: CatenarySolution,
        lines: Lines,
        ends: EndWrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            line = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            end_a = 2 * (first + line)
            point_a = model.end_point[end_a]
            point_b = model.end_point[end_a + 1]
            arm_a = arm(model, state, env, point_a)
            arm_b = arm(model, state, env, point_b)
            line_settings = settings[env, line]
            plane = vertical_plane(
                model.gravity[env, 0],
                point_position(model, state, env, point_a, arm_a),
                point_position(model, state, env, point_b, arm_b),
                line_settings,
            )

            # Dimensionless: lengths by the unstretched length, forces by a force of the order of the tension.
            x = plane.run / line_settings.length
            y = plane.rise / line_settings.length
            height = plane.height / line_settings.length
            chord = size(plane.run, plane.rise)
            unit = scale(
                plane.weight, line_settings.axial_stiffness, (chord - line_settings.length) / line_settings.length
            )
            if line_settings.enabled == 0:
                unit = zero
            weight = zero
            give = zero
            warm = vec2()
            if unit > zero:
                weight = plane.weight / unit
                give = unit / line_settings.axial_stiffness
                warm = vec2(last_solution.horizontal[env, line] / unit, last_solution.low[env, line] / unit)
            h = zero
            low = zero
            high = zero
            lowest = zero  # depth below the lower end
            hanging = one  # suspended fraction of the length
            evaluations = wp.int32(0)
            more = wp.int32(0)
            converged = wp.bool(True)
            grounded = wp.bool(False)
            if wp.static(floored) and last_solution.grounded[env, line] == 1 and weight > zero:
                h, evaluations, converged = solve_grounded(warm[0], x, height, height + y, weight, give)
                low = -suspended_weight(h, height, weight, give)[0]
                high = suspended_weight(h, height + y, weight, give)[0]
                # Lifted off if more weight is suspended than there is.
                grounded = high - low <= weight
            if unit > zero and not grounded:
                solution, more, converged = solve(warm, x, y, weight, give)
                evaluations += more
                h = solution[0]
                low = solution[1]
                high = low + weight
                if low < zero and high > zero:
                    lowest = low * low / weight * (one / (size(h, low) + h) + half * give)
                if wp.static(floored) and lowest > height:
                    h, more, converged = solve_grounded(h, x, height, height + y, weight, give)
                    evaluations += more
                    low = -suspended_weight(h, height, weight, give)[0]
                    high = suspended_weight(h, height + y, weight, give)[0]
                    grounded = True
            tension_low = size(h, low)
            tension_high = size(h, high)
            mean = zero
            if grounded:
                lowest = height
                # Integral of the tension: the part on the floor, then the suspended parts from their lowest points
                # upwards.
                hanging = wp.min((high - low) / weight, one)
                mean = (one - hanging) * h
                if low < zero:
                    mean -= low / weight * mean_tension(h, zero, -low)
                if high > zero:
                    mean += high / weight * mean_tension(h, zero, high)
            elif tension_low + tension_high > zero:
                mean = mean_tension(h, low, weight)

            line_status = LINE_HANGING
            if chord > line_settings.length:
                line_status = LINE_TAUT
            elif unit == zero:
                line_status = LINE_LOOSE
            elif h == zero and low < zero:
                line_status = LINE_FOLDED
            if grounded:
                line_status = LINE_GROUNDED
            if plane.sunk == 1:
                line_status = LINE_SUNK
            if not converged:
                line_status = LINE_FAILED
            if line_settings.enabled == 0:
                line_status = LINE_DISABLED
            new_solution.horizontal[env, line] = h * unit
            new_solution.low[env, line] = low * unit
            new_solution.grounded[env, line] = wp.where(grounded, 1, 0)

            along = h * unit * plane.along
            on_low = along + low * unit * plane.up
            on_high = -along - high * unit * plane.up
            dip = lowest * line_settings.length
            if plane.b_is_lower == 1:
                write_end_force(ends, env, end_a, arm_a, from_float64(on_high))
                write_end_force(ends, env, end_a + 1, arm_b, from_float64(on_low))
                lines.tension_a[env, line] = real(tension_high * unit)
                lines.tension_b[env, line] = real(tension_low * unit)
                dip += plane.rise
            else:
                write_end_force(ends, env, end_a, arm_a, from_float64(on_low))
                write_end_force(ends, env, end_a + 1, arm_b, from_float64(on_high))
                lines.tension_a[env, line] = real(tension_low * unit)
                lines.tension_b[env, line] = real(tension_high * unit)
            lines.horizontal_tension[env, line] = real(h * unit)
            lines.dip[env, line] = real(dip)
            lines.stretched_length[env, line] = real(line_settings.length * (one + give * mean))
            lines.grounded_length[env, line] = real(line_settings.length * (one - hanging))
            lines.iterations[env, line] = evaluations
            lines.status[env, line] = line_status

    return line_forces


@functools.cache
def accept(real: type) -> wp.Kernel:
    """Returns the kernel that stores the solutions of an accepted step; items: those of the set."""
    Lines = line_structs(real).Lines

    @unique_kernel()
    def accept_lines(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        new_solution: CatenarySolution,
        last_solution: CatenarySolution,
        lines: Lines,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            line = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            if lines.status[env, line] == LINE_FAILED:
                # The next step starts without a warm start.
                lines.failures[env, line] = lines.failures[env, line] + 1
                last_solution.horizontal[env, line] = zero
                last_solution.grounded[env, line] = 0
                continue
            last_solution.horizontal[env, line] = new_solution.horizontal[env, line]
            last_solution.low[env, line] = new_solution.low[env, line]
            last_solution.grounded[env, line] = new_solution.grounded[env, line]

    return accept_lines


@functools.cache
def reset(real: type) -> wp.Kernel:
    """Returns the kernel that resets catenaries. Launch with dim (env, line)."""
    Lines = line_structs(real).Lines

    @unique_kernel(runs_rarely=True)
    def reset_lines(mask: wp.array(dtype=wp.bool), last_solution: CatenarySolution, lines: Lines):
        env, line = wp.tid()
        if mask[env]:
            last_solution.horizontal[env, line] = zero
            last_solution.low[env, line] = zero
            last_solution.grounded[env, line] = 0
            lines.failures[env, line] = 0

    return reset_lines
