"""The folder that a run fills: which folders it may use, and what it writes into them."""

import itertools
import json
import os
import platform
import shutil
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from warpcontact._version import __version__
from warpcontact.contact_coupling_report import CouplingReport
from warpcontact.experiment.catalogue import FileMesh, FormulaSettings, Section, ShapeMesh, own_class
from warpcontact.experiment.errors import ExperimentError
from warpcontact.experiment.observation import OutcomeSettings
from warpcontact.experiment.own import OwnFiles
from warpcontact.experiment.schema import FORMULA_SECTIONS, ROW_KEYS, Settings
from warpcontact.health import Health
from warpcontact.recorder import Recording

RECORDING = "recording.zarr"
ANIMATION = "animation.usdc"
PICTURE = "picture.png"
EXPERIMENT = "experiment.toml"
SUMMARY = "run.json"

# What ``state`` in run.json may be. A run that was killed stays unfinished.
FINISHED = "finished"
UNFINISHED = "unfinished"
INTERRUPTED = "interrupted"

#: In run.json: the SHA-256 of the copied files with laws, by their names.
LAW_FILES = "law_files"

# Arrays are stored in pieces of about this size, each a range of environments [bytes].
CHUNK = 16 * 2**20


@dataclass(frozen=True)
class Run:
    """What a run left behind.

    Attributes:
        folder: Where the files are.
        files: Path of each file by what it is: experiment, recording, animation, picture, summary; copies of
            files with laws by their names.
        recording: The readings (time, env, …), and the parameters that varied (env, …). After batches they are
            read from the folder where they are asked for.
        health: Which environments turned non-finite.
        reports: How close contact couplings came, and over which area.
        summary: Content of ``run.json``: versions, device, seed, times.
    """

    folder: Path
    files: dict[str, Path]
    recording: Recording
    health: Health
    reports: tuple[CouplingReport, ...]
    summary: dict[str, Any]

    def __str__(self) -> str:
        s = self.summary
        rate = f"{s['env_steps_per_second']:.3g} environment steps per second"
        batches = f" in {s['batches']} batches" if s.get("batches", 1) > 1 else ""
        width = max(11, *map(len, self.files))
        lines = [
            f"{s['name']}: {s['envs']} environments × {s['duration']:g} s in {s['steps']} steps of {s['dt']:g} s",
            f"{s['wall_time']:.1f} s on {s['device']}{batches}, {rate}",
            str(self.health),
            *(str(report) for report in self.reports),
            *(f"  {kind:<{width}} {path}" for kind, path in sorted(self.files.items())),
        ]
        return "\n".join(lines)


@dataclass(frozen=True)
class Copy:
    """What is written of an experiment, so that it can be repeated from the folder of results alone.

    Attributes:
        settings: The experiment, with names of files as they are from there.
        files: Content of the files with laws, by their names there.
    """

    settings: Settings
    files: dict[str, bytes]


def check_folder(folder: Path, overwrite: bool, files: Mapping[str, bytes]) -> None:
    """Raises ``ExperimentError`` unless results may go into ``folder``.

    It may be new or empty, or hold a run that did not finish; with ``overwrite`` it may hold any earlier run.
    None of ``files``, that are to be written there by name, may replace another that no run has written.
    """
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise ExperimentError(str(folder), ["is not a folder"])
    if not any(folder.iterdir()):
        return
    summary = read_summary(folder)
    if summary is None:
        raise ExperimentError(
            str(folder), ["is not empty, and what is in it is no earlier run; choose a new folder"]
        )
    if _is_running(summary):
        raise ExperimentError(str(folder), [f"process {summary['process']} is running and writes there"])
    if not overwrite and summary.get("state") not in (UNFINISHED, INTERRUPTED):
        raise ExperimentError(
            str(folder), ["holds an earlier run; choose another folder, or overwrite it (--overwrite)"]
        )
    for name in files.keys() - _law_files(summary):
        if os.path.lexists(folder / name):
            raise ExperimentError(str(folder), [f"holds a file {name!r} of its own, which the run would replace"])


def read_summary(folder: Path) -> dict[str, Any] | None:
    """Returns the content of ``run.json``, or ``None`` if ``folder`` holds no run."""
    try:
        summary = json.loads((folder / SUMMARY).read_bytes())
        return summary if str(summary["program"]).startswith("warpcontact ") else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _law_files(summary: Mapping[str, Any] | None) -> set[str]:
    """Returns the names of the files with laws that a run left behind."""
    listed = (summary or {}).get(LAW_FILES)
    names = listed if isinstance(listed, dict) else ()
    # They are going to be removed: nothing but what a run can have written, whatever became of run.json.
    return {name for name in names if Path(name).name == name and name.endswith(".py")}


def _is_running(summary: Mapping[str, Any]) -> bool:
    """Whether another process of this machine is, as far as one can tell, at work on the run."""
    process = summary.get("process")
    if summary.get("state") != UNFINISHED or summary.get("host") != platform.node() or os.name != "posix":
        return False
    if not isinstance(process, int) or process <= 0 or process == os.getpid():
        return False
    try:
        os.kill(process, 0)  # sends nothing
    except PermissionError:
        return True
    except (OSError, OverflowError):
        return False
    return True


def clear_folder(folder: Path, keep: str = "") -> None:
    """Makes ``folder``, or removes the files of the earlier run in it, except ``keep``; others stay."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in (RECORDING, ANIMATION, PICTURE, EXPERIMENT, *_law_files(read_summary(folder)), SUMMARY):
        path = folder / name
        if name == keep:
            continue
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def copied(settings: Settings, old: Path, new: Path, own: OwnFiles) -> Copy:
    """Returns what is to be written into folder ``new`` of an experiment in folder ``old``.

    Files with meshes and rows stay where they are. Files with laws are copied: they may lie nowhere but beside the
    experiment, and are small. They are copied as they were loaded, whatever has become of them since.
    """
    names: dict[Path, str] = {}
    files: dict[str, bytes] = {}

    def with_file(table: FormulaSettings | OutcomeSettings) -> Section:
        file, cls = own_class(table.type)
        if not file:
            return table
        found = own.file(file)
        if found.path not in names:
            names[found.path] = _free_name(found.path, names.values())
            files[names[found.path]] = found.content
        return table.model_copy(update={"type": f"{names[found.path]}:{cls}"})

    def renamed(entry: Section) -> Section:
        changes = {}
        for key, table in entry:
            if isinstance(table, FormulaSettings):
                changes[key] = with_file(table)
        return entry.model_copy(update=changes)

    sections: dict[str, Any] = {name: tuple(map(renamed, getattr(settings, name))) for name in FORMULA_SECTIONS}
    sections["outcome"] = {name: with_file(table) for name, table in settings.outcome.items()}
    whole = settings.model_copy(update=sections)
    return Copy(_with_rows_from(_with_meshes_from(whole, old, new), old, new), files)


def _free_name(path: Path, taken: Iterable[str]) -> str:
    """Returns the name of file ``path``, with a number if it is taken; some systems do not tell a from A."""
    used = {name.casefold() for name in taken}
    numbered = (f"{path.stem}_{number}{path.suffix}" for number in itertools.count(2))
    return next(name for name in itertools.chain([path.name], numbered) if name.casefold() not in used)


def _with_meshes_from(settings: Settings, old: Path, new: Path) -> Settings:
    """Returns ``settings`` with the names of mesh files made relative to folder ``new`` instead of ``old``."""
    surfaces = []
    for surface in settings.surface:
        found = tuple(_mesh_from(mesh, old, new) for mesh in surface.meshes.values())
        mesh = found if isinstance(surface.mesh, tuple) else found[0]
        surfaces.append(surface.model_copy(update={"mesh": mesh}))
    return settings.model_copy(update={"surface": tuple(surfaces)})


def _mesh_from(mesh: FileMesh | ShapeMesh, old: Path, new: Path) -> FileMesh | ShapeMesh:
    if not isinstance(mesh, FileMesh):
        return mesh
    return mesh.model_copy(update={"file": _file_from(mesh.file, old, new)})


def _with_rows_from(settings: Settings, old: Path, new: Path) -> Settings:
    """Returns the same with the names of files with rows."""

    def renamed(entry: Section, keys: tuple[str, ...]) -> Section:
        named = {key: getattr(entry, key) for key in keys if isinstance(getattr(entry, key), str)}
        return entry.model_copy(update={key: _file_from(file, old, new) for key, file in named.items()})

    sections = {
        name: tuple(renamed(entry, keys) for entry in getattr(settings, name)) for name, keys in ROW_KEYS.items()
    }
    return settings.model_copy(update=sections)


def _file_from(name: str, old: Path, new: Path) -> str:
    """Returns the name of a file, relative to folder ``old``, as it is from folder ``new``."""
    if Path(name).is_absolute():
        return name
    target = (old / name).resolve()
    try:
        return Path(os.path.relpath(target, new.resolve())).as_posix()
    except ValueError:  # on another drive
        return target.as_posix()


def write_recording(recording: Recording, path: Path) -> None:
    """Writes ``recording`` as a Zarr v3 group, which ``xarray.open_zarr`` reads."""
    _create_store(recording, path, lambda envs, most: most)
    complete_recording(path, {})


def add_to_recording(recording: xr.Dataset, path: Path, *, new: bool) -> None:
    """Writes a batch of environments: the first into a ``new`` store, others behind those that are there.

    Args:
        recording: Of the batch; none has more environments than the first.
        path: The store.
        new: Whether it is the first.
    """
    if new:
        # Pieces are parts of a batch, so that none is written twice.
        _create_store(recording, path, _largest_part)
    else:
        recording.to_zarr(path, mode="a-", append_dim="env", zarr_format=3, consolidated=False)


def complete_recording(path: Path, attributes: Mapping[str, Any]) -> None:
    """Adds attributes to a store, and all metadata in one place, where xarray looks for it first."""
    import zarr

    zarr.open_group(path, mode="r+").attrs.update(attributes)
    with warnings.catch_warnings():
        # Others may pass over it.
        warnings.filterwarnings("ignore", message="Consolidated metadata", category=UserWarning)
        zarr.consolidate_metadata(path, zarr_format=3)


def _create_store(recording: xr.Dataset, path: Path, part: Callable[[int, int], int]) -> None:
    """Writes a new store in pieces of ``part(envs, most)`` environments."""
    encoding = {}
    for name, variable in recording.data_vars.items():
        all_envs = variable.sizes["env"]
        row = variable.nbytes // max(1, all_envs)
        envs = part(all_envs, max(1, min(all_envs, CHUNK // max(1, row))))
        chunks = tuple(envs if dim == "env" else size for dim, size in variable.sizes.items())
        encoding[name] = {"chunks": chunks}
    recording.to_zarr(path, mode="w-", zarr_format=3, consolidated=False, encoding=encoding)


def _largest_part(envs: int, most: int) -> int:
    """Returns the largest divisor of ``envs`` that is at most ``most``."""
    return next(part for part in range(most, 0, -1) if envs % part == 0)


def write_summary(path: Path, summary: Mapping[str, Any]) -> None:
    """Writes ``run.json``, by which a folder is known to hold a run."""
    content = {"program": f"warpcontact {__version__}", **summary}
    path.write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
