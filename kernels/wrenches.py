"""From the blocks of contacts to the bodies: wrenches start at zero, or are summed in one order."""

import functools

import warp as wp
from warpcontact.kernels.types import ENV_ACTIVE, Work, structs


@functools.cache
def clear(real: type) -> wp.Kernel:
    """Returns the kernel that zeroes ``wrenches``, for blocks that add to them; items: bodies."""
    t = structs(real)
    vec3, Wrenches = t.vec3, t.Wrenches

    @wp.kernel(module="unique", enable_backward=False)
    def clear_wrenches(work: Work, status: wp.array(dtype=wp.int32), wrenches: Wrenches):
        for task in range(wp.tid(), work.tasks, work.threads):
            env = work.first + task // work.items
            body = task % work.items
            if status[env] != ENV_ACTIVE:
                continue
            wrenches.force[env, body] = vec3()
            wrenches.torque[env, body] = vec3()

    return clear_wrenches


@functools.cache
def add_up(real: type) -> wp.Kernel:
    """Returns the kernel that sums what the blocks hold for each body, in their order; items: bodies.

    The same bits in every run, however many threads there are.
    """
    t = structs(real)
    vec3, Model, Near, Wrenches = t.vec3, t.Model, t.Near, t.Wrenches

    @wp.kernel(module="unique", enable_backward=False)
    def add_up_blocks(work: Work, status: wp.array(dtype=wp.int32), model: Model, near: Near, wrenches: Wrenches):
        for task in range(wp.tid(), work.tasks, work.threads):
            env = work.first + task // work.items
            body = task % work.items
            if status[env] != ENV_ACTIVE:
                continue
            force = vec3()
            torque = vec3()
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
