"""Recording of sensors, frame by frame, into one labeled data set.

``Recorder`` owns the result arrays (``frame_buffers.py``) and their copies (``frame_copies.py``). It is used by
``Simulation.run`` and by experiments, which write frames in blocks.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from warpcontact._version import __version__
from warpcontact.forces.sensor import AXES, Sensor
from warpcontact.model.environments import Environments
from warpcontact.model.model import DeviceModel
from warpcontact.scene.body_contact import BodyContact
from warpcontact.scene.scene_data import SceneData
from warpcontact.stepping.frame_buffers import Channel, Frame
from warpcontact.stepping.frame_copies import FrameCopies
from warpcontact.storage.allocation_plan import row_bytes
from warpcontact.storage.memory_estimate import (
    MemoryEstimate,
    MemoryItem,
    MemoryShortage,
    available_memory_for,
    shortage,
    shortage_message,
    total,
    usable_bytes,
)
from warpcontact.storage.parameters import Parameter
from warpcontact.system.resources import HOST, AvailableMemory
from warpcontact.validation.number_format import format_bytes

if TYPE_CHECKING:
    import xarray as xr

    from warpcontact.stepping.recording import Recording

#: Attribute of a recording: names of parameters that are not stored, because they equal those of the scene everywhere.
UNCHANGED = "unchanged_parameters"


@dataclass(frozen=True)
class RecordingSize:
    """Memory of a recording.

    Attributes:
        frames: Size of one frame of each sensor.
        parameters: Size of the stored parameters of one environment [bytes].
        measured: Quantities that the sensors need, see ``Sensor.needs``.
    """

    frames: tuple[Frame, ...]
    parameters: int
    measured: frozenset[str]

    def memory_items(self, device: str, envs: int, count: int, blocks: int = 1) -> list[MemoryItem]:
        """Returns the memory of ``blocks`` blocks of ``count`` frames of ``envs`` environments on a device."""
        needs = [need for frame in self.frames for need in frame.memory_items(device, envs, count, blocks)]
        return [*needs, MemoryItem("recording", HOST, envs * self.parameters, self.parameters)]

    def on_host(self, envs: int, count: int) -> int:
        """Returns the size of the data set [bytes]."""
        return envs * (self.parameters + count * sum(frame.host for frame in self.frames))


def item_dimension(scene: SceneData, element: str, count: int) -> str:
    """Returns the name of the dimension of the ``count`` items of an element; sets of different size need different names."""
    sizes = {points.count for points in scene.points if not points.single}
    sizes |= {body.count for body in scene.bodies if not body.single}
    # A particle contact has one item per particle, which may be those of several sets, and a body contact one per pair.
    contacts = {contact.name: contact.count for contact in scene.particle_contacts}
    contacts |= {contact.name: contact.count for contact in scene.body_contacts if not contact.single}
    if element in contacts:
        sizes |= set(contacts.values())
    return "item" if sizes == {count} else f"{element}.item"


def item_dimension_of(scene: SceneData, sensor: Sensor) -> str:
    """Returns the name of the item dimension of a sensor with items.

    Items that are not those of the element, such as the points of a body contact, have a dimension of their own,
    ``<element>.point.item``.
    """
    element = sensor.name.partition(".")[0]
    if sensor.items_of:
        return f"{element}.{sensor.items_of}.item"
    return item_dimension(scene, element, sensor.items)


def check_item_dimensions(scene: SceneData, sensors: Iterable[Sensor]) -> None:
    """Raises ``ValueError`` if two sensors have a different number of items along the same dimension.

    Sensors of the package do not; those of a force element of a user may.
    """
    found: dict[str, Sensor] = {}
    for sensor in sensors:
        if not sensor.items:
            continue
        dim = item_dimension_of(scene, sensor)
        first = found.setdefault(dim, sensor)
        if first.items != sensor.items:
            raise ValueError(
                f"{first.name!r} has {first.items} items and {sensor.name!r} has {sensor.items}, but both have the "
                f"dimension {dim!r}, so that they cannot be recorded together; items_of of a sensor gives its items a dimension of their own"
            )


def replay_parameters(model: Environments) -> list[str]:
    """Returns the parameters a replay reads from the scene whose value in environment 0 differs from the scene's."""
    scene = model.scene
    first = {
        f"{surface.name}.{key}": getattr(surface, key)
        for surface in scene.surfaces
        for key in ("position", "orientation", "scale")
    }
    first |= {f"{surface.name}.mesh": np.zeros(()) for surface in scene.surfaces if len(surface.meshes) > 1}
    for shape in scene.shapes:
        own = {"position": shape.positions, "orientation": shape.orientations, **shape.sizes}
        first |= {f"{shape.name}.{key}": v[0] if shape.single else v for key, v in own.items()}
    for points in scene.points:
        first[f"{points.name}.position"] = points.positions[0] if points.single else points.positions
    first["scene.gravity"] = scene.gravity
    for body in scene.bodies:
        first |= {f"{body.name}.motion.{key}": value for key, value in body.motion.parameters().items()}
    contacts: list[Any] = [
        *scene.contacts,
        *scene.shape_contacts,
        *scene.particle_contacts,
        *scene.body_contacts,
    ]
    for contact in contacts:
        formulas = contact.material.formulas
        values = {f"friction.{key}": value for key, value in formulas["friction"].parameters().items()}
        values["law.restitution"] = getattr(formulas["law"], "restitution", None)
        if isinstance(contact, BodyContact) and contact.table is not None:
            # One value per pair.
            parts = {part: contact.parameters(part) for part in ("law", "friction")}
            values = {key: parts[key.partition(".")[0]].get(key.partition(".")[2]) for key in values}
        first |= {f"{contact.name}.{key}": value for key, value in values.items() if value is not None}
    for body_contact in scene.body_contacts:
        # The pressure on their areas is computed from these.
        first |= {
            f"{body_contact.name}.{key}": getattr(body_contact, key)
            for key in ("kappa", "max_depth", "force_scale", "enabled")
        }
        for key, value in body_contact.parameters("law").items():
            first[f"{body_contact.name}.law.{key}"] = value
    known = model.parts[0].parameters
    return [name for name, value in first.items() if name in known and not _equals(model, name, value)]


def _equals(model: Environments, name: str, value: Any) -> bool:
    """Returns whether a parameter equals ``value`` in environment 0."""
    part = model.parts[0]
    return bool((part.parameters[name].read(part.envs)[0] == value).all())


def unchanged_parameters(model: Environments, kept: Iterable[str]) -> list[str]:
    """Returns the masses and inertias that are not in ``kept`` and equal those of the scene in all environments."""
    own = {f"{body.name}.{key}": getattr(body, key) for body in model.scene.bodies for key in ("mass", "inertia")}
    absent = own.keys() - set(kept)
    # Compare values: a field holds all bodies, and may be stored per environment although this body does not vary.
    return [name for name in own if name in absent and bool((model[name] == own[name]).all())]


class Recorder:
    """Records frames of sensors of a model, in one or several blocks; call ``start`` first.

    Args:
        model: The model.
        names: Names of the sensors.
        frames: Number of frames per block.
        poses: Whether to record also the pose of every body, and to store the parameters that differ between
            environments.
        parameters: Names of further parameters to store.
        series: Whether to record poses. If not, only parameters are stored for ``poses``.
        blocks: Number of blocks of frames. A block is overwritten after ``blocks`` calls of ``rewind``.
    """

    def __init__(
        self,
        model: Environments,
        names: Iterable[str],
        frames: int,
        poses: bool,
        parameters: Iterable[str] = (),
        series: bool = True,
        blocks: int = 1,
    ) -> None:
        self.model = model
        self.kept = [model.find_parameter(name) for name in parameters]
        if poses:
            # Parameters that a replay needs in addition to the poses, and all that differ between environments.
            needed = (".mass", ".inertia", ".radius")
            moved = replay_parameters(model)
            self.kept += [
                model.find_parameter(name)
                for name in model
                if model.varies(name) or name.endswith(needed) or name in moved
            ]
        wanted = list(names)
        if poses and series:
            both = ("position", "orientation")
            wanted += [f"{body.name}.{key}" for body in model.scene.bodies for key in both]
        # Keyed by stored name, so that an alias and its sensor are one channel.
        sensors = {sensor.name: sensor for sensor in model.find_sensors(wanted)}
        self.needs = {need for sensor in sensors.values() for need in sensor.needs}
        model.ensure_sensor_arrays(self.needs)
        check_item_dimensions(model.scene, sensors.values())
        self.channels = [Channel(model, name) for name in sensors]
        self.capacity, self._blocks = frames, blocks
        # Per block, after ``start``: copies of frames of parts on the CPU, and times of the frames.
        self._copies: list[dict[DeviceModel, FrameCopies]] = [{}]
        self._times = np.zeros((1, 0))
        self._block = 0
        self.taken = 0

    def size(self) -> RecordingSize:
        """Returns the memory of the recording."""
        envs = self.model.parts[0].envs
        parameters = {parameter.name: row_bytes(parameter.read(envs)) for parameter in self.kept}
        frames = tuple(channel.frame for channel in self.channels)
        return RecordingSize(frames, sum(parameters.values()), frozenset(self.needs))

    @property
    def copies(self) -> dict[DeviceModel, FrameCopies]:
        """Frame copies of the current block, by part on the CPU."""
        return self._copies[self._block]

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the frames of the current block [s]; the first ``taken`` are valid."""
        return self._times[self._block]

    @property
    def free_frames(self) -> int:
        """Number of free frames in the current block; 0 before ``start``."""
        return len(self.times) - self.taken

    def require(self, frames: int) -> None:
        """Raises ``RuntimeError`` if fewer than ``frames`` frames are free."""
        if frames > self.free_frames:
            raise RuntimeError(
                f"the recorder has {self.free_frames} of {self.capacity} frames free, but {frames} are required. "
                "Call start() before the first frame and rewind() before a new block"
            )

    def start(self, extra: Iterable[MemoryItem] = ()) -> None:
        """Allocates the buffers of the frames.

        Args:
            extra: Additional memory of steps that record these frames, see ``Simulation.frame_memory``.

        Raises:
            MemoryError: If the memory is not available; the message states the number of frames that fit.
        """
        size, frames, blocks = self.size(), self.capacity, self._blocks
        footprint = total(
            MemoryEstimate(
                part.envs, str(part.device), tuple(size.memory_items(str(part.device), part.envs, frames, blocks))
            )
            for part in self.model.parts
        ).with_items(extra)
        room = shortage(footprint, available_memory_for(footprint))
        if room is not None:
            raise MemoryShortage(
                self._shortage_message(footprint, room), footprint.bytes_at(room.location), usable_bytes(room)
            )
        on_cpu = [part for part in self.model.parts if part.device.is_cpu]
        self._copies = [{part: FrameCopies(part) for part in on_cpu} for _ in range(blocks)]
        self._times, self._block, self.taken = np.zeros((blocks, frames)), 0, 0
        for channel in self.channels:
            channel.allocate(frames, self._copies)

    def _shortage_message(self, footprint: MemoryEstimate, room: AvailableMemory) -> str:
        envs, frames = self.model.envs, self.capacity
        sizes = {channel.frame.name: envs * frames * channel.frame.host for channel in self.channels}
        largest = sorted(sizes, key=lambda name: -sizes[name])[:3]
        capacity = int(frames * usable_bytes(room) / footprint.bytes_at(room.location))
        if capacity:
            advice = (
                f"at most {capacity} frames fit: make every {-(-frames // capacity)} times as long, or record less"
            )
        else:
            advice = "not even one frame fits: record less, or of fewer environments"
        named = ", ".join(f"{name} {format_bytes(sizes[name])}" for name in largest)
        return (
            f"the recording of {frames} frames: {shortage_message(footprint, room)}; {advice} (largest: {named})"
        )

    def take(self, time: float) -> None:
        """Evaluates and records one frame of the current state at ``time`` [s].

        Raises:
            RuntimeError: If the block is full.
        """
        self.require(1)
        # Launch all parts before waiting for the first one, so that devices run in parallel.
        for part in self.model.parts:
            part.evaluate_needs(self.needs)
        for part in self.model.parts:
            self.take_part(part, slice(0, part.envs), self.taken)
        self.count([time])

    def take_part(self, part: DeviceModel, own: slice, number: int) -> None:
        """Records frame ``number`` of an evaluated part; ``own`` must be all of its environments."""
        if part in self.copies:
            self.copies[part].take(number)
        else:
            for channel in self.channels:
                channel.rings[part].take(number, channel.result)

    def count(self, times: Sequence[float] | NDArray[Any]) -> None:
        """Adds frames at ``times`` [s] that were recorded in all environments to the count."""
        self.times[self.taken : self.taken + len(times)] = times
        self.taken += len(times)

    def _parameter_variable(self, parameter: Parameter) -> dict[str, Any]:
        """Returns a parameter as a variable (env, …).

        A parameter with the name of a sensor (an initial state) is named ``<name>.initial``.
        """
        name = parameter.name
        dims = ["env"]
        if not parameter.single:
            dims.append(item_dimension(self.model.scene, name.partition(".")[0], parameter.count))
        if parameter.tail == (3, 3):
            dims += ["row", "column"]
        elif parameter.tail:
            dims.append(AXES[parameter.tail[0]][0])
        label = f"{name}.initial" if name in self.model.sensor_names else name
        notes = {"units": parameter.limits["unit"], "long_name": f"parameter {name}"}
        return {label: (dims, self.model[name].copy(), notes)}

    def frames(self) -> dict[str, NDArray[Any]]:
        """Returns the frames taken since the last ``rewind``, (frame, env, …) by sensor; views."""
        for channel in self.channels:
            channel.drain()
        return {channel.frame.name: channel.result[: self.taken] for channel in self.channels}

    def continue_from(self, frames: Mapping[str, NDArray[Any]], times: NDArray[Any]) -> None:
        """Loads the frames that ``frames`` of another recorder returned, with their ``times`` [s]."""
        self.taken = 0
        self.require(len(times))
        self.count(times)
        for channel in self.channels:
            channel.result[: self.taken] = frames[channel.frame.name]
            channel.continue_from(self.taken)

    def rewind(self) -> None:
        """Begins a new block of frames, which overwrites the oldest one."""
        self._block, self.taken = (self._block + 1) % self._blocks, 0
        for channel in self.channels:
            channel.begin(self._block)

    def series(self) -> "xr.Dataset":
        """Returns the frames taken since the last ``rewind`` as a data set, (time, env, …); views."""
        import xarray as xr

        return xr.Dataset(**self._labelled(self._series_variables(), self._time()))

    def _series_variables(self) -> dict[str, Any]:
        variables = {}
        frames = self.frames()
        for channel in self.channels:
            sensor = channel.sensor
            dims = ["time", "env"] + ([item_dimension_of(self.model.scene, sensor)] if sensor.items else [])
            values = frames[sensor.name]
            if values.ndim == len(dims) + 2:
                dims += ["row", "column"]
            elif values.ndim > len(dims):
                dims.append(AXES[values.shape[-1]][0])
            notes = {"units": sensor.unit, "long_name": sensor.meaning, **sensor.flags}
            variables[sensor.name] = (dims, values, notes)
        return variables

    def _time(self) -> dict[str, Any]:
        return {"time": ("time", self.times[: self.taken], {"units": "s", "long_name": "simulated time"})}

    def parameters(self) -> "xr.Dataset":
        """Returns the stored parameters as a data set, (env, …)."""
        import xarray as xr

        return xr.Dataset(**self._labelled(self._parameter_variables(), {}))

    def _parameter_variables(self) -> dict[str, Any]:
        variables: dict[str, Any] = {}
        for parameter in self.kept:
            variables |= self._parameter_variable(parameter)
        return variables

    def _labelled(self, variables: Mapping[str, Any], coordinates: Mapping[str, Any]) -> dict[str, Any]:
        """Returns keyword arguments of a data set: ``variables``, and coordinates of all their dimensions."""
        model = self.model
        used = {dim for dims, _, _ in variables.values() for dim in dims}
        numbers = ("env", model.first_env + np.arange(model.envs), {"long_name": "environment"})
        # dtype object, because some formats have no fixed-length strings, such as the Zarr v3 specification.
        labels = {dim: (dim, np.array(names, object)) for dim, names in AXES.values() if dim in used}
        return {"data_vars": variables, "coords": {**coordinates, "env": numbers, **labels}}

    def finish(self, attributes: Mapping[str, Any]) -> "Recording":
        """Returns the recorded frames and the stored parameters as one data set."""
        from warpcontact.stepping.recording import Recording

        variables = {**self._series_variables(), **self._parameter_variables()}
        attrs = {**sources(self.model), **attributes}
        if unchanged := unchanged_parameters(self.model, map(str, variables)):
            attrs[UNCHANGED] = unchanged
        recording = Recording(**self._labelled(variables, self._time()), attrs=attrs)
        recording.scene = self.model.scene
        return recording


def sources(model: Environments) -> dict[str, str]:
    """Returns the attributes of a data set that state version, devices and precision."""
    return {
        "source": f"warpcontact {__version__}",
        "device": ", ".join(map(str, model.devices)),
        "precision": model.precision,
    }
