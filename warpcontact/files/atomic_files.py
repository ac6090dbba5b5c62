"""Writes files of the user atomically, and checks their paths."""

import contextlib
import errno
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from warpcontact.files.run_folder import RunPath, below_run, run_path_of


def check_writable(path: Path | RunPath) -> None:
    """Raises an error unless a file can be written at ``path``; tests it by opening a file.

    Raises:
        ValueError: If it is a folder, its folder does not exist, or it cannot be written; the message names it.
    """
    inside = below_run(path)
    target = path.path if isinstance(path, RunPath) else path
    try:
        if target.is_dir() if inside is None else inside.is_real_folder():
            raise ValueError(f"{path}: is a folder; give the name of a file")
        if not target.parent.is_dir():
            wrong = "is not a folder" if target.parent.exists() else "does not exist"
            raise ValueError(f"{path}: {target.parent} {wrong}")
        if inside is None:
            _try(Path(os.path.realpath(target)))  # the target of a link, also of a dangling one
        else:
            inside.try_to_replace()
    except OSError as error:
        raise ValueError(f"{path}: cannot be written: {error.strerror or error}") from None


def _try(target: Path) -> None:
    """Opens a file for writing without changing it."""
    exists = target.exists()
    if exists and not target.is_file():  # opening a pipe would wait for its reader
        if not os.access(target, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(target))
        return
    target.open("ab").close()
    if not exists:
        target.unlink()


def atomic_file(path: Path | RunPath) -> contextlib.AbstractContextManager[BinaryIO]:
    """Opens a new file that replaces ``path``, synced to the disk, when the block ends without an error."""
    return run_path_of(path).replacement_file()


@contextlib.contextmanager
def atomic_path(path: Path | RunPath) -> Iterator[Path]:
    """Yields the path of a new file to write, which replaces ``path`` when the block ends without an error.

    Raises:
        OSError: If it cannot be written; the error names ``path``.
    """
    with run_path_of(path).replacement_path() as partial:
        yield partial.path


@contextlib.contextmanager
def open_for_writing(path: Path | RunPath) -> Iterator[BinaryIO]:
    """Opens a file of the user for writing; follows a link, except below a run folder.

    Below a run folder, a new file replaces ``path`` when the block ends without an error.
    """
    inside = below_run(path)
    if inside is None:
        with open(str(path), "wb") as file:
            yield file
    else:
        with inside.replacement_file() as file:
            yield file


def write_json(path: Path | RunPath, content: Mapping[str, Any]) -> None:
    """Writes ``content`` as JSON, atomically."""
    with atomic_file(path) as file:
        file.write((json.dumps(content, indent=2, ensure_ascii=False) + "\n").encode())
