"""Compiles kernels: concurrently on a CPU, and on a GPU without FMA (fused multiply-add) contraction."""

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import warp as wp

from warpcontact.system.initialization import explaining, require_room

# Largest number of compiler threads: each also compiles a header, and few kernels take long.
MAX_COMPILERS = 4


def disable_fma(kernel: wp.Kernel, device: wp.Device) -> None:
    """Disables FMA contraction of ``kernel`` on a GPU. Must be called before it is loaded there.

    With contraction, the rounding of a sum of two products depends on neighboring code of the kernel. On a CPU, it
    depends on the expression alone, and contraction saves time.
    """
    fma_flag = not device.is_cuda
    if kernel.module.options["fuse_fp"] != fma_flag:
        # Through Warp's function, because setting the entry would not clear cached hashes of the module.
        wp.set_module_options({"fuse_fp": fma_flag}, kernel.module)


def load(kernel: wp.Kernel, device: wp.Device) -> None:
    """Compiles ``kernel`` if it is not in the cache, so that errors in user-defined code are raised here."""
    disable_fma(kernel, device)
    compile_as_launched(kernel, device)


def compile_as_launched(kernel: wp.Kernel, device: wp.Device) -> None:
    """Compiles ``kernel`` if it is not in the cache, for the block size of launches: one thread on a CPU."""
    block_dim = None if device.is_cuda else 1
    with explaining():
        require_room(lambda: kernel.module.get_module_identifier(block_dim))
        kernel.module.load(device, block_dim=block_dim)


def load_all(
    kernels: Iterable[wp.Kernel],
    device: wp.Device,
    threads: int,
    on_loaded: Callable[[wp.Kernel], None] | None = None,
) -> None:
    """Compiles kernels for a CPU concurrently, except those in the cache.

    Args:
        kernels: The kernels, those with long compilation first.
        device: The CPU. Kernels for a GPU cannot be compiled in advance, because the block size depends on the launch.
        threads: Maximum number of threads.
        on_loaded: Called by the thread that loaded a kernel, with the kernel.
    """
    remaining = deque(dict.fromkeys(kernels))
    others = min(len(remaining), MAX_COMPILERS, threads) - 1

    def load_one(kernel: wp.Kernel) -> None:
        load(kernel, device)
        if on_loaded is not None:
            on_loaded(kernel)

    def load_next() -> None:
        try:
            while remaining:
                try:
                    kernel = remaining.popleft()
                except IndexError:  # another thread took the last one
                    return
                load_one(kernel)
        except BaseException:
            # Clear the queue, so that other threads stop after their current kernel.
            remaining.clear()
            raise

    if others < 1:
        load_next()
        return
    first = remaining.popleft()
    with ThreadPoolExecutor(others) as pool:
        try:
            tasks = []
            with suppress(RuntimeError):  # no threads can be started while the process exits
                tasks = [pool.submit(load_next) for _ in range(others)]
            # A thread compiles a header before its kernels. The thread that built the model usually has it already.
            load_one(first)
            load_next()
        except BaseException:
            remaining.clear()
            raise
        for task in tasks:
            task.result()
