"""Columns of two curved solids: along the normal of their common plane, see ``curved_pairs.py``."""

import functools

import warp as wp
from warpcontact.kernels.body_contact.column_sums import (
    Column,
    ColumnSums,
    Pair,
    column_functions,
    status_at_depth,
)
from warpcontact.kernels.body_contact.curved_pairs import (
    ANGLE_STEP,
    DIRECTIONS,
    RADIAL_POINTS,
    RADII,
    RADIUS_WEIGHTS,
    CurvedPair,
    boundary_distance,
    common_interval,
    common_plane,
    direction_of,
)
from warpcontact.kernels.body_contact.patches import patch_of
from warpcontact.kernels.body_contact.records import BodyContactSettings, body_contact_structs
from warpcontact.kernels.body_contact.solids import Geometries, PairPose
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry, are_apart
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.types import CONTACT, structs

double = wp.float64


@functools.cache
def pair_columns(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> wp.Function:
    """Returns the device function that finds the common plane of two curved solids, and integrates their columns.

    For its arguments and results, see ``polyhedron_force.pair_columns``.
    """
    t = structs(real)
    Model, State = t.Model, t.State
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real, per_patch=contact_model.acts_per_patch)
    has_patches = contact_model.acts_per_patch
    add_column = column_functions(contact_model, real, per_area, has_joints).add_column

    @wp.func
    def columns_of_curved_pair(
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
        sums = ColumnSums()
        sums.status = contact_status
        if not is_near or are_apart(first, second, pose.first_in_second, double(0.0)):
            return sums
        solids = CurvedPair()
        solids.first = first
        solids.second = second
        solids.pose = pose.first_in_second
        solids.size = wp.length(first.half_extents)
        solids.size += wp.length(second.half_extents)
        plane = common_plane(solids)
        if not plane.is_found:
            return sums
        sums.share = double(0.5)
        sums.depth = plane.largest_depth
        sums.status = status_at_depth(sums.depth, setting)
        if sums.status != CONTACT:
            return sums
        rotation = pose.second_axes.rotation
        column = Column()
        column.normal = rotation * plane.normal
        if wp.static(has_patches):
            column.patch = patch_of(normals, pair.to_axes * column.normal)
        unit_area = ANGLE_STEP * wp.length(plane.u_axis) * wp.length(plane.v_axis)
        limit = double(1.0)
        # Not a constant, so that the loop is not unrolled.
        directions = wp.int32(DIRECTIONS)
        for number_of_direction in range(directions):
            direction = direction_of(plane, number_of_direction)
            limit = boundary_distance(solids, plane, direction, limit)
            for i in range(RADIAL_POINTS):
                base = plane.center + (limit * RADII[i]) * direction
                interval = common_interval(solids, base, plane.normal)
                column.depth = interval[1] - interval[0]
                if column.depth <= double(0.0):
                    continue
                column.fraction = double(1.0)
                column.weight = unit_area * RADIUS_WEIGHTS[i] * RADII[i] * limit * limit
                # Columns stand on the second solid.
                column.position = rotation * (base + (interval[1] - kappa * column.depth) * plane.normal)
                sums = add_column(
                    model, state, env, dt, pair, column, coefficients, history_in, history_out, body_contacts, sums,
                    normals, patch_rows,
                )  # fmt: skip
        return sums

    return columns_of_curved_pair
