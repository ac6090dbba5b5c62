"""Finds points that cross a surface from its outer side within a step: however fast, they are caught."""

import functools

import numpy as np
import warp as wp
from warpcontact.kernels import foot as feet
from warpcontact.kernels import frames, travel
from warpcontact.kernels.types import (
    CONTACT,
    ENV_ACTIVE,
    ENV_CROSSED,
    ENV_WAITING,
    FAR,
    FEATURE_ACTIVE,
    LATCHED,
    SWEPT,
    Work,
    env_of,
    first_env,
    item_of,
    structs,
    task_count,
)
from warpcontact.kernels.unique import unique_kernel

# Rounding of the test, in units of epsilon times the size of the coordinates: what passes between two faces would
# be lost, so each takes in a little more than itself.
ROUNDING = 64.0
# Times a point may go in and out within a step.
MOST_CROSSINGS = 8


@functools.cache
def kernel(real: type) -> wp.Kernel:
    """Returns the kernel that follows swept contacts in and out of their surface; items: blocks.

    A point moves on a straight line from ``state_in`` to ``state_out`` as seen from the surface. The first time
    that it goes in is what counts as a crossing; whatever it is over in the end is ``face`` and ``crossed_face``.
    ``near`` lists those that crossed after the others, which have had to do with the step before.
    """
    t = structs(real)
    vec3, Model, State, Contacts, Near, Cache = t.vec3, t.Model, t.State, t.Contacts, t.Near, t.Cache
    see, moved = travel.functions(real).see, travel.functions(real).moved
    follow, inner = feet.functions(real).follow, feet.functions(real).inner
    frame = frames.functions(real)
    apart, turned, orientation_to_world = frame.apart, frame.turned, frame.orientation_to_world
    epsilon = wp.constant(real(t.epsilon * ROUNDING))
    query_epsilon = wp.constant(real(float(np.finfo(np.float32).eps) * ROUNDING))

    @wp.func
    def to_surface(model: Model, state: State, env: int, contact: int, surface: int):
        """The point in the mesh's frame and unit."""
        point = model.contact_point[contact]
        carrier = model.surface_body[surface]
        arm_W = turned(state, env, model.point_body[point], model.point_position[env, point])
        o_W = turned(state, env, carrier, model.surface_position[env, surface])
        q_WS = orientation_to_world(state, env, carrier, model.surface_orientation[env, surface])
        p_W = apart(model, state, env, point, surface) - o_W + arm_W
        return wp.quat_rotate_inv(q_WS, p_W) / model.surface_scale[env, surface]

    @wp.func
    def size(v: vec3):
        return wp.max(wp.max(wp.abs(v[0]), wp.abs(v[1])), wp.abs(v[2]))

    @wp.func
    def crossing(model: Model, row: int, p: vec3, q: vec3, sense: real, slack: real):
        """Where on the way from ``p`` to ``q`` face ``row`` is crossed, 0 to 1; 2: nowhere.

        Inwards with ``sense`` 1, outwards with −1.
        """
        n = model.face_normal[row, 0]
        a = model.face_corner[row, 0]
        b = model.face_corner[row, 1]
        c = model.face_corner[row, 2]
        before = sense * wp.dot(p - a, n)
        after = sense * wp.dot(q - a, n)
        if before < -slack or after >= real(0.0) or after >= before:
            return real(2.0)
        at = wp.clamp(before / (before - after), real(0.0), real(1.0))
        x = p + at * (q - p)
        if (
            wp.dot(wp.cross(n, b - a), x - a) < -slack * wp.length(b - a)
            or wp.dot(wp.cross(n, c - b), x - b) < -slack * wp.length(c - b)
            or wp.dot(wp.cross(n, a - c), x - c) < -slack * wp.length(a - c)
        ):
            return real(2.0)
        return at

    @wp.func
    def first_crossing(model: Model, patch: int, held: int, p: vec3, q: vec3):
        """Where on the way from ``p`` to ``q`` a face is first crossed, 0 to 1, and its row; 2 and −1: nowhere.

        An active face, inwards; or if face ``held`` holds the point, one of the sheet that holds it, outwards.
        """
        sense = wp.where(held >= 0, real(-1.0), real(1.0))
        scale = size(p) + size(q)
        slack = epsilon * scale
        margin = model.patch_slack[patch] + query_epsilon * scale
        around = vec3(margin, margin, margin)
        low = wp.min(p, q) - around
        high = wp.max(p, q) + around
        start = model.patch_face_start[patch]
        boxes = wp.mesh_query_aabb(
            model.patch_mesh[patch],
            wp.vec3f(wp.float32(low[0]), wp.float32(low[1]), wp.float32(low[2])),
            wp.vec3f(wp.float32(high[0]), wp.float32(high[1]), wp.float32(high[2])),
        )
        face = wp.int32(0)
        first = real(2.0)
        crossed = wp.int32(-1)
        while wp.mesh_query_aabb_next(boxes, face):
            row = start + face
            at = crossing(model, row, p, q, sense, slack)
            if at < first or (at == first and at < real(2.0) and row < crossed):
                counts = (wp.int32(model.face_flags[row, 0]) & FEATURE_ACTIVE) != 0
                if held >= 0:
                    counts = follow(model, held, p, p + at * (q - p)).distance <= real(2.0) * slack
                if counts:
                    first = at
                    crossed = row
        return first, crossed

    @wp.func
    def passes(model: Model, row: int, p: vec3, q: vec3):
        """Where on the way from ``p`` to ``q`` the plane of face ``row`` is passed, 0 to 1."""
        n = model.face_normal[row, 0]
        before = wp.dot(p - model.face_corner[row, 0], n)
        after = wp.dot(q - model.face_corner[row, 0], n)
        if before >= real(0.0) or after <= real(0.0):
            return real(1.0)
        return before / (before - after)

    @wp.func
    def may_cross(model: Model, contacts: Contacts, env: int, contact: int):
        option = model.contact_options[contact]
        if (option & SWEPT) == 0 or model.contact_geometry[env, contact].enabled == 0:
            return False
        # Not armed: known to be on the wrong side, or never near enough for its side to be known.
        armed = contacts.armed[env, contact] != 0 or contacts.status[env, contact] == FAR
        return armed or (option & LATCHED) == 0

    @wp.func
    def follow_through(
        model: Model, state_in: State, state_out: State, contacts: Contacts, env: int, contact: int
    ):
        """Follows a contact into and out of its surface; returns whether it crossed inwards."""
        base = model.contact_patch[contact]
        surface = model.patch_surface[base]
        patch = base + model.surface_mesh[env, surface]
        p = to_surface(model, state_in, env, contact, surface)
        q = to_surface(model, state_out, env, contact, surface)
        # A point on the inner side is held by a face, and free from where it comes out of that sheet.
        held = wp.int32(-1)
        depth = contacts.penetration[env, contact] - model.contact_geometry[env, contact].radius
        if contacts.status[env, contact] == CONTACT and depth >= real(0.0):
            held = contacts.face[env, contact]
        over = held
        gone = real(0.0)
        entered = real(2.0)
        for _ in range(wp.static(MOST_CROSSINGS)):
            at, row = first_crossing(model, patch, held, p, q)
            if held >= 0:
                foot = follow(model, held, p, q)
                over = foot.row
                if at > real(1.0):
                    if inner(model, foot):
                        break
                    # Past a boundary it comes out where it passes the plane of the face there.
                    at = passes(model, over, p, q)
            elif row < 0:
                break
            else:
                entered = wp.min(entered, gone + (real(1.0) - gone) * at)
            held = wp.where(held >= 0, -1, row)
            p = p + at * (q - p)
            gone = gone + (real(1.0) - gone) * at
        if over >= 0:
            # Whatever face it was held by, from the one that it is over now its nearest point is found.
            contacts.face[env, contact] = over
        if entered > real(1.0):
            return False
        contacts.armed[env, contact] = 1
        contacts.crossed_face[env, contact] = over
        contacts.crossed_at[env, contact] = entered
        return True

    @unique_kernel()
    def sweep(
        work: Work,
        status: wp.array(dtype=wp.int32),
        model: Model,
        state_in: State,
        state_out: State,
        cached: wp.bool,
        cache: Cache,
        contacts: Contacts,
        near: Near,
        mark: wp.int32,  # whether environments with a crossing are to take the step again
        marked: wp.array(dtype=wp.int32),  # [0] set if there are any
    ):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = env_of(work, task)
            block = item_of(work, task)
            if status[env] != ENV_ACTIVE:
                continue
            near.crossed[env, block] = 0
            start = model.block_start[block]
            if (model.contact_options[model.block_contact[start]] & SWEPT) == 0:
                continue
            # A step that is taken again may have crossed elsewhere before.
            count = near.count[env, block]
            for i in range(start, start + count):
                contacts.crossed_face[env, near.contact[env, i]] = -1
            # At the end of the step; what could not even touch until then did not cross.
            travelled = real(wp.inf)
            if cached:
                number = model.block_set[block]
                seen = see(model, state_out, env, number)
                margin = wp.max(seen.margin, cache.set_margin[env, number])
                travelled = cache.set_travel[env, number] + moved(model, cache, env, number, seen) + margin
                if travelled < cache.block_wake[env, block]:
                    continue
            crossed = wp.int32(0)
            for place in range(start, model.block_start[block + 1]):
                contact = model.block_contact[place]
                if travelled < cache.wake[env, contact] or not may_cross(model, contacts, env, contact):
                    continue
                if not follow_through(model, state_in, state_out, contacts, env, contact):
                    continue
                listed = wp.bool(False)
                for i in range(start, start + count):
                    listed = listed or near.contact[env, i] == contact
                if not listed:
                    near.contact[env, start + count + crossed] = contact
                    crossed += 1
                if mark != 0:
                    # Many threads may say so, all the same.
                    status[env] = ENV_CROSSED
                    marked[0] = 1
            near.crossed[env, block] = crossed

    return sweep


@functools.cache
def turn() -> wp.Kernel:
    """Returns the kernel that lets environments take turns.

    ``back`` 0: those with a crossing become active and the active ones wait; 1: all that can be are active.
    """

    @unique_kernel()
    def take_turns(work: Work, status: wp.array(dtype=wp.int32), back: wp.int32):
        for task in range(wp.tid(), task_count(work), work.threads):
            env = first_env(work) + task
            if back != 0:
                if status[env] == ENV_WAITING or status[env] == ENV_CROSSED:
                    status[env] = ENV_ACTIVE
            elif status[env] == ENV_CROSSED:
                status[env] = ENV_ACTIVE
            elif status[env] == ENV_ACTIVE:
                status[env] = ENV_WAITING

    return take_turns
