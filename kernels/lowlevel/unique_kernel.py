"""Module options of kernels: one module per kernel, and the same compiler options for all of them.

The environment variable ``WARPCONTACT_COMPILE`` chooses the options for a CPU when the package is imported:
``release`` (default) for fast steps, or ``quick`` for short compile times. Both give bitwise identical results.
``quick`` also selects staged kernels, see ``warpcontact.forces.launch_shape``.
"""

import os
from collections.abc import Callable
from typing import Any

import warp as wp
from warpcontact.kernels.lowlevel.switches import is_enabled

MODES = ("release", "quick")
MODE = os.environ.get("WARPCONTACT_COMPILE", "") or MODES[0]
if MODE not in MODES:
    raise ImportError(f"WARPCONTACT_COMPILE must be one of {', '.join(MODES)}, got {MODE!r}")
#: Whether kernels are compiled for short compile times.
QUICK = MODE == "quick"

# LLVM copies the structs of a call that it does not inline, kilobytes each time. LLVM options are global to the
# process: modules with equal options compile concurrently, and each thread precompiles one header for all of them.
RELEASE_OPTIONS: dict[str, Any] = {
    "cpu_compiler_flags": "-march=native -mllvm=-inline-threshold=100000"
    " -mllvm=-inline-cold-callsite-threshold=30000"
    " -mllvm=-slp-recursion-max-depth=4"
}
QUICK_OPTIONS: dict[str, Any] = {"cpu_compiler_flags": "-march=native"}
OPTIONS = QUICK_OPTIONS if QUICK else RELEASE_OPTIONS


def unique_kernel(
    registers: int | None = None, *, unrolled: int | None = None
) -> Callable[[Callable[..., Any]], wp.Kernel]:
    """Returns a decorator that makes a kernel of a function, compiled at first use, without a backward pass.

    Args:
        registers: Maximum number of registers per GPU thread. ``None``: chosen by the compiler.
        unrolled: Largest number of passes of a constant loop that is unrolled. ``None``: 16, the default of Warp.
    """
    options: dict[str, Any] = dict(OPTIONS)
    if unrolled is not None:
        options["max_unroll"] = unrolled
    if not wp.is_cuda_available():
        # Warp hashes a kernel for the block size of its module, and again if a launch has another. On a CPU it is
        # 1.
        options["block_dim"] = 1
    if not is_enabled("registers"):
        registers = None
    return wp.kernel(module="unique", enable_backward=False, module_options=options, cuda_max_registers=registers)
