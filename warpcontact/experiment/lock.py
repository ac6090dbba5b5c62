"""One process at a time writes into a folder; the system lets go of it however a process ends."""

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


#: How often a lock is asked for.
LOCK_ATTEMPTS = 5


@contextlib.contextmanager
def write_lock(folder: Path) -> Iterator[None]:
    """Keeps other processes from writing into ``folder``, which is there, until the block is left.

    Of file systems without locks, and on Windows, it keeps nobody.

    Raises:
        ExperimentError: If another process writes there.
    """
    with _opened(folder) as opened:
        # Who only looks whether somebody writes holds it for a moment.
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
    return ExperimentError(str(folder), ["a process is running and writes there"])


@contextlib.contextmanager
def _opened(folder: Path) -> Iterator[int | None]:
    with RunPath(folder).opened() as (_, opened):  # its end lets go of the lock
        yield None if fcntl is None else opened


def _lock(opened: int | None, *, exclusive: bool) -> bool:
    """Returns whether nobody else holds it, as far as the file system can tell."""
    if opened is None:
        return True
    try:
        fcntl.flock(opened, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True
