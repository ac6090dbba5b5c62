"""Stores the results of a run as Zarr groups that are filled shard by shard.

    data.zarr/params, outcome, series, events    results, as readers see them
    staging/<shard>/…                            chunks that are written and not committed
    checkpoint/<shard>-<steps>.npz               state from which an unfinished shard resumes
    commit/store.json, commit/<shard>.json       names, sizes and SHA-256 of the initial files; of committed chunks

Arrays are created with their final shape, filled with NaN or −1. Each chunk belongs to one shard. The checkpoint
and the staged chunks are synced, in any order, before the record that names them. Then the chunks are moved to
``data.zarr``. After a crash at any time, ``Ledger.recover`` restores the last commit. Files that no record names are
ignored. Chunks of series are written and synced while steps continue.
"""

import contextlib
import hashlib
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from warpcontact.experiment.chunks import Chunk, ChunkEncoder, compressors
from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.records import (
    COMMITS,
    DATA,
    GROUPS_ATTRIBUTE,
    LABELS_ATTRIBUTE,
    STAGING,
    STORE_RECORD,
    VARIABLES_ATTRIBUTE,
    Commit,
    ExpectedFiles,
    Files,
    RunDataError,
    RunExtent,
    commits_in,
    created_files,
    is_chunk,
    is_chunk_folder,
    is_unchanged,
)
from warpcontact.files.atomic_files import write_json
from warpcontact.files.run_folder import PARTIAL, RunPath, sync_all, sync_names
from warpcontact.system.resources import available_threads
from warpcontact.validation.checks import check_length

if TYPE_CHECKING:
    import xarray as xr

    from warpcontact.experiment.committed import CommittedStore

CHECKPOINTS = "checkpoint"

# If the largest divisor of the shard size is smaller than the wanted chunk by this factor, the next larger is used.
MIN_DIVISOR_RATIO = 8

# Approximate size of chunks before compression [bytes].
CHUNK = 16 * 2**20
# Longest name of a folder on usual file systems [bytes].
MAX_NAME_BYTES = 255
# Number of chunks that are compressed concurrently; each takes twice its size.
WRITERS = 4


@dataclass(frozen=True)
class Shard:
    """A range of environments that are run and committed together.

    Attributes:
        number: Number of the shard, from 0.
        first: First environment.
        stop: End of the range, exclusive.
    """

    number: int
    first: int
    stop: int

    @property
    def name(self) -> str:
        """Name of its files and folders."""
        return f"shard_{self.number:06d}"

    @property
    def envs(self) -> int:
        """Number of environments."""
        return self.stop - self.first


@dataclass(frozen=True)
class Shards(Sequence[Shard]):
    """The shards of a run, as a sequence; the last one may be smaller.

    Attributes:
        envs: Number of environments.
        size: Environments per shard.
    """

    envs: int
    size: int

    def __len__(self) -> int:
        return len(range(0, self.envs, self.size))

    @overload
    def __getitem__(self, number: int) -> Shard: ...
    @overload
    def __getitem__(self, number: slice) -> list[Shard]: ...

    def __getitem__(self, number: int | slice) -> Shard | list[Shard]:
        if isinstance(number, slice):
            return [self[k] for k in range(len(self))[number]]
        k = range(len(self))[number]
        return Shard(k, k * self.size, min((k + 1) * self.size, self.envs))


@contextlib.contextmanager
def _few_threads() -> Iterator[None]:
    """Limits the threads of Zarr to ``WRITERS`` if it starts them now and the user has not set their number.

    The threads persist, and the allocator keeps the memory that each of them freed. With the default number of
    threads, that is more than the data to be written.
    """
    import zarr

    key = "threading.max_workers"
    if zarr.config.get(key, None) is not None:
        yield
        return
    with zarr.config.set({key: min(available_threads(), WRITERS)}):
        yield


@_few_threads()
def _empty_store(folder: RunPath) -> "CommittedStore":
    """Returns the store of a run without any commits.

    Opens a group, so that Zarr starts its threads in the thread of the caller: its settings apply to the process.
    """
    import zarr

    from warpcontact.experiment.committed import CommittedStore

    store = CommittedStore(folder, commits={})
    zarr.open_group(store, mode="r")
    return store


def check_names(data_layouts: Mapping[str, "xr.Dataset"], source: str) -> None:
    """Raises ``ExperimentError`` of ``source`` if the name of a variable is too long for a folder."""
    for group, layout in data_layouts.items():
        for name in layout.data_vars:
            try:
                check_length(f"the name of a variable of {group}", str(name), MAX_NAME_BYTES)
            except ValueError as error:
                raise ExperimentError(source, [str(error)]) from None


@_few_threads()
def create(
    folder: Path,
    data_layouts: Mapping[str, "xr.Dataset"],
    envs: int,
    times: NDArray[np.float64],
    block: int,
    attributes: Mapping[str, Any],
) -> None:
    """Creates a store with empty arrays of their final shape, atomically.

    Args:
        folder: Folder of the run.
        data_layouts: Data set of a shard for each group: variables, axes, labels, attributes.
        envs: Number of environments of the run.
        times: Times of all frames [s].
        block: Frames per chunk.
        attributes: Attributes of each group.
    """
    import xarray as xr
    import zarr
    from zarr.storage import MemoryStore

    buffers: dict[str, Any] = {}
    made = MemoryStore(buffers)
    zarr.open_group(
        made, mode="w-", zarr_format=3, attributes={**attributes, GROUPS_ATTRIBUTE: list(data_layouts)}
    )
    for name, layout in data_layouts.items():
        sizes = {**layout.sizes, "env": envs}
        coordinates = {key: c for key, c in layout.coords.items() if key not in ("env", "time")}
        coordinates["env"] = ("env", np.arange(envs), layout["env"].attrs)
        if "time" in layout.sizes:
            sizes["time"] = len(times)
            coordinates["time"] = ("time", times, layout["time"].attrs)
        # Folders are unordered: store the order of the variables.
        listed = {
            VARIABLES_ATTRIBUTE: list(map(str, layout.data_vars)),
            LABELS_ATTRIBUTE: sorted(map(str, coordinates)),
        }
        labels = xr.Dataset(coords=coordinates, attrs={**attributes, **layout.attrs, **listed})
        # By default, Zarr does not write a chunk of zeros, such as the label of a single environment.
        with zarr.config.set({"array.write_empty_chunks": True}):
            labels.to_zarr(made, group=name, mode="w-", zarr_format=3, consolidated=False)
        group = zarr.open_group(made, mode="r+", path=name)
        for key, variable in layout.data_vars.items():
            _create_array(group, str(key), variable, sizes, layout.sizes["env"], block)
    content = {name: buffer.to_bytes() for name, buffer in sorted(buffers.items())}
    run = RunPath(folder)
    partial = run / f"{DATA}{PARTIAL}"
    partial.remove()
    for name, data in content.items():
        (partial / name).parent.make()
        with os.fdopen((partial / name).create(), "wb") as file:
            file.write(data)
    sync_all(partial / name for name in content)
    sync_names({(partial / name).parent for name in content}, partial)
    files = {name: (len(data), hashlib.sha256(data).hexdigest()) for name, data in content.items()}
    write_json(run / COMMITS / STORE_RECORD, {"files": files})
    partial.move_to(run / DATA)
    run.sync()


def _create_array(
    group: Any, name: str, layout: "xr.DataArray", sizes: Mapping[Any, int], shard: int, block: int
) -> None:
    tail = [size for dim, size in layout.sizes.items() if dim not in ("time", "env")]
    row = layout.dtype.itemsize * int(np.prod(tail, initial=1)) * (block if "time" in layout.sizes else 1)
    chunk = {"env": largest_divisor(shard, max(1, CHUNK // max(1, row))), "time": block}
    group.create_array(
        name,
        shape=tuple(sizes[dim] for dim in layout.dims),
        chunks=tuple(max(1, chunk.get(str(dim), sizes[dim])) for dim in layout.dims),
        dtype=layout.dtype,
        fill_value=empty_value(layout.dtype),
        dimension_names=[str(dim) for dim in layout.dims],
        attributes=dict(layout.attrs),
        compressors=compressors(layout),
    )


def empty_value(dtype: np.dtype[Any]) -> Any:
    """Returns the fill value of an array."""
    return {"f": np.nan, "i": -1, "b": False}.get(dtype.kind, 0)


def largest_divisor(envs: int, limit: int) -> int:
    """Returns the largest divisor of ``envs`` up to ``limit``; if that is far smaller, the next larger divisor."""
    small = [part for part in range(1, math.isqrt(envs) + 1) if envs % part == 0]
    parts = sorted({*small, *(envs // part for part in small)})
    largest = max(part for part in parts if part <= max(1, limit))
    # The divisors of a prime number are 1 and itself.
    return (
        largest
        if largest >= min(envs, limit) / MIN_DIVISOR_RATIO
        else next(part for part in parts if part > limit)
    )


class Ledger:
    """Commits of the shards of a run in a folder.

    Args:
        folder: Folder of the run.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = RunPath(folder)

    def commits(self) -> dict[int, Commit]:
        """Returns the last commit of each shard that has one.

        Raises:
            RunDataError: If a record is damaged.
        """
        return commits_in(self.folder / COMMITS)

    def staging(self, shard: Shard, threads: int | None = None) -> "Staging":
        """Returns the staging area of ``shard``, written by up to ``threads`` threads; ``None``: one per core."""
        return Staging(self.folder, shard, threads)

    def commit(self, shard: Shard, commit: Commit, staged: Files) -> None:
        """Commits the staged files and the checkpoint, which are already synced to the disk.

        Writes the record, moves the files to ``data.zarr`` and removes older checkpoints.

        Args:
            shard: The shard.
            commit: Its new commit, without the staged files.
            staged: The staged files, which are synced to the disk.
        """
        commit.files |= dict(sorted(staged.items()))
        write_json(self.folder / COMMITS / f"{shard.name}.json", asdict(commit))
        self._publish(shard, staged)
        self._drop_checkpoints(shard, commit)

    def recover(self, shard: Shard, commit: Commit) -> None:
        """Completes an interrupted commit, and removes files that were staged after it."""
        root = self.folder / STAGING / shard.name
        # A shard that was started again may have been rewriting a committed chunk when it was killed.
        self._publish(shard, [name for name, entry in commit.files.items() if is_unchanged(root / name, *entry)])
        root.remove()
        self._drop_checkpoints(shard, commit)

    def _publish(self, shard: Shard, names: Iterable[str]) -> None:
        root, target = self.folder / STAGING / shard.name, self.folder / DATA
        folders = set()
        for name in names:
            (target / name).parent.make()
            (root / name).move_to(target / name)
            folders.add((target / name).parent)
        sync_names(folders, target)

    def _drop_checkpoints(self, shard: Shard, commit: Commit) -> None:
        checkpoints = self.folder / CHECKPOINTS
        for name in checkpoints.names():
            if name.startswith(f"{shard.name}-") and name != commit.checkpoint:
                (checkpoints / name).remove()

    def check(self, extent: RunExtent, *, contents: bool = False, checkpoints: bool = True) -> None:
        """Checks that all files of the committed steps of each shard are recorded and exist.

        Args:
            extent: Environments, shards and steps of the run.
            contents: Whether to compare the contents of files, not only their sizes, and to refuse unknown entries
                of records and, in a finished run, unknown files.
            checkpoints: Whether to check that unfinished shards can be resumed. If not, they can be started again.

        Raises:
            RunDataError: If a file or its entry is missing, or does not belong to the run; the message names it.
        """
        made = created_files(self.folder / COMMITS)
        expected = ExpectedFiles(self.folder, made, extent)
        if problem := self._problem_of(made, "", contents):
            raise RunDataError(problem)
        commits = self.commits()
        for number, found in commits.items():
            commit: Commit | None = found
            while commit is not None and (problem := self._problem(commit, expected, contents, checkpoints)):
                # The run may have advanced since the record was read.
                again = self.commits().get(number)
                if again == commit:
                    raise RunDataError(problem)
                commit = again
        finished = sum(commit.finished for commit in commits.values()) == extent.shards
        if contents and finished and (problem := self._unknown_file(made, commits)):
            raise RunDataError(problem)

    def _unknown_file(self, made: Files, commits: Mapping[int, Commit]) -> str | None:
        """Returns the problem if a file is in no record. Chunks that are in no record are ignored by readers."""
        recorded = {*made, *(name for commit in commits.values() for name in commit.files)}
        unmatched = [self.folder / DATA]
        while unmatched:
            folder = unmatched.pop()
            for path in map(folder.__truediv__, folder.names()):
                name = "/".join(path.parts[1:])
                # Other folders can be nested to any depth, and are not searched.
                if is_chunk_folder(name) and path.is_real_folder():
                    unmatched.append(path)
                # Ignore hidden files, such as those of file managers.
                elif name not in recorded and not is_chunk(name) and not path.name.startswith("."):
                    return f"{path}: is not of this run; remove it"
        return None

    def _problem(self, commit: Commit, expected: ExpectedFiles, contents: bool, checkpoints: bool) -> str | None:
        if (checkpoints or commit.finished) and (problem := expected.problem(commit, entries=contents)):
            return problem
        path = self.folder / CHECKPOINTS / str(commit.checkpoint)
        if checkpoints and commit.checkpoint is not None and not path.is_file():
            return f"{path}: is missing, and was committed; --resume starts its shard again"
        sha = commit.checkpoint_sha256
        if contents and checkpoints and sha is not None and not is_unchanged(path, None, sha):
            return f"{path}: was changed since it was committed; --resume starts its shard again"
        return self._problem_of(commit.files, f"shard_{commit.shard:06d}", contents)

    def _problem_of(self, files: Files, shard: str, contents: bool) -> str | None:
        staged = self.folder / STAGING / shard if shard else None
        if staged is not None and not staged.is_folder():
            staged = None
        for name, (size, sha) in files.items():
            # Committed, but not yet moved.
            if staged is not None and is_unchanged(staged / name, size, sha):
                continue
            path = self.folder / DATA / name
            found = path.file_status()
            if found is None:
                return f"{path}: is missing, and was committed"
            if found.st_size != size:
                return f"{path}: has {found.st_size} bytes, and {size} were committed"
            if contents and not is_unchanged(path, size, sha):
                return f"{path}: was changed since it was committed"
        return None


class Staging:
    """Staging area of a shard: writes chunks in the background, until they are committed.

    A context manager; at its end all writes are completed.

    Args:
        folder: Folder of the run.
        shard: The shard.
        threads: Number of writing threads, at most ``WRITERS``; ``None``: one per core.

    Attributes:
        written: Files written and synced since the last ``clear``.
        empty: Chunks without a file since the last ``clear``, because all their values are the fill value.
    """

    def __init__(self, folder: RunPath, shard: Shard, threads: int | None = None) -> None:
        self._shard = shard
        self._root = folder / STAGING / shard.name
        self.written: Files = {}
        self.empty: set[str] = set()
        self._arrays: dict[str, ChunkEncoder] = {}
        self._store = _empty_store(folder)
        self._executor = ThreadPoolExecutor(1)
        self._writers = ThreadPoolExecutor(min(threads or available_threads(), WRITERS))
        self._pending: Future[None] | None = None

    def __enter__(self) -> "Staging":
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._executor.shutdown()
        self._writers.shutdown()
        failed = None if self._pending is None else self._pending.exception()
        if error is not None and failed is not None:
            error.add_note(f"results could not be written: {failed}")

    def write(self, group: str, values: Mapping[str, NDArray[Any]], first_frame: int = 0) -> None:
        """Starts to write values of the shard, after pending writes are completed.

        Values of environments after the end of the shard are ignored. The arrays must not be changed before ``wait``
        returns or ``write`` is called again.

        Args:
            group: Group of the store.
            values: Values by variable (…, env, …); with frames (time, …), at most those of one chunk.
            first_frame: Number of the first frame, a multiple of the frames per chunk.

        Raises:
            OSError: If a pending write failed.
        """
        self._end()
        self._pending = self._executor.submit(self._write, group, values, first_frame)

    def wait(self) -> None:
        """Waits until all writes are completed and synced to the disk.

        Raises:
            OSError: If a write failed.
        """
        self._end()
        sync_names({(self._root / name).parent for name in self.written}, self._root.parent)

    def _end(self) -> None:
        """Waits for the pending write."""
        pending, self._pending = self._pending, None
        if pending is not None:
            pending.result()

    def _write(self, group: str, values: Mapping[str, NDArray[Any]], first_frame: int) -> None:
        chunks, envs = {}, range(self._shard.first, self._shard.stop)
        for name, data in values.items():
            path = f"{group}/{name}"
            array = self._chunks(path)
            for chunk in array.split(data, envs.start, envs.stop, first_frame):
                chunks[f"{path}/{chunk.name}"] = chunk
            frames = range(first_frame, first_frame + array.frames_of(data))
            self.empty |= {f"{path}/{one}" for one in array.grid.names(envs, frames)} - chunks.keys()
        for folder in {(self._root / name).parent for name in chunks}:
            folder.make()
        written = dict(self._writers.map(self._put, chunks.items()))
        sync_all(self._root / name for name in written)
        self.written |= written

    def _put(self, item: tuple[str, Chunk]) -> tuple[str, tuple[int, str]]:
        """Writes a chunk; returns its name, and the size and SHA-256 of its file."""
        name, chunk = item
        return name, chunk.write(self._root / name)

    def _chunks(self, path: str) -> ChunkEncoder:
        """Returns the encoder of the chunks of a variable."""
        import zarr

        if path not in self._arrays:
            self._arrays[path] = ChunkEncoder(zarr.open_array(self._store, path=path, mode="r", zarr_format=3))
        return self._arrays[path]

    def clear(self) -> None:
        """Clears the lists of written and empty chunks after a commit."""
        self.written, self.empty = {}, set()

    def remove(self) -> None:
        """Removes the staging folder."""
        self._root.remove()
