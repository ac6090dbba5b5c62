"""Pixels of a picture: adaptive supersampling with rays from the eye, averaged and encoded as sRGB.

The color of a hit has three light sources: a sun with soft shadow, a sky with ambient occlusion, and a dim light at
the eye.
"""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.rendering.world import (
    Hit,
    World,
    flat_normal,
    into_shape,
    is_unoccluded,
    shadow_ray_origin,
    smooth_normal,
    surface_color,
    trace,
)

# Larger than all distances, in units of the view.
MAX_DISTANCE = wp.constant(1.0e6)
# Distance of the origins of secondary rays from the surface, in units of the view, and per distance to the eye.
RAY_OFFSET = wp.constant(1.0e-4)
ROUNDING = wp.constant(4.0e-6)
# Opacity of unlit marks behind surfaces.
UNLIT_OPACITY = wp.constant(0.9)


@wp.struct
class Light:
    """Light sources. Colors are linear RGB; a white face towards the sun gets about 1 in total."""

    sun: wp.vec3  # unit vector to its center, W
    across: wp.vec3  # unit vectors normal to it
    along: wp.vec3
    spread: wp.float32  # radius of its disk at distance 1
    sun_color: wp.vec3
    sky_color: wp.vec3  # from above
    ground_color: wp.vec3  # from below
    lamp: wp.float32  # at the eye
    gloss: wp.float32  # fraction of sunlight in the highlight
    occlusion_range: wp.float32  # largest distance of occluding surfaces, in units of the view


@wp.struct
class Grid:
    """Grid lines along x and y on the ground, as a scale and to make motion visible."""

    step: wp.float32  # distance of lines
    origin: wp.vec2  # an intersection of lines, W
    shade: wp.float32  # brightness of a line
    pixel: wp.float32  # size of a pixel at distance 1


@wp.struct
class Backdrop:
    """Background, into which unbounded planes fade; colors are linear RGB."""

    top: wp.vec3
    bottom: wp.vec3
    fade_from: wp.float32  # distances from the center of the view at which fading starts and ends
    fade_to: wp.float32


@wp.func
def sample_disk(x: float, y: float):
    """Maps a point of the unit square to the unit disk, uniformly."""
    radius = wp.sqrt(x)
    angle = 6.2831853 * y
    return wp.vec2(radius * wp.cos(angle), radius * wp.sin(angle))


@wp.func
def sample_hemisphere(n: wp.vec3, x: float, y: float):
    """Maps a point of the unit square to a direction about the normal ``n``, cosine-weighted."""
    z = 1.0 - 2.0 * x
    radius = wp.sqrt(wp.max(1.0 - z * z, 0.0))
    angle = 6.2831853 * y
    direction = n + wp.vec3(radius * wp.cos(angle), radius * wp.sin(angle), z)
    if wp.dot(direction, direction) < 1.0e-6:
        return n
    return wp.normalize(direction)


@wp.func
def line_coverage(x: float, step: float, blur: float):
    """Returns the fraction of an interval of length ``blur`` about ``x`` on lines at the multiples of ``step``."""
    half = 0.008 * step
    away = wp.abs(x / step - wp.floor(x / step + 0.5)) * step
    # Part of the interval within the nearest line.
    covered = wp.min(away + 0.5 * blur, half) - wp.max(away - 0.5 * blur, -half)
    return wp.clamp(covered / blur, 0.0, 1.0)


@wp.func
def grid_brightness(grid: Grid, p_W: wp.vec3, n: wp.vec3, ray: wp.vec3, t: float):
    """Returns the brightness factor of a ground point due to grid lines, from that of a line to 1."""
    level = wp.smoothstep(0.6, 0.9, wp.abs(n[2]))
    blur = grid.pixel * t / wp.max(wp.abs(wp.dot(n, ray)), 0.05)
    x = line_coverage(p_W[0] - grid.origin[0], grid.step, blur)
    y = line_coverage(p_W[1] - grid.origin[1], grid.step, blur)
    return 1.0 - level * (1.0 - grid.shade) * wp.max(x, y)


@wp.func
def shade_hit(
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
    """Returns the color of the hit point ``p_W``, seen along the unit vector ``ray``, linear RGB."""
    p_L = into_shape(world, hit.item, p_W - world.position[hit.item])
    flat = flat_normal(world, hit, p_L)
    n = smooth_normal(world, hit, flat)
    # Both sides of a face are visible and lit in the same way.
    side = wp.where(wp.dot(flat, ray) > 0.0, -1.0, 1.0)
    flat = side * flat
    n = side * n
    back_facing = wp.dot(n, ray)
    if back_facing > 0.0:  # interpolated normal faces away, at the silhouette of a smooth shape
        n = wp.normalize(n - 1.01 * back_facing * ray)
    sunlight = wp.float32(0.0)
    mirrored = wp.float32(0.0)
    open_sky = wp.float32(1.0)
    disc = sample_disk(at_sun[0], at_sun[1])
    to_sun = wp.normalize(light.sun + light.spread * (disc[0] * light.across + disc[1] * light.along))
    cosine = wp.dot(n, to_sun)
    offset = (RAY_OFFSET + ROUNDING * hit.t) * flat
    if cosine > 0.0:
        sunlight = cosine
        mirrored = light.gloss * wp.pow(wp.max(wp.dot(n, wp.normalize(to_sun - ray)), 0.0), 40.0)
    if shadows:
        if cosine > 0.0:  # shadow rays only where the sun can reach
            free = is_unoccluded(world, shadow_ray_origin(world, hit, p_W, side) + offset, to_sun, MAX_DISTANCE)
            sunlight = wp.where(free, sunlight, 0.0)
            mirrored = wp.where(free, mirrored, 0.0)
        to_sky = sample_hemisphere(n, at_sky[0], at_sky[1])
        if wp.dot(to_sky, flat) > 0.0:
            # More distant surfaces occlude less.
            open_sky = trace(world, p_W + offset, to_sky, light.occlusion_range).t / light.occlusion_range
    above = 0.5 + 0.5 * n[2]
    ambient = above * light.sky_color + (1.0 - above) * light.ground_color
    received = open_sky * ambient + sunlight * light.sun_color
    glow = received + wp.vec3(1.0, 1.0, 1.0) * (light.lamp * wp.max(-wp.dot(n, ray), 0.0))
    color = surface_color(world, hit)
    if world.has_grid[hit.item] != wp.uint8(0):
        color = color * grid_brightness(grid, p_W, flat, ray, hit.t)
        mirrored = 0.0
    return wp.cw_mul(color, glow) + mirrored * light.sun_color


@wp.func
def trace_color(
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
    """Returns the color along the unit vector ``ray``, linear RGB in 0…1.

    ``height``: Position in the picture, 0 at the bottom, 1 at the top. Marks, such as arrows, have no shadows and
    are partly visible through surfaces in front of them. Unlit marks have their own color.
    """
    background = height * backdrop.top + (1.0 - height) * backdrop.bottom
    color = background
    hit = trace(world, eye, ray, MAX_DISTANCE)
    if hit.item >= 0:
        p_W = eye + hit.t * ray
        fog = wp.float32(0.0)
        if world.infinite[hit.item] != wp.uint8(0):
            # The origin is the center of the view.
            fog = wp.smoothstep(backdrop.fade_from, backdrop.fade_to, wp.length(p_W))
        if fog < 1.0:
            surface = shade_hit(world, light, grid, hit, p_W, ray, at_sun, at_sky, True)
            color = (1.0 - fog) * surface + fog * background
    mark = trace(marks, eye, ray, MAX_DISTANCE)
    if mark.item >= 0:
        mark_color = surface_color(marks, mark)
        opacity = wp.where(mark.t < hit.t, 1.0, UNLIT_OPACITY)
        if marks.unlit[mark.item] == wp.uint8(0):
            mark_color = shade_hit(marks, light, grid, mark, eye + mark.t * ray, ray, wp.vec2(), wp.vec2(), False)
            opacity = wp.where(mark.t < hit.t, 1.0, 0.6)
        color = opacity * mark_color + (1.0 - opacity) * color
    return wp.min(wp.max(color, wp.vec3(0.0, 0.0, 0.0)), wp.vec3(1.0, 1.0, 1.0))


# Samples per pixel before the contrast is tested.
INITIAL_SAMPLES = wp.constant(4)
# Contrast above which a pixel gets all samples: difference in square roots of linear color.
CONTRAST_THRESHOLD = wp.constant(0.04)
# Steps of the R₂ sequence, a low-discrepancy sequence in the unit square.
_STEP_X = wp.constant(0.7548776662466927)
_STEP_Y = wp.constant(0.5698402909980532)


@wp.struct
class View:
    """Camera. The origin is the look-at point."""

    eye: wp.vec3
    forward: wp.vec3  # unit vectors, W
    right: wp.vec3
    up: wp.vec3
    tangent: wp.float32  # of half the vertical field of view
    width: wp.int32  # pixels
    height: wp.int32
    samples: wp.int32  # largest number of rays per pixel


@wp.func
def fraction(x: float):
    """Returns the fractional part of a nonnegative number."""
    return x - wp.floor(x)


@wp.func
def gradient_noise(column: int, row: int):
    """Returns a number in 0…1 that differs between neighboring pixels."""
    return fraction(52.9829189 * fraction(0.06711056 * float(column) + 0.00583715 * float(row)))


@wp.func
def srgb(x: float):
    """Converts linear light 0…1 to an sRGB byte."""
    encoded = 1.055 * wp.pow(x, wp.static(1.0 / 2.4)) - 0.055
    if x <= 0.0031308:
        encoded = 12.92 * x
    return wp.uint8(wp.clamp(encoded * 255.0 + 0.5, 0.0, 255.0))


@wp.func
def perceptual(color: wp.vec3):
    """Returns approximate perceived brightness."""
    return wp.vec3(wp.sqrt(color[0]), wp.sqrt(color[1]), wp.sqrt(color[2]))


@functools.cache
def kernel() -> wp.Kernel:
    """Returns the kernel that renders one pixel per thread; the result does not depend on other pixels."""

    @unique_kernel()
    def paint(
        first: int,  # pixel, row by row
        view: View,
        world: World,
        marks: World,
        light: Light,
        grid: Grid,
        backdrop: Backdrop,
        picture: wp.array2d(dtype=wp.uint8),  # [pixel, channel] sRGB
    ):
        pixel = first + wp.tid()
        column = pixel % view.width
        row = pixel // view.width
        # Neighboring pixels get different offsets whose mean is smooth (Jimenez, interleaved gradient noise,
        # 2014).
        sun_x = gradient_noise(column, row)
        sun_y = gradient_noise(column + 31, row + 17)
        sky_x = gradient_noise(column + 59, row + 83)
        sky_y = gradient_noise(column + 101, row + 47)
        total = wp.vec3()
        lowest = wp.vec3(2.0, 2.0, 2.0)
        highest = wp.vec3()
        count = wp.int32(0)
        target_count = wp.min(view.samples, INITIAL_SAMPLES)
        while count < target_count:
            # The first sample is at the center of the pixel.
            step_x = float(count) * _STEP_X
            step_y = float(count) * _STEP_Y
            x = float(column) + fraction(0.5 + step_x)
            y = float(row) + fraction(0.5 + step_y)
            h = 1.0 - y / float(view.height)
            across = view.tangent * (2.0 * x - float(view.width)) / float(view.height)
            ray = wp.normalize(view.forward + across * view.right + view.tangent * (2.0 * h - 1.0) * view.up)
            at_sun = wp.vec2(fraction(sun_x + step_x), fraction(sun_y + step_y))
            at_sky = wp.vec2(fraction(sky_x + step_y), fraction(sky_y + step_x))
            color = trace_color(world, marks, light, grid, backdrop, view.eye, ray, h, at_sun, at_sky)
            total += color
            lowest = wp.min(lowest, perceptual(color))
            highest = wp.max(highest, perceptual(color))
            count += 1
            if count == INITIAL_SAMPLES and wp.max(highest - lowest) > CONTRAST_THRESHOLD:
                target_count = view.samples
        mean = total / float(count)
        for channel in range(3):
            picture[pixel, channel] = srgb(mean[channel])

    return paint
