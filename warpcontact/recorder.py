"""Recording: chosen readings, gathered on the device and drained into one labelled data set."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import warp as wp
import xarray as xr
from numpy.typing import NDArray

from warpcontact._version import __version__
from warpcontact.environments import Environments
from warpcontact.model import Model
from warpcontact.parameters import Parameter
from warpcontact.readings import AXES, status_attributes
from warpcontact.scene import Scene

# Frames wait on the device up to this size, then move to the host in one copy.
RING_BYTES = 64 * 2**20


class Recording(xr.Dataset):
    """An ``xarray.Dataset`` of readings that remembers the scene they came from."""

    __slots__ = ("scene",)

    scene: Scene


class _Channel:
    """The frames of one reading: a buffer on each device and one result on the host."""

    def __init__(self, model: Environments, name: str, frames: int) -> None:
        self.reading = model.find_reading(name)
        first = self.reading.array(model.parts[0].arrays)
        one = self.reading.finish(first[:1].numpy()[None], axis=2)
        self.result = np.zeros((frames, model.envs, *one.shape[2:]), dtype=one.dtype)
        self._rings = [_Ring(part, name, self.result[:, own]) for part, own in model.shares()]

    def take(self) -> None:
        for ring in self._rings:
            ring.take()

    def drain(self) -> None:
        for ring in self._rings:
            ring.drain()


class _Ring:
    """The frames of one reading of a part: a buffer on its device, and where they go on the host.

    Args:
        part: The part.
        name: Name of the reading.
        result: Receives all frames (frame, env, …).
    """

    def __init__(self, part: Model, name: str, result: NDArray[Any]) -> None:
        self.reading = part.readings[name]
        self.source = self.reading.array(part.arrays)
        self.result = result
        shape = self.source.shape
        frame_bytes = max(1, int(np.prod(shape)) * wp.types.type_size_in_bytes(self.source.dtype))
        self.slots = int(min(len(result), max(1, RING_BYTES // frame_bytes)))
        self.memory = wp.zeros((self.slots, *shape), dtype=self.source.dtype, device=part.device)
        self.taken = 0
        self.drained = 0

    def take(self) -> None:
        wp.copy(self.memory[self.taken - self.drained], self.source)
        self.taken += 1
        if self.taken - self.drained == self.slots:
            self.drain()

    def drain(self) -> None:
        count = self.taken - self.drained
        if count:
            values = self.reading.finish(self.memory.numpy()[:count], axis=2)
            self.result[self.drained : self.taken] = values
            self.drained = self.taken


def moved_elements(model: Environments) -> list[str]:
    """Returns the parameters of surfaces and points that are no longer those of the scene in environment 0."""
    scene = model.scene
    first = {
        f"{surface.name}.{key}": getattr(surface, key)
        for surface in scene.surfaces
        for key in ("position", "orientation", "scale")
    }
    first |= {f"{surface.name}.mesh": np.zeros(()) for surface in scene.surfaces if len(surface.meshes) > 1}
    for points in scene.points:
        first[f"{points.name}.position"] = points.positions[0] if points.single else points.positions
    part = model.parts[0]
    return [name for name, value in first.items() if not (part.parameters[name].read(part.envs)[0] == value).all()]


class Recorder:
    """Takes frames of readings from a model.

    Args:
        model: The model.
        names: Readings to take.
        frames: Number of frames to come.
        poses: Whether to take the pose of every body as well, and keep the parameters that differ.
        parameters: Names of further parameters to keep.
    """

    def __init__(
        self, model: Environments, names: Iterable[str], frames: int, poses: bool, parameters: Iterable[str] = ()
    ) -> None:
        self.model = model
        self.kept = [model.find_parameter(name) for name in parameters]
        if poses:
            # What a replay needs beside the poses, and whatever sets the environments apart.
            needed = (".mass", ".inertia", ".radius")
            moved = moved_elements(model)
            self.kept += [
                model.find_parameter(name)
                for name in model
                if model.varies(name) or name.endswith(needed) or name in moved
            ]
        wanted = list(dict.fromkeys(names))
        if poses:
            both = ("position", "orientation")
            wanted += [f"{body.name}.{key}" for body in model.scene.bodies for key in both]
        readings = [model.find_reading(name) for name in dict.fromkeys(wanted)]
        self.needs = {need for reading in readings for need in reading.needs}
        self._prepare()
        self.channels = [_Channel(model, reading.name, frames) for reading in readings]
        self.times = np.zeros(frames)
        self.taken = 0

    def take(self, time: float) -> None:
        """Takes one frame of the current state at ``time`` [s]."""
        self._prepare()
        for channel in self.channels:
            channel.take()
        self.times[self.taken] = time
        self.taken += 1

    def _prepare(self) -> None:
        for part in self.model.parts:
            part.prepare(self.needs)

    def _item_dimension(self, element: str) -> str:
        """Returns the name of the item axis of a set: sets of different size cannot share one."""
        sizes = {len(points.positions) for points in self.model.scene.points if not points.single}
        return "item" if len(sizes) == 1 else f"{element}.item"

    def _parameter_variable(self, parameter: Parameter) -> dict[str, Any]:
        """Returns a parameter as a variable (env, …); that of an initial state has a name of its own."""
        name = parameter.name
        dims = ["env"] + ([] if parameter.single else [self._item_dimension(name.partition(".")[0])])
        if parameter.tail == (3, 3):
            dims += ["row", "column"]
        elif parameter.tail:
            dims.append(AXES[parameter.tail[0]][0])
        label = f"{name}.initial" if name in self.model.reading_names else name
        notes = {"units": parameter.limits["unit"], "long_name": f"parameter {name}"}
        return {label: (dims, self.model[name].copy(), notes)}

    def finish(self, attributes: Mapping[str, Any]) -> Recording:
        """Returns the frames taken as one data set."""
        model = self.model
        variables = {}
        for channel in self.channels:
            channel.drain()
            reading = channel.reading
            element = reading.name.rpartition(".")[0]
            dims = ["time", "env"] + ([self._item_dimension(element)] if reading.items else [])
            values = channel.result[: self.taken]
            if values.ndim > len(dims):
                dims.append(AXES[values.shape[-1]][0])
            notes = {"units": reading.unit, "long_name": reading.meaning}
            if reading.name.endswith(".status"):
                notes |= status_attributes()
            variables[reading.name] = (dims, values, notes)
        for parameter in self.kept:
            variables |= self._parameter_variable(parameter)
        used = {dim for dims, _, _ in variables.values() for dim in dims}
        coordinates: dict[str, Any] = {
            "time": ("time", self.times[: self.taken], {"units": "s", "long_name": "simulated time"}),
            "env": ("env", np.arange(model.envs), {"long_name": "environment"}),
        }
        # As objects: texts of fixed length have no place in some files, the Zarr v3 specification among them.
        coordinates |= {dim: (dim, np.array(labels, object)) for dim, labels in AXES.values() if dim in used}
        recording = Recording(
            variables,
            coords=coordinates,
            attrs={
                "source": f"warpcontact {__version__}",
                "device": ", ".join(map(str, model.devices)),
                "precision": model.precision,
                **attributes,
            },
        )
        recording.scene = model.scene
        return recording
