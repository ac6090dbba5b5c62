"""The copy of an experiment in its run folder: TOML text, copied files, and fingerprint with differences."""

import hashlib
import itertools
import json
import math
import os
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpcontact.experiment.catalogue import DeviceModelSettings, FileMesh, Section, ShapeMesh, user_class
from warpcontact.experiment.errors import abbreviated, key_path
from warpcontact.experiment.force_elements import ForceElementSettings
from warpcontact.experiment.observation import OutcomeSettings
from warpcontact.experiment.schema import DEVICE_MODEL_SECTIONS, LISTS, ROW_KEYS, SECTIONS, Settings
from warpcontact.experiment.user_code import UserFiles
from warpcontact.experiment.variation import relocate
from warpcontact.files.run_folder import RunPath, open_file

# Largest number of reported differences.
MAX_REPORTED = 5


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


def to_toml(settings: Settings, comment: str) -> str:
    """Returns ``settings``, including defaults, as TOML text that parses to the same settings.

    Vectors and nested tables are on one line, unlike the output of the package tomli-w.

    Args:
        settings: The settings.
        comment: Comment on the first line.
    """
    content = settings.model_dump(exclude_none=True)
    lines = [f"# {comment}"]
    lines += [
        _toml_line(key, value) for key, value in content.items() if not isinstance(value, dict | tuple | list)
    ]
    lines += [_toml_line("gravity", content["gravity"])]
    for section in (*SECTIONS, *LISTS):
        for entry in content[section]:
            lines += ["", f"[[{section}]]", *(_toml_line(key, value) for key, value in entry.items())]
    tables = ("variation", "sampling", "integrator", "outcome", "stop", "events", "quarantine", "record", "output")
    for table in tables:
        if content.get(table):
            lines += ["", f"[{table}]", *(_toml_line(key, value) for key, value in content[table].items())]
    return "\n".join(lines) + "\n"


def _toml_line(key: str, value: Any) -> str:
    return f"{key_path([key])} = {_toml_value(value)}"


def _toml_value(value: Any) -> str:
    """Returns ``value`` as a TOML value on one line.

    Raises:
        ValueError: If it is infinite, NaN, or of a type that settings do not contain.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if (isinstance(value, float) and math.isfinite(value)) or isinstance(value, int):
        return repr(value)
    if isinstance(value, str):
        # JSON and TOML use the same escapes, except for the DEL character.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_toml_line(key, entry) for key, entry in value.items()) + " }"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    raise ValueError(f"no TOML value for {value!r}")


def fingerprint(copy: ExperimentCopy) -> str:
    """Returns the SHA-256 of an experiment, with the content of law, mesh and row files."""
    total = hashlib.sha256(_settings_text(copy.settings).encode())
    for name, content in sorted(copy.files.items()):
        total.update(name.encode() + hashlib.sha256(content).digest())
    for path in copy.external:
        with open_file(path) as file:
            total.update(hashlib.file_digest(file, "sha256").digest())
    return total.hexdigest()


def differences(path: RunPath, settings: Settings) -> list[str]:
    """Returns the differences, as text, between the experiment file that a run has written and ``settings``."""
    try:
        stored = dict(_leaves(tomllib.loads(path.read().decode())))
    except (OSError, ValueError) as error:
        return [f"{path.name} cannot be read: {error}"]
    current = dict(_leaves(tomllib.loads(_settings_text(settings))))
    differing = [
        f"{key_path(key)} is {_value_text(stored, key)} there, {_value_text(current, key)} here"
        for key in dict.fromkeys((*stored, *current))
        if stored.get(key) != current.get(key)
    ]
    return differing[:MAX_REPORTED] + (
        [f"and {len(differing) - MAX_REPORTED} more"] if len(differing) > MAX_REPORTED else []
    )


def _settings_text(settings: Settings) -> str:
    return to_toml(settings, "")


def _value_text(leaves: dict[tuple[str | int, ...], Any], key: tuple[str | int, ...]) -> str:
    return abbreviated(leaves[key]) if key in leaves else "not given"


def _leaves(value: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, (*place, key))
    elif isinstance(value, list) and any(isinstance(inner, dict) for inner in value):
        for i, inner in enumerate(value):
            yield from _leaves(inner, (*place, i))
    else:
        yield place, value
