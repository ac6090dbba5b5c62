"""Files of the user that are replaced as a whole, and checks of where they go."""

import contextlib
import errno
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from warpcontact.files.run_folder import RunPath, below_run, place_of


def check_writable(path: Path | RunPath) -> None:
    """Raises an error unless a file can be written at ``path``, which is tried.

    Raises:
        ValueError: If it is a folder or in none that exists, or cannot be written; names it.
    """
    inside = below_run(path)
    place = path.path if isinstance(path, RunPath) else path
    try:
        if place.is_dir() if inside is None else inside.is_real_folder():
            raise ValueError(f"{path}: is a folder; give the name of a file")
        if not place.parent.is_dir():
            wrong = "is not a folder" if place.parent.exists() else "does not exist"
            raise ValueError(f"{path}: {place.parent} {wrong}")
        if inside is None:
            _try(Path(os.path.realpath(place)))  # a link stays, also a dangling one
        else:
            inside.try_to_replace()
    except OSError as error:
        raise ValueError(f"{path}: cannot be written: {error.strerror or error}") from None


def _try(place: Path) -> None:
    """Opens a file for writing, and changes nothing."""
    there = place.exists()
    if there and not place.is_file():  # to open a pipe would wait for its reader
        if not os.access(place, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(place))
        return
    place.open("ab").close()
    if not there:
        place.unlink()


def atomic_file(path: Path | RunPath) -> contextlib.AbstractContextManager[BinaryIO]:
    """Opens a new file that replaces ``path``, on the disk, when the block ends without an error."""
    return place_of(path).replacing()


@contextlib.contextmanager
def atomic_path(path: Path | RunPath) -> Iterator[Path]:
    """Yields the name of a new file, to be written, that replaces ``path`` when the block ends without an error.

    Raises:
        OSError: If it cannot be written; names ``path``.
    """
    with place_of(path).replaced() as partial:
        yield partial.path


@contextlib.contextmanager
def open_for_writing(path: Path | RunPath) -> Iterator[BinaryIO]:
    """Opens a file of the user for writing: through a link, except below the folder of a run.

    There, a new file replaces what is at ``path`` when the block ends without an error.
    """
    inside = below_run(path)
    if inside is None:
        with open(str(path), "wb") as file:
            yield file
    else:
        with inside.replacing() as file:
            yield file


def write_json(path: Path | RunPath, content: Mapping[str, Any]) -> None:
    """Writes ``content`` as JSON."""
    with atomic_file(path) as file:
        file.write((json.dumps(content, indent=2, ensure_ascii=False) + "\n").encode())
