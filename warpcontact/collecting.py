"""Pauses of Python's garbage collector, for where most of what is made stays."""

import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def paused() -> Iterator[None]:
    """Lets nothing look for garbage meanwhile, which takes the longer the more there is that is none."""
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()
