"""State and history of a simulation as arrays, and as a file: what a run needs to continue bitwise identically.

An ``AllocationPlan`` declares which arrays are stored, and the allowed values of their integers. Caches and arrays
that are computed before they are read are not stored; loading sets them to zero, as in a new model. Tables derived
from the scene and from parameters are recomputed. A file is an ``.npz`` of plain arrays with checksums, without code.

Files are not trusted: shapes, types, index ranges, parameters and states are checked before the simulation is
changed, so that no file can make a kernel read outside its arrays.
"""

import hashlib
import json
import os
import warnings
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from warpcontact._version import __version__
from warpcontact.files.atomic_files import atomic_file
from warpcontact.files.regular_files import UnsafeFileError
from warpcontact.files.run_folder import RunPath, open_file
from warpcontact.stepping.checkpoint_values import (
    CheckpointError,
    ParameterValues,
    check_clocks,
    check_states,
    set_values,
)
from warpcontact.stepping.integrators.base import formulas_of
from warpcontact.storage.allocation_plan import AllocationPlan
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.validation.safe_text import truncate

if TYPE_CHECKING:
    from warpcontact.stepping.outcomes.watch import MonitorSettings
    from warpcontact.stepping.simulation import Simulation

#: Schema version; incremented when files of earlier versions can no longer be read.
SCHEMA = 5
_HEADER = "header"

Arrays = dict[str, NDArray[Any]]


def write(path: Path | RunPath, arrays: Mapping[str, NDArray[Any]], header: Mapping[str, Any]) -> None:
    """Writes arrays and a header into a file atomically."""
    content = {"program": f"warpcontact {__version__}", "schema": SCHEMA, **header}
    named: dict[str, Any] = {_HEADER: np.frombuffer(json.dumps(content).encode(), dtype=np.uint8), **arrays}
    with atomic_file(path) as file:
        np.savez(file, **named)


def read(path: Path | RunPath) -> tuple[Arrays, dict[str, Any]]:
    """Returns arrays and header of a file.

    Raises:
        CheckpointError: If the file is no checkpoint, is damaged, or has another schema version.
        FileNotFoundError: If the file does not exist.
    """
    try:
        with open_file(path) as raw, warnings.catch_warnings():
            # NumPy warns of files written by Python 2.
            warnings.simplefilter("ignore")
            size = raw.seek(0, os.SEEK_END)
            raw.seek(0)
            with np.load(raw, allow_pickle=False) as file:
                _check_members(file.zip.infolist(), size)
                arrays = {name: np.asarray(file[name]) for name in file.files}
        header = json.loads(arrays.pop(_HEADER).tobytes())
        schema = header["schema"]
    except FileNotFoundError:
        raise
    except UnsafeFileError as error:
        raise CheckpointError(str(error)) from None
    except Exception as error:  # NumPy, zipfile and json raise many kinds for a damaged file
        # Drop NumPy's advice to enable pickle, which would run code from the file.
        why = str(error).partition(" when allow_pickle")[0]
        if not isinstance(error, OSError) and not _is_archive(path):
            why = "it is no .npz file of arrays, or is truncated"
        raise CheckpointError(f"{path}: is no complete checkpoint: {why}") from None
    if schema != SCHEMA:
        raise CheckpointError(
            f"{path}: has schema {schema!r}, written by {header.get('program')!r}; this version reads schema {SCHEMA}"
        )
    return arrays, header


def _is_archive(path: Path | RunPath) -> bool:
    with open_file(path) as file:
        return zipfile.is_zipfile(file)


def _check_members(members: list[zipfile.ZipInfo], size: int) -> None:
    """Raises ``ValueError`` unless the members of an archive of ``size`` bytes are stored one after the other.

    With compressed or overlapping members, a small file could require any amount of memory.
    """
    if any(one.compress_type != zipfile.ZIP_STORED for one in members):
        raise ValueError("its arrays are compressed; arrays of a checkpoint must be stored uncompressed")
    if sum(one.file_size for one in members) > size:
        raise ValueError("its arrays are larger than the file")


def identity(simulation: "Simulation") -> dict[str, Any]:
    """Returns the properties in which a checkpoint must match the simulation that loads it."""
    model = simulation.model
    scene = model.scene
    return {
        "envs": [part.envs for part in model.parts],
        "devices": ["cuda" if part.device.is_cuda else "cpu" for part in model.parts],
        "precision": model.precision,
        "dt": simulation.dt,
        "integrator": repr(simulation.integrator),
        "crossing_substeps": simulation.crossing_substeps,
        "watched": _monitored(simulation.monitor_settings),
        "parameters": list(model),
        "formulas": [
            f"{name}.{part} = {type(formula).__name__}"
            for name, formulas in formulas_of(scene).items()
            for part, formula in formulas.items()
        ],
        "meshes": [
            hashlib.sha256(mesh.vertices.tobytes() + mesh.faces.tobytes()).hexdigest()
            for surface in scene.surfaces
            for mesh in surface.meshes
        ],
    }


def _monitored(settings: "MonitorSettings") -> list[str]:
    """Returns outcomes, stop conditions, events and quarantine as texts, in order, with all settings."""
    named = [*settings.outcomes.items(), *settings.stops.items()]
    texts = [f"{name}: {type(one).__name__} {sorted(vars(one).items())}" for name, one in named]
    events = [] if settings.events is None else [f"events: {sorted(vars(settings.events).items())}"]
    return [*texts, *events, f"quarantine: {settings.quarantine}"]


def state_of(simulation: "Simulation") -> Arrays:
    """Returns all arrays that future steps of ``simulation`` depend on, by name."""
    arrays: Arrays = {}
    for place, layout in _layouts(simulation):
        for name, memory in layout.step_memory().items():
            arrays |= {f"{place}/{name}:{array}": content for array, content in memory.content().items()}
    parts = simulation.model.parts
    arrays["elapsed"] = np.array([part.elapsed for part in parts], dtype=np.float64)
    arrays["is_initial"] = np.array([part.is_initial for part in parts], dtype=bool)
    return arrays


@shared_capture_lock()
def restore(simulation: "Simulation", arrays: Mapping[str, NDArray[Any]]) -> None:
    """Sets state and history to those that ``state_of`` returned, and clears all caches.

    Raises:
        CheckpointError: If the arrays do not match those of ``simulation``, or hold values that steps cannot produce.
            The simulation is unchanged then.
    """
    restored = _checked(simulation, arrays)
    for place, layout in _layouts(simulation):
        for name, memory in layout.step_memory().items():
            memory.restore(restored[place][name])
    for part, elapsed, is_initial in zip(
        simulation.model.parts, arrays["elapsed"], arrays["is_initial"], strict=True
    ):
        for element in part.force_elements:
            element.restore_caches()
        part.elapsed, part.is_initial = float(elapsed), bool(is_initial)


def _checked(
    simulation: "Simulation", arrays: Mapping[str, NDArray[Any]]
) -> dict[str, dict[str, dict[str, NDArray[Any]]]]:
    """Returns the values of all arrays by layout, memory and name.

    Raises:
        CheckpointError: If an array is missing or has values that are not allowed.
    """
    restored: dict[str, dict[str, dict[str, NDArray[Any]]]] = {}
    for place, layout in _layouts(simulation):
        restored[place] = {name: {} for name in layout.step_memory()}
        for name, memory in layout.step_memory().items():
            for array in memory.saved:
                full = f"{place}/{name}:{array}"
                if full not in arrays:
                    raise CheckpointError(f"array {full!r} is missing")
                try:
                    restored[place][name][array] = memory.checked(array, arrays[full])
                except ValueError as error:
                    raise CheckpointError(f"array {full!r}: {error}") from None
    check_clocks(arrays, len(simulation.model.parts))
    for number in range(len(simulation.model.parts)):
        own = restored[f"{number}/model"]
        state = {array: values for name in own if name.endswith(":state") for array, values in own[name].items()}
        check_states(state)
    return restored


def save(simulation: "Simulation", path: str | os.PathLike[str]) -> None:
    """Writes a checkpoint; see ``Simulation.save``."""
    arrays = state_of(simulation)
    for number, part in enumerate(simulation.model.parts):
        arrays |= ParameterValues(part, number).saved()
    write(Path(path), arrays, {"identity": identity(simulation)})


def load(simulation: "Simulation", path: str | os.PathLike[str]) -> None:
    """Loads a checkpoint; see ``Simulation.load``."""
    arrays, header = read(Path(path))
    own = identity(simulation)
    theirs = header.get("identity")
    if not isinstance(theirs, dict):
        raise CheckpointError(f"{path}: belongs to a run; resume the run instead")
    for key, value in own.items():
        if theirs.get(key) != json.loads(json.dumps(value)):
            raise CheckpointError(f"{path}: is of another simulation: {_difference(key, theirs.get(key), value)}")
    try:
        _checked(simulation, arrays)
        values = [ParameterValues(part, number) for number, part in enumerate(simulation.model.parts)]
        for one in values:
            one.check(arrays)
        set_values(values)
        restore(simulation, arrays)
    except CheckpointError as error:
        raise CheckpointError(f"{path}: {error}") from None


def _layouts(simulation: "Simulation") -> Iterator[tuple[str, AllocationPlan]]:
    """Yields the allocation plans of each part, of model and stepping, with a name prefix."""
    for number, (part, stepping) in enumerate(
        zip(simulation.model.parts, simulation.step_allocations(), strict=True)
    ):
        yield f"{number}/model", part.layout
        yield f"{number}/stepping", stepping


def _shown(value: Any) -> str:
    return f"{len(value)} of them" if isinstance(value, list) and len(value) > 3 else truncate(f"{value!r}", 200)


def _difference(key: str, theirs: Any, own: Any) -> str:
    """Returns a text about the difference of an entry of two identities."""
    if key in ("parameters", "formulas", "watched") and isinstance(theirs, list):
        parts = [f"the file has {_shown(one)}" for one in theirs if one not in own][:1]
        parts += [f"has no {one!r}" for one in own if one not in theirs][:1]
        if parts:
            return f"{key}: {' and '.join(parts)}"
    return f"{key}: {_shown(theirs)} in the file, {_shown(own)} in the simulation"
