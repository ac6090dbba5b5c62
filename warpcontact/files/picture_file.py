"""Writes pictures: checks their paths, and saves figures reproducibly."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from warpcontact.files.atomic_files import check_writable, open_for_writing
from warpcontact.files.run_folder import RunPath

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Suffixes of picture files.
SUFFIXES = (".svg", ".png")


def check_path(path: Any, suffixes: Sequence[str] = SUFFIXES) -> Path:
    """Returns ``path`` if a picture can be written there; tests it by opening a file.

    Args:
        path: The file.
        suffixes: Allowed suffixes.

    Raises:
        ValueError: If the suffix is not allowed, the path is a folder, its folder does not exist, or it cannot be
            written.
    """
    file = Path(path)
    if file.suffix.lower() not in suffixes:
        raise ValueError(f"{path}: must end in {' or '.join(suffixes)}, got {file.suffix or 'no suffix'}")
    check_writable(file)
    return file


def save(figure: "Figure", path: Path | RunPath) -> None:
    """Writes a figure; equal figures give identical files."""
    import matplotlib as mpl

    with warnings.catch_warnings():
        # Names may have characters that are missing in all fonts and are drawn as boxes; the warning has no remedy.
        warnings.filterwarnings("ignore", r"Glyph .* missing from font", UserWarning)
        with open_for_writing(path) as file:
            _save(mpl, figure, file, path.name)


def _save(mpl: Any, figure: "Figure", file: BinaryIO, name: str) -> None:
    if name.lower().endswith(".svg"):
        with mpl.rc_context({"svg.hashsalt": "warpcontact"}):
            figure.savefig(file, format="svg", metadata={"Date": None})
    else:
        figure.savefig(file, format="png")
