"""The way of frames from where a sensor is measured to the host.

On the CPU launches put it where it belongs, in one graph with steps: Python, which steps drive out of the cache of
a core, takes longer to call than a slice to copy. On a GPU frames wait in a buffer, and come to the host some at a
time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpcontact.model.environments import Environments
from warpcontact.model.model import Model
from warpcontact.stepping.frame_copies import FrameCopies
from warpcontact.storage.memory_estimate import MemoryItem
from warpcontact.system.capture_lock import shared_capture_lock
from warpcontact.system.resources import HOST

# Frames wait on a GPU up to this size, then move to the host in one copy.
RING_BYTES = 64 * 2**20


@dataclass(frozen=True)
class Frame:
    """What one frame of a sensor takes for one environment.

    Attributes:
        name: Name of the sensor.
        device: On the device, as it is read [bytes].
        host: On the host, as it is reported [bytes].
    """

    name: str
    device: int
    host: int

    def slots(self, envs: int, frames: int) -> int:
        """Returns how many frames wait on the device."""
        return min(frames, max(1, RING_BYTES // max(1, envs * self.device)))

    def memory_items(self, device: str, envs: int, frames: int, blocks: int = 1) -> list[MemoryItem]:
        """Returns what a buffer on ``device``, if it is a GPU, and the results on the host, one a block, take."""
        slots, result = self.slots(envs, frames), blocks * frames * self.host
        memory_items = [MemoryItem("recording", HOST, envs * result, result)]
        if not wp.get_device(device).is_cpu:
            # A buffer of some frames is of about the same size however many environments there are.
            grows = slots in (1, frames)
            memory_items.append(
                MemoryItem("buffers", device, slots * envs * self.device, slots * self.device if grows else 0)
            )
        return memory_items


class Channel:
    """The frames of one sensor: results on the host, and on each GPU a buffer, once they are allocated.

    Attributes:
        result: Where frames are put now, one of ``results``.
        results: One for each block of frames.
    """

    def __init__(self, model: Environments, name: str) -> None:
        self.model = model
        self.sensor = model.find_sensor(name)
        source = self.sensor.array(model.parts[0].arrays)
        row = prod(source.shape[1:]) * wp.types.type_size_in_bytes(source.dtype)
        # Of one environment, as it is reported.
        self._sample = self.sensor.finish(source[:1].numpy()[None], axis=2)[0, 0]
        self.frame = Frame(name, row, self._sample.nbytes)
        self.result = np.zeros((0, model.envs, *self._sample.shape), dtype=self._sample.dtype)
        self.results = [self.result]
        self.rings: dict[Model, Ring] = {}

    @shared_capture_lock()
    def allocate(self, frames: int, blocks: Sequence[Mapping[Model, FrameCopies]]) -> None:
        """Makes room for ``frames`` frames of each block, which are to be taken of parts on the CPU by copies."""
        shape = (frames, self.model.envs, *self._sample.shape)
        self.results = [np.zeros(shape, dtype=self._sample.dtype) for _ in blocks]
        for part, own in self.model.shares():
            for copies, result in zip(blocks, self.results, strict=True):
                if part in copies:
                    copies[part].add(part.sensors[self.frame.name], result[:, own])
            if not part.device.is_cpu:
                self.rings[part] = Ring(part, self.frame, own, frames)
        self.begin(0)

    def begin(self, block: int) -> None:
        """Puts the frames that come next into a block, from its first on; what waits on a device is dropped."""
        self.result = self.results[block]
        self.continue_from(0)

    def drain(self) -> None:
        """Takes to the host what waits on a device."""
        for ring in self.rings.values():
            ring.drain(self.result)

    def continue_from(self, count: int) -> None:
        """Takes the first ``count`` frames of the result for taken, and what waits for lost."""
        for ring in self.rings.values():
            ring.taken = ring.drained = count


class Ring:
    """The frames of one sensor of a part on a GPU, that wait in a buffer there.

    Args:
        part: The part.
        frame: What one frame takes, and of which sensor.
        own: Environments of the part, among all.
        frames: How many come until they are all on the host.
    """

    def __init__(self, part: Model, frame: Frame, own: slice, frames: int) -> None:
        self.sensor = part.sensors[frame.name]
        self.source = self.sensor.array(part.arrays)
        self.own = own
        shape = (frame.slots(part.envs, frames), *self.source.shape)
        self.memory = wp.zeros(shape, dtype=self.source.dtype, device=part.device)
        self.taken = 0
        self.drained = 0

    @shared_capture_lock()
    def take(self, number: int, result: NDArray[Any]) -> None:
        """Copies a frame, and takes what waits to ``result`` when the buffer is full."""
        wp.copy(self.memory[number - self.drained], self.source)
        self.taken = number + 1
        if self.taken - self.drained == len(self.memory):
            self.drain(result)

    def drain(self, result: NDArray[Any]) -> None:
        """Takes what waits to the host, to ``result`` (frame, env, …) of all environments."""
        count = self.taken - self.drained
        if count:
            values = self.sensor.finish(self.memory.numpy()[:count], axis=2)
            result[self.drained : self.taken, self.own] = values
            self.drained = self.taken
