"""Contents of a picture: items, each a shape with a pose, in a BVH of their boxes."""

import warp as wp

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
