"""Features of solids: vertices, edges and planes, and their numbers, which identify points from step to step."""

import warp as wp
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose, scaled
from warpcontact.kernels.body_contact.surface_queries import SolidGeometry

vec3d = wp.vec3d


@wp.struct
class Features:
    """Features of all geometries."""

    corner: wp.array(dtype=wp.int32)  # [corner] vertices of faces
    corner_start: wp.array(dtype=wp.int32)  # [geometry + 1]
    neighbor: wp.array(dtype=wp.int32)  # neighbors of all vertices of convex solids
    neighbor_start: wp.array(dtype=wp.int32)  # [vertex + 1] first of its neighbors in ``neighbor``
    vertex_plane: wp.array(dtype=wp.int32)  # planes of the faces at all vertices of convex solids
    vertex_plane_start: wp.array(dtype=wp.int32)  # [vertex + 1] first of its planes in ``vertex_plane``
    edge: wp.array(dtype=wp.vec4i)  # [edge] its two vertices and two faces; the last is −1 at a boundary
    edge_start: wp.array(dtype=wp.int32)  # [geometry + 1]
    sharp_end: wp.array(dtype=wp.int32)  # [geometry] end of its convex edges, which come first
    face_edge: wp.array(dtype=wp.vec4i)  # [face] edges, the first from its first to its second vertex
    face_plane: wp.array(dtype=wp.int32)  # [face] plane
    # [6 × geometry + 2 × axis + side] planes of a box on the negative (side 0) and positive (1) side of each axis; −1: no box
    box_plane: wp.array(dtype=wp.int32)
    plane_face: wp.array(dtype=wp.int32)  # faces of all planes
    plane_start: wp.array(dtype=wp.int32)  # [plane + 1] first of its faces in ``plane_face``
    # Trees of normals of convex solids (``normal_trees.py``): [node] first of two children, which are consecutive, or −1; first
    # item; end of its items.
    normal_node: wp.array(dtype=wp.vec3i)
    # [node] smallest components of normals, and smallest offset from the center of the geometry [unit of the geometry]
    normal_lower: wp.array(dtype=wp.vec4d)
    normal_upper: wp.array(dtype=wp.vec4d)  # [node] largest ones
    normal_item: wp.array(dtype=wp.int32)  # planes or edges of all leaves
    plane_root: wp.array(dtype=wp.int32)  # [geometry] root of the tree of its planes
    edge_root: wp.array(dtype=wp.int32)  # [geometry] root of the tree of its convex edges
    # Outlines, convex polygons: those of the faces, with the same numbers, and those of planes with several faces of convex solids.
    outline_vertex: wp.array(dtype=wp.int32)  # vertices of all outlines, counter-clockwise as seen from outside
    outline_edge: wp.array(dtype=wp.int32)  # the edge that follows each vertex
    outline_start: wp.array(dtype=wp.int32)  # [outline + 1] first of its vertices in ``outline_vertex``
    plane_outline: wp.array(dtype=wp.int32)  # outlines of all planes
    plane_outline_start: wp.array(dtype=wp.int32)  # [plane + 1] first of its outlines in ``plane_outline``
    is_convex: wp.array(dtype=wp.int32)  # [geometry] 1: it is convex, and its planes and edges are all compared


@wp.struct
class Feature:
    """A point as the crossing of a feature of the first solid and one of the second."""

    first: wp.int32  # from ``vertex_feature``, ``edge_feature`` or ``plane_feature``; 0: there is no point
    second: wp.int32


@wp.func
def vertex_feature(vertex: int):
    """Returns the number of a vertex as a feature."""
    return 1 + 3 * vertex


@wp.func
def edge_feature(edge: int):
    """Returns the number of an edge as a feature."""
    return 2 + 3 * edge


@wp.func
def plane_feature(plane: int):
    """Returns the number of a plane as a feature."""
    return 3 + 3 * plane


@wp.func
def outline_of_face(features: Features, face: int):
    """Returns the outline of the plane of a face if it is one outline, or else that of the face."""
    plane = features.face_plane[face]
    first = features.plane_outline_start[plane]
    if features.plane_outline_start[plane + 1] == first + 1:
        return features.plane_outline[first]
    return face


@wp.func
def same_feature(one: Feature, other: Feature):
    """Returns whether two points are the crossing of the same features."""
    return one.first == other.first and one.second == other.second


@wp.func
def is_before(one: Feature, other: Feature):
    """Returns whether a feature comes before another one, which decides between equal points."""
    return one.first < other.first or (one.first == other.first and one.second < other.second)


@wp.func
def vertex_position(geometries: Geometries, vertex: int, side: SolidGeometry):
    """Returns the position of a vertex in the frame of its solid [m]."""
    return scaled(geometries.vertex[vertex], side.scale)


@wp.func
def moved(pose: RelativePose, position: vec3d):
    """Returns a position of a solid in the frame of the other one [m]."""
    return pose.rotation * position + pose.origin
