"""The results of a run as Zarr groups that are filled shard by shard, and what of them counts.

    data.zarr/params, outcome, series, events    what readers see
    staging/<shard>/…                            chunks that are written and not committed
    checkpoint/<shard>-<steps>.npz               the state from which an unfinished shard goes on
    commit/store.json                            what was there before the first shard: the empty arrays
    commit/<shard>.json                          what is committed of a shard: nothing else counts

The arrays are made with their final shape before anything runs, and filled with NaN, or -1. A shard writes whole
chunks, that no other shard writes, into its staging folder. A commit brings these to the disk, then a checkpoint,
then the record that names them; only then are they moved to where readers look, which needs no space. Whatever
ends a run at any moment leaves the last commit: ``Ledger.recover`` ends a move that was begun and drops what no
record names. The bytes of all chunks follow from the experiment alone.

Chunks of series are written, and brought to the disk, while steps go on; a commit waits for them.
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
from warpcontact.experiment.expected import LABELS, ORDER, PARTS, ExpectedFiles, RunExtent
from warpcontact.experiment.records import (
    COMMITS,
    DATA,
    MADE,
    Commit,
    Files,
    RunDataError,
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

STAGING = "staging"
CHECKPOINTS = "checkpoint"

# A piece may be so many times smaller than that for being a part of a shard.
MIN_DIVISOR_RATIO = 8

# Arrays are stored in pieces of about this size [bytes].
CHUNK = 16 * 2**20
# Longest name of a folder on usual file systems [bytes].
MOST_NAME = 255
# Chunks that are copied and compressed at once: each takes its size twice.
WRITERS = 4


@dataclass(frozen=True)
class Shard:
    """Environments that are run and committed together.

    Attributes:
        number: Its number, from 0.
        first: Its first environment.
        stop: The first one behind it.
    """

    number: int
    first: int
    stop: int

    @property
    def name(self) -> str:
        """Its name in folders."""
        return f"shard_{self.number:06d}"

    @property
    def envs(self) -> int:
        """How many environments it has."""
        return self.stop - self.first


@dataclass(frozen=True)
class Shards(Sequence[Shard]):
    """The shards that make up a number of environments, computed from their numbers; the last may be smaller.

    Attributes:
        envs: Number of environments.
        size: Environments of a shard.
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
    """Lets Zarr make no more threads than write at once, if it makes them now and nobody chose their number.

    They stay, and so does the memory that each of them freed, with the allocator: with as many as Zarr makes by
    itself that is more than what is written.
    """
    import zarr

    key = "threading.max_workers"
    if zarr.config.get(key, None) is not None:
        yield
        return
    with zarr.config.set({key: min(available_threads(), WRITERS)}):
        yield


@_few_threads()
def _created_files(folder: RunPath) -> "CommittedStore":
    """Returns the store of a run as it was made.

    Lets Zarr make its threads, by the thread of the caller: its settings are those of the process.
    """
    import zarr

    from warpcontact.experiment.committed import CommittedStore

    store = CommittedStore(folder, commits={})
    zarr.open_group(store, mode="r")
    return store


def check_names(data_layouts: Mapping[str, "xr.Dataset"], source: str) -> None:
    """Raises ``ExperimentError`` of ``source`` if a variable has too long a name for its folder in the store."""
    for group, layout in data_layouts.items():
        for name in layout.data_vars:
            try:
                check_length(f"the name of a variable of {group}", str(name), MOST_NAME)
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
    """Makes a store with empty arrays of their final shape; it is there as a whole or not at all.

    Args:
        folder: Folder of the run.
        data_layouts: A data set of a shard for each group: variables, axes, labels, attributes.
        envs: Number of environments of the whole.
        times: Times of all frames [s].
        block: Frames of a chunk.
        attributes: What is said of each group.
    """
    import xarray as xr
    import zarr
    from zarr.storage import MemoryStore

    buffers: dict[str, Any] = {}
    made = MemoryStore(buffers)
    zarr.open_group(made, mode="w-", zarr_format=3, attributes={**attributes, PARTS: list(data_layouts)})
    for name, layout in data_layouts.items():
        sizes = {**layout.sizes, "env": envs}
        coordinates = {key: c for key, c in layout.coords.items() if key not in ("env", "time")}
        coordinates["env"] = ("env", np.arange(envs), layout["env"].attrs)
        if "time" in layout.sizes:
            sizes["time"] = len(times)
            coordinates["time"] = ("time", times, layout["time"].attrs)
        # Folders have no order of their own.
        listed = {ORDER: list(map(str, layout.data_vars)), LABELS: sorted(map(str, coordinates))}
        labels = xr.Dataset(coords=coordinates, attrs={**attributes, **layout.attrs, **listed})
        # Zarr leaves out a chunk of zeros, such as that of a single environment.
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
    write_json(run / COMMITS / MADE, {"files": files})
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
    """Returns what stands for a value that is not there."""
    return {"f": np.nan, "i": -1, "b": False}.get(dtype.kind, 0)


def largest_divisor(envs: int, most: int) -> int:
    """Returns the largest divisor of ``envs`` up to ``most``; where all are far smaller, the next larger one."""
    small = [part for part in range(1, math.isqrt(envs) + 1) if envs % part == 0]
    parts = sorted({*small, *(envs // part for part in small)})
    largest = max(part for part in parts if part <= max(1, most))
    # Of a prime number the others are 1 and the whole.
    return (
        largest if largest >= min(envs, most) / MIN_DIVISOR_RATIO else next(part for part in parts if part > most)
    )


class Ledger:
    """What of the results of a run in a folder counts.

    Args:
        folder: Folder of the run.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = RunPath(folder)

    def commits(self) -> dict[int, Commit]:
        """Returns the record of each shard that has one.

        Raises:
            RunDataError: If one of them is damaged.
        """
        return commits_in(self.folder / COMMITS)

    def staging(self, shard: Shard, threads: int | None = None) -> "Staging":
        """Returns where ``shard`` writes, with so many threads; ``None``: with all."""
        return Staging(self.folder, shard, threads)

    def commit(self, shard: Shard, commit: Commit, staged: Files) -> None:
        """Makes what was staged, and the checkpoint that is written already, count.

        Args:
            shard: The shard.
            commit: Its new record, without the staged files.
            staged: These, which are on the disk.
        """
        commit.files |= dict(sorted(staged.items()))
        write_json(self.folder / COMMITS / f"{shard.name}.json", asdict(commit))
        self._publish(shard, staged)
        self._drop_checkpoints(shard, commit)

    def recover(self, shard: Shard, commit: Commit) -> None:
        """Ends what a commit began, and drops what was staged since."""
        root = self.folder / STAGING / shard.name
        # A shard that began anew may have been writing the same chunk again when it was ended.
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
        """Checks that all files that the committed steps of each shard lead to are recorded, and are there.

        Args:
            extent: Environments, shards and steps of the run.
            contents: Whether to compare the contents of files, not only their sizes, and to refuse unknown entries
                of records and, in a finished run, unknown files.
            checkpoints: Whether unfinished shards must be able to continue; otherwise they can start again.

        Raises:
            RunDataError: If a file or its entry is missing, or is not of the run; names it.
        """
        made = created_files(self.folder / COMMITS)
        expected = ExpectedFiles(self.folder, made, extent)
        if problem := self._problem_of(made, "", contents):
            raise RunDataError(problem)
        commits = self.commits()
        for number, found in commits.items():
            commit: Commit | None = found
            while commit is not None and (problem := self._problem(commit, expected, contents, checkpoints)):
                # The run may have gone on since the record was read.
                again = self.commits().get(number)
                if again == commit:
                    raise RunDataError(problem)
                commit = again
        finished = sum(commit.finished for commit in commits.values()) == extent.shards
        if contents and finished and (problem := self._unknown_file(made, commits)):
            raise RunDataError(problem)

    def _unknown_file(self, made: Files, commits: Mapping[int, Commit]) -> str | None:
        """Returns what is wrong if there is a file that no record names; unnamed chunks are never read."""
        recorded = {*made, *(name for commit in commits.values() for name in commit.files)}
        unmatched = [self.folder / DATA]
        while unmatched:
            folder = unmatched.pop()
            for path in map(folder.__truediv__, folder.names()):
                name = "/".join(path.parts[1:])
                # Other folders can be nested to any depth, and are not entered.
                if is_chunk_folder(name) and path.is_real_folder():
                    unmatched.append(path)
                # Hidden files are those of file managers.
                elif name not in recorded and not is_chunk(name) and not path.name.startswith("."):
                    return f"{path}: is not of this run; remove it"
        return None

    def _problem(self, commit: Commit, expected: ExpectedFiles, contents: bool, checkpoints: bool) -> str | None:
        if (checkpoints or commit.finished) and (problem := expected.problem(commit, entries=contents)):
            return problem
        path = self.folder / CHECKPOINTS / str(commit.checkpoint)
        if checkpoints and commit.checkpoint is not None and not path.is_file():
            return f"{path}: is missing, and was committed; --resume lets its shard begin anew"
        sha = commit.checkpoint_sha256
        if contents and checkpoints and sha is not None and not is_unchanged(path, None, sha):
            return f"{path}: was changed since it was committed; --resume lets its shard begin anew"
        return self._problem_of(commit.files, f"shard_{commit.shard:06d}", contents)

    def _problem_of(self, files: Files, shard: str, contents: bool) -> str | None:
        staged = self.folder / STAGING / shard if shard else None
        if staged is not None and not staged.is_folder():
            staged = None
        for name, (size, sha) in files.items():
            # Committed, and not moved yet?
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
    """Where a shard writes chunks, while steps go on, until they are committed.

    A context, at whose end nobody writes any more.

    Args:
        folder: Folder of the run.
        shard: The shard.
        threads: Threads that write at once, of which there are no more than ``WRITERS``; ``None``: those of the
            process.

    Attributes:
        written: The files that are there, with their contents on the disk, since the last ``clear``.
        empty: Chunks without a file since then, as all their values are empty.
    """

    def __init__(self, folder: RunPath, shard: Shard, threads: int | None = None) -> None:
        self._shard = shard
        self._root = folder / STAGING / shard.name
        self.written: Files = {}
        self.empty: set[str] = set()
        self._arrays: dict[str, ChunkEncoder] = {}
        self._store = _created_files(folder)
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
            error.add_note(f"what was to be written meanwhile could not be: {failed}")

    def write(self, group: str, values: Mapping[str, NDArray[Any]], first_frame: int = 0) -> None:
        """Begins to write values of the shard, once all is written that was begun before.

        Those of further environments are left out. The values are read until ``wait`` returns, or more is written.

        Args:
            group: Where they belong.
            values: By variable (…, env, …), with frames (time, …) of one chunk or less.
            first_frame: Number of the first frame, a multiple of those of a chunk.

        Raises:
            OSError: If what was begun before could not be written.
        """
        self._end()
        self._pending = self._executor.submit(self._write, group, values, first_frame)

    def wait(self) -> None:
        """Waits until all is written, and on the disk.

        Raises:
            OSError: If it could not be.
        """
        self._end()
        sync_names({(self._root / name).parent for name in self.written}, self._root.parent)

    def _end(self) -> None:
        """Waits until what was begun is written."""
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
        """Writes a chunk; returns what a record says of its file, by its name."""
        name, chunk = item
        return name, chunk.write(self._root / name)

    def _chunks(self, path: str) -> ChunkEncoder:
        """Returns what cuts a variable into chunks."""
        import zarr

        if path not in self._arrays:
            self._arrays[path] = ChunkEncoder(zarr.open_array(self._store, path=path, mode="r", zarr_format=3))
        return self._arrays[path]

    def clear(self) -> None:
        """Forgets what was committed; what steps write next goes into new files."""
        self.written, self.empty = {}, set()

    def remove(self) -> None:
        """Removes the folder."""
        self._root.remove()
