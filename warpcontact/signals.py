"""What becomes of signals that ask to stop, while something runs that is to end in good order."""

import contextlib
import signal
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any


@dataclass
class Asked:
    """Whether somebody asked to stop."""

    to_stop: bool = False


@contextlib.contextmanager
def interruptions() -> Iterator[Asked]:
    """Notes Ctrl-C, and the signal that ends a process, once; a second time they act as usual."""
    asked = Asked()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    # What nobody hears is not to be heard here.
    usual = {
        number: handler
        for number in (signal.SIGINT, signal.SIGTERM)
        if (handler := signal.getsignal(number)) not in (None, signal.SIG_IGN)
    }

    def note(number: int, _: Any) -> None:
        asked.to_stop = True
        for one, handler in usual.items():
            signal.signal(one, handler)

    for number in usual:
        signal.signal(number, note)
    try:
        yield asked
    finally:
        for number, handler in usual.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def terminations() -> Iterator[None]:
    """Lets the signal that ends a process do what Ctrl-C does, unless somebody else takes it meanwhile."""
    usual = signal.getsignal(signal.SIGTERM)
    if threading.current_thread() is not threading.main_thread() or usual in (None, signal.SIG_IGN):
        yield
        return

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGTERM) is interrupt:
            signal.signal(signal.SIGTERM, usual)
