"""Writes large files with direct I/O, without a copy in the page cache of the system.

Data that is written once and synced does not benefit from the page cache: copying takes time and evicts cached data of
other programs. On a virtual machine whose host has to allocate the memory, the copy takes several times as long as the
rest of writing.
"""

import errno
import mmap
import os
import threading
from collections.abc import Callable
from io import FileIO
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Alignment of direct I/O in memory, file offset and size [bytes]. Block sizes of disks are divisors.
BLOCK = mmap.PAGESIZE

# Errors of file systems without direct I/O.
_UNABLE = (errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP)

#: Size of the write buffer [bytes].
PIECE = 2**20

# The write buffer of each thread, which is reused.
_thread_local = threading.local()


class DirectFile:
    """A file that is written sequentially, with direct I/O if the system supports it. A context manager.

    The last bytes, less than a block, are written through the page cache, or all bytes if direct I/O is not supported.
    Each thread can write one such file at a time, because files share its buffer.

    Args:
        create: Creates the file with additional flags of ``os.open``, and returns its descriptor.

    Raises:
        OSError: If the file cannot be written by either method.
    """

    def __init__(self, create: Callable[[int], int]) -> None:
        self._piece = _piece()
        self._buffered = 0
        try:
            descriptor = create(getattr(os, "O_DIRECT", 0))
        except OSError as error:
            if error.errno not in _UNABLE:
                raise
            descriptor = create(0)
        self._file = FileIO(descriptor, "w")

    def __enter__(self) -> "DirectFile":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._file:
            if error is None:
                self._end()

    def write(self, content: Any) -> None:
        """Writes an object with a buffer, such as bytes; an incomplete piece stays in memory."""
        rest = np.frombuffer(content, dtype=np.uint8)
        while len(rest):
            count = min(len(rest), len(self._piece) - self._buffered)
            self._piece[self._buffered : self._buffered + count] = rest[:count]
            self._buffered += count
            rest = rest[count:]
            if self._buffered == len(self._piece):
                self._write_piece(self._piece)
                self._buffered = 0

    def _end(self) -> None:
        """Writes the buffered bytes."""
        whole = self._buffered // BLOCK * BLOCK
        self._write_piece(self._piece[:whole])
        if self._buffered > whole:
            self._write_buffered(self._piece[whole : self._buffered])

    def _write_piece(self, content: NDArray[np.uint8]) -> None:
        while len(content) >= BLOCK and len(content) % BLOCK == 0:
            try:
                content = content[self._file.write(content.data) :]
            except OSError as error:
                # Some file systems report missing support at the first write. Other errors occur again below.
                if error.errno not in _UNABLE:
                    raise
                break
        self._write_buffered(content)

    def _write_buffered(self, content: NDArray[np.uint8]) -> None:
        if len(content):
            _disable_direct_io(self._file.fileno())
        while len(content):
            content = content[self._file.write(content.data) :]


def _disable_direct_io(descriptor: int) -> None:
    """Disables direct I/O for further writes to a file."""
    if hasattr(os, "O_DIRECT"):
        import fcntl

        flags = fcntl.fcntl(descriptor, fcntl.F_GETFL)
        fcntl.fcntl(descriptor, fcntl.F_SETFL, flags & ~os.O_DIRECT)


def _piece() -> NDArray[np.uint8]:
    """Returns the write buffer of this thread, aligned to a block."""
    if not hasattr(_thread_local, "piece"):
        memory = np.empty(PIECE + BLOCK, dtype=np.uint8)
        _thread_local.piece = memory[-memory.ctypes.data % BLOCK :][:PIECE]
    piece: NDArray[np.uint8] = _thread_local.piece
    return piece
