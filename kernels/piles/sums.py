"""From the touches of a pile to the wrenches of its bodies."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels.piles.base import AT_ONCE, TOUCHES, pile_structs
from warpcontact.kernels.types import ENV_ACTIVE, Work, env_of, item_of, natural, structs, task_count
from warpcontact.kernels.unique import unique_kernel
from warpcontact.kernels.warps import count_of, first_of


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the struct ``Sum`` and the device function that adds what touches of a shape do, in their order."""
    t, p = structs(real), pile_structs(real)
    vec3, State = t.vec3, t.State
    Shapes, Lists, Touches = p.Shapes, p.Lists, p.Touches

    @wp.struct
    class Sum:
        force: vec3  # W [N]
        torque: vec3  # about the centre of mass, W [N·m]
        touching: wp.int32

    @wp.func
    def torque_on_second(
        state: State, shapes: Shapes, env: int, first: int, second: int, force: vec3, torque: vec3
    ):
        """Torque on the second of a pair, about its centre of mass, from force and torque on the first."""
        one = natural(shapes.body[first])
        other = natural(shapes.body[second])
        apart = state.body_position[env, one] - state.body_position[env, other]
        apart += state.body_position_remainder[env, one] - state.body_position_remainder[env, other]
        return -(torque + wp.cross(apart, force))

    @wp.func
    def add_shape(total: Sum, state: State, shapes: Shapes, lists: Lists, touches: Touches, env: int, shape: int):
        start = shapes.entry_start[shape]
        slot = shapes.slot_start[shape]
        owned = lists.owned[env, shape]
        count = lists.count[env, shape]
        for base in range(0, count, wp.static(AT_ONCE)):
            those = wp.int32(0)
            for k in range(base, wp.min(base + wp.static(AT_ONCE), count)):
                record = slot + k
                if k >= owned:
                    record = lists.slot[env, start + k]
                if record >= 0:  # noqa: SIM102  Warp would evaluate both sides
                    if (touches.bits[env, record] & TOUCHES) != 0:
                        those = those | (1 << (k - base))
            total.touching += count_of(those)
            while those != 0:
                k = base + first_of(those)
                those = those & (those - 1)
                record = slot + k
                if k >= owned:
                    record = lists.slot[env, start + k]
                partner = natural(lists.partner[env, start + k])
                force = touches.force[env, record]
                torque = touches.torque[env, record]
                if shape < partner:
                    total.force += force
                    total.torque += torque
                else:
                    total.force -= force
                    total.torque += torque_on_second(state, shapes, env, partner, shape, force, torque)
        return total

    return SimpleNamespace(Sum=Sum, add_shape=add_shape)


@functools.cache
def add(real: type, alone: bool) -> wp.Kernel:
    """Returns the kernel that adds to the wrench of each body what touches of its shapes do, in their order.

    The same bits in every run. Items: carriers. ``alone``: whether every body of the pile has one shape.
    """
    t = structs(real)
    State, Wrenches = t.State, t.Wrenches
    p = pile_structs(real)
    Shapes, Lists, Touches = p.Shapes, p.Lists, p.Touches
    of_shape = functions(real)
    Sum, add_shape = of_shape.Sum, of_shape.add_shape

    @unique_kernel()
    def add_pile(
        work: Work,
        status: wp.array(dtype=wp.int32),
        state: State,
        shapes: Shapes,
        lists: Lists,
        touches: Touches,
        wrenches: Wrenches,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            carrier = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            total = Sum()
            if wp.static(alone):
                total = add_shape(total, state, shapes, lists, touches, env, carrier)
            else:
                for place in range(shapes.carrier_start[carrier], shapes.carrier_start[carrier + 1]):
                    total = add_shape(total, state, shapes, lists, touches, env, shapes.carrier_shape[place])
            if total.touching > 0:
                body = shapes.carrier_body[carrier]
                wrenches.force[env, body] = wrenches.force[env, body] + total.force
                wrenches.torque[env, body] = wrenches.torque[env, body] + total.torque

    return add_pile
