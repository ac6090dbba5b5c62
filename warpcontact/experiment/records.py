"""Reads and validates the records of commits, without trusting their content.

``commit/store.json`` names the files of the empty store, ``commit/<shard>.json`` those of a shard, with sizes and
SHA-256. Names are restricted to paths inside of the store.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from warpcontact.experiment.errors import abbreviated
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import RunPath
from warpcontact.validation.safe_text import SafeTextError

DATA = "data.zarr"
COMMITS = "commit"
#: Folder of chunks that are written and not committed.
STAGING = "staging"
#: File in ``COMMITS`` that lists the files of the empty store.
MADE = "store.json"

#: Groups of the store: parameters, outcomes, sensors over time, and events.
GROUPS = ("params", "outcome", "series", "events")

#: Largest number of axes of an array.
AXES = 8

#: Size [bytes] and SHA-256 of files of the store, by their path.
Files = dict[str, tuple[int, str]]

_RECORD = re.compile(r"shard_(?:\d{6}|[1-9]\d{6,})\.json")
# Names of files of the store in records: no path outside of the store matches.
_VARIABLE = rf"(?:{'|'.join(GROUPS)})/(?!\.\.?/)[^/\\\0]+"
_PLACE = r"(?:/[0-9]{1,10})"
_CHUNK = re.compile(rf"{_VARIABLE}/c{_PLACE}{{1,{AXES}}}")
_CHUNK_FOLDER = re.compile(rf"(?:{'|'.join(GROUPS)})|{_VARIABLE}(?:/c{_PLACE}{{0,{AXES - 1}}})?")
_MADE = re.compile(rf"(?:(?:{'|'.join(GROUPS)}|{_VARIABLE})/)?zarr\.json|{_VARIABLE}/c{_PLACE}{{0,{AXES}}}")
_SHA = re.compile(r"[0-9a-f]{64}")
# Upper bound on counts: the largest 64-bit integer.
_MOST = 2**63 - 1
_COUNTS = ("steps", "frames", "frozen")


class RunDataError(SafeTextError):
    """The results of a run are damaged or were changed."""


@dataclass
class Commit:
    """Commit of a shard: its progress and files.

    Attributes:
        shard: Number of the shard.
        steps: Number of committed steps.
        frames: Number of committed frames of the series.
        finished: Whether all steps and frames, and the outcomes, are committed.
        checkpoint: Name of the checkpoint from which the shard resumes; ``None``: the shard is finished.
        wall_time: Wall time of stepping over all attempts [s].
        files: Size [bytes] and SHA-256 of each file of the shard in the store, by path.
        frozen: Number of frozen environments.
        checkpoint_sha256: SHA-256 of the checkpoint; ``None``: the shard is finished, or the record is of an earlier
            version.
        empty: Chunks without a file, because all their values are the fill value; ``None``: the record is of an
            earlier version.
    """

    shard: int
    steps: int = 0
    frames: int = 0
    finished: bool = False
    checkpoint: str | None = None
    wall_time: float = 0.0
    files: Files = field(default_factory=dict)
    frozen: int = 0
    checkpoint_sha256: str | None = None
    empty: list[str] | None = field(default_factory=list)

    @classmethod
    def read(cls, path: RunPath) -> "Commit":
        """Reads a record.

        Raises:
            RunDataError: If it is truncated or invalid; the message names the entry, its value and the condition.
        """
        entries = [one.name for one in fields(cls)]
        content = _content(path, entries, {"checkpoint_sha256": None, "empty": None})
        number = int(path.stem.rpartition("_")[2])
        finished = content["finished"] is True
        checkpoint, time, sha = content["checkpoint"], content["wall_time"], content["checkpoint_sha256"]
        can_resume = isinstance(checkpoint, str) and re.fullmatch(rf"{path.stem}-\d{{12,}}\.npz", checkpoint)
        is_time = isinstance(time, int | float) and not isinstance(time, bool) and 0.0 <= time < float("inf")
        rules = {
            "shard": (_is_count(content["shard"]) and content["shard"] == number, f"{number}, as in its name"),
            **{key: (_is_count(content[key]), f"a whole number from 0 to {_MOST}") for key in _COUNTS},
            "finished": (isinstance(content["finished"], bool), "true or false"),
            "checkpoint": (
                checkpoint is None if finished else bool(can_resume),
                "null in a finished shard" if finished else f"the name of a file {path.stem}-<steps>.npz",
            ),
            "wall_time": (is_time, "a time of at least 0 s"),
            "checkpoint_sha256": (
                sha is None or (not finished and isinstance(sha, str) and bool(_SHA.fullmatch(sha))),
                "null in a finished shard" if finished else "null, or a SHA-256 in 64 hexadecimal digits",
            ),
        }
        empty = content["empty"]
        rules["empty"] = (
            empty is None
            or (isinstance(empty, list) and all(isinstance(one, str) and _CHUNK.fullmatch(one) for one in empty)),
            f"a list of chunks that a run writes into {DATA}",
        )
        for key, (holds, allowed) in rules.items():
            if not holds:
                raise RunDataError(f"{path}: {key} must be {allowed}, got {abbreviated(content[key])}")
        return cls(**content | {"files": _files(path, content["files"], _CHUNK)})


def commits_in(folder: RunPath) -> dict[int, Commit]:
    """Returns the commits of shards in a folder, by shard number.

    Raises:
            RunDataError: If a record is damaged.
    """
    paths = (folder / name for name in folder.names() if _RECORD.fullmatch(name))
    return {commit.shard: commit for commit in map(Commit.read, paths)}


def is_chunk(name: str) -> bool:
    """Whether a path of the store is that of a chunk."""
    return bool(_CHUNK.fullmatch(name))


def is_chunk_folder(name: str) -> bool:
    """Whether a path of the store is that of a folder that may contain chunks, directly or in subfolders."""
    return bool(_CHUNK_FOLDER.fullmatch(name))


def created_files(folder: RunPath) -> Files:
    """Returns the files of the empty store, from their record in a folder.

    Raises:
        RunDataError: If the record is missing or damaged.
    """
    path = folder / MADE
    return _files(path, _content(path, ["files"])["files"], _MADE)


def digest(path: RunPath) -> str:
    """Returns the SHA-256 of a file."""
    with path.open_binary() as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_unchanged(path: RunPath, size: int | None, sha: str) -> bool:
    """Whether a file exists with this SHA-256; ``size`` allows a faster negative answer, ``None``: unknown."""
    try:
        return size in (None, path.size()) and digest(path) == sha
    except FileNotFoundError:
        return False


def _content(path: RunPath, entries: Iterable[str], later: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Returns the entries of a record; ``later`` has defaults of entries that earlier versions do not write."""
    try:
        content = json.loads(path.read())
    except FileNotFoundError:
        raise RunDataError(f"{path}: is missing; it lists the committed files") from None
    except UnsafeFileError as error:
        raise RunDataError(str(error)) from None
    except (OSError, ValueError, RecursionError) as error:
        raise RunDataError(f"{path}: is not a complete record of a commit: {error}") from None
    if isinstance(content, dict):
        content = {**(later or {}), **content}
    if not isinstance(content, dict) or set(content) != set(entries):
        got = sorted(content) if isinstance(content, dict) else content
        raise RunDataError(f"{path}: must have the entries {', '.join(entries)}, got {abbreviated(got)}")
    return content


def _is_count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= _MOST


def _files(path: RunPath, files: object, allowed: re.Pattern[str]) -> Files:
    if not isinstance(files, dict):
        raise RunDataError(f"{path}: files must be a table, got {abbreviated(files)}")
    found: Files = {}
    for name, entry in files.items():
        if not allowed.fullmatch(name):
            raise RunDataError(
                f"{path}: files must name files that a run writes into {DATA}, got {abbreviated(name)}"
            )
        match entry:
            case [int(size), str(sha)] if _is_count(size) and _SHA.fullmatch(sha):
                found[name] = (size, sha)
            case _:
                raise RunDataError(
                    f"{path}: files.{name} must be a size in bytes and a SHA-256 in 64 hexadecimal digits, "
                    f"got {abbreviated(entry)}"
                )
    return found
