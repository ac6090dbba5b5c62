"""Files of a run folder: checks whether a folder may be used, locks it, and writes ``run.json``.

The system releases the lock when a process ends.
"""

import contextlib
import json
import os
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from warpcontact._version import __version__
from warpcontact.experiment.errors import ExperimentError, abbreviated
from warpcontact.experiment.records import COMMITS, DATA, STAGING
from warpcontact.experiment.store import CHECKPOINTS
from warpcontact.files.atomic_files import write_json
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import EXPERIMENT, PARTIAL, SUMMARY, RunPath

#: Number of attempts to acquire the lock.
LOCK_ATTEMPTS = 5

ANIMATION = "animation.usdc"
PICTURE = "picture.png"
PROGRESS = "progress"

#: Schema version of run folders; increased when earlier folders can no longer be read.
SCHEMA = 2

# Values of ``state`` in run.json. A run that was killed stays unfinished.
FINISHED = "finished"
UNFINISHED = "unfinished"
INTERRUPTED = "interrupted"
FAILED = "failed"
STATES = (FINISHED, UNFINISHED, INTERRUPTED, FAILED)

#: Entry of run.json: the SHA-256 of the copied law files, by name.
LAW_FILES = "law_files"

# Required and optional entries of run.json, by type.
_WHOLE = ("envs", "shard", "shards", "block", "steps")
_TIMES = ("dt", "duration")
_TABLES = ("law_files", "failed", "contact_couplings")
_TEXTS = ("state", "name", "device", "fingerprint")
# Largest number of environments and steps: the largest 32-bit integer.
_MOST = 2**31 - 1


try:
    import fcntl
except ImportError:  # Windows has no locks on folders
    fcntl = None  # type: ignore[assignment]


@contextlib.contextmanager
def write_lock(folder: Path) -> Iterator[None]:
    """Locks an existing ``folder`` against writing by other processes, until the block is left.

    There is no lock on Windows and on file systems without locks.

    Raises:
        ExperimentError: If another process holds the lock.
    """
    with _opened(folder) as opened:
        # Retry, because ``is_locked`` holds a shared lock for a short time.
        for _ in range(LOCK_ATTEMPTS):
            if _lock(opened, exclusive=True):
                break
            time.sleep(0.05)
        else:
            raise locked_error(folder)
        yield


def is_locked(folder: Path) -> bool:
    """Whether a process is writing into ``folder``."""
    if not folder.is_dir():
        return False
    with _opened(folder) as opened:
        return not _lock(opened, exclusive=False)


def locked_error(folder: Path) -> ExperimentError:
    """Returns the error that a process is writing into ``folder``."""
    return ExperimentError(str(folder), ["another process is running and writes there"])


@contextlib.contextmanager
def _opened(folder: Path) -> Iterator[int | None]:
    with RunPath(folder).opened() as (_, opened):  # closing the folder releases the lock
        yield None if fcntl is None else opened


def _lock(opened: int | None, *, exclusive: bool) -> bool:
    """Acquires the lock without waiting; returns False if another process holds it.

    The folder itself is locked, by its descriptor: a lock file, as of the package filelock, could be a planted link,
    would remain in the folder, and could not be created to query a folder that cannot be written.
    """
    if opened is None:
        return True
    try:
        fcntl.flock(opened, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def check_usable(folder: Path, *, overwrite: bool, resume: bool) -> None:
    """Raises ``ExperimentError`` unless a run may start in ``folder``, or with ``resume`` continue there."""
    if not resume:
        check_new(folder, overwrite)
        return
    if is_locked(folder):
        raise locked_error(folder)
    check_started(folder)


def check_new(folder: Path, overwrite: bool) -> None:
    """Raises ``ExperimentError`` unless a new run may use ``folder``.

    The folder may be new or empty, or hold an unfinished run without commits; with ``overwrite``, any earlier run.
    """
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise ExperimentError(str(folder), ["is not a folder"])
    # A run that was killed while it wrote its first file leaves only the partial file.
    if set(RunPath(folder).names()) <= {f"{SUMMARY}{PARTIAL}"}:
        return
    summary = read_summary(folder)
    if summary is None:
        raise ExperimentError(str(folder), ["is not empty and holds no earlier run; choose a new folder"])
    if is_locked(folder):
        raise locked_error(folder)
    if not overwrite and (summary.get("state") not in (UNFINISHED, INTERRUPTED, FAILED) or has_commits(folder)):
        kind = "an earlier run" if summary.get("state") == FINISHED else "a run that did not finish"
        resume = "" if summary.get("state") == FINISHED else ", or resume it (--resume)"
        raise ExperimentError(
            str(folder), [f"holds {kind}; choose another folder, or overwrite it (--overwrite){resume}"]
        )


def check_replaced(folder: Path, files: Mapping[str, bytes]) -> None:
    """Raises ``ExperimentError`` if one of ``files``, by name, would replace a file of the user in ``folder``."""
    for name in files.keys() - law_files(read_summary(folder)):
        if (RunPath(folder) / name).exists():
            raise ExperimentError(str(folder), [f"holds a file {name!r} of the user, which the run would replace"])


def check_started(folder: Path) -> dict[str, Any]:
    """Returns the content of ``run.json`` of a run that can be resumed.

    Raises:
        ExperimentError: If there is none, or its schema is not supported.
    """
    summary = read_summary(folder)
    if summary is None:
        raise ExperimentError(str(folder), ["holds no run to resume; start one without --resume"])
    check_schema(folder, summary)
    if not (RunPath(folder) / DATA).is_folder():
        raise ExperimentError(
            str(folder), ["the run ended before anything was saved; start it again without --resume"]
        )
    return summary


def check_schema(folder: Path, summary: Mapping[str, Any]) -> None:
    """Raises ``ExperimentError`` unless ``run.json`` has the schema of this version and valid entries."""
    schema, source = summary.get("schema"), str(folder / SUMMARY)
    if schema != SCHEMA:
        raise ExperimentError(
            source, [f"schema must be {SCHEMA}, got {abbreviated(schema)}, written by {summary.get('program')}"]
        )
    wrong = [f"{key} is missing" for key in (*_WHOLE, *_TIMES, *_TEXTS) if key not in summary]
    if wrong:
        raise ExperimentError(source, wrong)
    for key in _WHOLE:
        value = summary[key]
        if not (isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= _MOST):
            wrong.append(f"{key} must be a whole number from 1 to {_MOST}, got {abbreviated(value)}")
    for key in _TIMES:
        value = summary[key]
        if not (isinstance(value, int | float) and not isinstance(value, bool) and 0.0 < value < float("inf")):
            wrong.append(f"{key} must be a time above 0 s, got {abbreviated(value)}")
    wrong += [
        f"{key} must be a text, got {abbreviated(summary[key])}"
        for key in _TEXTS
        if not isinstance(summary[key], str)
    ]
    for key in _TABLES:
        if not isinstance(summary.get(key, {}), dict):
            wrong.append(f"{key} must be a table, got {abbreviated(summary[key])}")
    if isinstance(summary["state"], str) and summary["state"] not in STATES:
        wrong.append(f"state must be one of {', '.join(STATES)}, got {abbreviated(summary['state'])}")
    if not wrong:
        count = -(-summary["envs"] // summary["shard"])
        if summary["shards"] != count:
            wrong.append(f"shards must be {count} for these envs and shard, got {summary['shards']}")
    if wrong:
        raise ExperimentError(source, wrong)


def read_summary(folder: Path) -> dict[str, Any] | None:
    """Returns the content of ``run.json``, or ``None`` if ``folder`` holds no run.

    Raises:
        UnsafeFileError: If the file is a link, a pipe or a device, or is too large.
    """
    try:
        summary = json.loads((RunPath(folder) / SUMMARY).read())
        return summary if str(summary["program"]).startswith("warpcontact ") else None
    except UnsafeFileError:
        raise
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Writes ``run.json``, which marks ``folder`` as a run folder."""
    write_json(RunPath(folder) / SUMMARY, {"program": f"warpcontact {__version__}", "schema": SCHEMA, **summary})


def has_commits(folder: Path) -> bool:
    """Whether the run in ``folder`` has committed any shard."""
    names = (RunPath(folder) / COMMITS).names()
    return any(name.startswith("shard_") and name.endswith(".json") for name in names)


def law_files(summary: Mapping[str, Any] | None) -> set[str]:
    """Returns the names of the law files that a run copied into its folder."""
    listed = (summary or {}).get(LAW_FILES)
    names = listed if isinstance(listed, dict) else ()
    # These files will be removed, so accept only names that a run can have written, even if run.json was changed.
    return {name for name in names if Path(name).name == name and name.endswith(".py")}


def clear(folder: Path) -> None:
    """Creates ``folder``, or removes the files of the earlier run in it; other files are unchanged."""
    run = RunPath(folder)
    run.make()
    run_files = (DATA, f"{DATA}{PARTIAL}", STAGING, CHECKPOINTS, COMMITS, PROGRESS, ANIMATION, PICTURE, EXPERIMENT)
    for name in (*run_files, *law_files(read_summary(folder)), SUMMARY):
        (run / name).remove()


def make_subfolders(folder: Path) -> None:
    """Creates the subfolders that a run writes into."""
    for name in (STAGING, CHECKPOINTS, COMMITS, PROGRESS):
        (RunPath(folder) / name).make()


def remove_work_subfolders(folder: Path) -> None:
    """Removes the subfolders that a finished run no longer needs."""
    for name in (STAGING, CHECKPOINTS, PROGRESS):
        with contextlib.suppress(OSError):
            (RunPath(folder) / name).remove()
