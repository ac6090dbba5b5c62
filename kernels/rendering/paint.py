"""Pixels of a picture: adaptive supersampling with rays from the eye, averaged and encoded as sRGB."""

import functools

import warp as wp
from warpcontact.kernels.lowlevel.unique_kernel import unique_kernel
from warpcontact.kernels.rendering.shade import Backdrop, Grid, Light, trace_color
from warpcontact.kernels.rendering.world import World

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
