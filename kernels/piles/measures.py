"""What is measured of a pile."""

import functools

import warp as wp
from warpcontact.kernels.piles.base import TOUCHES, pile_structs
from warpcontact.kernels.types import structs
from warpcontact.kernels.unique import unique_kernel


@functools.cache
def measured(real: type):
    """Returns the struct of arrays that a pile is measured into."""
    vec3 = structs(real).vec3

    @wp.struct
    class Measured:
        contacts: wp.array(dtype=wp.int32)  # [env] pairs that touch
        normal_force: wp.array(dtype=wp.float64)  # [env] sum of their normal forces [N]
        max_penetration: wp.array(dtype=real)  # [env] [m]
        max_normal_force: wp.array(dtype=real)  # [env] [N]
        coordination: wp.array2d(dtype=wp.int32)  # [env, shape] shapes that touch it
        force: wp.array2d(dtype=vec3)  # [env, shape] of the pile on it, W [N]

    return Measured


@functools.cache
def shapes(real: type) -> wp.Kernel:
    """Returns the kernel that measures every shape. Launch with dim (env, shape)."""
    vec3 = structs(real).vec3
    p = pile_structs(real)
    Shapes, Lists, Touches = p.Shapes, p.Lists, p.Touches
    Measured = measured(real)

    @unique_kernel()
    def measure_shapes(shapes: Shapes, lists: Lists, touches: Touches, measured: Measured):
        env, shape = wp.tid()
        start = shapes.entry_start[shape]
        owned = lists.owned[env, shape]
        count = wp.int32(0)
        force = vec3()
        for k in range(lists.count[env, shape]):
            slot = shapes.slot_start[shape] + k
            if k >= owned:
                slot = lists.slot[env, start + k]
            if slot >= 0:  # noqa: SIM102
                if (touches.bits[env, slot] & TOUCHES) != 0:
                    count += 1
                    if shape < lists.partner[env, start + k]:
                        force += touches.force[env, slot]
                    else:
                        force -= touches.force[env, slot]
        measured.coordination[env, shape] = count
        measured.force[env, shape] = force

    return measure_shapes


@functools.cache
def totals(real: type) -> wp.Kernel:
    """Returns the kernel that measures all touches of an environment, in their order. Launch with dim env."""
    p = pile_structs(real)
    Shapes, Lists, Touches = p.Shapes, p.Lists, p.Touches
    Measured = measured(real)

    @unique_kernel()
    def measure_totals(count: wp.int32, shapes: Shapes, lists: Lists, touches: Touches, measured: Measured):
        env = wp.tid()
        contacts = wp.int32(0)
        total = wp.float64(0.0)
        deepest = real(0.0)
        strongest = real(0.0)
        for shape in range(count):
            first = shapes.slot_start[shape]
            for slot in range(first, first + lists.owned[env, shape]):
                if (touches.bits[env, slot] & TOUCHES) != 0:
                    contacts += 1
                    total += wp.float64(touches.normal_force[env, slot])
                    deepest = wp.max(deepest, -touches.gap[env, slot])
                    strongest = wp.max(strongest, touches.normal_force[env, slot])
        measured.contacts[env] = contacts
        measured.normal_force[env] = total
        measured.max_penetration[env] = deepest
        measured.max_normal_force[env] = strongest

    return measure_totals
