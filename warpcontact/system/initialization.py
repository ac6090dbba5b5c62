"""Initializes Warp without a warning about a missing GPU, and explains errors of the kernel cache."""

import ctypes
import errno
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import warp as wp

# The native library prints this line on every machine without a driver, at any log level.
_NO_DRIVER = b"Warp CUDA warning: Could not find or load the NVIDIA CUDA driver."
_STDERR = 2
# Free space required to compile a module; the largest modules take a few MB with all their files [bytes].
ROOM = 2**24
# Beginning of an error message of the module tempfile.
_NO_TEMPORARY_FOLDER = "No usable temporary directory found in"

_lock = threading.Lock()
_done = threading.Event()


class KernelCacheError(OSError):
    """The folder of compiled kernels cannot be used."""


def initialize() -> None:
    """Initializes Warp, if it is not yet initialized.

    Raises:
        KernelCacheError: If the folder of compiled kernels cannot be created; the message names folder and remedy.
    """
    with _lock:
        if _done.is_set():
            return
        given = wp.config.kernel_cache_dir
        try:
            if missing_driver() is None:
                wp.init()
            else:
                with _stderr_without(_NO_DRIVER):
                    wp.init()
        except OSError as error:
            unusable = _unusable_cache(error)
            wp.config.kernel_cache_dir = given
            raise unusable from None
        _done.set()


def missing_driver() -> str | None:
    """Returns the reason why the NVIDIA driver cannot be loaded, or ``None`` if it can."""
    reason = None
    for name in ("nvcuda.dll",) if sys.platform == "win32" else ("libcuda.so", "libcuda.so.1"):
        try:
            ctypes.CDLL(name)
            return None
        except OSError as error:
            reason = str(error)
    return reason


def explained(error: OSError, *, compiling: bool = False) -> OSError:
    """Returns ``error``, or an error that names folder and remedy if the kernel cache or temporary files are unusable.

    Args:
        error: The error.
        compiling: Whether the error is from a compilation, even if it names no file.
    """
    folder, file = wp.config.kernel_cache_dir, error.filename
    reason = error.strerror or ""
    if reason.startswith(_NO_TEMPORARY_FOLDER):
        listed = reason.removeprefix(_NO_TEMPORARY_FOLDER).strip()
        return OSError(
            f"no temporary file can be created in any of {listed}; set the environment variable TMPDIR to a "
            "folder with free space that can be written"
        )
    in_cache = folder and isinstance(file, str) and Path(file).is_relative_to(folder)
    if isinstance(error, KernelCacheError) or not (in_cache or (compiling and file is None)):
        return error
    return _unusable_cache(error)


@contextmanager
def explaining() -> Iterator[None]:
    """Replaces an ``OSError`` in a block that compiles kernels by the result of ``explained``."""
    try:
        yield
    except OSError as error:
        if (other := explained(error, compiling=True)) is not error:
            raise other from None
        raise


def require_room(module: Callable[[], str]) -> None:
    """Raises an error unless a module can be compiled: on a full disk, the compiler would end the process.

    Args:
        module: Returns the name of its folder in the kernel cache. If that exists, nothing is compiled.

    Raises:
        OSError: If the disk is full.
    """
    folder = Path(wp.config.kernel_cache_dir)
    if folder.is_dir() and shutil.disk_usage(folder).free < ROOM and not (folder / module()).is_dir():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))


def _unusable_cache(error: OSError) -> KernelCacheError:
    folder = wp.config.kernel_cache_dir or error.filename
    return KernelCacheError(
        f"the kernel cache {folder} must be a folder with free space that can be written, got: "
        f"{error.strerror or error}; set the environment variable WARP_CACHE_PATH to such a folder"
    )


@contextmanager
def _stderr_without(line: bytes) -> Iterator[None]:
    """Removes lines that begin with ``line`` from the output of native code to standard error in the block.

    All other output is written when the block ends.
    """
    try:
        saved, file = os.dup(_STDERR), _memory_file()
    except OSError:  # closed, or no temporary file can be made
        yield
        return
    with file:
        os.dup2(file.fileno(), _STDERR)
        try:
            yield
        finally:
            if sys.stderr is not None:
                sys.stderr.flush()
            os.dup2(saved, _STDERR)
            os.close(saved)
            file.seek(0)
            for written in file:
                if not written.startswith(line):
                    os.write(_STDERR, written)


def _memory_file() -> BinaryIO:
    """Returns a temporary file, in memory if the system supports it."""
    if hasattr(os, "memfd_create"):
        return os.fdopen(os.memfd_create("stderr"), "w+b")
    return os.fdopen(os.dup(tempfile.TemporaryFile().fileno()), "w+b")
