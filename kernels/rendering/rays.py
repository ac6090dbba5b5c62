"""Rays through a world: first hit, occlusion test, and normal and color of a hit."""

import warp as wp
from warpcontact.kernels.rendering.forms import intersect_shape, shape_normal
from warpcontact.kernels.rendering.world import MESH, Hit, World, into_shape, normal_to_world, point_to_world


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
