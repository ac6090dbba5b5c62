"""Files that are there as a whole or not at all, whatever ends the process or the machine."""

import contextlib
import json
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, BinaryIO

#: End of the name of a file that is not whole yet.
PARTIAL = ".partial"

# Files or folders that are waited for at once.
WAITING = 16


def check_place(path: Path) -> None:
    """Raises an error unless a file can be written at ``path``, which is tried.

    Raises:
        ValueError: If it is a folder or in none that exists, or cannot be written; names it.
    """
    if path.is_dir():
        raise ValueError(f"{path}: is a folder; give the name of a file")
    if not path.parent.is_dir():
        wrong = "is not a folder" if path.parent.exists() else "does not exist"
        raise ValueError(f"{path}: {path.parent} {wrong}")
    place = Path(os.path.realpath(path))  # a link stays, whether or not there is what it leads to
    there = place.exists()
    try:
        place.open("ab").close()
        if not there:
            place.unlink()
    except OSError as error:
        raise ValueError(f"{path}: cannot be written: {error.strerror or error}") from None


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Opens a file beside ``path`` that takes its place, on the disk, when the block ends without an error."""
    with replaced(path) as partial, partial.open("wb") as file:
        yield file


@contextlib.contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Yields the name of a file beside ``path``, to be written, that takes its place when the block ends well.

    Raises:
        OSError: If it cannot be written; names ``path``, of which the user knows.
    """
    partial = path.with_name(f"{path.name}{PARTIAL}")
    try:
        yield partial
        sync_file(partial)
        partial.replace(path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            partial.unlink()
        if isinstance(error, OSError) and error.filename == str(partial):
            raise OSError(error.errno, error.strerror, str(path)) from error
        raise
    sync_folder(path.parent)


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Writes ``content`` as JSON."""
    with replacing(path) as file:
        file.write((json.dumps(content, indent=2, ensure_ascii=False) + "\n").encode())


def sync_file(path: Path) -> None:
    """Waits until the content of a file is on the disk."""
    with path.open("rb") as file:
        os.fsync(file.fileno())


def sync_files(paths: Iterable[Path]) -> None:
    """Waits until the contents of files are on the disk; their names may not be yet."""
    _wait_for(sync_file, list(paths))


def sync_names(folders: Iterable[Path], root: Path) -> None:
    """Waits until the names in folders, and in all above them up to ``root``, are on the disk."""
    _wait_for(sync_folder, {one for given in folders for one in _up_to(given, root)})


def _wait_for(synced: Callable[[Path], None], paths: Collection[Path]) -> None:
    """Waits until all paths are on the disk: it writes what it keeps in its memory for many that wait at once."""
    if paths:
        with ThreadPoolExecutor(min(len(paths), WAITING)) as pool:
            for _ in pool.map(synced, paths):
                pass


def _up_to(folder: Path, root: Path) -> set[Path]:
    return {folder, *folder.parents[: max(0, len(folder.parts) - len(root.parts))]}


def sync_folder(folder: Path) -> None:
    """Waits until the names in a folder are on the disk, where a system can say so."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
