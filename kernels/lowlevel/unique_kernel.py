"""Builds of kernels: one module per kernel, and the same compiler options for all kernels of a build.

A CPU has two builds. The *release* build runs several times faster, the *quick* build compiles several times faster.
Both give bitwise identical results. The environment variable ``WARPCONTACT_COMPILE`` chooses when the package is
imported:

- ``background`` (default): steps start with quick builds, and release builds are compiled in the background.
- ``release``: each kernel is compiled before it is launched.
- ``quick``: quick builds only, and staged kernels, see ``warpcontact.forces.launch_shape``.
"""

import os
from collections.abc import Callable
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import warp as wp
from warpcontact.kernels.lowlevel.switches import is_enabled

MODES = ("background", "release", "quick")
MODE = os.environ.get("WARPCONTACT_COMPILE", "") or MODES[0]
if MODE not in MODES:
    raise ImportError(f"WARPCONTACT_COMPILE must be one of {', '.join(MODES)}, got {MODE!r}")
#: Whether quick builds are launched until the release builds are compiled in the background.
BACKGROUND = MODE == "background"
#: Whether there are quick builds only.
QUICK = MODE == "quick"

# The header takes a third less time without 16-bit brain floats, which no kernel uses. The optimizer must not replace
# powers with a constant exponent: whether it finds the constant depends on inlining, and a product rounds differently.
_COMMON_FLAGS = "-march=native -DWP_NO_BFLOAT16= -fno-builtin-pow -fno-builtin-powf"
# LLVM copies the structs of a call that it does not inline, kilobytes each time. LLVM options are global to the
# process: modules with equal options compile concurrently, and each thread precompiles one header for all of them.
RELEASE_OPTIONS: dict[str, Any] = {
    "cpu_compiler_flags": f"{_COMMON_FLAGS} -mllvm=-inline-threshold=100000"
    " -mllvm=-inline-cold-callsite-threshold=30000"
    " -mllvm=-slp-recursion-max-depth=4"
}
# At optimization level 0, kernels compile in half the time of level 1, but steps take ten times longer.
QUICK_OPTIONS: dict[str, Any] = {
    "cpu_compiler_flags": f"{_COMMON_FLAGS} -mllvm=-inline-threshold=25",
    "optimization_level": 1,
}
OPTIONS = QUICK_OPTIONS if QUICK else RELEASE_OPTIONS


class _Source(NamedTuple):
    """Function and options from which a kernel is made."""

    function: Callable[..., Any]
    options: dict[str, Any]  # of the module, without those of a build
    registers: int | None  # maximum number of registers per GPU thread
    only_quick: bool  # whether the kernel itself is a quick build


# Sources of the kernels, and the further builds that were made of them. A module has the options of one build, and they
# do not change: Warp identifies a compiled module by them.
_SOURCES: WeakKeyDictionary[wp.Kernel, _Source] = WeakKeyDictionary()
_QUICK_BUILDS: WeakKeyDictionary[wp.Kernel, wp.Kernel] = WeakKeyDictionary()
_GPU_BUILDS: WeakKeyDictionary[wp.Kernel, wp.Kernel] = WeakKeyDictionary()


def unique_kernel(
    registers: int | None = None, *, unrolled: int | None = None, runs_rarely: bool = False
) -> Callable[[Callable[..., Any]], wp.Kernel]:
    """Returns a decorator that makes a kernel of a function, compiled at first use, without a backward pass.

    Args:
        registers: Maximum number of registers per GPU thread. ``None``: chosen by the compiler.
        unrolled: Largest number of passes of a constant loop that is unrolled. ``None``: 16, the default of Warp.
        runs_rarely: Whether compiling a release build takes longer than it saves, as for resets. The kernel then
            has a quick build only, unless ``WARPCONTACT_COMPILE`` is ``release``.
    """
    options: dict[str, Any] = {} if unrolled is None else {"max_unroll": unrolled}
    if not wp.is_cuda_available():
        # Warp hashes a kernel for the block size of its module, and again if a launch has another. On a CPU it is
        # 1.
        options["block_dim"] = 1
    if not is_enabled("registers"):
        registers = None
    only_quick = QUICK or (BACKGROUND and runs_rarely)

    def make(function: Callable[..., Any]) -> wp.Kernel:
        build = QUICK_OPTIONS if only_quick else RELEASE_OPTIONS
        kernel = wp.kernel(
            function,
            module="unique",
            enable_backward=False,
            module_options=build | options,
            cuda_max_registers=registers,
        )
        _SOURCES[kernel] = _Source(function, options, registers, only_quick)
        return kernel

    return make


def quick_build(kernel: wp.Kernel) -> wp.Kernel:
    """Returns the quick build of a kernel for a CPU; ``kernel`` itself if it has no other build."""
    source = _SOURCES.get(kernel)
    if source is None or source.only_quick:
        return kernel
    if kernel not in _QUICK_BUILDS:
        _QUICK_BUILDS[kernel] = wp.kernel(
            source.function, module="unique", enable_backward=False, module_options=QUICK_OPTIONS | source.options
        )
    return _QUICK_BUILDS[kernel]


def gpu_build(kernel: wp.Kernel) -> wp.Kernel:
    """Returns the build of a kernel for steps on a GPU, without contraction to FMA (fused multiply-add).

    With contraction, the rounding of a sum of two products depends on neighboring code of the kernel. On a CPU, it
    depends on the expression alone, and contraction saves time.
    """
    source = _SOURCES.get(kernel)
    if source is None:
        # Through Warp's function, because setting the entry would not clear cached hashes of the module.
        if kernel.module.options["fuse_fp"]:
            wp.set_module_options({"fuse_fp": False}, kernel.module)
        return kernel
    if kernel not in _GPU_BUILDS:
        _GPU_BUILDS[kernel] = wp.kernel(
            source.function,
            module="unique",
            enable_backward=False,
            module_options=OPTIONS | source.options | {"fuse_fp": False},
            cuda_max_registers=source.registers,
        )
    return _GPU_BUILDS[kernel]
