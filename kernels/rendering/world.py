"""What is in a picture: items, each a shape that is placed, in a tree of their boxes."""

import warp as wp

# Kinds of items. Those of analytic form are of unit size and scaled.
MESH = 0
SPHERE = 1  # about the origin
CYLINDER = 2  # about the z axis, from z = 0 to 1, with both ends
CONE = 3  # about the z axis, from its base at z = 0 to its tip at z = 1


@wp.struct
class World:
    """Items; frames: W of the picture, L of the shape of an item. p_W = position + rotation · (scale ∘ p_L)."""

    count: wp.int32  # items; with none there is no tree
    bvh: wp.uint64  # wp.Bvh over the boxes of the items, W
    kind: wp.array(dtype=wp.int32)  # [item]
    shape: wp.array(dtype=wp.int32)  # [item] of a mesh: which
    position: wp.array(dtype=wp.vec3)  # [item]
    rotation: wp.array(dtype=wp.quat)  # [item]
    scale: wp.array(dtype=wp.vec3)  # [item] none is 0
    color: wp.array(dtype=wp.vec3)  # [item] linear RGB
    has_grid: wp.array(dtype=wp.uint8)  # [item] 1: with lines of a grid where it is level
    infinite: wp.array(dtype=wp.uint8)  # [item] 1: fades into the background far away
    mesh: wp.array(dtype=wp.uint64)  # [shape] wp.Mesh
    first_normal: wp.array(dtype=wp.int32)  # [shape] where in ``normals`` its corners begin; −1: faces are flat
    first_color: wp.array(dtype=wp.int32)  # [shape] where in ``colors`` its faces begin; −1: that of the item
    normals: wp.array(dtype=wp.vec3)  # of the corners of faces, one face after the other, L
    colors: wp.array(dtype=wp.vec3)  # of faces, linear RGB


@wp.struct
class Hit:
    """Where a ray first meets something."""

    item: wp.int32  # −1: nothing
    t: wp.float32  # along the ray, in lengths of its direction
    face: wp.int32  # of a mesh
    u: wp.float32  # weights of the first two corners of the face
    v: wp.float32


@wp.func
def into_shape(world: World, item: int, v_W: wp.vec3):
    """A vector in the axes of the shape of an item, in its units."""
    return wp.cw_div(wp.quat_rotate_inv(world.rotation[item], v_W), world.scale[item])


@wp.func
def normal_to_world(world: World, item: int, n_L: wp.vec3):
    """A normal of the shape of an item in W, of unit length."""
    return wp.normalize(wp.quat_rotate(world.rotation[item], wp.cw_div(n_L, world.scale[item])))


@wp.func
def point_to_world(world: World, item: int, p_L: wp.vec3):
    """A point of the shape of an item in W."""
    return world.position[item] + wp.quat_rotate(world.rotation[item], wp.cw_mul(world.scale[item], p_L))
