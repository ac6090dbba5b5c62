"""The results of a run as Zarr groups that are filled shard by shard, and what of them counts.

    data.zarr/params, outcome, series, events    what readers see
    staging/<shard>/…                            chunks that are written and not committed
    checkpoint/<shard>-<steps>.npz               the state from which an unfinished shard goes on
    commit/<shard>.json                          what is committed of a shard: nothing else counts

The arrays are made with their final shape before anything runs, and filled with NaN, or -1. A shard writes whole
chunks, that no other shard writes, into its staging folder. A commit brings these to the disk, then a checkpoint,
then the record that names them; only then are they moved to where readers look, which needs no space. Whatever
ends a run at any moment leaves the last commit: ``Ledger.recover`` ends a move that was begun and drops what no
record names. The bytes of all chunks follow from the experiment alone.
"""

import hashlib
import json
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from warpcontact.durable import PARTIAL, sync, sync_folder, write_json

DATA = "data.zarr"
STAGING = "staging"
CHECKPOINTS = "checkpoint"
COMMITS = "commit"

#: The groups, of parameters, outcomes, readings over time, and events.
GROUPS = ("params", "outcome", "series", "events")

#: Attribute of a group: its variables, in their order.
ORDER = "variables"

# Arrays are stored in pieces of about this size [bytes].
CHUNK = 16 * 2**20


class StoreError(ValueError):
    """A folder of results that is damaged, or was changed by somebody else."""


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


def shards_of(envs: int, size: int) -> list[Shard]:
    """Returns the shards of ``size`` environments that make up ``envs``; the last may be smaller."""
    return [Shard(k, first, min(first + size, envs)) for k, first in enumerate(range(0, envs, size))]


@dataclass
class Commit:
    """What is committed of a shard.

    Attributes:
        shard: Number of the shard.
        steps: How many steps were taken.
        frames: How many frames of the series are in the store.
        finished: Whether these are all, and the outcome is there.
        checkpoint: Name of the file from which the shard goes on; ``None``: it is finished.
        wall_time: How long it was stepped, over all attempts [s].
        files: Size and SHA-256 of each file of the store that belongs to it, by its path.
        frozen: How many of its environments are frozen.
    """

    shard: int
    steps: int = 0
    frames: int = 0
    finished: bool = False
    checkpoint: str | None = None
    wall_time: float = 0.0
    files: dict[str, tuple[int, str]] = field(default_factory=dict)
    frozen: int = 0


def create(
    path: Path,
    templates: Mapping[str, xr.Dataset],
    envs: int,
    times: NDArray[np.float64],
    block: int,
    attributes: Mapping[str, Any],
) -> None:
    """Makes a store with empty arrays of their final shape; it is there as a whole or not at all.

    Args:
        path: The store.
        templates: A data set of a shard for each group: variables, axes, labels, attributes.
        envs: Number of environments of the whole.
        times: Times of all frames [s].
        block: Frames of a chunk.
        attributes: What is said of each group.
    """
    import zarr

    partial = path.with_name(path.name + PARTIAL)
    if partial.exists():
        shutil.rmtree(partial)
    zarr.open_group(partial, mode="w-", zarr_format=3, attributes=dict(attributes))
    for name, template in templates.items():
        sizes = {**template.sizes, "env": envs}
        coordinates = {key: c for key, c in template.coords.items() if key not in ("env", "time")}
        coordinates["env"] = ("env", np.arange(envs), template["env"].attrs)
        if "time" in template.sizes:
            sizes["time"] = len(times)
            coordinates["time"] = ("time", times, template["time"].attrs)
        # Folders have no order of their own.
        order = {ORDER: list(map(str, template.data_vars))}
        labels = xr.Dataset(coords=coordinates, attrs={**attributes, **template.attrs, **order})
        labels.to_zarr(partial, group=name, mode="w-", zarr_format=3, consolidated=False)
        group = zarr.open_group(partial, mode="r+", path=name)
        for key, variable in template.data_vars.items():
            _create_array(group, str(key), variable, sizes, template.sizes["env"], block)
    sync(one for one in partial.rglob("*") if one.is_file())
    for folder in (partial, *(one for one in partial.rglob("*") if one.is_dir())):
        sync_folder(folder)
    partial.rename(path)
    sync_folder(path.parent)


def _create_array(
    group: Any, name: str, template: xr.DataArray, sizes: Mapping[Any, int], shard: int, block: int
) -> None:
    from zarr.codecs import ZstdCodec

    tail = [size for dim, size in template.sizes.items() if dim not in ("time", "env")]
    row = template.dtype.itemsize * int(np.prod(tail, initial=1)) * (block if "time" in template.sizes else 1)
    chunk = {"env": largest_part(shard, max(1, CHUNK // max(1, row))), "time": block}
    group.create_array(
        name,
        shape=tuple(sizes[dim] for dim in template.dims),
        chunks=tuple(max(1, chunk.get(str(dim), sizes[dim])) for dim in template.dims),
        dtype=template.dtype,
        fill_value=empty_value(template.dtype),
        dimension_names=[str(dim) for dim in template.dims],
        attributes=dict(template.attrs),
        # With a check sum: a chunk that was changed is no chunk.
        compressors=ZstdCodec(level=1, checksum=True),
    )


def empty_value(dtype: np.dtype[Any]) -> Any:
    """Returns what stands for a value that is not there."""
    return {"f": np.nan, "i": -1, "b": False}.get(dtype.kind, 0)


def largest_part(envs: int, most: int) -> int:
    """Returns the largest divisor of ``envs`` that is at most ``most``."""
    return next(part for part in range(min(most, envs), 0, -1) if envs % part == 0)


class Ledger:
    """What of the results of a run in a folder counts.

    Args:
        folder: Folder of the run.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def commits(self) -> dict[int, Commit]:
        """Returns the record of each shard that has one.

        Raises:
            StoreError: If one of them is damaged.
        """
        found = {}
        for path in sorted((self.folder / COMMITS).glob("shard_*.json")):
            try:
                commit = Commit(**json.loads(path.read_bytes()))
                commit.files = {name: (int(size), str(sha)) for name, (size, sha) in commit.files.items()}
                found[int(commit.shard)] = commit
            except (OSError, ValueError, TypeError) as error:
                raise StoreError(f"{path}: is no whole record of a commit: {error}") from None
        return found

    def staging(self, shard: Shard) -> "Staging":
        """Returns where ``shard`` writes."""
        return Staging(self.folder, shard)

    def commit(self, shard: Shard, commit: Commit, staged: Iterable[str]) -> None:
        """Makes what was staged, and the checkpoint that is written already, count.

        Args:
            shard: The shard.
            commit: Its new record, without the staged files.
            staged: Paths of these.
        """
        root = self.folder / STAGING / shard.name
        staged = sorted(staged)
        sync(root / name for name in staged)
        for name in staged:
            content = (root / name).read_bytes()
            commit.files[name] = (len(content), hashlib.sha256(content).hexdigest())
        write_json(self.folder / COMMITS / f"{shard.name}.json", asdict(commit))
        self._publish(shard, staged)
        for path in (self.folder / CHECKPOINTS).glob(f"{shard.name}-*"):
            if path.name != commit.checkpoint:
                path.unlink()

    def recover(self, shard: Shard, commit: Commit) -> None:
        """Ends what a commit began, and drops what was staged since."""
        root = self.folder / STAGING / shard.name
        self._publish(shard, [name for name in commit.files if (root / name).is_file()])
        if root.exists():
            shutil.rmtree(root)
        for path in (self.folder / CHECKPOINTS).glob(f"{shard.name}-*"):
            if path.name != commit.checkpoint:
                path.unlink()

    def _publish(self, shard: Shard, names: Iterable[str]) -> None:
        root, target = self.folder / STAGING / shard.name, self.folder / DATA
        folders = set()
        for name in names:
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).replace(target / name)
            folders.add((target / name).parent)
        for folder in sorted(folders):
            sync_folder(folder)

    def check(self, *, contents: bool = False) -> None:
        """Checks that every file that was committed is there, with its size, and if asked with its content.

        Raises:
            StoreError: If one is not; names it.
        """
        for commit in self.commits().values():
            if commit.checkpoint is not None and not (self.folder / CHECKPOINTS / commit.checkpoint).is_file():
                raise StoreError(f"{self.folder / CHECKPOINTS / commit.checkpoint}: is missing")
            for name, (size, sha) in commit.files.items():
                path = self.folder / DATA / name
                staged = self.folder / STAGING / f"shard_{commit.shard:06d}" / name
                if staged.is_file():
                    path = staged  # committed, and not moved yet
                if not path.is_file():
                    raise StoreError(f"{path}: is missing, and was committed")
                if path.stat().st_size != size:
                    raise StoreError(f"{path}: has {path.stat().st_size} bytes, and {size} were committed")
                if contents and hashlib.sha256(path.read_bytes()).hexdigest() != sha:
                    raise StoreError(f"{path}: was changed since it was committed")


class Staging:
    """Where a shard writes chunks until they are committed.

    Args:
        folder: Folder of the run.
        shard: The shard.
    """

    def __init__(self, folder: Path, shard: Shard) -> None:
        self._shard = shard
        self._root = folder / STAGING / shard.name
        self._store = folder / DATA
        self.written: set[str] = set()

    def write(self, group: str, data: xr.Dataset, first_frame: int = 0) -> None:
        """Writes the values of a data set of the shard; those of further environments are left out.

        Args:
            group: Where they belong.
            data: Variables (…, env, …), with frames (time, …) from a multiple of those of a chunk on.
            first_frame: Number of the first frame.
        """
        import zarr

        for name, variable in data.data_vars.items():
            path = f"{group}/{name}"
            target = self._root / path
            if not (target / "zarr.json").exists():
                target.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(self._store / path / "zarr.json", target / "zarr.json")
            own = variable.isel(env=slice(0, self._shard.envs))
            place = {
                "env": slice(self._shard.first, self._shard.stop),
                "time": slice(first_frame, first_frame + own.sizes.get("time", 0)),
            }
            region = tuple(place.get(str(dim), slice(None)) for dim in own.dims)
            zarr.open_array(target, mode="r+", zarr_format=3)[region] = np.ascontiguousarray(own.values)
            self.written |= {
                one.relative_to(self._root).as_posix() for one in (target / "c").rglob("*") if one.is_file()
            }

    def clear(self) -> None:
        """Forgets what was committed; what steps write next goes into new files."""
        self.written = set()

    def remove(self) -> None:
        """Removes the folder."""
        if self._root.exists():
            shutil.rmtree(self._root)
