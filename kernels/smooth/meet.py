"""Where two shapes meet: the device function for a pair, chosen when a model is built."""

import functools

import warp as wp
from warpcontact.kernels.smooth import convex
from warpcontact.kernels.smooth.base import Shape


@functools.cache
def meet(A: type[Shape], B: type[Shape]) -> wp.Function:
    """Returns the device function ``(p_a, p_b, x, q, seed)`` → ``Meeting`` of a pair of shapes."""
    return convex.meet(A, B)
