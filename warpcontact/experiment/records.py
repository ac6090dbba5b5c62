"""Records of commits, read without trusting their content, and the files that the results of a run must have.

``commit/store.json`` names the files of the empty store, ``commit/<shard>.json`` those of a shard, with sizes and
SHA-256. Names are restricted to paths inside of the store.

The expected files follow from the array metadata and the committed frames. A chunk whose values are all the fill value
has no file; the record of its shard lists it as empty. A chunk that is in neither list was lost. Records of earlier
versions do not list empty chunks, and are only checked for unknown files.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from warpcontact.experiment.errors import abbreviated
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import RunPath
from warpcontact.validation.safe_text import SafeTextError

DATA = "data.zarr"
COMMITS = "commit"
STAGING = "staging"
#: File in ``COMMITS`` that lists the files of the empty store.
STORE_RECORD = "store.json"

#: Groups of the store: parameters, outcomes, sensors over time, and events.
GROUPS = ("params", "outcome", "series", "events")

#: Largest number of axes of an array.
AXES = 8

#: Size [bytes] and SHA-256 of files of the store, by their path.
Files = dict[str, tuple[int, str]]

_RECORD = re.compile(r"shard_(?:\d{6}|[1-9]\d{6,})\.json")
# Names of files of the store in records: no path outside of the store matches.
_VARIABLE = rf"(?:{'|'.join(GROUPS)})/(?!\.\.?/)[^/\\\0]+"
_INDEX = r"(?:/[0-9]{1,10})"
_CHUNK = re.compile(rf"{_VARIABLE}/c{_INDEX}{{1,{AXES}}}")
_CHUNK_FOLDER = re.compile(rf"(?:{'|'.join(GROUPS)})|{_VARIABLE}(?:/c{_INDEX}{{0,{AXES - 1}}})?")
_STORE_FILE = re.compile(rf"(?:(?:{'|'.join(GROUPS)}|{_VARIABLE})/)?zarr\.json|{_VARIABLE}/c{_INDEX}{{0,{AXES}}}")
_SHA = re.compile(r"[0-9a-f]{64}")
# Upper bound on counts: the largest 64-bit integer.
_MAX_COUNT = 2**63 - 1
_COUNTS = ("steps", "frames", "frozen")

#: Attribute of the store: names of its groups.
GROUPS_ATTRIBUTE = "groups"
#: Attributes of a group: its variables in order, and the arrays that label its axes.
VARIABLES_ATTRIBUTE = "variables"
LABELS_ATTRIBUTE = "labels"

_META = "zarr.json"
# Groups that are written when a shard ends.
_WRITTEN_AT_END = ("outcome", "events")
# Larger sizes are not supported for device arrays.
_MAX_SIZE = 2**31 - 1


class RunDataError(SafeTextError):
    """The results of a run are damaged or were changed."""


@dataclass
class Commit:
    """Commit of a shard: its progress and files.

    Attributes:
        shard: Number of the shard.
        steps: Number of committed steps.
        frames: Number of committed frames of the series.
        finished: Whether all steps and frames, and the outcomes, are committed.
        checkpoint: Name of the checkpoint from which the shard resumes; ``None``: the shard is finished.
        wall_time: Wall time of stepping over all attempts [s].
        files: Size [bytes] and SHA-256 of each file of the shard in the store, by path.
        frozen: Number of frozen environments.
        checkpoint_sha256: SHA-256 of the checkpoint; ``None``: the shard is finished, or the record is of an earlier
            version.
        empty: Chunks without a file, because all their values are the fill value; ``None``: the record is of an
            earlier version.
    """

    shard: int
    steps: int = 0
    frames: int = 0
    finished: bool = False
    checkpoint: str | None = None
    wall_time: float = 0.0
    files: Files = field(default_factory=dict)
    frozen: int = 0
    checkpoint_sha256: str | None = None
    empty: list[str] | None = field(default_factory=list)

    @classmethod
    def read(cls, path: RunPath) -> "Commit":
        """Reads a record.

        Raises:
            RunDataError: If it is truncated or invalid; the message names the entry, its value and the condition.
        """
        entries = [one.name for one in fields(cls)]
        content = _content(path, entries, {"checkpoint_sha256": None, "empty": None})
        number = int(path.stem.rpartition("_")[2])
        finished = content["finished"] is True
        checkpoint, time, sha = content["checkpoint"], content["wall_time"], content["checkpoint_sha256"]
        can_resume = isinstance(checkpoint, str) and re.fullmatch(rf"{path.stem}-\d{{12,}}\.npz", checkpoint)
        is_time = isinstance(time, int | float) and not isinstance(time, bool) and 0.0 <= time < float("inf")
        rules = {
            "shard": (_is_count(content["shard"]) and content["shard"] == number, f"{number}, as in its name"),
            **{key: (_is_count(content[key]), f"a whole number from 0 to {_MAX_COUNT}") for key in _COUNTS},
            "finished": (isinstance(content["finished"], bool), "true or false"),
            "checkpoint": (
                checkpoint is None if finished else bool(can_resume),
                "null in a finished shard" if finished else f"the name of a file {path.stem}-<steps>.npz",
            ),
            "wall_time": (is_time, "a time of at least 0 s"),
            "checkpoint_sha256": (
                sha is None or (not finished and isinstance(sha, str) and bool(_SHA.fullmatch(sha))),
                "null in a finished shard" if finished else "null, or a SHA-256 in 64 hexadecimal digits",
            ),
        }
        empty = content["empty"]
        rules["empty"] = (
            empty is None
            or (isinstance(empty, list) and all(isinstance(one, str) and _CHUNK.fullmatch(one) for one in empty)),
            f"a list of chunks that a run writes into {DATA}",
        )
        for key, (holds, allowed) in rules.items():
            if not holds:
                raise RunDataError(f"{path}: {key} must be {allowed}, got {abbreviated(content[key])}")
        return cls(**content | {"files": _files(path, content["files"], _CHUNK)})


def commits_in(folder: RunPath) -> dict[int, Commit]:
    """Returns the commits of shards in a folder, by shard number.

    Raises:
            RunDataError: If a record is damaged.
    """
    paths = (folder / name for name in folder.names() if _RECORD.fullmatch(name))
    return {commit.shard: commit for commit in map(Commit.read, paths)}


def is_chunk(name: str) -> bool:
    """Whether a path of the store is that of a chunk."""
    return bool(_CHUNK.fullmatch(name))


def is_chunk_folder(name: str) -> bool:
    """Whether a path of the store is that of a folder that may contain chunks, directly or in subfolders."""
    return bool(_CHUNK_FOLDER.fullmatch(name))


def created_files(folder: RunPath) -> Files:
    """Returns the files of the empty store, from their record in a folder.

    Raises:
        RunDataError: If the record is missing or damaged.
    """
    path = folder / STORE_RECORD
    return _files(path, _content(path, ["files"])["files"], _STORE_FILE)


def digest(path: RunPath) -> str:
    """Returns the SHA-256 of a file."""
    with path.open_binary() as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_unchanged(path: RunPath, size: int | None, sha: str) -> bool:
    """Whether a file exists with this SHA-256; ``size`` allows a faster negative answer, ``None``: unknown."""
    try:
        return size in (None, path.size()) and digest(path) == sha
    except FileNotFoundError:
        return False


def _content(path: RunPath, entries: Iterable[str], later: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Returns the entries of a record; ``later`` has defaults of entries that earlier versions do not write."""
    try:
        content = json.loads(path.read())
    except FileNotFoundError:
        raise RunDataError(f"{path}: is missing; it lists the committed files") from None
    except UnsafeFileError as error:
        raise RunDataError(str(error)) from None
    except (OSError, ValueError, RecursionError) as error:
        raise RunDataError(f"{path}: is not a complete record of a commit: {error}") from None
    if isinstance(content, dict):
        content = {**(later or {}), **content}
    if not isinstance(content, dict) or set(content) != set(entries):
        got = sorted(content) if isinstance(content, dict) else content
        raise RunDataError(f"{path}: must have the entries {', '.join(entries)}, got {abbreviated(got)}")
    return content


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= _MAX_COUNT


def _files(path: RunPath, files: object, allowed: re.Pattern[str]) -> Files:
    if not isinstance(files, dict):
        raise RunDataError(f"{path}: files must be a table, got {abbreviated(files)}")
    found: Files = {}
    for name, entry in files.items():
        if not allowed.fullmatch(name):
            raise RunDataError(
                f"{path}: files must name files that a run writes into {DATA}, got {abbreviated(name)}"
            )
        match entry:
            case [int(size), str(sha)] if _is_count(size) and _SHA.fullmatch(sha):
                found[name] = (size, sha)
            case _:
                raise RunDataError(
                    f"{path}: files.{name} must be a size in bytes and a SHA-256 in 64 hexadecimal digits, "
                    f"got {abbreviated(entry)}"
                )
    return found


@dataclass(frozen=True)
class ChunkGrid:
    """Division of an array into chunks.

    Attributes:
        dims: Names of the axes.
        shape: Size of the array along each axis.
        chunks: Size of a chunk along each axis.
    """

    dims: tuple[str | None, ...]
    shape: tuple[int, ...]
    chunks: tuple[int, ...]

    def chunk_ranges(self, envs: range | None = None, frames: range | None = None) -> list[range]:
        """Returns the chunk indices along each axis, for ranges of environments and frames; ``None``: all."""
        selected = {"env": envs, "time": frames}
        chunk_ranges = []
        for dim, size, chunk in zip(self.dims, self.shape, self.chunks, strict=True):
            part = selected.get(str(dim))
            part = range(size) if part is None else part
            empty = part.start >= part.stop
            chunk_ranges.append(range(0) if empty else range(part.start // chunk, -(-part.stop // chunk)))
        return chunk_ranges

    def names(self, envs: range | None = None, frames: range | None = None) -> Iterator[str]:
        """Iterates over the names of the same chunks."""
        for position in _product(self.chunk_ranges(envs, frames)):
            yield "/".join(("c", *map(str, position)))


def _product(ranges: Sequence[range]) -> Iterator[tuple[int, ...]]:
    # Without itertools.product, which stores all numbers of each range.
    if not all(ranges):
        return  # also with an empty range after a long one
    if not ranges:
        yield ()
        return
    for first in ranges[0]:
        for rest in _product(ranges[1:]):
            yield (first, *rest)


@dataclass(frozen=True)
class RunExtent:
    """Size of a run, as stated in ``run.json``.

    Attributes:
        envs: Number of environments.
        shard: Environments per shard.
        steps: Steps of each environment.
    """

    envs: int
    shard: int
    steps: int

    @classmethod
    def of(cls, summary: Mapping[str, Any]) -> "RunExtent":
        """Returns that of a checked ``run.json``."""
        return cls(summary["envs"], summary["shard"], summary["steps"])

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.envs // self.shard)

    def envs_of(self, number: int) -> range:
        """Returns the environments of a shard."""
        return range(number * self.shard, min((number + 1) * self.shard, self.envs))


class ExpectedFiles:
    """Arrays of a store, from its metadata, and the chunks that must be recorded.

    Args:
        folder: Folder of the run.
        made: Recorded files of the empty store.
        extent: Size of the run, from ``run.json``.

    Attributes:
        complete: Whether records list empty chunks; those of earlier versions do not.

    Raises:
        RunDataError: If metadata is missing, was changed, or contradicts ``run.json``; the message names the array.
    """

    def __init__(self, folder: RunPath, made: Files, extent: RunExtent) -> None:
        self._data, self._record = folder / DATA, folder / COMMITS
        self._made, self._extent = made, extent
        self._variables: dict[str, dict[str, ChunkGrid]] = {}
        expected = {_META}
        stored_groups = self._attributes("", self._read("")).get(GROUPS_ATTRIBUTE)
        if stored_groups is not None and not (
            isinstance(stored_groups, list) and all(group in GROUPS for group in stored_groups)
        ):
            raise RunDataError(f"{self._data / _META}: {GROUPS_ATTRIBUTE} must be a list of {', '.join(GROUPS)}")
        self.complete = stored_groups is not None
        recorded = [group for group in GROUPS if f"{group}/{_META}" in made]
        for group in recorded if stored_groups is None else stored_groups:
            attributes = self._attributes(group, self._read(group))
            self._variables[group] = {
                name: self._grid(group, name) for name in self._names(group, attributes, VARIABLES_ATTRIBUTE)
            }
            expected.add(f"{group}/{_META}")
            expected |= {f"{group}/{name}/{_META}" for name in self._variables[group]}
            if LABELS_ATTRIBUTE in attributes:
                for name in self._names(group, attributes, LABELS_ATTRIBUTE):
                    expected |= {f"{group}/{name}/{_META}", *self._label(group, name)}
        if self.complete and (more := sorted(made.keys() - expected)):
            raise RunDataError(f"{self._record / STORE_RECORD}: files must be those of the store, got {more[0]!r}")

    def _read(self, array: str) -> dict[str, Any]:
        """Returns the metadata of an array or group; ``""``: that of the store."""
        name = f"{array}/{_META}".lstrip("/")
        if name not in self._made:
            raise RunDataError(f"{self._data}/{name}: is missing in {self._record / STORE_RECORD}")
        path = self._data / name
        if not is_unchanged(path, *self._made[name]):
            what = "was changed since it" if path.is_file() else "is missing, and"
            raise RunDataError(f"{path}: {what} was committed")
        try:
            content = json.loads(path.read())
        except (OSError, ValueError, RecursionError) as error:
            raise RunDataError(f"{path}: cannot be read: {error}") from None
        if not isinstance(content, dict):
            raise RunDataError(f"{path}: must be a table")
        return content

    def _attributes(self, array: str, content: Mapping[str, Any]) -> dict[str, Any]:
        attributes = content.get("attributes")
        if not isinstance(attributes, dict):
            raise RunDataError(f"{self._data}/{array}/{_META}: attributes must be a table")
        return attributes

    def _names(self, group: str, attributes: Mapping[str, Any], key: str) -> list[str]:
        names = attributes.get(key)
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise RunDataError(f"{self._data}/{group}/{_META}: {key} must be a list of names")
        return names

    def _grid(self, group: str, name: str) -> ChunkGrid:
        """Returns the division of an array into chunks."""
        content = self._read(f"{group}/{name}")
        path = self._data / group / name
        try:
            shape = tuple(content["shape"])
            chunks = tuple(content["chunk_grid"]["configuration"]["chunk_shape"])
            dims = tuple(content["dimension_names"])
            sizes = _are_whole(shape, 0) and _are_whole(chunks, 1)
            if not sizes or not len(shape) == len(chunks) == len(dims) == len(set(dims)) <= AXES:
                raise ValueError
        except (KeyError, TypeError, ValueError):
            raise RunDataError(
                f"{path / _META}: must have a shape of at most {AXES} axes, and chunks of a regular grid, in "
                f"whole numbers up to {_MAX_SIZE}"
            ) from None
        grid = ChunkGrid(dims, shape, chunks)
        axes = dict(zip(dims, zip(shape, chunks, strict=True), strict=True))
        if "env" in axes and axes["env"][0] != self._extent.envs:
            raise RunDataError(
                f"{path}: must have {self._extent.envs} environments, as in run.json, got {axes['env'][0]}"
            )
        if "time" in axes and axes["time"][0] > self._extent.steps + 1:
            raise RunDataError(
                f"{path}: must have at most {self._extent.steps + 1} frames, as run.json has {self._extent.steps} "
                f"steps, got {axes['time'][0]}"
            )
        return grid

    def _label(self, group: str, name: str) -> list[str]:
        """Returns the chunks of an array that labels an axis."""
        grid, found = self._grid(group, name), []
        for chunk in grid.names():
            full = f"{group}/{name}/{chunk}"
            if full not in self._made:
                raise RunDataError(f"{self._data}/{full}: is missing in {self._record / STORE_RECORD}")
            found.append(full)
        return found

    def problem(self, commit: Commit, *, entries: bool = True) -> str | None:
        """Returns the problem with the record of a shard; ``None``: it is valid.

        Args:
            commit: The record.
            entries: Whether to reject unknown entries as well.
        """
        extent, record = self._extent, self._record / f"shard_{commit.shard:06d}.json"
        if commit.shard >= extent.shards:
            return f"{record}: shard must be below {extent.shards}, as in run.json, got {commit.shard}"
        if commit.empty is None and self.complete:
            return f"{record}: empty is missing"
        frames = self._frames if commit.finished else min(commit.frames, self._frames)
        envs, grids = extent.envs_of(commit.shard), self._grids(finished=commit.finished)
        named = {*commit.files, *(commit.empty or ())}
        if entries and (problem := self._unknown_entry(commit, named, grids, range(frames))):
            return f"{record}: {problem}"
        if commit.empty is None or not commit.steps:  # without committed steps the shard starts again
            return None
        expected = (f"{path}/{name}" for path, grid in grids.items() for name in grid.names(envs, range(frames)))
        # Stops at the first missing chunk. The number of tests is bounded by that of recorded chunks, for any shape.
        missing = next((name for name in expected if name not in named), None)
        return missing and f"{self._data / missing}: is missing, and so is its entry in {record}"

    def _unknown_entry(
        self, commit: Commit, named: set[str], grids: Mapping[str, ChunkGrid], frames: range
    ) -> str | None:
        """Returns the problem with entries that no run writes after the committed steps; ``None``: none."""
        for key, found, end in (
            ("steps", commit.steps, self._extent.steps),
            ("frames", commit.frames, self._frames),
        ):
            if (commit.finished and found != end) or found > end:
                return f"{key} must be {end if commit.finished else f'at most {end}'}, got {found}"
        if len(named) < len(commit.files) + len(commit.empty or ()):
            return "empty must name chunks that are not in files, each once"
        envs = self._extent.envs_of(commit.shard)
        chunk_ranges = {path: grid.chunk_ranges(envs, frames) for path, grid in grids.items()}
        if more := next((name for name in named if not _is_among(chunk_ranges, name)), None):
            return f"files must be those of this shard after {commit.steps} steps, got {more!r}"
        return None

    @property
    def _frames(self) -> int:
        """Number of frames of the run."""
        grids = self._variables.get("series", {}).values()
        return max((dict(zip(grid.dims, grid.shape, strict=True)).get("time", 0) for grid in grids), default=0)

    def _grids(self, *, finished: bool) -> dict[str, ChunkGrid]:
        """Returns the arrays in which a shard must have chunks, by path; those of all groups if it is finished."""
        return {
            f"{group}/{name}": grid
            for group, variables in self._variables.items()
            if finished or group not in _WRITTEN_AT_END
            for name, grid in variables.items()
        }


def _are_whole(sizes: Sequence[object], least: int) -> bool:
    """Whether all sizes are integers from ``least`` to ``_MAX_SIZE``."""
    return all(isinstance(n, int) and not isinstance(n, bool) and least <= n <= _MAX_SIZE for n in sizes)


def _is_among(chunk_ranges: Mapping[str, Sequence[range]], name: str) -> bool:
    """Whether a chunk lies within the index ranges of its array."""
    path, _, position = name.partition("/c/")
    axes, found = chunk_ranges.get(path), position.split("/")
    if axes is None or len(found) != len(axes):
        return False
    return all(str(int(k)) == k and int(k) in selected for k, selected in zip(found, axes, strict=True))
