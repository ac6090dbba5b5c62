"""How far the points of a set moved over their surface: none that was farther away than this can touch it now."""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.types import ENV_ACTIVE, Work, env_of, item_of, natural, structs, task_count
from warpcontact.kernels.unique import unique_kernel

# Rounding of a position, in units of epsilon times the size of what it is computed from.
ROUNDING = 32.0


@functools.cache
def functions(real: type) -> SimpleNamespace:
    """Returns the device functions for ``real``."""
    t = structs(real)
    vec3, quat, Model, State, Cache = t.vec3, t.quat, t.Model, t.State, t.Cache
    frame = frames.functions(real)
    apart, turned, orientation_to_world = frame.apart, frame.turned, frame.orientation_to_world
    epsilon = wp.constant(real(t.epsilon))
    rounding = wp.constant(real(t.epsilon * ROUNDING))

    @wp.struct
    class Seen:
        """Where a set of points is, seen from its surface."""

        position: vec3  # its middle, S [m]
        orientation: quat  # B → S, if it has an extent
        margin: real  # rounding of a position [m]

    @wp.func
    def size(v: vec3):
        """The length of a vector, or up to √3 times that."""
        return wp.abs(v[0]) + wp.abs(v[1]) + wp.abs(v[2])

    @wp.func
    def see(model: Model, state: State, env: int, number: int):
        contact = natural(model.set_contact[number])
        surface = natural(model.patch_surface[natural(model.contact_patch[contact])])
        carrier = model.surface_body[surface]
        o_B = model.surface_position[env, surface]
        q_WS = orientation_to_world(state, env, carrier, model.surface_orientation[env, surface])
        point = natural(model.contact_point[contact])
        body = model.point_body[point]
        c_B = model.set_center[env, number]
        between = apart(model, state, env, point, surface)
        c_W = between + turned(state, env, body, c_B) - turned(state, env, carrier, o_B)
        seen = Seen()
        seen.position = wp.quat_rotate_inv(q_WS, c_W)
        extent = model.set_extent[env, number]
        # A single point is where it is however it turns.
        if extent > real(0.0):
            seen.orientation = wp.quat_inverse(q_WS)
            if body >= 0:
                seen.orientation = seen.orientation * state.body_orientation[env, body]
        seen.margin = rounding * (size(between) + size(c_B) + size(o_B) + extent)
        return seen

    @wp.func
    def moved(model: Model, cache: Cache, env: int, number: int, seen: Seen):
        """How far, at most, any point of the set is from where it was when its travel was last added up [m]."""
        way = wp.length(seen.position - cache.set_position[env, number])
        extent = model.set_extent[env, number]
        if extent > real(0.0):
            # Two rotations, as unit quaternions, move a point at distance 1 from each other by 2 |q − q'| at most.
            last = cache.set_orientation[env, number]
            way += (
                real(2.0) * extent * wp.min(wp.length(seen.orientation - last), wp.length(seen.orientation + last))
            )
        return way * (real(1.0) + real(8.0) * epsilon)

    @wp.func
    def add(model: Model, state: State, cache: Cache, env: int, number: int):
        """Adds up the travel of a set; returns it with the rounding of positions, as it is held against wakes."""
        seen = see(model, state, env, number)
        way = moved(model, cache, env, number, seen)
        before = cache.set_travel[env, number]
        travel = before + way + epsilon * before
        cache.set_position[env, number] = seen.position
        cache.set_orientation[env, number] = seen.orientation
        cache.set_travel[env, number] = travel
        cache.set_step[env, number] = way
        cache.set_margin[env, number] = seen.margin
        return travel + seen.margin

    @wp.func
    def sleeps(model: Model, cache: Cache, env: int, number: int, travelled: real):
        """Whether no point of a set can touch yet."""
        wake = cache.set_wake[env, number]
        if travelled < wake:
            return True
        # Its blocks may have learned more since.
        wake = real(wp.inf)
        block = natural(model.set_block_start[number])
        stop = model.set_block_start[number + 1]
        while block < stop:
            wake = wp.min(wake, cache.block_wake[env, block])
            block = natural(block + 1)
        cache.set_wake[env, number] = wake
        return travelled < wake

    return SimpleNamespace(see=see, moved=moved, add=add, sleeps=sleeps)


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that adds up the travel of every set; items: sets.

    It is seen from the surface, which may move as well. A body that was put elsewhere has travelled there.
    """
    t = structs(real)
    Model, State, Cache = t.Model, t.State, t.Cache
    add, sleeps = functions(real).add, functions(real).sleeps

    @unique_kernel()
    def add_travel(work: Work, status: wp.array(dtype=wp.int32), model: Model, state: State, cache: Cache):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            number = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            travelled = add(model, state, cache, env, number)
            asleep = sleeps(model, cache, env, number, travelled)
            cache.set_asleep[env, number] = wp.where(asleep, 1, 0)

    return add_travel
