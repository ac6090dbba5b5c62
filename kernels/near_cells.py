"""Which contacts a step has to do with, where all meshes have cells: nothing is remembered but what is quiet.

The cell of a point tells at once that it is far away, or which few faces to look at. What no cell tells of is left
to a second launch, which searches: points that lie deep, or beside a boundary.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import near as nearness
from warpcontact.kernels import warps
from warpcontact.kernels.closest_point import AWAY, EITHER, LATER, QUERY
from warpcontact.kernels.types import ENV_ACTIVE, Work, env_of, item_of, natural, structs, task_count
from warpcontact.kernels.unique import unique_kernel

# What ``near.news`` says of a contact that is left to the second launch.
TO_SEARCH = 2
# Registers of a thread of a GPU in float32, so that many of them wait for memory at once; measured.
REGISTERS = 80


@functools.cache
def _functions(real: type, follows: bool, part: str) -> SimpleNamespace:
    """Returns the device functions of ``near.functions``, and those of blocks."""
    t = structs(real)
    Model, Near = t.Model, t.Near
    of_block = nearness.functions(real, follows, part)

    @wp.func
    def gather(model: Model, near: Near, env: int, block: int):
        """Lists the contacts of a block with news, in their order."""
        start = natural(model.block_start[block])
        count = wp.int32(0)
        for place in range(start, model.block_start[block + 1]):
            contact = natural(model.block_contact[place])
            if near.news[env, contact] != 0:
                near.contact[env, start + count] = contact
                count += 1
        near.count[env, block] = count
        return count

    return SimpleNamespace(**vars(of_block), gather=gather)


@functools.cache
def kernel(real: type, follows: bool, width: int, whole: bool) -> wp.Kernel:
    """Returns the kernel that fills ``contacts`` and ``near`` from ``state``; items: blocks.

    Args:
        real: Type of a real number.
        follows: Whether any contact stays with the part of the surface that it touched.
        width: Threads of a block on a GPU, a power of two, one for each of its contacts; 0: one thread for all.
        whole: Whether to search at once for what cells do not tell, and not to leave it to ``rest``.
    """
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, Near, Cache = t.Contacts, t.Near, t.Cache
    of_block = _functions(real, follows, EITHER if whole else AWAY)
    view_of, probe, gather = of_block.view_of, of_block.probe, of_block.gather
    find, tell, news = of_block.find, of_block.tell, of_block.news
    left_of, may_be_left = of_block.left_of, of_block.may_be_left
    View, Found, leave = of_block.View, of_block.Found, of_block.leave
    registers = REGISTERS if width and not whole and real is wp.float32 else None

    @wp.func
    def is_free(model: Model, history: History, env: int, block: int, contact: int, around: real):
        """Whether the middle of its block shows that a contact is far away on the outer side."""
        if not (around > real(0.0)) or not may_be_left(model, history, env, contact):
            return False
        return left_of(model, env, block, contact, around) > real(0.0)

    @wp.func
    def news_of(
        model: Model,
        view: View,
        history: History,
        contacts: Contacts,
        cache: Cache,
        near: Near,
        env: int,
        block: int,
        contact: int,
        around: real,
        quiet: bool,
    ):
        """Looks at a contact; returns whether the rest of the step has to do with it, or ``TO_SEARCH``."""
        result = wp.static(TO_SEARCH)
        # Right before it is written, what this comes with would be long in coming.
        before = contacts.status[env, contact]
        free = is_free(model, history, env, block, contact, around)
        found = Found()
        if not free:
            found = find(model, view, history, True, cache, env, contact)
        if free or found.free != real(LATER):
            # One that was quiet, and is, has nothing to tell.
            if quiet and not found.told and (free or found.armed == history.armed[env, contact]):
                return 0
            if free:
                leave(contacts, env, contact)
            else:
                tell(found, contacts, env, contact)
            result = news(contacts, history, env, contact, before)
        near.news[env, contact] = result
        return result

    @unique_kernel(registers)
    def look_in_cells(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        cache: Cache,
        contacts: Contacts,
        near: Near,
    ):
        if wp.static(width == 0):
            for task in range(wp.tid(), task_count(work), work.threads):
                env = env_of(work, task)
                block = item_of(work, task)
                if status[env] != ENV_ACTIVE:
                    continue
                quiet = cache.block_quiet[env, block] != 0
                view = view_of(model, state, env, natural(model.block_set[block]))
                start = natural(model.block_start[block])
                stop = model.block_start[block + 1]
                around = real(-1.0)
                if stop - start > 1:
                    around = probe(model, view, cache, env, block)
                later = wp.bool(False)
                for place in range(start, stop):
                    contact = natural(model.block_contact[place])
                    new = news_of(model, view, history, contacts, cache, near, env, block, contact, around, quiet)
                    later = later or new == wp.static(TO_SEARCH)
                if later:
                    cache.waiting_block[wp.atomic_add(cache.waiting, 0, 1)] = task
                else:
                    cache.block_quiet[env, block] = wp.where(gather(model, near, env, block) == 0, 1, 0)
        else:
            # The threads of a warp have whole blocks, and all of them have to come by where they vote.
            task = natural(wp.tid()) // wp.static(max(1, width))
            lane = natural(wp.tid()) % wp.static(max(1, width))
            there = task < task_count(work)
            env = wp.int32(0)
            block = wp.int32(0)
            if there:
                env = env_of(work, task)
                block = item_of(work, task)
                there = status[env] == ENV_ACTIVE
            new = wp.int32(0)
            start = wp.int32(0)
            contact = wp.int32(0)
            if there:
                start = natural(model.block_start[block])
                if start + lane < model.block_start[block + 1]:
                    contact = natural(model.block_contact[start + lane])
                    view = view_of(model, state, env, natural(model.block_set[block]))
                    around = real(-1.0)
                    if wp.static(width > 1):
                        around = probe(model, view, cache, env, block)
                    quiet = cache.block_quiet[env, block] != 0
                    new = news_of(model, view, history, contacts, cache, near, env, block, contact, around, quiet)
            later = wp.bool(new == wp.static(TO_SEARCH))
            those = wp.where(new == 1, 1, 0)
            if wp.static(width > 1):
                first = warps.lane() - lane
                later = warps.some(warps.lanes_with(later), first, wp.static(width)) != 0
                those = warps.some(warps.lanes_with(new == 1), first, wp.static(width))
            if there and not later:
                if new == 1:
                    near.contact[env, start + warps.count_of(warps.some(those, 0, lane))] = contact
                if lane == 0:
                    near.count[env, block] = warps.count_of(those)
                    cache.block_quiet[env, block] = wp.where(those == 0, 1, 0)
            if there and later and lane == 0:
                cache.waiting_block[wp.atomic_add(cache.waiting, 0, 1)] = task

    return look_in_cells


@functools.cache
def rest(real: type, follows: bool) -> wp.Kernel:
    """Returns the kernel that searches for what ``kernel`` left, block by block; items: blocks."""
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, Near, Cache = t.Contacts, t.Near, t.Cache
    of_block = _functions(real, follows, QUERY)
    view_of, look, news, gather = of_block.view_of, of_block.look, of_block.news, of_block.gather

    @unique_kernel()
    def search_the_rest(
        work: Work,
        model: Model,
        state: State,
        history: History,
        cache: Cache,
        contacts: Contacts,
        near: Near,
    ):
        for i in range(warps.spread(wp.tid(), work.threads), cache.waiting[0], work.threads):
            task = cache.waiting_block[i]
            env = env_of(work, task)
            block = item_of(work, task)
            view = view_of(model, state, env, natural(model.block_set[block]))
            for place in range(model.block_start[block], model.block_start[block + 1]):
                contact = natural(model.block_contact[place])
                if near.news[env, contact] == wp.static(TO_SEARCH):
                    before = contacts.status[env, contact]
                    look(model, view, history, contacts, True, cache, env, contact)
                    near.news[env, contact] = news(contacts, history, env, contact, before)
            gather(model, near, env, block)
            cache.block_quiet[env, block] = 0

    return search_the_rest
