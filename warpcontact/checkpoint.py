"""The full state of a simulation as arrays, and as a file: what a run needs to go on to the bit.

Everything that steps write is declared as zeros in a ``Layout``, so it is saved without being named here; what
follows from the scene and from parameters is made anew. A file is an ``.npz`` of plain arrays, whose parts carry
check sums; nothing in it is code.
"""

import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact._version import __version__
from warpcontact.arrays import Layout
from warpcontact.captures import beside_captures
from warpcontact.durable import replacing
from warpcontact.hostile import VisibleError
from warpcontact.integrators.base import formulas_of
from warpcontact.parameters import Field
from warpcontact.regular_files import UnsafeFileError
from warpcontact.run_folder import RunPath, open_file

if TYPE_CHECKING:
    from warpcontact.model import Model
    from warpcontact.outcomes.watch import Watch
    from warpcontact.simulation import Simulation

#: Goes up when files of earlier versions can no longer be read as they are.
SCHEMA = 3
_HEADER = "header"

# What a file that is damaged anywhere may raise; sizes in it may be anything, and so may ways of compression.
_UNREADABLE = (
    *(OSError, ValueError, KeyError, TypeError, EOFError, MemoryError, RuntimeError, SyntaxError),
    *(zipfile.BadZipFile, zlib.error),
)

Arrays = dict[str, NDArray[Any]]


class CheckpointError(VisibleError):
    """A file that holds no checkpoint, a damaged one, or one of another simulation."""


def write(path: Path | RunPath, arrays: Mapping[str, NDArray[Any]], header: Mapping[str, Any]) -> None:
    """Writes arrays and a header into a file, which is there as a whole or not at all."""
    content = {"program": f"warpcontact {__version__}", "schema": SCHEMA, **header}
    named: dict[str, Any] = {_HEADER: np.frombuffer(json.dumps(content).encode(), dtype=np.uint8), **arrays}
    with replacing(path) as file:
        np.savez(file, **named)


def read(path: Path | RunPath) -> tuple[Arrays, dict[str, Any]]:
    """Returns arrays and header of a file.

    Raises:
        CheckpointError: If it is no checkpoint, damaged, or of a later version.
        FileNotFoundError: If there is none.
    """
    try:
        with open_file(path) as raw, np.load(raw, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        header = json.loads(arrays.pop(_HEADER).tobytes())
        schema = header["schema"]
    except FileNotFoundError:
        raise
    except UnsafeFileError as error:
        raise CheckpointError(str(error)) from None
    except _UNREADABLE as error:
        # NumPy tells how to run the code in a file, also of one that is no archive.
        why = str(error).partition(" when allow_pickle")[0]
        if not isinstance(error, OSError) and not _is_archive(path):
            why = "it is no .npz file of arrays, or was cut off"
        raise CheckpointError(f"{path}: is no whole checkpoint: {why}") from None
    if schema != SCHEMA:
        raise CheckpointError(
            f"{path}: is of schema {schema!r}, by {header.get('program')}; this version reads schema {SCHEMA}"
        )
    return arrays, header


def _is_archive(path: Path | RunPath) -> bool:
    with open_file(path) as file:
        return zipfile.is_zipfile(file)


def identity(simulation: "Simulation") -> dict[str, Any]:
    """Returns what a checkpoint has to agree in with a simulation that takes it over."""
    model = simulation.model
    scene = model.scene
    return {
        "envs": [part.envs for part in model.parts],
        "devices": ["cuda" if part.device.is_cuda else "cpu" for part in model.parts],
        "precision": model.precision,
        "dt": simulation.dt,
        "integrator": repr(simulation.integrator),
        "crossing_steps": simulation.crossing_steps,
        "watched": _watched(simulation.watch),
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


def _watched(watch: "Watch") -> list[str]:
    """Returns what is watched, in its order and with everything that tells one from another."""
    named = [*watch.outcomes.items(), *watch.stops.items()]
    told = [f"{name}: {type(one).__name__} {sorted(vars(one).items())}" for name, one in named]
    events = [] if watch.events is None else [f"events: {sorted(vars(watch.events).items())}"]
    return [*told, *events, f"quarantine: {watch.quarantine}"]


def state_of(simulation: "Simulation") -> Arrays:
    """Returns everything that steps of ``simulation`` have written, by name; views of its memory on the CPU."""
    arrays: Arrays = {}
    for number, layouts in enumerate(_layouts(simulation)):
        for kind, layout in layouts.items():
            for name, array in layout.written().items():
                arrays[f"{number}/{kind}/{name}"] = array.numpy().ravel()
    parts = simulation.model.parts
    arrays["elapsed"] = np.array([part.elapsed for part in parts])
    arrays["untouched"] = np.array([part.untouched for part in parts])
    return arrays


@beside_captures()
def restore(simulation: "Simulation", arrays: Mapping[str, NDArray[Any]]) -> None:
    """Puts back what ``state_of`` returned.

    Raises:
        CheckpointError: If the arrays are others than those of ``simulation``; nothing is changed then.
    """
    targets = {
        f"{number}/{kind}/{name}": array
        for number, layouts in enumerate(_layouts(simulation))
        for kind, layout in layouts.items()
        for name, array in layout.written().items()
    }
    for name, array in targets.items():
        found = arrays.get(name)
        if found is None or found.dtype != np.uint8 or found.shape != (array.size,):
            size = "is missing" if found is None else f"has {found.nbytes} bytes"
            raise CheckpointError(f"array {name!r} {size}, and {array.size} are expected")
    parts = simulation.model.parts
    for name in ("elapsed", "untouched"):
        if name not in arrays or arrays[name].shape != (len(parts),):
            raise CheckpointError(f"array {name!r} must have a value for each of {len(parts)} devices")
    for name, array in targets.items():
        array.assign(arrays[name].reshape(array.shape))
    for part, elapsed, untouched in zip(parts, arrays["elapsed"], arrays["untouched"], strict=True):
        part.elapsed, part.untouched = float(elapsed), bool(untouched)


def save(simulation: "Simulation", path: str | os.PathLike[str]) -> None:
    """Writes what ``Simulation.save`` promises."""
    arrays = state_of(simulation)
    for number, part in enumerate(simulation.model.parts):
        for key, field in enumerate(_fields(part)):
            arrays[f"{number}/values/{key}"] = field.values
        if part.handed_out:
            for name, array in _external(part).items():
                arrays[f"{number}/external/{name}"] = array.numpy()
    write(Path(path), arrays, {"identity": identity(simulation)})


def load(simulation: "Simulation", path: str | os.PathLike[str]) -> None:
    """Reads what ``Simulation.load`` promises."""
    arrays, header = read(Path(path))
    own = identity(simulation)
    theirs = header.get("identity")
    if not isinstance(theirs, dict):
        raise CheckpointError(f"{path}: is a part of a run, which only the run can go on from")
    for key, value in own.items():
        if theirs.get(key) != json.loads(json.dumps(value)):
            raise CheckpointError(f"{path}: is of another simulation: {_difference(key, theirs.get(key), value)}")
    try:
        # Values first: whoever sends them forgets what is known of distances, which then comes back.
        for number, part in enumerate(simulation.model.parts):
            _load_values(part, {key: arrays[f"{number}/values/{key}"] for key in range(len(_fields(part)))})
            if f"{number}/external/force" in arrays:
                for name, array in _external(part).items():
                    array.assign(arrays[f"{number}/external/{name}"])
        restore(simulation, arrays)
    except (KeyError, CheckpointError) as error:
        raise CheckpointError(f"{path}: {error}") from None


def _layouts(simulation: "Simulation") -> Iterator[dict[str, Layout]]:
    """Iterates over what is on the device of each part."""
    for part, stepping in zip(simulation.model.parts, simulation.stepping_layouts(), strict=True):
        yield {"model": part.layout, "stepping": stepping}


def _fields(part: "Model") -> list[Field]:
    """Returns the values of all parameters, each once."""
    return list({id(parameter.field): parameter.field for parameter in part.parameters.values()}.values())


def _external(part: "Model") -> dict[str, wp.array]:
    external = part.external
    return {"force": external.force, "torque": external.torque}


def _load_values(part: "Model", values: Mapping[int, NDArray[Any]]) -> None:
    fields = _fields(part)
    for key, field in enumerate(fields):
        found = values[key]
        if found.shape[1:] != field.values.shape[1:] or len(found) not in (1, part.envs):
            raise CheckpointError(f"the values of parameter group {key} have shape {found.shape}")
    changed = {id(field) for key, field in enumerate(fields) if not np.array_equal(field.values, values[key])}
    uploads = {
        id(upload): upload
        for parameter in part.parameters.values()
        if id(parameter.field) in changed
        for upload in parameter.uploads
    }
    for key, field in enumerate(fields):
        if id(field) in changed:
            field.values = np.array(values[key], dtype=np.float64)
            field.shared = len(values[key]) == 1 and (part.envs > 1 or field.shared)
    part.send(uploads.values(), (upload.content() for upload in uploads.values()))


def _shown(value: Any) -> str:
    return f"{len(value)} of them" if isinstance(value, list) and len(value) > 3 else f"{value!r}"


def _difference(key: str, theirs: Any, own: Any) -> str:
    """Returns in words where two identities differ."""
    if key in ("parameters", "formulas", "watched"):
        told = [f"it has {one!r}" for one in theirs if one not in own][:1]
        told += [f"has no {one!r}" for one in own if one not in theirs][:1]
        if told:
            return f"{key}: {' and '.join(told)}"
    return f"{key}: {_shown(theirs)} there, {_shown(own)} here"
