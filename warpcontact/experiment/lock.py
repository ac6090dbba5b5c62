"""Locks a run folder, so that only one process writes into it. The system releases the lock when a process ends.

The folder itself is locked, by its descriptor: a lock file, as of the package filelock, could be a planted link, would
remain in the folder, and could not be created to query a folder that cannot be written.
"""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

from warpcontact.experiment.errors import ExperimentError
from warpcontact.files.run_folder import RunPath

try:
    import fcntl
except ImportError:  # Windows has no locks on folders
    fcntl = None  # type: ignore[assignment]


#: Number of attempts to acquire the lock.
LOCK_ATTEMPTS = 5


@contextlib.contextmanager
def write_lock(folder: Path) -> Iterator[None]:
    """Locks an existing ``folder`` against writing by other processes, until the block is left.

    There is no lock on Windows and on file systems without locks.

    Raises:
        ExperimentError: If another process holds the lock.
    """
    with _opened(folder) as opened:
        # Retry, because ``is_locked`` holds a shared lock for a short time.
        for _ in range(LOCK_ATTEMPTS):
            if _lock(opened, exclusive=True):
                break
            time.sleep(0.05)
        else:
            raise locked_error(folder)
        yield


def is_locked(folder: Path) -> bool:
    """Whether a process is writing into ``folder``."""
    if not folder.is_dir():
        return False
    with _opened(folder) as opened:
        return not _lock(opened, exclusive=False)


def locked_error(folder: Path) -> ExperimentError:
    """Returns the error that a process is writing into ``folder``."""
    return ExperimentError(str(folder), ["another process is running and writes there"])


@contextlib.contextmanager
def _opened(folder: Path) -> Iterator[int | None]:
    with RunPath(folder).opened() as (_, opened):  # closing the folder releases the lock
        yield None if fcntl is None else opened


def _lock(opened: int | None, *, exclusive: bool) -> bool:
    """Acquires the lock without waiting; returns False if another process holds it."""
    if opened is None:
        return True
    try:
        fcntl.flock(opened, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True
