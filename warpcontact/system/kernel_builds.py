"""Builds of kernels on a CPU: which one to launch, and the files of a build in Warp's kernel cache.

Warp compiles a kernel in the process that launches it. So that another process can compile a build, this module uses
functions of Warp that are not part of its interface. If Warp does not have them, kernels are compiled before launches.
"""

import os
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from weakref import WeakSet

import warp as wp

try:
    from warp._src.codegen import _codegen_lock as codegen_lock
    from warp._src.context import ModuleHasher
except ImportError:
    ModuleHasher = codegen_lock = None

from warpcontact.kernels.lowlevel import unique_kernel
from warpcontact.system.initialization import require_room

# Threads per block of launches on a CPU.
_BLOCK_DIM = 1
# Largest interval after which code generation releases the interpreter to other threads [s].
_SWITCH_INTERVAL = 1e-3
# Optimization level of Warp for a CPU if the options of a module have none.
_DEFAULT_LEVEL = 2
_NEEDED = ("_get_compile_output_name", "_get_meta_name", "_run_codegen", "_write_meta")
_HAS_NEEDED = ModuleHasher is not None and all(hasattr(wp.Module, name) for name in _NEEDED)
# Kernels whose release build was found in the kernel cache.
_found: WeakSet[wp.Kernel] = WeakSet()
# Number of active blocks of ``release_builds_only``.
_release_only: list[None] = []


@dataclass(frozen=True)
class CompileJob:
    """A build to be compiled by another process.

    Attributes:
        name: Name of the kernel.
        folder: Folder in the kernel cache for the build. It does not exist, or has builds for other machines.
        build_folder: Folder with the source. It becomes ``folder``.
        source: File name of the source.
        binary: File name of the compiled code.
        options: Options of Warp's function ``build_cpu``.
    """

    name: str
    folder: str
    build_folder: str
    source: str
    binary: str
    options: dict[str, Any]

    def discard(self) -> None:
        """Removes the build folder."""
        shutil.rmtree(self.build_folder, ignore_errors=True)


def starts_quick(device: wp.Device) -> bool:
    """Returns whether quick builds are launched on ``device`` until the release builds are compiled."""
    possible = unique_kernel.BACKGROUND and device.is_cpu and _HAS_NEEDED and wp.config.cache_kernels
    return possible and not _release_only


@contextmanager
def release_builds_only() -> Iterator[None]:
    """Makes launches that are prepared in the block compile the release builds of their kernels."""
    _release_only.append(None)
    try:
        yield
    finally:
        _release_only.pop()


def current_build(kernel: wp.Kernel, device: wp.Device) -> wp.Kernel:
    """Returns the build of ``kernel`` to launch on ``device``: on a CPU the quick one while the other is missing."""
    if device.is_cuda:
        return unique_kernel.gpu_build(kernel)
    if not starts_quick(device) or is_compiled(kernel):
        return kernel
    return unique_kernel.quick_build(kernel)


def is_compiled(kernel: wp.Kernel) -> bool:
    """Returns whether the release build of ``kernel`` for the CPU is in the kernel cache."""
    if kernel not in _found and has_files(kernel):
        _found.add(kernel)
    return kernel in _found


def has_files(kernel: wp.Kernel) -> bool:
    """Returns whether the files of ``kernel`` for the CPU are in the kernel cache."""
    return all(path.is_file() for path in _files(kernel))


def require_unchanged(kernel: wp.Kernel) -> None:
    """Raises an error if a build of ``kernel`` for the CPU must be generated and would differ from its identifier.

    The identifier is computed once, from the source of the kernel and from the constants and functions that it uses.
    If these are bound to other values later, the source that Warp then generates must not get this identifier.

    Raises:
        RuntimeError: If a constant or function was changed.
    """
    module = kernel.module
    if not _HAS_NEEDED or _BLOCK_DIM not in module.hashers or has_files(kernel):
        return
    with codegen_lock:
        present = {one: one.hash for one in module._get_live_kernels()}
        fresh = ModuleHasher(list(present), module.resolved_options[_BLOCK_DIM])
        if fresh.get_hash() == module.get_module_hash(_BLOCK_DIM):
            return
        for one, old in present.items():
            one.hash = old
    raise RuntimeError(
        f"a constant or function that kernel {kernel.adj.fun_name} uses was changed since it was first prepared; "
        "build the model again to use the present one"
    )


@contextmanager
def _short_switch_interval() -> Iterator[None]:
    """Makes this thread release the interpreter sooner to other threads; the lock of code generation is held.

    A capture calls thousands of C functions, which release the interpreter. With Python's interval of 5 ms, it would take
    as long as the generation.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, _SWITCH_INTERVAL))
    try:
        yield
    finally:
        sys.setswitchinterval(before)


def compile_job(kernel: wp.Kernel) -> CompileJob:
    """Generates the source of the release build of ``kernel`` for the CPU, and writes it into a build folder.

    Raises:
        OSError: If the kernel cache cannot be written.
        RuntimeError: If a constant or function that the kernel uses was changed since its identifier was computed.
    """
    module = kernel.module
    binary, meta = _files(kernel)
    require_room(lambda: binary.parent.name)
    options = module.resolved_options[_BLOCK_DIM] | {"output_arch": None}
    with codegen_lock, _short_switch_interval():
        source, extension, meta_data, *_ = module._run_codegen(options, True)
        require_unchanged(kernel)
    build_folder = Path(f"{binary.parent}_p{os.getpid()}_t{threading.get_ident()}")
    build_folder.mkdir(parents=True, exist_ok=True)
    source_file = f"{binary.parent.name}.{extension}"
    (build_folder / source_file).write_text(source, encoding="utf-8")
    module._write_meta(build_folder / meta.name, meta_data)
    level = options["optimization_level"]
    build_options = {
        "mode": options["mode"],
        "verify_fp": options["verify_fp"],
        "fast_math": options["fast_math"],
        "fuse_fp": options["fuse_fp"],
        "extra_flags": options["cpu_compiler_flags"],
        "optimization_level": _DEFAULT_LEVEL if level is None else level,
        "use_precompiled_headers": options["use_precompiled_headers"],
        "block_dim": _BLOCK_DIM,
        "enable_tiles_in_stack_memory": options["enable_tiles_in_stack_memory"],
        "extra_include_dirs": list(options["extra_cpu_include_dirs"]),
    }
    name = kernel.key.split("__")[-1]
    return CompileJob(name, str(binary.parent), str(build_folder), source_file, binary.name, build_options)


def _files(kernel: wp.Kernel) -> tuple[Path, Path]:
    """Returns the files of a build in the kernel cache: compiled code and metadata."""
    module = kernel.module
    folder = Path(wp.config.kernel_cache_dir, module.get_module_identifier(_BLOCK_DIM))
    binary = module._get_compile_output_name(wp.get_device("cpu"), block_dim=_BLOCK_DIM)
    return folder / binary, folder / module._get_meta_name(block_dim=_BLOCK_DIM)
