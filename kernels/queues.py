"""The same on a GPU, contact by contact: threads side by side do the same kind of work.

Contacts that may touch are put into a queue; what is sure to be nearest is looked at there, and what needs more is
handed on: to the remembered faces, then to a search, each with a queue of its own. Blocks of which nothing is
known are probed before. About meshes with cells, where no faces are remembered, contacts look into their cell, and
what no cell tells of is searched for. In the end each block gathers which of its contacts the rest of the step has
to do with.
"""

import functools

import warp as wp
from warpcontact.kernels import near as nearness
from warpcontact.kernels import warps
from warpcontact.kernels.closest_point import CELL, KNOWN, LATER, LISTED, QUERY, RECALLED, SEARCH
from warpcontact.kernels.types import ENV_ACTIVE, Work, env_of, first_env, item_of, structs, task_count
from warpcontact.kernels.unique import unique_kernel

# Queues of contacts, by what they need; that of blocks to probe comes first.
QUEUE_OF = {KNOWN: 1, RECALLED: 1, CELL: 1, LISTED: 2, SEARCH: 3, QUERY: 3}
# Registers of a search in float32, which would take 200: with so few an H200 holds all its threads at once
# (``schedule.SEARCHING``). They wait for memory most of the time.
SEARCH_REGISTERS = 128
# Of a look into a cell, likewise.
CELL_REGISTERS = 112


@functools.cache
def _put(real: type) -> wp.Function:
    Cache = structs(real).Cache

    @wp.func
    def put(cache: Cache, queue: int, task: int):
        cache.waiting_contact[queue, wp.atomic_add(cache.waiting, queue, 1)] = task

    return put


@functools.cache
def pick(real: type, follows: bool) -> wp.Kernel:
    """Returns the kernel that puts contacts that may touch into the first queue; items: blocks."""
    t = structs(real)
    Model, Cache = t.Model, t.Cache
    unknown = nearness.functions(real, follows, KNOWN).unknown
    put = _put(real)

    @unique_kernel()
    def pick_contacts(
        work: Work, contacts: wp.int32, status: wp.array(dtype=wp.int32), model: Model, cache: Cache
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            member = task // work.items
            env = first_env(work) + member
            block = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            number = model.block_set[block]
            travelled = cache.set_travel[env, number] + cache.set_margin[env, number]
            if cache.set_asleep[env, number] != 0 or travelled < cache.block_wake[env, block]:
                continue
            start = model.block_start[block]
            stop = model.block_start[block + 1]
            if stop - start > 1:  # noqa: SIM102 - Warp computes both sides of an ``and``
                if unknown(model, cache, env, start, stop, travelled):
                    cache.waiting_block[wp.atomic_add(cache.waiting, 0, 1)] = task
                    continue
            for place in range(start, stop):
                contact = model.block_contact[place]
                if not (travelled < cache.wake[env, contact]):
                    put(cache, wp.static(QUEUE_OF[KNOWN]), member * contacts + contact)

    return pick_contacts


@functools.cache
def probe(real: type, follows: bool, celled: bool) -> wp.Kernel:
    """Returns the kernel that looks in the middle of blocks of which nothing is known; items: blocks.

    ``celled``: whether all meshes have cells, which tell; else it searches.
    """
    t = structs(real)
    Model, State, History, Contacts, Near, Cache = t.Model, t.State, t.History, t.Contacts, t.Near, t.Cache
    block_of = nearness.functions(real, follows, CELL if celled else KNOWN)
    view_of, probe, wake_of, news = block_of.view_of, block_of.probe, block_of.wake_of, block_of.news
    free_around, longer_wake = block_of.free_around, block_of.longer_wake
    put = _put(real)

    @unique_kernel()
    def probe_blocks(
        work: Work,
        items: wp.int32,
        model: Model,
        state: State,
        history: History,
        cache: Cache,
        contacts: Contacts,
        near: Near,
    ):
        for i in range(warps.spread(wp.tid(), work.threads), cache.waiting[0], work.threads):
            task = cache.waiting_block[i]
            member = task // work.items
            env = first_env(work) + member
            block = item_of(work, task)
            number = model.block_set[block]
            travel = cache.set_travel[env, number]
            travelled = travel + cache.set_margin[env, number]
            around = probe(model, view_of(model, state, env, number), cache, env, block)
            for place in range(model.block_start[block], model.block_start[block + 1]):
                contact = model.block_contact[place]
                if travelled < cache.wake[env, contact]:
                    longer_wake(model, history, cache, env, block, contact, travel, around)
                else:
                    before = contacts.status[env, contact]
                    free = free_around(model, history, contacts, cache, env, block, contact, around)
                    if free < real(0.0):
                        put(cache, wp.static(QUEUE_OF[KNOWN]), member * items + contact)
                    else:
                        cache.wake[env, contact] = wake_of(travel, free)
                        near.news[env, contact] = news(contacts, history, env, contact, before)

    return probe_blocks


@functools.cache
def work_off(real: type, follows: bool, part: str, next_part: str) -> wp.Kernel:
    """Returns the kernel that looks at the contacts in the queue of ``part`` or hands them on; items: contacts."""
    t = structs(real)
    Model, State, History, Contacts, Near, Cache = t.Model, t.State, t.History, t.Contacts, t.Near, t.Cache
    block_of = nearness.functions(real, follows, part)
    view_of, look, wake_of, news = block_of.view_of, block_of.look, block_of.wake_of, block_of.news
    put = _put(real)
    queue, next_queue = QUEUE_OF[part], QUEUE_OF[next_part]
    registers = {SEARCH: SEARCH_REGISTERS, QUERY: SEARCH_REGISTERS, CELL: CELL_REGISTERS}.get(part)
    registers = registers if real is wp.float32 else None

    @unique_kernel(registers)
    def look_at_contacts(
        work: Work,
        model: Model,
        state: State,
        history: History,
        cache: Cache,
        contacts: Contacts,
        near: Near,
    ):
        thread = wp.tid()
        if wp.static(part in (SEARCH, QUERY)):
            thread = warps.spread(thread, work.threads)
        for i in range(thread, cache.waiting[queue], work.threads):
            task = cache.waiting_contact[queue, i]
            env = env_of(work, task)
            contact = item_of(work, task)
            number = model.contact_set[contact]
            view = view_of(model, state, env, number)
            before = contacts.status[env, contact]
            free = look(model, view, history, contacts, True, cache, env, contact)
            if wp.static(part not in (SEARCH, QUERY)) and free == real(LATER):
                put(cache, next_queue, task)
            else:
                cache.wake[env, contact] = wake_of(cache.set_travel[env, number], free)
                near.news[env, contact] = news(contacts, history, env, contact, before)
                if wp.static(part in (CELL, QUERY)):
                    # Of what is near a look in the middle of its block tells nothing.
                    size = view.scale * model.patch_cells_size[view.patch]
                    cache.faces[env, contact] = wp.where(free < size, 1, 0)

    return look_at_contacts


@functools.cache
def gather(real: type) -> wp.Kernel:
    """Returns the kernel that lists in ``near`` what was found; items: blocks."""
    t = structs(real)
    Model, Near, Cache = t.Model, t.Near, t.Cache

    @unique_kernel()
    def gather_contacts(work: Work, status: wp.array(dtype=wp.int32), model: Model, cache: Cache, near: Near):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            block = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            number = model.block_set[block]
            travelled = cache.set_travel[env, number] + cache.set_margin[env, number]
            if cache.set_asleep[env, number] != 0 or travelled < cache.block_wake[env, block]:
                near.count[env, block] = 0
                continue
            start = model.block_start[block]
            count = wp.int32(0)
            wake = real(wp.inf)
            for place in range(start, model.block_start[block + 1]):
                contact = model.block_contact[place]
                wake = wp.min(wake, cache.wake[env, contact])
                if near.news[env, contact] != 0:
                    near.contact[env, start + count] = contact
                    count += 1
            near.count[env, block] = count
            # What is new is told until history has it; a step may be taken again.
            cache.block_wake[env, block] = wp.where(count > 0, real(0.0), wake)

    return gather_contacts
