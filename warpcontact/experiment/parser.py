"""Parses TOML files, or dictionaries of the same form, into validated settings. All problems are collected.

Overrides ``PATH=VALUE`` are applied before validation.
"""

import copy
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from warpcontact.experiment.catalogue import Section
from warpcontact.experiment.errors import ExperimentError, Problems, abbreviated, key_path
from warpcontact.experiment.schema import LISTS, SECTIONS, Settings, VariationSettings, entry_model, table_at
from warpcontact.experiment.user_code import UserFiles
from warpcontact.experiment.variation_settings import MOST_ENVS, grid_size
from warpcontact.files.run_folder import read_file
from warpcontact.kernels.catalogue.names import present_name, suggestion

# A bare key, a quoted key, or the number of an entry, as in messages.
_PART = re.compile(
    r"\.?(?:(?P<bare>[A-Za-z0-9_-]+)|(?P<quoted>\"(?:[^\"\\]|\\.)*\"|'[^']*')|\[(?P<number>[0-9]{1,9})\])"
)

# Required kind of value, by the error type of pydantic.
_KINDS = {
    "bool_type": "true or false",
    "dict_type": "a table",
    "float_type": "a number",
    "int_from_float": "a whole number",
    "int_type": "a whole number",
    "list_type": "a list",
    "model_attributes_type": "a table",
    "model_type": "a table",
    "string_type": "a text",
    "tuple_type": "a list",
}

#: Singular and plural names of sections.
_PLURALS = {"point": "points", "body": "bodies"}
_VALUES = "; write { values = [...] }"


def apply_overrides(content: Mapping[str, Any], changes: Iterable[str]) -> dict[str, Any]:
    """Returns the content of an experiment file with overrides applied.

    Args:
        content: The content.
        changes: Strings ``PATH=VALUE``; for equal paths the last one applies. The path has the form that messages use,
            ``body[0].mass`` or ``variation."ball.mass".uniform``; entries of a list can also be named:
            ``body.ball.mass``. Missing tables are created. The value is a TOML value.

    Raises:
        ExperimentError: If an override is invalid, or its path does not exist.
    """
    changed = copy.deepcopy(dict(content))
    for change in changes:
        try:
            path, value = _parse_override(change)
            _set_value(changed, path, value)
        except ValueError as error:
            raise ExperimentError(f"--set {abbreviated(change)}", [str(error)]) from None
    return changed


def _parse_override(change: str) -> tuple[list[str | int], Any]:
    """Returns path and value of an override."""
    change, position = change.strip(), 0
    path: list[str | int] = []
    while position < len(change) and (part := _PART.match(change, position)) is not None:
        if (part[0][0] == ".") != (bool(path) and part["number"] is None):
            break
        if part["number"] is not None:
            path.append(int(part["number"]))
        else:
            path.append(part["bare"] or tomllib.loads(f"key = {part['quoted']}")["key"])
        position = part.end()
    key, equals, text = change[position:].partition("=")
    if not path or isinstance(path[0], int) or not equals or key.strip():
        raise ValueError('must be PATH=VALUE, with a path such as body[0].mass or variation."ball.mass".uniform')
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError):
        parsed = {}
    # A value with several lines could contain further keys.
    if list(parsed) != ["value"]:
        hint = (
            f"; write a string in quotes: '{key_path(path)}=\"{text.strip()}\"'" if text.strip().isalnum() else ""
        )
        raise ValueError(f"{key_path(path)} must be a TOML value, got {abbreviated(text)}{hint}")
    return path, parsed["value"]


def _set_value(content: dict[str, Any], path: list[str | int], value: Any) -> None:
    """Sets the entry of ``content`` at ``path`` to ``value``."""
    at: Any = content
    for depth, part in enumerate(path):
        location = key_path(path[: depth + 1])
        key: Any = part
        if isinstance(at, list):
            key = _entry_index(at, part, location)
        elif not isinstance(at, dict):
            raise ValueError(f"{location} does not exist: {key_path(path[:depth])} is {abbreviated(at)}")
        elif isinstance(part, int):
            raise ValueError(f"{location} does not exist: {key_path(path[:depth])} is no list")
        if depth == len(path) - 1:
            at[key] = value
        else:
            at = at[key] if isinstance(at, list) else at.setdefault(key, {})


def _entry_index(entries: list[Any], part: str | int, location: str) -> int:
    """Returns the index of an entry of a list, given by its index or its name."""
    if isinstance(part, int):
        if part >= len(entries):
            raise ValueError(f"{location} does not exist: the list has {len(entries)} entries")
        return part
    names = [entry.get("name") if isinstance(entry, dict) else None for entry in entries]
    if part not in names:
        available = [name for name in names if isinstance(name, str)]
        there = f"; there are: {', '.join(available[:20]) or 'none with a name'}"
        raise ValueError(
            f"{location} does not exist: no entry has this name{suggestion(part, available) or there}"
        )
    return names.index(part)


@dataclass
class ExperimentParts:
    """The valid parts of an experiment, which may have problems elsewhere.

    Attributes:
        entries: Valid entries of each section, by number.
        damaged: Invalid entries of each section that are tables, as in the file.
        names: Names of all entries of each section, valid or not; references to them are not reported.
        unnamed: Sections with an entry without a name; any reference may refer to it.
        variation: The valid variations.
        settings: All settings. With problems, only those that are in no section, with defaults instead of invalid
            ones; ``None`` if the time step or the duration is invalid.
        envs: Number of environments; ``None`` if it is invalid.
    """

    entries: dict[str, dict[int, Any]] = field(default_factory=lambda: {section: {} for section in SECTIONS})
    damaged: dict[str, dict[int, Mapping[str, Any]]] = field(
        default_factory=lambda: {section: {} for section in SECTIONS}
    )
    names: dict[str, set[str]] = field(default_factory=lambda: {section: set() for section in SECTIONS})
    unnamed: set[str] = field(default_factory=set)
    variation: dict[str, VariationSettings] = field(default_factory=dict)
    settings: Settings | None = None
    envs: int | None = None

    @classmethod
    def from_settings(cls, settings: Settings) -> "ExperimentParts":
        """Returns all parts of a valid experiment."""
        parts = cls(variation=dict(settings.variation), settings=settings, envs=settings.envs)
        for section in SECTIONS:
            parts.entries[section] = dict(enumerate(getattr(settings, section)))
            parts.names[section] = {entry.name for entry in getattr(settings, section)}
        return parts

    @classmethod
    def from_invalid(cls, raw: Mapping[str, Any], wrong: Set[Any], user_files: UserFiles) -> "ExperimentParts":
        """Returns the valid parts of ``raw``; ``wrong`` are the keys of its first level with a problem."""
        parts = cls()
        for section in SECTIONS:
            entries = raw.get(section, ())
            if not isinstance(entries, list | tuple):
                entries = [entries]
            for i, entry in enumerate(entries):
                name = entry.get("name") if isinstance(entry, dict) else None
                if isinstance(name, str):
                    parts.names[section].add(name)
                else:
                    parts.unnamed.add(section)
                entry_settings = _validated_entry(section, entry, user_files)
                if entry_settings is not None:
                    parts.entries[section][i] = entry_settings
                elif isinstance(entry, dict):
                    parts.damaged[section][i] = entry
        variation = raw.get("variation")
        for name, entry in variation.items() if isinstance(variation, dict) else ():
            entry_settings = _validated(VariationSettings, entry, user_files)
            if entry_settings is not None:
                parts.variation[name] = entry_settings
        left_out = {*SECTIONS, "variation", *wrong}
        if "variation" in wrong:
            # The number of samples and the parameters that can be correlated are unknown.
            left_out |= {"sampling", "correlation"}
        rest = {key: value for key, value in raw.items() if key not in left_out}
        parts.settings = _validated(Settings, rest, user_files)
        if "envs" not in wrong:
            parts.envs = raw.get("envs", grid_size(parts.variation))
        return parts

    def may_refer_to(self, name: str) -> bool:
        """Whether ``name`` is, or may be, the name of an entry of any section."""
        # A surface contact or contact coupling creates elements whose names begin with its own.
        prefixes = self.names["surface_contact"] | self.names["contact_coupling"]
        if any(name.startswith(f"{whole}_") for whole in prefixes):
            return True
        return bool(self.unnamed) or any(name in names for names in self.names.values())

    def __iter__(self) -> Iterator[tuple[str, str, Any]]:
        """Iterates over section, key and entry, in the order in which elements are added to the scene."""
        for section in SECTIONS:
            for i, entry in self.entries[section].items():
                yield section, f"{section}[{i}]", entry


def _validated_entry(section: str, entry: Any, user_files: UserFiles) -> Any:
    try:
        model = entry_model(section, entry, user_files)
    except ValueError:
        return None
    return _validated(model, entry, user_files)


def _validated(model: type[Section], raw: Any, user_files: UserFiles) -> Any:
    try:
        return model.model_validate(raw, context=user_files)
    except ValidationError:
        return None


def load_toml(path: Path) -> dict[str, Any]:
    """Reads a TOML file.

    Raises:
        ExperimentError: If it cannot be read, or is not valid TOML; the message has line and column.
    """
    try:
        return tomllib.loads(read_file(path).decode("utf-8-sig"))
    except FileNotFoundError:
        problem = "there is no such file"
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}"
    except UnicodeDecodeError as error:
        problem = f"byte {error.start} is not UTF-8 text"
    except RecursionError:
        problem = "lists or tables are nested too deeply"
    except tomllib.TOMLDecodeError as error:
        place = re.fullmatch(r"(.*) \(at (.*)\)", str(error), re.DOTALL)
        what, where = place.groups() if place else (str(error), "not valid TOML")
        problem = f"{where}: {what}"
    raise ExperimentError(str(path), [problem])


def read_settings(raw: Mapping[str, Any], user_files: UserFiles, problems: Problems) -> ExperimentParts:
    """Validates form and ranges of all entries of ``raw``; returns the valid ones.

    Args:
        raw: The content of an experiment file.
        user_files: Files with user-defined laws.
        problems: Receives the problems.

    Raises:
        TrustError: If it names law files of a run folder that are not trusted.
    """
    user_files.check_trusted(raw)
    for section in SECTIONS:
        entries = raw.get(section, ())
        for i, entry in enumerate(entries if isinstance(entries, list | tuple) else ()):
            if isinstance(entry, dict) and isinstance(entry.get("name"), str):
                problems.names[f"{section}[{i}]"] = entry["name"]
    try:
        settings = Settings.model_validate(dict(raw), context=user_files)
        if "envs" in raw:
            return ExperimentParts.from_settings(settings)
        size = grid_size(settings.variation)
        if size > MOST_ENVS:
            problems.add("variation", f": grid must have at most {MOST_ENVS} combinations, got {size}")
            size = 1
        return ExperimentParts.from_settings(settings.model_copy(update={"envs": size}))
    except ValidationError as failure:
        errors = failure.errors(include_url=False)
    places = {error["loc"] for error in errors}
    for error in errors:
        # If a point has "positions", its missing "position" is not reported: the section is wrong.
        if error["type"] != "missing" or (*error["loc"][:-1], "positions") not in places:
            _explain(error, raw, user_files, problems)
    return ExperimentParts.from_invalid(raw, {error["loc"][0] for error in errors}, user_files)


def _explain(error: Any, raw: Mapping[str, Any], user_files: UserFiles, problems: Problems) -> None:
    """Adds the message for an error of pydantic."""
    kind, location, value = error["type"], error["loc"], error["input"]
    path = key_path(location)
    if kind == "missing":
        meaning = table_at(location[:-1], raw, user_files).model_fields[location[-1]].description
        problems.add(path, f"is missing{f': {meaning}' if meaning else ''}")
    elif kind == "extra_forbidden" and _is_nested_name(location, value):
        name = ".".join(_nested_name(location[1:], value))
        problems.add(path, f'must be one name in quotes: "{name}" = {{ … }}')
    elif kind == "extra_forbidden" and location[0] in _PLURALS and location[-1] == "positions":
        problems.add(path, f"is not known{_several(location[0])}")
    elif kind == "extra_forbidden":
        keys = list(table_at(location[:-1], raw, user_files).model_fields)
        if (new := present_name(location[-1], keys)) is not None:
            problems.add(path, f"is now {key_path((*location[:-1], new))}")
            return
        problems.add(path, f"is not known{suggestion(location[-1], keys) or '; allowed: ' + ', '.join(keys)}")
    elif kind == "value_error":
        prefixes = location[0] in _PLURALS and location[-1] == "position" and _is_list_of_lists(value)
        problems.add(path, f"{error['ctx']['error']}{_several(location[0]) if prefixes else ''}")
    elif kind == "greater_than_equal":
        problems.add(path, f"must be at least {error['ctx']['ge']}, got {abbreviated(value)}")
    elif kind == "less_than_equal":
        problems.add(path, f"must be at most {error['ctx']['le']}, got {abbreviated(value)}")
    elif kind in _KINDS:
        what = f"a list of tables, [[{path}]]" if path in SECTIONS or path in LISTS else _KINDS[kind]
        listed = location[0] == "variation" and isinstance(value, list | tuple)
        problems.add(path, f"must be {what}, got {abbreviated(value)}{_VALUES if listed else ''}")
    else:
        problems.add(path, f": {error['msg']}, got {abbreviated(value)}")


def _several(section: str) -> str:
    """Returns advice to use the plural of ``section`` for a list of positions."""
    return f"; a list of positions belongs into [[{_PLURALS[section]}]], as positions"


def _is_list_of_lists(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and isinstance(value[0], list | tuple)


def _is_nested_name(location: Sequence[str | int], value: Any) -> bool:
    """Whether TOML parsed a dotted parameter name as nested tables."""
    return location[0] == "variation" and "." not in str(location[1]) and isinstance(value, dict)


def _nested_name(location: Sequence[str | int], value: Any) -> list[str]:
    """Returns the parts of a dotted name that was parsed as nested tables."""
    names = [str(part) for part in location]
    while isinstance(value, dict) and value and not set(value) & set(VariationSettings.model_fields):
        key, value = next(iter(value.items()))
        names.append(key)
    return names
