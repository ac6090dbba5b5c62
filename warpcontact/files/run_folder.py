"""Access to files below a run folder, which may come from others: symbolic links below it are not followed.

``RunPath`` opens, creates, lists, moves and removes files. Each folder of the path is opened by descriptor without
following links; on systems without such descriptors it is checked before. New files are created exclusively. The
path of the run folder itself may contain links. ``open_file`` and ``run_path_of`` apply the same rules to files that the
user names, if they are below a run folder. All modules that access a run folder use this module.
"""

import contextlib
import errno
import os
import re
import shutil
import stat
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from warpcontact.files.regular_files import LINKED, TEXT, UnsafeFileError, check_regular, open_regular, refused

#: Suffix of the name of an incomplete file.
PARTIAL = ".partial"
EXPERIMENT = "experiment.toml"
SUMMARY = "run.json"

# Number of files or folders that are synced concurrently.
MAX_CONCURRENT_SYNCS = 16

_NO_LINKS = getattr(os, "O_NOFOLLOW", 0)
_FOLDER = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_CLOEXEC", 0)
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | _NO_LINKS | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)

# Windows: ``file:stream`` is a stream of ``file``, some names are devices, and trailing dots and spaces are dropped.
_WINDOWS = os.name == "nt"
_DEVICES = re.compile(r"(?:con|prn|aux|nul|conin\$|conout\$|(?:com|lpt)[0-9¹²³]) *(?:\..*)?", re.IGNORECASE)

# Whether the system can open folders and resolve names relative to them.
_DESCRIPTORS = (
    bool(_NO_LINKS)
    and shutil.rmtree.avoids_symlink_attacks
    and {os.open, os.stat, os.mkdir, os.unlink, os.rename} <= os.supports_dir_fd
)


@dataclass(frozen=True)
class _Entry:
    """An entry of an open folder.

    Attributes:
        name: Its name in the folder, or its path if there are no descriptors of folders.
        folder: Descriptor of the folder.
    """

    name: str
    folder: int | None

    def stat(self) -> os.stat_result:
        """Returns the status of the entry, without following a link; raises ``FileNotFoundError`` if it is missing."""
        return os.stat(self.name, dir_fd=self.folder, follow_symlinks=False)


@dataclass(frozen=True)
class RunPath:
    """A file or folder below a run folder, or the run folder itself.

    All methods raise ``UnsafeFileError`` if a folder of the path is a symbolic link. An ``OSError`` has the full path
    as its file name.

    Args:
        root: The run folder, which may be a link.
        parts: Names of the path below it.
    """

    root: Path
    parts: tuple[str, ...] = ()

    def __truediv__(self, name: str) -> "RunPath":
        below = tuple(name.split("/"))
        if any(part in ("", ".", "..") or "\0" in part or os.sep in part for part in below):
            raise ValueError(f"{self}: the name of a file must not be empty, '.' or '..', got {name!r}")
        if _WINDOWS and any(":" in part or part[-1] in ". " or _DEVICES.fullmatch(part) for part in below):
            raise ValueError(f"{self}: the name of a file must be valid on Windows, got {name!r}")
        return RunPath(self.root, (*self.parts, *below))

    def __str__(self) -> str:
        return str(self.path)

    @property
    def path(self) -> Path:
        """Path for messages and for libraries that open files by name."""
        return self.root.joinpath(*self.parts)

    @property
    def name(self) -> str:
        """Last name of the path."""
        return self.path.name

    @property
    def stem(self) -> str:
        """Last name of the path without the suffix."""
        return self.path.stem

    @property
    def parent(self) -> "RunPath":
        """Folder of the entry; the run folder is its own parent."""
        return RunPath(self.root, self.parts[:-1])

    def with_name(self, name: str) -> "RunPath":
        """Returns the entry ``name`` of the same folder."""
        return self.parent / name

    # Status

    def status(self) -> os.stat_result | None:
        """Returns the status of the entry, without following a link; ``None``: it is missing."""
        with self._with_full_path():
            if not self.parts:
                return os.stat(self.root) if self.root.exists() else None
            try:
                with self._entry() as entry:
                    return entry.stat()
            except (FileNotFoundError, NotADirectoryError):
                return None

    def exists(self) -> bool:
        """Whether an entry exists, also a link."""
        return self.status() is not None

    def is_folder(self) -> bool:
        """Whether the entry is a folder; a link is refused."""
        found = self.status()
        if found is not None and stat.S_ISLNK(found.st_mode):
            raise refused(self, LINKED)
        return found is not None and stat.S_ISDIR(found.st_mode)

    def is_real_folder(self) -> bool:
        """Whether the entry is a folder; a link is not."""
        found = self.status()
        return found is not None and stat.S_ISDIR(found.st_mode)

    def file_status(self) -> os.stat_result | None:
        """Returns the status of a file; ``None``: missing, or a folder. A link, pipe or device is refused."""
        found = self.status()
        if found is None or stat.S_ISDIR(found.st_mode):
            return None
        check_regular(found, self)
        return found

    def is_file(self) -> bool:
        """Whether the entry is a file; a link, pipe or device is refused."""
        return self.file_status() is not None

    def size(self) -> int:
        """Returns the size of a file [bytes]."""
        found = self.status()
        if found is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))
        check_regular(found, self)
        return found.st_size

    def names(self) -> list[str]:
        """Returns the names in a folder, sorted; empty if the folder is missing."""
        with self._with_full_path():
            try:
                with self.opened() as (path, descriptor):
                    return sorted(os.listdir(path if descriptor is None else descriptor))
            except FileNotFoundError:
                return []

    # Read

    def open_binary(self, max_size: int | None = None, flags: int = 0) -> BufferedReader:
        """Opens a regular file of at most ``max_size`` bytes in read mode, with additional flags of ``os.open``."""
        with self._with_full_path(), self._entry() as entry:
            return open_regular(entry.name, max_size, shown=self, follow=False, folder=entry.folder, flags=flags)

    def read(self, max_size: int = TEXT) -> bytes:
        """Returns the content of a regular file of at most ``max_size`` bytes."""
        with self.open_binary(max_size) as file:
            return file.read()

    # Write

    def make(self) -> None:
        """Creates a folder and its parents, if they do not exist."""
        if self.is_folder():
            return
        self.root.mkdir(parents=True, exist_ok=True)
        for count in range(1, len(self.parts) + 1):
            folder = RunPath(self.root, self.parts[:count])
            with folder._with_full_path(), folder._entry() as entry:
                try:
                    os.mkdir(entry.name, dir_fd=entry.folder)
                except FileExistsError:
                    if not folder.is_folder():
                        raise

    def create(self, flags: int = 0) -> int:
        """Creates an empty file, which replaces a file or link, and returns a descriptor for writing.

        Args:
            flags: Additional flags of ``os.open``.
        """
        with self._with_full_path(), self._entry() as entry:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(entry.name, dir_fd=entry.folder)
            return os.open(entry.name, _NEW | flags, 0o666, dir_fd=entry.folder)

    @contextlib.contextmanager
    def replacement_path(self, partial: str | None = None) -> Iterator["RunPath"]:
        """Yields a new, empty file to write by name; it replaces this one when the block ends without an error.

        Args:
            partial: Name of the new file; ``None``: the name of this file with ``.partial``.

        Raises:
            OSError: If it cannot be written; the error names this file.
        """
        with self._replacement(partial or f"{self.name}{PARTIAL}") as (new, descriptor):
            os.close(descriptor)
            yield new
            new.sync()

    @contextlib.contextmanager
    def replacement_file(self, *, wait: bool = True) -> Iterator[BinaryIO]:
        """Opens a new file, which replaces this one when the block ends without an error.

        Args:
            wait: Whether to sync its content to the disk.

        Raises:
            OSError: If it cannot be written; the error names this file.
        """
        with self._replacement(f"{self.name}{PARTIAL}", wait=wait) as (_, descriptor):
            try:
                with os.fdopen(descriptor, "wb", closefd=False) as file:
                    yield file
                if wait:
                    with self._with_full_path():
                        os.fsync(descriptor)
            finally:
                os.close(descriptor)

    @contextlib.contextmanager
    def _replacement(self, name: str, *, wait: bool = True) -> Iterator[tuple["RunPath", int]]:
        new = self.with_name(name)
        try:
            yield new, new.create()
            new.move_to(self)
        except BaseException as error:
            with contextlib.suppress(OSError):
                new.remove()
            if isinstance(error, OSError) and error.filename == str(new):
                error.filename = str(self)
            raise
        if wait:
            self.parent.sync()

    def try_to_replace(self) -> None:
        """Creates and removes the new file of ``replacement_file``, to test whether it can be written."""
        new = self.with_name(f"{self.name}{PARTIAL}")
        os.close(new.create())
        new.remove()

    def move_to(self, other: "RunPath") -> None:
        """Moves the entry to ``other``, which is replaced."""
        with self._with_full_path(), self._entry() as old, other._entry() as new:
            os.replace(old.name, new.name, src_dir_fd=old.folder, dst_dir_fd=new.folder)

    def remove(self) -> None:
        """Removes a file, a link itself, or a folder with its content; does nothing if the entry is missing."""
        found = self.status()
        if found is None:
            return
        with self._with_full_path(), self._entry() as entry, contextlib.suppress(FileNotFoundError):
            if stat.S_ISDIR(found.st_mode):
                try:
                    shutil.rmtree(entry.name, dir_fd=entry.folder)
                except RecursionError:
                    raise OSError(
                        errno.ENOTEMPTY, "has folders that are nested too deeply to be removed"
                    ) from None
            else:
                os.unlink(entry.name, dir_fd=entry.folder)

    def sync(self) -> None:
        """Syncs the content of a file, or the names in a folder, to the disk."""
        if self.is_folder():
            with self._with_full_path(), self.opened() as (_, descriptor):
                if descriptor is not None:
                    os.fsync(descriptor)
            return
        # Windows syncs only descriptors that are open for writing.
        with self.open_binary(flags=os.O_RDWR if _WINDOWS else 0) as file, self._with_full_path():
            os.fsync(file.fileno())

    # Descriptors

    @contextlib.contextmanager
    def opened(self) -> Iterator[tuple[Path, int | None]]:
        """Opens a folder; yields its path, and its descriptor if the system supports it."""
        if not _DESCRIPTORS:
            for count in range(1, len(self.parts) + 1):
                above = self.root.joinpath(*self.parts[:count])
                if above.is_symlink() or getattr(above, "is_junction", bool)():
                    raise refused(above, LINKED)
            yield self.path, None
            return
        descriptor = os.open(self.root, _FOLDER)
        try:
            for count, part in enumerate(self.parts, 1):
                try:
                    inner = os.open(part, _FOLDER | _NO_LINKS, dir_fd=descriptor)
                except OSError:
                    # The error for a link depends on the system.
                    if stat.S_ISLNK(os.stat(part, dir_fd=descriptor, follow_symlinks=False).st_mode):
                        raise refused(self.root.joinpath(*self.parts[:count]), LINKED) from None
                    raise
                os.close(descriptor)
                descriptor = inner
            yield self.path, descriptor
        finally:
            os.close(descriptor)

    @contextlib.contextmanager
    def _entry(self) -> Iterator[_Entry]:
        """Opens the folder of the entry."""
        if not self.parts:
            raise ValueError(f"{self}: is the folder of a run")
        with self.parent.opened() as (path, descriptor):
            yield _Entry(str(path / self.name) if descriptor is None else self.name, descriptor)

    @contextlib.contextmanager
    def _with_full_path(self) -> Iterator[None]:
        """Sets the full path as the file name of an ``OSError``, which may have a part of it or none."""
        try:
            yield
        except OSError as error:
            if not isinstance(error, UnsafeFileError):
                error.filename = str(self)
                del error.filename2
            raise


def sync_all(paths: Iterable[RunPath]) -> None:
    """Syncs files and folders to the disk concurrently, so that the system writes many at a time."""
    once = list(dict.fromkeys(paths))
    if once:
        with ThreadPoolExecutor(min(len(once), MAX_CONCURRENT_SYNCS)) as pool:
            for _ in pool.map(RunPath.sync, once):
                pass


def sync_names(folders: Iterable[RunPath], above: RunPath) -> None:
    """Syncs the names in folders, and in their parents up to ``above``, to the disk."""
    count = len(above.parts)
    sync_all(
        RunPath(folder.root, folder.parts[:length])
        for folder in folders
        for length in range(len(folder.parts), count - 1, -1)
    )


def is_run_folder(folder: Path) -> bool:
    """Whether a folder looks like a run folder; its content is not checked."""
    return all(os.path.lexists(folder / name) for name in (SUMMARY, EXPERIMENT))


def below_run(path: Path | RunPath) -> RunPath | None:
    """Returns ``path`` as an entry below a run folder; ``None``: it is not below one."""
    if isinstance(path, RunPath):
        return path
    # Do not resolve links, because links below the folder must be detected.
    absolute = Path(os.path.abspath(path))
    root = next((folder for folder in absolute.parents if is_run_folder(folder)), None)
    if root is None:
        return None
    parts = absolute.relative_to(root).parts
    # Keep the path as the user wrote it, for messages.
    as_given = path.parents[len(parts) - 1] if len(path.parents) >= len(parts) and ".." not in path.parts else root
    return RunPath(as_given, parts)


def run_path_of(path: Path | RunPath) -> RunPath:
    """Returns the ``RunPath`` of a file of the user; the root is its run folder, or else its folder."""
    if isinstance(path, RunPath):
        return path
    return below_run(path) or RunPath(path.parent, (path.name,))


def open_file(path: Path | RunPath, max_size: int | None = None) -> BufferedReader:
    """Opens a regular file of at most ``max_size`` bytes in read mode; below a run folder, links are not followed.

    Raises:
        UnsafeFileError: If it is a pipe or device, too large, or reached through a link below a run folder.
        OSError: If it cannot be opened.
    """
    inside = below_run(path)
    return inside.open_binary(max_size) if inside is not None else open_regular(str(path), max_size)


def read_file(path: Path | RunPath, max_size: int = TEXT) -> bytes:
    """Returns the content of a file, opened by ``open_file``."""
    with open_file(path, max_size) as file:
        return file.read()
