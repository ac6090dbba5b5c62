"""Values that stand in for those of an experiment file, given as ``PATH=VALUE``."""

import copy
import re
import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

from warpcontact.experiment.errors import ExperimentError, abbreviated, key_path
from warpcontact.kernels.catalogue.names import suggestion

# A bare key, one in quotes, or the number of an entry, as messages write them.
_PART = re.compile(
    r"\.?(?:(?P<bare>[A-Za-z0-9_-]+)|(?P<quoted>\"(?:[^\"\\]|\\.)*\"|'[^']*')|\[(?P<number>[0-9]{1,9})\])"
)


def apply_overrides(content: Mapping[str, Any], changes: Iterable[str]) -> dict[str, Any]:
    """Returns the content of an experiment file with other values.

    Args:
        content: The content.
        changes: Texts ``PATH=VALUE``, the last of a path counts. A path is written as messages do,
            ``body[0].mass`` or ``variation."ball.mass".uniform``; entries of a list may be named, too:
            ``body.ball.mass``. Tables that are missing are made. The value is one of TOML.

    Raises:
        ExperimentError: If one of them is no such text, or its path leads nowhere.
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
    """Returns path and value of a text."""
    change, place = change.strip(), 0
    path: list[str | int] = []
    while place < len(change) and (part := _PART.match(change, place)) is not None:
        if (part[0][0] == ".") != (bool(path) and part["number"] is None):
            break
        if part["number"] is not None:
            path.append(int(part["number"]))
        else:
            path.append(part["bare"] or tomllib.loads(f"key = {part['quoted']}")["key"])
        place = part.end()
    key, equals, text = change[place:].partition("=")
    if not path or isinstance(path[0], int) or not equals or key.strip():
        raise ValueError('must be PATH=VALUE, with a path such as body[0].mass or variation."ball.mass".uniform')
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (tomllib.TOMLDecodeError, RecursionError):
        parsed = {}
    # What goes on in another line is no value.
    if list(parsed) != ["value"]:
        hint = (
            f"; a text stands in quotes: '{key_path(path)}=\"{text.strip()}\"'" if text.strip().isalnum() else ""
        )
        raise ValueError(f"{key_path(path)} must be a value of TOML, got {abbreviated(text)}{hint}")
    return path, parsed["value"]


def _set_value(content: dict[str, Any], path: list[str | int], value: Any) -> None:
    """Puts ``value`` where ``path`` leads to in ``content``."""
    at: Any = content
    for depth, part in enumerate(path):
        run_in_process = key_path(path[: depth + 1])
        key: Any = part
        if isinstance(at, list):
            key = _entry_index(at, part, run_in_process)
        elif not isinstance(at, dict):
            raise ValueError(f"{run_in_process} leads nowhere: {key_path(path[:depth])} is {abbreviated(at)}")
        elif isinstance(part, int):
            raise ValueError(f"{run_in_process} leads nowhere: {key_path(path[:depth])} is no list")
        if depth == len(path) - 1:
            at[key] = value
        else:
            at = at[key] if isinstance(at, list) else at.setdefault(key, {})


def _entry_index(entries: list[Any], part: str | int, run_in_process: str) -> int:
    """Returns the number of an entry of a list that is given by it or by its name."""
    if isinstance(part, int):
        if part >= len(entries):
            raise ValueError(f"{run_in_process} is not there: the list has {len(entries)} entries")
        return part
    names = [entry.get("name") if isinstance(entry, dict) else None for entry in entries]
    if part not in names:
        available = [name for name in names if isinstance(name, str)]
        there = f"; there are: {', '.join(available[:20]) or 'none with a name'}"
        raise ValueError(
            f"{run_in_process} is not there: no entry has this name{suggestion(part, available) or there}"
        )
    return names.index(part)
