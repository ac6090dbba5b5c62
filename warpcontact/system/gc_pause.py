"""Pauses Python's garbage collector while many long-lived objects are created."""

import contextlib
import gc
from collections.abc import Iterator


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
