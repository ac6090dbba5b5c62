"""Access to the results of a run in its folder.

``open_run`` checks the folder and returns a ``Run``. Its data sets are read lazily, from committed files only.
"""

import csv
import functools
import hashlib
import io
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsInt, TextIO

import numpy as np
from numpy.typing import NDArray

from warpcontact.building.scene import Scene
from warpcontact.drawing.reduction import merged_items
from warpcontact.experiment import folder as files_of
from warpcontact.experiment.assemble import FileCache, SceneBuilder
from warpcontact.experiment.errors import ExperimentError, Problems, abbreviated
from warpcontact.experiment.folder import is_locked
from warpcontact.experiment.parser import ExperimentParts, load_toml, read_settings
from warpcontact.experiment.records import (
    COMMITS,
    DATA,
    GROUPS,
    LABELS_ATTRIBUTE,
    VARIABLES_ATTRIBUTE,
    Commit,
    RunDataError,
    RunExtent,
)
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.store import Ledger, Shards
from warpcontact.experiment.user_code import Trust, UserFiles
from warpcontact.files.atomic_files import open_for_writing
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import RunPath
from warpcontact.kernels.catalogue.keywords import explain_keywords, explain_keywords_of
from warpcontact.model.flags import words_of
from warpcontact.model.health import Health
from warpcontact.scene.contact_coupling import CouplingReport, report_of
from warpcontact.storage.memory_estimate import env_count_text
from warpcontact.validation.safe_text import escape_lines

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from warpcontact.experiment.experiment import Experiment
    from warpcontact.stepping.recording import Recording

# Largest part of an array that ``digest`` reads at a time [bytes].
READ_AT_ONCE = 256 * 2**20


@explain_keywords_of
@dataclass(frozen=True)
class Run:
    """The results of a run, finished or not.

    The committed part of unfinished shards is available. Data sets are read from the folder when they are accessed.

    Attributes:
        folder: Folder of the run.
        summary: Content of ``run.json``: schema, versions, device, seed, times, state.
    """

    folder: Path
    summary: dict[str, Any]
    _scene: Scene | None = field(default=None, repr=False, compare=False)
    _trust: Trust = field(default=False, repr=False, compare=False)

    @property
    def _files(self) -> RunPath:
        return RunPath(self.folder)

    @functools.cached_property
    def scene(self) -> Scene:
        """The scene of the run. Law files of the folder are executed to read it; no model is built."""
        if self._scene is not None:
            return self._scene
        problems = Problems()
        scene = SceneBuilder(ExperimentParts.from_settings(self.settings), self.folder, FileCache()).scene(
            problems
        )
        problems.raise_if_any(str(self.folder / files_of.EXPERIMENT))
        return scene

    @functools.cached_property
    def experiment(self) -> "Experiment":
        """The experiment of the run. Building it checks it as before a run: with a model, which compiles kernels."""
        from warpcontact.experiment.experiment import Experiment

        return Experiment.from_toml(self.folder / files_of.EXPERIMENT, trust=self._trust)

    @functools.cached_property
    def settings(self) -> Settings:
        """All settings of the experiment. Law files of the folder are executed to read them; no model is built."""
        path, problems = self.folder / files_of.EXPERIMENT, Problems()
        user_files = UserFiles(self.folder, lambda stage: None, self._trust)
        settings = read_settings(load_toml(path), user_files, problems).settings
        problems.raise_if_any(str(path))
        assert settings is not None  # read_settings returns settings unless it reports problems
        return settings

    @functools.cached_property
    def _commits(self) -> dict[int, Commit]:
        """Commits as of the first access, so that all data sets show the same state of the run."""
        count = len(self.shards)
        return {number: one for number, one in Ledger(self.folder).commits().items() if number < count}

    @property
    def finished(self) -> bool:
        """Whether all shards are finished."""
        return sum(commit.finished for commit in self._commits.values()) == len(self.shards)

    @functools.cached_property
    def params(self) -> "xr.Dataset":
        """Parameters that vary, and those that a replay requires (env, …)."""
        return self._group("params").isel(env=self._begun_data())

    @functools.cached_property
    def outcome(self) -> "xr.Dataset":
        """Outcomes of the finished environments (env, …)."""
        data = self._group("outcome")
        return data if self.finished else data.isel(env=np.flatnonzero(self._mask(finished=True)))

    @functools.cached_property
    def series(self) -> "xr.Dataset":
        """Sensors (time, env, …) of environments that have started; NaN or −1 after the last written block.

        Frames of an unfinished shard are written in blocks; those after the last block are in its checkpoint.

        Records of an unfinished shard are written in blocks; those since the last one are in its checkpoint.

        Raises:
            ValueError: If no series were recorded.
        """
        from warpcontact.stepping.recording import Series

        data = self._group("series").isel(env=self._begun_data())
        return Series(data.data_vars, coords=data.coords, attrs=data.attrs)

    @functools.cached_property
    def events(self) -> "xr.Dataset":
        """Events of the finished environments (env, event).

        Raises:
            ValueError: If no events were recorded.
        """
        return self._group("events").isel(env=np.flatnonzero(self._mask(finished=True)))

    @functools.cached_property
    def recording(self) -> "Recording":
        """Series and parameters as ``Simulation.run`` returns them, for replay and export."""
        from warpcontact.stepping.recording import Recording

        variables: dict[Any, Any] = {}
        for data in (self.series, self.params):
            variables |= {name: array.variable for name, array in data.data_vars.items()}
        coordinates = {**self.params.coords, **self.series.coords}
        copied = ("device", "frozen_environments", "fingerprint")
        attributes = {key: self.summary[key] for key in copied if key in self.summary}
        recording = Recording(variables, coords=coordinates, attrs={**self.series.attrs, **attributes})
        recording.scene = self.scene
        return recording

    def check_series(self) -> None:
        """Raises ``ValueError`` if no frame can be read yet."""
        if any(commit.frames for commit in self._commits.values()):
            return
        if any(commit.steps for commit in self._commits.values()):
            raise ValueError(f"{self.folder}: no frame can be read yet: {self._blocks}; {self._resume_hint}")
        raise ValueError(f"{self.folder}: no frame is committed yet in this run; {self._resume_hint}")

    def records_of(self, envs: Iterable[SupportsInt]) -> int:
        """Returns the number of frames that can be read for all of these environments, at least 1.

        Numbers outside of the run are ignored; the caller reports them.

        Raises:
            ValueError: If one of them has no frame yet; the message states the progress of its shard.
        """
        count = int(self.series.sizes["time"])
        for env in (one for one in map(int, envs) if 0 <= one < self.summary["envs"]):
            commit = self._commits.get(env // self.summary["shard"])
            if commit is None or not commit.steps:
                raise ValueError(
                    f"environment {env} has no frame yet in this run: it has not started; {self._resume_hint}"
                )
            if not commit.frames:
                raise ValueError(
                    f"environment {env} has no frame yet in this run that can be read: its shard is at step "
                    f"{commit.steps} of {self.summary['steps']}, and {self._blocks}; {self._resume_hint}"
                )
            count = min(count, commit.frames)
        return count

    @property
    def _blocks(self) -> str:
        """Text that states when frames can be read."""
        return (
            f"frames are written in blocks of {self.summary['block']}, those after the last block are stored in "
            "checkpoints and can be read as the run continues"
        )

    @property
    def _resume_hint(self) -> str:
        """Text that states how the run is continued."""
        if is_locked(self.folder):
            return "a process is running it"
        return f"to resume: warpcontact run --resume --out {self.folder}"

    @property
    def frames(self) -> NDArray[np.intp]:
        """Number of frames that can be read, of each environment that has started (env,), ordered as ``series``."""
        frames = np.zeros(self.summary["envs"], dtype=np.intp)
        for number, commit in self._commits.items():
            shard = self.shards[number]
            frames[shard.first : shard.stop] = commit.frames
        return frames[self._mask(finished=False)]

    @property
    def health(self) -> Health:
        """Numbers of active, frozen and stopped environments, of those that are finished."""
        outcome = self.outcome
        status, cause, time, numbers = (outcome[name].values for name in ("status", "cause", "end_time", "env"))
        conditions: dict[str, int] = {}
        if "stopped_by" in outcome:
            codes, counts = np.unique(outcome["stopped_by"].values, return_counts=True)
            words = words_of(outcome["stopped_by"])
            conditions = {
                words[code]: int(n) for code, n in zip(codes.tolist(), counts, strict=True) if code in words
            }
        return Health.of(status, cause, time, numbers, conditions)

    @property
    def reports(self) -> tuple[CouplingReport, ...]:
        """Reports of the contact couplings: smallest distances and areas."""
        parameters = self.params.sel(env=self.outcome["env"])
        return tuple(report_of(one, self.outcome, parameters) for one in self.scene.contact_couplings)

    @property
    def files(self) -> dict[str, Path]:
        """Paths of the files by kind: experiment, data, commits, summary, animation, picture; law files by name."""
        named = {
            "experiment": files_of.EXPERIMENT,
            "data": DATA,
            "commits": COMMITS,
            "summary": files_of.SUMMARY,
            "animation": files_of.ANIMATION,
            "picture": files_of.PICTURE,
        }
        named |= {name: name for name in files_of.law_files(self.summary)}
        return {kind: self.folder / name for kind, name in named.items() if (self._files / name).exists()}

    @property
    def shards(self) -> Shards:
        """The shards of the run."""
        return Shards(self.summary["envs"], self.summary["shard"])

    def table(self) -> "xr.Dataset":
        """Returns parameters and outcomes of the finished environments as one data set (env, …)."""
        import xarray as xr

        outcome = self.outcome
        params = self.params.sel(env=outcome["env"])
        both = [name for name in params if name in outcome]
        return xr.merge([params.drop_vars(both), outcome], join="exact", combine_attrs="drop_conflicts")

    def to_dataframe(self) -> "pd.DataFrame":
        """Returns parameters and outcomes with one row per finished environment, vectors by component.

        A parameter of a set has one column if its items are equal in every environment, else one column per item.
        Codes, such as those of ``status``, are categories with their labels as values. Codes without a label are
        missing values, such as ``stopped_by`` of an environment that no condition stopped.
        """
        import pandas as pd

        table = self.table()
        columns: dict[str, Any] = {}
        for name, array in table.data_vars.items():
            words = words_of(array)
            for labels, values in _columns(array if name in self.outcome else merged_items(array)):
                key = ".".join([str(name), *labels])
                columns[key] = values
                if words:
                    places = [list(words).index(code) if code in words else -1 for code in values.tolist()]
                    columns[key] = pd.Categorical.from_codes(places, list(words.values()))
        return pd.DataFrame(columns, index=pd.Index(table["env"].values, name="env"))

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Writes the table as comma-separated values: numbers with all digits, missing labels as empty fields."""
        with open_for_writing(Path(path)) as raw, io.TextIOWrapper(raw, encoding="utf-8", newline="") as file:
            self.write_csv(file)

    def write_csv(self, file: TextIO, line_end: str = "\r\n") -> None:
        """Writes the table to an open text file, in the format of ``to_csv``."""
        frame = self.to_dataframe()
        coded = frame.select_dtypes("category").astype(object)
        frame[coded.columns] = coded.where(coded.notna(), None)
        writer = csv.writer(file, lineterminator=line_end)
        writer.writerow(["env", *frame.columns])
        for env, row in zip(frame.index, frame.itertuples(index=False), strict=True):
            writer.writerow([env, *row])

    def to_parquet(self, path: str | PathLike[str]) -> None:
        """Writes the table as Parquet.

        Raises:
            ImportError: If pyarrow is not installed.
        """
        try:
            import pyarrow  # noqa: F401
        except ImportError:
            raise ImportError(
                "Parquet needs pyarrow, which is not installed: pip install 'warpcontact[tables]'"
            ) from None
        with open_for_writing(Path(path)) as file:
            self.to_dataframe().to_parquet(file, engine="pyarrow")

    def digest(self) -> str:
        """Returns the SHA-256 of all results in order of environments. It does not depend on shards or devices."""
        total = hashlib.sha256()
        for group in GROUPS:
            if not (self._files / DATA / group).is_folder():
                continue
            data = self._group(group)
            for name in sorted(map(str, data.data_vars)):
                array = data[name].transpose("env", ...)
                total.update(f"{group}/{name}{array.dtype}{array.shape}".encode())
                for block in _env_blocks(data[name]):
                    total.update(np.ascontiguousarray(array.isel(env=block).values).tobytes())
        return total.hexdigest()

    def check(self) -> None:
        """Reads all result files and compares them with the committed checksums.

        Raises:
            RunDataError: If a file is missing or was changed.
        """
        Ledger(self.folder).check(RunExtent.of(self.summary), contents=True)

    def _group(self, name: str) -> "xr.Dataset":
        if not (self._files / DATA / name).is_folder():
            what = {"series": "no series: [record] series = false", "events": "no events"}[name]
            raise ValueError(f"{self.folder}: the run recorded {what}")
        import xarray as xr

        from warpcontact.experiment.committed import CommittedStore

        data = xr.open_zarr(
            CommittedStore(self._files, commits=self._commits), group=name, consolidated=False, chunks=None
        )
        order = data.attrs.pop(VARIABLES_ATTRIBUTE, None)
        data.attrs.pop(LABELS_ATTRIBUTE, None)
        if not isinstance(order, list) or set(order) != set(data.data_vars):
            raise RunDataError(f"{self.folder / DATA / name}: must have the variables {order}, has {list(data)}")
        # The order of arrays in a folder listing is arbitrary.
        names = sorted(map(str, data.coords))
        return data[order].drop_vars(names).assign_coords({name: data.coords[name] for name in names})

    def _mask(self, *, finished: bool) -> NDArray[np.bool_]:
        """Returns a mask of the environments that are finished, or that have started (env,)."""
        mask = np.zeros(self.summary["envs"], dtype=bool)
        for number, commit in self._commits.items():
            shard = self.shards[number]
            mask[shard.first : shard.stop] = commit.finished or not finished
        return mask

    def _begun_data(self) -> NDArray[np.intp] | slice:
        mask = self._mask(finished=False)
        return slice(None) if mask.all() else np.flatnonzero(mask)

    def __str__(self) -> str:
        s = self.summary
        shards = f" in {len(self.shards)} shards" if len(self.shards) > 1 else ""
        title = f"{s['name']}: {env_count_text(s['envs'])} × {s['duration']:g} s in {s['steps']} steps of {s['dt']:g} s"
        lines = [title]
        if "wall_time" in s:
            rate = f"{s['env_steps_per_second']:.3g} environment steps per second"
            lines.append(f"{s['wall_time']:.1f} s on {s['device']}{shards}, {rate}")
        else:
            count = int(self._mask(finished=True).sum())
            lines.append(f"{s['state']}: {count} of {s['envs']} environments are finished{shards}")
        for shard, message in s.get("failed", {}).items():
            lines.append(f"{shard} failed: {message}")
        if count := self.outcome.sizes["env"]:
            of = "" if self.finished else f"of the {count} of {s['envs']} that are finished: "
            lines.append(f"{of}{self.health}")
        begun = self._mask(finished=False) & ~self._mask(finished=True)
        if begun.any() and (self._files / DATA / "series").is_folder():
            fewest = self.frames[~self._mask(finished=True)[self._mask(finished=False)]].min()
            started = env_count_text(int(begun.sum()))
            lines.append(f"{started} started, with {fewest} or more frames: {self._blocks}")
        lines += [line for report in s.get("contact_couplings", {}).values() for line in report]
        width = max(11, *map(len, self.files))
        lines += [f"  {kind:<{width}} {path}" for kind, path in sorted(self.files.items())]
        return escape_lines(lines)

    def __repr__(self) -> str:
        return escape_lines([f"<Run in {self.folder}: {self.summary['name']}, {self.summary['state']}>"])


@explain_keywords
def open_run(path: str | PathLike[str], *, verify: bool = False, trust: Trust = False) -> Run:
    """Opens the folder of a run, finished or not.

    Args:
        path: The folder.
        verify: Read all results and compare them with the committed checksums, not only their sizes.
        trust: Whether to execute law files of the folder that no run of this user wrote there, when the scene or
            the experiment is read; or the SHA-256 of those that may be executed.

    Raises:
        ExperimentError: If the folder holds no run, or its schema is not supported by this version.
        RunDataError: If a committed file is missing, truncated or was changed.
        UnsafeFileError: If a file or folder of the run is a symbolic link, a pipe or a device.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise ExperimentError(str(folder), ["is not a folder"])
    summary = files_of.read_summary(folder)
    if summary is None:
        raise ExperimentError(str(folder), [f"holds no run: {files_of.SUMMARY} is missing or incomplete"])
    files_of.check_schema(folder, summary)
    files = RunPath(folder)
    if not (files / DATA).is_folder():
        raise ExperimentError(str(folder), ["the run ended before anything was saved"])
    if not (files / COMMITS).is_folder():
        raise ExperimentError(str(folder), [f"folder {COMMITS} is missing; it lists the committed files"])
    try:
        envs = tomllib.loads((files / files_of.EXPERIMENT).read().decode()).get("envs")
    except UnsafeFileError:
        raise
    except (OSError, ValueError, RecursionError) as error:
        raise ExperimentError(str(folder / files_of.EXPERIMENT), [f"cannot be read: {error}"]) from None
    if envs != summary["envs"]:
        raise ExperimentError(
            str(folder / files_of.SUMMARY),
            [f"envs must be {abbreviated(envs)}, as in {files_of.EXPERIMENT}, got {summary['envs']}"],
        )
    ledger = Ledger(folder)
    ledger.check(RunExtent.of(summary), contents=verify)
    run = Run(folder, summary, None, trust)
    commits = ledger.commits()
    for shard in run.shards if summary["state"] == files_of.FINISHED else ():
        if shard.number not in commits or not commits[shard.number].finished:
            raise RunDataError(
                f"{folder / COMMITS / shard.name}.json: the run is finished, but this shard has no record that "
                "states it; --resume runs it again"
            )
    return run


def _columns(array: "xr.DataArray") -> Iterator[tuple[list[str], NDArray[Any]]]:
    """Iterates over the columns of an array: labels of the axes after ``env``, and values (env,)."""
    values = array.transpose("env", ...).values
    axes = [dim for dim in array.dims if dim != "env"]
    for index in np.ndindex(values.shape[1:]):
        labels = [
            str(array[dim].values[i]) if dim in array.coords else str(i)
            for dim, i in zip(axes, index, strict=True)
        ]
        yield labels, values[(slice(None), *index)]


def _env_blocks(array: "xr.DataArray") -> Iterator[slice]:
    """Iterates over ranges of environments of a stored array, up to ``READ_AT_ONCE``, of whole chunks if possible.

    Chunks that are larger are read several times, one part at a time.
    """
    envs = array.sizes["env"]
    chunk = dict(zip(array.dims, array.encoding["chunks"], strict=True))["env"]
    max_envs = max(1, READ_AT_ONCE * envs // max(1, array.nbytes))
    whole_chunks = max_envs // chunk * chunk
    step = whole_chunks or -(-chunk // -(-chunk // max_envs))
    for first in range(0, envs, whole_chunks or chunk):
        stop = min(first + (whole_chunks or chunk), envs)
        yield from (slice(k, min(k + step, stop)) for k in range(first, stop, step))
