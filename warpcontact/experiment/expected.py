"""Determines which files the results of a run must have, from the array metadata and the committed frames.

A chunk whose values are all the fill value has no file; the record of its shard lists it as empty. A chunk that is
in neither list was lost. Records of earlier versions do not list empty chunks, and are only checked for unknown files.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from warpcontact.experiment.records import (
    AXES,
    COMMITS,
    DATA,
    GROUPS,
    MADE,
    Commit,
    Files,
    RunDataError,
    is_unchanged,
)
from warpcontact.files.run_folder import RunPath

#: Attribute of the store: names of its groups.
PARTS = "groups"
#: Attributes of a group: its variables in order, and the arrays that label its axes.
ORDER = "variables"
LABELS = "labels"

_META = "zarr.json"
# Groups that are written when a shard ends.
_WRITTEN_AT_END = ("outcome", "events")
# Larger sizes are not supported for device arrays.
_MOST = 2**31 - 1


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
        stored_groups = self._attributes("", self._read("")).get(PARTS)
        if stored_groups is not None and not (
            isinstance(stored_groups, list) and all(group in GROUPS for group in stored_groups)
        ):
            raise RunDataError(f"{self._data / _META}: {PARTS} must be a list of {', '.join(GROUPS)}")
        self.complete = stored_groups is not None
        recorded = [group for group in GROUPS if f"{group}/{_META}" in made]
        for group in recorded if stored_groups is None else stored_groups:
            attributes = self._attributes(group, self._read(group))
            self._variables[group] = {
                name: self._grid(group, name) for name in self._names(group, attributes, ORDER)
            }
            expected.add(f"{group}/{_META}")
            expected |= {f"{group}/{name}/{_META}" for name in self._variables[group]}
            if LABELS in attributes:
                for name in self._names(group, attributes, LABELS):
                    expected |= {f"{group}/{name}/{_META}", *self._label(group, name)}
        if self.complete and (more := sorted(made.keys() - expected)):
            raise RunDataError(f"{self._record / MADE}: files must be those of the store, got {more[0]!r}")

    def _read(self, array: str) -> dict[str, Any]:
        """Returns the metadata of an array or group; ``""``: that of the store."""
        name = f"{array}/{_META}".lstrip("/")
        if name not in self._made:
            raise RunDataError(f"{self._data}/{name}: is missing in {self._record / MADE}")
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
                f"whole numbers up to {_MOST}"
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
                raise RunDataError(f"{self._data}/{full}: is missing in {self._record / MADE}")
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
    """Whether all sizes are integers from ``least`` to ``_MOST``."""
    return all(isinstance(n, int) and not isinstance(n, bool) and least <= n <= _MOST for n in sizes)


def _is_among(chunk_ranges: Mapping[str, Sequence[range]], name: str) -> bool:
    """Whether a chunk lies within the index ranges of its array."""
    path, _, position = name.partition("/c/")
    axes, found = chunk_ranges.get(path), position.split("/")
    if axes is None or len(found) != len(axes):
        return False
    return all(str(int(k)) == k and int(k) in selected for k, selected in zip(found, axes, strict=True))
