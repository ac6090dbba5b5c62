"""Spring-dampers: a force along the line between two points, from its length and rate.

Spring and damper are compiled into the kernel, once per combination of classes and precision.
"""

import functools
from typing import NamedTuple

import warp as wp
from warpcontact.kernels.catalogue.device_model import Formula, coefficient_struct, named_struct
from warpcontact.kernels.couplings import ends
from warpcontact.kernels.couplings.springs import Damper, Spring
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import (
    COUPLING_ACTIVE,
    COUPLING_BROKEN,
    COUPLING_DISABLED,
    COUPLING_NO_DIRECTION,
    COUPLING_OUTSIDE,
    COUPLING_SLACK,
    ENV_ACTIVE,
    LaunchRange,
    Struct,
    structs,
    task_count,
    task_env,
    task_item,
)


class SpringModel(NamedTuple):
    """Classes of spring and damper, for which kernels are compiled."""

    spring: type[Spring]
    damper: type[Damper]


class SpringStructs(NamedTuple):
    """Structs of spring-dampers, in one precision."""

    Settings: Struct  # parameters of a spring-damper apart from those of its models
    Springs: Struct  # measured quantities and history of spring-dampers
    Stretch: Struct  # arguments of spring and damper models at one instant
    Row: Struct  # row of a table over the distance
    Tables: Struct  # rows of all tables of a model


@functools.cache
def spring_structs(real: type) -> SpringStructs:
    """Returns the structs of spring-dampers in one precision."""
    vec3 = structs(real).vec3
    vec4 = {wp.float32: wp.vec4f, wp.float64: wp.vec4d}[real]

    @wp.struct
    class Settings:
        rest_length: real  # [m]
        break_force: real  # magnitude of the force above which it breaks [N]
        tension_only: wp.int32  # 0 or 1
        enabled: wp.int32  # 0 or 1

    @wp.struct
    class Springs:
        """Measured quantities and history of spring-dampers."""

        length: wp.array2d(dtype=real)  # [env, spring] [m]
        rate: wp.array2d(dtype=real)  # [env, spring] rate of the length, > 0 apart [m/s]
        force: wp.array2d(dtype=real)  # [env, spring] > 0: attractive [N]
        status: wp.array2d(dtype=wp.int32)  # [env, spring] COUPLING_*
        direction: wp.array2d(
            dtype=vec3
        )  # [env, spring] unit vector from the first end to the second, W; 0: undefined
        # As of the last accepted step
        broken: wp.array2d(dtype=wp.int32)  # [env, spring] 0 or 1
        last_direction: wp.array2d(dtype=vec3)  # [env, spring]

    @wp.struct
    class Stretch:
        """Arguments of spring and damper models at one instant."""

        length: real  # x ≥ 0 [m]
        rest_length: real  # x₀ [m]
        extension: real  # x − x₀ [m]
        rate: real  # ẋ, > 0 apart [m/s]

    @wp.struct
    class Row:
        """Row of a table over the distance: linear from ``start`` on."""

        start: real  # [m]
        value: real
        slope: real
        integral: real  # of the table, from its first distance to ``start``

    @wp.struct
    class Tables:
        """Rows of all tables of a model, table by table: one before it, one per interval, one after it."""

        rows: wp.array(dtype=vec4)  # start, value, slope, integral
        first: wp.array(dtype=wp.int32)  # [spring + 1] first row

    return SpringStructs(Settings=Settings, Springs=Springs, Stretch=Stretch, Row=Row, Tables=Tables)


@functools.cache
def coefficient_structs(parts: SpringModel, real: type) -> Struct:
    """Returns the struct of arrays [env, spring of the group]: coefficients of both models, and settings."""
    elements = [(part, coefficient_struct(formula, real)) for part, formula in parts._asdict().items()]
    elements.append(("settings", spring_structs(real).Settings))
    return named_struct("SpringCoefficients", tuple((part, wp.array2d(dtype=dtype)) for part, dtype in elements))


@functools.cache
def _device_functions(formula: type[Formula], real: type) -> tuple[wp.Function, wp.Function]:
    """Returns the force of a model, with table lookup if it has one, and the test for out of range."""
    t = spring_structs(real)
    Row, Tables, Stretch = t.Row, t.Tables, t.Stretch
    Coefficients = coefficient_struct(formula, real)
    force = formula.force

    if formula.table_field() is None:

        @wp.func
        def evaluate(p: Coefficients, s: Stretch, tables: Tables, spring: int):
            return force(p, s)

        @wp.func
        def outside(length: real, tables: Tables, spring: int):
            return False

        return evaluate, outside

    @wp.func
    def evaluate_with_table(p: Coefficients, s: Stretch, tables: Tables, spring: int):
        low = tables.first[spring]
        above = tables.first[spring + 1]
        # Binary search for the last row that starts at or before the length. Shorter lengths use the first row.
        while above - low > 1:
            middle = (low + above) // 2
            if tables.rows[middle][0] <= s.length:
                low = middle
            else:
                above = middle
        coupling_status = tables.rows[low]
        row = Row()
        row.start = coupling_status[0]
        row.value = coupling_status[1]
        row.slope = coupling_status[2]
        row.integral = coupling_status[3]
        return force(p, s, row)

    @wp.func
    def outside_table(length: real, tables: Tables, spring: int):
        return (
            length < tables.rows[tables.first[spring]][0] or length > tables.rows[tables.first[spring + 1] - 1][0]
        )

    return evaluate_with_table, outside_table


@functools.cache
def kernel(parts: SpringModel, real: type) -> wp.Kernel:
    """Returns the kernel of the forces of spring-dampers; items: those of the group.

    The history is read but not changed; ``accept`` advances it from ``springs`` once the step is accepted.
    """
    t = structs(real)
    s = spring_structs(real)
    Model, State, EndWrenches = t.Model, t.State, t.EndWrenches
    Springs, Stretch, Tables = s.Springs, s.Stretch, s.Tables
    Coefficients = coefficient_structs(parts, real)
    spring_force, spring_outside = _device_functions(parts.spring, real)
    damper_force, damper_outside = _device_functions(parts.damper, real)
    end = ends.functions(real)
    arm, separation, velocity, write_end_force = end.arm, end.separation, end.velocity, end.write_end_force
    # Relative distance below which the direction is dominated by rounding.
    rounding = wp.constant(real(8.0 * t.epsilon))

    @unique_kernel()
    def spring_forces(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        first: wp.int32,  # coupling
        coefficients: Coefficients,
        spring_tables: Tables,
        damper_tables: Tables,
        springs: Springs,
        ends: EndWrenches,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            spring = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            end_1 = 2 * (first + spring)
            point_1 = model.end_point[end_1]
            point_2 = model.end_point[end_1 + 1]
            settings = coefficients.settings[env, spring]
            arm_1 = arm(model, state, env, point_1)
            arm_2 = arm(model, state, env, point_2)
            from_1_to_2 = separation(model, state, env, point_1, point_2, arm_1, arm_2)
            apart = velocity(model, state, env, point_2, arm_2) - velocity(model, state, env, point_1, arm_1)

            stretch = Stretch()
            stretch.length = wp.length(from_1_to_2)
            stretch.rest_length = settings.rest_length
            stretch.extension = stretch.length - settings.rest_length
            direction = springs.last_direction[env, spring]
            coupling_status = COUPLING_ACTIVE
            if stretch.length > rounding * (wp.length(arm_1) + wp.length(arm_2)):
                direction = from_1_to_2 / stretch.length
            elif wp.length_sq(direction) == real(0.0):
                coupling_status = COUPLING_NO_DIRECTION
            stretch.rate = wp.dot(direction, apart)

            force = spring_force(coefficients.spring[env, spring], stretch, spring_tables, spring)
            damping = damper_force(coefficients.damper[env, spring], stretch, damper_tables, spring)
            total = force + damping
            if spring_outside(stretch.length, spring_tables, spring):
                coupling_status = wp.max(coupling_status, COUPLING_OUTSIDE)
            if damper_outside(stretch.length, damper_tables, spring):
                coupling_status = wp.max(coupling_status, COUPLING_OUTSIDE)
            # A rope without tension has no force, so damping does not act either.
            if settings.tension_only == 1:
                if force <= real(0.0):
                    coupling_status = COUPLING_SLACK
                    total = real(0.0)
                elif total < real(0.0):
                    total = real(0.0)
            if wp.abs(total) > settings.break_force or springs.broken[env, spring] == 1:
                coupling_status = COUPLING_BROKEN
                total = real(0.0)
            if settings.enabled == 0:
                coupling_status = COUPLING_DISABLED
                total = real(0.0)

            springs.length[env, spring] = stretch.length
            springs.rate[env, spring] = stretch.rate
            springs.force[env, spring] = total
            springs.status[env, spring] = coupling_status
            springs.direction[env, spring] = direction
            write_end_force(ends, env, end_1, arm_1, total * direction)
            write_end_force(ends, env, end_1 + 1, arm_2, -total * direction)

    return spring_forces


@functools.cache
def accept(real: type) -> wp.Kernel:
    """Returns the kernel that advances the history in an accepted step; items: those of the group."""
    Springs = spring_structs(real).Springs

    @unique_kernel()
    def accept_springs(launch: LaunchRange, status: wp.array(dtype=wp.int32), springs: Springs):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            spring = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            if springs.status[env, spring] == COUPLING_BROKEN:
                springs.broken[env, spring] = 1
            springs.last_direction[env, spring] = springs.direction[env, spring]

    return accept_springs


@functools.cache
def reset(real: type) -> wp.Kernel:
    """Returns the kernel that resets spring-dampers. Launch with dim (env, spring)."""
    t = structs(real)
    vec3 = t.vec3
    Springs = spring_structs(real).Springs

    @unique_kernel(runs_rarely=True)
    def reset_springs(mask: wp.array(dtype=wp.bool), springs: Springs):
        env, spring = wp.tid()
        if mask[env]:
            springs.broken[env, spring] = 0
            springs.last_direction[env, spring] = vec3()

    return reset_springs
