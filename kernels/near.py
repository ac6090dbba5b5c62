"""Which contacts a step has to do with: blocks and points that cannot touch yet are left alone.

A point can only touch after it moved as far as it was from touching when it was looked at; ``travel.py`` says how
far it can have moved. What is near is looked at by ``closest_point.py``.
"""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels import closest_point as closest
from warpcontact.kernels import foot as feet
from warpcontact.kernels.closest_point import LATER, ROUNDING
from warpcontact.kernels.types import CONTACT, ENV_ACTIVE, INLINED, OPEN, SWEPT, Work, structs

# Of what a block is free by: a contact with less left would soon be looked at again.
FEW = 0.25


@functools.cache
def kernel(real: type, follows: bool, part: str = "whole") -> wp.Kernel:
    """Returns the kernel that fills ``contacts`` and ``near`` from ``state``; items: blocks.

    With ``cached`` it looks only at points that may touch, and remembers what it finds: contacts that it leaves
    out do not touch and did not in the last step, and ``near`` lists the others. The outcome is the same.

    Args:
        real: Type of a real number.
        follows: Whether any contact stays with the part of the surface that it touched.
        part: ``"whole"``; or ``"known"``, which puts off the blocks that need a search, and then ``"rest"``.
    """
    t = structs(real)
    Model, State, History = t.Model, t.State, t.History
    Contacts, Near, Cache = t.Contacts, t.Near, t.Cache
    contact_of = closest.functions(real, follows, part)
    View, view_of, room_on_side, look = (
        contact_of.View,
        contact_of.view_of,
        contact_of.room_on_side,
        contact_of.look,
    )
    foot_on, inner = feet.functions(real).foot_on, feet.functions(real).inner
    query_epsilon = wp.constant(real(float(np.finfo(np.float32).eps) * ROUNDING))
    rounded_down = wp.constant(real(1.0 - 4.0 * t.epsilon))
    rounded_up = wp.constant(real(1.0 + 16.0 * t.epsilon))

    @wp.func
    def probe(model: Model, view: View, env: int, block: int):
        """How far a point in the middle of a block is from coming to touch, or to be on the inner side [m].

        All that lies nearer to it than this is as free. Negative: nothing is known.
        """
        patch = view.patch
        c_W = view.apart_W + view.R_WB * model.block_center[env, block]
        c_S = view.per_scale * (wp.transpose(view.R_WS) * c_W)
        query = wp.mesh_query_point_no_sign(
            model.patch_mesh[patch],
            wp.vec3f(wp.float32(c_S[0]), wp.float32(c_S[1]), wp.float32(c_S[2])),
            wp.float32(wp.inf),
        )
        if not query.result:
            return real(-1.0)
        foot = foot_on(model, view.start + query.face, c_S)
        extent = wp.max(wp.max(wp.abs(c_S[0]), wp.abs(c_S[1])), wp.abs(c_S[2]))
        unsure = model.patch_slack[patch] + query_epsilon * (extent + foot.distance)
        if inner(model, foot):
            return real(-1.0)
        return view.scale * wp.min(foot.distance - unsure, room_on_side(model, patch, c_S))

    @wp.func
    def left_of(model: Model, env: int, block: int, contact: int, around: real):
        """What is left of ``around``, which is for the middle of a block, for one of its contacts [m]."""
        arm_B = model.point_position[env, model.contact_point[contact]] - model.block_center[env, block]
        return around - rounded_up * wp.length(arm_B) - model.contact_geometry[env, contact].radius

    @wp.func
    def leave(contacts: Contacts, env: int, contact: int):
        """Fills ``contacts`` for one that is far away on the outer side."""
        contacts.status[env, contact] = OPEN
        contacts.penetration[env, contact] = real(0.0)
        contacts.armed[env, contact] = 1

    @wp.func
    def changed(contacts: Contacts, history: History, env: int, contact: int):
        """Whether a contact that does not touch has something to tell: it did, or its latch moved."""
        latch = contacts.armed[env, contact] != history.armed[env, contact]
        return latch or history.entry_speed[env, contact] >= real(0.0)

    @wp.func
    def put_off(cache: Cache, task: int):
        cache.waiting_task[wp.atomic_add(cache.waiting, 0, 1)] = task

    @wp.kernel(module="unique", enable_backward=False, module_options=INLINED)
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
        tasks = work.tasks
        if wp.static(part == "rest"):
            tasks = cache.waiting[0]
        thread = wp.tid()
        if wp.static(part == "rest"):
            # Searches go different ways: as few as may be side by side in a warp.
            warps = (work.threads + 31) // 32
            thread = (thread % 32) * warps + thread // 32
        for i in range(thread, tasks, work.threads):
            task = i
            if wp.static(part == "rest"):
                task = cache.waiting_task[i]
            env = work.first + task // work.items
            block = task % work.items
            if status[env] != ENV_ACTIVE:
                continue
            count = wp.int32(0)
            number = model.block_set[block]
            travel = real(0.0)
            travelled = real(0.0)
            if cached:
                travel = cache.set_travel[env, number]
                travelled = travel + cache.set_margin[env, number]
                if cache.set_asleep[env, number] != 0 or travelled < cache.block_wake[env, block]:
                    near.count[env, block] = 0
                    continue
            start = model.block_start[block]
            stop = model.block_start[block + 1]
            view = view_of(model, state, env, block)
            around = real(-1.0)
            if cached and stop - start > 1:
                # One search in the middle may do for all that are far from where they last touched.
                unknown = wp.bool(False)
                for place in range(start, stop):
                    contact = model.block_contact[place]
                    if cache.faces[env, contact] == 0 and not (travelled < cache.wake[env, contact]):
                        unknown = True
                if unknown:
                    if wp.static(part == "known"):
                        put_off(cache, task)
                        continue
                    around = probe(model, view, env, block)
            later = wp.bool(False)
            first_wake = real(wp.inf)
            for place in range(start, stop):
                contact = model.block_contact[place]
                wake = real(0.0)
                if cached:
                    wake = cache.wake[env, contact]
                news = wp.bool(False)
                if not cached or not (travelled < wake):
                    news = True
                    always = (model.contact_options[contact] & SWEPT) != 0
                    free = real(-1.0)
                    if around > real(0.0) and not always and cache.faces[env, contact] == 0:
                        free = left_of(model, env, block, contact, around)
                    if free > real(FEW) * around and model.contact_geometry[env, contact].enabled != 0:
                        leave(contacts, env, contact)
                    else:
                        free = look(model, view, history, contacts, cached, cache, env, contact)
                    if wp.static(part == "known") and free == real(LATER):
                        later = True
                        break
                    if cached:
                        wake = real(0.0)
                        if free > real(0.0) and not always:
                            wake = rounded_down * (travel + free)
                        cache.wake[env, contact] = wake
                        # What neither touches nor touched has nothing to be told.
                        touches = contacts.status[env, contact] == CONTACT
                        news = always or touches or changed(contacts, history, env, contact)
                else:
                    if wp.static(part == "rest"):
                        # It may have been looked at before its block was put off.
                        news = changed(contacts, history, env, contact)
                    if around > real(0.0):
                        # Those asleep may learn that they can sleep longer.
                        longer = rounded_down * (travel + left_of(model, env, block, contact, around))
                        if longer > wake:
                            wake = longer
                            cache.wake[env, contact] = wake
                if news:
                    near.contact[env, start + count] = contact
                    count += 1
                first_wake = wp.min(first_wake, wake)
            if wp.static(part == "known") and later:
                put_off(cache, task)
                continue
            near.count[env, block] = count
            if cached:
                cache.block_wake[env, block] = first_wake

    return closest_point
