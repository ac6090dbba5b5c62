"""Captures of steps: one at a time, and nothing else of Warp beside it, in the whole process.

While a thread captures on the CPU, Warp takes what other threads launch, copy or allocate for part of it, and they
may fail. Replays do not notice.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

# Held by who captures; who waits for the others lets go of it.
_condition = threading.Condition()
# Threads of the others.
_shared_holders: list[int] = []


@contextmanager
def exclusive_capture_lock() -> Iterator[None]:
    """Waits for all that use Warp, and keeps others from it."""
    with _condition:
        while _shared_holders:
            _condition.wait()
        yield


@contextmanager
def shared_capture_lock() -> Iterator[None]:
    """Waits for a capture of another thread; then none begins. Also to decorate a function."""
    own = threading.get_ident()
    with _condition:
        _shared_holders.append(own)
    try:
        yield
    finally:
        with _condition:
            _shared_holders.remove(own)
            _condition.notify_all()
