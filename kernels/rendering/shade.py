"""The colour of what a ray meets: a sun with a soft shadow, a sky that corners are darker under, a dim lamp."""

import warp as wp
from warpcontact.kernels.rendering.rays import color_of, flat_normal, is_free, raised, smooth_normal, trace
from warpcontact.kernels.rendering.world import Hit, World, into_shape

# Beyond everything, in units of the view.
FAR = wp.constant(1.0e6)
# How far from a surface rays to the light begin: of the distance to the eye, to which positions are rounded.
APART = wp.constant(1.0e-4)


@wp.struct
class Light:
    """Where light comes from; colours are linear RGB, the sum of all on a white face towards the sun about 1."""

    sun: wp.vec3  # unit vector to its middle, W
    across: wp.vec3  # unit vectors at right angles to it
    along: wp.vec3
    spread: wp.float32  # radius of its disc, at distance 1
    sun_color: wp.vec3
    sky_color: wp.vec3  # from above
    ground_color: wp.vec3  # from below
    lamp: wp.float32  # at the eye
    gloss: wp.float32  # share of the sun that is mirrored
    reach: wp.float32  # how near things take the sky away from each other, in units of the view


@wp.struct
class Backdrop:
    """What is behind everything, and where things fade into it; colours are linear RGB."""

    top: wp.vec3
    bottom: wp.vec3
    fade_from: wp.float32  # distance from the middle of the view where fading begins, and where it is complete
    fade_to: wp.float32


@wp.func
def on_disc(x: float, y: float):
    """A point of the unit disc, evenly for points of the unit square."""
    radius = wp.sqrt(x)
    angle = 6.2831853 * y
    return wp.vec2(radius * wp.cos(angle), radius * wp.sin(angle))


@wp.func
def towards_sky(n: wp.vec3, x: float, y: float):
    """A direction about the normal ``n`` by the law of the cosine, for points of the unit square."""
    z = 1.0 - 2.0 * x
    radius = wp.sqrt(wp.max(1.0 - z * z, 0.0))
    angle = 6.2831853 * y
    direction = n + wp.vec3(radius * wp.cos(angle), radius * wp.sin(angle), z)
    if wp.dot(direction, direction) < 1.0e-6:
        return n
    return wp.normalize(direction)


@wp.func
def lit(
    world: World,
    light: Light,
    hit: Hit,
    p_W: wp.vec3,
    ray: wp.vec3,
    at_sun: wp.vec2,
    at_sky: wp.vec2,
    shadows: bool,
):
    """The colour of the point ``p_W`` that a ray met, seen along the unit vector ``ray``, linear RGB."""
    p_L = into_shape(world, hit.item, p_W - world.position[hit.item])
    flat = flat_normal(world, hit, p_L)
    n = smooth_normal(world, hit, flat)
    # Both sides of a face are seen and lit alike.
    side = wp.where(wp.dot(flat, ray) > 0.0, -1.0, 1.0)
    flat = side * flat
    n = side * n
    bent = wp.dot(n, ray)
    if bent > 0.0:  # a normal between corners that looks away, at the rim of a smooth shape
        n = wp.normalize(n - 1.01 * bent * ray)
    sunlight = float(0.0)
    mirrored = float(0.0)
    open_sky = float(1.0)
    disc = on_disc(at_sun[0], at_sun[1])
    to_sun = wp.normalize(light.sun + light.spread * (disc[0] * light.across + disc[1] * light.along))
    facing = wp.dot(n, to_sun)
    start = p_W + (APART * hit.t) * flat
    if facing > 0.0:
        free = bool(True)
        if shadows:
            free = is_free(world, raised(world, hit, p_W, side) + (APART * hit.t) * flat, to_sun, FAR)
        if free:
            sunlight = facing
            halfway = wp.normalize(to_sun - ray)
            mirrored = light.gloss * wp.pow(wp.max(wp.dot(n, halfway), 0.0), 40.0)
    if shadows:
        to_sky = towards_sky(n, at_sky[0], at_sky[1])
        if wp.dot(to_sky, flat) > 0.0:
            if not is_free(world, start, to_sky, light.reach):
                open_sky = 0.0
    above = 0.5 + 0.5 * n[2]
    around = above * light.sky_color + (1.0 - above) * light.ground_color
    received = open_sky * around + sunlight * light.sun_color
    glow = received + wp.vec3(1.0, 1.0, 1.0) * (light.lamp * wp.max(-wp.dot(n, ray), 0.0))
    return wp.cw_mul(color_of(world, hit), glow) + mirrored * light.sun_color


@wp.func
def seen(
    world: World,
    marks: World,
    light: Light,
    backdrop: Backdrop,
    eye: wp.vec3,
    ray: wp.vec3,
    height: float,
    at_sun: wp.vec2,
    at_sky: wp.vec2,
):
    """What is seen along a unit vector, linear RGB in 0…1; ``height`` in the picture: 0 at the bottom, 1 at the top.

    Marks, such as arrows, neither cast nor catch shadows, and shine through what is before them.
    """
    behind = height * backdrop.top + (1.0 - height) * backdrop.bottom
    color = behind
    hit = trace(world, eye, ray, FAR)
    if hit.item >= 0:
        p_W = eye + hit.t * ray
        # The middle of the view is the origin.
        fog = wp.smoothstep(backdrop.fade_from, backdrop.fade_to, wp.length(p_W))
        if fog < 1.0:
            surface = lit(world, light, hit, p_W, ray, at_sun, at_sky, True)
            color = (1.0 - fog) * surface + fog * behind
    mark = trace(marks, eye, ray, FAR)
    if mark.item >= 0:
        over = lit(marks, light, mark, eye + mark.t * ray, ray, wp.vec2(), wp.vec2(), False)
        share = wp.where(mark.t < hit.t, 1.0, 0.5)
        color = share * over + (1.0 - share) * color
    return wp.min(wp.max(color, wp.vec3(0.0, 0.0, 0.0)), wp.vec3(1.0, 1.0, 1.0))
