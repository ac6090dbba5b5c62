"""Regions of a face whose points are crossed by the columns of a curved solid and a polyhedron.

Columns on a face of the polyhedron stand on its section with the curved solid. Columns on a sheet of the curved solid cross the face
in the section with the points below the sheet: those of which the closest point of the sheet, extended, is on the sheet. They
are the solid itself, except for a cone: its columns may leave it through the other sheet.
"""

import warp as wp
from warpcontact.kernels.body_contact.columns import FaceFrame, cut_by_depth, position_on_face
from warpcontact.kernels.body_contact.curved_sections import Region
from warpcontact.kernels.body_contact.curved_solids import (
    CAPSULE,
    CONE,
    ELLIPSOID,
    Section,
    part_count,
    profile_of,
    with_radius,
)
from warpcontact.kernels.body_contact.curved_surfaces import sheet_point
from warpcontact.kernels.body_contact.overlap import FULL_WEIGHT, NO_WEIGHT
from warpcontact.kernels.body_contact.polygons import STORED, Polygon, corner, set_corner
from warpcontact.kernels.body_contact.solids import RelativePose

double = wp.float64
vec3d = wp.vec3d

# Height of the tip of a cone above a half-space, relative to its height, up to which it affects columns.
TIP_REACH = wp.constant(double(0.25))
# Columns on faces of the polyhedron, on the curved surface, and from here on on the flat ends of the curved solid.
ON_FACE = 0
ON_CURVED_SURFACE = 1
ON_END = 2


@wp.func
def store_face(corners: wp.array2d(dtype=double), frame: FaceFrame, section: Section):
    """Stores the corners (u, v, 0) of a face in the coordinates of a section, and returns the stored ``Polygon``."""
    polygon = Polygon()
    polygon.start = STORED
    polygon.count = frame.count
    polygon.weight = double(1.0)
    for i in range(frame.count):
        position = position_on_face(frame, frame.corners[i, 0], frame.corners[i, 1]) - section.center
        set_corner(
            corners,
            STORED + i,
            vec3d(wp.dot(section.u_dual, position), wp.dot(section.v_dual, position), double(0.0)),
        )
    return polygon


@wp.func
def region_count(flags: int, kind: int):
    """Returns the number of regions of a face for one kind of columns."""
    if kind >= ON_END:
        # Depths of full weight, and of decreasing weight.
        return wp.int32(2)
    if kind == ON_CURVED_SURFACE and (flags & CONE) != 0:
        return wp.int32(2)
    return part_count(flags)


@wp.func
def region_of(flags: int, scale: vec3d, kind: int, number: int, section: Section, depth: double):
    """Returns one ``Region`` of a face or half-space for one kind of columns.

    Args:
        flags: Kind of the solid.
        scale: Its sizes [m].
        kind: Kind of columns.
        number: Number of the region.
        section: The plane of the face.
        depth: Depth of the overlap, from which the weights of columns follow; infinite on a half-space [m].
    """
    region = Region()
    if kind == ON_FACE:
        region.profile = profile_of(flags, scale, number)
        region.has_tip = section.has_tip
        # On a half-space, columns enter and leave each part of a capsule. On a face, they run to the end of the capsule.
        if depth == double(wp.inf):
            region.end_count = 2
            # Also if it is not far above the plane: columns enter the solid around it.
            region.has_tip = (flags & CONE) != 0 and section.tip_height < TIP_REACH * scale[2]
        elif (flags & CAPSULE) == 0:
            region.end_count = 1
        if flags & ELLIPSOID:
            region.end_count = 0
        return region
    if kind >= ON_END:
        # Within the circle of the end.
        region.profile = profile_of(flags, scale, 0)
        region.profile.k_1 = double(0.0)
        region.profile.k_2 = double(0.0)
        return region
    region.profile = profile_of(flags, scale, number)
    if (flags & CONE) != 0 and number == 1:
        # Below the base, columns are inside the normals of the curved surface at its edge.
        slope = scale[2] / scale[0]
        region.profile.k_1 = double(2.0) * scale[0] * slope
        region.profile.k_2 = slope * slope
        region.profile.lower = -scale[0] / slope
        region.profile.upper = double(0.0)
        return region
    inner_1, has_first = with_radius(region.profile, flags, scale, FULL_WEIGHT * depth)
    inner_2, has_second = with_radius(region.profile, flags, scale, NO_WEIGHT * depth)
    region.inner_1 = inner_1
    region.inner_2 = inner_2
    if has_first:
        region.inner_count = 1
        if has_second:
            region.inner_count = 2
    return region


@wp.func
def polygon_of_region(
    corners: wp.array2d(dtype=double),
    face: Polygon,
    frame: FaceFrame,
    flags: int,
    scale: vec3d,
    pose: RelativePose,
    kind: int,
    number: int,
    depth: double,
):
    """Returns the part of a face that contains a region: all of it, or depths below a flat end with one form of the weight.

    Args:
        corners: Corners of the polygons of the thread.
        face: The face, from ``store_face``.
        frame: Its plane.
        flags: Kind of the curved solid.
        scale: Its sizes [m].
        pose: Its pose in the frame of the face.
        kind: Kind of columns.
        number: Number of the region.
        depth: Depth of the overlap [m].
    """
    if kind < ON_END or face.count == 0:
        return face
    polygon = Polygon()
    polygon.count = face.count
    polygon.weight = double(1.0)
    for i in range(face.count):
        position = position_on_face(frame, frame.corners[i, 0], frame.corners[i, 1])
        from_solid = wp.transpose(pose.rotation) * (position - pose.origin)
        point = corner(corners, face, i)
        point[2] = sheet_point(flags, scale, kind - ON_CURVED_SURFACE, from_solid).depth
        set_corner(corners, i, point)
    if number == 0:
        return cut_by_depth(corners, polygon, double(0.0), FULL_WEIGHT * depth)
    return cut_by_depth(corners, polygon, FULL_WEIGHT * depth, NO_WEIGHT * depth)
