"""Sanitizes text of unknown origin, such as names and paths in files of others, for terminals and messages."""

import contextlib
import io
import re
import sys
from collections.abc import Iterable, Iterator
from typing import Any, TextIO

# Control characters that terminals interpret, except newline and tab; marks that change the direction of text; and
# the line separators U+2028 and U+2029.
_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def escape_controls(text: object) -> str:
    """Returns a text with control characters, except newline and tab, as escapes of Python."""
    return _CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), str(text))


def escape_lines(lines: Iterable[object]) -> str:
    """Returns lines as one text; newlines within a line are escaped, so that quoted text adds no line."""
    return "\n".join(escape_controls(line).replace("\n", "\\n") for line in lines)


class SafeTextError(ValueError):
    """An error whose message may quote files; control characters in it are escaped."""

    def __init__(self, message: object) -> None:
        super().__init__(escape_controls(message))


class SafeTextStream:
    """A stream to a terminal that escapes control characters.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Writes a text; returns its length."""
        self.stream.write(escape_controls(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Writes texts one after the other."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextlib.contextmanager
def escape_output() -> Iterator[None]:
    """Escapes control characters in the output and error streams of this process.

    Characters that the encoding of the streams does not have are escaped as well, and raise no error.
    """
    out, err = sys.stdout, sys.stderr
    for stream in (out, err):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    with (
        contextlib.redirect_stdout(SafeTextStream(out)),
        contextlib.redirect_stderr(SafeTextStream(err)),
    ):
        yield


def terminal() -> TextIO:
    """Returns the original error stream, for progress bars, which move the cursor with control characters."""
    stream: Any = sys.stderr
    return stream.stream if isinstance(stream, SafeTextStream) else stream


def truncate(text: str, most: int, *, middle: bool = False) -> str:
    """Returns a text of at most ``most`` characters; … replaces the omitted part.

    Args:
        text: The text.
        most: Maximum number of characters, at least 1.
        middle: Whether to omit the middle, for example of paths; otherwise the end is omitted.
    """
    if len(text) <= most:
        return text
    after = (most - 1) // 2 if middle else 0
    return f"{text[: most - 1 - after]}…{text[len(text) - after :]}"


def single_line(text: object) -> str:
    """Returns a text with white space replaced by single spaces, and other control characters escaped."""
    return escape_controls(" ".join(str(text).split()))
