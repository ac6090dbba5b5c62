"""Decides which Python files of run folders may be executed: those copied by a run of this user, or trusted ones.

A run folder can come from elsewhere, with law files that contain any code. Therefore the SHA-256 of each file that a
run copies into its folder is recorded outside of it, as the name of an empty file in the state folder of the user.
"""

import contextlib
import hashlib
import os
import warnings
from collections.abc import Collection, Iterable
from pathlib import Path

from warpcontact.validation.warning_levels import RunWarning, WarningLevel

#: ``True``: any file may be executed; otherwise the recorded files, and those with one of these SHA-256.
Trust = bool | Collection[str]


def digest_of(content: bytes) -> str:
    """Returns the SHA-256 of the content of a file."""
    return hashlib.sha256(content).hexdigest()


def may_run(content: bytes, trust: Trust) -> bool:
    """Whether a file of a run folder may be executed."""
    if isinstance(trust, bool):
        return trust or _is_recorded(digest_of(content))
    return digest_of(content) in trust or _is_recorded(digest_of(content))


def record(contents: Iterable[bytes]) -> None:
    """Records that files with these contents may be executed; warns if they cannot be recorded."""
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
                f"the law files of this run could not be recorded as trusted: {reason}; to resume or render it, use "
                "--trust"
            )
            warnings.warn(RunWarning(text, WarningLevel.CAUTION), stacklevel=2)
            return


def records() -> Path:
    """Returns the folder with the recorded SHA-256.

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
