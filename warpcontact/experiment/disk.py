"""Free disk space for results."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from warpcontact.validation.number_format import format_bytes


@dataclass(frozen=True)
class Disk:
    """The disk of an existing or future folder.

    Attributes:
        folder: The folder.
        free: Free space for this user [bytes].
    """

    folder: Path
    free: int

    def __str__(self) -> str:
        return f"{format_bytes(self.free)} is free on the disk of {self.folder}"


def find_disk(folder: Path) -> Disk | None:
    """Returns the disk of ``folder``, or of its nearest existing parent; ``None``: not reported by the system."""
    existing = folder.absolute()
    existing = next((one for one in (existing, *existing.parents) if one.exists()), existing)
    try:
        return Disk(folder, shutil.disk_usage(existing).free)
    except OSError:
        return None
