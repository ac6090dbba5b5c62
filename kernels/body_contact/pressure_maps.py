"""Pressure maps of body contacts: the area of contact as triangles, with the columns at their vertices.

They are computed for pictures, apart from steps. A kernel writes the triangles of all pairs, and is launched twice: without
arrays of vertices it counts them. Another kernel evaluates the law at the vertices.
"""

import functools

import warp as wp
from warpcontact.kernels.body_contact import solids as solid_functions
from warpcontact.kernels.body_contact.column_sums import Column, ColumnSums, column_functions, pair_of
from warpcontact.kernels.body_contact.overlap import Overlap, column_weight
from warpcontact.kernels.body_contact.patches import PATCH_COUNT, PATCH_SUMS
from warpcontact.kernels.body_contact.records import SolidPairs, body_contact_structs
from warpcontact.kernels.body_contact.solids import HALF_SPACE, Geometries, Solids
from warpcontact.kernels.body_contact.surface_queries import solid_geometry
from warpcontact.kernels.contact.contact_evaluation import ContactModel, group_structs
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.types import structs

vec3d = wp.vec3d
double = wp.float64


@wp.struct
class MapPairs:
    """Overlap of each pair, and its range of vertices and triangles: [env, pair]."""

    depth: wp.array2d(dtype=wp.float64)  # D; 0 without contact [m]
    share: wp.array2d(dtype=wp.float64)  # weight of the columns on the second solid [-]
    vertex_count: wp.array2d(dtype=wp.int32)
    triangle_count: wp.array2d(dtype=wp.int32)
    vertex_start: wp.array2d(dtype=wp.int32)
    triangle_start: wp.array2d(dtype=wp.int32)


@wp.struct
class MapVertices:
    """Bases of columns: [vertex]."""

    position: wp.array(dtype=wp.vec3d)  # relative to the origin of the pair, W [m]
    normal: wp.array(dtype=wp.vec3d)  # unit, out of the second solid, W
    depth: wp.array(dtype=wp.float64)  # of the column [m]
    entry: wp.array(dtype=wp.float64)  # depth of the column that is subtracted, 0 if there is none [m]
    factor: wp.array(dtype=wp.float64)  # of the pressure that acts, apart from the weight of its depth, 0 to 1 [-]


@wp.struct
class MapTriangles:
    """Triangles between bases of columns: [triangle]."""

    vertices: wp.array(dtype=wp.vec3i)
    weight: wp.array(dtype=wp.float64)  # of their area; negative where columns are subtracted [-]
    side: wp.array(dtype=wp.int32)  # solid on which the columns stand: 0, the second; 1, the first
    face: wp.array(dtype=wp.int32)  # face on which they stand; −1: a curved surface


@wp.struct
class MapCounts:
    """Vertices and triangles of a pair so far."""

    vertex: wp.int32
    triangle: wp.int32


@wp.func
def add_vertex(
    vertices: MapVertices,
    first: int,
    counts: MapCounts,
    position: vec3d,
    normal: vec3d,
    depth: double,
    entry: double,
    factor: double,
):
    """Adds a vertex of a pair whose first vertex is ``first``, and returns the counts; it is only counted without arrays."""
    number = first + counts.vertex
    if number < vertices.position.shape[0]:
        vertices.position[number] = position
        vertices.normal[number] = normal
        vertices.depth[number] = depth
        vertices.entry[number] = entry
        vertices.factor[number] = factor
    counts.vertex += 1
    return counts


@wp.func
def add_triangle(
    triangles: MapTriangles,
    first: int,
    counts: MapCounts,
    vertices: wp.vec3i,
    weight: double,
    side: int,
    face: int,
):
    """Adds a triangle of a pair whose first triangle is ``first``, and returns the counts; see ``add_vertex``."""
    number = first + counts.triangle
    if number < triangles.weight.shape[0]:
        triangles.vertices[number] = vertices
        triangles.weight[number] = weight
        triangles.side[number] = side
        triangles.face[number] = face
    counts.triangle += 1
    return counts


@functools.cache
def pressures(contact_model: ContactModel, real: type, per_area: bool, has_joints: bool) -> wp.Kernel:
    """Returns the kernel of the pressures at vertices; the arguments are those of ``force.contact_forces``."""
    t = structs(real)
    Model, State = t.Model, t.State
    BodyContacts = body_contact_structs(real).BodyContacts
    Coefficients, MaterialHistory = group_structs(contact_model, real, per_patch=contact_model.acts_per_patch)
    add_column = column_functions(contact_model, real, per_area, has_joints).add_column
    poses = solid_functions.functions(real)
    pair_pose, pose_in_world = poses.pair_pose, poses.pose_in_world

    @unique_kernel()
    def map_pressures(
        model: Model,
        state: State,
        step: wp.array2d(dtype=real),
        geometries: Geometries,
        solids: Solids,
        pairs: SolidPairs,
        coefficients: Coefficients,
        history_in: MaterialHistory,
        history_out: MaterialHistory,
        body_contacts: BodyContacts,
        map_pairs: MapPairs,
        owner: wp.array(dtype=wp.vec2i),  # [vertex] environment and pair
        vertices: MapVertices,
        origin: wp.array(dtype=wp.vec3d),  # [vertex] receives the origin of the pair, W [m]
        pressure: wp.array(dtype=wp.float64),  # [vertex] receives the pressure; N for a law without an area [Pa]
        weight: wp.array(dtype=wp.float64),  # [vertex] receives the part of the pressure that acts, 0 to 1 [-]
    ):
        normals = wp.zeros(shape=(PATCH_COUNT, 3), dtype=double)
        patch_rows = wp.zeros(shape=(PATCH_COUNT, PATCH_SUMS), dtype=double)
        vertex = wp.tid()
        env = owner[vertex][0]
        number = owner[vertex][1]
        solid_1 = pairs.first[number]
        solid_2 = pairs.second[number]
        pose = pair_pose(state, env, solids, solid_1, solid_2)
        pair = pair_of(pose, solids, solid_1, solid_2, number)
        second = solid_geometry(geometries, solids.pose[env, solid_2])
        overlap = Overlap()
        overlap.depth = map_pairs.depth[env, number]
        acting = vertices.factor[vertex]
        acting = acting * column_weight(vertices.depth[vertex], overlap, (second.flags & HALF_SPACE) != 0)
        column = Column()
        column.weight = double(1.0)
        column.fraction = double(1.0)
        column.position = vertices.position[vertex]
        column.normal = vertices.normal[vertex]
        value = double(0.0)
        # Down to the exit, less that down to the entry. Not a constant, so that the loop is not unrolled.
        ends = wp.int32(2)
        for end in range(ends):
            column.depth = vertices.depth[vertex]
            sign = double(1.0)
            if end == 1:
                column.depth = vertices.entry[vertex]
                sign = double(-1.0)
            # Rounding can make the depth at the boundary negative.
            if column.depth > double(0.0):
                sums = add_column(
                    model, state, env, step[env, 0], pair, column, coefficients, history_in, history_out, body_contacts,
                    ColumnSums(), normals, patch_rows,
                )  # fmt: skip
                value += sign * sums.pressure
        pressure[vertex] = acting * value
        weight[vertex] = acting
        origin[vertex] = pose_in_world(state, env, solids, solid_2).origin

    return map_pressures
