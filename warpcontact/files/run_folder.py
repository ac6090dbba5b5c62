"""Files below the folder of a run, which others may have prepared: no symbolic link below the folder is followed.

``RunPath`` opens, creates, lists, moves and removes. Every folder on the way is opened by its descriptor without
following links; on systems without such descriptors each one is checked before. New files are created exclusively.
The folder of the run itself may be reached through a link. ``open_file`` and ``place_of`` do the same for files
that the user names, when these lie below the folder of a run. All modules that use a run folder use this one.
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

#: End of the name of a file that is not whole yet.
PARTIAL = ".partial"
EXPERIMENT = "experiment.toml"
SUMMARY = "run.json"

# Files or folders that are synchronized concurrently.
WAITING = 16

_NO_LINKS = getattr(os, "O_NOFOLLOW", 0)
_FOLDER = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_CLOEXEC", 0)
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | _NO_LINKS | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)

# On Windows ``file:stream`` is in ``file``, some names are of devices, and a dot or space at the end is dropped.
_WINDOWS = os.name == "nt"
_DEVICES = re.compile(r"(?:con|prn|aux|nul|conin\$|conout\$|(?:com|lpt)[0-9¹²³]) *(?:\..*)?", re.IGNORECASE)

# Whether folders can be opened, and names be relative to them.
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
        """Returns its status, a link's own; raises ``FileNotFoundError`` if it is missing."""
        return os.stat(self.name, dir_fd=self.folder, follow_symlinks=False)


@dataclass(frozen=True)
class RunPath:
    """A file or folder below the folder of a run, or that folder itself.

    All methods raise ``UnsafeFileError`` if a folder on the way is a symbolic link, and ``OSError`` with the whole
    path as its file name.

    Args:
        root: The folder of the run, which may be a link.
        parts: Names below it.
    """

    root: Path
    parts: tuple[str, ...] = ()

    def __truediv__(self, name: str) -> "RunPath":
        below = tuple(name.split("/"))
        if any(part in ("", ".", "..") or "\0" in part or os.sep in part for part in below):
            raise ValueError(f"{self}: the name of a file must not be empty, '.' or '..', got {name!r}")
        if _WINDOWS and any(":" in part or part[-1] in ". " or _DEVICES.fullmatch(part) for part in below):
            raise ValueError(f"{self}: the name of a file must be one that Windows has for files, got {name!r}")
        return RunPath(self.root, (*self.parts, *below))

    def __str__(self) -> str:
        return str(self.path)

    @property
    def path(self) -> Path:
        """Its path, for messages and for libraries that open files by name."""
        return self.root.joinpath(*self.parts)

    @property
    def name(self) -> str:
        """Its last name."""
        return self.path.name

    @property
    def stem(self) -> str:
        """Its last name without the suffix."""
        return self.path.stem

    @property
    def parent(self) -> "RunPath":
        """The folder that it is in; the folder of the run is its own."""
        return RunPath(self.root, self.parts[:-1])

    def with_name(self, name: str) -> "RunPath":
        """Returns the entry ``name`` of the same folder."""
        return self.parent / name

    # Status

    def status(self) -> os.stat_result | None:
        """Returns the status of the entry, of a link itself; ``None``: it is missing."""
        with self._blamed():
            if not self.parts:
                return os.stat(self.root) if self.root.exists() else None
            try:
                with self._entry() as entry:
                    return entry.stat()
            except (FileNotFoundError, NotADirectoryError):
                return None

    def is_there(self) -> bool:
        """Whether there is anything of this name, also a link."""
        return self.status() is not None

    def is_folder(self) -> bool:
        """Whether there is a folder of this name; a link is refused."""
        found = self.status()
        if found is not None and stat.S_ISLNK(found.st_mode):
            raise refused(self, LINKED)
        return found is not None and stat.S_ISDIR(found.st_mode)

    def is_real_folder(self) -> bool:
        """Whether there is a folder of this name, and no link."""
        found = self.status()
        return found is not None and stat.S_ISDIR(found.st_mode)

    def file_status(self) -> os.stat_result | None:
        """Returns the status of a file; ``None``: there is none. A link, pipe or device is refused."""
        found = self.status()
        if found is None or stat.S_ISDIR(found.st_mode):
            return None
        check_regular(found, self)
        return found

    def is_file(self) -> bool:
        """Whether there is a file of this name; a link, pipe or device is refused."""
        return self.file_status() is not None

    def size(self) -> int:
        """Returns the size of a file [bytes]."""
        found = self.status()
        if found is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))
        check_regular(found, self)
        return found.st_size

    def names(self) -> list[str]:
        """Returns the names in a folder, sorted; none if there is no folder."""
        with self._blamed():
            try:
                with self.opened() as (path, descriptor):
                    return sorted(os.listdir(path if descriptor is None else descriptor))
            except FileNotFoundError:
                return []

    # Read

    def open_binary(self, most: int | None = None, flags: int = 0) -> BufferedReader:
        """Opens a regular file of at most ``most`` bytes to read, with further flags of ``os.open``."""
        with self._blamed(), self._entry() as entry:
            return open_regular(entry.name, most, shown=self, follow=False, folder=entry.folder, flags=flags)

    def read(self, most: int = TEXT) -> bytes:
        """Returns the content of a regular file of at most ``most`` bytes."""
        with self.open_binary(most) as file:
            return file.read()

    # Write

    def make(self) -> None:
        """Makes a folder, and those that it is in, unless they are there."""
        if self.is_folder():
            return
        self.root.mkdir(parents=True, exist_ok=True)
        for count in range(1, len(self.parts) + 1):
            folder = RunPath(self.root, self.parts[:count])
            with folder._blamed(), folder._entry() as entry:
                try:
                    os.mkdir(entry.name, dir_fd=entry.folder)
                except FileExistsError:
                    if not folder.is_folder():
                        raise

    def create(self, flags: int = 0) -> int:
        """Creates an empty file, which replaces another or a link, and returns its descriptor to write.

        Args:
            flags: Further flags of ``os.open``.
        """
        with self._blamed(), self._entry() as entry:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(entry.name, dir_fd=entry.folder)
            return os.open(entry.name, _NEW | flags, 0o666, dir_fd=entry.folder)

    @contextlib.contextmanager
    def replaced(self, partial: str | None = None) -> Iterator["RunPath"]:
        """Yields a new, empty file, to be written by name, that replaces this one when the block ends well.

        Args:
            partial: Its name; ``None``: that of this file with ``.partial``.

        Raises:
            OSError: If it cannot be written; names this file.
        """
        with self._replacement(partial or f"{self.name}{PARTIAL}") as (new, descriptor):
            os.close(descriptor)
            yield new
            new.sync()

    @contextlib.contextmanager
    def replacing(self, *, wait: bool = True) -> Iterator[BinaryIO]:
        """Opens a new file that replaces this one when the block ends without an error.

        Args:
            wait: Whether to wait until its content is on the disk.

        Raises:
            OSError: If it cannot be written; names this file.
        """
        with self._replacement(f"{self.name}{PARTIAL}", wait=wait) as (_, descriptor):
            try:
                with os.fdopen(descriptor, "wb", closefd=False) as file:
                    yield file
                if wait:
                    with self._blamed():
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
        """Creates the new file of ``replacing``, and removes it."""
        new = self.with_name(f"{self.name}{PARTIAL}")
        os.close(new.create())
        new.remove()

    def move_to(self, other: "RunPath") -> None:
        """Moves it to ``other``, which is replaced."""
        with self._blamed(), self._entry() as old, other._entry() as new:
            os.replace(old.name, new.name, src_dir_fd=old.folder, dst_dir_fd=new.folder)

    def remove(self) -> None:
        """Removes a file, a link itself, or a folder with all that is in it; does nothing if it is missing."""
        found = self.status()
        if found is None:
            return
        with self._blamed(), self._entry() as entry, contextlib.suppress(FileNotFoundError):
            if stat.S_ISDIR(found.st_mode):
                try:
                    shutil.rmtree(entry.name, dir_fd=entry.folder)
                except RecursionError:
                    raise OSError(errno.ENOTEMPTY, "has folders that are nested too deep to be removed") from None
            else:
                os.unlink(entry.name, dir_fd=entry.folder)

    def sync(self) -> None:
        """Waits until the content of a file, or the names in a folder, are on the disk."""
        if self.is_folder():
            with self._blamed(), self.opened() as (_, descriptor):
                if descriptor is not None:
                    os.fsync(descriptor)
            return
        # Windows synchronizes no descriptor that cannot write.
        with self.open_binary(flags=os.O_RDWR if _WINDOWS else 0) as file, self._blamed():
            os.fsync(file.fileno())

    # Descriptors

    @contextlib.contextmanager
    def opened(self) -> Iterator[tuple[Path, int | None]]:
        """Opens a folder; yields its path, and its descriptor where systems have these."""
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
                    # Systems have different errors for a link.
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
        """Opens the folder that it is in."""
        if not self.parts:
            raise ValueError(f"{self}: is the folder of a run")
        with self.parent.opened() as (path, descriptor):
            yield _Entry(str(path / self.name) if descriptor is None else self.name, descriptor)

    @contextlib.contextmanager
    def _blamed(self) -> Iterator[None]:
        """Names the whole path in errors of the system, which name a part of it, or none."""
        try:
            yield
        except OSError as error:
            if not isinstance(error, UnsafeFileError):
                error.filename = str(self)
                del error.filename2
            raise


def sync_all(paths: Iterable[RunPath]) -> None:
    """Waits until files and folders are on the disk: concurrently, which lets the system write many at a time."""
    once = list(dict.fromkeys(paths))
    if once:
        with ThreadPoolExecutor(min(len(once), WAITING)) as pool:
            for _ in pool.map(RunPath.sync, once):
                pass


def sync_names(folders: Iterable[RunPath], above: RunPath) -> None:
    """Waits until the names in folders, and in all above them up to ``above``, are on the disk."""
    count = len(above.parts)
    sync_all(
        RunPath(folder.root, folder.parts[:length])
        for folder in folders
        for length in range(len(folder.parts), count - 1, -1)
    )


def is_run_folder(folder: Path) -> bool:
    """Whether a folder looks like that of a run: what is in it is not checked."""
    return all(os.path.lexists(folder / name) for name in (SUMMARY, EXPERIMENT))


def below_run(path: Path | RunPath) -> RunPath | None:
    """Returns ``path`` as an entry below the folder of a run; ``None``: it is below none."""
    if isinstance(path, RunPath):
        return path
    # Without resolving links: those below the folder are to be found.
    whole = Path(os.path.abspath(path))
    root = next((folder for folder in whole.parents if is_run_folder(folder)), None)
    if root is None:
        return None
    parts = whole.relative_to(root).parts
    # As the user wrote it, for messages.
    written = path.parents[len(parts) - 1] if len(path.parents) >= len(parts) and ".." not in path.parts else root
    return RunPath(written, parts)


def place_of(path: Path | RunPath) -> RunPath:
    """Returns a file of the user, to be replaced, or to be read with what belongs to it."""
    if isinstance(path, RunPath):
        return path
    return below_run(path) or RunPath(path.parent, (path.name,))


def open_file(path: Path | RunPath, most: int | None = None) -> BufferedReader:
    """Opens a regular file of at most ``most`` bytes to read; below the folder of a run, no link is followed.

    Raises:
        UnsafeFileError: If it is a pipe or device, too large, or below the folder of a run and behind a link.
        OSError: If it cannot be opened.
    """
    inside = below_run(path)
    return inside.open_binary(most) if inside is not None else open_regular(str(path), most)


def read_file(path: Path | RunPath, most: int = TEXT) -> bytes:
    """Returns the content of a file; see ``open_file``."""
    with open_file(path, most) as file:
        return file.read()
