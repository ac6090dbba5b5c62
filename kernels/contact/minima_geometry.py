"""Minima of a contact: where they are, and which minima of the last step they continue."""

import functools
import math
from typing import NamedTuple

import warp as wp
from warpcontact.kernels import frames
from warpcontact.kernels.contact.minima_records import minima_structs, slot_count
from warpcontact.kernels.lowlevel.assumptions import assume_nonnegative
from warpcontact.kernels.narrowphase import closest_point, distance_minima
from warpcontact.kernels.types import IGNORES_BOUNDARY, structs

# Cosine of the largest angle, 40°, between the normals of a minimum in successive steps.
SIMILAR = math.cos(math.radians(40.0))


class Functions(NamedTuple):
    """Device functions of the minima of a contact."""

    #: ``(model, set_frames, env, contact)``: center of the sphere relative to the origin of its body, W [m].
    center_arm: wp.Function
    #: ``(set_frames, arm_W)``: center of the sphere, in the frame and unit of the mesh.
    center_in_mesh: wp.Function
    #: ``(model, set_frames, contacts, env, contact, p, reach, distance, normal, position, rows)``: finds the minima within
    #: ``reach`` [m] of a contact whose status is CONTACT; the last four arguments and the result are those of
    #: ``distance_minima.find_minima``. The normal of the closest point is written, too.
    find_minima: wp.Function
    #: ``(model, set_frames, contacts, env, contact, p, normal, position, is_closest)``: point K of a minimum relative to the
    #: origin of the body of the sphere, W [m].
    contact_arm: wp.Function
    #: ``(model, state, env, contact, arm)``: position of the end of ``arm`` from the body of the sphere, W, float64 [m].
    world_position: wp.Function
    #: ``(history, env, first, normal, position, count, slot)``: finds the slot of each minimum. ``first`` is the index of the
    #: first slot of the contact, ``slot`` [room] gets the result. A minimum keeps its slot if it and the minimum there
    #: are closest to each other among those with similar normals. Others get an empty slot.
    match_slots: wp.Function


@functools.cache
def functions(real: type, room: int) -> Functions:
    """Returns the device functions for up to ``room`` minima of a sphere."""
    t = structs(real)
    vec3, Model, State, Contacts = t.vec3, t.Model, t.State, t.Contacts
    to_float64 = frames.functions(real).to_float64
    MinimaHistory = minima_structs(real).MinimaHistory
    slots = slot_count(room)
    SetFrames = closest_point.functions(real, False, closest_point.DETECT_ALL).SetFrames
    find_in_mesh = distance_minima.functions(real, room).find_minima
    similar = wp.constant(real(SIMILAR))

    @wp.func
    def separation(history: MinimaHistory, env: int, member: int, normal: vec3, position: vec3):
        """Returns the distance of a minimum from that of a slot in the last step [mesh unit]; ∞: not the same wall."""
        if history.entry_speed[env, member] < real(0.0):
            return real(wp.inf)
        if wp.dot(history.last_normal[env, member], normal) < similar:
            return real(wp.inf)
        return wp.length(history.last_position[env, member] - position)

    @wp.func
    def match_slots(
        history: MinimaHistory,
        env: int,
        first: int,
        normal: wp.array(dtype=vec3),
        position: wp.array(dtype=vec3),
        count: int,
        slot: wp.array(dtype=wp.int32),
    ):
        for i in range(count):
            best = wp.int32(-1)
            least = real(wp.inf)
            for candidate in range(wp.static(slots)):
                apart = separation(history, env, first + candidate, normal[i], position[i])
                if apart < least:
                    least = apart
                    best = candidate
            if best >= 0:
                for j in range(count):
                    if j != i:
                        apart = separation(history, env, first + best, normal[j], position[j])
                        if apart < least or (apart == least and j < i):
                            best = -1
                            break
            slot[i] = best
        empty = wp.int32(0)
        for i in range(count):
            if slot[i] < 0:
                while history.entry_speed[env, first + empty] >= real(0.0):
                    empty += 1
                slot[i] = empty
                empty += 1

    @wp.func
    def center_arm(model: Model, set_frames: SetFrames, env: int, contact: int):
        return set_frames.R_WB * model.point_position[env, assume_nonnegative(model.contact_point[contact])]

    @wp.func
    def center_in_mesh(set_frames: SetFrames, arm_W: vec3):
        return set_frames.inverse_scale * (wp.transpose(set_frames.R_WS) * (set_frames.offset_W + arm_W))

    @wp.func
    def find_minima(
        model: Model,
        set_frames: SetFrames,
        contacts: Contacts,
        env: int,
        contact: int,
        p: vec3,
        reach: real,
        distance: wp.array(dtype=real),
        normal: wp.array(dtype=vec3),
        position: wp.array(dtype=vec3),
        rows: wp.array(dtype=wp.int32),
    ):
        option = model.contact_options[contact]
        # A tracked contact on the inner side is held by the wall that it passed, and other walls are behind that.
        is_inside = contacts.gap[env, contact] < -model.contact_geometry[env, contact].radius
        minima = find_in_mesh(
            model,
            set_frames.query_mesh,
            p,
            reach * set_frames.inverse_scale,
            contacts.face[env, contact],
            (option & IGNORES_BOUNDARY) == 0,
            is_inside and (option & closest_point.TRACKED) != 0,
            distance,
            normal,
            position,
            rows,
        )
        if minima.closest_counts:
            normal[0] = wp.transpose(set_frames.R_WS) * contacts.normal[env, contact]
        return minima

    @wp.func
    def contact_arm(
        model: Model,
        set_frames: SetFrames,
        contacts: Contacts,
        env: int,
        contact: int,
        p: vec3,
        normal: vec3,
        position: vec3,
        is_closest: bool,
    ):
        # As the narrow phase found it.
        if is_closest:
            return contacts.arm[env, contact]
        geometry = model.contact_geometry[env, contact]
        to_surface = set_frames.scale * (position - p)
        to_deepest = -geometry.radius * normal
        to_contact = to_surface + geometry.kappa * (to_deepest - to_surface)
        return center_arm(model, set_frames, env, contact) + set_frames.R_WS * to_contact

    @wp.func
    def world_position(model: Model, state: State, env: int, contact: int, arm: vec3):
        point = assume_nonnegative(model.contact_point[contact])
        body = model.point_body[point]
        if body < 0:
            return to_float64(model.point_anchor[env, point]) + to_float64(arm)
        origin_W = to_float64(state.body_position[env, body]) + to_float64(
            state.body_position_remainder[env, body]
        )
        return origin_W + to_float64(arm)

    return Functions(
        center_arm=center_arm,
        center_in_mesh=center_in_mesh,
        find_minima=find_minima,
        contact_arm=contact_arm,
        world_position=world_position,
        match_slots=match_slots,
    )
