"""Records of what counts of a run, read as if somebody else had written them: nothing in them is trusted."""

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
#: In ``COMMITS``: the files that the store was made with.
MADE = "store.json"

#: The groups, of parameters, outcomes, sensors over time, and events.
GROUPS = ("params", "outcome", "series", "events")

#: Most axes of an array.
AXES = 8

#: Size [bytes] and SHA-256 of files of the store, by their path.
Files = dict[str, tuple[int, str]]

_RECORD = re.compile(r"shard_(?:\d{6}|[1-9]\d{6,})\.json")
# Files of the store as records name them: nothing outside of it has such a name.
_VARIABLE = rf"(?:{'|'.join(GROUPS)})/(?!\.\.?/)[^/\\\0]+"
_PLACE = r"(?:/[0-9]{1,10})"
_CHUNK = re.compile(rf"{_VARIABLE}/c{_PLACE}{{1,{AXES}}}")
_CHUNK_FOLDER = re.compile(rf"(?:{'|'.join(GROUPS)})|{_VARIABLE}(?:/c{_PLACE}{{0,{AXES - 1}}})?")
_MADE = re.compile(rf"(?:(?:{'|'.join(GROUPS)}|{_VARIABLE})/)?zarr\.json|{_VARIABLE}/c{_PLACE}{{0,{AXES}}}")
_SHA = re.compile(r"[0-9a-f]{64}")
# Numbers beyond this fit into no array.
_MOST = 2**63 - 1
_COUNTS = ("steps", "frames", "frozen")


class RunDataError(SafeTextError):
    """A folder of results that is damaged, or was changed by somebody else."""


@dataclass
class Commit:
    """What is committed of a shard.

    Attributes:
        shard: Number of the shard.
        steps: How many steps were taken.
        frames: How many frames of the series are in the store.
        finished: Whether these are all, and the outcome is there.
        checkpoint: Name of the file from which the shard goes on; ``None``: it is finished.
        wall_time: How long it was stepped, over all attempts [s].
        files: Size [bytes] and SHA-256 of each file of the store that belongs to it, by its path.
        frozen: How many of its environments are frozen.
        checkpoint_sha256: SHA-256 of that file; ``None``: it is finished, or of an earlier version.
        empty: Chunks that have no file, as all their values are empty; ``None``: a record of an earlier version.
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
            RunDataError: If it is cut off, or holds what no run writes; names the entry, the value and what is
                allowed.
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
    """Returns the records of shards in a folder, by their numbers.

    Raises:
        RunDataError: If one of them is damaged.
    """
    paths = (folder / name for name in folder.names() if _RECORD.fullmatch(name))
    return {commit.shard: commit for commit in map(Commit.read, paths)}


def is_chunk(name: str) -> bool:
    """Whether a file of the store is a chunk, by its path."""
    return bool(_CHUNK.fullmatch(name))


def is_chunk_folder(name: str) -> bool:
    """Whether chunks can be in a folder of the store or below it, by its path."""
    return bool(_CHUNK_FOLDER.fullmatch(name))


def created_files(folder: RunPath) -> Files:
    """Returns the files that the store was made with, by the record of them in a folder.

    Raises:
        RunDataError: If this is missing or damaged.
    """
    path = folder / MADE
    return _files(path, _content(path, ["files"])["files"], _MADE)


def digest(path: RunPath) -> str:
    """Returns the SHA-256 of a file."""
    with path.open_binary() as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def is_unchanged(path: RunPath, size: int | None, sha: str) -> bool:
    """Whether a file is there, with this content; its size tells faster, where it is known, that it is not."""
    try:
        return size in (None, path.size()) and digest(path) == sha
    except FileNotFoundError:
        return False


def _content(path: RunPath, entries: Iterable[str], later: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Returns the entries of a record; ``later`` stands for those that earlier versions did not write."""
    try:
        content = json.loads(path.read())
    except FileNotFoundError:
        raise RunDataError(f"{path}: is missing, which says what counts") from None
    except UnsafeFileError as error:
        raise RunDataError(str(error)) from None
    except (OSError, ValueError, RecursionError) as error:
        raise RunDataError(f"{path}: is no whole record of a commit: {error}") from None
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
