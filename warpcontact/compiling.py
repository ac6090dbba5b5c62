"""How kernels of a step are built for a device: with the same rounding whatever launches take the step."""

import warp as wp


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
