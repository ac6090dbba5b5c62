"""Points of a reference plane of two convex solids: corners of the common areas of the plane and the faces near it."""

import warp as wp
from warpcontact.kernels.body_contact.face_trees import PENDING_NODES, next_leaf_in_box, start_traversal
from warpcontact.kernels.body_contact.solids import Geometries, RelativePose
from warpcontact.kernels.body_contact.surface_queries import BoundingBox, plane_offset
from warpcontact.kernels.manifolds.candidates import (
    COSINE_STEP,
    DIRECTIONS,
    SINE_STEP,
    Candidate,
    Patch,
    add_candidate,
    axes_across,
)
from warpcontact.kernels.manifolds.collect import Reach, ReferenceSide, add_corners
from warpcontact.kernels.manifolds.face_clipping import (
    FACING,
    ClippedCorner,
    clip_outline,
    is_outline_outside,
    low_vertices,
    outline_box,
)
from warpcontact.kernels.manifolds.features import (
    Feature,
    Features,
    moved,
    outline_of_face,
    plane_feature,
    vertex_feature,
    vertex_position,
)
from warpcontact.kernels.manifolds.normal_trees import height_above_plane

double = wp.float64
vec3d = wp.vec3d

# Faces that are clipped at a time, those of a leaf at most, and planes with several faces that are not clipped twice.
CLIPPED_FACES, LEAF_FACES, TREATED_PLANES = (wp.constant(i) for i in (32, 8, 16))
# Largest number of vertices within reach that are listed.
LOW_VERTICES = wp.constant(64)
# Cosine of two faces from which on they are nearly parallel, 6°.
PARALLEL_FACES = wp.constant(double(0.9945))


@wp.func
def index_of(pending: wp.array(dtype=wp.int32), first: int, stride: int, end: int, number: int):
    """Returns the index of a number among every ``stride``-th one of an array from ``first`` on, or ``end``."""
    index = wp.int32(first)
    while index < end and pending[index] != number:
        index += stride
    return index


@wp.func
def list_low_vertices(
    geometries: Geometries,
    features: Features,
    side: ReferenceSide,
    normal: vec3d,
    limit: double,
    nearest: int,
    pending: wp.array(dtype=wp.int32),
):
    """Lists the low vertices of the other solid, which are within reach; returns their number; −1 if they are too many.

    Low vertices of a convex solid are neighbors of each other, so they are found from the lowest one.

    Args:
        geometries: The geometries.
        features: Their features.
        side: The solids.
        normal: Normal of the reference plane.
        limit: Offset along the normal up to which a vertex is low [m].
        nearest: The lowest vertex.
        pending: Receives the vertices.
    """
    along = wp.cw_mul(wp.transpose(side.pose.rotation) * normal, side.other.scale)
    shift = wp.dot(normal, side.pose.origin) - limit
    current = wp.int32(0)
    end = wp.int32(0)
    if wp.dot(along, geometries.vertex[nearest]) + shift <= double(0.0):
        pending[end] = nearest
        end += 1
    while current < end:
        vertex = pending[current]
        current += 1
        for i in range(features.neighbor_start[vertex], features.neighbor_start[vertex + 1]):
            neighbor = features.neighbor[i]
            if wp.dot(along, geometries.vertex[neighbor]) + shift <= double(0.0):
                if index_of(pending, 0, 1, end, neighbor) == end:
                    if end == LOW_VERTICES:
                        return -1
                    pending[end] = neighbor
                    end += 1
    return end


@wp.func
def is_above_outline(geometries: Geometries, features: Features, side: ReferenceSide, normal: vec3d, outline: int):
    """Returns whether the bounding box of the other solid, projected along the normal of an outline, is inside the outline."""
    rotation = side.pose.rotation
    center = moved(side.pose, side.other.center)
    end = features.outline_start[outline + 1]
    start = vertex_position(geometries, features.outline_vertex[end - 1], side.own)
    for i in range(features.outline_start[outline], end):
        corner = vertex_position(geometries, features.outline_vertex[i], side.own)
        inward = wp.cross(normal, corner - start)
        reach = wp.dot(wp.abs(wp.transpose(rotation) * inward), side.other.half_extents)
        if wp.dot(inward, center - start) < reach:
            return False
        start = corner
    return True


@wp.func
def keep_extreme_vertices(
    geometries: Geometries,
    side: ReferenceSide,
    normal: vec3d,
    count: int,
    pending: wp.array(dtype=wp.int32),
):
    """Moves the deepest listed vertex and the extremes of some directions to the front, as ``keep_extremes``; returns their number."""
    u_axis, v_axis = axes_across(normal)
    to_other = wp.transpose(side.pose.rotation)
    u_axis = wp.cw_mul(to_other * u_axis, side.other.scale)
    v_axis = wp.cw_mul(to_other * v_axis, side.other.scale)
    along = -wp.cw_mul(to_other * normal, side.other.scale)
    cosine = double(1.0)
    sine = double(0.0)
    kept = wp.int32(0)
    for number in range(DIRECTIONS + 1):
        if number > 0:
            along = cosine * u_axis + sine * v_axis
            turned = COSINE_STEP * cosine - SINE_STEP * sine
            sine = SINE_STEP * cosine + COSINE_STEP * sine
            cosine = turned
        best = wp.int32(0)
        largest = -double(wp.inf)
        for i in range(count):
            value = wp.dot(along, geometries.vertex[pending[i]])
            if value > largest:
                largest = value
                best = i
        if best >= kept:
            vertex = pending[best]
            pending[best] = pending[kept]
            pending[kept] = vertex
            kept += 1
    return kept


@wp.func
def add_low_vertices(
    geometries: Geometries,
    features: Features,
    side: ReferenceSide,
    second_frame: RelativePose,
    plane: int,
    listed: int,
    pending: wp.array(dtype=wp.int32),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the listed vertices of faces towards the plane as candidates of the first patch; arguments as ``add_reference_plane``."""
    normal = geometries.normal[geometries.plane_face[plane]]
    along = wp.transpose(side.pose.rotation) * normal
    count = wp.int32(listed)
    if listed > DIRECTIONS:
        count = keep_extreme_vertices(geometries, side, normal, listed, pending)
    for i in range(count):
        vertex = pending[i]
        k = features.vertex_plane_start[vertex]
        end = features.vertex_plane_start[vertex + 1]
        while k < end:
            if wp.dot(along, geometries.normal[geometries.plane_face[features.vertex_plane[k]]]) < -FACING:
                break
            k += 1
        if k == end:
            continue
        position = moved(side.pose, vertex_position(geometries, vertex, side.other))
        height = height_above_plane(geometries, side.own, plane, position)
        position -= ((double(1.0) - side.kappa) * height) * normal
        own = plane_feature(plane)
        other = vertex_feature(vertex)
        feature = Feature()
        feature.first = wp.where(side.is_second, other, own)
        feature.second = wp.where(side.is_second, own, other)
        add_candidate(patches, candidates, 0, moved(second_frame, position), height, feature)


@wp.func
def low_faces(
    geometries: Geometries,
    features: Features,
    side: ReferenceSide,
    normal: vec3d,
    limit: double,
    listed: int,
    box: BoundingBox,
    pending: wp.array(dtype=wp.int32),
):
    """Lists faces of the other solid at its listed vertices that are clipped; returns their number; −1 if they are too many.

    Arguments as ``list_low_vertices`` and ``add_reference_plane``. ``listed``: number of listed vertices. ``box``: box of the
    outline, in the frame of the reference solid.
    """
    # After the vertices planes with the numbers of their low vertices; the faces replace all of them.
    end = wp.int32(listed)
    for k in range(listed):
        for i in range(features.vertex_plane_start[pending[k]], features.vertex_plane_start[pending[k] + 1]):
            index = index_of(pending, listed, 2, end, features.vertex_plane[i])
            if index == end:
                if end + 2 > PENDING_NODES:
                    return -1
                pending[end] = features.vertex_plane[i]
                pending[end + 1] = 0
                end += 2
            pending[index + 1] += 1
    rotated = wp.transpose(side.pose.rotation) * normal
    count = wp.int32(0)
    steepest = wp.int32(-1)
    least = -FACING
    for index in range(listed, end, 2):
        plane = pending[index]
        low = pending[index + 1]
        cosine = wp.dot(rotated, geometries.normal[geometries.plane_face[plane]])
        if cosine >= -FACING:
            continue
        first_outline = features.plane_outline_start[plane]
        end_outline = features.plane_outline_start[plane + 1]
        if end_outline > first_outline + 1:
            # Several outlines: by the tree of faces.
            return -1
        outline = features.plane_outline[first_outline]
        is_steeper = cosine < least
        if is_steeper and is_outline_outside(geometries, features, side.other, side.pose, outline, box):
            continue
        if is_steeper:
            least = cosine
            steepest = -1
        if low > 2 or cosine < -PARALLEL_FACES:
            pending[count] = geometries.plane_face[plane]
            count += 1
        elif is_steeper:
            steepest = geometries.plane_face[plane]
    if steepest >= 0:
        pending[count] = steepest
        count += 1
    return count


@wp.func
def add_reference_plane(
    geometries: Geometries,
    features: Features,
    side: ReferenceSide,
    second_frame: RelativePose,
    plane: int,
    overlap: double,
    nearest: int,
    reach: Reach,
    corners: wp.array(dtype=ClippedCorner),
    pending: wp.array(dtype=wp.int32),
    patches: wp.array(dtype=Patch),
    candidates: wp.array(dtype=Candidate),
):
    """Adds the corners of the common areas of a plane and the faces of the other solid as candidates of the first patch.

    Faces that are not nearly parallel to the plane, with at most two vertices within reach, add no points to those of their
    neighbors: of them, only the one that is most nearly parallel counts.

    ``overlap``: depth of the other solid below the plane [m]. ``nearest``: its vertex that is nearest to the plane.
    ``second_frame``: pose of the reference solid in the frame of the second one.
    """
    reference_face = geometries.plane_face[plane]
    normal = geometries.normal[reference_face]
    offset = plane_offset(geometries, side.own, reference_face)
    # Normal in the frame of the other solid.
    along = wp.transpose(side.pose.rotation) * normal
    for number in range(features.plane_outline_start[plane], features.plane_outline_start[plane + 1]):
        reference_outline = features.plane_outline[number]
        # Below the pending nodes: faces to be clipped, and planes of several faces that were treated.
        treated = wp.int32(0)
        steepest = wp.int32(-1)
        least = -FACING
        listed = list_low_vertices(geometries, features, side, normal, offset + reach.margin, nearest, pending)
        if listed >= 0 and is_above_outline(geometries, features, side, normal, reference_outline):
            add_low_vertices(geometries, features, side, second_frame, plane, listed, pending, patches, candidates)
            return
        box = outline_box(geometries, features, side.own, reference_outline, reach.margin)
        box.lower -= wp.max(overlap * normal, vec3d())
        box.upper -= wp.min(overlap * normal, vec3d())
        clipped = wp.int32(-1)
        if listed >= 0:
            clipped = low_faces(geometries, features, side, normal, offset + reach.margin, listed, box, pending)
        top = start_traversal(pending, CLIPPED_FACES + TREATED_PLANES, side.other)
        are_listed = clipped >= 0
        is_complete = wp.bool(False)
        while not is_complete:
            if are_listed:
                is_complete = True
            else:
                # By the tree of faces, some of them at a time.
                clipped = 0
            while clipped < CLIPPED_FACES - LEAF_FACES and not is_complete:
                leaf = next_leaf_in_box(
                    pending, CLIPPED_FACES + TREATED_PLANES, top, geometries, side.other, side.pose, box
                )
                top = leaf.top
                for other_face in range(leaf.first_face, leaf.end_face):
                    cosine = wp.dot(along, geometries.normal[other_face])
                    if cosine >= -FACING:
                        continue
                    other_plane = features.face_plane[other_face]
                    outline = outline_of_face(features, other_face)
                    is_treated = wp.bool(False)
                    if outline != other_face:
                        for i in range(CLIPPED_FACES, CLIPPED_FACES + treated):
                            is_treated = is_treated or pending[i] == other_plane
                        if not is_treated and treated < TREATED_PLANES:
                            pending[CLIPPED_FACES + treated] = other_plane
                            treated += 1
                    if is_treated:
                        continue
                    low = low_vertices(
                        geometries, features, side.other, side.pose, outline, normal, offset + reach.margin
                    )
                    if low == 0:
                        continue
                    if low > 2 or cosine < -PARALLEL_FACES:
                        pending[clipped] = other_face
                        clipped += 1
                        if cosine < least:
                            least = cosine
                            steepest = -1
                    elif cosine < least:
                        least = cosine
                        steepest = other_face
                is_complete = leaf.end_face == leaf.first_face
            if is_complete and not are_listed and steepest >= 0:
                pending[clipped] = steepest
                clipped += 1
            for i in range(clipped):
                other_face = pending[i]
                other_outline = outline_of_face(features, other_face)
                count, start = clip_outline(
                    geometries, features, side.own, reference_face, reference_outline, side.other, other_face,
                    other_outline, side.pose, reach.size, corners,
                )  # fmt: skip
                add_corners(
                    geometries, features, side, second_frame, reference_face, reference_outline, other_face,
                    other_outline, reach, corners, start, count, patches, candidates, 0,
                )  # fmt: skip
