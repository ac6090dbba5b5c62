"""Fingerprints of experiments, which include the content of the files that they name, and their differences."""

import hashlib
import tomllib
from collections.abc import Iterator
from typing import Any

from warpcontact.experiment.errors import abbreviated, key_path
from warpcontact.experiment.folder import ExperimentCopy
from warpcontact.experiment.schema import Settings
from warpcontact.experiment.toml import to_toml
from warpcontact.files.run_folder import RunPath, open_file

# Largest number of reported differences.
MAX_REPORTED = 5


def fingerprint(copy: ExperimentCopy) -> str:
    """Returns the SHA-256 of an experiment, with the content of law, mesh and row files."""
    total = hashlib.sha256(_text(copy.settings).encode())
    for name, content in sorted(copy.files.items()):
        total.update(name.encode() + hashlib.sha256(content).digest())
    for path in copy.external:
        with open_file(path) as file:
            total.update(hashlib.file_digest(file, "sha256").digest())
    return total.hexdigest()


def differences(path: RunPath, settings: Settings) -> list[str]:
    """Returns the differences, as text, between the experiment file that a run has written and ``settings``."""
    try:
        stored = dict(_leaves(tomllib.loads(path.read().decode())))
    except (OSError, ValueError) as error:
        return [f"{path.name} cannot be read: {error}"]
    current = dict(_leaves(tomllib.loads(_text(settings))))
    differing = [
        f"{key_path(key)} is {_value_text(stored, key)} there, {_value_text(current, key)} here"
        for key in dict.fromkeys((*stored, *current))
        if stored.get(key) != current.get(key)
    ]
    return differing[:MAX_REPORTED] + (
        [f"and {len(differing) - MAX_REPORTED} more"] if len(differing) > MAX_REPORTED else []
    )


def _text(settings: Settings) -> str:
    return to_toml(settings, "")


def _value_text(leaves: dict[tuple[str | int, ...], Any], key: tuple[str | int, ...]) -> str:
    return abbreviated(leaves[key]) if key in leaves else "not given"


def _leaves(value: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _leaves(inner, (*place, key))
    elif isinstance(value, list) and any(isinstance(inner, dict) for inner in value):
        for i, inner in enumerate(value):
            yield from _leaves(inner, (*place, i))
    else:
        yield place, value
