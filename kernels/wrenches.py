"""From the blocks of contacts, the ends of couplings and from outside to the wrenches of the bodies."""

import functools

import warp as wp
from warpcontact.kernels.types import ENV_ACTIVE, Work, first_env, structs, task_count


@functools.cache
def _start(real: type, coupled: bool, pushed: bool) -> wp.Function:
    """Returns the device function that tells the wrench of a body without its contacts."""
    t = structs(real)
    vec3, Model, Ends = t.vec3, t.Model, t.Ends

    @wp.struct
    class Wrench:
        force: vec3  # W [N]
        torque: vec3  # about the centre of mass, W [N·m]

    @wp.func
    def start(model: Model, ends: Ends, env: int, body: int):
        wrench = Wrench()
        if wp.static(pushed):
            wrench.force = model.body_external_force[env, body]
            wrench.torque = model.body_external_torque[env, body]
        if wp.static(coupled):
            for place in range(model.body_end_start[body], model.body_end_start[body + 1]):
                end = model.body_end[place]
                wrench.force += ends.force[env, end]
                wrench.torque += ends.torque[env, end]
        return wrench

    return start


@functools.cache
def clear(real: type, coupled: bool = False, pushed: bool = False) -> wp.Kernel:
    """Returns the kernel that prepares ``wrenches`` for blocks that add to them; items: bodies.

    Args:
        real: Precision.
        coupled: Whether there are couplings.
        pushed: Whether there are forces from outside.
    """
    t = structs(real)
    Model, Ends, Wrenches = t.Model, t.Ends, t.Wrenches
    start = _start(real, coupled, pushed)

    @wp.kernel(module="unique", enable_backward=False)
    def clear_wrenches(work: Work, status: wp.array(dtype=wp.int32), model: Model, ends: Ends, wrenches: Wrenches):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task // work.items
            body = task % work.items
            if status[env] != ENV_ACTIVE:
                continue
            wrench = start(model, ends, env, body)
            wrenches.force[env, body] = wrench.force
            wrenches.torque[env, body] = wrench.torque

    return clear_wrenches


@functools.cache
def add_up(real: type, coupled: bool = False, pushed: bool = False) -> wp.Kernel:
    """Returns the kernel that sums what acts on each body, blocks of contacts in their order; items: bodies.

    The same bits in every run, however many threads there are. Arguments are those of ``clear``.
    """
    t = structs(real)
    Model, Near, Ends, Wrenches = t.Model, t.Near, t.Ends, t.Wrenches
    start = _start(real, coupled, pushed)

    @wp.kernel(module="unique", enable_backward=False)
    def add_up_blocks(
        work: Work, status: wp.array(dtype=wp.int32), model: Model, near: Near, ends: Ends, wrenches: Wrenches
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task // work.items
            body = task % work.items
            if status[env] != ENV_ACTIVE:
                continue
            wrench = start(model, ends, env, body)
            force = wrench.force
            torque = wrench.torque
            for place in range(model.body_block_start[body], model.body_block_start[body + 1]):
                block = model.body_block[place] // 2
                if near.count[env, block] > 0:
                    if model.body_block[place] == 2 * block:
                        force += near.force[env, block]
                        torque += near.torque_1[env, block]
                    else:
                        force -= near.force[env, block]
                        torque += near.torque_2[env, block]
            wrenches.force[env, body] = force
            wrenches.torque[env, body] = torque

    return add_up_blocks
