"""Read-only Zarr store with the committed results of a run, checked against the recorded SHA-256."""

import asyncio
import contextlib
import hashlib
import os
from collections.abc import AsyncIterator, Iterable, Mapping

from zarr.abc.store import ByteRequest, OffsetByteRequest, RangeByteRequest, Store
from zarr.core.buffer import Buffer, BufferPrototype, default_buffer_prototype

from warpcontact.experiment.records import COMMITS, DATA, STAGING, Commit, RunDataError, commits_in, created_files
from warpcontact.files.run_folder import RunPath


class CommittedStore(Store):
    """Reads the store of a run and compares its files with the records of commits.

    Files that no record names are neither read nor listed.

    Args:
        folder: Folder of the run.
        read_only: Ignored, the store is always read-only. The parameter is required by Zarr.
        commits: Commits by shard number; ``None``: the current ones of the folder.
    """

    supports_writes = False
    supports_deletes = False
    supports_partial_writes = False  # with set_partial_values: Zarr 3.1.0 requires them
    supports_listing = True

    def __init__(
        self, folder: RunPath, *, read_only: bool = True, commits: Mapping[int, Commit] | None = None
    ) -> None:
        super().__init__(read_only=True)
        self.folder = folder
        self._commits = commits_in(folder / COMMITS) if commits is None else commits
        self._files = created_files(folder / COMMITS)
        self._shards: dict[str, str] = {}
        for commit in self._commits.values():
            self._files |= commit.files
            self._shards |= dict.fromkeys(commit.files, f"shard_{commit.shard:06d}")

    def with_read_only(self, read_only: bool = False) -> "CommittedStore":
        """Returns a copy, which is read-only as well."""
        return type(self)(self.folder, read_only=read_only, commits=self._commits)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, type(self)) and (self.folder, self._files) == (other.folder, other._files)

    __hash__ = None  # type: ignore[assignment]

    def __str__(self) -> str:
        return str(self.folder / DATA)

    async def get(
        self, key: str, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        """Returns the content of a file, or a range of it; ``None``: not committed, all values are the fill value.

        Raises:
            RunDataError: If the file is missing or was changed since it was committed.
        """
        if key not in self._files:
            return None
        content = await asyncio.to_thread(self._content, key)
        return _buffer(content, prototype, byte_range)

    def get_sync(
        self, key: str, *, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        """Returns the same as ``get``."""
        return _buffer(self._content(key), prototype, byte_range) if key in self._files else None

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        """Returns the same as ``get``, for several files."""
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]

    async def exists(self, key: str) -> bool:
        """Whether a file was committed."""
        return key in self._files

    async def list(self) -> AsyncIterator[str]:
        """Iterates over all files."""
        for key in self._files:
            yield key

    async def list_prefix(self, prefix: str) -> AsyncIterator[str]:
        """Iterates over the files whose names begin with ``prefix``."""
        for key in self._files:
            if key.startswith(prefix):
                yield key

    async def list_dir(self, prefix: str) -> AsyncIterator[str]:
        """Iterates over the names in a folder."""
        above = f"{prefix.rstrip('/')}/" if prefix else ""
        for name in dict.fromkeys(
            key.removeprefix(above).split("/")[0] for key in self._files if key.startswith(above)
        ):
            yield name

    async def set(self, key: str, value: Buffer) -> None:
        """Raises ``ValueError``: the store is read-only."""
        self._check_writable()

    async def set_partial_values(self, key_start_values: Iterable[tuple[str, int, bytes]]) -> None:
        """Raises ``ValueError``: the store is read-only."""
        self._check_writable()

    async def delete(self, key: str) -> None:
        """Raises ``ValueError``: the store is read-only."""
        self._check_writable()

    def _content(self, key: str) -> bytes:
        size, sha = self._files[key]
        absolute = self.folder / DATA / key
        paths = [absolute]
        if key in self._shards:
            # The file may be in the staging folder, or be moved while it is opened.
            paths += [self.folder / STAGING / self._shards[key] / key, absolute]
        exists = False
        for path in paths:
            with contextlib.suppress(FileNotFoundError), path.open_binary() as file:
                exists = exists or path == absolute
                if os.fstat(file.fileno()).st_size == size:
                    content = file.read(size)
                    if hashlib.sha256(content).hexdigest() == sha:
                        return content
        what = "was changed since it" if exists else "is missing, and"
        raise RunDataError(f"{absolute}: {what} was committed")


def _buffer(content: bytes, prototype: BufferPrototype | None, byte_range: ByteRequest | None) -> Buffer:
    """Returns bytes, or the requested range of them, as a buffer of Zarr."""
    part = slice(None)
    if isinstance(byte_range, RangeByteRequest):
        part = slice(byte_range.start, byte_range.end)
    elif isinstance(byte_range, OffsetByteRequest):
        part = slice(byte_range.offset, None)
    elif byte_range is not None:
        part = slice(max(len(content) - byte_range.suffix, 0), None)
    return (prototype or default_buffer_prototype()).buffer.from_bytes(content[part])
