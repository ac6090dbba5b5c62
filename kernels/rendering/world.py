"""Items of a picture, each a shape with a pose in a BVH of their boxes, and rays through them: hits and occlusion."""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel

# Kinds of items. Analytic shapes have unit size and are scaled.
MESH = 0
SPHERE = 1  # about the origin
CYLINDER = 2  # about the z axis, from z = 0 to 1, closed
CONE = 3  # about the z axis, from its base at z = 0 to its tip at z = 1


@wp.struct
class World:
    """Items; frames: W of the picture, L of the shape of an item. p_W = position + rotation · (scale ∘ p_L)."""

    count: wp.int32  # number of items; without items there is no BVH
    bvh: wp.uint64  # wp.Bvh over the boxes of the items, W
    kind: wp.array(dtype=wp.int32)  # [item]
    shape: wp.array(dtype=wp.int32)  # [item] index of the mesh
    position: wp.array(dtype=wp.vec3)  # [item]
    rotation: wp.array(dtype=wp.quat)  # [item]
    scale: wp.array(dtype=wp.vec3)  # [item] no component is 0
    color: wp.array(dtype=wp.vec3)  # [item] linear RGB
    has_grid: wp.array(dtype=wp.uint8)  # [item] 1: grid lines on level parts
    infinite: wp.array(dtype=wp.uint8)  # [item] 1: fades into the background
    unlit: wp.array(dtype=wp.uint8)  # [item] 1: a mark whose color does not depend on light
    mesh: wp.array(dtype=wp.uint64)  # [shape] wp.Mesh
    first_normal: wp.array(dtype=wp.int32)  # [shape] first row in ``normals``; −1: flat shading
    first_color: wp.array(dtype=wp.int32)  # [shape] first row in ``colors``; −1: color of the item
    normals: wp.array(dtype=wp.vec3)  # one per vertex of each face, face by face, L
    colors: wp.array(dtype=wp.vec3)  # one per face, linear RGB


@wp.struct
class Hit:
    """First hit of a ray."""

    item: wp.int32  # −1: none
    t: wp.float32  # distance along the ray, in lengths of its direction
    face: wp.int32  # of a mesh
    u: wp.float32  # barycentric weights of the first two vertices of the face
    v: wp.float32


@wp.func
def into_shape(world: World, item: int, v_W: wp.vec3):
    """Returns a vector in the axes and units of the shape of an item."""
    return wp.cw_div(wp.quat_rotate_inv(world.rotation[item], v_W), world.scale[item])


@wp.func
def normal_to_world(world: World, item: int, n_L: wp.vec3):
    """Returns the unit normal in W from one in the frame of the shape."""
    return wp.normalize(wp.quat_rotate(world.rotation[item], wp.cw_div(n_L, world.scale[item])))


@wp.func
def point_to_world(world: World, item: int, p_L: wp.vec3):
    """Returns the position in W of a point of the shape."""
    return world.position[item] + wp.quat_rotate(world.rotation[item], wp.cw_mul(world.scale[item], p_L))


# Distance along a ray that hits nothing.
NO_HIT = wp.constant(-1.0)
_FAR = wp.constant(1.0e30)


@wp.func
def first_positive(enter: float, leave: float):
    """Returns the distance at which a ray enters a convex body, or leaves it if the ray starts inside."""
    if enter > leave:
        return NO_HIT
    if enter > 0.0:
        return enter
    return leave


@wp.func
def intersect_sphere(o: wp.vec3, d: wp.vec3):
    """Returns the distance along the ray from ``o`` along ``d`` to the unit sphere; not positive: none."""
    # Relative to the point nearest to the center, so that a distant origin does not cancel digits.
    squared = wp.dot(d, d)
    nearest = -wp.dot(o, d) / squared
    p = o + nearest * d
    discriminant = 1.0 - wp.dot(p, p)
    if discriminant < 0.0:
        return NO_HIT
    half = wp.sqrt(discriminant / squared)
    return first_positive(nearest - half, nearest + half)


@wp.func
def intersect_cylinder(o: wp.vec3, d: wp.vec3):
    """Returns the distance to the unit cylinder; see ``intersect_sphere``."""
    nearest = -wp.dot(o - wp.vec3(0.0, 0.0, 0.5), d) / wp.dot(d, d)
    p = o + nearest * d
    enter = -_FAR
    leave = _FAR
    a = d[0] * d[0] + d[1] * d[1]
    c = p[0] * p[0] + p[1] * p[1] - 1.0
    if a > 0.0:
        b = p[0] * d[0] + p[1] * d[1]
        root = b * b - a * c
        if root < 0.0:
            return NO_HIT
        enter = (-b - wp.sqrt(root)) / a
        leave = (-b + wp.sqrt(root)) / a
    elif c > 0.0:
        return NO_HIT
    if d[2] != 0.0:
        bottom = -p[2] / d[2]
        top = (1.0 - p[2]) / d[2]
        enter = wp.max(enter, wp.min(bottom, top))
        leave = wp.min(leave, wp.max(bottom, top))
    elif p[2] < 0.0 or p[2] > 1.0:
        return NO_HIT
    return first_positive(nearest + enter, nearest + leave)


@wp.func
def nearer_cone_hit(t: float, p: wp.vec3, d: wp.vec3, start: float, best: float):
    """Returns ``start + t`` if that point is between base and tip and nearer than ``best``, else ``best``."""
    z = p[2] + t * d[2]
    if z >= 0.0 and z <= 1.0 and start + t > 0.0 and start + t < best:
        return start + t
    return best


@wp.func
def intersect_cone(o: wp.vec3, d: wp.vec3):
    """Returns the distance to the unit cone; see ``intersect_sphere``."""
    nearest = -wp.dot(o - wp.vec3(0.0, 0.0, 0.5), d) / wp.dot(d, d)
    p = o + nearest * d
    best = _FAR
    a = d[0] * d[0] + d[1] * d[1] - d[2] * d[2]
    b = p[0] * d[0] + p[1] * d[1] + (1.0 - p[2]) * d[2]
    c = p[0] * p[0] + p[1] * p[1] - (1.0 - p[2]) * (1.0 - p[2])
    if wp.abs(a) > 1.0e-6 * wp.dot(d, d):
        root = b * b - a * c
        if root >= 0.0:
            best = nearer_cone_hit((-b - wp.sqrt(root)) / a, p, d, nearest, best)
            best = nearer_cone_hit((-b + wp.sqrt(root)) / a, p, d, nearest, best)
    elif b != 0.0:
        best = nearer_cone_hit(-0.5 * c / b, p, d, nearest, best)
    if d[2] != 0.0:
        t = -p[2] / d[2]
        x = p[0] + t * d[0]
        y = p[1] + t * d[1]
        if x * x + y * y <= 1.0 and nearest + t > 0.0 and nearest + t < best:
            best = nearest + t
    return wp.where(best < _FAR, best, NO_HIT)


@wp.func
def intersect_shape(kind: int, o: wp.vec3, d: wp.vec3):
    """Returns the distance along a ray to a shape of this kind, in its frame; not positive: none."""
    if kind == SPHERE:
        return intersect_sphere(o, d)
    if kind == CYLINDER:
        return intersect_cylinder(o, d)
    return intersect_cone(o, d)


@wp.func
def shape_normal(kind: int, p: wp.vec3, scale: wp.vec3):
    """Returns the outer normal at a point of a shape of this kind, in its frame."""
    if kind == SPHERE:
        return p
    radius = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    if kind == CONE:
        if p[2] * scale[2] < wp.abs(1.0 - p[2] - radius) * scale[0]:
            return wp.vec3(0.0, 0.0, -1.0)
        return wp.vec3(p[0], p[1], radius)
    # Cylinder: the nearest of side and ends.
    side = wp.abs(1.0 - radius) * scale[0]
    if wp.abs(p[2]) * scale[2] < side:
        return wp.vec3(0.0, 0.0, -1.0)
    if wp.abs(1.0 - p[2]) * scale[2] < side:
        return wp.vec3(0.0, 0.0, 1.0)
    return wp.vec3(p[0], p[1], 0.0)


@wp.func
def trace(world: World, origin: wp.vec3, direction: wp.vec3, limit: float):
    """Returns the first hit of a ray before ``limit`` lengths of ``direction``."""
    best = Hit()
    best.item = wp.int32(-1)
    best.t = limit
    if world.count > 0:
        query = wp.bvh_query_ray(world.bvh, origin, direction)
        item = wp.int32(0)
        while wp.bvh_query_next(query, item, best.t):
            o = into_shape(world, item, origin - world.position[item])
            d = into_shape(world, item, direction)
            kind = world.kind[item]
            if kind == MESH:
                hit = wp.mesh_query_ray(world.mesh[world.shape[item]], o, d, best.t)
                if hit.result:
                    best.item = item
                    best.t = hit.t
                    best.face = hit.face
                    best.u = hit.u
                    best.v = hit.v
            else:
                t = intersect_shape(kind, o, d)
                if t > 0.0 and t < best.t:
                    best.item = item
                    best.t = t
    return best


@wp.func
def is_unoccluded(world: World, origin: wp.vec3, direction: wp.vec3, limit: float):
    """Returns whether a ray hits nothing before ``limit`` lengths of ``direction``."""
    if world.count > 0:
        query = wp.bvh_query_ray(world.bvh, origin, direction)
        item = wp.int32(0)
        while wp.bvh_query_next(query, item, limit):
            o = into_shape(world, item, origin - world.position[item])
            d = into_shape(world, item, direction)
            kind = world.kind[item]
            if kind == MESH:
                if wp.mesh_query_ray_anyhit(world.mesh[world.shape[item]], o, d, limit):
                    return False
            else:
                t = intersect_shape(kind, o, d)
                if t > 0.0 and t < limit:
                    return False
    return True


@wp.func
def flat_normal(world: World, hit: Hit, p_L: wp.vec3):
    """Returns the outer normal of a hit, W; for a mesh the face normal."""
    item = hit.item
    kind = world.kind[item]
    n_L = wp.vec3()
    if kind == MESH:
        n_L = wp.mesh_eval_face_normal(world.mesh[world.shape[item]], hit.face)
    else:
        n_L = shape_normal(kind, p_L, world.scale[item])
    return normal_to_world(world, item, n_L)


@wp.func
def smooth_normal(world: World, hit: Hit, flat_W: wp.vec3):
    """Returns the shading normal of a hit, W; for a smooth mesh interpolated between its vertex normals."""
    item = hit.item
    if world.kind[item] != MESH:
        return flat_W
    first = world.first_normal[world.shape[item]]
    if first < 0:
        return flat_W
    corner = first + 3 * hit.face
    w = 1.0 - hit.u - hit.v
    n_L = hit.u * world.normals[corner] + hit.v * world.normals[corner + 1] + w * world.normals[corner + 2]
    return normal_to_world(world, item, n_L)


@wp.func
def shadow_ray_origin(world: World, hit: Hit, p_W: wp.vec3, side: float):
    """Returns the origin of shadow rays: a point of the smooth surface instead of the face.

    With the point of the face, edges between faces would be visible in self-shadows. The point is moved to the
    weighted mean of the planes of the vertex normals (Hanika, Hacking the Shadow Terminator, 2021).
    """
    item = hit.item
    if world.kind[item] != MESH:
        return p_W
    shape = world.shape[item]
    first = world.first_normal[shape]
    if first < 0:
        return p_W
    shift = wp.vec3()
    for k in range(3):
        weight = wp.where(k == 0, hit.u, wp.where(k == 1, hit.v, 1.0 - hit.u - hit.v))
        corner_W = point_to_world(world, item, wp.mesh_get_point(world.mesh[shape], 3 * hit.face + k))
        n_W = side * normal_to_world(world, item, world.normals[first + 3 * hit.face + k])
        below = wp.min(wp.dot(p_W - corner_W, n_W), 0.0)
        shift -= weight * below * n_W
    return p_W + shift


@wp.func
def surface_color(world: World, hit: Hit):
    """Returns the color of a hit, linear RGB."""
    item = hit.item
    color = world.color[item]
    if world.kind[item] == MESH:
        first = world.first_color[world.shape[item]]
        if first >= 0:
            color = world.colors[first + hit.face]
    return color


@functools.cache
def visibility() -> wp.Kernel:
    """Returns the kernel that tests the visibility of points, one per thread."""

    @unique_kernel()
    def test_points(
        world: World,
        eye: wp.vec3,
        points: wp.array(dtype=wp.vec3),  # W
        radii: wp.array(dtype=wp.float32),  # surfaces nearer to a point than this do not hide it
        visible: wp.array(dtype=wp.uint8),  # 1: visible
    ):
        i = wp.tid()
        offset = points[i] - eye
        distance = wp.length(offset)
        visible[i] = wp.uint8(0)
        if distance <= radii[i] or is_unoccluded(world, eye, offset / distance, distance - radii[i]):
            visible[i] = wp.uint8(1)

    return test_points
