"""Columns of two polyhedra, or of a polyhedron and a half-space: on the faces of both solids, see ``face_columns.py``."""

import functools

import warp as wp
from warpcontact.kernels.body_contact import face_columns
from warpcontact.kernels.body_contact.column_sums import (
    ColumnSums,
    Pair,
    RelativeMotion,
    column_functions,
    status_at_depth,
)
from warpcontact.kernels.body_contact.columns import ramp_height
from warpcontact.kernels.body_contact.convex_columns import store_planes
from warpcontact.kernels.body_contact.face_columns import column_side, other_box
from warpcontact.kernels.body_contact.face_trees import next_leaf_in_box, start_traversal
from warpcontact.kernels.body_contact.overlap import NO_WEIGHT, Overlap, least_depth_of_face, overlap_of
from warpcontact.kernels.body_contact.patches import use_areas_of_exits
from warpcontact.kernels.body_contact.records import BodyContactSettings, body_contact_structs
from warpcontact.kernels.body_contact.solids import (
    HALF_SPACE,
    HAS_BOUNDARY,
    Geometries,
    PairPose,
    no_motion,
)
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry, are_apart, is_face_outside
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.types import CONTACT, structs

double = wp.float64


@functools.cache
def pair_columns(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> wp.Function:
    """Returns the device function that finds the overlap of two solids, and integrates their columns.

    Its arguments are (model, state, env, dt, pair, pose, geometries, first, second, setting, kappa, contact_status, is_near,
    corners, planes, exits, least_depths, breaks, limits, pending, coefficients, history_in, history_out, body_contacts, normals,
    patch_rows); it returns the ``ColumnSums``. ``kappa`` is the fraction of the length of a column, from the second solid, at which
    its force acts; ``contact_status`` the status without overlap; ``is_near`` whether the solids may overlap. The arrays from
    ``corners`` to ``pending`` are room of the thread, of which each kind of pair uses a part. ``normals`` and ``patch_rows`` are
    those of the patches, see ``patches.py``. For the arguments of the factory, see ``force.contact_forces``.
    """
    t = structs(real)
    Model, State = t.Model, t.State
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real, per_patch=contact_model.acts_per_patch)
    has_law_history = bool(contact_model.law.memories)
    relative_motion = column_functions(contact_model, real, per_area, has_joints).relative_motion
    add_face = face_columns.add_face(contact_model, real, per_area, has_joints)

    @wp.func
    def columns_of_polyhedra(
        model: Model,
        state: State,
        env: int,
        dt: real,
        pair: Pair,
        pose: PairPose,
        geometries: Geometries,
        first: SolidGeometry,
        second: SolidGeometry,
        setting: BodyContactSettings,
        kappa: double,
        contact_status: int,
        is_near: bool,
        corners: wp.array2d(dtype=double),
        planes: wp.array2d(dtype=double),
        exits: wp.array2d(dtype=double),
        least_depths: wp.array(dtype=double),
        breaks: wp.array2d(dtype=double),
        limits: wp.array(dtype=double),
        pending: wp.array(dtype=wp.int32),
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        body_contacts: BodyContacts,
        normals: wp.array2d(dtype=double),
        patch_rows: wp.array2d(dtype=double),
    ):
        half_space = (second.flags & HALF_SPACE) != 0
        second_is_reference = (second.flags & (HALF_SPACE | HAS_BOUNDARY)) != 0
        if is_near and not half_space:
            margin = ramp_height(first) + ramp_height(second)
            is_near = not are_apart(first, second, pose.first_in_second, margin)
        overlap = Overlap()
        sums = ColumnSums()
        sums.status = contact_status
        if is_near:
            overlap = overlap_of(
                corners, planes, exits, least_depths, pending, geometries, first, second, pose.first_in_second
            )
            if setting.reference >= double(0.0) and not second_is_reference:
                overlap.share = setting.reference
            sums.status = status_at_depth(overlap.depth, setting)
        sums.depth = overlap.depth
        sums.share = overlap.share
        sides = wp.int32(0)
        motion = RelativeMotion()
        if sums.status == CONTACT:
            motion = relative_motion(state, env, pair)
            sides = wp.where(second_is_reference, 1, 2)
        for number_of_side in range(sides):
            side = column_side(first, second, pose, overlap, kappa, number_of_side)
            if side.share == double(0.0):
                continue
            if side.by_planes:
                store_planes(planes, geometries, side.other)
            box = other_box(side)
            top = start_traversal(pending, 0, side.own)
            while top > 0:
                leaf = next_leaf_in_box(pending, 0, top, geometries, side.own, no_motion(), box)
                top = leaf.top
                for face in range(leaf.first_face, leaf.end_face):
                    if not half_space:
                        least = least_depth_of_face(least_depths, number_of_side, face - side.own.first_face)
                        if least >= NO_WEIGHT * overlap.depth or is_face_outside(geometries, side.own, face, box):
                            continue
                    sums = add_face(
                        model, state, env, dt, pair, motion, geometries, side, overlap, face, corners, planes, exits,
                        pending, top, coefficients, history_in, history_out, body_contacts, sums, normals, patch_rows,
                    )  # fmt: skip
        if half_space:
            # Parts wholly below the plane have columns that cancel: the area is that of the exits.
            sums.area = double(0.5) * (sums.area + sums.gross_area)
            if wp.static(has_law_history):
                use_areas_of_exits(patch_rows)
        return sums

    return columns_of_polyhedra
