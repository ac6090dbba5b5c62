"""Collects the problems of an experiment, each with its key in the file, for one error message."""

import json
import re
from collections.abc import Iterable, Mapping
from typing import Any

from warpcontact.kernels.catalogue.names import suggestion
from warpcontact.validation.safe_text import escape_controls

# Largest number of problems in a message: more of them usually have a common cause.
PROBLEMS_SHOWN = 40
# Largest number of characters of a quoted value.
VALUE_LENGTH = 60

_ELEMENT = re.compile(r"\w+\[\d+\]")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


class ExperimentError(ValueError):
    """An experiment that cannot be read or run.

    Attributes:
        source: Name of the file or of the experiment.
        problems: One sentence each, beginning with the key, such as ``body[0].mass must be …``. The message also has
            the name of the element: ``body[0] ('ball').mass must be …``.
    """

    def __init__(self, source: str, problems: Iterable[str], names: Mapping[str, str] | None = None) -> None:
        self.source = source
        self.problems = tuple(problems)
        abbreviated = [_with_element_name(problem, names or {}) for problem in self.problems[:PROBLEMS_SHOWN]]
        if len(self.problems) == 1:
            super().__init__(escape_controls(f"{source}: {abbreviated[0]}"))
            return
        lines = [f"{source} has {len(self.problems)} problems:", *(f"  - {problem}" for problem in abbreviated)]
        if len(self.problems) > len(abbreviated):
            lines.append(f"  … and {len(self.problems) - len(abbreviated)} more")
        super().__init__(escape_controls("\n".join(lines)))


def _with_element_name(problem: str, names: Mapping[str, str]) -> str:
    """Returns ``problem`` with the name of the element after its number."""
    place = _ELEMENT.match(problem)
    if place is None or place[0] not in names or problem.startswith(f"{place[0]}.name"):
        return problem
    return f"{place[0]} ({abbreviated(names[place[0]])}){problem[place.end() :]}"


class Problems:
    """Collects the problems of an experiment.

    Attributes:
        lines: The problems.
        names: Names of the elements by their key, such as ``body[0]``.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.names: dict[str, str] = {}

    def __bool__(self) -> bool:
        return bool(self.lines)

    def add(self, path: str, message: str) -> None:
        """Adds ``message`` about ``path``; one that begins with ``[``, ``.`` or ``:`` continues the path."""
        space = "" if message[:1] in "[.: " else " "
        # Indent lists within a message, such as the defects of a mesh.
        self.lines.append(f"{path}{space}{message}".replace("\n", "\n    "))

    def add_unknown_name(self, path: str, value: str, kind: str, available: Iterable[str]) -> None:
        """Adds that ``value`` is not the name of a ``kind``, with the most similar name or all that are available."""
        names = list(dict.fromkeys(available))
        hint = suggestion(value, names) or f"; there are: {', '.join(names[:20]) or 'none'}"
        self.add(path, f"must be the name of a {kind}, got {abbreviated(value)}{hint}")

    def raise_if_any(self, source: str) -> None:
        """Raises ``ExperimentError`` if there is any problem."""
        if self.lines:
            raise ExperimentError(source, dict.fromkeys(self.lines), self.names)


def key_path(location: Iterable[str | int]) -> str:
    """Returns a location as a key path of TOML: ``variation."ball.mass".uniform[0]``."""
    path = ""
    for part in location:
        if isinstance(part, int):
            path += f"[{part}]"
        else:
            key = part if _BARE_KEY.fullmatch(part) else json.dumps(part, ensure_ascii=False)
            path += f".{key}" if path else key
    return path


def abbreviated(value: Any) -> str:
    """Returns ``repr(value)`` for a message, shortened to ``VALUE_LENGTH`` characters."""
    text = repr(value)
    return text if len(text) <= VALUE_LENGTH else f"{text[: VALUE_LENGTH - 2]} …"
