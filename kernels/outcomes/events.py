"""Records the start and end times of contacts."""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.outcomes.source import SourceForm, value
from warpcontact.kernels.types import ENV_ACTIVE, LaunchRange, first_env, task_count


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
def kernel(form: SourceForm) -> wp.Kernel:
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
def restart() -> wp.Kernel:
    """Returns the kernel that clears events. Launch with dim env."""

    @unique_kernel()
    def reset_events(mask: wp.array(dtype=wp.bool), events: Events):
        env = wp.tid()
        if mask[env]:
            events.count[env] = 0
            for place in range(events.touching.shape[1]):
                events.touching[env, place] = 0

    return reset_events
