"""Files of a run folder: checks whether a folder may be used, and writes ``run.json`` and the experiment."""

import contextlib
import itertools
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpcontact._version import __version__
from warpcontact.experiment.catalogue import DeviceModelSettings, FileMesh, Section, ShapeMesh, user_class
from warpcontact.experiment.errors import ExperimentError, abbreviated
from warpcontact.experiment.force_elements import ForceElementSettings
from warpcontact.experiment.lock import is_locked, locked_error
from warpcontact.experiment.observation import OutcomeSettings
from warpcontact.experiment.records import COMMITS, DATA, STAGING
from warpcontact.experiment.schema import DEVICE_MODEL_SECTIONS, ROW_KEYS, Settings
from warpcontact.experiment.store import CHECKPOINTS
from warpcontact.experiment.user_code import UserFiles
from warpcontact.experiment.variation import relocate
from warpcontact.files.atomic_files import write_json
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import EXPERIMENT, PARTIAL, SUMMARY, RunPath

ANIMATION = "animation.usdc"
PICTURE = "picture.png"
PROGRESS = "progress"

#: Schema version of run folders; increased when earlier folders can no longer be read.
SCHEMA = 2

# Values of ``state`` in run.json. A run that was killed stays unfinished.
FINISHED = "finished"
UNFINISHED = "unfinished"
INTERRUPTED = "interrupted"
FAILED = "failed"
STATES = (FINISHED, UNFINISHED, INTERRUPTED, FAILED)

#: Entry of run.json: the SHA-256 of the copied law files, by name.
LAW_FILES = "law_files"

# Required and optional entries of run.json, by type.
_WHOLE = ("envs", "shard", "shards", "block", "steps")
_TIMES = ("dt", "duration")
_TABLES = ("law_files", "failed", "contact_couplings")
_TEXTS = ("state", "name", "device", "fingerprint")
# Largest number of environments and steps: the largest 32-bit integer.
_MOST = 2**31 - 1


@dataclass(frozen=True)
class ExperimentCopy:
    """An experiment as it is saved in its run folder, so that it can be repeated from there.

    Attributes:
        settings: The experiment, with file names relative to the run folder.
        files: Content of the copied law files, by their names in the run folder.
        external: Files with meshes and rows, which are not copied.
    """

    settings: Settings
    files: dict[str, bytes]
    external: tuple[Path, ...] = ()


def check_usable(folder: Path, *, overwrite: bool, resume: bool) -> None:
    """Raises ``ExperimentError`` unless a run may start in ``folder``, or with ``resume`` continue there."""
    if not resume:
        check_new(folder, overwrite)
        return
    if is_locked(folder):
        raise locked_error(folder)
    check_started(folder)


def check_new(folder: Path, overwrite: bool) -> None:
    """Raises ``ExperimentError`` unless a new run may use ``folder``.

    The folder may be new or empty, or hold an unfinished run without commits; with ``overwrite``, any earlier run.
    """
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise ExperimentError(str(folder), ["is not a folder"])
    # A run that was killed while it wrote its first file leaves only the partial file.
    if set(RunPath(folder).names()) <= {f"{SUMMARY}{PARTIAL}"}:
        return
    summary = read_summary(folder)
    if summary is None:
        raise ExperimentError(str(folder), ["is not empty and holds no earlier run; choose a new folder"])
    if is_locked(folder):
        raise locked_error(folder)
    if not overwrite and (summary.get("state") not in (UNFINISHED, INTERRUPTED, FAILED) or has_commits(folder)):
        kind = "an earlier run" if summary.get("state") == FINISHED else "a run that did not finish"
        resume = "" if summary.get("state") == FINISHED else ", or resume it (--resume)"
        raise ExperimentError(
            str(folder), [f"holds {kind}; choose another folder, or overwrite it (--overwrite){resume}"]
        )


def check_replaced(folder: Path, files: Mapping[str, bytes]) -> None:
    """Raises ``ExperimentError`` if one of ``files``, by name, would replace a file of the user in ``folder``."""
    for name in files.keys() - law_files(read_summary(folder)):
        if (RunPath(folder) / name).is_there():
            raise ExperimentError(str(folder), [f"holds a file {name!r} of the user, which the run would replace"])


def check_started(folder: Path) -> dict[str, Any]:
    """Returns the content of ``run.json`` of a run that can be resumed.

    Raises:
        ExperimentError: If there is none, or its schema is not supported.
    """
    summary = read_summary(folder)
    if summary is None:
        raise ExperimentError(str(folder), ["holds no run to resume; start one without --resume"])
    check_schema(folder, summary)
    if not (RunPath(folder) / DATA).is_folder():
        raise ExperimentError(
            str(folder), ["the run ended before anything was saved; start it again without --resume"]
        )
    return summary


def check_schema(folder: Path, summary: Mapping[str, Any]) -> None:
    """Raises ``ExperimentError`` unless ``run.json`` has the schema of this version and valid entries."""
    schema, source = summary.get("schema"), str(folder / SUMMARY)
    if schema != SCHEMA:
        raise ExperimentError(
            source, [f"schema must be {SCHEMA}, got {abbreviated(schema)}, written by {summary.get('program')}"]
        )
    wrong = [f"{key} is missing" for key in (*_WHOLE, *_TIMES, *_TEXTS) if key not in summary]
    if wrong:
        raise ExperimentError(source, wrong)
    for key in _WHOLE:
        value = summary[key]
        if not (isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= _MOST):
            wrong.append(f"{key} must be a whole number from 1 to {_MOST}, got {abbreviated(value)}")
    for key in _TIMES:
        value = summary[key]
        if not (isinstance(value, int | float) and not isinstance(value, bool) and 0.0 < value < float("inf")):
            wrong.append(f"{key} must be a time above 0 s, got {abbreviated(value)}")
    wrong += [
        f"{key} must be a text, got {abbreviated(summary[key])}"
        for key in _TEXTS
        if not isinstance(summary[key], str)
    ]
    for key in _TABLES:
        if not isinstance(summary.get(key, {}), dict):
            wrong.append(f"{key} must be a table, got {abbreviated(summary[key])}")
    if isinstance(summary["state"], str) and summary["state"] not in STATES:
        wrong.append(f"state must be one of {', '.join(STATES)}, got {abbreviated(summary['state'])}")
    if not wrong:
        count = -(-summary["envs"] // summary["shard"])
        if summary["shards"] != count:
            wrong.append(f"shards must be {count} for these envs and shard, got {summary['shards']}")
    if wrong:
        raise ExperimentError(source, wrong)


def read_summary(folder: Path) -> dict[str, Any] | None:
    """Returns the content of ``run.json``, or ``None`` if ``folder`` holds no run.

    Raises:
        UnsafeFileError: If the file is a link, a pipe or a device, or is too large.
    """
    try:
        summary = json.loads((RunPath(folder) / SUMMARY).read())
        return summary if str(summary["program"]).startswith("warpcontact ") else None
    except UnsafeFileError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Writes ``run.json``, which marks ``folder`` as a run folder."""
    write_json(RunPath(folder) / SUMMARY, {"program": f"warpcontact {__version__}", "schema": SCHEMA, **summary})


def has_commits(folder: Path) -> bool:
    """Whether the run in ``folder`` has committed any shard."""
    names = (RunPath(folder) / COMMITS).names()
    return any(name.startswith("shard_") and name.endswith(".json") for name in names)


def law_files(summary: Mapping[str, Any] | None) -> set[str]:
    """Returns the names of the law files that a run copied into its folder."""
    listed = (summary or {}).get(LAW_FILES)
    names = listed if isinstance(listed, dict) else ()
    # These files will be removed, so accept only names that a run can have written, even if run.json was changed.
    return {name for name in names if Path(name).name == name and name.endswith(".py")}


def clear(folder: Path) -> None:
    """Creates ``folder``, or removes the files of the earlier run in it; other files are unchanged."""
    run = RunPath(folder)
    run.make()
    run_files = (DATA, f"{DATA}{PARTIAL}", STAGING, CHECKPOINTS, COMMITS, PROGRESS, ANIMATION, PICTURE, EXPERIMENT)
    for name in (*run_files, *law_files(read_summary(folder)), SUMMARY):
        (run / name).remove()


def make_subfolders(folder: Path) -> None:
    """Creates the subfolders that a run writes into."""
    for name in (STAGING, CHECKPOINTS, COMMITS, PROGRESS):
        (RunPath(folder) / name).make()


def remove_work_subfolders(folder: Path) -> None:
    """Removes the subfolders that a finished run no longer needs."""
    for name in (STAGING, CHECKPOINTS, PROGRESS):
        with contextlib.suppress(OSError):
            (RunPath(folder) / name).remove()


def copy_experiment(settings: Settings, old: Path, new: Path, user_files: UserFiles) -> ExperimentCopy:
    """Returns the copy of an experiment in folder ``old`` that is saved in run folder ``new``.

    Files with meshes and rows are not copied. Law files are copied, with the content that was loaded: they must be in
    the folder of the experiment, and are small.
    """
    names: dict[Path, str] = {}
    files: dict[str, bytes] = {}

    def with_file(table: DeviceModelSettings | OutcomeSettings | ForceElementSettings) -> Section:
        file, cls = user_class(table.type)
        if not file:
            return table
        found = user_files.file(file)
        if found.path not in names:
            names[found.path] = _free_name(found.path, names.values())
            files[names[found.path]] = found.content
        return table.model_copy(update={"type": f"{names[found.path]}:{cls}"})

    def renamed(entry: Section) -> Section:
        changes = {}
        for key, table in entry:
            if isinstance(table, DeviceModelSettings):
                changes[key] = with_file(table)
        return entry.model_copy(update=changes)

    sections: dict[str, Any] = {
        name: tuple(map(renamed, getattr(settings, name))) for name in DEVICE_MODEL_SECTIONS
    }
    sections["force_element"] = tuple(map(with_file, settings.force_element))
    sections["outcome"] = {name: with_file(table) for name, table in settings.outcome.items()}
    whole = settings.model_copy(update=sections)
    moved = _with_rows_from(_with_meshes_from(whole, old, new), old, new)
    return ExperimentCopy(moved, files, tuple(_external_files(settings, old)))


def _free_name(path: Path, taken: Iterable[str]) -> str:
    """Returns the name of file ``path``, with a number if it is in use, ignoring case as some file systems do."""
    used = {name.casefold() for name in taken}
    numbered = (f"{path.stem}_{number}{path.suffix}" for number in itertools.count(2))
    return next(name for name in itertools.chain([path.name], numbered) if name.casefold() not in used)


def _with_meshes_from(settings: Settings, old: Path, new: Path) -> Settings:
    """Returns ``settings`` with mesh file names relative to folder ``new`` instead of ``old``."""
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
    """Returns ``settings`` with the names of row files relative to folder ``new`` instead of ``old``."""

    def renamed(entry: Section, keys: tuple[str, ...]) -> Section:
        named = {key: getattr(entry, key) for key in keys if isinstance(getattr(entry, key), str)}
        return entry.model_copy(update={key: _file_from(file, old, new) for key, file in named.items()})

    sections = {
        name: tuple(renamed(entry, keys) for entry in getattr(settings, name)) for name, keys in ROW_KEYS.items()
    }
    variation = relocate(settings.variation, lambda file: _file_from(file, old, new))
    return settings.model_copy(update=sections | {"variation": variation})


def _file_from(name: str, old: Path, new: Path) -> str:
    """Returns a file name that is relative to folder ``old``, relative to folder ``new``."""
    if Path(name).is_absolute():
        return name
    target = (old / name).resolve()
    try:
        return Path(os.path.relpath(target, new.resolve())).as_posix()
    except ValueError:  # on another drive
        return target.as_posix()


def _external_files(settings: Settings, folder: Path) -> Iterator[Path]:
    """Iterates over the mesh and row files of an experiment in ``folder``."""
    for surface in settings.surface:
        for mesh in surface.meshes.values():
            if isinstance(mesh, FileMesh):
                yield folder / mesh.file
    for section, keys in ROW_KEYS.items():
        for entry in getattr(settings, section):
            for key in keys:
                if isinstance(getattr(entry, key), str):
                    yield folder / getattr(entry, key)
    for varied in settings.variation.values():
        if isinstance(varied.values, str):
            yield folder / varied.values
