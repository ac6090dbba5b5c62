"""The colour of what a ray meets: a sun with a soft shadow, a sky that corners are darker under, a dim lamp."""

import warp as wp
from warpcontact.kernels.rendering.rays import color_of, flat_normal, is_free, raised, smooth_normal, trace
from warpcontact.kernels.rendering.world import Hit, World, into_shape

# Beyond everything, in units of the view.
FAR = wp.constant(1.0e6)
# How far from a surface rays to the light begin, in units of the view, and what more for the distance to the eye.
APART = wp.constant(1.0e-4)
ROUNDING = wp.constant(4.0e-6)


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
class Grid:
    """Lines along x and y on the ground, to see how large things are, and that they move."""

    step: wp.float32  # from one to the next
    origin: wp.vec2  # where two of them cross, W
    shade: wp.float32  # brightness of a line
    pixel: wp.float32  # what a pixel sees at distance 1


@wp.struct
class Backdrop:
    """What is behind everything, and where planes without end fade into it; colours are linear RGB."""

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
def on_line(x: float, step: float, blur: float):
    """How much of a stretch of length ``blur`` about ``x`` lies on lines at the multiples of ``step``."""
    half = 0.008 * step
    away = wp.abs(x / step - wp.floor(x / step + 0.5)) * step
    # The part of the stretch that is within the line, or of what it sees of many lines.
    covered = wp.min(away + 0.5 * blur, half) - wp.max(away - 0.5 * blur, -half)
    return wp.clamp(covered / blur, 0.0, 1.0)


@wp.func
def ruling(grid: Grid, p_W: wp.vec3, n: wp.vec3, ray: wp.vec3, t: float):
    """The brightness of a point of the ground by the lines on it, between that of a line and 1."""
    level = wp.smoothstep(0.6, 0.9, wp.abs(n[2]))
    blur = grid.pixel * t / wp.max(wp.abs(wp.dot(n, ray)), 0.05)
    x = on_line(p_W[0] - grid.origin[0], grid.step, blur)
    y = on_line(p_W[1] - grid.origin[1], grid.step, blur)
    return 1.0 - level * (1.0 - grid.shade) * wp.max(x, y)


@wp.func
def lit(
    world: World,
    light: Light,
    grid: Grid,
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
    sunlight = wp.float32(0.0)
    mirrored = wp.float32(0.0)
    open_sky = wp.float32(1.0)
    disc = on_disc(at_sun[0], at_sun[1])
    to_sun = wp.normalize(light.sun + light.spread * (disc[0] * light.across + disc[1] * light.along))
    facing = wp.dot(n, to_sun)
    apart = (APART + ROUNDING * hit.t) * flat
    if facing > 0.0:
        sunlight = facing
        mirrored = light.gloss * wp.pow(wp.max(wp.dot(n, wp.normalize(to_sun - ray)), 0.0), 40.0)
    if shadows:
        if facing > 0.0:  # a ray for those alone that the sun could reach
            free = is_free(world, raised(world, hit, p_W, side) + apart, to_sun, FAR)
            sunlight = wp.where(free, sunlight, 0.0)
            mirrored = wp.where(free, mirrored, 0.0)
        to_sky = towards_sky(n, at_sky[0], at_sky[1])
        if wp.dot(to_sky, flat) > 0.0:
            # What is farther away takes less of it.
            open_sky = trace(world, p_W + apart, to_sky, light.reach).t / light.reach
    above = 0.5 + 0.5 * n[2]
    around = above * light.sky_color + (1.0 - above) * light.ground_color
    received = open_sky * around + sunlight * light.sun_color
    glow = received + wp.vec3(1.0, 1.0, 1.0) * (light.lamp * wp.max(-wp.dot(n, ray), 0.0))
    color = color_of(world, hit)
    if world.ruled[hit.item] != wp.uint8(0):
        color = color * ruling(grid, p_W, flat, ray, hit.t)
        mirrored = 0.0
    return wp.cw_mul(color, glow) + mirrored * light.sun_color


@wp.func
def seen(
    world: World,
    marks: World,
    light: Light,
    grid: Grid,
    backdrop: Backdrop,
    eye: wp.vec3,
    ray: wp.vec3,
    height: float,
    at_sun: wp.vec2,
    at_sky: wp.vec2,
):
    """What is seen along a unit vector, linear RGB in 0…1; ``height`` in the picture is 0 at the bottom, 1 on top.

    Marks, such as arrows, neither cast nor catch shadows, and shine through what is before them.
    """
    behind = height * backdrop.top + (1.0 - height) * backdrop.bottom
    color = behind
    hit = trace(world, eye, ray, FAR)
    if hit.item >= 0:
        p_W = eye + hit.t * ray
        fog = wp.float32(0.0)
        if world.endless[hit.item] != wp.uint8(0):
            # The middle of the view is the origin.
            fog = wp.smoothstep(backdrop.fade_from, backdrop.fade_to, wp.length(p_W))
        if fog < 1.0:
            surface = lit(world, light, grid, hit, p_W, ray, at_sun, at_sky, True)
            color = (1.0 - fog) * surface + fog * behind
    mark = trace(marks, eye, ray, FAR)
    if mark.item >= 0:
        over = lit(marks, light, grid, mark, eye + mark.t * ray, ray, wp.vec2(), wp.vec2(), False)
        share = wp.where(mark.t < hit.t, 1.0, 0.6)
        color = share * over + (1.0 - share) * color
    return wp.min(wp.max(color, wp.vec3(0.0, 0.0, 0.0)), wp.vec3(1.0, 1.0, 1.0))
