"""Makes the lists of partners anew where any shape has moved by half the skin since they were made.

Nothing is decided on the host: the kernels come with every step, and return at once for environments whose lists
still hold. Shapes are sorted into cells, cells into buckets by a hash; partners are sorted by their number, so the
lists are the same whatever order threads come in. What is remembered of a pair moves with it, and a pair with a
memory stays, however far apart it is now.

Conditions are nested where Warp, which looks at both sides of ``and``, would read beyond an array.

    check → clear → fill → gather → [carry_impulses] → carry → join
"""

import functools

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.piles import meeting
from warpcontact.kernels.piles.base import NONE, TOUCHED, Form, owns, pile_structs
from warpcontact.kernels.piles.history import copy_memory
from warpcontact.kernels.touch import Parts, group_structs
from warpcontact.kernels.types import ENV_ACTIVE, Work, env_of, item_of, structs, task_count
from warpcontact.kernels.unilateral.records import record_structs
from warpcontact.kernels.unique import unique_kernel

# Of half the skin, what a shape may move before lists are stale: the rest is for rounding.
SHARE_OF_SKIN = 0.49
# Cells are numbered in a ring of this many.
RING = 1 << 30


@wp.func
def bucket_of(cell: wp.vec3i, buckets: int):
    """Bucket of a cell; ``buckets`` is a power of two."""
    # Without signs: products of signed numbers must not overflow, and compilers rely on it.
    x = wp.uint32(cell[0]) * wp.uint32(73856093)
    y = wp.uint32(cell[1]) * wp.uint32(19349663)
    z = wp.uint32(cell[2]) * wp.uint32(83492791)
    return wp.int32((x ^ y ^ z) & wp.uint32(buckets - 1))


@functools.cache
def check(form: Form, real: type) -> wp.Kernel:
    """Returns the kernel that finds environments whose lists do not hold; items: shapes."""
    t = structs(real)
    State = t.State
    p = pile_structs(real)
    Shapes, Grid = p.Shapes, p.Grid
    spot = meeting.functions(form, real).spot
    long = form.long

    @unique_kernel()
    def check_pile(work: Work, status: wp.array(dtype=wp.int32), state: State, shapes: Shapes, grid: Grid):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            shape = item_of(work, task)
            if status[env] != ENV_ACTIVE or grid.stale[env] != 0:
                continue
            if grid.known[env] == 0:
                grid.stale[env] = 1
                continue
            now = spot(shapes, state, env, shape)
            moved = (now.base - grid.base[env, shape]) + (now.rest - grid.rest[env, shape])
            most = real(SHARE_OF_SKIN) * shapes.settings[env, 0].skin
            if wp.static(long):
                # No point of an axis moves farther than one of its ends.
                turned = now.axis - grid.axis[env, shape]
                if wp.length(moved + turned) > most or wp.length(moved - turned) > most:
                    grid.stale[env] = 1
            elif wp.length_sq(moved) > most * most:
                grid.stale[env] = 1

    return check_pile


@functools.cache
def clear(real: type) -> wp.Kernel:
    """Returns the kernel that empties the buckets; items: buckets."""
    Grid = pile_structs(real).Grid

    @unique_kernel()
    def clear_buckets(work: Work, status: wp.array(dtype=wp.int32), grid: Grid):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            if status[env] == ENV_ACTIVE and grid.stale[env] != 0:
                grid.head[env, item_of(work, task)] = NONE

    return clear_buckets


@functools.cache
def fill(form: Form, real: type) -> wp.Kernel:
    """Returns the kernel that puts shapes into buckets and remembers where they are; items: shapes."""
    t = structs(real)
    State = t.State
    p = pile_structs(real)
    Shapes, Grid = p.Shapes, p.Grid
    spot = meeting.functions(form, real).spot
    wide = frames.functions(real).wide
    long = form.long

    @wp.func
    def cell_along(x: wp.float64, cell: wp.float64):
        return wp.int32(wp.int64(wp.floor(x / cell)) & wp.int64(wp.static(RING - 1)))

    @unique_kernel()
    def fill_buckets(
        work: Work, status: wp.array(dtype=wp.int32), buckets: wp.int32, state: State, shapes: Shapes, grid: Grid
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            shape = item_of(work, task)
            if status[env] != ENV_ACTIVE or grid.stale[env] == 0:
                continue
            now = spot(shapes, state, env, shape)
            grid.base[env, shape] = now.base
            grid.rest[env, shape] = now.rest
            if wp.static(long):
                grid.axis[env, shape] = now.axis
            place = wide(now.base) + wide(now.rest)
            size = wp.float64(shapes.settings[env, 0].cell)
            cell = wp.vec3i(cell_along(place[0], size), cell_along(place[1], size), cell_along(place[2], size))
            grid.cell[env, shape] = cell
            grid.link[env, shape] = wp.atomic_exch(grid.head, env, bucket_of(cell, buckets), shape)
            if shape == 0:
                grid.made[env] = grid.made[env] + 1

    return fill_buckets


@functools.cache
def gather(form: Form, real: type) -> wp.Kernel:
    """Returns the kernel that looks for the partners of a shape; items: shapes.

    The lists in force are not changed.
    """
    t = structs(real)
    State = t.State
    p = pile_structs(real)
    Shapes, Lists, Touches, Grid = p.Shapes, p.Lists, p.Touches, p.Grid
    found = meeting.functions(form, real)
    spot, nearest = found.spot, found.nearest

    @wp.func
    def insert(grid: Grid, env: int, start: int, room: int, count: int, key: int):
        """Puts a key into its place; returns how many there are, or would be if there were room."""
        last = wp.min(count, room)
        place = start + last
        before = wp.int32(NONE)
        while place > start:
            before = grid.key[env, place - 1]
            if before <= key:
                break
            place -= 1
        if place > start and before == key:
            return count
        if last == room:
            return count + 1
        k = start + last
        while k > place:
            grid.key[env, k] = grid.key[env, k - 1]
            k -= 1
        grid.key[env, place] = key
        return count + 1

    @wp.func
    def key_of(shape: int, partner: int, shapes: int):
        if owns(shape, partner):
            return partner
        return partner + shapes

    @unique_kernel()
    def gather_partners(
        work: Work,
        status: wp.array(dtype=wp.int32),
        buckets: wp.int32,
        state: State,
        shapes: Shapes,
        lists: Lists,
        touches: Touches,
        grid: Grid,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            shape = item_of(work, task)
            if status[env] != ENV_ACTIVE or grid.stale[env] == 0:
                continue
            own = spot(shapes, state, env, shape)
            cell = grid.cell[env, shape]
            kind = shapes.kind[shape]
            body = shapes.body[shape]
            reach = shapes.radius[env, shape] + shapes.settings[env, 0].skin
            start = shapes.entry_start[shape]
            room = shapes.entry_start[shape + 1] - start
            count = wp.int32(0)
            for number in range(27):
                near = wp.vec3i(
                    (cell[0] + number % 3 - 1) & wp.static(RING - 1),
                    (cell[1] + (number // 3) % 3 - 1) & wp.static(RING - 1),
                    (cell[2] + number // 9 - 1) & wp.static(RING - 1),
                )
                other = grid.head[env, bucket_of(near, buckets)]
                while other != NONE:
                    of_other = grid.cell[env, other]
                    if of_other[0] == near[0] and of_other[1] == near[1] and of_other[2] == near[2]:  # noqa: SIM102
                        if other != shape and shapes.body[other] != body:  # noqa: SIM102
                            if shapes.allowed[kind, shapes.kind[other]] != 0:
                                pair = nearest(own, spot(shapes, state, env, other))
                                if wp.length(pair.apart) < reach + shapes.radius[env, other]:
                                    key = key_of(shape, other, work.items)
                                    count = insert(grid, env, start, room, count, key)
                    other = grid.link[env, other]
            # Wherever it is in this state, which may be one that is only tried.
            first_slot = shapes.slot_start[shape]
            for k in range(lists.count[env, shape]):
                slot = first_slot + k
                if k >= lists.owned[env, shape]:
                    slot = lists.slot[env, start + k]
                if slot >= 0:  # noqa: SIM102
                    if (touches.bits[env, slot] & TOUCHED) != 0:
                        key = key_of(shape, lists.partner[env, start + k], work.items)
                        count = insert(grid, env, start, room, count, key)
            count_that_fit = wp.min(count, room)
            lacking = count - count_that_fit
            owned = wp.int32(0)
            for k in range(count_that_fit):
                if grid.key[env, start + k] < work.items:
                    owned += 1
            records = shapes.slot_start[shape + 1] - first_slot
            lacking = wp.max(lacking, owned - records)
            grid.keys[env, shape] = count_that_fit
            if lacking > 0:
                wp.atomic_max(grid.missing, env, lacking)

    return gather_partners


@functools.cache
def carry(parts: Parts, real: type) -> wp.Kernel:
    """Returns the kernel that puts the new lists in force, and moves what is remembered; items: shapes."""
    p = pile_structs(real)
    Shapes, Lists, Touches, Grid = p.Shapes, p.Lists, p.Touches, p.Grid
    _, Memory = group_structs(parts, real)
    copy = copy_memory(parts, real)

    @unique_kernel()
    def carry_history(
        work: Work,
        status: wp.array(dtype=wp.int32),
        shapes: Shapes,
        lists: Lists,
        touches: Touches,
        grid: Grid,
        kept: Memory,
        memory: Memory,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            shape = item_of(work, task)
            if status[env] != ENV_ACTIVE or grid.stale[env] == 0:
                continue
            start = shapes.entry_start[shape]
            first = shapes.slot_start[shape]
            count = grid.keys[env, shape]
            before = lists.owned[env, shape]
            records = shapes.slot_start[shape + 1] - first
            owned = wp.int32(0)
            old = wp.int32(0)
            # What the force stage will write anew holds it meanwhile: both lists share their records.
            for k in range(count):
                key = grid.key[env, start + k]
                if key >= work.items or owned == records:
                    break
                owned += 1
                while old < before:
                    if lists.partner[env, start + old] >= key:
                        break
                    old += 1
                speed = real(-1.0)
                if old < before:  # noqa: SIM102
                    if lists.partner[env, start + old] == key:  # noqa: SIM102
                        if (touches.bits[env, first + old] & TOUCHED) != 0:
                            speed = touches.entry_speed[env, first + old]
                            copy(memory, first + old, kept, first + k, env)
                touches.approach_speed[env, first + k] = speed
            busy = wp.int32(0)
            for k in range(owned):
                speed = touches.approach_speed[env, first + k]
                touches.bits[env, first + k] = 0
                if speed >= real(0.0):
                    busy = TOUCHED
                    touches.bits[env, first + k] = TOUCHED
                    touches.entry_speed[env, first + k] = speed
                    copy(kept, first + k, memory, first + k, env)
            for k in range(count):
                key = grid.key[env, start + k]
                lists.partner[env, start + k] = wp.where(key < work.items, key, key - work.items)
            touches.busy[env, shape] = busy
            lists.owned[env, shape] = owned
            lists.count[env, shape] = count

    return carry_history


@functools.cache
def carry_impulses(real: type) -> wp.Kernel:
    """Returns the kernel that moves what is remembered of hard pairs, before the new lists are in force.

    Items: shapes. Both lists are sorted, so that what moves down its records, and then what moves up, overwrites
    nothing that is to move yet.
    """
    p = pile_structs(real)
    Shapes, Lists, Grid = p.Shapes, p.Lists, p.Grid
    Memories = record_structs(real).Memories

    @wp.func
    def forget(memory: Memories, env: int, number: int):
        # No step has this number.
        memory[env, number].stamp = 0

    @wp.func
    def move(memory: Memories, env: int, source: int, target: int):
        memory[env, target] = memory[env, source]
        forget(memory, env, source)

    @unique_kernel()
    def carry_pile_impulses(
        work: Work,
        status: wp.array(dtype=wp.int32),
        shapes: Shapes,
        lists: Lists,
        grid: Grid,
        first: wp.int32,  # number of the contact of the first record
        memory: Memories,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            shape = item_of(work, task)
            if status[env] != ENV_ACTIVE or grid.stale[env] == 0:
                continue
            start = shapes.entry_start[shape]
            slot = shapes.slot_start[shape]
            number = first + slot
            before = lists.owned[env, shape]
            room = wp.min(grid.keys[env, shape], shapes.slot_start[shape + 1] - slot)
            owned = wp.int32(0)
            old = wp.int32(0)
            while owned < room:
                key = grid.key[env, start + owned]
                if key >= work.items:
                    break
                while old < before:
                    if lists.partner[env, start + old] >= key:
                        break
                    forget(memory, env, number + old)
                    old += 1
                if old < before:  # noqa: SIM102
                    if lists.partner[env, start + old] == key:
                        old += 1
                owned += 1
            while old < before:
                forget(memory, env, number + old)
                old += 1

            old = wp.int32(0)
            for new in range(owned):
                key = grid.key[env, start + new]
                while old < before:
                    if lists.partner[env, start + old] >= key:
                        break
                    old += 1
                if new < old and old < before:  # noqa: SIM102
                    if lists.partner[env, start + old] == key:
                        move(memory, env, number + old, number + new)
            old = before - 1
            for place in range(owned):
                new = owned - 1 - place
                key = grid.key[env, start + new]
                while old >= 0:
                    if lists.partner[env, start + old] <= key:
                        break
                    old -= 1
                if old >= 0 and old < new:  # noqa: SIM102
                    if lists.partner[env, start + old] == key:
                        move(memory, env, number + old, number + new)

    return carry_pile_impulses


@functools.cache
def join(real: type) -> wp.Kernel:
    """Returns the kernel that finds the records of pairs that a shape does not own; items: shapes."""
    p = pile_structs(real)
    Shapes, Lists, Grid = p.Shapes, p.Lists, p.Grid

    @unique_kernel()
    def join_lists(work: Work, status: wp.array(dtype=wp.int32), shapes: Shapes, lists: Lists, grid: Grid):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            shape = item_of(work, task)
            if status[env] != ENV_ACTIVE or grid.stale[env] == 0:
                continue
            start = shapes.entry_start[shape]
            for k in range(lists.owned[env, shape], lists.count[env, shape]):
                partner = lists.partner[env, start + k]
                begin = shapes.entry_start[partner]
                low = wp.int32(0)
                high = lists.owned[env, partner]
                while low < high:
                    middle = (low + high) // 2
                    if lists.partner[env, begin + middle] < shape:
                        low = middle + 1
                    else:
                        high = middle
                slot = wp.int32(NONE)
                if low < lists.owned[env, partner]:  # noqa: SIM102
                    if lists.partner[env, begin + low] == shape:
                        slot = shapes.slot_start[partner] + low
                lists.slot[env, start + k] = slot

    return join_lists
