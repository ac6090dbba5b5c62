"""How much room there is for results."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from warpcontact.validation.number_format import format_bytes


@dataclass(frozen=True)
class Disk:
    """The disk on which a folder is, or is going to be.

    Attributes:
        folder: The folder.
        free: What this user may still write there [bytes].
    """

    folder: Path
    free: int

    def __str__(self) -> str:
        return f"{format_bytes(self.free)} is free on the disk of {self.folder}"


def find_disk(folder: Path) -> Disk | None:
    """Returns the disk of ``folder``, or of the nearest one above it that there is; ``None`` if nobody knows."""
    existing = folder.absolute()
    existing = next((one for one in (existing, *existing.parents) if one.exists()), existing)
    try:
        return Disk(folder, shutil.disk_usage(existing).free)
    except OSError:
        return None
