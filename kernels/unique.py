"""How kernels are built: each in a module of its own, all with the same options of the compiler."""

from collections.abc import Callable
from typing import Any

import warp as wp

# What LLVM does not inline gets its structs copied, kilobytes at every call. Its options are those of the process:
# only what has the same is compiled side by side, and a thread precompiles one header for all of it.
OPTIONS = {
    "cpu_compiler_flags": "-march=native -mllvm=-inline-threshold=100000"
    " -mllvm=-inline-cold-callsite-threshold=30000"
    " -mllvm=-slp-recursion-max-depth=4"
}


def unique_kernel(
    registers: int | None = None, *, unrolled: int | None = None
) -> Callable[[Callable[..., Any]], wp.Kernel]:
    """Makes a kernel, without a backward pass, of a function; it is compiled when it is first needed.

    Args:
        registers: How many a thread of a GPU may have, at most; ``None``: as the compiler sees fit.
        unrolled: Loops of constant length are written out for the compiler if they have no more passes than this;
            ``None``: than Warp's 16.
    """
    options: dict[str, Any] = dict(OPTIONS)
    if unrolled is not None:
        options["max_unroll"] = unrolled
    if not wp.is_cuda_available():
        # Warp hashes a kernel for the block that its module says, and once more if launches have another: on a CPU
        # that is one thread.
        options["block_dim"] = 1
    return wp.kernel(module="unique", enable_backward=False, module_options=options, cuda_max_registers=registers)
