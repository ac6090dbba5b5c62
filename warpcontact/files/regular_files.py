"""Opens files of unknown origin: pipes, devices and sockets are refused before they are opened; arrays must be numbers."""

import errno
import os
import stat
from io import BufferedReader
from typing import TYPE_CHECKING

from warpcontact.validation.number_format import format_bytes

if TYPE_CHECKING:
    import numpy as np

#: Largest size of text files, such as JSON, TOML and Python files [bytes].
TEXT = 512 * 2**20

# Without waiting for the other end of a pipe, and without making a terminal the controlling one of the process.
_READING = os.O_RDONLY
for _flag in ("O_NONBLOCK", "O_CLOEXEC", "O_NOCTTY", "O_BINARY"):
    _READING |= getattr(os, _flag, 0)

#: Reason for refusing a link below a run folder.
LINKED = "is a symbolic link, and none is followed below the folder of a run"

_KINDS = {
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class UnsafeFileError(OSError):
    """A file is not opened: a pipe or device, too large, or a symbolic link below a run folder."""

    def __str__(self) -> str:
        return f"{self.filename}: {self.strerror}"


def refused(path: object, reason: str) -> UnsafeFileError:
    """Returns the error for a file at ``path`` that is not opened."""
    return UnsafeFileError(errno.EPERM, reason, str(path))


def check_regular(found: os.stat_result, path: object, max_size: int | None = None) -> None:
    """Raises an error unless ``found`` is the status of a regular file.

    Args:
        found: Status of the file.
        path: Its name in messages.
        max_size: Largest allowed size [bytes]; ``None``: any.

    Raises:
        IsADirectoryError: If it is a folder.
        UnsafeFileError: If it is a pipe, device, socket or link, or larger than ``max_size``.
    """
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if stat.S_ISLNK(found.st_mode):
        raise refused(path, LINKED)
    if not stat.S_ISREG(found.st_mode):
        kind = _KINDS.get(stat.S_IFMT(found.st_mode), "a special file")
        raise refused(path, f"is not a regular file: it is {kind}")
    if max_size is not None and found.st_size > max_size:
        raise refused(path, f"must have at most {format_bytes(max_size)}, has {format_bytes(found.st_size)}")


def open_regular(
    path: str | os.PathLike[str],
    max_size: int | None = None,
    *,
    shown: object = None,
    follow: bool = True,
    folder: int | None = None,
    flags: int = 0,
) -> BufferedReader:
    """Opens a regular file in read mode; other files are refused.

    Args:
        path: The file.
        max_size: Largest allowed size [bytes]; ``None``: any.
        shown: Its name in messages; ``None``: ``path``.
        follow: Whether to follow a symbolic link; otherwise it is refused.
        folder: Descriptor of the folder to which ``path`` is relative.
        flags: Additional flags of ``os.open``.

    Raises:
        UnsafeFileError: If it is a pipe, device, socket or refused link, or larger than ``max_size``.
        OSError: If it cannot be opened.
    """
    shown = path if shown is None else shown
    # Check before opening: opening a device can have effects, and a socket cannot be opened.
    check_regular(os.stat(path, dir_fd=folder, follow_symlinks=follow), shown, max_size)
    flags |= _READING if follow else _READING | getattr(os, "O_NOFOLLOW", 0)
    descriptor = os.open(path, flags, dir_fd=folder)
    try:
        check_regular(os.fstat(descriptor), shown, max_size)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


# Descriptions by the kind of the data type.
_WORDS = {
    "b": "truth values",
    "c": "complex numbers",
    "m": "times",
    "M": "dates",
    "O": "objects of Python",
    "S": "bytes",
    "U": "text",
    "V": "records of several fields",
}


def check_numbers(what: str, array: "np.ndarray") -> None:
    """Raises ``ValueError`` about ``what`` unless an array has real numbers."""
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{what} must be numbers, got {_WORDS.get(array.dtype.kind, str(array.dtype))}")
