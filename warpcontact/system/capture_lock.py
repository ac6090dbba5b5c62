"""Lock between graph captures and other uses of Warp in this process.

While a thread captures a graph on the CPU, Warp records launches, copies and allocations of other threads as part of
it, and they may fail. Replaying a graph needs no lock.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

# Held during a capture; released while a capture waits for shared holders.
_condition = threading.Condition()
# Identifiers of the threads that use Warp without a capture.
_shared_holders: list[int] = []


@contextmanager
def exclusive_capture_lock() -> Iterator[None]:
    """Locks for a capture: waits until no other thread uses Warp, and blocks them until the end."""
    with _condition:
        while _shared_holders:
            _condition.wait()
        yield


def lock_captures_for_fork() -> None:
    """Waits for a capture of another thread to end, so that no process is forked during it."""
    _condition.acquire()


def unlock_captures_after_fork(*, in_child: bool) -> None:
    """Ends ``lock_captures_for_fork``. In the child process, other threads do not exist and hold no shared lock."""
    if in_child:
        own = threading.get_ident()
        _shared_holders[:] = [holder for holder in _shared_holders if holder == own]
    _condition.release()


@contextmanager
def shared_capture_lock() -> Iterator[None]:
    """Locks for other uses of Warp: waits for a capture to end, and delays further ones. Also a decorator."""
    own = threading.get_ident()
    with _condition:
        _shared_holders.append(own)
    try:
        yield
    finally:
        with _condition:
            _shared_holders.remove(own)
            _condition.notify_all()
