"""Facts for the optimizer: an index is not negative, a value is not known at compile time."""

import warp as wp
from warpcontact.kernels.lowlevel.switches import is_enabled


@wp.func_native("if (number < 0) __builtin_unreachable(); return number;")
def assume_nonnegative(number: int) -> int:
    """Returns ``number``. The compiler may assume that it is not negative, which saves instructions per index."""
    ...


@wp.func_native(
    """
    #if !defined(__CUDA_ARCH__)
    asm volatile("" : "+r"(number));
    #endif
    if (number < 0) __builtin_unreachable();
    return number;
    """
)
def hide_from_optimizer(number: int) -> int:
    """Returns ``number``, which is not negative, and hides its value from the optimizer, for loops of few passes.

    Otherwise the compiler computes the addresses of all arrays in the loop before the loop, even those that it
    does not use.
    """
    ...


if not is_enabled("assumptions"):

    @wp.func_native("return number;")
    def assume_nothing(number: int) -> int:
        """Returns ``number``."""
        ...

    assume_nonnegative = hide_from_optimizer = assume_nothing
