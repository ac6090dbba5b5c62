"""Monitors of a step: outcomes, stop conditions, and events of contacts."""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.outcomes.source import SourceForm, array_types, value, values
from warpcontact.kernels.types import (
    ENV_ACTIVE,
    ENV_FROZEN,
    ENV_HALTED,
    LaunchRange,
    first_env,
    task_count,
    task_env,
    task_item,
)


@wp.struct
class SourceView:
    """Evaluation of the first source of an outcome: ``sign`` (x − ``limit``), positive if it holds."""

    limit: wp.float64
    sign: wp.float64
    components: wp.int32  # number of components per item


@functools.cache
def _source_value(forms: tuple[SourceForm, ...], single: bool) -> wp.Function:
    """Returns the device function that evaluates the source of an outcome; see ``accumulate``."""
    see = values(forms)
    type_0, type_1, type_2, type_3 = array_types(forms)
    single_source = len(forms) == 1

    @wp.func
    def source_value(
        view: SourceView,
        a: wp.array3d(dtype=type_0),
        b: wp.array3d(dtype=type_1),
        c: wp.array3d(dtype=type_2),
        d: wp.array3d(dtype=type_3),
        env: int,
        result: int,
    ):
        item = wp.int32(0)
        component = wp.int32(0)
        if wp.static(not single):
            item = result // view.components
            component = result % view.components
        x = see(a, b, c, d, env, item, component)
        if wp.static(single_source):
            x = view.sign * (x - view.limit)
        return x

    return source_value


@functools.cache
def accumulate(update: wp.Function, length: int, forms: tuple[SourceForm, ...], single: bool) -> wp.Kernel:
    """Returns the kernel that updates an outcome with the state before a step; items: results.

    Args:
        update: Device function of the outcome.
        length: Length of its memory.
        forms: Forms of its sources.
        single: Whether there is one result per environment; avoids divisions, which would dominate the time.
    """
    Memory = wp.types.vector(length=length, dtype=wp.float64)
    source_value = _source_value(forms, single)
    type_0, type_1, type_2, type_3 = array_types(forms)

    @unique_kernel()
    def accumulate(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),  # [env] before the step [s]
        step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        view: SourceView,
        a: wp.array3d(dtype=type_0),
        b: wp.array3d(dtype=type_1),
        c: wp.array3d(dtype=type_2),
        d: wp.array3d(dtype=type_3),
        memory: wp.array2d(dtype=Memory),  # [env, result]
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            number = wp.int32(0)
            if wp.static(not single):
                env = task_env(launch, task)
                number = task_item(launch, task)
            if status[env] != ENV_ACTIVE:
                continue
            x = source_value(view, a, b, c, d, env, number)
            memory[env, number] = update(memory[env, number], x, time[env], step[env, 0])

    return accumulate


@functools.cache
def report(update: wp.Function, result: wp.Function, length: int, forms: tuple[SourceForm, ...]) -> wp.Kernel:
    """Returns the kernel that evaluates results at the current state; items: results.

    It adds the current state with ``dt`` = 0 to a copy of the memory. For a frozen environment, whose next step
    failed, the state is added only if it is finite.
    """
    Memory = wp.types.vector(length=length, dtype=wp.float64)
    source_value = _source_value(forms, False)
    type_0, type_1, type_2, type_3 = array_types(forms)

    @unique_kernel()
    def report(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),
        view: SourceView,
        a: wp.array3d(dtype=type_0),
        b: wp.array3d(dtype=type_1),
        c: wp.array3d(dtype=type_2),
        d: wp.array3d(dtype=type_3),
        memory: wp.array2d(dtype=Memory),
        results: wp.array2d(dtype=wp.float64),  # [env, result]
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = task_env(launch, task)
            number = task_item(launch, task)
            x = source_value(view, a, b, c, d, env, number)
            m = memory[env, number]
            if status[env] != ENV_FROZEN or wp.isfinite(x):
                m = update(m, x, time[env], wp.float64(0.0))
            results[env, number] = result(m, time[env])

    return report


@functools.cache
def reset_outcome(length: int) -> wp.Kernel:
    """Returns the kernel that resets memories to their initial values. Launch with dim (env, result)."""
    Memory = wp.types.vector(length=length, dtype=wp.float64)

    @unique_kernel(runs_rarely=True)
    def restart_memory(mask: wp.array(dtype=wp.bool), start: Memory, memory: wp.array2d(dtype=Memory)):
        env, number = wp.tid()
        if mask[env]:
            memory[env, number] = start

    return restart_memory


@functools.cache
def reset_counts() -> wp.Kernel:
    """Returns the kernel that sets counts to 0. Launch with dim env."""

    @unique_kernel(runs_rarely=True)
    def reset(mask: wp.array(dtype=wp.bool), counts: wp.array(dtype=wp.int32)):
        env = wp.tid()
        if mask[env]:
            counts[env] = 0

    return reset


#: Tolerance for the duration of a condition, as a fraction of a step, because clocks are rounded sums.
TIME_TOLERANCE = wp.constant(wp.float64(1.0e-6))


@wp.struct
class StopCriterion:
    """Stop condition: ``sign`` (x − ``limit``) > 0 for the duration ``lasting``."""

    limit: wp.float64
    sign: wp.float64
    lasting: wp.float64  # [s]
    number: wp.int32  # index of the condition


@wp.struct
class StopStates:
    """State of the stop conditions."""

    since: wp.array2d(dtype=wp.float64)  # [env, condition] time since which it holds [s]; NaN: does not hold
    stopped_by: wp.array(dtype=wp.int32)  # [env] index of the condition; −1: none


@functools.cache
def check_stop(form: SourceForm) -> wp.Kernel:
    """Returns the kernel that checks a condition before a step; items: one per environment."""
    source_value = value(form)
    dtype = form.dtype

    @unique_kernel()
    def stop(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),  # [env] before the step [s]
        step: wp.array2d(dtype=wp.float64),  # [env, 0] [s]
        condition: StopCriterion,
        a: wp.array3d(dtype=dtype),
        stops: StopStates,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            x = condition.sign * (source_value(a, env, 0, 0) - condition.limit)
            since = wp.float64(wp.nan)
            if x > wp.float64(0.0):
                since = stops.since[env, condition.number]
                if wp.isnan(since):
                    since = time[env]
                if time[env] - since >= condition.lasting - TIME_TOLERANCE * step[env, 0]:
                    status[env] = ENV_HALTED
                    stops.stopped_by[env] = condition.number
            stops.since[env, condition.number] = since

    return stop


@functools.cache
def reset_stops() -> wp.Kernel:
    """Returns the kernel that resets conditions. Launch with dim env."""

    @unique_kernel(runs_rarely=True)
    def reset_conditions(mask: wp.array(dtype=wp.bool), count: wp.int32, stops: StopStates):
        env = wp.tid()
        if mask[env]:
            stops.stopped_by[env] = -1
            for number in range(count):
                stops.since[env, number] = wp.float64(wp.nan)

    return reset_conditions


@wp.struct
class Events:
    """Ring buffer of the last events of an environment."""

    touching: wp.array2d(
        dtype=wp.int32
    )  # [env, index] contact state at the last evaluation; index: item of a contact
    count: wp.array(dtype=wp.int32)  # [env] total number of events
    time: wp.array2d(dtype=wp.float64)  # [env, slot] time of the first state after the event [s]
    what: wp.array2d(dtype=wp.int32)  # [env, slot] 2 × index + 1: contact began, + 0: contact ended


@functools.cache
def record_events(form: SourceForm) -> wp.Kernel:
    """Returns the kernel that detects events of a contact, which is closed where its source is positive.

    Items: one per environment, so that the order of events is fixed.
    """
    source_value = value(form)
    dtype = form.dtype

    @unique_kernel()
    def write_events(
        launch: LaunchRange,
        status: wp.array(dtype=wp.int32),
        time: wp.array(dtype=wp.float64),  # [env] before the step [s]
        first: wp.int32,  # index of the first item
        a: wp.array3d(dtype=dtype),
        events: Events,
    ):
        for task in range(wp.tid(), task_count(launch), launch.threads):
            env = first_env(launch) + task
            if status[env] != ENV_ACTIVE:
                continue
            for item in range(a.shape[1]):
                place = first + item
                touches = wp.where(source_value(a, env, item, 0) > wp.float64(0.0), 1, 0)
                if touches != events.touching[env, place]:
                    events.touching[env, place] = touches
                    count = events.count[env]
                    slot = count % events.time.shape[1]
                    events.time[env, slot] = time[env]
                    events.what[env, slot] = 2 * place + touches
                    events.count[env] = count + 1

    return write_events


@functools.cache
def reset_events() -> wp.Kernel:
    """Returns the kernel that clears events. Launch with dim env."""

    @unique_kernel(runs_rarely=True)
    def clear_events(mask: wp.array(dtype=wp.bool), events: Events):
        env = wp.tid()
        if mask[env]:
            events.count[env] = 0
            for place in range(events.touching.shape[1]):
                events.touching[env, place] = 0

    return clear_events
