"""Warnings and their levels. Warning filters import this module, so it does not import kernels."""

import enum
import sys

from warpcontact.validation.safe_text import escape_controls


class WarningLevel(enum.StrEnum):
    """Level of a warning: its meaning for the results.

    NOTE: for information; results are as accurate as requested. CAUTION: results may be less accurate than the user
    expects, or an output is missing. ERROR: a part of the results is wrong or missing.
    """

    NOTE = "note"
    CAUTION = "caution"
    ERROR = "error"


class ContactWarning(UserWarning):
    """Warns that a scene can be simulated, but its results are probably not what the user expects.

    Args:
        message: The problem, its consequence, and the remedy.
        level: Meaning for the results, the attribute ``level``.
    """

    def __init__(self, message: str, level: WarningLevel = WarningLevel.CAUTION) -> None:
        super().__init__(escape_controls(message))
        self.level = level


class RunWarning(RuntimeWarning):
    """Warns of events of a run: failed environments, problems that were not solved, repeated shards.

    Args:
        message: The event, its consequence, and the remedy.
        level: Meaning for the results, the attribute ``level``.
    """

    def __init__(self, message: str, level: WarningLevel = WarningLevel.CAUTION) -> None:
        super().__init__(escape_controls(message))
        self.level = level


def labeled(warning: Warning | str) -> str:
    """Returns the text of a warning prefixed with its level, such as ``caution: …``, which is the default level."""
    return escape_controls(f"{getattr(warning, 'level', WarningLevel.CAUTION)}: {warning}")


def split_label(text: str) -> tuple[WarningLevel, str]:
    """Returns level and text of a result of ``labeled``; text without a level is a caution."""
    level, colon, rest = text.partition(": ")
    if colon and level in list(WarningLevel):
        return WarningLevel(level), rest
    return WarningLevel.CAUTION, text


def caller_stacklevel() -> int:
    """Returns the ``stacklevel`` for a warning in the caller that refers to the code outside of this package."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_globals["__name__"].partition(".")[0] == "warpcontact":
        level, frame = level + 1, frame.f_back
    return level
