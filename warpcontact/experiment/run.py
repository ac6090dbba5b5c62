"""What a run left in its folder, read where it is asked for."""

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

from warpcontact.drawing.equal_items import merged_items
from warpcontact.experiment import folder as files_of
from warpcontact.experiment.assemble import FileCache, SceneBuilder
from warpcontact.experiment.errors import ExperimentError, Problems, abbreviated
from warpcontact.experiment.expected import LABELS, ORDER, RunExtent
from warpcontact.experiment.lock import is_locked
from warpcontact.experiment.parser import ExperimentParts, load_toml, read_settings
from warpcontact.experiment.records import COMMITS, DATA, GROUPS, Commit, RunDataError
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.store import Ledger, Shards
from warpcontact.experiment.trust import Trust
from warpcontact.experiment.user_code import UserFiles
from warpcontact.files.atomic_files import open_for_writing
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import RunPath
from warpcontact.forces.contact_coupling.report import CouplingReport, report_of
from warpcontact.kernels.catalogue.keywords import explain_keywords, explain_keywords_of
from warpcontact.model.flags import words_of
from warpcontact.model.health import Health
from warpcontact.scene.scene import Scene
from warpcontact.storage.memory_estimate import env_count_text
from warpcontact.validation.safe_text import escape_lines

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from warpcontact.experiment.experiment import Experiment
    from warpcontact.stepping.recording import Recording

# A digest reads pieces of arrays of up to this size [bytes].
READ_AT_ONCE = 256 * 2**20


@explain_keywords_of
@dataclass(frozen=True)
class Run:
    """What a run left behind, finished or not: of shards that are not finished, what is committed.

    Data sets are read from the folder where their values are asked for.

    Attributes:
        folder: Where the files are.
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
        """What ran. Files with laws of its own are run to read it; no model is built."""
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
        """The experiment that ran, checked as one that is to run again: with a model, which compiles kernels."""
        from warpcontact.experiment.experiment import Experiment

        return Experiment.from_toml(self.folder / files_of.EXPERIMENT, trust=self._trust)

    @functools.cached_property
    def settings(self) -> Settings:
        """All settings of the experiment. Files with laws of its own are run to read them; no model is built."""
        path, problems = self.folder / files_of.EXPERIMENT, Problems()
        user_files = UserFiles(self.folder, lambda stage: None, self._trust)
        settings = read_settings(load_toml(path), user_files, problems).settings
        problems.raise_if_any(str(path))
        assert settings is not None  # they are there if there are no problems
        return settings

    @functools.cached_property
    def _commits(self) -> dict[int, Commit]:
        """What is committed, as of when it was first asked for: all data sets are of the same moment."""
        count = len(self.shards)
        return {number: one for number, one in Ledger(self.folder).commits().items() if number < count}

    @property
    def finished(self) -> bool:
        """Whether all shards are."""
        return sum(commit.finished for commit in self._commits.values()) == len(self.shards)

    @functools.cached_property
    def params(self) -> "xr.Dataset":
        """The parameters that vary, and those that a replay needs, (env, …)."""
        return self._group("params").isel(env=self._begun_data())

    @functools.cached_property
    def outcome(self) -> "xr.Dataset":
        """What became of each environment, (env, …); those that are finished."""
        data = self._group("outcome")
        return data if self.finished else data.isel(env=np.flatnonzero(self._mask(finished=True)))

    @functools.cached_property
    def series(self) -> "xr.Dataset":
        """The sensors (time, env, …) of environments that have begun; NaN, or −1, behind the last whole block.

        Records of an unfinished shard are written in blocks; those since the last one are in its checkpoint.

        Raises:
            ValueError: If nothing was recorded over time.
        """
        from warpcontact.stepping.recording import Series

        data = self._group("series").isel(env=self._begun_data())
        return Series(data.data_vars, coords=data.coords, attrs=data.attrs)

    @functools.cached_property
    def events(self) -> "xr.Dataset":
        """What happened when, (env, event).

        Raises:
            ValueError: If no events were asked for.
        """
        return self._group("events").isel(env=np.flatnonzero(self._mask(finished=True)))

    @functools.cached_property
    def recording(self) -> "Recording":
        """Series and parameters as ``Simulation.run`` returns them, to be drawn and exported."""
        from warpcontact.stepping.recording import Recording

        variables: dict[Any, Any] = {}
        for data in (self.series, self.params):
            variables |= {name: array.variable for name, array in data.data_vars.items()}
        coordinates = {**self.params.coords, **self.series.coords}
        kept = ("device", "frozen_environments", "fingerprint")
        attributes = {key: self.summary[key] for key in kept if key in self.summary}
        recording = Recording(variables, coords=coordinates, attrs={**self.series.attrs, **attributes})
        recording.scene = self.scene
        return recording

    def check_series(self) -> None:
        """Raises ``ValueError`` if no record over time can be read yet, to be drawn or exported."""
        if any(commit.frames for commit in self._commits.values()):
            return
        if any(commit.steps for commit in self._commits.values()):
            raise ValueError(
                f"{self.folder}: no record over time can be read yet: {self._blocks}; {self._resume_hint}"
            )
        raise ValueError(f"{self.folder}: nothing over time is committed yet in this run; {self._resume_hint}")

    def records_of(self, envs: Iterable[SupportsInt]) -> int:
        """Returns how many records over time can be read of all of these environments, at least 1.

        Numbers that are not of the run do not count: who draws or exports refuses them.

        Raises:
            ValueError: If there is none of one of them yet; says how far its shard is.
        """
        count = int(self.series.sizes["time"])
        for env in (one for one in map(int, envs) if 0 <= one < self.summary["envs"]):
            commit = self._commits.get(env // self.summary["shard"])
            if commit is None or not commit.steps:
                raise ValueError(
                    f"environment {env} has no record yet in this run: it has not begun; {self._resume_hint}"
                )
            if not commit.frames:
                raise ValueError(
                    f"environment {env} has no record yet in this run that can be read: its shard is at step "
                    f"{commit.steps} of {self.summary['steps']}, and {self._blocks}; {self._resume_hint}"
                )
            count = min(count, commit.frames)
        return count

    @property
    def _blocks(self) -> str:
        """When records over time can be read, in words."""
        return (
            f"records are written in blocks of {self.summary['block']}, those since the last block are kept in "
            "checkpoints and appear as the run goes on"
        )

    @property
    def _resume_hint(self) -> str:
        """How the run goes on, in words."""
        if is_locked(self.folder):
            return "a process is at work on it"
        return f"warpcontact run --resume --out {self.folder} goes on with it"

    @property
    def frames(self) -> NDArray[np.intp]:
        """How many records over time can be read of each environment that was begun, (env,), as in ``series``."""
        frames = np.zeros(self.summary["envs"], dtype=np.intp)
        for number, commit in self._commits.items():
            shard = self.shards[number]
            frames[shard.first : shard.stop] = commit.frames
        return frames[self._mask(finished=False)]

    @property
    def health(self) -> Health:
        """Which environments are frozen and which stopped, of those that are finished."""
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
        """How close contact couplings came, and over which area."""
        parameters = self.params.sel(env=self.outcome["env"])
        return tuple(report_of(one, self.outcome, parameters) for one in self.scene.contact_couplings)

    @property
    def files(self) -> dict[str, Path]:
        """Path of each by what it is: experiment, data, commits, summary, animation, picture; laws by name."""
        named = {
            "experiment": files_of.EXPERIMENT,
            "data": DATA,
            "commits": COMMITS,
            "summary": files_of.SUMMARY,
            "animation": files_of.ANIMATION,
            "picture": files_of.PICTURE,
        }
        named |= {name: name for name in files_of.law_files(self.summary)}
        return {kind: self.folder / name for kind, name in named.items() if (self._files / name).is_there()}

    @property
    def shards(self) -> Shards:
        """The shards that it consists of."""
        return Shards(self.summary["envs"], self.summary["shard"])

    def table(self) -> "xr.Dataset":
        """Returns parameters and outcomes of the finished environments as one data set (env, …)."""
        import xarray as xr

        outcome = self.outcome
        params = self.params.sel(env=outcome["env"])
        both = [name for name in params if name in outcome]
        return xr.merge([params.drop_vars(both), outcome], join="exact", combine_attrs="drop_conflicts")

    def to_dataframe(self) -> "pd.DataFrame":
        """Returns one row for each finished environment: its parameters and outcomes, vectors by component.

        A parameter of a set has one column if its items are equal in every environment, else one for each item.
        Codes, such as that of ``status``, are categories by their words; where there is none, as of ``stopped_by``
        in an environment that no condition stopped, the value is missing.
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
        """Writes that table as comma-separated values, numbers with all their digits, missing words as nothing."""
        with open_for_writing(Path(path)) as raw, io.TextIOWrapper(raw, encoding="utf-8", newline="") as file:
            self.write_csv(file)

    def write_csv(self, file: TextIO, line_end: str = "\r\n") -> None:
        """Writes that table to an open text file, as ``to_csv``."""
        frame = self.to_dataframe()
        coded = frame.select_dtypes("category").astype(object)
        frame[coded.columns] = coded.where(coded.notna(), None)
        writer = csv.writer(file, lineterminator=line_end)
        writer.writerow(["env", *frame.columns])
        for env, row in zip(frame.index, frame.itertuples(index=False), strict=True):
            writer.writerow([env, *row])

    def to_parquet(self, path: str | PathLike[str]) -> None:
        """Writes that table as Parquet.

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
        """Returns the SHA-256 of all results, environment by environment: the same however they were run."""
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
        """Reads every file of the results and compares it with what was committed.

        Raises:
            RunDataError: If one is missing or was changed.
        """
        Ledger(self.folder).check(RunExtent.of(self.summary), contents=True)

    def _group(self, name: str) -> "xr.Dataset":
        if not (self._files / DATA / name).is_folder():
            what = {"series": "nothing over time: [record] series = false", "events": "no events"}[name]
            raise ValueError(f"{self.folder}: the run recorded {what}")
        import xarray as xr

        from warpcontact.experiment.committed import CommittedStore

        data = xr.open_zarr(
            CommittedStore(self._files, commits=self._commits), group=name, consolidated=False, chunks=None
        )
        order = data.attrs.pop(ORDER, None)
        data.attrs.pop(LABELS, None)
        if not isinstance(order, list) or set(order) != set(data.data_vars):
            raise RunDataError(f"{self.folder / DATA / name}: must have the variables {order}, has {list(data)}")
        # A folder lists its arrays in any order.
        names = sorted(map(str, data.coords))
        return data[order].drop_vars(names).assign_coords({name: data.coords[name] for name in names})

    def _mask(self, *, finished: bool) -> NDArray[np.bool_]:
        """Returns which environments are finished, or begun (env,)."""
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
            more = env_count_text(int(begun.sum()))
            lines.append(f"{more} begun, with {fewest} records over time or more: {self._blocks}")
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
        verify: Whether to read all results and compare them with what was committed, not only their sizes.
        trust: Whether files with laws are run that came with the folder and were not written there by a run of
            this user, when the scene or the experiment is read; or the SHA-256 of those that are.

    Raises:
        ExperimentError: If it holds no run, or one of a schema that this version does not read.
        RunDataError: If anything that was committed is missing, cut off or was changed.
        UnsafeFileError: If there is a symbolic link, a pipe or a device instead of a file or folder of the run.
    """
    folder = Path(path)
    if not folder.is_dir():
        raise ExperimentError(str(folder), ["is not a folder"])
    summary = files_of.read_summary(folder)
    if summary is None:
        raise ExperimentError(str(folder), [f"holds no run: there is no whole {files_of.SUMMARY} in it"])
    files_of.check_schema(folder, summary)
    files = RunPath(folder)
    if not (files / DATA).is_folder():
        raise ExperimentError(str(folder), ["the run was ended before anything was kept"])
    if not (files / COMMITS).is_folder():
        raise ExperimentError(str(folder), [f"folder {COMMITS} is missing, which says what counts"])
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
                f"{folder / COMMITS / shard.name}.json: the run is finished, and there is no record of this shard "
                "that says so; --resume runs it again"
            )
    return run


def _columns(array: "xr.DataArray") -> Iterator[tuple[list[str], NDArray[Any]]]:
    """Iterates over the labels behind ``env`` of an array, and the values of each."""
    values = array.transpose("env", ...).values
    axes = [dim for dim in array.dims if dim != "env"]
    for place in np.ndindex(values.shape[1:]):
        labels = [
            str(array[dim].values[i]) if dim in array.coords else str(i)
            for dim, i in zip(axes, place, strict=True)
        ]
        yield labels, values[(slice(None), *place)]


def _env_blocks(array: "xr.DataArray") -> Iterator[slice]:
    """Iterates over environments of a stored array, those of whole chunks at once if they fit.

    Chunks of an array that is so long in time that they do not are read several times, for parts of them.
    """
    envs = array.sizes["env"]
    chunk = dict(zip(array.dims, array.encoding["chunks"], strict=True))["env"]
    max_envs = max(1, READ_AT_ONCE * envs // max(1, array.nbytes))
    whole_chunks = max_envs // chunk * chunk
    step = whole_chunks or -(-chunk // -(-chunk // max_envs))
    for first in range(0, envs, whole_chunks or chunk):
        stop = min(first + (whole_chunks or chunk), envs)
        yield from (slice(k, min(k + step, stop)) for k in range(first, stop, step))
