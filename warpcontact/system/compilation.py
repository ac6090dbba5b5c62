"""How kernels are built for a device: side by side, and with the same rounding whatever launches them."""

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import warp as wp

from warpcontact.system.initialization import explaining, require_room

# Threads that compile, at most: each compiles a header as well, and few kernels take long.
MAX_COMPILERS = 4


def disable_fma(kernel: wp.Kernel, device: wp.Device) -> None:
    """Has ``kernel`` round every product on a GPU; to be called before it is loaded there.

    Else the compiler chooses which of two products that are added is rounded, by what else the kernel computes of
    the same numbers. On a CPU it goes by each expression, and fused products save time.
    """
    fma_flag = not device.is_cuda
    if kernel.module.options["fuse_fp"] != fma_flag:
        # Not the entry alone: what is known already of its builds says the opposite.
        wp.set_module_options({"fuse_fp": fma_flag}, kernel.module)


def load(kernel: wp.Kernel, device: wp.Device) -> None:
    """Compiles ``kernel``, if it has to be, so that mistakes in what users wrote of it show at once."""
    disable_fma(kernel, device)
    compile_as_launched(kernel, device)


def compile_as_launched(kernel: wp.Kernel, device: wp.Device) -> None:
    """Compiles ``kernel``, if it has to be, for the blocks that launches have: of one thread on a CPU."""
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
    """Compiles kernels for a CPU side by side, those that have to be.

    Args:
        kernels: The kernels, those that take long first.
        device: The CPU. A GPU compiles for blocks of a size that launches say.
        threads: Threads at most.
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
                except IndexError:  # others were faster
                    return
                load_one(kernel)
        except BaseException:
            # Who waits for it, or interrupts it, waits for what is being compiled, and for nothing else.
            remaining.clear()
            raise

    if others < 1:
        load_next()
        return
    first = remaining.popleft()
    with ThreadPoolExecutor(others) as pool:
        try:
            tasks = []
            with suppress(RuntimeError):  # of a process that ends, which has no more threads
                tasks = [pool.submit(load_next) for _ in range(others)]
            # A thread compiles a header before its kernels. The one that built the model mostly has it.
            load_one(first)
            load_next()
        except BaseException:
            remaining.clear()
            raise
        for task in tasks:
            task.result()
