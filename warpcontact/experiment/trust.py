"""Which Python files of run folders may be run: those that a run of this user has copied, or that were trusted.

A run folder can come from elsewhere, with files of laws that run any code. The SHA-256 of each file that a run
copies into its folder is therefore recorded outside of it, as the name of an empty file in the state folder of the
user.
"""

import contextlib
import hashlib
import os
import warnings
from collections.abc import Collection, Iterable
from pathlib import Path

from warpcontact.validation.warning_levels import RunWarning, WarningLevel

#: ``True``: any file may be run; otherwise those with one of these SHA-256, next to those that are recorded.
Trust = bool | Collection[str]


def digest_of(content: bytes) -> str:
    """Returns the SHA-256 of the content of a file."""
    return hashlib.sha256(content).hexdigest()


def may_run(content: bytes, trust: Trust) -> bool:
    """Whether a file of a run folder may be run."""
    if isinstance(trust, bool):
        return trust or _is_recorded(digest_of(content))
    return digest_of(content) in trust or _is_recorded(digest_of(content))


def record(contents: Iterable[bytes]) -> None:
    """Records that files with these contents may be run; warns if that cannot be recorded."""
    for content in contents:
        if _is_recorded(digest_of(content)):
            continue
        try:
            folder = records()
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            (folder / digest_of(content)).touch(0o600)
        except (OSError, RuntimeError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            text = (
                f"the files with laws of this run could not be recorded as trusted: {reason}; to resume or draw "
                "it, use --trust"
            )
            warnings.warn(RunWarning(text, WarningLevel.CAUTION), stacklevel=2)
            return


def records() -> Path:
    """Returns the folder of records.

    Raises:
        RuntimeError: If the user has no home folder.
    """
    if os.name == "nt":
        given, default = os.environ.get("LOCALAPPDATA", ""), ("AppData", "Local")
    else:
        given, default = os.environ.get("XDG_STATE_HOME", ""), (".local", "state")
    base = Path(given) if os.path.isabs(given) else Path.home().joinpath(*default)
    return base / "warpcontact" / "trusted_laws"


def _is_recorded(sha: str) -> bool:
    with contextlib.suppress(OSError, RuntimeError):
        return (records() / sha).is_file()
    return False
