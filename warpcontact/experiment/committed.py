"""A store of results as readers see it: what was committed, as it was committed."""

import asyncio
import contextlib
import hashlib
from collections.abc import Mapping
from pathlib import Path

from zarr.abc.store import ByteRequest
from zarr.core.buffer import Buffer, BufferPrototype, default_buffer_prototype
from zarr.storage import LocalStore

from warpcontact.experiment.records import COMMITS, Commit, StoreError, commits_in, made_in
from warpcontact.experiment.store import STAGING


class CommittedStore(LocalStore):
    """Reads the store of a run, and compares what it reads with the records of commits.

    Args:
        root: The store, in the folder of a run.
        read_only: Has to be; for those who make copies of a store.
        commits: The records of shards; ``None``: those that there are now.
    """

    def __init__(
        self, root: Path | str, *, read_only: bool = True, commits: Mapping[int, Commit] | None = None
    ) -> None:
        super().__init__(root, read_only=read_only)
        folder = self.root.parent / COMMITS
        self._commits = commits_in(folder) if commits is None else commits
        self._files = made_in(folder)
        self._shards: dict[str, str] = {}
        for commit in self._commits.values():
            self._files |= commit.files
            self._shards |= dict.fromkeys(commit.files, f"shard_{commit.shard:06d}")

    def with_read_only(self, read_only: bool = False) -> "CommittedStore":
        """Returns the same, which nobody can write into."""
        return type(self)(self.root, read_only=read_only, commits=self._commits)

    async def get(
        self, key: str, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        """Returns a file, or a range of one; ``None``: nothing was written, all values are empty.

        Raises:
            StoreError: If it was committed, and is missing or was changed since.
        """
        if key not in self._files or byte_range is not None:
            return None if self._is_unknown(key) else await super().get(key, prototype, byte_range)
        content = await asyncio.to_thread(self._content, key)
        return (prototype or default_buffer_prototype()).buffer.from_bytes(content)

    def get_sync(
        self, key: str, *, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        """Returns what ``get`` does."""
        if key not in self._files or byte_range is not None:
            return (
                None
                if self._is_unknown(key)
                else super().get_sync(key, prototype=prototype, byte_range=byte_range)
            )
        return (prototype or default_buffer_prototype()).buffer.from_bytes(self._content(key))

    def _is_unknown(self, key: str) -> bool:
        """Whether it is a chunk that nobody has committed, whatever is there: it counts for nothing."""
        return key not in self._files and "/c/" in key

    def _content(self, key: str) -> bytes:
        size, sha = self._files[key]
        places = [self.root / key]
        if key in self._shards:
            # Committed, and not moved yet; or in this very moment.
            places += [self.root.parent / STAGING / self._shards[key] / key, self.root / key]
        there = False
        for place in places:
            with contextlib.suppress(FileNotFoundError):
                content = place.read_bytes()
                if len(content) == size and hashlib.sha256(content).hexdigest() == sha:
                    return content
                there = there or place == places[0]
        what = "was changed since it" if there else "is missing, and"
        raise StoreError(f"{places[0]}: {what} was committed")
