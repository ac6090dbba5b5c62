"""Pauses of Python's garbage collector, for where most of what is made stays."""

import contextlib
import gc
from collections.abc import Iterator


@contextlib.contextmanager
def gc_paused() -> Iterator[None]:
    """Lets nothing look for garbage meanwhile, which takes the longer the more there is that is none.

    What is there afterwards counts as old: it is not looked through before all is.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            # Freezing takes what is young out of what is looked through, and thawing makes it old; but it would
            # thaw what others froze.
            if gc.get_freeze_count() == 0:
                gc.freeze()
                gc.unfreeze()
            gc.enable()
