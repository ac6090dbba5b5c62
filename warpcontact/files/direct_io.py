"""Large files, from memory to the disk without a copy in the memory of the system.

What is written once, and waited for, gains nothing from that copy: it takes its time, and drives out what others
read. On a virtual machine, whose host has to find new memory for it, the copy takes several times as long as all
the rest of writing.
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

#: What goes to the disk directly is in blocks of so many bytes: in memory, in the file, and in number. Those of
#: disks are as large or smaller.
BLOCK = mmap.PAGESIZE

# What file systems say that know no such way.
_UNABLE = (errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP)

#: Bytes that are handed on at once.
PIECE = 2**20

# Of a thread, once it wrote: always the same memory.
_thread_local = threading.local()


class DirectFile:
    """A file that is written from its begin, directly as far as its system lets it. A context.

    Its last bytes, less than a block, go the way of other files, as do all where a system or disk knows no other.
    One thread writes one such file at a time.

    Args:
        create: Creates the file with further flags of ``os.open``, and returns its descriptor.

    Raises:
        OSError: If it cannot be written, by any of the methods.
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
        """Writes what has a buffer, such as bytes; some of it waits until there is more."""
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
        """Writes what waits."""
        whole = self._buffered // BLOCK * BLOCK
        self._write_piece(self._piece[:whole])
        if self._buffered > whole:
            self._write_buffered(self._piece[whole : self._buffered])

    def _write_piece(self, content: NDArray[np.uint8]) -> None:
        while len(content) >= BLOCK and len(content) % BLOCK == 0:
            try:
                content = content[self._file.write(content.data) :]
            except OSError as error:
                # Some say it at the first write only; who cannot be written to at all says it again.
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
    """Lets what is written to a file from now on go the way of other files."""
    if hasattr(os, "O_DIRECT"):
        import fcntl

        flags = fcntl.fcntl(descriptor, fcntl.F_GETFL)
        fcntl.fcntl(descriptor, fcntl.F_SETFL, flags & ~os.O_DIRECT)


def _piece() -> NDArray[np.uint8]:
    """Returns memory of this thread that begins with a block."""
    if not hasattr(_thread_local, "piece"):
        memory = np.empty(PIECE + BLOCK, dtype=np.uint8)
        _thread_local.piece = memory[-memory.ctypes.data % BLOCK :][:PIECE]
    piece: NDArray[np.uint8] = _thread_local.piece
    return piece
