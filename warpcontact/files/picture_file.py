"""Where pictures go: names of files that can be written, and files that depend on nothing but the picture."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from warpcontact.files.atomic_files import check_writable, open_for_writing
from warpcontact.files.run_folder import RunPath

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Kinds of files that a picture can be written to.
SUFFIXES = (".svg", ".png")


def check_path(path: Any, suffixes: Sequence[str] = SUFFIXES) -> Path:
    """Returns ``path`` if a picture can be written there, which is tried.

    Args:
        path: The file.
        suffixes: What its name may end in.

    Raises:
        ValueError: If the suffix is not allowed, it is a folder or in none that exists, or cannot be written.
    """
    file = Path(path)
    if file.suffix.lower() not in suffixes:
        raise ValueError(f"{path}: must end in {' or '.join(suffixes)}, got {file.suffix or 'no suffix'}")
    check_writable(file)
    return file


def save(figure: "Figure", path: Path | RunPath) -> None:
    """Writes a figure; the same one gives the same file."""
    import matplotlib as mpl

    with warnings.catch_warnings():
        # Names may have signs that no font here has; they are boxes then, and nobody can do anything about it.
        warnings.filterwarnings("ignore", r"Glyph .* missing from font", UserWarning)
        with open_for_writing(path) as file:
            _save(mpl, figure, file, path.name)


def _save(mpl: Any, figure: "Figure", file: BinaryIO, name: str) -> None:
    if name.lower().endswith(".svg"):
        with mpl.rc_context({"svg.hashsalt": "warpcontact"}):
            figure.savefig(file, format="svg", metadata={"Date": None})
    else:
        figure.savefig(file, format="png")
