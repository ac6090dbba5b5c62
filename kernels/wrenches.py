"""From the blocks of contacts, the ends of couplings and from outside to the wrenches of the bodies."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.types import ENV_ACTIVE, QUEUES, Work, env_of, item_of, natural, structs, task_count
from warpcontact.kernels.unique import unique_kernel


@wp.func
def empty(waiting: wp.array(dtype=wp.int32)):
    """Empties the queues of what is near, which has been looked at: those of the next step begin anew."""
    for kind in range(QUEUES):
        waiting[kind] = 0


@functools.cache
def functions(real: type, coupled: bool, pushed: bool) -> SimpleNamespace:
    """Returns the device functions that tell what acts on a body: ``start`` without contacts, ``total`` with them.

    Args:
        real: Precision.
        coupled: Whether there are couplings.
        pushed: Whether there are forces from outside.
    """
    t = structs(real)
    vec3, Model, Near, Ends = t.vec3, t.Model, t.Near, t.Ends

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

    @wp.func
    def total(model: Model, near: Near, ends: Ends, env: int, body: int):
        """With the blocks of contacts in their order: the same bits in every run, whoever computed them."""
        wrench = start(model, ends, env, body)
        place = natural(model.body_block_start[body])
        stop = model.body_block_start[body + 1]
        while place < stop:
            entry = natural(model.body_block[place])
            place = natural(place + 1)
            block = entry // 2
            if near.count[env, block] > 0:
                if entry == 2 * block:
                    wrench.force += near.force[env, block]
                    wrench.torque += near.torque_1[env, block]
                else:
                    wrench.force -= near.force[env, block]
                    wrench.torque += near.torque_2[env, block]
        return wrench

    return SimpleNamespace(start=start, total=total)


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
    start = functions(real, coupled, pushed).start

    @unique_kernel()
    def clear_wrenches(
        work: Work,
        status: wp.array(dtype=wp.int32),
        waiting: wp.array(dtype=wp.int32),
        model: Model,
        ends: Ends,
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            if task == 0:
                empty(waiting)
            env = env_of(work, task)
            body = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            wrench = start(model, ends, env, body)
            wrenches.force[env, body] = wrench.force
            wrenches.torque[env, body] = wrench.torque

    return clear_wrenches


@functools.cache
def add_up(real: type, coupled: bool = False, pushed: bool = False) -> wp.Kernel:
    """Returns the kernel that sums what acts on each body, blocks of contacts in their order; items: bodies.

    Arguments are those of ``clear``.
    """
    t = structs(real)
    Model, Near, Ends, Wrenches = t.Model, t.Near, t.Ends, t.Wrenches
    total = functions(real, coupled, pushed).total

    @unique_kernel()
    def add_up_blocks(
        work: Work,
        status: wp.array(dtype=wp.int32),
        waiting: wp.array(dtype=wp.int32),
        model: Model,
        near: Near,
        ends: Ends,
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            if task == 0:
                empty(waiting)
            env = env_of(work, task)
            body = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            wrench = total(model, near, ends, env, body)
            wrenches.force[env, body] = wrench.force
            wrenches.torque[env, body] = wrench.torque

    return add_up_blocks
