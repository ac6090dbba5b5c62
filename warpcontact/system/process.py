"""The process of Python: pauses of the garbage collector, and handling of SIGINT and SIGTERM."""

import contextlib
import gc
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any


@contextlib.contextmanager
def gc_paused() -> Iterator[None]:
    """Disables garbage collection in a block: its cost grows with the number of objects that are alive.

    Objects created in the block are moved to the oldest generation, which is collected rarely.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            # Freezing and unfreezing moves all young objects to the oldest generation. Skipped if objects are frozen
            # already, because they would be unfrozen as well.
            if gc.get_freeze_count() == 0:
                gc.freeze()
                gc.unfreeze()
            gc.enable()


@dataclass
class StopRequest:
    """Whether a signal has requested a stop."""

    stop_requested: bool = False


@contextlib.contextmanager
def catch_interrupts() -> Iterator[StopRequest]:
    """Records the first SIGINT or SIGTERM in the yielded request; a second one has its usual effect."""
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return
    # Signals that are ignored stay ignored.
    previous_handlers = {
        number: handler
        for number in (signal.SIGINT, signal.SIGTERM)
        if (handler := signal.getsignal(number)) not in (None, signal.SIG_IGN)
    }

    def note(number: int, _: Any) -> None:
        request.stop_requested = True
        for one, handler in previous_handlers.items():
            signal.signal(one, handler)

    for number in previous_handlers:
        signal.signal(number, note)
    try:
        yield request
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """Makes SIGTERM raise ``KeyboardInterrupt`` as Ctrl-C does, unless another handler is set in the block."""
    previous_handlers = signal.getsignal(signal.SIGTERM)
    if threading.current_thread() is not threading.main_thread() or previous_handlers in (None, signal.SIG_IGN):
        yield
        return

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGTERM) is interrupt:
            signal.signal(signal.SIGTERM, previous_handlers)
