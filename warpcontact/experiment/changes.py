"""Applies overrides ``PATH=VALUE`` to the content of an experiment file."""

import copy
import re
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

from warpcontact.experiment.errors import ExperimentError, abbreviated, key_path
from warpcontact.kernels.catalogue.names import suggestion

# A bare key, a quoted key, or the number of an entry, as in messages.
_PART = re.compile(
    r"\.?(?:(?P<bare>[A-Za-z0-9_-]+)|(?P<quoted>\"(?:[^\"\\]|\\.)*\"|'[^']*')|\[(?P<number>[0-9]{1,9})\])"
)


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
