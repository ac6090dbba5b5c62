"""How kernels are built for a device: side by side, and with the same rounding whatever launches them."""

from collections import deque
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor

import warp as wp

from warpcontact.available import available_threads

# Threads that compile, at most.
COMPILERS = 4


def round_each_product(kernel: wp.Kernel, device: wp.Device) -> None:
    """Has ``kernel`` round every product on a GPU; to be called before it is loaded there.

    Else the compiler chooses which of two products that are added is rounded, by what else the kernel computes of
    the same numbers. On a CPU it goes by each expression, and fused products save time.
    """
    fused = not device.is_cuda
    if kernel.module.options["fuse_fp"] != fused:
        # Not the entry alone: what is known already of its builds says the opposite.
        wp.set_module_options({"fuse_fp": fused}, kernel.module)


def load(kernel: wp.Kernel, device: wp.Device) -> None:
    """Compiles ``kernel``, if it has to be, so that mistakes in what users wrote of it show at once."""
    round_each_product(kernel, device)
    kernel.module.load(device, block_dim=None if device.is_cuda else 1)


def load_all(kernels: Iterable[wp.Kernel], device: wp.Device) -> None:
    """Compiles kernels for a CPU side by side, those that have to be; first come those that take long.

    On a GPU that is left to their launches, which say what blocks they are for.
    """
    if device.is_cuda:
        return
    distinct = list(dict.fromkeys(kernels))
    workers = min(len(distinct), COMPILERS, available_threads())
    left = iter(distinct[workers:])

    def work(kernel: wp.Kernel | None) -> None:
        while kernel is not None:
            load(kernel, device)
            kernel = next(left, None)

    # This thread has a header already that each other one compiles before its kernels, and takes the first.
    with ThreadPoolExecutor(COMPILERS) as pool:
        others = [pool.submit(work, kernel) for kernel in distinct[1:workers]]
        try:
            work(next(iter(distinct), None))
        finally:
            # Who interrupts it waits for what is being compiled, and for nothing else.
            deque(left, maxlen=0)
        for other in others:
            other.result()
