"""Captures of steps: one at a time, and nothing else of Warp beside it, in the whole process.

While a thread captures on the CPU, Warp takes what other threads launch, copy or allocate for part of it, and they
may fail. Replays do not notice.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

# Held by who captures; who waits for the others lets go of it.
_free = threading.Condition()
# Threads of the others.
_others: list[int] = []


@contextmanager
def capturing() -> Iterator[None]:
    """Waits for all that use Warp, and keeps others from it."""
    with _free:
        while _others:
            _free.wait()
        yield


@contextmanager
def beside_captures() -> Iterator[None]:
    """Waits for a capture of another thread; then none begins. Also to decorate a function."""
    own = threading.get_ident()
    with _free:
        _others.append(own)
    try:
        yield
    finally:
        with _free:
            _others.remove(own)
            _free.notify_all()
