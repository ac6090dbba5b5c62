"""Which contacts a step has to do with: blocks and points that cannot touch yet are left alone.

A point can only touch after it moved as far as it was from touching when it was looked at; ``travel.py`` says how
far it can have moved. What is near is looked at by ``closest_point.py``: here by one thread for a whole block, on
a GPU contact by contact, by ``queues.py``.
"""

import functools
from types import SimpleNamespace

import warp as wp
from warpcontact.kernels import cells, search, tree
from warpcontact.kernels import closest_point as closest
from warpcontact.kernels import foot as feet
from warpcontact.kernels.closest_point import AWAY, CELL, EITHER, FEW, FOLLOWS, WHOLE
from warpcontact.kernels.sides import room_on_side as sides_of
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    LATCHED,
    Work,
    env_of,
    item_of,
    natural,
    structs,
    task_count,
)
from warpcontact.kernels.unique import unique_kernel


@functools.cache
def functions(real: type, follows: bool, part: str) -> SimpleNamespace:
    """Returns the device functions for ``real``; ``follows`` and ``part`` are those of ``closest_point``."""
    t = structs(real)
    Model, History, Contacts, Near, Cache = t.Model, t.History, t.Contacts, t.Near, t.Cache
    contact_of = closest.functions(real, follows, part)
    View, view_of = contact_of.View, contact_of.view_of
    leave = contact_of.leave
    of_search, of_tree = search.functions(real), tree.functions(real)
    extent_of, unsure_of = of_search.extent_of, of_search.unsure_of
    nearest_of_all = of_search.nearest_of_all
    nearest, rounding_of = of_tree.nearest, of_tree.rounding_of
    room_on_side, cell_at = sides_of(real), cells.functions(real).cell_at
    foot_on, inner = feet.functions(real).foot_on, feet.functions(real).inner
    rounded_down = wp.constant(real(1.0 - 4.0 * t.epsilon))
    rounded_up = wp.constant(real(1.0 + 16.0 * t.epsilon))

    @wp.func
    def probe(model: Model, view: View, cache: Cache, env: int, block: int):
        """How far a point in the middle of a block is from coming to touch, or to be on the inner side [m].

        All that lies nearer to it than this is as free. Negative: nothing is known.
        """
        patch = view.patch
        c_W = view.apart_W + view.R_WB * model.block_center[env, block]
        c_S = view.per_scale * (wp.transpose(view.R_WS) * c_W)
        if wp.static(part in (CELL, AWAY, EITHER)):
            # Where that is little, each point looks into its own.
            return view.scale * cell_at(model, patch, c_S).free
        extent = extent_of(c_S)
        if wp.static(part == WHOLE):
            hint = cache.nearest[env, natural(model.block_contact[natural(model.block_start[block])])]
            foot = nearest(model, patch, c_S, hint)
            if not (foot.distance < real(wp.inf)):
                return real(-1.0)
            unsure = rounding_of(extent, foot)
        else:
            query = wp.mesh_query_point_no_sign(
                model.patch_mesh[patch],
                wp.vec3f(wp.float32(c_S[0]), wp.float32(c_S[1]), wp.float32(c_S[2])),
                wp.float32(wp.inf),
            )
            if not query.result:
                return real(-1.0)
            foot = foot_on(model, view.start + query.face, c_S)
            unsure = unsure_of(model, patch, extent, foot.distance)
            if wp.static(real is wp.float64) or model.patch_thin[patch] > real(0.0):
                # One that the query takes for as near may show the other side.
                foot = nearest_of_all(model, patch, c_S, foot, unsure)
        if inner(model, foot):
            return real(-1.0)
        return view.scale * wp.min(foot.distance - unsure, room_on_side(model, patch, c_S))

    @wp.func
    def left_of(model: Model, env: int, block: int, contact: int, around: real):
        """What is left of ``around``, which is for the middle of a block, for one of its contacts [m]."""
        arm_B = model.point_position[env, natural(model.contact_point[contact])] - model.block_center[env, block]
        geometry = model.contact_geometry[env, contact]
        return around - rounded_up * wp.length(arm_B) - (geometry.radius + geometry.closed)

    @wp.func
    def way_to_use(model: Model, env: int, start: int, stop: int, block: int, around: real):
        """How far the points of a block have to come until their middle, with ``around``, may tell of any [m]."""
        least = real(wp.inf)
        for place in range(start, stop):
            least = wp.min(least, around - left_of(model, env, block, natural(model.block_contact[place]), around))
        return wp.max(least / real(1.0 - FEW) - around, real(0.0))

    @wp.func
    def to_be_armed(model: Model, history: History, env: int, contact: int):
        """Whether a latched contact is not armed yet: a look has to tell when it comes into sight."""
        if wp.static(follows):
            return (model.contact_options[contact] & LATCHED) != 0 and history.armed[env, contact] == 0
        return False

    @wp.func
    def may_be_left(model: Model, history: History, env: int, contact: int):
        """Whether a contact is of no concern if it is far away on the outer side, as its surroundings are.

        One that stays with the face that it touched is on the inner side of that, wherever it is; another may have
        to be armed.
        """
        if wp.static(follows):
            if (model.contact_options[contact] & FOLLOWS) != 0 and history.face[env, contact] >= 0:
                return False
            if to_be_armed(model, history, env, contact):
                return False
        return model.contact_geometry[env, contact].enabled != 0

    @wp.func
    def free_around(
        model: Model,
        history: History,
        contacts: Contacts,
        cache: Cache,
        env: int,
        block: int,
        contact: int,
        around: real,
    ):
        """Fills ``contacts`` for one that is far away on the outer side, as the middle of its block shows.

        Returns how far its point can move and not touch [m]; negative: nothing is known, and nothing was filled.
        """
        if not (around > real(0.0)) or cache.faces[env, contact] != 0:
            return real(-1.0)
        if not may_be_left(model, history, env, contact):
            return real(-1.0)
        free = left_of(model, env, block, contact, around)
        if not (free > real(FEW) * around):
            return real(-1.0)
        leave(contacts, env, contact)
        return free

    @wp.func
    def wake_of(travel: real, free: real):
        """Travel up to which a contact that is ``free`` cannot touch [m]."""
        if not (free > real(0.0)):
            return real(0.0)
        return rounded_down * (travel + free)

    @wp.func
    def longer_wake(
        model: Model,
        history: History,
        cache: Cache,
        env: int,
        block: int,
        contact: int,
        travel: real,
        around: real,
    ):
        """Lets a contact that is asleep sleep longer if the middle of its block shows that it can."""
        wake = cache.wake[env, contact]
        if to_be_armed(model, history, env, contact):
            return wake
        if around > real(0.0):
            longer = rounded_down * (travel + left_of(model, env, block, contact, around))
            if longer > wake:
                wake = longer
                cache.wake[env, contact] = wake
        return wake

    @wp.func
    def unknown(model: Model, cache: Cache, env: int, start: int, stop: int, travelled: real):
        """Whether some contact of a block is awake and no faces near it are known."""
        for place in range(start, stop):
            contact = natural(model.block_contact[place])
            if cache.faces[env, contact] == 0 and not (travelled < cache.wake[env, contact]):
                return True
        return False

    @wp.func
    def news(contacts: Contacts, history: History, env: int, contact: int, before: int):
        """1 if the rest of the step has to do with a contact: it touches, or did, or its latch moved; or 0.

        ``before`` is its status when it was looked at last, not necessarily in an accepted step.
        """
        latch = contacts.armed[env, contact] != history.armed[env, contact]
        touched = before == CONTACT or history.entry_speed[env, contact] >= real(0.0)
        return wp.where(latch or touched or contacts.status[env, contact] == CONTACT, 1, 0)

    @wp.func
    def around_of(
        model: Model,
        view: View,
        cache: Cache,
        env: int,
        block: int,
        start: int,
        stop: int,
        travel: real,
        travelled: real,
    ):
        """What ``probe`` tells of a block, where that may do for some of its contacts; negative: nothing is known.

        One search in the middle may do for all that are far from where they last touched.
        """
        if stop - start > 1 and travel >= cache.block_probe[env, block]:  # noqa: SIM102
            # (Nested, as Warp computes both sides of an ``and``.)
            if unknown(model, cache, env, start, stop, travelled):
                return probe(model, view, cache, env, block)
        return real(-1.0)

    @wp.func
    def settle(
        history: History,
        contacts: Contacts,
        cache: Cache,
        near: Near,
        env: int,
        contact: int,
        travel: real,
        free: real,
        before: int,
    ):
        """Remembers what was found of a contact; returns the travel up to which it may be left alone [m]."""
        wake = wake_of(travel, free)
        cache.wake[env, contact] = wake
        near.news[env, contact] = news(contacts, history, env, contact, before)
        return wake

    @wp.func
    def settle_block(
        model: Model,
        cache: Cache,
        env: int,
        block: int,
        start: int,
        stop: int,
        travel: real,
        around: real,
        of_use: bool,
        new: int,
        first_wake: real,
    ):
        """Remembers of a block when it has to be looked at again, and when in its middle."""
        if around >= real(0.0) and not of_use:
            cache.block_probe[env, block] = travel + way_to_use(model, env, start, stop, block, around)
        # What is new is told until history has it; a step may be taken again.
        cache.block_wake[env, block] = wp.where(new > 0, real(0.0), first_wake)

    return SimpleNamespace(
        View=View,
        view_of=view_of,
        Found=contact_of.Found,
        find=contact_of.find,
        tell=contact_of.tell,
        look=contact_of.look,
        leave=leave,
        left_of=left_of,
        may_be_left=may_be_left,
        probe=probe,
        way_to_use=way_to_use,
        free_around=free_around,
        wake_of=wake_of,
        longer_wake=longer_wake,
        unknown=unknown,
        news=news,
        around_of=around_of,
        settle=settle,
        settle_block=settle_block,
    )


@functools.cache
def kernel(real: type, follows: bool) -> wp.Kernel:
    """Returns the kernel that fills ``contacts`` and ``near`` from ``state``; items: blocks.

    With ``cached`` it looks only at points that may touch, and remembers what it finds: contacts that it leaves
    out do not touch and did not in the last step, and ``near`` lists the others. Without, it looks at all, lists
    all, and tells gap, normal and point of those that are far away as well. Of the others the outcome is the same.

    Args:
        real: Type of a real number.
        follows: Whether any contact stays with the part of the surface that it touched.
    """
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, Near, Cache = t.Contacts, t.Near, t.Cache
    block_of = functions(real, follows, WHOLE)
    view_of, look, around_of = block_of.view_of, block_of.look, block_of.around_of
    free_around, longer_wake = block_of.free_around, block_of.longer_wake
    settle, settle_block = block_of.settle, block_of.settle_block

    @unique_kernel()
    def closest_point(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state: State,
        history: History,
        cached: wp.bool,
        cache: Cache,
        contacts: Contacts,
        near: Near,
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            block = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            count = wp.int32(0)
            new = wp.int32(0)
            number = natural(model.block_set[block])
            travel = real(0.0)
            travelled = real(0.0)
            if cached:
                travel = cache.set_travel[env, number]
                travelled = travel + cache.set_margin[env, number]
                if cache.set_asleep[env, number] != 0 or travelled < cache.block_wake[env, block]:
                    near.count[env, block] = 0
                    continue
            start = natural(model.block_start[block])
            stop = model.block_start[block + 1]
            view = view_of(model, state, env, number)
            around = real(-1.0)
            if cached:
                around = around_of(model, view, cache, env, block, start, stop, travel, travelled)
            of_use = wp.bool(False)
            first_wake = real(wp.inf)
            for place in range(start, stop):
                contact = natural(model.block_contact[place])
                if cached and travelled < cache.wake[env, contact]:
                    wake = longer_wake(model, history, cache, env, block, contact, travel, around)
                    first_wake = wp.min(first_wake, wake)
                else:
                    before = contacts.status[env, contact]
                    free = real(-1.0)
                    if cached:
                        free = free_around(model, history, contacts, cache, env, block, contact, around)
                    if free >= real(0.0):
                        of_use = True
                    else:
                        free = look(model, view, history, contacts, cached, cache, env, contact)
                    if cached:
                        wake = settle(history, contacts, cache, near, env, contact, travel, free, before)
                        first_wake = wp.min(first_wake, wake)
                    elif contacts.status[env, contact] == CONTACT:
                        # A later look with ``cached`` may not leave it out.
                        cache.wake[env, contact] = real(0.0)
                        new += 1
                if cached:
                    new += near.news[env, contact]
                if not cached or near.news[env, contact] != 0:
                    near.contact[env, start + count] = contact
                    count += 1
            near.count[env, block] = count
            if cached:
                settle_block(model, cache, env, block, start, stop, travel, around, of_use, new, first_wake)
            elif new > 0:
                cache.block_wake[env, block] = real(0.0)
                cache.block_quiet[env, block] = 0
                cache.set_wake[env, number] = real(0.0)

    return closest_point
