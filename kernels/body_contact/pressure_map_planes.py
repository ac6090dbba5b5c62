"""Pressure maps of two curved solids: the region of their common plane, in rings around the center of the overlap."""

import functools

import warp as wp
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.curved_pairs import (
    CommonPlane,
    CurvedPair,
    boundary_distance,
    common_interval,
    common_plane,
)
from warpcontact.kernels.body_contact.curved_solids import CURVED
from warpcontact.kernels.body_contact.pressure_maps import (
    MapCounts,
    MapPairs,
    MapTriangles,
    MapVertices,
    add_triangle,
    add_vertex,
)
from warpcontact.kernels.body_contact.records import BodyContactSettings, SolidPairs
from warpcontact.kernels.body_contact.solids import Geometries, PairPose, Solids
from warpcontact.kernels.body_contact.surface_queries import are_apart, solid_geometry
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import structs

vec3d = wp.vec3d
double = wp.float64

#: Directions around the center, and rings.
SECTORS = 48
RINGS = 8
SECTOR = wp.constant(double(6.283185307179586476925 / 48))


@wp.func
def add_point(
    vertices: MapVertices,
    first: int,
    counts: MapCounts,
    solids_of_pair: CurvedPair,
    plane: CommonPlane,
    pose: PairPose,
    base: vec3d,
    kappa: double,
):
    """Adds the column along the normal of the common plane through a point, and returns the counts."""
    interval = common_interval(solids_of_pair, base, plane.normal)
    depth = wp.max(interval[1] - interval[0], double(0.0))
    rotation = pose.second_axes.rotation
    position = rotation * (base + (interval[1] - kappa * depth) * plane.normal)
    return add_vertex(vertices, first, counts, position, rotation * plane.normal, depth, double(0.0), double(1.0))


@functools.cache
def plane_maps(real: type) -> wp.Kernel:
    """Returns the kernel of the pressure maps of pairs of curved solids, in one precision of the state."""
    State = structs(real).State
    pair_pose = solid_functions.functions(real).pair_pose

    @unique_kernel()
    def map_planes(
        state: State,
        geometries: Geometries,
        solids: Solids,
        pairs: SolidPairs,
        settings: wp.array2d(dtype=BodyContactSettings),
        map_pairs: MapPairs,
        vertices: MapVertices,
        triangles: MapTriangles,
    ):
        env, number = wp.tid()
        setting = settings[env, number]
        solid_1 = pairs.first[number]
        solid_2 = pairs.second[number]
        solids_of_pair = CurvedPair()
        solids_of_pair.first = solid_geometry(geometries, solids.pose[env, solid_1])
        solids_of_pair.second = solid_geometry(geometries, solids.pose[env, solid_2])
        are_curved = (solids_of_pair.first.flags & CURVED) != 0 and (solids_of_pair.second.flags & CURVED) != 0
        if setting.enabled == 0 or not are_curved:
            return
        pose = pair_pose(state, env, solids, solid_1, solid_2)
        if are_apart(solids_of_pair.first, solids_of_pair.second, pose.first_in_second, double(0.0)):
            return
        solids_of_pair.pose = pose.first_in_second
        solids_of_pair.size = wp.length(solids_of_pair.first.half_extents)
        solids_of_pair.size += wp.length(solids_of_pair.second.half_extents)
        plane = common_plane(solids_of_pair)
        if not plane.is_found or plane.largest_depth > setting.max_depth:
            return
        map_pairs.depth[env, number] = plane.largest_depth
        # All columns, in one family.
        map_pairs.share[env, number] = double(1.0)
        first_vertex = map_pairs.vertex_start[env, number]
        first_triangle = map_pairs.triangle_start[env, number]
        counts = add_point(
            vertices, first_vertex, MapCounts(), solids_of_pair, plane, pose, plane.center, setting.kappa
        )
        limit = double(1.0)
        # Not constants, so that the loops are not unrolled.
        sectors = wp.int32(SECTORS)
        rings = wp.int32(RINGS)
        for sector in range(sectors):
            angle = SECTOR * double(sector)
            direction = wp.cos(angle) * plane.u_axis + wp.sin(angle) * plane.v_axis
            limit = boundary_distance(solids_of_pair, plane, direction, limit)
            # Vertices of this direction, and of the next one.
            own = first_vertex + 1 + sector * rings
            other = first_vertex + 1 + ((sector + 1) % sectors) * rings
            for ring in range(rings):
                base = plane.center + (limit * double(ring + 1) / double(rings)) * direction
                counts = add_point(
                    vertices, first_vertex, counts, solids_of_pair, plane, pose, base, setting.kappa
                )
                numbers = wp.vec3i(first_vertex, own, other)
                if ring > 0:
                    numbers = wp.vec3i(own + ring - 1, own + ring, other + ring)
                    counts = add_triangle(triangles, first_triangle, counts, numbers, double(1.0), 0, -1)
                    numbers = wp.vec3i(own + ring - 1, other + ring, other + ring - 1)
                counts = add_triangle(triangles, first_triangle, counts, numbers, double(1.0), 0, -1)
        map_pairs.vertex_count[env, number] = counts.vertex
        map_pairs.triangle_count[env, number] = counts.triangle

    return map_planes
