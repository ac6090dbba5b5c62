"""Writes settings as a TOML file, with vectors and nested tables on one line, unlike the package tomli-w."""

import json
import math
from collections.abc import Mapping
from typing import Any

from warpcontact.experiment.errors import key_path
from warpcontact.experiment.schema import LISTS, SECTIONS, Settings


def to_toml(settings: Settings, comment: str) -> str:
    """Returns ``settings``, including defaults, as TOML text that parses to the same settings.

    Args:
        settings: The settings.
        comment: Comment on the first line.
    """
    content = settings.model_dump(exclude_none=True)
    lines = [f"# {comment}"]
    lines += [_line(key, value) for key, value in content.items() if not isinstance(value, dict | tuple | list)]
    lines += [_line("gravity", content["gravity"])]
    for section in (*SECTIONS, *LISTS):
        for entry in content[section]:
            lines += ["", f"[[{section}]]", *(_line(key, value) for key, value in entry.items())]
    tables = ("variation", "sampling", "integrator", "outcome", "stop", "events", "quarantine", "record", "output")
    for table in tables:
        if content.get(table):
            lines += ["", f"[{table}]", *(_line(key, value) for key, value in content[table].items())]
    return "\n".join(lines) + "\n"


def _line(key: str, value: Any) -> str:
    return f"{key_path([key])} = {_value(value)}"


def _value(value: Any) -> str:
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
        return "{ " + ", ".join(_line(key, entry) for key, entry in value.items()) + " }"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(map(_value, value)) + "]"
    raise ValueError(f"no TOML value for {value!r}")
